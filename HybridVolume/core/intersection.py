# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Where triangulated surfaces cut themselves or each other, and which points they enclose.

Answers are exact for the coordinates given (floats taken as exact numbers): pairs of triangles
whose boxes meet are first told apart by certain signs of determinants (looking along the sum of
both normals, which also separates neighbours in a plane), those that remain by exact predicates.

Triangles are closed sets. Two triangles cross when they have a point in common that is not in the
corner or side they share by vertex number; touching without a shared vertex is crossing, for a tet
mesh cannot keep such a surface either.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import FaultError
from .boxtree import BoxTree
from .predicates import cross_product, dot_sign, orientation_2d, orientation_3d

_CHUNK = 200_000

_ANEW = 0.4
"""Share of changed triangles from which all are compared again."""


@dataclass(frozen=True)
class _Triangles:
    """Triangles that have an area, with what the tests need.

    ``number`` (m,) in the caller's mesh, ``corners`` (m, 3) vertex numbers, ``points`` (n, 3) of
    moderate size, ``normal`` (m, 3) unit vectors, ``plane`` (m, 2) coordinates in which
    the triangle surely has an area, ``flat`` numbers of the triangles without area.
    """

    number: np.ndarray
    corners: np.ndarray
    points: np.ndarray
    normal: np.ndarray
    plane: np.ndarray
    flat: np.ndarray

    @cached_property
    def corner_lines(self) -> np.ndarray:
        """Corners as (3, m), contiguous."""
        return np.ascontiguousarray(self.corners.T)

    def tree(self) -> BoxTree:
        return _tree(*(self.points[self.corners[:, k]] for k in range(3)))


def _tree(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> BoxTree:
    return BoxTree(np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c))


_PLANES = np.array([[1, 2], [2, 0], [0, 1]])
# Order of the corners that puts those first whose bit is set in the row's number.
_ORDER = np.array([sorted(range(3), key=lambda k: not code >> k & 1) for code in range(8)])


def _checked(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.asarray(vertices, dtype=float).reshape(-1, 3)
    triangles = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    if not np.isfinite(vertices).all():
        raise FaultError("a vertex of a triangulated surface is not finite")
    if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(vertices):
        raise FaultError("a triangle of a surface refers to a vertex that does not exist")
    return vertices, triangles


def _scaled(*points: np.ndarray) -> list[np.ndarray]:
    """All points, times one power of two where they are so large or small that products may fail.

    Exact, but for coordinates below 1e-290 of the largest when that is above 1e9.
    """
    largest = max((np.abs(a).max() for a in points if a.size), default=0.0)
    if largest == 0.0 or 1e-9 < largest < 1e9:
        return list(points)
    return [np.ldexp(a, -int(np.frexp(largest)[1])) for a in points]


def _prepare(points: np.ndarray, triangles: np.ndarray) -> _Triangles:
    a, b, c = (np.ascontiguousarray(points[triangles[:, k]].T) for k in range(3))
    normal, magnitude = cross_product(b - a, c - a)
    # Each entry is a determinant of its own; entries that are not surely nonzero do not count.
    certain = np.abs(normal) > 1e-14 * magnitude + 1e-280
    plane = np.where(certain, np.abs(normal), -1.0).argmax(axis=0)
    usable = certain.any(axis=0)
    doubtful = np.flatnonzero(~usable)
    for k in range(3) if len(doubtful) else ():
        x = points[triangles[doubtful]][:, :, _PLANES[k]]
        found = doubtful[orientation_2d(x[:, 0], x[:, 1], x[:, 2]) != 0]
        plane[found], usable[found] = k, True
    length = np.sqrt((normal * normal).sum(axis=0))
    unit = (normal / np.where(length > 0.0, length, 1.0)).T
    keep = np.flatnonzero(usable)
    return _Triangles(
        keep,
        triangles[keep],
        points,
        np.ascontiguousarray(unit[keep]),
        _PLANES[plane[keep]],
        np.flatnonzero(~usable),
    )


def self_intersections(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Pairs of triangles of one surface that cross or touch beyond the corner or side they share.

    Parameters
    ----------
    vertices : (n, 3) array
        mm. Vertices are the same only when their numbers are.
    triangles : (m, 3) int array

    Returns
    -------
    (k, 2) int array
        Rows i < j, sorted. A triangle without area (also one that names a vertex twice) gives the
        row (i, i) and takes no further part; a surface without any row is embedded.

    Raises
    ------
    FaultError
        When a coordinate is not finite or a triangle refers to a vertex that does not exist.
    """
    vertices, triangles = _checked(vertices, triangles)
    surface = _prepare(_scaled(vertices)[0], triangles)
    return _sorted_rows(_self_pairs(surface, surface.tree()))


def _self_pairs(surface: _Triangles, tree: BoxTree) -> np.ndarray:
    """Pairs i < j that cross, and (i, i) for triangles without area, in any order."""
    hits = [np.stack([surface.flat, surface.flat], axis=1)]
    for part in _parts(tree.self_pairs()):
        crossing = _cross(surface, surface, part, shared_vertices=True)
        hits.append(surface.number[part[crossing]])
    return np.concatenate(hits)


class CrossingPairs:
    """What `self_intersections` finds, for one triangulation in states that differ in places.

    Triangles that stand as they did are not compared with each other again. The answers are the
    same.
    """

    def __init__(self) -> None:
        self._known: tuple[_Triangles, BoxTree, np.ndarray, np.ndarray] | None = None

    def find(self, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """Pairs for the next state, as of :func:`self_intersections`.

        Parameters
        ----------
        vertices : (n, 3) array
            mm.
        triangles : (m, 3) int array
            As many as before; a corner may be another vertex.
        """
        vertices, triangles = _checked(vertices, triangles)
        (points,) = _scaled(vertices)
        changed = self._changed(points, triangles)
        if changed is None or np.count_nonzero(changed) > _ANEW * len(triangles):
            surface = _prepare(points, triangles)
            tree = surface.tree()
            found = _sorted_rows(_self_pairs(surface, tree))
            self._known = surface, tree, triangles, found
            return found
        before, tree, _, found = self._known
        number = np.flatnonzero(changed)
        moved = _prepare(points, triangles[number])
        own = moved.tree()
        hits = [found[~changed[found].any(axis=1)], number[_self_pairs(moved, own)]]
        pairs = own.pairs(tree)
        for part in _parts(pairs[~changed[before.number[pairs[:, 1]]]]):
            crossing = part[_cross(moved, before, part, shared_vertices=True)]
            both = [number[moved.number[crossing[:, 0]]], before.number[crossing[:, 1]]]
            hits.append(np.sort(np.stack(both, axis=1), axis=1))
        return _sorted_rows(np.concatenate(hits))

    def _changed(self, points: np.ndarray, triangles: np.ndarray) -> np.ndarray | None:
        """Triangles that are not as they were, (m,) bool; None where nothing is known."""
        if self._known is None:
            return None
        before, _, known, _ = self._known
        if before.points.shape != points.shape or known.shape != triangles.shape:
            return None
        moved = (before.points != points).any(axis=1)
        return moved[triangles].any(axis=1) | (known != triangles).any(axis=1)


def surfaces_intersect(
    vertices1: np.ndarray, triangles1: np.ndarray, vertices2: np.ndarray, triangles2: np.ndarray
) -> np.ndarray:
    """Pairs of triangles of two surfaces that cross or touch.

    Parameters
    ----------
    vertices1, vertices2 : (n, 3) arrays
        mm. The vertex numbers of the two surfaces have nothing to do with each other.
    triangles1, triangles2 : (m, 3) int arrays

    Returns
    -------
    (k, 2) int array
        Rows (triangle of the first, triangle of the second), sorted. Triangles without area are
        left out: :func:`self_intersections` reports them.

    Raises
    ------
    FaultError
        As :func:`self_intersections`.
    """
    vertices1, triangles1 = _checked(vertices1, triangles1)
    vertices2, triangles2 = _checked(vertices2, triangles2)
    points1, points2 = _scaled(vertices1, vertices2)
    first, second = _prepare(points1, triangles1), _prepare(points2, triangles2)
    hits = [np.zeros((0, 2), dtype=np.int64)]
    for part in _parts(first.tree().pairs(second.tree())):
        found = part[_cross(first, second, part, shared_vertices=False)]
        hits.append(np.stack([first.number[found[:, 0]], second.number[found[:, 1]]], axis=1))
    return _sorted_rows(np.concatenate(hits))


def _parts(pairs: np.ndarray) -> list[np.ndarray]:
    return np.array_split(pairs, -(-len(pairs) // _CHUNK)) if len(pairs) else []


def _sorted_rows(pairs: np.ndarray) -> np.ndarray:
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _cross(
    first: _Triangles, second: _Triangles, pairs: np.ndarray, *, shared_vertices: bool
) -> np.ndarray:
    """Which pairs (k, 2) cross, (k,) bool."""
    i, j = np.ascontiguousarray(pairs.T)
    # (3, k): a corner of all pairs lies in one piece of memory
    one, two = first.corner_lines[:, i], second.corner_lines[:, j]
    crossing = np.zeros(len(pairs), dtype=bool)
    count = np.zeros(len(pairs), dtype=np.int64)
    if shared_vertices:
        equal = [[a == b for b in two] for a in one]
        own = [row[0] | row[1] | row[2] for row in equal]
        other = [equal[0][j] | equal[1][j] | equal[2][j] for j in range(3)]
        count = own[0].astype(np.int64) + own[1] + own[2]
        one, two = _shared_first(one, own), _shared_first(two, other)
    crossing[count == 3] = True
    for shared, test in ((2, _cross_at_side), (1, _cross_at_corner), (0, _cross_apart)):
        rows = np.flatnonzero(count == shared)
        if len(rows):
            crossing[rows] = test(
                first.points[one[:, rows].T],
                second.points[two[:, rows].T],
                first.normal[i[rows]] + second.normal[j[rows]],
                first.plane[i[rows]],
                second.plane[j[rows]],
            )
    return crossing


def _shared_first(corners: np.ndarray, shared: list[np.ndarray]) -> np.ndarray:
    """Corners (3, k) with the shared ones in front; the cyclic order may be lost."""
    code = shared[0] + 2 * shared[1].astype(np.int64) + 4 * shared[2].astype(np.int64)
    place = _ORDER.T[:, code]
    return np.stack([np.choose(row, corners) for row in place])


def _columns(points: np.ndarray) -> np.ndarray:
    """(m, 3, 3) corners of triangles -> (corner, coordinate, m), contiguous."""
    return np.ascontiguousarray(np.moveaxis(points, 0, -1))


def _cross_at_side(one, two, along, plane, _plane2) -> np.ndarray:
    """Triangles (m, 3, 3) with a common side (corners 0 and 1): do they overlap in one plane?"""
    a, b, direction = _columns(one), two[:, 2].T - one[:, 0].T, along.T.copy()
    seen = cross_product(direction, a[1] - a[0])
    apart = dot_sign(seen, a[2] - a[0]) * dot_sign(seen, b) < 0
    rows = np.flatnonzero(~apart)
    crossing = np.zeros(len(one), dtype=bool)
    if len(rows):
        s, t, apex, other = one[rows, 0], one[rows, 1], one[rows, 2], two[rows, 2]
        flat = orientation_3d(s, t, apex, other) == 0
        rows, s, t, apex, other = (x[flat] for x in (rows, s, t, apex, other))
        s, t, apex, other = (_project(x, plane[rows]) for x in (s, t, apex, other))
        crossing[rows] = orientation_2d(s, t, apex) == orientation_2d(s, t, other)
    return crossing


def _cross_at_corner(one, two, along, plane1, plane2) -> np.ndarray:
    """Triangles (m, 3, 3) with the common corner 0: have they another point in common?

    They are convex, so then a segment from the corner is common, and it leaves one triangle
    through the side opposite to the corner: that side meets the other triangle.
    """
    a, d = _columns(one), _columns(two)
    b, c, e, f = a[1] - a[0], a[2] - a[0], d[1] - d[0], d[2] - d[0]
    direction = along.T.copy()
    # Seen along one direction: no side at the corner lies in the other triangle's angle.
    by_e, by_f = cross_product(e, direction), cross_product(f, direction)
    turn1 = dot_sign(cross_product(c, direction), b)
    turn2 = dot_sign(by_f, e)
    be, bf, ce, cf = dot_sign(by_e, b), dot_sign(by_f, b), dot_sign(by_e, c), dot_sign(by_f, c)
    apart = (turn1 != 0) & (turn2 != 0)
    apart &= (turn1 * be < 0) | (turn1 * ce > 0)
    apart &= (turn1 * bf < 0) | (turn1 * cf > 0)
    apart &= (turn2 * be > 0) | (turn2 * bf < 0)
    rows = np.flatnonzero(~apart)
    # Both other corners strictly on one side of the other triangle's plane.
    for left, right, near, far in ((b, c, e, f), (e, f, b, c)):
        if len(rows):
            normal = cross_product(left[:, rows], right[:, rows])
            sides = dot_sign(normal, near[:, rows]) * dot_sign(normal, far[:, rows])
            rows = rows[sides <= 0]
    crossing = np.zeros(len(one), dtype=bool)
    if len(rows):
        crossing[rows] = _sides_meet(
            [(one[rows, 1], one[rows, 2], two[rows], plane2[rows])]
            + [(two[rows, 1], two[rows, 2], one[rows], plane1[rows])]
        )
    return crossing


def _cross_apart(one, two, along, plane1, plane2) -> np.ndarray:
    """Triangles (m, 3, 3) without a common corner: have they a point in common?"""
    rows = np.arange(len(one))
    for x, y in ((one, two), (two, one)):
        a, d = _columns(x[rows]), _columns(y[rows])
        normal = cross_product(a[1] - a[0], a[2] - a[0])
        sides = [dot_sign(normal, d[k] - a[0]) for k in range(3)]
        rows = rows[(sides[0] == 0) | (sides[0] != sides[1]) | (sides[0] != sides[2])]
    # Seen along one direction: a side with the other triangle strictly beyond it.
    for x, y in ((one, two), (two, one)):
        a, d = _columns(x[rows]), _columns(y[rows])
        direction = along[rows].T.copy()
        apart = np.zeros(len(rows), dtype=bool)
        for k in range(3):
            start, end, third = a[k], a[(k + 1) % 3], a[(k + 2) % 3]
            seen = cross_product(direction, end - start)
            side = dot_sign(seen, third - start)
            beyond = side != 0
            for j in range(3):
                beyond &= dot_sign(seen, d[j] - start) == -side
            apart |= beyond
        rows = rows[~apart]
    crossing = np.zeros(len(one), dtype=bool)
    if len(rows):
        sides = [
            (x[rows, k], x[rows, (k + 1) % 3], y[rows], plane[rows])
            for x, y, plane in ((one, two, plane2), (two, one, plane1))
            for k in range(3)
        ]
        crossing[rows] = _sides_meet(sides)
    return crossing


def _sides_meet(tests: list[tuple]) -> np.ndarray:
    """Whether any of the segments of each pair meets its triangle; tests hold m pairs each."""
    p, q, triangle, plane = (np.concatenate(x) for x in zip(*tests, strict=True))
    return _segments_meet(p, q, triangle, plane).reshape(len(tests), -1).any(axis=0)


def _project(points: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """Two of the three coordinates of points (m, 3), columns plane (m, 2)."""
    return np.take_along_axis(points, plane, axis=1)


def _segments_meet(
    p: np.ndarray, q: np.ndarray, triangle: np.ndarray, plane: np.ndarray
) -> np.ndarray:
    """Exactly: does the closed segment p q meet the closed triangle?

    Parameters
    ----------
    p, q : (m, 3) arrays
        Ends, p != q.
    triangle : (m, 3, 3) array
        Corners, with an area also in the coordinates ``plane`` (m, 2).

    Returns
    -------
    (m,) bool array
    """
    a, b, c = triangle[:, 0], triangle[:, 1], triangle[:, 2]
    start, end = orientation_3d(a, b, c, p), orientation_3d(a, b, c, q)
    meet = np.zeros(len(p), dtype=bool)
    rows = np.flatnonzero((start * end <= 0) & ((start != 0) | (end != 0)))
    if len(rows):
        turns = [
            orientation_3d(p[rows], q[rows], x[rows], y[rows]) for x, y in ((a, b), (b, c), (c, a))
        ]
        meet[rows] = (np.min(turns, axis=0) >= 0) | (np.max(turns, axis=0) <= 0)
    rows = np.flatnonzero((start == 0) & (end == 0))
    if len(rows):
        a, b, c, p, q = (_project(x[rows], plane[rows]) for x in (a, b, c, p, q))
        inside = orientation_2d(a, b, c)
        line = [orientation_2d(p, q, x) for x in (a, b, c)]
        apart = (line[0] != 0) & (line[0] == line[1]) & (line[0] == line[2])
        for x, y in ((a, b), (b, c), (c, a)):
            apart |= (orientation_2d(x, y, p) == -inside) & (orientation_2d(x, y, q) == -inside)
        meet[rows] = ~apart
    return meet


def winding_numbers(vertices: np.ndarray, triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How often a closed oriented surface winds around points: exact, by a ray in direction z.

    Parameters
    ----------
    vertices : (n, 3) array
        mm.
    triangles : (m, 3) int array
        Closed and oriented outward.
    points : (k, 3) array

    Returns
    -------
    (k,) int array
        1 inside an embedded surface, 0 outside. On the surface it is that of either side.

    Raises
    ------
    FaultError
        As :func:`self_intersections`, or when a point is not finite.
    """
    vertices, triangles = _checked(vertices, triangles)
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    if not np.isfinite(points).all():
        raise FaultError("a point to be located is not finite")
    number = np.zeros(len(points), dtype=np.int64)
    if not len(triangles) or not len(points):
        return number
    vertices, points = _scaled(vertices, points)
    corners = vertices[triangles]
    top = points.copy()
    top[:, 2] = np.maximum(points[:, 2], vertices[:, 2].max())
    tree = _tree(*(corners[:, k] for k in range(3)))
    for part in _parts(BoxTree(points, top).pairs(tree)):
        p = points[part[:, 0]]
        a, b, c = (corners[part[:, 1], k] for k in range(3))
        turns = [_turn_beside(x, y, p) for x, y in ((a, b), (b, c), (c, a))]
        rows = np.flatnonzero((turns[0] == turns[1]) & (turns[0] == turns[2]))
        turn = turns[0][rows].astype(np.int64)
        above = orientation_3d(a[rows], b[rows], c[rows], p[rows]) * turn < 0
        np.add.at(number, part[rows[above], 0], turn[above])
    return number


def _turn_beside(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Turn a, b, p seen along z, with p moved by (t, t^2, 0), t > 0 tending to 0: no zeros.

    Sides that share an edge see the point on opposite sides of it, so a ray through an edge or a
    vertex is counted once. (0 remains where a and b coincide seen along z.)
    """
    turn = orientation_2d(a[:, :2], b[:, :2], p[:, :2])
    turn = np.where(turn == 0, np.sign(a[:, 1] - b[:, 1]), turn)
    return np.where(turn == 0, np.sign(b[:, 0] - a[:, 0]), turn).astype(np.int8)


def points_inside(vertices: np.ndarray, triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which points a closed oriented surface encloses (winding number not 0).

    Parameters
    ----------
    vertices, triangles, points
        As :func:`winding_numbers`; shells of cavities point into the cavity.

    Returns
    -------
    (k,) bool array
        Points on the surface may be either.
    """
    return winding_numbers(vertices, triangles, points) != 0
