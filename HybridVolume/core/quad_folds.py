# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Surfaces made from a mesh that fold or cut themselves, told by the faces of the mesh."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..errors import HybridVolumeError, SelfIntersectionError, SingularSurfaceError
from .bezier import bernstein
from .check import check_surface, check_uncut
from .intersection import self_intersections
from .polygons import have, near, some
from .surface import PatchSurface

SAMPLES = 7
"""Places a direction of each net where its normal is looked at first."""
FLAT = 1e-6
"""Normal at a place over the largest of the net below which it is suspicious."""

FEW = 4000
"""Nets up to which crossing parts are looked for with more than their corners."""


def check_quads(surface: PatchSurface, nets: np.ndarray, numbers: np.ndarray) -> None:
    """Refuse a surface that is folded or cuts itself.

    Only what a look at samples finds suspicious is proved, for the proof takes as long as the
    check of any body before its shell.

    Parameters
    ----------
    surface : PatchSurface
    nets : (q, p + 1, p + 1, 3) array
        The same as Bézier points, mm.
    numbers : (q,) int array
        Face of the mesh's file that each is from.

    Raises
    ------
    SingularSurfaceError, SelfIntersectionError
        Naming faces of the file.
    """
    points, normals = _sampled(nets)
    middle = surface.control_points.mean(axis=0)
    lengths = np.linalg.norm(normals, axis=-1)
    mean = normals.sum(axis=(1, 2))
    ahead = np.einsum("qabd,qd->qab", normals, mean)
    # corners may be straight, for a shell can follow these
    inner = (slice(None), slice(1, -1), slice(1, -1))
    flat = lengths[inner].min(axis=(1, 2)) <= FLAT * lengths.max(axis=(1, 2))
    if (flat | (ahead.min(axis=(1, 2)) < 0.0)).any():
        try:
            check_surface(surface, lines=True)
        except SingularSurfaceError as error:
            faces = _faces(error, points, numbers, flat | (ahead.min(axis=(1, 2)) < 0.0))
            what = error.places[0].what if error.places else "the surface is folded"
            raise SingularSurfaceError(
                f"{some('face', faces)} of the mesh: {what}{near(_first(error, middle))}",
                figure=float(len(faces)),
                remedy="move vertices so that these faces are convex, not folded, and their edges"
                " not as sharp as a knife",
            ) from error
    every = SAMPLES // 2 if len(nets) <= FEW else SAMPLES - 1
    if not _crossing(points[:, ::every, ::every]):
        return
    try:
        check_uncut(surface)
    except SelfIntersectionError as error:
        faces = _faces(error, points, numbers, np.ones(len(nets), dtype=bool))
        raise SelfIntersectionError(
            f"the surface cuts itself at {some('face', faces)} of the mesh"
            f"{near(_first(error, middle))}",
            figure=float(len(faces)),
            remedy=f"move {have(faces, 'it', 'them')} apart from the others",
        ) from error


def _first(error: HybridVolumeError, middle: np.ndarray) -> np.ndarray:
    return np.array(error.places[0].point) if error.places else middle


def _faces(
    error: HybridVolumeError, points: np.ndarray, numbers: np.ndarray, chosen: np.ndarray
) -> np.ndarray:
    """Faces of the mesh where an error has its places; without places those that are chosen."""
    if not error.places:
        return np.unique(numbers[chosen])
    count = points.shape[1] * points.shape[2]
    _, nearest = cKDTree(points.reshape(-1, 3)).query([place.point for place in error.places])
    return np.unique(numbers[nearest // count])


def _sampled(nets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals at places of each net, (q, k, k, 3) each."""
    degree = nets.shape[1] - 1
    t = np.linspace(0.0, 1.0, SAMPLES)
    value, slope = bernstein(degree, t), bernstein(degree, t, 1)
    along = np.einsum("sa,tb,qabd->qstd", slope, value, nets, optimize=True)
    across = np.einsum("sa,tb,qabd->qstd", value, slope, nets, optimize=True)
    points = np.einsum("sa,tb,qabd->qstd", value, value, nets, optimize=True)
    return points, np.cross(along, across)


def _crossing(grid: np.ndarray) -> bool:
    """Whether triangles over grids of points (q, m, m, 3) cut each other."""
    q, m = grid.shape[:2]
    # common sides have the same points but for rounding
    flat = grid.reshape(-1, 3)
    size = np.linalg.norm(np.ptp(flat, axis=0))
    places, number = np.unique(np.round((flat - flat[0]) / (1e-9 * size)), axis=0,
                               return_inverse=True)  # fmt: skip
    number = number.reshape(q, m, m)
    a, b = number[:, :-1, :-1].ravel(), number[:, 1:, :-1].ravel()
    c, d = number[:, 1:, 1:].ravel(), number[:, :-1, 1:].ravel()
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return len(self_intersections(places * (1e-9 * size), triangles[whole])) > 0
