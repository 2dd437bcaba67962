# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Faces that are the whole rectangle of their surface's parameters, and the edges on its sides.

Corners of such a face may be flat, and a side may have several edges. Whether an edge is on a side
is judged by the edge's own tolerance: files give curves that miss their faces by that much. The
surface's own side is then taken as the curve of the edge.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from .. import bspline
from ..surface import SplineFace
from .geometry import SplineCurve
from .outline import Outline

SAME = 1e-9
"""Points that agree to this share of the diagonal are the same, and so are functions."""
SHARE = 1e-7
"""Ends of edges on a side are the same to this share of its range."""
_SAMPLES = 11


@dataclass(frozen=True)
class IsoSides:
    """Edges around a face that is the rectangle of its surface.

    Attributes
    ----------
    order : tuple of four int arrays
        Edges of the four sides as they follow each other in the face's loop.
    edge : (k,) int array
        The edges side by side,
    side : (k,) int array
        which side each is on: 0 and 1 are the first and last u, 2 and 3 the first and last v,
    ends : (k, 2) array
        and where it begins and ends there, as a share of the range.
    curve : tuple of k SplineCurve
        These parts of the surface's sides; they run with its parameters.
    """

    order: tuple[np.ndarray, ...]
    edge: np.ndarray
    side: np.ndarray
    ends: np.ndarray
    curve: tuple[SplineCurve, ...]

    def along(self, side: int) -> tuple[np.ndarray, np.ndarray]:
        """Edges of a side in the order of the surface's parameter, and the k + 1 shares."""
        own = np.flatnonzero(self.side == side)
        low = self.ends[own].min(axis=1)
        order = np.argsort(low)
        return self.edge[own[order]], np.append(low[order], 1.0)


def iso_sides(
    outline: Outline,
    curves: Sequence[SplineCurve | None],
    surfaces: Sequence[SplineFace],
    tolerance: float,
) -> dict[int, IsoSides]:
    """Faces of an outline that are whole rectangles.

    Parameters
    ----------
    outline : Outline
    curves, surfaces : sequences
        Of its edges and faces.
    tolerance : float
        What an edge may be moved by at most, mm.
    """
    diagonal = float(np.linalg.norm(np.ptp(outline.vertices, axis=0)))
    samples: dict[int, np.ndarray] = {}
    found = {}
    for face, surface in enumerate(surfaces):
        own = np.flatnonzero(outline.face == face)
        if len(np.unique(outline.loop[own])) != 1 or len(own) < 4:
            continue
        edges = outline.edge[own]
        if len(np.unique(edges)) < len(edges):
            continue
        loose = 2.0 * max(curves[edge].tolerance for edge in edges.tolist())
        reach = SAME * diagonal + min(loose, tolerance)
        corners = surface.control_points[[0, 0, -1, -1], [0, -1, 0, -1]]
        vertices = outline.vertices[outline.edges[edges].ravel()]
        off = np.linalg.norm(corners[:, None] - vertices, axis=2).min(axis=1)
        if off.max() > reach or any(_short(surface, side, reach) for side in range(4)):
            continue
        for edge in edges.tolist():
            if edge not in samples:
                samples[edge] = _samples(curves[edge])
        sides = _placed(surface, [samples[edge] for edge in edges.tolist()], reach)
        if sides is not None and (around := _around(edges, *sides)) is not None:
            found[face] = around
    return found


def _short(surface: SplineFace, side: int, reach: float) -> bool:
    row = side_points(surface, side)[0]
    return bool(np.linalg.norm(np.ptp(row, axis=0)) <= 4.0 * reach)


def side_points(surface: SplineFace, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Control points (n, 3) and weights of a side of a surface."""
    axis, row = side // 2, (0, -1)[side % 2]
    return (
        np.take(surface.control_points, row, axis=axis),
        np.take(surface.weights, row, axis=axis),
    )


def side_curve(surface: SplineFace, side: int) -> SplineCurve:
    """A side of a surface, with its parameters."""
    along = 1 - side // 2
    return SplineCurve(surface.degrees[along], surface.knots[along], *side_points(surface, side))


def _samples(curve: SplineCurve) -> np.ndarray:
    return curve.evaluate(np.linspace(curve.knots[0], curve.knots[-1], _SAMPLES))


def _placed(
    surface: SplineFace, samples: list[np.ndarray], reach: float
) -> tuple[np.ndarray, np.ndarray, list[SplineCurve]] | None:
    """Side, shares of the ends and curve of each edge; None where one is on no side."""
    whole = [side_curve(surface, side) for side in range(4)]
    count = len(samples)
    points = np.concatenate(samples)
    off, share = np.empty((4, count)), np.empty((4, count, _SAMPLES))
    for side, curve in enumerate(whole):
        t = curve.project(points)
        away = np.linalg.norm(curve.evaluate(t) - points, axis=1).reshape(count, -1)
        # the ends of a closed side are one point: what is between them tells the side
        off[side] = away.max(axis=1)
        low, high = curve.knots[0], curve.knots[-1]
        share[side] = ((t - low) / (high - low)).reshape(count, -1)
    side = off.argmin(axis=0)
    if off.min(axis=0).max() > reach or len(np.unique(side)) < 4:
        return None
    share = share[side, np.arange(count)]
    inner = np.diff(share[:, 1:-1], axis=1)
    rising = inner.sum(axis=1) > 0.0
    if np.any(inner * np.where(rising, 1.0, -1.0)[:, None] <= 0.0):
        return None
    ends = np.where(rising[:, None], share[:, [0, -1]], share[:, [-1, 0]])
    # where a side closes, its last point may have been found at its beginning
    middle = share[:, _SAMPLES // 2]
    ends[:, 0] = np.where(ends[:, 0] > middle, 0.0, ends[:, 0])
    ends[:, 1] = np.where(ends[:, 1] < middle, 1.0, ends[:, 1])
    for k in range(4):
        own = np.flatnonzero(side == k)
        own = own[np.argsort(ends[own, 0])]
        gaps = np.append(ends[own, 0], 1.0) - np.insert(ends[own, 1], 0, 0.0)
        # edges that miss their face do not end exactly where the parameter says either
        slack = max(SHARE, 4.0 * reach / _length(whole[k]))
        if np.abs(gaps).max() > slack:
            return None
        ends[own[1:], 0] = ends[own[:-1], 1]
        ends[own[0], 0], ends[own[-1], 1] = 0.0, 1.0
    curves = []
    for k in range(count):
        curve = whole[side[k]]
        low, high = curve.knots[0], curve.knots[-1]
        at = low + ends[k] * (high - low)
        curves.append(curve if tuple(ends[k]) == (0.0, 1.0) else curve.cut(*at.tolist()))
    return side, ends, curves


def _length(curve: SplineCurve) -> float:
    return float(np.linalg.norm(np.diff(curve.control_points, axis=0), axis=1).sum())


def _around(
    edges: np.ndarray, side: np.ndarray, ends: np.ndarray, curves: list[SplineCurve]
) -> IsoSides | None:
    """Edges in the order of the loop, cut where the side changes."""
    change = np.flatnonzero(side != np.roll(side, 1))
    if len(change) != 4:
        return None
    turned = np.roll(np.arange(len(edges)), -change[0])
    parts = np.split(turned, change[1:] - change[0])
    run = [int(side[part[0]]) // 2 for part in parts]
    if run[0] == run[1] or run[0] != run[2] or run[1] != run[3]:
        return None
    return IsoSides(tuple(edges[part] for part in parts), edges, side, ends, tuple(curves))


def order_rows(
    faces: Mapping[int, IsoSides], edge_count: int
) -> tuple[sparse.csr_matrix, np.ndarray, np.ndarray]:
    """Linear constraints on the intervals: vertices of opposite sides in the order of parameters.

    The line that begins at a vertex in a side ends at the vertex opposite, where there is one at
    the same parameter, or between two.

    Returns
    -------
    matrix : (m, ne) sparse
    low, high : (m,) arrays
    """
    rows, low, high = [], [], []
    for around in faces.values():
        for first in (0, 2):
            (one, at), (other, there) = (around.along(first + k) for k in (0, 1))
            for i, x in enumerate(at[1:-1].tolist()):
                for j, y in enumerate(there[1:-1].tolist()):
                    rows.append((one[: i + 1], other[: j + 1]))
                    same = abs(x - y) <= SHARE
                    low.append(0.0 if same else 1.0 if x > y else -np.inf)
                    high.append(0.0 if same else -1.0 if x < y else np.inf)
    matrix = sparse.lil_matrix((len(rows), edge_count))
    for k, (one, other) in enumerate(rows):
        for edges, sign in ((one, 1.0), (other, -1.0)):
            for edge in edges.tolist():
                matrix[k, edge] += sign
    return matrix.tocsr(), np.array(low), np.array(high)


def agreeing(
    faces: Mapping[int, IsoSides],
    outline: Outline,
    curves: Sequence[SplineCurve | None],
    rank: np.ndarray,
) -> tuple[dict[int, IsoSides], list[SplineCurve | None]]:
    """Faces that agree with those before them on the edges and vertices that they share.

    OCC's conversions of an edge and of the face beside it agree as sets of points, not always as
    functions. The surface's own side is taken; where two such faces beside an edge disagree, the
    second one is followed within the tolerance only.

    Parameters
    ----------
    faces : mapping
    outline : Outline
    curves : sequence of SplineCurve
        Of its edges.
    rank : (nf,) array
        Faces with a lower one come first.

    Returns
    -------
    faces : dict
        Their ``ends`` fall where the curve of the edge runs against the surface's parameter.
    curves : list of SplineCurve
        All end in the same points where they meet.
    """
    diagonal = float(np.linalg.norm(np.ptp(outline.vertices, axis=0)))
    found, taken = list(curves), np.zeros(len(curves), dtype=bool)
    place = outline.vertices.copy()
    known = np.zeros(len(place), dtype=bool)
    agreed = {}
    for face in sorted(faces, key=lambda face: (rank[face], face)):
        around = faces[face]
        ends = around.ends.copy()
        corners = []
        for k, (edge, curve) in enumerate(zip(around.edge.tolist(), around.curve, strict=True)):
            if taken[edge]:
                turned = _alike(found[edge], curve, SAME * diagonal)
                if turned is None:
                    break
                if turned:
                    ends[k] = ends[k, ::-1]
            corners += zip(_vertices(outline, edge, curve), _ends(curve), strict=True)
        else:
            if any(
                known[vertex] and np.linalg.norm(place[vertex] - point) > SAME * diagonal
                for vertex, point in corners
            ):
                continue
            agreed[face] = replace(around, ends=ends)
            for vertex, point in corners:
                if not known[vertex]:
                    place[vertex], known[vertex] = point, True
            for edge, curve in zip(around.edge.tolist(), around.curve, strict=True):
                if not taken[edge]:
                    found[edge] = replace(curve, tolerance=curves[edge].tolerance)
                    taken[edge] = True
    for edge in np.unique(outline.edge).tolist():
        if not taken[edge]:
            found[edge] = _drawn(found[edge], place[_vertices(outline, edge, found[edge])])
    return agreed, found


def _ends(curve: SplineCurve) -> np.ndarray:
    return curve.control_points[[0, -1]]


def _vertices(outline: Outline, edge: int, curve: SplineCurve) -> np.ndarray:
    """Vertices of an edge at the beginning and the end of a curve."""
    own = outline.edges[edge]
    ends = _ends(curve)
    straight, turned = (
        np.linalg.norm(outline.vertices[pair] - ends, axis=1).sum() for pair in (own, own[::-1])
    )
    return own if straight <= turned else own[::-1]


def _drawn(curve: SplineCurve, points: np.ndarray) -> SplineCurve:
    """A curve drawn to other ends, which are near its own."""
    off = points - _ends(curve)
    if not off.any():
        return curve
    share = bspline.greville(curve.degree, curve.knots)
    share = ((share - curve.knots[0]) / (curve.knots[-1] - curve.knots[0]))[:, None]
    moved = curve.control_points + (1.0 - share) * off[0] + share * off[1]
    moved[[0, -1]] = points
    return replace(curve, control_points=moved)


def _alike(one: SplineCurve, other: SplineCurve, reach: float) -> bool | None:
    """Whether two curves are the same function of their parameters: False as they are, True with
    one turned round, None if neither."""
    share = np.linspace(0.0, 1.0, 17)
    x, y = (
        curve.evaluate(curve.knots[0] + share * (curve.knots[-1] - curve.knots[0]))
        for curve in (one, other)
    )
    if np.abs(x - y).max() <= reach:
        return False
    return True if np.abs(x - y[::-1]).max() <= reach else None
