# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Kept facets as an even triangle complex that tetrahedra can have as inner faces (section 5)."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..intersection import points_inside, self_intersections
from .closest import Carrier
from .contacts import join_contacts
from .curves import corners, smooth_curves
from .pieces import in_pieces
from .remesh import SIDES, Edges, Remesher, opening_sides
from .sheets import Midstructure

log = logging.getLogger(__name__)

# What is narrower than this share of the wanted length is no feature of the midstructure.
DETAIL = 0.4
# Triangles that open by less than this at a common edge lie one upon the other, degrees.
FOLD = 25.0
# Vertices stay this near to the given facets, in units of the distance to the surface.
NEAR = 0.01
# Rounds of splits, collapses, flips and smoothing.
ROUNDS = 6
# Triangles with a smaller angle are collapsed in the second half of the rounds, degrees.
POOR = 15.0
# What comes nearer than this share of the wanted length touches.
CONTACT = 0.15
# Longest edges on a closed part, in units of the root of its area.
ROUND = 0.15
# Vertices leave the planes they lie in by so much, in units of the wanted length: four points in a
# plane are tetrahedra without volume where a sheet has a gap.
JITTER = 3e-4
# Points that stand for lines, in units of the distance to the surface.
ALONG = 0.25


@dataclass(frozen=True)
class Complex:
    """Even triangles in place of the kept facets, and what they do not reach.

    Attributes
    ----------
    vertices : (m, 3) array
        mm.
    triangles : (f, 3) int array
        They meet only in shared vertices and edges.
    rest : (k, 3) array
        Points of lines and specks of the midstructure, mm.
    rest_radius : (k,) array
        Distance to the surface there, mm.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    rest: np.ndarray
    rest_radius: np.ndarray


def spread(points: np.ndarray, spacing: np.ndarray, rank: np.ndarray | None = None) -> np.ndarray:
    """Numbers of points at least ``spacing`` apart, such that every point is near one.

    Parameters
    ----------
    points : (k, 3) array
    spacing : (k,) array
    rank : (k,) array, optional
        Points of lower rank are chosen first.
    """
    order = np.random.default_rng(0).permutation(len(points))
    if rank is not None:
        order = order[np.argsort(rank[order], kind="stable")]
    tree = cKDTree(points)
    free = np.ones(len(points), dtype=bool)
    chosen = []
    for part in np.array_split(order, -(-len(order) // 4096)) if len(order) else ():
        part = part[free[part]]
        around = tree.query_ball_point(points[part], spacing[part])
        for i, near in zip(part.tolist(), around, strict=True):
            if free[i]:
                chosen.append(i)
                free[near] = False
    return np.array(chosen, dtype=np.int64)


def resample(
    midstructure: Midstructure,
    size: Callable[[np.ndarray], np.ndarray],
    boundary: tuple[np.ndarray, np.ndarray],
) -> Complex:
    """Even triangles for the kept facets."""
    source = _Source.of(in_pieces(midstructure, boundary), size)
    mesh = source.coarse()
    if len(mesh.t):
        _even(mesh, source)
        mesh.x = mesh.x + JITTER * mesh.h[:, None] * np.random.default_rng(0).uniform(
            -1.0, 1.0, mesh.x.shape
        )
        dropped = _embed(mesh, source, boundary)
        if dropped:
            log.info("%d triangles of the midstructure cannot be embedded", dropped)
    rest, radius = source.rest(mesh)
    log.info(
        "midstructure: %d facets became %d triangles, %d balls",
        int(midstructure.kept.sum()),
        len(mesh.t),
        len(rest),
    )
    return Complex(mesh.x, mesh.t, rest, radius)


@dataclass
class _Source:
    """The kept facets: triangles, cut where they are large, and points along the lines."""

    vertices: np.ndarray
    triangles: np.ndarray
    sheet: np.ndarray
    radius: np.ndarray
    lines: np.ndarray
    line_radius: np.ndarray
    wanted: Callable[[np.ndarray], np.ndarray]
    sharp: bool

    @classmethod
    def of(cls, midstructure: Midstructure, wanted: Callable[[np.ndarray], np.ndarray]) -> _Source:
        """From facets that are all kept and small."""
        facets = midstructure.facets
        flat = (facets == facets[:, [1, 2, 0]]).any(axis=1)
        ends = np.unique(facets[flat])
        return cls(
            midstructure.vertices,
            facets[~flat],
            midstructure.sheet[~flat],
            midstructure.radius,
            midstructure.vertices[ends],
            midstructure.radius[ends],
            wanted,
            midstructure.method == "own",
        )

    def __post_init__(self):
        used = np.unique(self.triangles)
        self.used = used
        self.tree = cKDTree(self.vertices[used])
        x = self.vertices[self.triangles]
        self.h = np.minimum(self.wanted(self.radius), self._closed_limit())
        self.carrier = Carrier(x, 0.5 * self.h[self.triangles].mean(axis=1))

    def size(self, points):
        return self._between(self.h, points)

    def _between(self, values, points):
        """Values at vertices, taken between the nearest of them."""
        number = min(4, len(self.used))
        d, i = self.tree.query(points, k=number)
        d, i = d.reshape(len(points), number), i.reshape(len(points), number)
        weight = 1.0 / np.maximum(d, 1e-9 * self.radius.max()) ** 2
        return (weight * values[self.used[i]]).sum(axis=1) / weight.sum(axis=1)

    def _closed_limit(self):
        """Largest edge length at each vertex, so that small closed surfaces stay round."""
        n = len(self.vertices)
        limit = np.full(n, np.inf)
        if not len(self.triangles):
            return limit
        edges = Edges.of(self.triangles, n)
        graph = coo_matrix((np.ones(len(edges.ends)), edges.ends.T), shape=(n, n))
        part = connected_components(graph, directed=False)[1]
        rim = np.zeros(part.max() + 1, dtype=bool)
        rim[part[edges.ends[edges.count == 1, 0]]] = True
        x = self.vertices[self.triangles]
        twice = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
        area = np.bincount(part[self.triangles[:, 0]], 0.5 * twice, len(rim))
        return np.where(rim, np.inf, ROUND * np.sqrt(area))[part]

    def back(self, points):
        near = self.carrier.closest(points)[0]
        away = points - near
        d = np.linalg.norm(away, axis=1)
        limit = NEAR * self._between(self.radius, points)
        return near + away * np.minimum(1.0, limit / np.maximum(d, 1e-300))[:, None]

    def coarse(self) -> Remesher:
        """Vertices nearer than the detail become one."""
        x, t = self.vertices, self.triangles
        n = len(x)
        if not len(t):
            return Remesher(x[:0], t, self.sheet, self.size, self.h[:0])
        mesh = Remesher(x, t, self.sheet, self.size, self.h, sharp=self.sharp)
        edges, curve, degree = mesh.edges()
        kind = np.where(degree == 0, 3, np.where(degree == 2, 2, 1))
        kind[corners(mesh)] = 0
        # several passes: rank rims and seams first
        spacing = DETAIL * self.h
        points = self._thinned(kind, spacing)
        chosen = points[spread(x[points], spacing[points], kind[points])]
        label = np.zeros(n, dtype=np.int64)
        label[self.used] = cKDTree(x[chosen]).query(x[self.used])[1]
        on = self.used[kind[self.used] < 3]
        mine = np.flatnonzero(kind[chosen] < 3)
        if len(on):
            label[on] = mine[cKDTree(x[chosen[mine]]).query(x[on])[1]]
        mesh.fixed = kind == 0
        mesh.merge(chosen[label])
        return mesh

    def _thinned(self, kind, spacing):
        """One vertex for each cell of a fine grid."""
        used = self.used
        level = np.floor(np.log2(np.maximum(spacing[used], 1e-300))).astype(np.int64)
        cell = np.floor(self.vertices[used] / (0.25 * 2.0**level)[:, None]).astype(np.int64)
        key = level - level.min()
        for k in range(3):
            key = key * 2**20 + (cell[:, k] - cell[:, k].min()) % 2**20
        order = np.argsort(kind[used], kind="stable")
        return used[order[np.unique(key[order], return_index=True)[1]]]

    def rest(self, mesh):
        used = self._thinned(np.zeros(len(self.vertices)), self.h)
        points = np.vstack([self.vertices[used], self.lines])
        radius = np.append(self.radius[used], self.line_radius)
        if len(mesh.t):
            carrier = Carrier(mesh.x[mesh.t], mesh.h[mesh.t].mean(axis=1))
            d = np.linalg.norm(carrier.closest(points)[0] - points, axis=1)
            far = d > self.wanted(radius)
            points, radius = points[far], radius[far]
        pick = spread(points, ALONG * radius)
        return points[pick], radius[pick]


def _even(mesh: Remesher, source: _Source) -> None:
    """Triangles of even size."""
    mesh.relax(source.back)
    mesh.unfold(FOLD)
    curves = smooth_curves(mesh, source.back)
    back_to_curve = (lambda points: curves.closest(points)[0]) if len(curves) else source.back
    mesh.collapse()
    for k in range(ROUNDS):
        mesh.split()
        if k >= ROUNDS // 2:
            join_contacts(mesh, CONTACT)
        mesh.collapse(rounds=6, worst=0.0 if k < ROUNDS // 2 else POOR)
        mesh.flip()
        mesh.smooth(source.back, back_to_curve)


def _embed(mesh: Remesher, source: _Source, boundary: tuple[np.ndarray, np.ndarray]) -> int:
    """Make triangles meet in shared corners and sides only; how many had to be left out."""
    for attempt in range(4):
        pairs = self_intersections(mesh.x, mesh.t)
        if not len(pairs):
            break
        log.debug("%d pairs of %d triangles cross", len(pairs), len(mesh.t))
        crossing = np.unique(pairs)
        if attempt < 2:
            mesh.relax(source.back, 1, np.unique(mesh.t[crossing]))
        else:
            mesh.merge(_shortest_sides(mesh, crossing))
        mesh.unfold(FOLD)
    before = len(mesh.t)
    _keep(mesh, _without_folds(mesh.x, mesh.t))
    outer, count = boundary[1], len(boundary[0])
    everything = np.vstack([boundary[0], mesh.x])
    for _ in range(20):
        pairs = self_intersections(everything, np.vstack([outer, mesh.t + count]))
        pairs = pairs[(pairs >= len(outer)).any(axis=1)] - len(outer)
        if not len(pairs):
            break
        drop = np.zeros(len(mesh.t), dtype=bool)
        with_outer = pairs.min(axis=1) < 0
        drop[pairs[with_outer].max(axis=1)] = True
        inner = pairs[~with_outer]
        drop |= _fewest(inner[~drop[inner].any(axis=1)], len(mesh.t))
        _keep(mesh, ~drop)
    _keep(mesh, _inside(mesh, boundary))
    mesh.compact()
    return before - len(mesh.t)


def _keep(mesh: Remesher, which: np.ndarray) -> None:
    mesh.t, mesh.sheet = mesh.t[which], mesh.sheet[which]


def _shortest_sides(mesh: Remesher, which: np.ndarray) -> np.ndarray:
    """Where vertices go when the shortest sides of some triangles are given up, (n,)."""
    to = np.arange(len(mesh.x))
    sides = mesh.t[which][:, SIDES]
    length = np.linalg.norm(mesh.x[sides[..., 0]] - mesh.x[sides[..., 1]], axis=2)
    ends = sides[np.arange(len(which)), length.argmin(axis=1)]
    free = np.ones(len(mesh.x), dtype=bool)
    for a, b in ends[np.argsort(length.min(axis=1), kind="stable")].tolist():
        if free[a] and free[b]:
            free[[a, b]] = False
            to[a] = b
    return to


def _without_folds(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Whether each triangle stays so that no two lie one upon the other at a common side."""
    sides = opening_sides(vertices, triangles, FOLD)
    return ~_fewest(sides // 3, len(triangles))


def _fewest(pairs: np.ndarray, count: int) -> np.ndarray:
    """Whether each triangle has to go so that no pair is left; those in many pairs go first."""
    drop = np.zeros(count, dtype=bool)
    if not len(pairs):
        return drop
    hits = np.bincount(pairs.ravel(), minlength=count)
    for a, b in pairs[np.argsort(-hits[pairs].max(axis=1), kind="stable")].tolist():
        if not drop[a] and not drop[b]:
            drop[a if hits[a] >= hits[b] else b] = True
    return drop


def _inside(mesh: Remesher, boundary: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Triangles within the boundary, which they do not cross: one point of each part decides."""
    if not len(mesh.t):
        return np.zeros(0, dtype=bool)
    n = len(mesh.x)
    a, b = mesh.t[:, [0, 1, 1, 2]].reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n))
    label = connected_components(graph, directed=False)[1][mesh.t[:, 0]]
    _, first, part = np.unique(label, return_index=True, return_inverse=True)
    inside = points_inside(*boundary, mesh.x[mesh.t[first]].mean(axis=1))
    return inside[part.ravel()]
