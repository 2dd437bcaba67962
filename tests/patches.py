# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Spline patches for test bodies, made with SciPy's splines and not with our own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline

from HybridVolume.core.surface import SplineFace
from HybridVolume.reproduce.voxels import greville, uniform_knots


@dataclass(frozen=True)
class Body:
    """Faces with what is known about the body that they bound.

    Attributes
    ----------
    name : str
    faces : tuple of SplineFace
    volume : float
        mm³, exact.
    genus : tuple of int
        One a shell, the outer shell first.
    """

    name: str
    faces: tuple[SplineFace, ...]
    volume: float
    genus: tuple[int, ...] = (0,)


def interpolating_face(
    function: Callable[[np.ndarray, np.ndarray], np.ndarray],
    degrees: tuple[int, int],
    knots: tuple[np.ndarray, np.ndarray],
) -> SplineFace:
    """Face through a function on [0, 1]², exact where the function lies in the spline space.

    Parameters
    ----------
    function : callable
        Takes u (m, 1) and v (1, n), returns (m, n, 3) points or (m, n, 4) homogeneous ones.
    degrees, knots : pairs
        Knots on [0, 1].
    """
    at = [greville(p, t) for p, t in zip(degrees, knots, strict=True)]
    values = np.asarray(function(at[0][:, None], at[1][None, :]), dtype=float)
    for axis in range(2):
        matrix = BSpline.design_matrix(at[axis], knots[axis], degrees[axis]).toarray()
        rows = np.moveaxis(values, axis, 0)
        solved = np.linalg.solve(matrix, rows.reshape(len(rows), -1)).reshape(rows.shape)
        values = np.moveaxis(solved, 0, axis)
    if values.shape[-1] == 3:
        return SplineFace("", degrees, knots, values, np.ones(values.shape[:2]))
    weights = values[..., 3]
    return SplineFace("", degrees, knots, values[..., :3] / weights[..., None], weights)


def bilinear_face(
    corners: Sequence, degrees: tuple[int, int], knots: tuple[np.ndarray, np.ndarray]
) -> SplineFace:
    """Bilinear face; its control points are its values at the Greville abscissae.

    Parameters
    ----------
    corners : (2, 2, 3) array
        Indexed by u, then v.
    """
    c = np.asarray(corners, dtype=float)
    u = greville(degrees[0], knots[0])[:, None, None]
    v = greville(degrees[1], knots[1])[None, :, None]
    points = (1 - u) * ((1 - v) * c[0, 0] + v * c[0, 1]) + u * ((1 - v) * c[1, 0] + v * c[1, 1])
    return SplineFace("", degrees, knots, points, np.ones(points.shape[:2]))


def bezier_face(points: np.ndarray, weights: np.ndarray | None = None) -> SplineFace:
    """One-span face of (nu, nv, 3) control points."""
    points = np.asarray(points, dtype=float)
    degrees = (points.shape[0] - 1, points.shape[1] - 1)
    weights = np.ones(points.shape[:2]) if weights is None else np.asarray(weights, dtype=float)
    return SplineFace("", degrees, tuple(uniform_knots(p, 1) for p in degrees), points, weights)


def homogeneous(face: SplineFace, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Homogeneous points (wx, wy, wz, w) of a face on a grid, (mu, mv, 4)."""
    values = np.concatenate(
        [face.control_points * face.weights[..., None], face.weights[..., None]], axis=-1
    )
    for axis, x in enumerate((u, v)):
        spline = BSpline(face.knots[axis], np.moveaxis(values, axis, 0), face.degrees[axis])
        values = np.moveaxis(spline(np.ravel(x)), 0, axis)
    return values


def represent(face: SplineFace, degrees: tuple[int, int], spans: tuple[int, int]) -> SplineFace:
    """The same one-span face with more degree or uniform spans."""
    knots = tuple(uniform_knots(p, n) for p, n in zip(degrees, spans, strict=True))
    rational = np.ptp(face.weights) > 0.0
    keep = 4 if rational else 3
    fresh = interpolating_face(lambda u, v: homogeneous(face, u, v)[..., :keep], degrees, knots)
    return replace(fresh, name=face.name)


def make_body(
    name: str, faces: Sequence[SplineFace], volume: float, genus: Sequence[int] = (0,)
) -> Body:
    named = tuple(replace(face, name=f"Face{k + 1}") for k, face in enumerate(faces))
    return Body(name, named, float(volume), tuple(genus))
