# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bicubic Bézier patches of quads joined to B-spline patches, one for each patch of the layout.

Knots are as few as the smoothness along a whole line allows: simple where curvatures agree, double
where slopes do, triple elsewhere. The surface stays what it was.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from . import bspline
from .quad_layout import quad_layout
from .surface import SplineFace

EXACT = 1e-11
"""Share of the size by which a patch with fewer knots may miss its quads."""
THIRDS = bspline.insertion_matrix(3, bspline.clamped_knots(3, 1), bspline.clamped_knots(3, 3, 3))
"""Bézier points of three pieces (10) of those of one (4)."""


def merged_faces(
    quads: np.ndarray,
    nets: np.ndarray,
    sides: np.ndarray,
    size: float,
    split: Mapping[int, np.ndarray] | None = None,
) -> list[SplineFace]:
    """B-spline patches of the quads' nets.

    Parameters
    ----------
    quads : (nf, 4) int array
        Closed and oriented.
    nets : (nf, 4, 4, 3) array
        Bézier points, u from the first corner to the second; neighbours share theirs.
    sides : (e, 2) int array
        Edges that must be on sides of patches.
    size : float
        Of the whole, mm, that `EXACT` is a share of.
    split : mapping of int to (10, 10, 3) array, optional
        Quads at corners of patches whose patch has three by three pieces; then all cells along
        sides of patches are cut into three, so that neighbours match.
    """
    layout = quad_layout(quads, sides)
    order = np.lexsort((layout.cell[:, 1], layout.cell[:, 0], layout.patch))
    starts = np.concatenate([[0], np.cumsum(np.bincount(layout.patch))])
    faces = []
    for k, grid in enumerate(layout.grids):
        m, n = grid.shape[0] - 1, grid.shape[1] - 1
        lines_u, lines_v = (_lines(count, split is not None) for count in (m, n))
        points = np.empty((3 * len(lines_u) - 2, 3 * len(lines_v) - 2, 3))
        for row, quad in enumerate(order[starts[k] : starts[k + 1]].tolist()):
            i, j = divmod(row, n)
            at_u, at_v = (np.searchsorted(line, (c, c + 1)) for line, c in
                          ((lines_u, i), (lines_v, j)))  # fmt: skip
            net = nets[quad] if split is None else split.get(quad, nets[quad])
            net = np.rot90(net, -int(layout.first[quad]), axes=(0, 1))
            net = _cut(_cut(net, np.diff(at_u)[0]).transpose(1, 0, 2), np.diff(at_v)[0])
            points[3 * at_u[0] : 3 * at_u[1] + 1, 3 * at_v[0] : 3 * at_v[1] + 1] = net.transpose(
                1, 0, 2
            )
        knots_u, points = fewest_knots(points, lines_u, size)
        knots_v, points = fewest_knots(points.transpose(1, 0, 2), lines_v, size)
        points = np.ascontiguousarray(points.transpose(1, 0, 2))
        faces.append(
            SplineFace(
                name=f"Face{k + 1}",
                degrees=(3, 3),
                knots=(knots_u, knots_v),
                control_points=points,
                weights=np.ones(points.shape[:2]),
            )
        )
    return faces


def _lines(cells: int, thirds: bool) -> np.ndarray:
    """Where the pieces of a patch end."""
    lines = np.arange(cells + 1.0)
    if not thirds:
        return lines
    parts = np.array([1.0, 2.0]) / 3.0
    return np.unique(np.concatenate([lines, parts, cells - 1 + parts]))


def _cut(net: np.ndarray, parts: int) -> np.ndarray:
    """A net with so many pieces along its first axis."""
    if len(net) == 3 * parts + 1:
        return net
    return np.tensordot(THIRDS, net, 1)


def fewest_knots(
    points: np.ndarray, lines: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """Knots and control points along the first axis of cubic pieces.

    Parameters
    ----------
    points : (3 m + 1, n, 3) array
        Bézier points.
    lines : (m + 1,) array
        Where the pieces end.
    size : float
        mm.
    """
    inner = np.arange(1, len(lines) - 1)
    h = np.diff(lines)
    low, high = (a[:, None, None] for a in (h[inner - 1], h[inner]))
    left, a, middle, b, right = (points[3 * inner + step] for step in (-2, -1, 0, 1, 2))
    slope = np.abs((middle - a) / low - (b - middle) / high)
    bend = np.abs((left - 2.0 * a + middle) / low**2 - (right - 2.0 * b + middle) / high**2)
    smooth = slope.max(axis=(1, 2), initial=0.0) <= EXACT * size
    plain = smooth & (bend.max(axis=(1, 2), initial=0.0) <= 100.0 * EXACT * size)
    count = np.where(plain, 1, np.where(smooth, 2, 3))
    full = np.concatenate([lines[:1], np.repeat(lines, 3), lines[-1:]])
    if (count == 3).all():
        return full, points
    knots = np.concatenate(
        [np.repeat(lines[0], 4), np.repeat(lines[inner], count), np.repeat(lines[-1], 4)]
    )
    # the control points that give these ones by knot insertion
    raised = bspline.insertion_matrix(3, knots, full)
    flat = points.reshape(len(points), -1)
    found, *_ = np.linalg.lstsq(raised, flat, rcond=None)
    found[0], found[-1] = flat[0], flat[-1]
    if np.abs(raised @ found - flat).max() > 10.0 * EXACT * size:
        return full, points
    return knots, found.reshape(-1, *points.shape[1:])
