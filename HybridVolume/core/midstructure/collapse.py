# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Tetrahedra burnt down to a graph by elementary collapses, which keep every loop.

The fire starts at the surface and comes to a point after a time equal to its depth. What it leaves
of a tetrahedral complex (first triangles, then edges) burns on from its rims; an edge that has
lasted longer than the body is thick there is kept for good. After Liu, Chambers, Letscher and Ju,
*A simple and robust thinning algorithm on cell complexes* (2010), with the distance to the surface
in place of their count of rounds.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from ..tetmesh.mesh import FACES, row_keys

# A face burns with the front of the fire where it faces the surface, up to this cosine on average.
# Through other faces the fire must not rush: it would eat a thin layer from the side.
FACING = 0.35
# What is left at a smaller depth, in units of half the local thickness, burns at once.
SHALLOW = 0.6
# Depth of what is in the middle, in the same units.
MIDDLE = 0.85
# Speed of the fire along triangles, and along edges; 1 in the volume. Ways over a mesh are detours:
# a slower fire would never catch up with the front that runs ahead of it.
SPEED = 1.5
EDGE_SPEED = 3.0
# A branch in a sheet is to be as long as this share of the time that the sheet took to burn.
SHEET = 0.4


@dataclass(frozen=True)
class Graph:
    """What is left of a complex.

    Attributes
    ----------
    edges : (e, 2) int array
        Vertex numbers.
    time : (e,) array
        When the last triangle beside each edge had burnt, mm.
    point : int
        A vertex that is left where the complex shrinks to a point, or -1.
    burnt : dict of int to int
        Vertices that a branch was shortened by: from each one that next towards its old end.
    solid : bool
        Whether triangles or tetrahedra are left, which enclose cavities.
    """

    edges: np.ndarray
    time: np.ndarray
    point: int
    burnt: dict[int, int]
    solid: bool


def collapse(
    points: np.ndarray,
    depth: np.ndarray,
    inward: np.ndarray,
    scale: np.ndarray,
    tets: np.ndarray,
    lasting: float,
) -> Graph:
    """Burn down a connected complex.

    Parameters
    ----------
    points : (n, 3) array
        mm.
    depth : (n,) array
        Distance to the surface, mm.
    inward : (n, 3) array
        Unit vectors from the nearest point of the surface.
    scale : (n,) array
        Half the thickness of the body near each point, mm.
    tets : (m, 4) int array
    lasting : float
        Length of a branch that is kept, in units of ``scale``.
    """
    return _Fire(points, depth, inward, scale, tets).run(lasting)


class _Fire:
    """Cells of the complex with the number and the sum of their living cofaces.

    Where one coface is left, the sum is its number: no lists of cofaces are needed.
    """

    def __init__(
        self,
        points: np.ndarray,
        depth: np.ndarray,
        inward: np.ndarray,
        scale: np.ndarray,
        tets: np.ndarray,
    ) -> None:
        n = len(points)
        corners = np.sort(tets[:, FACES].reshape(-1, 3), axis=1)
        _, first, inverse = np.unique(row_keys(corners, n), return_index=True, return_inverse=True)
        triangles = corners[first]
        self.tet_faces = inverse.reshape(-1, 4)
        sides = triangles[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2)
        _, first, inverse = np.unique(row_keys(sides, n), return_index=True, return_inverse=True)
        self.pairs = sides[first]
        self.face_edges = inverse.reshape(-1, 3)
        self.length = np.linalg.norm(points[self.pairs[:, 0]] - points[self.pairs[:, 1]], axis=1)
        self.scale = scale[self.pairs].max(axis=1)
        x = points[triangles]
        double_area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
        # over the length of a side this is the time to burn a triangle from there: half the height,
        # for a layer of a sheet takes two, one that points forwards and one that points back
        self.height = 0.5 * double_area / SPEED
        # all around have burnt when the deepest corner is reached; of several free faces of one
        # tetrahedron the shallowest goes first
        self.tet_time = depth[tets].max(axis=1)
        self.face_bias = 1e-6 * depth[triangles].mean(axis=1)
        deep = depth > SHALLOW * scale
        self.deep_edge = deep[self.pairs].any(axis=1)
        # what counts of a burnt branch: the ways to the surface beside it are of no use
        middle = (depth > MIDDLE * scale)[self.pairs].all(axis=1)
        self.worth = np.where(middle, self.length, 1e-6 * self.length)
        self.deep_face = deep[triangles].any(axis=1)
        self.wait = _waits(points, inward, tets)
        self.wait[~deep[tets].any(axis=1)] = 0.0
        self.count = n

    @staticmethod
    def _cofaces(of: np.ndarray, size: int) -> tuple[list[int], list[int]]:
        number = np.repeat(np.arange(len(of)), of.shape[1])
        count = np.bincount(of.ravel(), minlength=size)
        total = np.bincount(of.ravel(), number, size).astype(np.int64)
        return count.tolist(), total.tolist()

    def run(self, lasting: float) -> Graph:
        faces, edges = len(self.face_edges), len(self.pairs)
        tets_at, tet_sum = self._cofaces(self.tet_faces, faces)
        faces_at, face_sum = self._cofaces(self.face_edges, edges)
        edges_at, edge_sum = self._cofaces(self.pairs, self.count)
        tet_faces, face_edges = self.tet_faces.tolist(), self.face_edges.tolist()
        pairs, length, scale = self.pairs.tolist(), self.length.tolist(), self.scale.tolist()
        tet_time, face_bias = self.tet_time.tolist(), self.face_bias.tolist()
        height = self.height.tolist()
        deep_edge, deep_face = self.deep_edge.tolist(), self.deep_face.tolist()
        wait, worth = self.wait.tolist(), self.worth.tolist()
        alone_since = [0.0] * edges
        face_lives, edge_lives, kept = [True] * faces, [True] * edges, [False] * edges
        fuel: dict[int, tuple[float, int]] = {}
        push, pop = heapq.heappush, heapq.heappop
        heap: list[tuple[float, int, int]] = []
        now, last = 0.0, self.pairs[0, 0]

        def free_face(f: int) -> None:
            tet = tet_sum[f]
            reached = now + wait[tet][tet_faces[tet].index(f)]
            push(heap, (max(reached, tet_time[tet] + face_bias[f]), 0, f))

        def free_edge(e: int) -> None:
            """Time of burning of the triangle at an edge that has no other one."""
            f = face_sum[e]
            late = height[f] / length[e] if deep_face[f] else 0.0
            push(heap, (now + late, 1, e))

        def free_vertex(v: int) -> None:
            if edges_at[v] == 1 and faces_at[edge_sum[v]] == 0:
                e = edge_sum[v]
                push(heap, (now + (length[e] / EDGE_SPEED if deep_edge[e] else 0.0), 2, v))

        def without_face(f: int, gone: int) -> None:
            for e in face_edges[f]:
                faces_at[e] -= 1
                face_sum[e] -= f
                if e == gone:
                    continue
                if faces_at[e] == 1:
                    free_edge(e)
                elif faces_at[e] == 0:
                    alone_since[e] = now
                    for v in pairs[e]:
                        free_vertex(v)

        for f in range(faces):
            if tets_at[f] == 1:
                free_face(f)
        left = len(tet_faces)
        while heap:
            time, kind, cell = pop(heap)
            if time > now:
                now = time
            if kind == 0:
                if not face_lives[cell] or tets_at[cell] != 1:
                    continue
                tet = tet_sum[cell]
                left -= 1
                for f in tet_faces[tet]:
                    tets_at[f] -= 1
                    tet_sum[f] -= tet
                    if tets_at[f] == 1:
                        free_face(f)
                face_lives[cell] = False
                without_face(cell, -1)
            elif kind == 1:
                if not edge_lives[cell] or faces_at[cell] != 1:
                    continue
                f = face_sum[cell]
                face_lives[f] = False
                without_face(f, cell)
                edge_lives[cell] = False
                for x in pairs[cell]:
                    edges_at[x] -= 1
                    edge_sum[x] -= cell
                    free_vertex(x)
            else:
                if edges_at[cell] != 1 or faces_at[edge_sum[cell]] != 0:
                    continue
                e = edge_sum[cell]
                since = alone_since[e]
                if kept[e]:
                    continue
                if EDGE_SPEED * (now - since) > lasting * max(scale[e], SHEET * since):
                    kept[e] = True
                    continue
                u, v = pairs[e]
                last = u + v - cell
                burnt = fuel.get(cell, (0.0, -1))[0] + worth[e]
                if burnt > fuel.get(last, (0.0, -1))[0]:
                    fuel[last] = (burnt, cell)
                edges_at[cell] = 0
                edge_lives[e] = False
                edges_at[last] -= 1
                edge_sum[last] -= e
                free_vertex(last)
        living = np.array(edge_lives)
        return Graph(
            self.pairs[living],
            np.array(alone_since)[living],
            -1 if living.any() else int(last),
            {v: step for v, (_, step) in fuel.items()},
            left > 0 or any(face_lives),
        )


def _waits(points: np.ndarray, inward: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Time that the fire takes through a tetrahedron from each of its faces, (m, 4).

    0 from a face that looks towards the surface.
    """
    corners = tets[:, FACES]
    x = points[corners]
    normal = np.cross(x[:, :, 1] - x[:, :, 0], x[:, :, 2] - x[:, :, 0])
    size = np.maximum(np.linalg.norm(normal, axis=2), np.finfo(float).tiny)
    height = np.einsum("mfi,mfi->mf", normal, x[:, :, 0] - points[tets]) / size
    facing = np.einsum("mfi,mfi->mf", normal, -inward[corners].mean(axis=2)) > FACING * size
    return np.where(facing, 0.0, height / SPEED)
