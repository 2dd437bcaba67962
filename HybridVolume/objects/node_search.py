# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Looking for the nodes of a mesh on faces, edges and vertices of a body as the FEM workbench does:
by distance, closer than the tolerance of the face, edge or vertex.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import Fem
import numpy as np
import Part
from scipy import spatial

from HybridVolume.sources.distances import surface_distances

from .fem_mesh import MeshArrays

SAMPLED_NODES = 500
"""Nodes that are looked for on the CAD faces in any case: each costs OCC up to 7 ms."""

SAMPLED_FACES = 500
"""Faces that are looked at in any case, where the nodes of all are measured: each costs OCC 3 ms
before the first node."""

BORDER_NODES = 2000
"""Nodes on the faces' borders that are looked for in any case where faces were covered: their
distance from a face is not that from its surface."""

_BUNDLE = 64
"""Nodes in a mesh in which edges and vertices are looked for together."""


@dataclass
class Found:
    """What a search found.

    Attributes
    ----------
    bad : list of str
        Faces on which nodes are not found.
    missed : dict of str to int array
        Nodes that were looked for on these faces and not found.
    strangers : list of str
        Faces on which a triangle of another face is found too, or a node inside the body.
    lost : list of str
        Edges and vertices on which nodes are not found.
    inside : set of str
        Those among them that no two faces share: seams, poles and tips.
    off : dict of str to float
        How far the nodes of what is lost are from it, mm.
    searched, edges, vertices : int
        Nodes that were looked for on faces; edges and vertices with their nodes.
    """

    bad: list[str] = field(default_factory=list)
    missed: dict[str, np.ndarray] = field(default_factory=dict)
    strangers: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    inside: set[str] = field(default_factory=set)
    off: dict[str, float] = field(default_factory=dict)
    searched: int = 0
    edges: int = 0
    vertices: int = 0


class Search:
    """Looks for the nodes of a mesh on a shape as the FEM workbench does.

    Parameters
    ----------
    arrays : MeshArrays
    known : mapping of str to int array
        Nodes of each face, sorted.
    shape : Part.Shape
    seconds : float
        CPU seconds that looking for all nodes may take; a spread sample is looked for otherwise.
    spread : bool
        The nodes are measured as well: at most `SAMPLED_FACES` faces are looked at as long as
        nothing is missed there; edges and vertices all are.
    wide : iterable of str
        Faces with a tolerance so wide that nodes beside them may be found in any case.
    covered : bool
        Nodes on the faces' borders may be beside the body's edges: up to `BORDER_NODES` of them
        are looked for in any case.

    Attributes
    ----------
    result : Found
    """

    def __init__(
        self,
        arrays: MeshArrays,
        known: Mapping[str, np.ndarray],
        shape: Any,
        seconds: float,
        *,
        spread: bool = False,
        wide: Iterable[str] = (),
        covered: bool = False,
    ) -> None:
        self.arrays, self.known, self.covered = arrays, known, covered
        self.parts = {"Face": shape.Faces, "Edge": shape.Edges, "Vertex": shape.Vertexes}
        self.neighbours = edges_by_faces(shape)
        self.result = Found()
        self._faces(seconds, spread)
        self.result.strangers += [
            name
            for name in wide
            if name not in self.result.strangers and self._reaches_too_far(name)
        ]
        self._edges_and_vertices()

    def _faces(self, seconds: float, spread: bool) -> None:
        share = max(4, SAMPLED_NODES // max(1, len(self.known)))
        sample = {name: spread_out(nodes, share) for name, nodes in self.known.items()}
        if self.covered:
            border = self._border()
            share = max(4, BORDER_NODES // max(1, len(self.known)))
            for name, nodes in self.known.items():
                own = np.intersect1d(nodes, border)
                near = self._nearest(np.setdiff1d(nodes, own), own)[:share]
                own = np.concatenate([spread_out(own, share), near])
                sample[name] = np.union1d(sample[name], own)
        looked, total = 0, sum(map(len, self.known.values()))
        names = list(self.known)
        first = [names[k] for k in spread_out(np.arange(len(names)), SAMPLED_FACES)]
        bad: list[str] = []
        started = time.thread_time()
        for some in (first, [name for name in names if name not in set(first)]):
            if some is not first and spread and not bad:
                break
            bad += [name for name in some if self._missing(name, sample[name])]
            looked += sum(len(sample[name]) for name in some)
        spent = time.thread_time() - started
        self.result.bad = [name for name in names if name in set(bad)]
        self.result.searched = looked
        if self.result.bad or spent * total > seconds * looked:
            return
        rest = {name: np.setdiff1d(nodes, sample[name]) for name, nodes in self.known.items()}
        self.result.bad = [name for name, nodes in rest.items() if self._missing(name, nodes)]
        self.result.searched = total
        self.result.strangers = self._strangers()

    def _border(self) -> np.ndarray:
        """Nodes on more than one face."""
        every, times = np.unique(np.concatenate(list(self.known.values())), return_counts=True)
        return every[times > 1]

    def _nearest(self, nodes: np.ndarray, border: np.ndarray) -> np.ndarray:
        """Nodes inside a face, those first that are nearest to nodes on its border.

        OCC loses some that are nearer than the face's tolerance, which it takes for one of the
        surface's parameters as well.
        """
        if not len(border):
            return nodes
        points = self.arrays.nodes
        return nodes[np.argsort(spatial.cKDTree(points[border]).query(points[nodes])[0])]

    def _missing(self, name: str, nodes: np.ndarray) -> bool:
        missed = np.setdiff1d(nodes, self._find(name, "Face", nodes))
        if len(missed):
            self.result.missed[name] = missed
        return bool(len(missed))

    def _strangers(self) -> list[str]:
        """Faces on which a whole triangle of another face lies as well."""
        rows = [rows for _, rows in self.arrays.faces.values()]
        owner = np.repeat(np.arange(len(rows)), [len(part) for part in rows])
        rows = np.concatenate(rows)
        order = np.argsort(rows, axis=None, kind="stable")
        start = np.searchsorted(rows.ravel()[order], np.arange(len(self.arrays.nodes) + 1))
        order //= rows.shape[1]
        strangers = []
        for number, name in enumerate(self.arrays.faces):
            own = self.known.get(name)
            if own is None:
                continue
            touching = np.unique(np.concatenate([order[start[n] : start[n + 1]] for n in own]))
            around = rows[touching[owner[touching] != number]]
            if not len(around):
                continue
            near = np.setdiff1d(around, own)
            both = np.union1d(own, self._find(name, "Face", near))
            if np.isin(around, both).all(axis=1).any():
                strangers.append(name)
        return strangers

    def _reaches_too_far(self, name: str) -> bool:
        """Whether a triangle of another face is found on a face, or a node inside the body."""
        own = np.zeros(len(self.arrays.nodes), dtype=bool)
        own[self.known[name]] = True
        outer = [rows[own[rows].any(axis=1)] for _, rows in self.arrays.faces.values()]
        inner = [rows[own[rows].any(axis=1)] for _, rows in self.arrays.volumes.values()]
        around = np.unique(np.concatenate([rows.ravel() for rows in (*outer, *inner)]))
        around = around[~own[around]]
        face = self.parts["Face"][number_of(name) - 1]
        # the surface is never farther than the face: OCC is asked about few nodes
        off = surface_distances(face, self.arrays.nodes[around])
        also = self._find(name, "Face", around[off <= face.Tolerance])
        if not len(also):
            return False
        boundary = np.zeros(len(own), dtype=bool)
        for _, rows in self.arrays.faces.values():
            boundary[rows] = True
        if not boundary[also].all():
            return True
        found = own.copy()
        found[also] = True
        # a triangle with all its nodes on its own face has none that is not of that face
        return any((found[rows].all(axis=1) & ~own[rows].all(axis=1)).any() for rows in outer)

    def _find(self, name: str, kind: str, nodes: np.ndarray) -> np.ndarray:
        """Those of some nodes that FreeCAD finds on a part of the shape."""
        return nodes[self._probe(nodes).on(kind, self.parts[kind][number_of(name) - 1])]

    def _probe(self, nodes: np.ndarray) -> Probe:
        return Probe(self.arrays.nodes[nodes])

    def _edges_and_vertices(self) -> None:
        """Nodes on the faces' common sides must be found on edges, and one on each vertex."""
        border, every = self._border(), np.unique(np.concatenate(list(self.known.values())))
        corner = self._vertices(border, every)
        shared = set(border.tolist())
        sides = {name: shared.intersection(nodes.tolist()) for name, nodes in self.known.items()}
        todo = []
        for around, edges in self.neighbours.items():
            # walls inside the material are no faces of the mesh
            faces = [n for n in around if f"Face{n}" in self.known]
            if not faces:
                for number in edges:
                    self.result.inside.add(f"Edge{number}")
                    self._lose(f"Edge{number}", np.inf)
                continue
            if len(faces) == 1:
                for number in edges:
                    self._inside(f"Face{faces[0]}", number)
                continue
            side = set.intersection(*(sides[f"Face{n}"] for n in faces))
            ends = {tuple(v.Point) for n in edges for v in self.parts["Edge"][n - 1].Vertexes}
            # two faces may touch at a vertex that is on none of their common edges
            side = {node for node in side if corner.get(node, ends) <= ends}
            todo.append((edges, np.array(sorted(side), dtype=int)))
        for some in _bundles(todo):
            # a mesh costs more than some nodes that lie elsewhere
            nodes = np.unique(np.concatenate([side for _, side in some]))
            probe = self._probe(nodes)
            for edges, side in some:
                found = [nodes[probe.on("Edge", self.parts["Edge"][n - 1])] for n in edges]
                rest = side[~np.isin(side, np.concatenate(found))]
                self._settle(edges, rest)

    def _settle(self, edges: list[int], rest: np.ndarray) -> None:
        """Count the edges of a side, of which some nodes may not have been found."""
        points = self.arrays.nodes[spread_out(rest, 50)].tolist()
        if not points:
            self.result.edges += len(edges)
            return
        apart = [[far(p, self.parts["Edge"][n - 1]) for p in points] for n in edges]
        for number, near in zip(edges, _nearest(apart), strict=True):
            if near is None:
                self.result.edges += 1
            else:
                self._lose(f"Edge{number}", near)

    def _inside(self, name: str, number: int) -> None:
        """Look for a line of the mesh along an edge inside one face, such as a seam."""
        edge, nodes = self.parts["Edge"][number - 1], self.known[name]
        found = self._find(f"Edge{number}", "Edge", nodes)
        if self._is_line(found, edge, self.arrays.faces[name][1]):
            self.result.edges += 1
        else:
            self.result.inside.add(f"Edge{number}")
            self._lose(f"Edge{number}", np.inf)

    def _is_line(self, nodes: np.ndarray, edge: Any, triangles: np.ndarray) -> bool:
        """Whether nodes follow an edge from end to end, each in a triangle with the next."""
        if len(nodes) < 2:
            return False
        points = [tuple(point) for point in self.arrays.nodes[nodes].tolist()]
        ends = [tuple(edge.valueAt(t)) for t in edge.ParameterRange]
        reach = 1.001 * max(vertex.Tolerance for vertex in edge.Vertexes)
        at_end = spatial.cKDTree(points).query(ends)
        if at_end[0].max() > reach:
            return False
        place = [edge.Curve.parameter(Part.Vertex(*point).Point) for point in points]
        order = nodes[np.argsort(place)]
        pairs = [*zip(order[:-1].tolist(), order[1:].tolist(), strict=True)]
        if edge.Curve.isClosed():
            # the place of the end may be the one or the other
            pairs.append((int(order[-1]), int(order[0])))
        rows = triangles[np.isin(triangles, nodes).sum(axis=1) > 1]
        together = [((rows == a).any(axis=1) & (rows == b).any(axis=1)).any() for a, b in pairs]
        return sum(together) >= len(nodes) - 1

    def _vertices(self, border: np.ndarray, every: np.ndarray) -> dict[int, set[tuple]]:
        """Look for the nearest of some nodes on each vertex.

        Returns
        -------
        dict
            The vertices that each of these nodes is the nearest of.
        """
        result, parts = self.result, self.parts["Vertex"]
        places = np.array([tuple(vertex.Point) for vertex in parts]).reshape(-1, 3)
        corner: dict[int, set[tuple]] = {}
        within = self._vertices_inside()
        apart, nearest = np.full(len(parts), np.inf), np.zeros(len(parts), dtype=int)
        for nodes, chosen in ((border, ~within), (every, within)):
            if len(nodes) and chosen.any():
                off, row = spatial.cKDTree(self.arrays.nodes[nodes]).query(places[chosen])
                apart[chosen], nearest[chosen] = off, nodes[row]
        result.inside |= {f"Vertex{k + 1}" for k in np.flatnonzero(within).tolist()}
        for first in range(0, len(parts), _BUNDLE):
            some = range(first, min(first + _BUNDLE, len(parts)))
            probe = self._probe(nearest[some.start : some.stop])
            for at, number in enumerate(some):
                if np.isfinite(apart[number]):
                    corner.setdefault(int(nearest[number]), set()).add(tuple(places[number]))
                if np.isfinite(apart[number]) and at in probe.on("Vertex", parts[number]):
                    result.vertices += 1
                else:
                    self._lose(f"Vertex{number + 1}", float(apart[number]))
        return corner

    def _vertices_inside(self) -> np.ndarray:
        """Which vertices are on one face only, bool."""
        owners: dict[int, list[tuple[Any, set[int]]]] = {}
        for number, face in enumerate(self.parts["Face"]):
            for vertex in face.Vertexes:
                bucket = owners.setdefault(vertex.hashCode(), [])
                for known, faces in bucket:
                    if known.isSame(vertex):
                        faces.add(number)
                        break
                else:
                    bucket.append((vertex, {number}))
        return np.array(
            [
                any(
                    known.isSame(vertex) and len(faces) == 1
                    for known, faces in owners.get(vertex.hashCode(), ())
                )
                for vertex in self.parts["Vertex"]
            ],
            dtype=bool,
        )

    def _lose(self, name: str, off: float) -> None:
        self.result.lost.append(name)
        self.result.off[name] = off


class Probe:
    """A mesh of some nodes only: every node in the box of a part costs time.

    Parameters
    ----------
    points : (n, 3) array
    """

    def __init__(self, points: np.ndarray) -> None:
        self._mesh = Fem.FemMesh()
        for number, (x, y, z) in enumerate(points.tolist(), start=1):
            self._mesh.addNode(x, y, z, number)

    def on(self, kind: str, part: Any) -> np.ndarray:
        """Numbers of the points, from 0, that FreeCAD finds on a face, edge or vertex."""
        return np.array(getattr(self._mesh, f"getNodesBy{kind}")(part), dtype=int) - 1


def number_of(name: str) -> int:
    """Number in a name such as ``"Face3"``."""
    return int(re.sub(r"\D", "", name))


def far(point: list[float], shape: Any) -> float:
    """Distance of a point from a shape as FreeCAD measures it, mm."""
    return Part.Vertex(*point).distToShape(shape)[0]


def spread_out(known: np.ndarray, count: int) -> np.ndarray:
    """At most ``count`` of some nodes, spread evenly."""
    if len(known) <= count:
        return known
    return known[np.linspace(0, len(known) - 1, count).round().astype(int)]


def _bundles(
    todo: Iterable[tuple[list[int], np.ndarray]],
) -> Iterator[list[tuple[list[int], np.ndarray]]]:
    """Sides with their nodes, as many together as have few nodes."""
    bundle: list[tuple[list[int], np.ndarray]] = []
    count = 0
    for edges, side in todo:
        if bundle and count + len(side) > _BUNDLE:
            yield bundle
            bundle, count = [], 0
        bundle.append((edges, side))
        count += len(side)
    if bundle:
        yield bundle


def _nearest(apart: Iterable[list[float]]) -> list[float | None]:
    """For each edge the largest distance of the points that are nearest to it; None without any."""
    table = np.array(list(apart))
    owner = table.argmin(axis=0)
    return [
        float(table[k, owner == k].max()) if (owner == k).any() else None for k in range(len(table))
    ]


def edges_by_faces(shape: Any) -> dict[tuple[int, ...], list[int]]:
    """Numbers of the edges (from 1) by the numbers of the faces that they belong to."""
    known: dict[int, list[tuple[Any, int, list[int]]]] = {}
    for number, edge in enumerate(shape.Edges, start=1):
        known.setdefault(edge.hashCode(), []).append((edge, number, []))
    for number, face in enumerate(shape.Faces, start=1):
        for edge in face.Edges:
            for other, _, faces in known.get(edge.hashCode(), ()):
                if edge.isSame(other) and number not in faces:
                    faces.append(number)
    table: dict[tuple[int, ...], list[int]] = {}
    for rows in known.values():
        for edge, number, faces in rows:
            if faces and not edge.Degenerated:
                table.setdefault(tuple(faces), []).append(number)
    return table
