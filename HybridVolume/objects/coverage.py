# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Whether loads and supports on faces, edges and vertices of a body find the mesh's nodes.

The FEM workbench looks for nodes by distance, closer than the tolerance of the face, edge or
vertex. What it does not find gets no load, without a message: therefore every node is measured
against its CAD face here, at its own parameters, and looked for as the workbench does.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import Fem
import numpy as np
import Part
from scipy import spatial

from HybridVolume.errors import FaultError

from .fem_mesh import MeshArrays
from .node_places import Places

logger = logging.getLogger(__name__)

SAMPLED_NODES = 500
"""Nodes that are looked for on the CAD faces in any case: each costs OCC up to 7 ms."""

SECONDS = 2.0
"""CPU seconds that looking for all nodes may take; where it would take longer, the sample does."""

WIDEST = 1e-5
"""Widest tolerance of a face that is used, as a share of the body's diagonal."""

SAMPLED_FACES = 500
"""Faces that are looked at in any case, where the nodes of all are measured: each costs OCC 3 ms
before the first node."""

_BUNDLE = 64
"""Nodes in a mesh in which edges and vertices are looked for together."""

_NARROWEST = 1e-6
"""Smallest tolerance that is given to a face, mm."""


@dataclass(frozen=True)
class Coverage:
    """What FreeCAD finds of a mesh on a body.

    Attributes
    ----------
    copy : Part.Shape or None
        None where the body serves as it is, else a copy whose faces, edges and vertices have a
        tolerance wide enough.
    faces, edges, vertices : int
        Number of those on which the mesh's nodes are found.
    lost : tuple of str
        Those on which some are not, e.g. ``("Edge5",)``. Nodes of a face among them lie on it all
        the same: they were measured, and FreeCAD's search is what fails, as it does on bodies of a
        few µm.
    nodes : int
        Nodes on faces; one on several faces counts for each.
    measured : int
        So many of them were measured against their CAD face at their own parameters.
    searched : int
        So many of them were looked for as the FEM workbench does: all, or a spread sample, which
        leaves out faces where there are more than `SAMPLED_FACES`.
    distance : float or None
        Largest measured distance from a CAD face, mm; None where none was measured.
    tolerance : float
        Largest tolerance of a face of the body, or of its copy, mm.
    """

    copy: Any | None
    faces: int
    edges: int
    vertices: int
    lost: tuple[str, ...]
    nodes: int
    measured: int
    searched: int
    distance: float | None
    tolerance: float

    @property
    def notes(self) -> list[str]:
        """What is to be told, for report.json's ``notes``."""
        if not self.lost:
            return []
        return [
            f"FreeCAD does not find every node of the mesh on {', '.join(self.lost)}: loads and"
            " supports on them would be incomplete; a body in larger units may help"
        ]

    def figures(self) -> dict[str, Any]:
        """Figures for report.json's ``fem``."""
        return {
            "faces_covered": self.faces,
            "edges_covered": self.edges,
            "vertices_covered": self.vertices,
            "lost": list(self.lost),
            "face_nodes": self.nodes,
            "face_nodes_measured": self.measured,
            "face_nodes_searched": self.searched,
            "face_distance": self.distance,
            "face_tolerance": self.tolerance,
        }


def cover(
    arrays: MeshArrays, shape: Any, places: Places | None = None, seconds: float = SECONDS
) -> Coverage:
    """Make sure that FreeCAD finds the mesh's nodes on every face of a body.

    Parameters
    ----------
    arrays : MeshArrays
        With a group of faces ``FaceN`` for every face of the shape.
    shape : Part.Shape
    places : Places, optional
        Where the nodes should lie on its faces.
    seconds : float
        CPU seconds that looking for all nodes may take.

    Raises
    ------
    FaultError
        Nodes lie too far from a face, or those of another face lie on it too; the error names the
        faces.
    """
    known = {f"Face{n}": _nodes_of(arrays, f"Face{n}") for n in range(1, len(shape.Faces) + 1)}
    absent = [name for name, nodes in known.items() if not len(nodes)]
    if absent:
        raise FaultError(
            "the mesh has no nodes on some CAD faces; loads on them would be lost",
            faces=absent,
            remedy="run again on the body as it is now",
        )
    measured = dict.fromkeys(known, 0.0)
    if places is not None:
        measured = places.distances(known, arrays.nodes)
    found = _Search(arrays, known, shape, seconds, spread=places is not None).result
    # not only just within the tolerance
    allowed = {f"Face{n}": 0.9 * face.Tolerance for n, face in enumerate(shape.Faces, start=1)}
    beside = {name: value for name, value in measured.items() if value >= allowed[name]}
    copy = None
    if beside or found.bad or found.lost:
        copy, wider = _widened(arrays, known, shape, seconds, found, beside)
        if copy is not None:
            found, beside = wider, {}
    if places is None:
        # nothing but the search tells where the nodes are
        beside |= _off(arrays, known, shape, found.bad)
    if beside:
        worst = max(beside.values())
        raise FaultError(
            f"mesh nodes lie up to {worst:.2g} mm beside the CAD faces; loads on them would be"
            " lost",
            faces=sorted(beside, key=_number),
            figure=worst,
            remedy="heal the body and run again",
        )
    if found.strangers:
        raise FaultError(
            "loads on some CAD faces would act on elements of their neighbours too, so wide is"
            " the faces' tolerance",
            faces=found.strangers,
            figure=float(len(found.strangers)),
            remedy="heal the body, or choose larger elements",
        )
    used = copy or shape
    count = sum(map(len, known.values()))
    coverage = Coverage(
        copy=copy,
        faces=len(shape.Faces) - len(found.bad),
        edges=found.edges,
        vertices=found.vertices,
        lost=(*found.bad, *found.lost),
        nodes=count,
        measured=count if places is not None else 0,
        searched=found.searched,
        distance=max(measured.values()) if places is not None else None,
        tolerance=used.getTolerance(1, Part.Face),
    )
    for note in coverage.notes:
        logger.warning("%s", note)
    return coverage


def _widened(
    arrays: MeshArrays,
    known: Mapping[str, np.ndarray],
    shape: Any,
    seconds: float,
    found: _Found,
    beside: Mapping[str, float],
) -> tuple[Any, _Found] | tuple[None, None]:
    """A copy of a shape with a wider tolerance and what is found on it; None where none helps."""
    widest = WIDEST * shape.BoundBox.DiagonalLength
    distances = {**_off(arrays, known, shape, found.bad), **found.off}
    needed = [2.0 * value for value in beside.values()]
    needed += [2.0 * value for value in distances.values() if 2.0 * value <= widest]
    tolerance = max(_NARROWEST, *needed) if needed else np.inf
    if tolerance > widest:
        return None, None
    copy = shape.copy()
    copy.fixTolerance(tolerance)
    wider = _Search(arrays, known, copy, seconds).result
    fewer = len(wider.bad) + len(wider.lost) < len(found.bad) + len(found.lost)
    return (copy, wider) if beside or fewer else (None, None)


def _off(
    arrays: MeshArrays, known: Mapping[str, np.ndarray], shape: Any, names: Iterable[str]
) -> dict[str, float]:
    """Largest distance of some of the nodes of faces from them, as FreeCAD measures, mm."""
    faces, table = shape.Faces, {}
    for name in names:
        points = arrays.nodes[_spread(known[name], SAMPLED_NODES)].tolist()
        table[name] = max(_far(point, faces[_number(name) - 1]) for point in points)
    return table


def _number(name: str) -> int:
    """Number in a name such as ``"Face3"``."""
    return int(re.sub(r"\D", "", name))


def _nodes_of(arrays: MeshArrays, name: str) -> np.ndarray:
    """Nodes on a face, sorted."""
    return np.unique(arrays.faces[name][1]) if name in arrays.faces else np.zeros(0, dtype=int)


def _far(point: list[float], shape: Any) -> float:
    return Part.Vertex(*point).distToShape(shape)[0]


def _spread(known: np.ndarray, count: int) -> np.ndarray:
    """At most ``count`` nodes, spread evenly."""
    if len(known) <= count:
        return known
    return known[np.linspace(0, len(known) - 1, count).round().astype(int)]


@dataclass
class _Found:
    """What a search found."""

    bad: list[str] = field(default_factory=list)
    strangers: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    off: dict[str, float] = field(default_factory=dict)
    searched: int = 0
    edges: int = 0
    vertices: int = 0


class _Search:
    """Looks for the nodes of a mesh on a shape as the FEM workbench does.

    With ``spread``, where the nodes are measured as well, at most `SAMPLED_FACES` faces are looked
    at as long as nothing is missed there; edges and vertices all are.
    """

    def __init__(
        self,
        arrays: MeshArrays,
        known: Mapping[str, np.ndarray],
        shape: Any,
        seconds: float,
        *,
        spread: bool = False,
    ) -> None:
        self.arrays, self.known = arrays, known
        self.parts = {"Face": shape.Faces, "Edge": shape.Edges, "Vertex": shape.Vertexes}
        self.neighbours = _edges_by_faces(shape)
        self.result = _Found()
        self._faces(seconds, spread)
        self._edges_and_vertices()

    def _faces(self, seconds: float, spread: bool) -> None:
        share = max(4, SAMPLED_NODES // max(1, len(self.known)))
        sample = {name: _spread(nodes, share) for name, nodes in self.known.items()}
        looked, total = 0, sum(map(len, self.known.values()))
        names = list(self.known)
        first = [names[k] for k in _spread(np.arange(len(names)), SAMPLED_FACES)]
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

    def _missing(self, name: str, nodes: np.ndarray) -> bool:
        return len(self._find(name, "Face", nodes)) != len(nodes)

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

    def _find(self, name: str, kind: str, nodes: np.ndarray) -> np.ndarray:
        """Those of some nodes that FreeCAD finds on a part of the shape."""
        return nodes[self._probe(nodes).on(kind, self.parts[kind][_number(name) - 1])]

    def _probe(self, nodes: np.ndarray) -> _Probe:
        return _Probe(self.arrays.nodes[nodes])

    def _edges_and_vertices(self) -> None:
        """Nodes on the faces' common sides must be found on edges, and one on each vertex."""
        every, times = np.unique(np.concatenate(list(self.known.values())), return_counts=True)
        border = every[times > 1]
        corner = self._vertices(border)
        shared = set(border.tolist())
        sides = {name: shared.intersection(nodes.tolist()) for name, nodes in self.known.items()}
        todo = []
        for faces, edges in self.neighbours.items():
            side = set.intersection(*(sides[f"Face{n}"] for n in faces))
            if len(faces) == 1:
                side = shared
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
        points = self.arrays.nodes[_spread(rest, 50)].tolist()
        if not points:
            self.result.edges += len(edges)
            return
        apart = [[_far(p, self.parts["Edge"][n - 1]) for p in points] for n in edges]
        for number, near in zip(edges, _nearest(apart), strict=True):
            if near is None:
                self.result.edges += 1
            else:
                self._lose(f"Edge{number}", near)

    def _vertices(self, border: np.ndarray) -> dict[int, set[tuple[float, ...]]]:
        """Look for the nearest of some nodes on each vertex.

        Returns
        -------
        dict
            The vertices that each of these nodes is the nearest of.
        """
        result, parts = self.result, self.parts["Vertex"]
        places = [tuple(vertex.Point) for vertex in parts]
        corner: dict[int, set[tuple[float, ...]]] = {}
        if not len(border):
            for number in range(len(parts)):
                self._lose(f"Vertex{number + 1}", np.inf)
            return corner
        tree = spatial.cKDTree(self.arrays.nodes[border])
        apart, nearest = tree.query(np.array(places).reshape(-1, 3))
        for first in range(0, len(parts), _BUNDLE):
            some = range(first, min(first + _BUNDLE, len(parts)))
            probe = self._probe(border[nearest[some.start : some.stop]])
            for at, number in enumerate(some):
                corner.setdefault(int(border[nearest[number]]), set()).add(places[number])
                if at in probe.on("Vertex", parts[number]):
                    result.vertices += 1
                else:
                    self._lose(f"Vertex{number + 1}", float(apart[number]))
        return corner

    def _lose(self, name: str, off: float) -> None:
        self.result.lost.append(name)
        self.result.off[name] = off


class _Probe:
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


def _edges_by_faces(shape: Any) -> dict[tuple[int, ...], list[int]]:
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
