# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Surfaces and geometry that travel to the worker: plain arrays in .npz files, no pickles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from HybridVolume.core.surface import SplineFace


def write_surface(path: Path, faces: Sequence[SplineFace]) -> None:
    """Write faces as plain arrays (no pickles) for the worker."""
    arrays: dict[str, np.ndarray] = {"names": np.array([face.name for face in faces], dtype=str)}
    arrays["exact"] = np.array([face.exact for face in faces], dtype=bool)
    arrays["degrees"] = np.array([face.degrees for face in faces], dtype=np.int64)
    for number, face in enumerate(faces):
        arrays[f"knots_u_{number}"], arrays[f"knots_v_{number}"] = map(np.asarray, face.knots)
        arrays[f"control_points_{number}"] = np.asarray(face.control_points, dtype=float)
        arrays[f"weights_{number}"] = np.asarray(face.weights, dtype=float)
    np.savez(path, **arrays)


def read_surface(path: Path) -> list[SplineFace]:
    """Read what :func:`write_surface` wrote, bit for bit."""
    with np.load(path, allow_pickle=False) as data:
        return [
            SplineFace(
                name=str(name),
                degrees=tuple(int(p) for p in data["degrees"][number]),
                knots=(data[f"knots_u_{number}"], data[f"knots_v_{number}"]),
                control_points=data[f"control_points_{number}"],
                weights=data[f"weights_{number}"],
                exact=bool(data["exact"][number]),
            )
            for number, name in enumerate(data["names"])
        ]


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
