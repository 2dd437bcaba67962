# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Where the corners of quads stand on the edges: at equal parameters on opposite sides.

On a face that keeps its parameters the lines between corners on opposite sides must be parameter
lines. Corners that such lines join, through any number of faces, have one parameter together, and
where a line begins at a vertex it is given. What is left free is as even as it can be.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from .. import bspline
from .geometry import SplineCurve
from .iso_sides import SHARE, IsoSides
from .quad_mesh import QuadCover

LEAST = 0.1
"""Shortest step between corners, as a share of the wanted one."""
UNEVEN = 2.0
"""Lengths beside each other may differ by this factor for the sake of even parameters."""
BESIDE = 0.25
"""Corners that are nearer to a knot than this share of the shortest step stand on it."""


def edge_chains(cover: QuadCover, curves: Sequence[SplineCurve | None]) -> dict[int, np.ndarray]:
    """Corners along each edge, from the beginning of its curve to the end.

    Parameters
    ----------
    cover : QuadCover
    curves : sequence of SplineCurve

    Returns
    -------
    dict
        (k + 1,) int array for each edge of k sides; a closed edge ends where it begins.
    """
    order = np.argsort(cover.rim_edge, kind="stable")
    edges, start = np.unique(cover.rim_edge[order], return_index=True)
    parts = np.split(cover.rim[order], start[1:])
    return {
        edge: _chain(part, cover.points, curves[edge])
        for edge, part in zip(edges.tolist(), parts, strict=True)
    }


def _chain(pairs: np.ndarray, points: np.ndarray, curve: SplineCurve) -> np.ndarray:
    beside: dict[int, list[int]] = {}
    for a, b in pairs.tolist():
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    first, second, last = curve.evaluate(curve.knots[[0, 0, -1]] + _second(curve))
    ends = [corner for corner, near in beside.items() if len(near) == 1]
    if ends:
        away = [np.linalg.norm(points[corner] - first) for corner in ends]
        here = ends[int(np.argmin(away))]
        step = beside[here][0]
    else:
        # a closed curve: the corner where it closes, and the one beside it that comes first
        corners = list(beside)
        here = corners[int(np.linalg.norm(points[corners] - first, axis=1).argmin())]
        t = curve.project(points[beside[here]])
        step = beside[here][int(t.argmin())]
    chain = [here, step]
    for _ in range(len(pairs) - 1):
        one, *other = beside[step]
        here, step = step, (other[0] if other and one == here else one)
        chain.append(step)
    return np.array(chain)


def _second(curve: SplineCurve) -> np.ndarray:
    return np.array([0.0, 1e-3, 0.0]) * (curve.knots[-1] - curve.knots[0])


def wanted_places(curve: SplineCurve, points: np.ndarray) -> np.ndarray:
    """Shares of a curve's range where the corners on an edge should be.

    Evenly in its parameter, with a corner at every knot if there are enough; where that makes
    lengths too different they stay where they are.

    Parameters
    ----------
    curve : SplineCurve
    points : (k + 1, 3) array
        Corners from the curve's beginning to its end.
    """
    low, high = curve.knots[0], curve.knots[-1]
    even = _even(curve, len(points) - 1)
    lengths = np.linalg.norm(np.diff(curve.evaluate(low + even * (high - low)), axis=0), axis=1)
    if lengths.max() <= UNEVEN * lengths.min():
        return even
    share = (curve.project(points) - low) / (high - low)
    share[[0, -1]] = 0.0, 1.0
    return share if np.diff(share).min() > 0.0 else even


def places_on_knots(
    edges: Iterable[int],
    curves: Sequence[SplineCurve | None],
    points: np.ndarray,
    chains: Mapping[int, np.ndarray],
) -> dict[int, np.ndarray]:
    """Shares of edges' ranges where corners that stand beside a knot stand on it.

    Between the two there would be a span of which nothing can be proved.

    Parameters
    ----------
    edges : iterable of int
    curves : sequence of SplineCurve
    points : (n, 3) array
        All corners.
    chains : mapping
        Of :func:`edge_chains`.

    Returns
    -------
    dict
        Of the edges with such corners.
    """
    found = {}
    for edge in edges:
        curve = curves[edge]
        lines = bspline.breakpoints(curve.knots)
        if len(lines) == 2:
            continue
        lines = (lines - lines[0]) / (lines[-1] - lines[0])
        share = curve.project(points[chains[edge]]) - curve.knots[0]
        share = share / (curve.knots[-1] - curve.knots[0])
        share[[0, -1]] = 0.0, 1.0
        near = lines[np.abs(share[:, None] - lines).argmin(axis=1)]
        moved = np.where(np.abs(near - share) < BESIDE * np.diff(share).min(), near, share)
        if np.any(moved != share) and np.all(np.diff(moved) > 0.0):
            found[edge] = moved
    return found


def _even(curve: SplineCurve, count: int) -> np.ndarray:
    lines = bspline.breakpoints(curve.knots)
    spans = np.diff(lines)
    if count < len(spans):
        return np.linspace(0.0, 1.0, count + 1)
    parts = np.ones(len(spans), dtype=int)
    for _ in range(count - len(spans)):
        parts[np.argmax(spans / parts)] += 1
    inside = [
        a + width * np.arange(n) / n for a, width, n in zip(lines, spans, parts, strict=False)
    ]
    t = np.append(np.concatenate(inside), lines[-1])
    return (t - lines[0]) / (lines[-1] - lines[0])


def spread_places(
    faces: Mapping[int, IsoSides],
    counts: Mapping[int, int],
    even: Mapping[int, np.ndarray],
    rank: np.ndarray,
) -> tuple[dict[int, np.ndarray], set[int]]:
    """Shares of the edges' ranges at the corners on them.

    Parameters
    ----------
    faces : mapping
        That should keep their parameters.
    counts : mapping
        Number of sides of quads on each edge.
    even : mapping
        Where the corners of each edge stand best, (k + 1,).
    rank : (nf,) array
        Faces with a higher one yield first.

    Returns
    -------
    places : dict
        For each edge of a kept face.
    kept : set of int
        Faces with equal parameters on opposite sides.
    """
    if not faces:
        return {}, set()
    order = sorted(faces, key=lambda face: (rank[face], face))
    edges = sorted({edge for around in faces.values() for edge in around.edge.tolist()})
    start = dict(zip(edges, np.cumsum([0] + [counts[e] + 1 for e in edges]).tolist(), strict=False))
    size = sum(counts[edge] + 1 for edge in edges)
    target = np.concatenate([even[edge] for edge in edges])
    fixed = np.zeros(size, dtype=bool)
    for edge in edges:
        fixed[[start[edge], start[edge] + counts[edge]]] = True
    kept = set(order)
    while True:
        relations = _Relations(size)
        relations.fix(np.flatnonzero(fixed), target[fixed])
        for face in order:
            if face in kept and not relations.add(*_joined(faces[face], counts, start)):
                kept.discard(face)
        found = relations.solved(edges, start, counts, target)
        bad = [
            edge
            for edge in edges
            if np.any(
                np.diff(found[start[edge] : start[edge] + counts[edge] + 1])
                < LEAST * np.diff(even[edge])
            )
        ]
        beside = [face for face in order if face in kept and np.isin(faces[face].edge, bad).any()]
        if not beside:
            break
        kept.discard(beside[-1])
    return {edge: found[start[edge] : start[edge] + counts[edge] + 1] for edge in edges}, kept


def _joined(
    around: IsoSides, counts: Mapping[int, int], start: Mapping[int, int]
) -> tuple[np.ndarray, np.ndarray] | tuple[None, None]:
    """Pairs of corners on opposite sides, (m, 2), and shares there: (m, 2, 2) of p + q x."""
    numbers, maps = [], []
    for first in (0, 2):
        lines = [_side_corners(around, first + k, counts, start) for k in (0, 1)]
        if len(lines[0][0]) != len(lines[1][0]):
            return None, None
        numbers.append(np.stack([line[0] for line in lines], axis=1))
        maps.append(np.stack([line[1] for line in lines], axis=1))
    return np.concatenate(numbers), np.concatenate(maps)


def _side_corners(
    around: IsoSides, side: int, counts: Mapping[int, int], start: Mapping[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Corners along a side without its ends, and p, q of each: it stands at the share p + q x."""
    numbers, maps = [], []
    for edge in around.along(side)[0].tolist():
        p, q = around.ends[np.flatnonzero(around.edge == edge)[0]]
        corners = start[edge] + np.arange(counts[edge] + 1)
        corners = corners if p < q else corners[::-1]
        numbers.append(corners[1:])  # the last one is a vertex
        maps.append(np.tile([p, q - p], (counts[edge], 1)))
    return np.concatenate(numbers)[:-1], np.concatenate(maps)[:-1]


class _Relations:
    """Numbers of which pairs are joined by p + q x = p' + q' x', and some are known."""

    def __init__(self, size: int) -> None:
        # x = offset + scale * x of the parent; a root is its own parent
        self.parent = np.arange(size)
        self.offset, self.scale = np.zeros(size), np.ones(size)
        self.value = np.full(size, np.nan)

    def fix(self, numbers: np.ndarray, values: np.ndarray) -> None:
        self.value[numbers] = values

    def root(self, k: int) -> tuple[int, float, float]:
        offset, scale = 0.0, 1.0
        while self.parent[k] != k:
            offset, scale = offset + scale * self.offset[k], scale * self.scale[k]
            k = int(self.parent[k])
        return k, offset, scale

    def add(self, numbers: np.ndarray | None, maps: np.ndarray | None) -> bool:
        """Join pairs; False, and nothing is changed, where they contradict what is known."""
        if numbers is None:
            return False
        before = [array.copy() for array in (self.parent, self.offset, self.scale, self.value)]
        for (a, b), ((p, q), (r, s)) in zip(numbers.tolist(), maps.tolist(), strict=True):
            i, c, d = self.root(a)
            j, e, f = self.root(b)
            # p + q (c + d x) = r + s (e + f y)
            level, one, other = p + q * c - r - s * e, q * d, s * f
            if not self._join(i, j, level, one, other):
                self.parent, self.offset, self.scale, self.value = before
                return False
        return True

    def _join(self, i: int, j: int, level: float, one: float, other: float) -> bool:
        """level + one x_i = other x_j."""
        if i == j:
            if abs(one - other) <= SHARE * abs(one):
                return abs(level) <= SHARE
            return self._known(i, level / (other - one))
        known = ~np.isnan(self.value[[i, j]])
        if known.all():
            return abs(level + one * self.value[i] - other * self.value[j]) <= SHARE
        if known[0]:
            self.value[j] = (level + one * self.value[i]) / other
        elif known[1]:
            self.value[i] = (other * self.value[j] - level) / one
        else:
            self.parent[j], self.offset[j], self.scale[j] = i, level / other, one / other
        return True

    def _known(self, i: int, value: float) -> bool:
        if not np.isnan(self.value[i]):
            return abs(self.value[i] - value) <= SHARE
        self.value[i] = value
        return bool(-SHARE <= value <= 1.0 + SHARE)

    def solved(
        self,
        edges: Sequence[int],
        start: Mapping[int, int],
        counts: Mapping[int, int],
        target: np.ndarray,
    ) -> np.ndarray:
        """All numbers, with steps along edges as near to the target's as can be."""
        size = len(self.value)
        roots = [self.root(k) for k in range(size)]
        root = np.array([r[0] for r in roots])
        offset, scale = (np.array([r[k] for r in roots]) for k in (1, 2))
        value = self.value[root]
        known = ~np.isnan(value)
        base = np.where(known, offset + scale * np.where(known, value, 0.0), offset)
        free, column = np.unique(root[~known], return_inverse=True)
        if not len(free):
            return base
        rows = np.flatnonzero(~known)
        matrix = sparse.csr_matrix((scale[rows], (rows, column)), shape=(size, len(free)))
        step = np.concatenate([start[edge] + np.arange(counts[edge]) for edge in edges])
        width = target[step + 1] - target[step]
        weight = sparse.diags(1.0 / width)
        moves = matrix[step + 1] - matrix[step]
        wanted = width - (base[step + 1] - base[step])
        normal = (moves.T @ weight @ moves).tocsc()
        found = np.atleast_1d(spsolve(normal, moves.T @ (weight @ wanted)))
        return base + matrix @ found
