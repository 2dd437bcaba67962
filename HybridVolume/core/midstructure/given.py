# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The facets that a triangle complex stands for: what it starts from and comes back to."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .closest import Carrier
from .curves import corners
from .remesh import CREASE, Remesher
from .shapes import Edges
from .sheets import Midstructure

# What is narrower than this share of the wanted length is no feature of the midstructure.
DETAIL = 0.6
# Vertices stay this near to the given facets, in units of the wanted length.
NEAR = 0.02
# Longest edges on a closed part, in units of the root of its area.
ROUND = 0.1
# Distance of points that stand for lines, in units of the distance to the surface.
ALONG = 0.25


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


class Given:
    """Facets of a midstructure, all of them kept and small beside their distance to the surface.

    Parameters
    ----------
    midstructure : Midstructure
        From :func:`HybridVolume.core.midstructure.pieces.in_pieces`.
    wanted : callable
        Wanted edge length, mm, where the surface is (k,) mm away.

    Attributes
    ----------
    triangles : (t, 3) int array
    sheet : (t,) int array
    used : (u,) int array
        Vertices of the triangles.
    lines, ends : (l,), (k,) int arrays
        Vertices of lines and points, and those of them that are not between two pieces of a line.
    wanted : (n,) array
        Wanted edge length at every vertex, mm.
    """

    def __init__(
        self, midstructure: Midstructure, wanted: Callable[[np.ndarray], np.ndarray]
    ) -> None:
        facets = midstructure.facets
        flat = (facets == facets[:, [1, 2, 0]]).any(axis=1)
        self.vertices, self.radius = midstructure.vertices, midstructure.radius
        self.triangles, self.sheet = facets[~flat], midstructure.sheet[~flat]
        lines = np.sort(facets[flat], axis=1)[:, [0, 2]]
        self.lines, degree = np.unique(lines, return_counts=True)
        # ends, branches and points
        self.ends = self.lines[degree != 2]
        self.used = np.unique(self.triangles)
        # on a medial axis creases are noise, unless two sheets meet there
        self.sharp = midstructure.figures is None
        self.wanted = np.minimum(wanted(self.radius), self._round())
        self._tree = cKDTree(self.vertices[self.used])
        size = self.wanted[self.triangles].mean(axis=1)
        self._carrier = Carrier(self.vertices[self.triangles], 0.5 * size)

    def _round(self) -> np.ndarray:
        """Largest edge length at each vertex, so that small closed surfaces stay round."""
        n = len(self.vertices)
        if not len(self.triangles):
            return np.full(n, np.inf)
        edges = Edges.of(self.triangles, n)
        graph = coo_matrix((np.ones(len(edges.ends)), edges.ends.T), shape=(n, n))
        part = connected_components(graph, directed=False)[1]
        rim = np.zeros(part.max() + 1, dtype=bool)
        rim[part[edges.ends[edges.count == 1, 0]]] = True
        x = self.vertices[self.triangles]
        twice = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
        area = np.bincount(part[self.triangles[:, 0]], 0.5 * twice, len(rim))
        rim |= area == 0.0
        return np.where(rim, np.inf, ROUND * np.sqrt(area))[part]

    def size(self, points: np.ndarray) -> np.ndarray:
        """Wanted edge lengths, (k,), mm, at points (k, 3) on the triangles."""
        return self._between(self.wanted, points)

    def radius_at(self, points: np.ndarray) -> np.ndarray:
        """Distance to the surface, (k,), mm, at points (k, 3) on the triangles."""
        return self._between(self.radius, points)

    def _between(self, values: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Values of the vertices, taken between the nearest of them."""
        number = min(4, len(self.used))
        distance, near = self._tree.query(points, k=number)
        distance = distance.reshape(len(points), number)
        near = self.used[near.reshape(len(points), number)]
        weight = 1.0 / np.maximum(distance, 1e-9 * self.radius.max()) ** 2
        return (weight * values[near]).sum(axis=1) / weight.sum(axis=1)

    def back(self, points: np.ndarray) -> np.ndarray:
        """Points (k, 3) moved to the triangles, as far as they are not near enough."""
        near = self._carrier.closest(points)[0]
        away = points - near
        distance = np.linalg.norm(away, axis=1)
        limit = NEAR * self.size(points)
        return near + away * np.minimum(1.0, limit / np.maximum(distance, 1e-300))[:, None]

    def coarse(self) -> Remesher:
        """The triangles with vertices nearer than the detail put together.

        Small holes, slits and fins are gone by that. Corners of rims and seams are chosen first,
        then other vertices of them, and such vertices go to such only.
        """
        x = self.vertices
        mesh = Remesher(x, self.triangles, self.sheet, self.size, self.wanted, sharp=self.sharp)
        if not len(self.triangles):
            mesh.compact()
            return mesh
        _, _, degree = mesh.edges()
        rank = np.where(degree == 0, 3, np.where(degree == 2, 2, 1))
        rank[corners(mesh)] = 0
        points = self._thinned(DETAIL * self.wanted, rank)
        chosen = points[spread(x[points], DETAIL * self.wanted[points], rank[points])]
        label = np.arange(len(x))
        label[self.used] = self._nearest(mesh, self.used, chosen, rank)
        on_curve = self.used[rank[self.used] < 3]
        if len(on_curve):
            of_curves = chosen[rank[chosen] < 3]
            label[on_curve] = of_curves[cKDTree(x[of_curves]).query(x[on_curve])[1]]
        mesh.fixed = rank == 0
        mesh.merge(label)
        return mesh

    def _nearest(
        self, mesh: Remesher, which: np.ndarray, chosen: np.ndarray, rank: np.ndarray
    ) -> np.ndarray:
        """The nearest of the chosen vertices for each of some, but not around an edge."""
        x, tree = self.vertices, cKDTree(self.vertices[chosen])
        result = chosen[tree.query(x[which])[1]]
        if not self.sharp:
            return result
        corner = x[mesh.t]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        area = np.linalg.norm(normal, axis=1)
        order = np.argsort(area, kind="stable")
        unit = np.zeros_like(x)
        for k in range(3):
            # the largest triangle comes last and stays
            unit[mesh.t[order, k]] = (normal / np.maximum(area, 1e-300)[:, None])[order]

        def astray(vertex: np.ndarray, to: np.ndarray) -> np.ndarray:
            cosine = np.abs(np.einsum("...i,...i->...", unit[vertex], unit[to]))
            return (rank[to] == 3) & (rank[vertex] == 3) & (cosine < np.cos(np.radians(CREASE)))

        wrong = np.flatnonzero(astray(which, result))
        if len(wrong):
            number = min(12, len(chosen))
            near = chosen[tree.query(x[which[wrong]], k=number)[1].reshape(len(wrong), number)]
            good = ~astray(which[wrong][:, None], near)
            found = good.any(axis=1)
            result[wrong[found]] = near[found, good[found].argmax(axis=1)]
        return result

    def _thinned(self, spacing: np.ndarray, rank: np.ndarray) -> np.ndarray:
        """Vertices of triangles, one of the lowest rank in each cell of a quarter of a spacing."""
        used = self.used
        if not len(used):
            return used
        level = np.floor(np.log2(np.maximum(spacing[used], 1e-300))).astype(np.int64)
        cell = np.floor(self.vertices[used] / (0.25 * 2.0**level)[:, None]).astype(np.int64)
        key = level - level.min()
        for k in range(3):
            key = key * 2**20 + (cell[:, k] - cell[:, k].min()) % 2**20
        order = np.argsort(rank[used], kind="stable")
        return used[order[np.unique(key[order], return_index=True)[1]]]

    def rest(self, mesh: Remesher) -> tuple[np.ndarray, np.ndarray]:
        """Points that stand for what triangles do not reach, (k, 3), and their radius, (k,), mm."""
        some = self._thinned(self.wanted, np.zeros(len(self.vertices)))
        some = np.union1d(some, self.lines)
        if len(mesh.t):
            carrier = Carrier(mesh.x[mesh.t], mesh.h[mesh.t].mean(axis=1))
            near = carrier.closest(self.vertices[some])[0]
            distance = np.linalg.norm(near - self.vertices[some], axis=1)
            some = some[distance > self.wanted[some]]
        points, radius = self.vertices[some], self.radius[some]
        pick = spread(points, ALONG * radius, ~np.isin(some, self.ends))
        return points[pick], radius[pick]
