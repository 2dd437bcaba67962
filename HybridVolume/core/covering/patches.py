# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Quads joined to patches of many spans, and pieces of surfaces where these are kept exactly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .. import bspline
from ..merged_quads import fewest_knots
from ..quad_layout import QuadLayout, quad_layout
from ..surface import SplineFace
from .coons import Nets
from .iso_faces import segment
from .quad_mesh import QuadCover

Spline = tuple[tuple[np.ndarray, np.ndarray], np.ndarray]
"""Knots on [0, 1] and homogeneous points of one quad's patch."""


@dataclass(frozen=True)
class Joined:
    """Patches of a cover.

    Attributes
    ----------
    faces : tuple of SplineFace
        Named ``Face3.1``, ``Face3.2``, ...; ``exact`` is false for pieces of the file's surfaces.
    origin : (n,) int array
        Face of the outline of each.
    places : dict
        Of patches that are pieces of surfaces: parameters there of their corners (u, v) = (0, 0),
        (1, 0), (1, 1), (0, 1), as (4, 2) arrays.
    """

    faces: tuple[SplineFace, ...]
    origin: np.ndarray
    places: dict[int, np.ndarray]


def joined_patches(
    cover: QuadCover,
    nets: Sequence[Nets],
    grids: Mapping[int, tuple[np.ndarray, np.ndarray]],
    surfaces: Sequence[SplineFace],
) -> Joined:
    """Patches of a cover, none across an edge of the outline.

    Parameters
    ----------
    cover : QuadCover
    nets : sequence of Nets
        Patches of quads.
    grids : mapping
        Corners and parameters of faces that are pieces of their surfaces.
    surfaces : sequence of SplineFace
    """
    layout, widths = _layout(cover, grids)
    face = np.empty(len(layout.grids), dtype=int)
    face[layout.patch] = cover.face
    order, starts = _cells(layout)
    where = np.empty((len(cover.quads), 2), dtype=int)
    for k, group in enumerate(nets):
        where[group.quads] = np.column_stack([np.full(len(group.quads), k),
                                              np.arange(len(group.quads))])  # fmt: skip
    size = float(np.linalg.norm(np.ptp(cover.points, axis=0)))
    count = np.zeros(len(surfaces), dtype=int)
    found, places = [], {}
    for k in range(len(layout.grids)):
        own = int(face[k])
        count[own] += 1
        name = f"Face{own + 1}.{count[own]}"
        if own in grids:
            piece, places[k] = _piece(layout.grids[k], name, *grids[own], surfaces[own])
            found.append(piece)
        else:
            cells = order[starts[k] : starts[k + 1]].tolist()
            pieces = [_turned(nets[where[q, 0]], where[q, 1], int(layout.first[q])) for q in cells]
            m, n = (extent - 1 for extent in layout.grids[k].shape)
            rows = [pieces[i * n : (i + 1) * n] for i in range(m)]
            first = np.array(cells)
            lines = widths[first[::n], 0], widths[first[:n], 1]
            found.append(_joined(rows, *map(_lines, lines), name, size))
    return Joined(tuple(found), face, places)


def _cells(layout: QuadLayout) -> tuple[np.ndarray, np.ndarray]:
    """Quads in the order of the patches and their cells, and where each patch begins."""
    order = np.lexsort((layout.cell[:, 1], layout.cell[:, 0], layout.patch))
    return order, np.concatenate([[0], np.cumsum(np.bincount(layout.patch))])


def _layout(
    cover: QuadCover, grids: Mapping[int, tuple[np.ndarray, np.ndarray]]
) -> tuple[QuadLayout, np.ndarray]:
    """Patches, and the widths of all quads along u and v of these, (m, 2).

    All quads of a strip have one width, so that the patches that it crosses match. In a piece of a
    surface the widths are those of the surface's parameters; where a strip crosses two pieces with
    different ones, the patches are cut between their cells.
    """
    quads, count = cover.quads, len(cover.points)
    pairs = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=2), axis=2)
    sides, number = np.unique(pairs[..., 0] * count + pairs[..., 1], return_inverse=True)
    number = number.reshape(quads.shape)
    links = np.concatenate([number[:, [0, 2]], number[:, [1, 3]]])
    graph = coo_array((np.ones(len(links)), links.T), shape=(len(sides), len(sides)))
    strip = connected_components(graph, directed=False)[1][number[:, :2]]
    cuts = cover.rim
    while True:
        layout = quad_layout(quads, cuts)
        # a patch may begin at another corner than its quads
        label = strip.copy()
        odd = layout.first % 2 == 1
        label[odd] = label[odd, ::-1]
        width, more = _strip_widths(layout, label, cover.face, grids)
        if not more:
            return layout, width[label]
        cuts = np.concatenate([cuts, *more])


def _strip_widths(
    layout: QuadLayout,
    label: np.ndarray,
    face: np.ndarray,
    grids: Mapping[int, tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Width of each strip, and sides between cells of pieces that need others."""
    width = np.zeros(label.max() + 1)
    order, starts = _cells(layout)
    more = []
    for k, grid in enumerate(layout.grids):
        own = int(face[order[starts[k]]])
        if own not in grids:
            continue
        corners, uv = grids[own]
        cells = order[starts[k] : starts[k + 1]].reshape(grid.shape[0] - 1, grid.shape[1] - 1)
        for axis in (0, 1):
            lines = grid if axis == 0 else grid.T
            if len(lines) < 3:
                continue
            strips = label[cells[:, 0] if axis == 0 else cells[0], axis]
            at = uv[np.searchsorted(corners, lines[:, 0])]
            step = np.abs(np.diff(at[:, np.ptp(at, axis=0).argmax()]))
            step /= step.mean()
            there = width[strips]
            if not there.any():
                width[strips] = step
            elif np.abs(there / there.mean() - step).max() > 1e-9:
                more.append(np.column_stack([lines[1:-1, 0], lines[1:-1, 1]]))
    width[width == 0.0] = 1.0
    return width, more


def _lines(widths: np.ndarray) -> np.ndarray:
    """Where cells of some widths end on [0, 1]; evenly where they are equal but for rounding."""
    count = len(widths)
    if np.ptp(widths) <= 1e-13 * widths.max():
        return np.arange(count + 1.0) / count
    lines = np.concatenate([[0.0], np.cumsum(widths)])
    return lines / lines[-1]


def _piece(
    grid: np.ndarray, name: str, corners: np.ndarray, uv: np.ndarray, surface: SplineFace
) -> tuple[SplineFace, np.ndarray]:
    """The piece of a surface under a patch, and the parameters of its corners."""
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
    return _face(name, degrees, knots, points, surface.exact), ends


def _turned(nets: Nets, row: int, first: int) -> Spline:
    """A quad's patch that begins at another of its corners."""
    (u, v), points = nets.knots, np.rot90(nets.points[row], -first, axes=(0, 1))
    knots = ((u, v), (v, 1.0 - u[::-1]), (1.0 - u[::-1], 1.0 - v[::-1]), (1.0 - v[::-1], u))[first]
    return knots, points


def _joined(
    cells: list[list[Spline]], u: np.ndarray, v: np.ndarray, name: str, size: float
) -> SplineFace:
    """One spline of the cells of a patch between lines, raised to the highest degrees there."""
    n = len(cells[0])
    degrees = [
        max(len(knots[axis]) - points.shape[axis] - 1 for line in cells for knots, points in line)
        for axis in (0, 1)
    ]
    lines = [
        [_common(degrees[0], [cell[0][0] for cell in line]) for line in cells],
        [_common(degrees[1], [line[j][0][1] for line in cells]) for j in range(n)],
    ]
    counts = [[len(knots) - p - 2 for knots in own] for p, own in zip(degrees, lines, strict=True)]
    begin = [np.concatenate([[0], np.cumsum(own)]) for own in counts]
    points = np.empty((begin[0][-1] + 1, begin[1][-1] + 1, 4))
    for i, line in enumerate(cells):
        for j, (knots, net) in enumerate(line):
            for axis, wanted in ((0, lines[0][i]), (1, lines[1][j])):
                matrix = _refining(degrees[axis], knots[axis], net.shape[axis], wanted)
                if matrix is not None:
                    net = np.moveaxis(np.tensordot(matrix, net, (1, axis)), 0, axis)
            at = [slice(begin[axis][k], begin[axis][k + 1] + 1) for axis, k in ((0, i), (1, j))]
            points[at[0], at[1]] = net
    plain = all(len(own) == 8 for line in lines for own in line)
    if degrees == [3, 3] and plain and np.all(points[..., 3] == 1.0):
        knots_u, points = fewest_knots(points, u, size)
        knots_v, points = fewest_knots(points.transpose(1, 0, 2), v, size)
        points = points.transpose(1, 0, 2)
        points[..., 3] = 1.0
    else:
        knots_u, knots_v = (
            _strung(p, own, at) for p, own, at in zip(degrees, lines, (u, v), strict=True)
        )
    return _face(name, (degrees[0], degrees[1]), (knots_u, knots_v), points, True)


def _common(degree: int, lines: list[np.ndarray]) -> np.ndarray:
    """Knots of a degree that contain those of all cells beside each other."""
    raised = []
    for knots in lines:
        values, counts = bspline.multiplicities(knots)
        raised.append(np.repeat(values, counts + degree + 1 - counts[0]))
    if all(np.array_equal(knots, raised[0]) for knots in raised[1:]):
        return raised[0]
    return bspline.merge_knots(degree, raised)


def _refining(degree: int, knots: np.ndarray, count: int, wanted: np.ndarray) -> np.ndarray | None:
    """Matrix to the control points over other knots of a higher degree; None if they are these."""
    own = len(knots) - count - 1
    matrix = None
    if own < degree:
        matrix, knots = bspline.elevation_matrix(own, knots, degree - own)
    if not np.array_equal(knots, wanted):
        finer = bspline.insertion_matrix(degree, bspline.snap_knots(knots, wanted), wanted)
        matrix = finer if matrix is None else finer @ matrix
    return matrix


def _strung(degree: int, lines: list[np.ndarray], at: np.ndarray) -> np.ndarray:
    """Knots of cells one after the other, which only touch."""
    inner = []
    for own, low, high in zip(lines, at[:-1], at[1:], strict=True):
        knots = low + own[degree + 1 : -1] * (high - low)
        knots[own[degree + 1 : -1] == 1.0] = high
        inner.append(knots)
    return np.concatenate([np.zeros(degree + 1), *inner, at[-1:]])


def _face(
    name: str,
    degrees: tuple[int, int],
    knots: tuple[np.ndarray, np.ndarray],
    points: np.ndarray,
    exact: bool,
) -> SplineFace:
    weights = np.ascontiguousarray(points[..., 3])
    return SplineFace(
        name,
        (int(degrees[0]), int(degrees[1])),
        (np.ascontiguousarray(knots[0]), np.ascontiguousarray(knots[1])),
        np.ascontiguousarray(points[..., :3] / weights[..., None]),
        weights,
        exact,
    )
