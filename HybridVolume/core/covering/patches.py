# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Quads joined to patches of many spans, and pieces of surfaces where these are kept exactly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import bspline
from ..merged_quads import fewest_knots
from ..quad_layout import QuadLayout, quad_layout
from ..surface import SplineFace
from .iso_faces import segment
from .quad_mesh import QuadCover


def joined_patches(
    cover: QuadCover,
    nets: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]],
    grids: dict[int, tuple[np.ndarray, np.ndarray]],
    surfaces: Sequence[SplineFace],
) -> tuple[list[SplineFace], np.ndarray]:
    """Patches of a cover, none across an edge of the outline.

    Parameters
    ----------
    cover : QuadCover
    nets : dict
        Homogeneous Bézier points of quads by their degrees.
    grids : dict
        Corners and parameters of faces that are pieces of their surfaces.
    surfaces : sequence of SplineFace

    Returns
    -------
    patches : list of SplineFace
        Named ``Face3.1``, ``Face3.2``, ...
    face : (n,) int array
        Face of the outline of each.
    """
    layout = quad_layout(cover.quads, cover.rim)
    face = np.empty(len(layout.grids), dtype=int)
    face[layout.patch] = cover.face
    order = np.lexsort((layout.cell[:, 1], layout.cell[:, 0], layout.patch))
    starts = np.concatenate([[0], np.cumsum(np.bincount(layout.patch))])
    where = np.empty((len(cover.quads), 3), dtype=int)
    for (du, dv), (quads, _) in nets.items():
        where[quads] = np.column_stack([np.full(len(quads), du), np.full(len(quads), dv),
                                        np.arange(len(quads))])  # fmt: skip
    size = float(np.linalg.norm(np.ptp(cover.points, axis=0)))
    count = np.zeros(len(surfaces), dtype=int)
    found = []
    for k in range(len(layout.grids)):
        own = int(face[k])
        count[own] += 1
        name = f"Face{own + 1}.{count[own]}"
        if own in grids:
            found.append(_piece(layout.grids[k], name, *grids[own], surfaces[own]))
        else:
            cells = order[starts[k] : starts[k + 1]]
            found.append(_joined(layout, k, cells, nets, where, name, size))
    return found, face


def _piece(
    grid: np.ndarray, name: str, corners: np.ndarray, uv: np.ndarray, surface: SplineFace
) -> SplineFace:
    """The piece of a surface under a patch."""
    ends = uv[np.searchsorted(corners, grid[[0, -1, -1, 0], [0, 0, -1, -1]])]
    turned = abs(ends[1, 0] - ends[0, 0]) < abs(ends[1, 1] - ends[0, 1])
    low, high = ends.min(axis=0), ends.max(axis=0)
    knots, points = segment(surface, (low[0], high[0]), (low[1], high[1]))
    degrees = surface.degrees
    if turned:
        knots, points, degrees = knots[::-1], points.transpose(1, 0, 2), degrees[::-1]
    for axis, corner in ((0, 1), (1, 3)):
        along = (1 - axis) if turned else axis
        if ends[corner, along] < ends[0, along]:
            points = np.flip(points, axis=axis)
            knots = tuple(1.0 - own[::-1] if d == axis else own for d, own in enumerate(knots))
    return _face(name, degrees, knots, points)


def _joined(
    layout: QuadLayout,
    k: int,
    cells: np.ndarray,
    nets: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]],
    where: np.ndarray,
    name: str,
    size: float,
) -> SplineFace:
    """One spline of the quads of a patch, all raised to the highest degrees among them."""
    m, n = (extent - 1 for extent in layout.grids[k].shape)
    turned = [np.rot90(_net(nets, where, quad), -int(layout.first[quad]), axes=(0, 1))
              for quad in cells.tolist()]  # fmt: skip
    du, dv = (max(net.shape[axis] for net in turned) - 1 for axis in (0, 1))
    points = np.empty((m * du + 1, n * dv + 1, 4))
    for row, net in enumerate(turned):
        i, j = divmod(row, n)
        points[i * du : (i + 1) * du + 1, j * dv : (j + 1) * dv + 1] = _raised(net, du, dv)
    lines_u, lines_v = np.arange(m + 1.0), np.arange(n + 1.0)
    if (du, dv) == (3, 3) and np.all(points[..., 3] == 1.0):
        knots_u, points = fewest_knots(points, lines_u, size)
        knots_v, points = fewest_knots(points.transpose(1, 0, 2), lines_v, size)
        points = points.transpose(1, 0, 2)
        points[..., 3] = 1.0
    else:
        knots_u, knots_v = _knots(du, lines_u), _knots(dv, lines_v)
    return _face(name, (du, dv), (knots_u / m, knots_v / n), points)


def _net(
    nets: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]], where: np.ndarray, quad: int
) -> np.ndarray:
    du, dv, row = where[quad].tolist()
    return nets[du, dv][1][row]


def _raised(net: np.ndarray, du: int, dv: int) -> np.ndarray:
    for axis, degree in ((0, du), (1, dv)):
        own = net.shape[axis] - 1
        if own < degree:
            up = bspline.bezier_elevation(own, degree - own)
            net = np.moveaxis(np.tensordot(up, net, (1, axis)), 0, axis)
    return net


def _knots(degree: int, lines: np.ndarray) -> np.ndarray:
    return np.concatenate([lines[:1], np.repeat(lines, degree), lines[-1:]])


def _face(
    name: str, degrees: tuple[int, int], knots: tuple[np.ndarray, np.ndarray], points: np.ndarray
) -> SplineFace:
    weights = np.ascontiguousarray(points[..., 3])
    return SplineFace(
        name,
        (int(degrees[0]), int(degrees[1])),
        (np.ascontiguousarray(knots[0]), np.ascontiguousarray(knots[1])),
        np.ascontiguousarray(points[..., :3] / weights[..., None]),
        weights,
    )
