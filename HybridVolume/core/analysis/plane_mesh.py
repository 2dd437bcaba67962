# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Triangles in a closed polygon, all of whose edges they keep.

Points of a hexagonal lattice, as far apart as the edges around are long, then rounds of a Delaunay
triangulation, of smoothing, and of putting in or taking out points where the sizes are not met.
"""

from __future__ import annotations

import logging

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from ...errors import InputError, MesherError

log = logging.getLogger(__name__)

GRADING = 0.3
"""How much longer edges may be a mm away from the boundary."""
ROUNDS = 24
"""Rounds of smoothing; points are put in or taken out in the first half of them."""
_LATTICE = 400_000
"""Points of a lattice at most; a polygon with finer edges than that starts with none inside."""
_NEXT = 1.3
"""Ratio of the sizes of two lattices."""
_SHORT, _LARGE = 0.6, 1.6
"""Shares of the wanted length beyond which a point is taken out or put in."""
_FLAT = 0.1
"""Area of a triangle, as a share of its longest side squared, that is too flat to be made."""
_PAIRS = 4_000_000
"""Pairs of points and edges that are looked at together, which bounds the memory."""


def fill_polygon(polygon: np.ndarray, size: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Triangles in a polygon.

    Parameters
    ----------
    polygon : (n, 2) array
        Corners, mm, counterclockwise; its edges become edges of triangles.
    size : float, optional
        Longest edge inside, mm; the longest edge of the polygon by default. Near shorter edges of
        the polygon triangles are smaller in any case.

    Returns
    -------
    vertices : (m, 2) array
        The polygon's corners first.
    triangles : (t, 3) int array
        Counterclockwise; none has two edges on the polygon.

    Raises
    ------
    InputError
        The polygon runs clockwise or crosses itself, or its edges are too long where it is narrow.
    MesherError
        The triangles do not fill it.
    """
    polygon = np.asarray(polygon, dtype=float)
    n = len(polygon)
    area = polygon_area(polygon)
    if n < 3 or not area > 0.0:
        raise InputError(
            f"{n} corners enclose {area:.3g} mm²",
            figure=area,
            remedy="give three or more, counterclockwise",
        )
    if size is not None and not size > 0.0:
        raise InputError(f"triangles of the size {size:g} mm", remedy="give a size > 0")
    sizes = _Sizes(polygon, size)
    inner = _clear(_lattice(polygon, sizes), polygon)
    for number in range(ROUNDS):
        points = np.concatenate([polygon, inner])
        triangles = _inside(points, polygon)
        if number < ROUNDS // 2 and number % 2 == 0:
            inner = _clear(_sized(points, triangles, n, sizes), polygon)
        else:
            inner = _clear(_smoothed(points, triangles, n, sizes), polygon)
    points = np.concatenate([polygon, inner])
    triangles = _inside(points, polygon)
    _check(points, triangles, n, area)
    return _without_ears(points, triangles, n)


def polygon_area(polygon: np.ndarray) -> float:
    """Area of a polygon, mm²; negative where it runs clockwise."""
    x, y = (polygon - polygon.mean(axis=0)).T
    return float(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def crossing_edges(polygon: np.ndarray) -> np.ndarray:
    """Edges of a closed polygon that cross others, (k,)."""
    n = len(polygon)
    start, end = polygon, np.roll(polygon, -1, axis=0)
    along = end - start
    # on one line, but for roundings
    nothing = 1e-13 * float(np.ptp(polygon, axis=0).max()) ** 2

    def side(edge: np.ndarray, points: np.ndarray) -> np.ndarray:
        """1, 0 or -1: left of the lines of edges, on them, right of them."""
        way = points - start[edge]
        turned = along[edge, 0] * way[..., 1] - along[edge, 1] * way[..., 0]
        return np.where(np.abs(turned) <= nothing, 0.0, np.sign(turned))

    found = np.zeros(n, dtype=bool)
    for rows in np.array_split(np.arange(n), 1 + n * n // _PAIRS):
        one = rows[:, None]
        apart = side(one, start[None]) * side(one, end[None]) < 0.0
        place, other = np.nonzero(apart)
        one = rows[place]
        both = side(other, start[one]) * side(other, end[one]) < 0.0
        found[one[both]] = True
    return np.flatnonzero(found)


def triangle_areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Areas with sign, (t,), mm²."""
    a, b, c = points[triangles].swapaxes(0, 1)
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


class _Sizes:
    """Wanted edge length at a place: that of the nearest edges, growing away from them."""

    def __init__(self, polygon: np.ndarray, size: float | None) -> None:
        ends = np.roll(polygon, -1, axis=0)
        self.length = np.linalg.norm(ends - polygon, axis=1)
        self.tree = cKDTree(0.5 * (polygon + ends))
        self.largest = float(self.length.max()) if size is None else size
        self.smallest = min(float(self.length.min()), self.largest)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        count = min(8, len(self.length))
        distance, place = self.tree.query(points, k=count)
        near = self.length[place] + GRADING * np.maximum(distance - 0.5 * self.length[place], 0.0)
        return np.minimum(near.reshape(len(points), -1).min(axis=1), self.largest)


def _lattice(polygon: np.ndarray, sizes: _Sizes) -> np.ndarray:
    """Points inside as far apart as is wanted: a lattice for each size between two powers."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    found = []
    step = sizes.smallest
    while True:
        rows = np.arange(low[1], high[1], np.sqrt(0.75) * step)
        columns = np.arange(low[0], high[0] + step, step)
        if len(rows) * len(columns) <= _LATTICE:
            x, y = np.meshgrid(columns, rows)
            x = x - 0.5 * step * (np.arange(len(rows)) % 2)[:, None]
            points = np.column_stack([x.ravel(), y.ravel()])
            wanted = sizes(points)
            last = step * _NEXT >= sizes.largest
            points = points[(wanted >= step) & ((wanted < _NEXT * step) | last)]
            found.append(points[_contains(polygon, points)])
        if step * _NEXT >= sizes.largest:
            return np.concatenate(found) if found else np.zeros((0, 2))
        step *= _NEXT


def _contains(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether points are inside, by crossings of rays along x."""
    start, end = polygon, np.roll(polygon, -1, axis=0)
    order = np.argsort(points[:, 1], kind="stable")
    y = points[order, 1]
    low, high = np.sort(np.column_stack([start[:, 1], end[:, 1]]), axis=1).T
    # points whose ray meets an edge are a row of those in order
    first, behind = np.searchsorted(y, low), np.searchsorted(y, high)
    crossed = np.zeros(len(points), dtype=np.int64)
    counts = behind - first
    for edges in np.array_split(np.arange(len(polygon)), 1 + counts.sum() // _PAIRS):
        edge = np.repeat(edges, counts[edges])
        skipped = np.repeat(np.cumsum(counts[edges]) - counts[edges], counts[edges])
        place = first[edge] + np.arange(len(edge)) - skipped
        share = (y[place] - start[edge, 1]) / (end[edge, 1] - start[edge, 1])
        crossing = start[edge, 0] + share * (end[edge, 0] - start[edge, 0])
        left = points[order[place], 0] < crossing
        crossed += np.bincount(place[left], minlength=len(points))
    found = np.empty(len(points), dtype=bool)
    found[order] = crossed % 2 == 1
    return found


def _clear(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Points that are inside, and not so near an edge that Delaunay's triangles would cut it."""
    if not len(points):
        return points
    middle = 0.5 * (polygon + np.roll(polygon, -1, axis=0))
    radius = 0.5 * np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1)
    near = cKDTree(points).query_ball_point(middle, 1.1 * radius)
    keep = np.ones(len(points), dtype=bool)
    keep[[k for group in near for k in group]] = False
    points = points[keep]
    return points[_contains(polygon, points)]


def _inside(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Delaunay's triangles within the polygon, counterclockwise."""
    # coordinates about the origin, as large as 1: qhull's tolerances are absolute in parts
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    scaled = (points - 0.5 * (low + high)) / (high - low).max()
    triangles = Delaunay(scaled).simplices
    areas = triangle_areas(scaled, triangles)
    triangles = np.where((areas < 0.0)[:, None], triangles[:, ::-1], triangles)
    triangles = triangles[np.abs(areas) > 1e-14]
    return triangles[_contains(polygon, points[triangles].mean(axis=1))]


def _sized(points: np.ndarray, triangles: np.ndarray, n: int, sizes: _Sizes) -> np.ndarray:
    """Inner points with further ones in triangles that are too large, and without some too near."""
    pairs = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0)
    length = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    near = (length < _SHORT * sizes(points[pairs].mean(axis=1))) & (pairs[:, 1] >= n)
    # of edges that are too short and touch each other only the shortest loses an end
    least = np.full(len(points), np.inf)
    np.minimum.at(least, pairs[near].ravel(), np.repeat(length[near], 2))
    first = length[near] <= least[pairs[near]].min(axis=1)
    keep = np.ones(len(points), dtype=bool)
    keep[pairs[near][first, 1]] = False
    inner = points[n:][keep[n:]]
    x = points[triangles]
    side = np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2)
    area = np.abs(triangle_areas(points, triangles))
    radius = side.prod(axis=1) / np.maximum(4.0 * area, 1e-300)
    centre = x.mean(axis=1)
    large = np.sqrt(3.0) * radius / sizes(centre)
    order = np.argsort(-large, kind="stable")
    new = centre[order[large[order] > _LARGE]]
    if not len(new):
        return inner
    # a new point gives way to any that is near it and in a larger triangle
    wanted = sizes(new)
    pairs = np.sort(cKDTree(new).query_pairs(_SHORT * wanted.max(), output_type="ndarray"), axis=1)
    apart = np.linalg.norm(new[pairs[:, 0]] - new[pairs[:, 1]], axis=1)
    taken = np.ones(len(new), dtype=bool)
    taken[pairs[apart < wanted[pairs[:, 1]], 1]] = False
    return np.concatenate([inner, new[taken]])


def _smoothed(points: np.ndarray, triangles: np.ndarray, n: int, sizes: _Sizes) -> np.ndarray:
    """Inner points in the middle of their triangles, each of which counts as its wanted number."""
    centre = points[triangles].mean(axis=1)
    weight = np.abs(triangle_areas(points, triangles)) / sizes(centre) ** 2
    corners = triangles.ravel()
    total = np.bincount(corners, np.repeat(weight, 3), len(points))[n:]
    moved = np.column_stack(
        [np.bincount(corners, np.repeat(weight * x, 3), len(points))[n:] for x in centre.T]
    )
    used = total > 0.0
    return moved[used] / total[used, None]


def _check(points: np.ndarray, triangles: np.ndarray, n: int, area: float) -> None:
    """Refuse triangles that do not fill the polygon or miss one of its edges."""
    ends = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    ring = np.sort(np.column_stack([np.arange(n), (np.arange(n) + 1) % n]), axis=1)
    missed = np.setdiff1d(ring @ [len(points), 1], ends @ [len(points), 1])
    if len(missed):
        x, y = points[missed // len(points)][0]
        raise InputError(
            f"{len(missed)} edges of the polygon are longer than it is wide there, the first at "
            f"({x:.4g}, {y:.4g}) mm",
            figure=float(len(missed)),
            remedy="cut the boundary finer, or make the ring thinner",
        )
    filled = float(triangle_areas(points, triangles).sum())
    if not abs(filled - area) <= 1e-9 * area:
        raise MesherError(
            f"triangles fill {filled:.6g} of {area:.6g} mm²",
            figure=filled,
            remedy="the boundary must not cross itself",
        )


def _without_ears(
    points: np.ndarray, triangles: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles so that none has two edges on the polygon: curved ones would be flat there.

    The edge across from the corner is turned where that leaves no flat triangle, else a point is
    put into the triangle.
    """
    while True:
        tips = _ears(triangles, n)
        if not len(tips):
            return points, triangles
        # a corner b between edges of the polygon, its neighbours c and a, and d across from it
        row, place = tips[0]
        b, c, a = np.roll(triangles[row], -place)
        across = (triangles == a).any(axis=1) & (triangles == c).any(axis=1)
        across[row] = False
        (other,) = np.flatnonzero(across)[:1] if across.any() else (-1,)
        if other >= 0:
            (d,) = np.setdiff1d(triangles[other], [a, c])
            fresh = np.array([[a, b, d], [b, c, d]])
            x = points[fresh]
            side = np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2)
            flat = triangle_areas(points, fresh) < _FLAT * side.max(axis=1) ** 2
            if d >= n and not flat.any():
                triangles = np.concatenate([np.delete(triangles, [row, other], axis=0), fresh])
                continue
        new = len(points)
        cut = np.array([[a, b, new], [b, c, new], [c, a, new]])
        points = np.concatenate([points, points[[a, b, c]].mean(axis=0)[None]])
        triangles = np.concatenate([np.delete(triangles, row, axis=0), cut])


def _ears(triangles: np.ndarray, n: int) -> np.ndarray:
    """Triangles with two edges on the polygon, and the places of the corner between: (k, 2)."""
    ends = np.roll(triangles, -1, axis=1)
    apart = (ends - triangles) % n
    outside = (np.maximum(triangles, ends) < n) & ((apart == 1) | (apart == n - 1))
    # side k goes from corner k: two sides on the polygon meet where both are
    return np.argwhere(outside & np.roll(outside, 1, axis=1))
