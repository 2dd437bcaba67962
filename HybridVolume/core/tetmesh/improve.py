# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Better shapes of the worst tetrahedra: edges and faces are swapped, inner vertices move.

Meshers improve the mean; a finite element mesh is judged by its worst element. Every step here is
local and raises the smallest quality of the tetrahedra that it touches, so that nothing gets worse
(Freitag and Ollivier-Gooch 1997; Klingner and Shewchuk 2007). The boundary stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np

from ..element_jacobians import tet_quality
from .mesh import EDGES, FACES, TetMesh, row_keys

GOOD = 0.1
"""Scaled Jacobian from which on a tetrahedron is left alone."""
_ROUNDS = 12
_GAIN = 1.01
"""Factor by which the worst tetrahedron of a step must get better."""
_LARGEST_RING = 7
_STEPS = (0.3, 0.1, 0.03)
"""Ways that vertices are moved, as shares of the mean of their edges."""


def improve(mesh: TetMesh, good: float = GOOD) -> TetMesh:
    """The mesh with better shapes around tetrahedra below a quality.

    Parameters
    ----------
    mesh : TetMesh
    good : float
        Scaled Jacobian from which on tetrahedra are left alone.

    Returns
    -------
    TetMesh
        On the same vertices, of which only those inside have moved; the same boundary triangles.
        Its worst tetrahedron is no worse.
    """
    vertices, tets = mesh.vertices.copy(), mesh.tets
    fixed = mesh.on_boundary
    sides = row_keys(mesh.boundary_edges, len(vertices))
    for _ in range(_ROUNDS):
        quality = tet_quality(vertices[tets])
        poor = quality < good
        if not poor.any():
            break
        # rings and stars of what is poor lie around its vertices
        near = np.zeros(len(vertices), dtype=bool)
        near[tets[poor]] = True
        around = near[tets].any(axis=1)
        part, rest = tets[around], tets[~around]
        part, swapped = _swap(vertices, part, quality[around], good, sides)
        # only vertices whose whole star is at hand may move
        moved = _smooth(vertices, part, good, near & ~fixed)
        tets = np.concatenate([rest, part])
        if not swapped and not moved:
            break
    return TetMesh(vertices, tets, mesh.engine, mesh.exact)


@dataclass(frozen=True, eq=False)
class _Swaps:
    """Swaps that would gain: tetrahedra that go (-1 pads), those that come, and the qualities."""

    old: np.ndarray
    new: np.ndarray
    before: np.ndarray
    after: np.ndarray


def _swap(
    vertices: np.ndarray, tets: np.ndarray, quality: np.ndarray, good: float, sides: np.ndarray
) -> tuple[np.ndarray, int]:
    """Swap edges and faces around poor tetrahedra; the number of swaps comes with the result."""
    swaps = [
        *_edge_swaps(vertices, tets, quality, good, sides),
        _face_swaps(vertices, tets, quality, good),
    ]
    width = max(s.old.shape[1] for s in swaps)
    old = np.concatenate([_padded(s.old, width) for s in swaps])
    before = np.concatenate([s.before for s in swaps])
    after = np.concatenate([s.after for s in swaps])
    if not len(old):
        return tets, 0
    # the worst first, and of its swaps the best; one of several on the same tetrahedra
    rank = np.empty(len(old), dtype=np.int64)
    rank[np.lexsort((-after, before))] = np.arange(len(old))
    first = np.full(len(tets) + 1, len(old))
    np.minimum.at(first, old.ravel(), np.repeat(rank, width))
    first[-1] = len(old)
    chosen = ((first[old] == rank[:, None]) | (old < 0)).all(axis=1)
    keep = np.ones(len(tets) + 1, dtype=bool)
    keep[old[chosen].ravel()] = False
    parts, start = [tets[keep[:-1]]], 0
    for s in swaps:
        new = s.new[chosen[start : start + len(s.old)]]
        parts.append(new.reshape(-1, 4))
        start += len(s.old)
    return np.concatenate(parts), int(np.count_nonzero(chosen))


def _padded(rows: np.ndarray, width: int) -> np.ndarray:
    found = np.full((len(rows), width), -1, dtype=np.int64)
    found[:, : rows.shape[1]] = rows
    return found


@cache
def _triangulations(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of a ring of n vertices (t, 3), and those of each of its triangulations."""
    triangles = list(combinations(range(n), 3))
    number = {t: i for i, t in enumerate(triangles)}

    def fill(low: int, high: int) -> list[list[int]]:
        if high - low < 2:
            return [[]]
        return [
            [number[low, middle, high], *left, *right]
            for middle in range(low + 1, high)
            for left in fill(low, middle)
            for right in fill(middle, high)
        ]

    return np.array(triangles), np.array(fill(0, n - 1))


def _edge_swaps(
    vertices: np.ndarray, tets: np.ndarray, quality: np.ndarray, good: float, sides: np.ndarray
) -> list[_Swaps]:
    """Inner edges of poor tetrahedra that go: their ring is filled by triangles instead."""
    count = len(vertices)
    keys = row_keys(tets[:, EDGES].reshape(-1, 2), count)
    wanted = np.unique(keys.reshape(-1, 6)[quality < good])
    wanted = wanted[~np.isin(wanted, sides)]
    entry = np.flatnonzero(np.isin(keys, wanted))
    entry = entry[np.argsort(keys[entry], kind="stable")]
    _, start, size = np.unique(keys[entry], return_index=True, return_counts=True)
    # the edge first, then the others so that the tetrahedron stays positive
    order = np.array([[0, 1, 2, 3], [0, 2, 3, 1], [0, 3, 1, 2], [1, 2, 0, 3], [1, 3, 2, 0],
                      [2, 3, 0, 1]])  # fmt: skip
    found = []
    for n in range(3, _LARGEST_RING + 1):
        rows = entry[start[size == n][:, None] + np.arange(n)]
        if not len(rows):
            continue
        tet = rows // 6
        corners = np.take_along_axis(tets[tet], order[rows % 6], axis=2)
        # as numbers grow along the edge in one tetrahedron and not in the other, they are sorted
        turned = corners[..., 0] > corners[..., 1]
        corners[turned] = corners[turned][:, [1, 0, 3, 2]]
        ends, left, right = corners[:, 0, :2], corners[..., 2], corners[..., 3]
        ring = np.empty((len(rows), n), dtype=np.int64)
        ring[:, 0] = left[:, 0]
        closed = np.ones(len(rows), dtype=bool)
        for k in range(1, n + 1):
            match = left == ring[:, [k - 1]]
            closed &= match.sum(axis=1) == 1
            step = right[np.arange(len(rows)), match.argmax(axis=1)]
            if k < n:
                ring[:, k] = step
        closed &= step == ring[:, 0]
        closed &= (np.diff(np.sort(ring, axis=1), axis=1) > 0).all(axis=1)
        tet, ends, ring = tet[closed], ends[closed], ring[closed]
        triangles, choices = _triangulations(n)
        flat = ring[:, triangles]
        above = np.concatenate(
            [flat, np.broadcast_to(ends[:, None, 1:], (*flat.shape[:2], 1))], axis=2
        )
        below = np.concatenate(
            [flat[..., ::-1], np.broadcast_to(ends[:, None, :1], (*flat.shape[:2], 1))], axis=2
        )
        worth = np.minimum(tet_quality(vertices[above]), tet_quality(vertices[below]))
        each = worth[:, choices].min(axis=2)
        best = each.argmax(axis=1)
        after = each[np.arange(len(each)), best]
        before = quality[tet].min(axis=1)
        gain = after > np.maximum(_GAIN * before, 0.0)
        pick = choices[best[gain]]
        row = np.flatnonzero(gain)[:, None]
        new = np.concatenate([above[row, pick], below[row, pick]], axis=1)
        found.append(_Swaps(tet[gain], new, before[gain], after[gain]))
    return found


def _face_swaps(vertices: np.ndarray, tets: np.ndarray, quality: np.ndarray, good: float) -> _Swaps:
    """Inner faces of poor tetrahedra that go: an edge joins the two vertices opposite."""
    keys = row_keys(tets[:, FACES].reshape(-1, 3), len(vertices))
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
    one, two = order[same], order[same + 1]
    poor = np.minimum(quality[one // 4], quality[two // 4]) < good
    one, two = one[poor], two[poor]
    face = tets[one[:, None] // 4, FACES[one % 4]]
    inner, outer = tets[one // 4, one % 4], tets[two // 4, two % 4]
    new = np.stack(
        [np.column_stack([face[:, i], face[:, (i + 1) % 3], outer, inner]) for i in range(3)],
        axis=1,
    )
    after = tet_quality(vertices[new]).min(axis=1)
    before = np.minimum(quality[one // 4], quality[two // 4])
    gain = after > np.maximum(_GAIN * before, 0.0)
    return _Swaps(np.column_stack([one // 4, two // 4])[gain], new[gain], before[gain], after[gain])


def _smooth(vertices: np.ndarray, tets: np.ndarray, good: float, free: np.ndarray) -> int:
    """Move inner vertices of poor tetrahedra so that the worst around each gains; in place.

    Returns
    -------
    int
        Vertices that moved.
    """
    quality = tet_quality(vertices[tets])
    movable = np.unique(tets[quality < good])
    movable = movable[free[movable]]
    if not len(movable):
        return 0
    corner = np.flatnonzero(np.isin(tets, movable))
    corner = corner[np.argsort(tets.ravel()[corner], kind="stable")]
    _, start, size = np.unique(tets.ravel()[corner], return_index=True, return_counts=True)
    before = vertices.copy()
    left = np.ones(len(movable), dtype=bool)
    while left.any():
        # vertices that share no tetrahedron move at once
        number = np.full(len(vertices), len(movable))
        number[movable[left]] = np.flatnonzero(left)
        lowest = number[tets].min(axis=1)
        ready = np.minimum.reduceat(lowest[corner // 4], start) >= np.arange(len(movable))
        now = np.flatnonzero(ready & left)
        entry = corner[np.repeat(start[now], size[now]) + _ranges(size[now])]
        _move(vertices, tets[entry // 4], entry % 4, movable[now], size[now])
        left[now] = False
    return int(np.count_nonzero((vertices != before).any(axis=1)))


def _ranges(sizes: np.ndarray) -> np.ndarray:
    """0, 1, ... for every size, one after the other."""
    return np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)


_DIRECTIONS = np.array(
    [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z],
    dtype=float,
)
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)


def _move(
    vertices: np.ndarray, star: np.ndarray, place: np.ndarray, moved: np.ndarray, size: np.ndarray
) -> None:
    """Move vertices to the best of some places around each, by ever smaller steps; in place."""
    owner = np.repeat(np.arange(len(moved)), size)
    start = np.cumsum(size) - size
    corners = vertices[star]
    rows = np.arange(len(star))
    others = np.linalg.norm(corners - vertices[moved[owner]][:, None], axis=2).sum(axis=1) / 3.0
    length = np.add.reduceat(others, start) / size
    middle = np.add.reduceat(corners.sum(axis=1), start) / (4 * size[:, None])
    best = np.minimum.reduceat(tet_quality(corners), start)
    for step in (1.0, *_STEPS):
        centre = vertices[moved]
        ways = step * length[:, None, None] * _DIRECTIONS
        if step == 1.0:
            ways = (middle - centre)[:, None] * np.array([0.5, 1.0])[:, None]
        for k in range(ways.shape[1]):
            corners[rows, place] = (centre + ways[:, k])[owner]
            found = np.minimum.reduceat(tet_quality(corners), start)
            better = found > np.maximum(_GAIN * best, 0.0)
            best = np.where(better, found, best)
            vertices[moved[better]] = (centre + ways[:, k])[better]
