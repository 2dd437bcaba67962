# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The triangulated surface that patches are fitted to: nearest points on it and on its features."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ..polygons import PolygonMesh

SHARP = 25.0
"""Degrees by which the faces at an edge turn where it is a feature."""
BENT = 50.0
"""Degrees by which a line of features turns at a corner."""
SHORT = 0.01
"""Side of the pieces that triangles are looked up by, as a share of the diagonal."""
_NEAR = 12
"""Pieces around a point whose triangles are looked at."""


@dataclass(frozen=True)
class Chain:
    """Feature edges from one node to another, or all around.

    Attributes
    ----------
    vertices : (k,) int array
        In order; of a closed one the first is also the last.
    points : (k, 3) array
    """

    vertices: np.ndarray
    points: np.ndarray

    @property
    def closed(self) -> bool:
        """Whether it comes back to where it began."""
        return self.vertices[0] == self.vertices[-1]

    @cached_property
    def length(self) -> np.ndarray:
        """Length from the begin to each point, (k,)."""
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    def at(self, length: np.ndarray) -> np.ndarray:
        """Points at lengths from the begin, (m, 3); closed chains go round and round."""
        length = np.asarray(length, dtype=float)
        if self.closed:
            length = np.mod(length, self.length[-1])
        return np.stack([np.interp(length, self.length, c) for c in self.points.T], axis=-1)

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lengths from the begin of the nearest points, (m,), and their distances, (m,)."""
        start, step = self.points[:-1], np.diff(self.points, axis=0)
        to = points[:, None] - start
        share = np.einsum("mki,ki->mk", to, step) / np.maximum((step**2).sum(axis=1), 1e-300)
        share = np.clip(share, 0.0, 1.0)
        off = np.linalg.norm(to - share[..., None] * step, axis=2)
        best = off.argmin(axis=1)
        rows = np.arange(len(points))
        length = self.length[best] + share[rows, best] * np.diff(self.length)[best]
        return length, off[rows, best]

    def reversed(self) -> Chain:
        """The same, the other way round."""
        return Chain(self.vertices[::-1], self.points[::-1])


def edge_turns(mesh: PolygonMesh) -> tuple[np.ndarray, np.ndarray]:
    """Ends (e, 2) of all edges and by how many degrees the faces turn there, (e,)."""
    ends, edge = mesh.edges
    order = np.argsort(edge, kind="stable").reshape(-1, 2)
    normal = mesh.area_vectors()
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    one, other = (normal[mesh.face_of[order[:, k]]] for k in (0, 1))
    sine = np.linalg.norm(np.cross(one, other), axis=1)
    return ends, np.degrees(np.arctan2(sine, (one * other).sum(axis=1)))


def feature_nodes(points: np.ndarray, edges: np.ndarray, bent: float = BENT) -> np.ndarray:
    """Vertices of feature lines where these end, meet or turn sharply, sorted.

    Parameters
    ----------
    points : (n, 3) array
    edges : (e, 2) int array
        Feature edges.
    bent : float
        Degrees.
    """
    degree = np.bincount(edges.ravel(), minlength=len(points))
    nodes = set(np.flatnonzero((degree != 2) & (degree > 0)).tolist())
    around: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        around.setdefault(a, []).append(b)
        around.setdefault(b, []).append(a)
    for vertex, others in around.items():
        if len(others) == 2:
            one, other = (points[o] - points[vertex] for o in others)
            cosine = -(one @ other) / max(np.linalg.norm(one) * np.linalg.norm(other), 1e-300)
            if cosine < np.cos(np.radians(bent)):
                nodes.add(vertex)
    return np.array(sorted(nodes), dtype=int)


def feature_chains(points: np.ndarray, edges: np.ndarray, nodes: np.ndarray) -> list[Chain]:
    """Feature edges as chains between nodes, and closed ones without nodes."""
    around: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        around.setdefault(a, []).append(b)
        around.setdefault(b, []).append(a)
    ends = set(nodes.tolist())
    seen: set[tuple[int, int]] = set()
    chains = []
    for start in [*nodes.tolist(), *(v for v in around if v not in ends)]:
        for other in around.get(start, []):
            if (start, other) in seen:
                continue
            way = [start, other]
            while way[-1] not in ends and way[-1] != start:
                (after,) = [v for v in around[way[-1]] if v != way[-2]] or [way[-2]]
                way.append(after)
            seen.update(zip(way, way[1:], strict=False))
            seen.update(zip(way[1:], way, strict=False))
            chains.append(Chain(np.array(way), points[way]))
    return chains


class Reference:
    """A closed triangulated surface.

    Parameters
    ----------
    mesh : PolygonMesh
        Mended; other faces than triangles are cut into fans.
    sharp : float
        Degrees by which faces turn at features.
    """

    def __init__(self, mesh: PolygonMesh, sharp: float = SHARP) -> None:
        self.mesh = mesh
        self.vertices = mesh.vertices
        self.triangles, _ = mesh.triangles()
        x = self.vertices[self.triangles]
        self.normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        self.normals /= np.maximum(np.linalg.norm(self.normals, axis=1, keepdims=True), 1e-300)
        ends, turn = edge_turns(mesh)
        self.feature_edges = ends[turn > sharp]
        self.nodes = feature_nodes(self.vertices, self.feature_edges)
        self.chains = feature_chains(self.vertices, self.feature_edges, self.nodes)
        # long triangles are far from their centres: places all along them are looked up
        size = np.linalg.norm(np.ptp(self.vertices, axis=0))
        places, self._owner = _pieces(x, SHORT * size)
        self._tree = cKDTree(places)

    @property
    def diagonal(self) -> float:
        """Of the bounding box, mm."""
        return self.mesh.diagonal

    def nearest(
        self, points: np.ndarray, normals: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Nearest points (m, 3) and their triangles (m,).

        Parameters
        ----------
        points : (m, 3) array
        normals : (m, 3) array, optional
            Triangles that look another way (by more than 70 degrees) do not count where others do.
        """
        points = np.asarray(points, dtype=float)
        found, triangle = np.empty_like(points), np.empty(len(points), dtype=int)
        for start in range(0, len(points), 20_000):
            part = slice(start, start + 20_000)
            _, rows = self._tree.query(points[part], _NEAR)
            candidates = self._owner[rows]
            near = _on_triangles(points[part][:, None], self.vertices[self.triangles[candidates]])
            off = np.linalg.norm(near - points[part][:, None], axis=2)
            if normals is not None:
                look = np.einsum("mki,mi->mk", self.normals[candidates], normals[part])
                off = np.where(look < 0.34, off + self.diagonal, off)
            best = off.argmin(axis=1)
            at = np.arange(len(best))
            found[part], triangle[part] = near[at, best], candidates[at, best]
        return found, triangle


def _pieces(x: np.ndarray, short: float) -> tuple[np.ndarray, np.ndarray]:
    """Middles (p, 3) of triangles (t, 3, 3) halved across their longest sides, and whose they are.

    Halved until no side is longer than ``short``: a thin triangle has pieces along, not across.
    """
    owner = np.arange(len(x))
    middles, owners = [], []
    while len(x):
        side = np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2)
        first = side.argmax(axis=1)
        done = side.max(axis=1) <= short
        middles.append(x[done].mean(axis=1))
        owners.append(owner[done])
        x, owner, first = x[~done], owner[~done], first[~done]
        rows = np.arange(len(x))
        a, b, c = (x[rows, (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        x = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
        owner = np.concatenate([owner, owner])
    return np.concatenate(middles), np.concatenate(owners)


def _on_triangles(p: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Nearest points of triangles (..., 3, 3) to points (..., 3)."""
    a, b, c = x[..., 0, :], x[..., 1, :], x[..., 2, :]
    best = _on_segment(p, a, b)
    off = ((best - p) ** 2).sum(axis=-1)
    for start, end in ((b, c), (c, a)):
        other = _on_segment(p, start, end)
        away = ((other - p) ** 2).sum(axis=-1)
        closer = away < off
        best, off = np.where(closer[..., None], other, best), np.where(closer, away, off)
    # inside: the foot on the plane has positive shares of all corners
    ab, ac, ap = b - a, c - a, p - a
    d00, d01, d11 = (ab * ab).sum(-1), (ab * ac).sum(-1), (ac * ac).sum(-1)
    d20, d21 = (ap * ab).sum(-1), (ap * ac).sum(-1)
    det = np.maximum(d00 * d11 - d01 * d01, 1e-300)
    v, w = (d11 * d20 - d01 * d21) / det, (d00 * d21 - d01 * d20) / det
    inside = (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0)
    foot = a + v[..., None] * ab + w[..., None] * ac
    return np.where(inside[..., None], foot, best)


def _on_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    step = b - a
    share = ((p - a) * step).sum(axis=-1) / np.maximum((step * step).sum(axis=-1), 1e-300)
    return a + np.clip(share, 0.0, 1.0)[..., None] * step
