# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Faces that are an iso-parameter rectangle of their surface: their quads follow its parameters.

Such a face keeps its geometry and parametrisation: its patches are pieces of the surface itself,
where the corners of quads on opposite sides stand at the same parameters and the edges' curves are
the surface's own sides, see :mod:`.iso_sides`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..surface import SplineFace
from .geometry import clamped_part, evaluate
from .quad_mesh import QuadCover

SAME = 1e-7
"""Shares of a range on opposite sides that agree to this are the same; lines are between them."""


def grid_parameters(
    cover: QuadCover, face: int, surface: SplineFace, rim: np.ndarray, share: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Parameters of a face's corners if they form a grid.

    Parameters
    ----------
    cover : QuadCover
    face : int
    surface : SplineFace
    rim : (k,) int array
        Corners on the sides of the face, sorted,
    share : (k, 2) array
        and where they stand there.

    Returns
    -------
    corners : (n,) int array
    uv : (n, 2) array
        Inner corners stand where the lines through the corners on the sides cross. None where
        opposite sides have different parameters.
    """
    quads = cover.quads[cover.face == face]
    corners, local = np.unique(quads, return_inverse=True)
    local = local.reshape(quads.shape)
    on_rim = np.isin(corners, rim)
    if on_rim.sum() != len(rim):
        return None
    known = np.zeros((len(corners), 2))
    known[on_rim] = share
    lines = []
    for axis in (0, 1):
        low, high = (np.sort(share[share[:, 1 - axis] == side, axis]) for side in (0.0, 1.0))
        if len(low) != len(high) or np.abs(low - high).max() > SAME:
            return None
        lines.append(0.5 * (low + high))
    if len(corners) != len(lines[0]) * len(lines[1]):
        return None
    place = _grid_places(local, known, on_rim, lines)
    if place is None:
        return None
    exact = np.column_stack([lines[0][place[:, 0]], lines[1][place[:, 1]]])
    low, high = (np.array([knots[k] for knots in surface.knots]) for k in (0, -1))
    return corners, low + exact * (high - low)


def _grid_places(
    quads: np.ndarray, share: np.ndarray, on_rim: np.ndarray, lines: list[np.ndarray]
) -> np.ndarray | None:
    """Row and column of every corner, found from quad to quad beginning at a corner of the face."""
    count = len(share)
    place = np.full((count, 2), -1)
    for axis in (0, 1):
        known = np.abs(share[:, axis, None] - lines[axis]).argmin(axis=1)
        place[on_rim, axis] = known[on_rim]
    # an inner corner is opposite a known one in a quad whose three other corners are known
    for _ in range(count):
        missing = place[quads].min(axis=2) < 0
        ready = np.flatnonzero(missing.sum(axis=1) == 1)
        if not len(ready):
            break
        k = missing[ready].argmax(axis=1)
        around = [place[quads[ready, (k + step) % 4]] for step in (1, 2, 3)]
        place[quads[ready, k]] = around[0] + around[2] - around[1]
    if place.min() < 0 or len(np.unique(place, axis=0)) != count:
        return None
    step = np.abs(place[quads] - place[np.roll(quads, -1, axis=1)]).sum(axis=2)
    return place if np.all(step == 1) else None


def on_grids(
    cover: QuadCover,
    grids: Mapping[int, tuple[np.ndarray, np.ndarray]],
    surfaces: Sequence[SplineFace],
) -> QuadCover:
    """Put inner corners of faces to the places where their parameter lines cross."""
    points = cover.points.copy()
    inside = np.ones(len(points), dtype=bool)
    inside[cover.rim] = False
    for face, (corners, uv) in grids.items():
        own = inside[corners]
        if own.any():
            points[corners[own]] = evaluate(surfaces[face], uv[own])[0]
    return replace(cover, points=points)


def segment(
    face: SplineFace, u: tuple[float, float], v: tuple[float, float]
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """A rectangle of a surface as a spline of its own.

    Returns
    -------
    knots : (array, array)
        On [0, 1].
    points : (nu, nv, 4) array
        (w x, w y, w z, w)
    """
    points = np.concatenate(
        [face.control_points * face.weights[..., None], face.weights[..., None]], axis=2
    )
    knots = []
    for axis, ends in enumerate((u, v)):
        own, matrix = clamped_part(face.degrees[axis], face.knots[axis], *ends)
        points = np.moveaxis(np.tensordot(matrix, points, (1, axis)), 0, axis)
        knots.append((own - own[0]) / (own[-1] - own[0]))
    return (knots[0], knots[1]), points
