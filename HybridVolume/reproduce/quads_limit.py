# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How far the patches of a cage are from the limit of its subdivision.

The limit is found here once more, by a subdivision that shares nothing with
`HybridVolume.core.subdivision`: rules as matrices between vertices, edges and faces, and at the end
the places that the masks of the limit give to the vertices, which lie on the limit surface itself.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from HybridVolume.core.catmull_clark import catmull_clark, default_steps
from HybridVolume.core.polygon_repair import bodies, mended
from HybridVolume.core.polygons import PolygonMesh
from HybridVolume.sources.polygon_files import read_polygons

from .quads_inputs import torus_cage
from .quads_pieces import distances, pieces_of

FOREVER = 10.0
"""Sharpness from which on a crease stays."""
POINTS = 15_000
"""Points of the limit surface that are measured, at least; each subdivision makes four times as
many."""
QUADS = 6_000
"""Quads of the patches up to which another subdivision before them is measured as well."""
STEPS = (0, 1, 2, 3)
"""Subdivisions before the patches."""


@dataclass(frozen=True)
class Cage:
    """A cage by its incidences.

    Attributes
    ----------
    x : (n, 3) array
    corner_face, corner_vertex : (nc,) int arrays
        Face and vertex of each corner, in the order of the faces.
    edges : (e, 2) int array
    corner_edge : (nc,) int array
        The edge after each corner.
    sharpness : (e,) array
    """

    x: np.ndarray
    corner_face: np.ndarray
    corner_vertex: np.ndarray
    edges: np.ndarray
    corner_edge: np.ndarray
    sharpness: np.ndarray

    def matrices(self) -> tuple[csr_matrix, csr_matrix, csr_matrix]:
        """Means over faces' corners (f, n) and edges' ends (e, n), and edges' faces (e, f)."""
        corners, n = len(self.corner_face), len(self.x)
        faces = self.corner_face[-1] + 1
        one = np.ones(corners)
        face = csr_matrix((one, (self.corner_face, self.corner_vertex)), (faces, n))
        face = csr_matrix(face.multiply(1.0 / face.sum(axis=1)))
        e = len(self.edges)
        half = csr_matrix(
            (np.full(2 * e, 0.5), (np.repeat(np.arange(e), 2), self.edges.ravel())), (e, n)
        )
        beside = csr_matrix((one, (self.corner_edge, self.corner_face)), (e, faces))
        return face, half, beside

    def refine(self) -> Cage:
        """The next finer cage."""
        face, half, beside = self.matrices()
        middles, halves = face @ self.x, half @ self.x
        share = np.clip(self.sharpness, 0.0, 1.0)[:, None]
        smooth = 0.5 * halves + 0.25 * (beside @ middles)
        on_edges = share * halves + (1.0 - share) * smooth
        after = np.where(
            self.sharpness >= FOREVER, self.sharpness, np.clip(self.sharpness - 1.0, 0.0, None)
        )
        now = self._vertices(middles, halves, self.sharpness > 0.0)
        if np.any((self.sharpness > 0.0) & (after == 0.0)):
            # a crease that ends in this step leads over from its rule to the one without it
            then = self._vertices(middles, halves, after > 0.0)
            ending = np.where(after == 0.0, self.sharpness, 0.0)
            total = self._at_vertices(ending)
            count = self._at_vertices((ending > 0.0).astype(float))
            weight = np.where(count > 0.0, np.clip(total / np.maximum(count, 1.0), 0.0, 1.0), 1.0)
            now = weight[:, None] * now + (1.0 - weight[:, None]) * then
        n, e = len(self.x), len(self.edges)
        first = np.concatenate([[0], np.flatnonzero(np.diff(self.corner_face)) + 1])
        size = np.diff(np.concatenate([first, [len(self.corner_face)]]))
        before = np.arange(len(self.corner_face)) - 1
        before[first] = first + size - 1
        quads = np.column_stack(
            [
                self.corner_vertex,
                n + self.corner_edge,
                n + e + self.corner_face,
                n + self.corner_edge[before],
            ]
        )
        sharp = np.flatnonzero(after > 0.0)
        creases = np.concatenate(
            [np.column_stack([self.edges[sharp, k], n + sharp]) for k in (0, 1)]
        )
        return cage_of(
            np.concatenate([now, on_edges, middles]), quads, creases, np.tile(after[sharp], 2)
        )

    def _at_vertices(self, values: np.ndarray) -> np.ndarray:
        """Sums of values of edges at their ends."""
        total = np.zeros(len(self.x))
        np.add.at(total, self.edges[:, 0], values)
        np.add.at(total, self.edges[:, 1], values)
        return total

    def _vertices(self, middles: np.ndarray, halves: np.ndarray, sharp: np.ndarray) -> np.ndarray:
        """New places of the vertices by the rule for their number of sharp edges."""
        n = len(self.x)
        valence = self._at_vertices(np.ones(len(self.edges)))[:, None]
        one = np.ones(len(self.corner_face))
        around = csr_matrix((one, (self.corner_vertex, self.corner_face)), (n, len(middles)))
        spokes = csr_matrix(
            (np.ones(2 * len(self.edges)),
             (self.edges.ravel(), np.repeat(np.arange(len(self.edges)), 2))),
            (n, len(self.edges)),
        )  # fmt: skip
        q, r = (around @ middles) / valence, (spokes @ halves) / valence
        places = (q + 2.0 * r + (valence - 3.0) * self.x) / valence
        count = spokes @ sharp.astype(float)
        # (6 x + a + b) / 8 by the midpoints of both creases
        along = 0.5 * self.x + 0.25 * (spokes[:, sharp] @ halves[sharp])
        places[count == 2.0] = along[count == 2.0]
        places[count > 2.0] = self.x[count > 2.0]
        return places

    def limit(self) -> np.ndarray:
        """Where the vertices of a cage of quads lie on the limit surface, (n, 3).

        On creases that stay and elsewhere; not at the very end of one.
        """
        face, half, _ = self.matrices()
        middles, halves = face @ self.x, half @ self.x
        ones = np.ones(len(self.edges))
        valence = self._at_vertices(ones)[:, None]
        sums = np.zeros_like(self.x)
        for k in (0, 1):
            np.add.at(sums, self.edges[:, k], halves)
        across = np.zeros_like(self.x)
        np.add.at(across, self.corner_vertex, middles[self.corner_face])
        # limit mask n² x + 4 sum of neighbours + sum of opposite corners, by mid-points:
        # 4 f = x + next + opposite + before summed over n faces is n x + 2 sum of neighbours + ...
        neighbours = 2.0 * sums - valence * self.x
        opposite = 4.0 * across - valence * self.x - 2.0 * neighbours
        places = (valence**2 * self.x + 4.0 * neighbours + opposite) / (valence * (valence + 5.0))
        sharp = self.sharpness > 0.0
        count = self._at_vertices(sharp.astype(float))
        ends = np.zeros_like(self.x)
        for k in (0, 1):
            np.add.at(ends, self.edges[sharp, k], self.x[self.edges[sharp, 1 - k]])
        crease = (4.0 * self.x + ends) / 6.0
        places[count == 2.0] = crease[count == 2.0]
        places[count > 2.0] = self.x[count > 2.0]
        return places


def cage_of(
    x: np.ndarray, faces: Any, creases: np.ndarray | None = None, sharpness: Any = ()
) -> Cage:
    """A cage of faces, lists of vertices or an (nf, 4) array, and creases (k, 2)."""
    size = np.array([len(face) for face in faces])
    vertex = np.concatenate([np.asarray(face) for face in faces])
    face = np.repeat(np.arange(len(size)), size)
    last = np.cumsum(size) - 1
    following = np.concatenate([vertex[1:], vertex[:1]])
    following[last] = vertex[last - size + 1]
    pairs = np.sort(np.column_stack([vertex, following]), axis=1)
    edges, corner_edge = np.unique(pairs, axis=0, return_inverse=True)
    sharp = np.zeros(len(edges))
    if creases is not None and len(creases):
        found = {tuple(pair): k for k, pair in enumerate(edges.tolist())}
        for pair, value in zip(np.sort(creases, axis=1).tolist(), sharpness, strict=True):
            if tuple(pair) in found:
                sharp[found[tuple(pair)]] = max(sharp[found[tuple(pair)]], value)
    return Cage(np.asarray(x, float), face, vertex, edges, corner_edge.reshape(-1), sharp)


def refined_cage(mesh: PolygonMesh, steps: int) -> Cage:
    """The cage of a mesh after some subdivisions."""
    faces = np.split(mesh.corners, mesh.start[1:-1])
    cage = cage_of(mesh.vertices, faces, mesh.creases, mesh.sharpness)
    for _ in range(steps):
        cage = cage.refine()
    return cage


def make(task: Mapping[str, Any]) -> dict[str, Any]:
    """Distances of the limit surface from the patches, for several subdivisions before them.

    Parameters
    ----------
    task : mapping
        ``file``, or ``torus`` (quads around and across).

    Returns
    -------
    dict
        ``rows``, each with ``steps`` (``default`` where nobody asks for others), ``quads``,
        ``patches``, the largest distance ``distance`` and the root mean square ``rms``, both mm,
        ``share`` of the diagonal, and ``told``, what the program itself says, mm.
    """
    if "torus" in task:
        mesh = PolygonMesh.of(*torus_cage(*task["torus"]))
    else:
        mesh = read_polygons(task["file"])
    (mesh,) = bodies(mended(mesh, cage=True), cage=True)
    cage, depth = refined_cage(mesh, 0), 0
    while len(cage.x) < POINTS:
        cage, depth = cage.refine(), depth + 1
    points = cage.limit()
    usual = max(default_steps(mesh), int((mesh.sizes != 4).any()))
    rows = []
    for steps in STEPS:
        if steps == 0 and (mesh.sizes != 4).any():
            continue
        started = time.process_time()
        made = catmull_clark(mesh, steps)
        if rows and made.quads > QUADS:
            break
        spent = time.process_time() - started
        pieces = pieces_of(made.faces)
        off = distances(pieces, points)
        rows.append(
            {
                "steps": steps,
                "default": steps == usual,
                "quads": made.quads,
                "patches": len(made.faces),
                "distance": float(off.max()),
                "rms": float(np.sqrt((off**2).mean())),
                "share": float(off.max() / pieces.diagonal),
                "told": made.distance,
                "seconds_cpu": spent,
            }
        )
    return {"points": len(points), "depth": depth, "creases": len(mesh.creases), "rows": rows}
