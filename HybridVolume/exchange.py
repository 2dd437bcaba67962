# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Surfaces and geometry that travel to the worker: plain arrays in .npz files, no pickles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from HybridVolume.core.surface import SplineFace


def write_surface(path: Path, faces: Sequence[SplineFace]) -> None:
    """Write faces as plain arrays (no pickles) for the worker.

    The faces' knots, points and weights stand one behind the other: a member of an archive costs
    more than what is in it, and there may be thousands of faces.
    """
    knots = {
        f"knots_{name}": [np.asarray(face.knots[axis], dtype=float) for face in faces]
        for axis, name in enumerate("uv")
    }
    points = [np.asarray(face.control_points, dtype=float) for face in faces]
    np.savez(
        path,
        names=np.array([face.name for face in faces], dtype=str),
        exact=np.array([face.exact for face in faces], dtype=bool),
        degrees=np.array([face.degrees for face in faces], dtype=np.int64).reshape(-1, 2),
        shapes=np.array([net.shape[:2] for net in points], dtype=np.int64).reshape(-1, 2),
        control_points=_joined([net.reshape(-1, 3) for net in points], (0, 3)),
        weights=_joined([np.asarray(face.weights, dtype=float).ravel() for face in faces], (0,)),
        **{name: _joined(lines, (0,)) for name, lines in knots.items()},
        **{f"{name}_sizes": np.array(list(map(len, k)), int) for name, k in knots.items()},
    )


def read_surface(path: Path) -> list[SplineFace]:
    """Read what :func:`write_surface` wrote, bit for bit."""
    with np.load(path, allow_pickle=False) as data:
        shapes = data["shapes"]
        knots = [_parted(data[f"knots_{name}"], data[f"knots_{name}_sizes"]) for name in "uv"]
        points = _parted(data["control_points"], shapes.prod(axis=1))
        weights = _parted(data["weights"], shapes.prod(axis=1))
        names, degrees, exact = (data[name].tolist() for name in ("names", "degrees", "exact"))
    return [
        SplineFace(
            name=names[number],
            degrees=tuple(degrees[number]),
            knots=(knots[0][number], knots[1][number]),
            control_points=points[number].reshape(*shape, 3),
            weights=weights[number].reshape(shape),
            exact=exact[number],
        )
        for number, shape in enumerate(shapes.tolist())
    ]


def _joined(parts: Sequence[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    return np.concatenate(parts) if parts else np.zeros(shape)


def _parted(values: np.ndarray, sizes: np.ndarray) -> list[np.ndarray]:
    """Parts of the given sizes, each an array of its own."""
    ends = np.cumsum(sizes).tolist()
    starts = [0, *ends]
    return [values[a:b].copy() for a, b in zip(starts, ends, strict=False)]


def write_own(path: Path, vertices: np.ndarray, facets: np.ndarray) -> None:
    """Write geometry of the user's for the worker."""
    np.savez(
        path, vertices=np.asarray(vertices, dtype=float), facets=np.asarray(facets, dtype=np.int64)
    )


def read_own(path: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """Read what :func:`write_own` wrote; None where there is none."""
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as data:
        return data["vertices"], data["facets"]
