# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Catmull-Clark subdivision of closed cages, with sharp and semi-sharp creases.

Rules of DeRose, Kass and Truong 1998 for creases; where a semi-sharp one ends within a step, the
rules of the step and of the next one are mixed as OpenSubdiv does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from .polygons import SHARP, PolygonMesh


@dataclass(frozen=True)
class Corners:
    """Incidences of a closed mesh of polygons.

    Attributes
    ----------
    edges : (e, 2) int array
    edge : (nc,) int array
        Edge after each corner.
    before : (nc,) int array
        Edge before each corner.
    sharpness : (e,) array
    point_sharpness : (n,) array
        That of vertices.
    valence : (n,) int array
        Edges at each vertex, as many as faces.
    """

    edges: np.ndarray
    edge: np.ndarray
    before: np.ndarray
    sharpness: np.ndarray
    point_sharpness: np.ndarray
    valence: np.ndarray

    @classmethod
    def of(cls, mesh: PolygonMesh) -> Corners:
        """Those of a mesh."""
        edges, edge = mesh.edges
        at = np.arange(len(mesh.corners)) - 1
        at[mesh.start[:-1]] = mesh.start[1:] - 1
        sharpness = np.zeros(len(edges))
        if len(mesh.creases):
            n = len(mesh.vertices)
            known = edges[:, 0] * n + edges[:, 1]
            wanted = mesh.creases[:, 0] * n + mesh.creases[:, 1]
            row = np.clip(np.searchsorted(known, wanted), 0, len(known) - 1)
            found = known[row] == wanted
            np.maximum.at(sharpness, row[found], mesh.sharpness[found])
        points = np.zeros(len(mesh.vertices))
        np.maximum.at(points, mesh.points, mesh.point_sharpness)
        valence = np.bincount(edges.ravel(), minlength=len(mesh.vertices))
        return cls(edges, edge, edge[at], sharpness, points, valence)

    def sharp_count(self, edges: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Sharp edges at the vertices, (n,), and three more where the vertex itself is sharp.

        Two make a crease, more a corner.
        """
        return self.sum_over_edges(edges.astype(float)) + 3.0 * points

    def sum_over_edges(self, values: np.ndarray) -> np.ndarray:
        """Sums at the vertices of values of edges, (n, ...)."""
        return _sums(self.edges.ravel(), np.repeat(values, 2, axis=0), len(self.valence))

    def sum_of_neighbours(self, points: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Sums at the vertices of the points at the other ends of chosen edges, (n, 3)."""
        edges = self.edges[chosen]
        return _sums(edges.ravel(), points[edges[:, ::-1].ravel()], len(self.valence))


def _sums(at: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    if values.ndim == 1:
        return np.bincount(at, values, count)
    return np.column_stack([np.bincount(at, column, count) for column in values.T])


def subdivide(mesh: PolygonMesh, steps: int = 1) -> PolygonMesh:
    """A finer cage of the same surface, of quads only.

    Parameters
    ----------
    mesh : PolygonMesh
        Closed, as `mended` gives it.
    steps : int

    Returns
    -------
    PolygonMesh
        After each step: vertices of the mesh before, then one for each edge, one for each face.
        Quads are numbered in the order of the corners that they stand at.
    """
    for _ in range(steps):
        mesh = _step(mesh)
    return mesh


def _step(mesh: PolygonMesh) -> PolygonMesh:
    x, topology = mesh.vertices, Corners.of(mesh)
    edges, edge, sharp = topology.edges, topology.edge, topology.sharpness
    after = np.where(sharp >= SHARP, sharp, np.maximum(sharp - 1.0, 0.0))
    middle = np.add.reduceat(x[mesh.corners], mesh.start[:-1], axis=0) / mesh.sizes[:, None]
    half = 0.5 * (x[edges[:, 0]] + x[edges[:, 1]])
    # edges: half-way where sharp, else the mean of four points, and between for less than 1
    smooth = 0.5 * half + 0.25 * _sums(edge, middle[mesh.face_of], len(edges))
    share = np.minimum(sharp, 1.0)[:, None]
    on_edges = share * half + (1.0 - share) * smooth
    points = topology.point_sharpness
    points_after = np.where(points >= SHARP, points, np.maximum(points - 1.0, 0.0))
    now = _ruled(mesh, topology, middle, half, sharp, points)
    ends = (sharp > 0.0) & (after == 0.0)
    points_end = (points > 0.0) & (points_after == 0.0)
    if ends.any() or points_end.any():
        then = _ruled(mesh, topology, middle, half, after, points_after)
        weight = topology.sum_over_edges(np.where(ends, sharp, 0.0))
        weight += np.where(points_end, points, 0.0)
        count = topology.sum_over_edges(ends.astype(float)) + points_end
        weight = np.where(count > 0, np.minimum(weight / np.maximum(count, 1.0), 1.0), 1.0)
        now = weight[:, None] * now + (1.0 - weight[:, None]) * then
    n, e = len(x), len(edges)
    quads = np.column_stack([mesh.corners, n + edge, n + e + mesh.face_of, n + topology.before])
    kept = np.flatnonzero(after > 0.0)
    creases = np.concatenate([np.column_stack([edges[kept, k], n + kept]) for k in (0, 1)])
    return replace(
        mesh,
        vertices=np.concatenate([now, on_edges, middle]),
        corners=quads.ravel(),
        start=4 * np.arange(len(quads) + 1),
        creases=creases,
        sharpness=np.tile(after[kept], 2),
        points=np.flatnonzero(points_after),
        point_sharpness=points_after[points_after > 0.0],
        face_number=mesh.face_number[mesh.face_of],
        vertex_number=np.arange(n + e + len(mesh)),
    )


def _ruled(
    mesh: PolygonMesh,
    topology: Corners,
    middle: np.ndarray,
    half: np.ndarray,
    sharp: np.ndarray,
    points: np.ndarray,
) -> np.ndarray:
    """New places of the vertices by the number of sharp edges at them."""
    x, n = mesh.vertices, topology.valence[:, None].astype(float)
    around = _sums(mesh.corners, middle[mesh.face_of], len(x)) / n
    places = (around + 2.0 * topology.sum_over_edges(half) / n + (n - 3.0) * x) / n
    chosen = sharp > 0.0
    if chosen.any() or points.any():
        count = topology.sharp_count(chosen, points > 0.0)
        crease = 0.75 * x + 0.125 * topology.sum_of_neighbours(x, chosen)
        places = np.where((count == 2)[:, None], crease, places)
        places = np.where((count > 2)[:, None], x, places)
    return places


def limit_points(mesh: PolygonMesh) -> np.ndarray:
    """Where the vertices of a mesh of quads lie on the limit surface, (n, 3), mm.

    Exact where edges are smooth or sharp for good.
    """
    x, topology = mesh.vertices, Corners.of(mesh)
    quads = mesh.quads
    n = topology.valence[:, None].astype(float)
    every = np.ones(len(topology.edges), dtype=bool)
    across = _sums(quads.ravel(), x[np.roll(quads, 2, axis=1).ravel()], len(x))
    places = n * n * x + 4.0 * topology.sum_of_neighbours(x, every) + across
    places /= n * (n + 5.0)
    chosen, points = topology.sharpness > 0.0, topology.point_sharpness > 0.0
    if chosen.any() or points.any():
        count = topology.sharp_count(chosen, points)
        crease = (4.0 * x + topology.sum_of_neighbours(x, chosen)) / 6.0
        places = np.where((count == 2)[:, None], crease, places)
        places = np.where((count > 2)[:, None], x, places)
        darts, ends = dart_points(mesh, topology, chosen, count)
        places[darts] = ends
    return places


def dart_points(
    mesh: PolygonMesh, topology: Corners, sharp: np.ndarray, count: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Limits of vertices where one crease ends.

    Parameters
    ----------
    mesh : PolygonMesh
        Of quads.
    topology : Corners
    sharp : (e,) bool array
    count : (n,) array
        Sharp edges at each vertex.

    Returns
    -------
    vertices : (k,) int array
    places : (k, 3) array
        mm.
    """
    corner = np.flatnonzero(sharp[topology.edge] & (count[mesh.corners] == 1))
    vertices = mesh.corners[corner]
    places = np.empty((len(vertices), 3))
    order = np.argsort(topology.edge, kind="stable").reshape(-1, 2)
    twin = np.empty(len(mesh.corners), dtype=np.int64)
    twin[order[:, 0]], twin[order[:, 1]] = order[:, 1], order[:, 0]
    for n in np.unique(topology.valence[vertices]).tolist():
        rows = np.flatnonzero(topology.valence[vertices] == n)
        weights, at = _dart_weights(n), corner[rows]
        total = weights[0] * mesh.vertices[vertices[rows]]
        for k in range(n):
            first = at - at % 4
            beside, across = (mesh.corners[first + (at + step) % 4] for step in (1, 2))
            total += weights[1 + k] * mesh.vertices[beside]
            total += weights[1 + n + k] * mesh.vertices[across]
            at = twin[first + (at + 3) % 4]
        places[rows] = total
    return vertices, places


@cache
def _dart_weights(n: int) -> np.ndarray:
    """Weights of a vertex, of its neighbours from the crease on, and of what is across its faces.

    Those that subdivision repeats for ever; a vertex with n edges, (2 n + 1,).
    """
    own = np.eye(2 * n + 1)
    vertex, edges, faces = own[0], own[1 : n + 1], own[n + 1 :]
    middles = (vertex + edges + np.roll(edges, -1, axis=0) + faces) / 4.0
    beside = (vertex + edges + middles + np.roll(middles, 1, axis=0)) / 4.0
    beside[0] = (vertex + edges[0]) / 2.0
    centre = (middles.mean(axis=0) + (vertex + edges).mean(axis=0) + (n - 3.0) * vertex) / n
    step = np.concatenate([centre[None], beside, middles])
    return np.linalg.matrix_power(step, 256)[0]
