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
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import Fem
import numpy as np
import Part

from HybridVolume.errors import FaultError
from HybridVolume.sources.faces import distance_of_points

from .fem_mesh import MeshArrays

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh
    from HybridVolume.core.surface import PatchSurface
    from HybridVolume.sources import Body

logger = logging.getLogger(__name__)

SAMPLED_NODES = 500
"""Nodes that are looked for on the CAD faces in any case: each costs OCC up to 7 ms."""

SECONDS = 2.0
"""CPU seconds that looking for all nodes may take; where it would take longer, the sample does."""

WIDEST = 1e-5
"""Widest tolerance of a face that is used, as a share of the body's diagonal."""

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
        So many of them were looked for as the FEM workbench does: all, or a spread sample.
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


@dataclass(frozen=True)
class Places:
    """Where a mesh's outer nodes lie on the patches, and the patches on the CAD faces.

    Attributes
    ----------
    surface : PatchSurface
    body : Body
    patch : (n,) int array
        Patch of each node of the mesh, -1 inside.
    uv : (n, 2) array
        Its parameters there.
    """

    surface: PatchSurface
    body: Body
    patch: np.ndarray
    uv: np.ndarray

    @classmethod
    def of(cls, fem: FiniteElementMesh, surface: PatchSurface, body: Body) -> Places | None:
        """Places of the nodes of a mesh; None where it does not tell them."""
        if not len(fem.surface_nodes):
            return None
        patch = np.full(len(fem.nodes), -1)
        uv = np.full((len(fem.nodes), 2), np.nan)
        patch[fem.surface_nodes] = fem.surface_patch
        uv[fem.surface_nodes] = fem.surface_uv
        return cls(surface, body, patch, uv)

    def distance(self, name: str, known: np.ndarray, nodes: np.ndarray) -> float:
        """Largest distance of nodes from a CAD face at their own parameters, mm.

        Parameters
        ----------
        name : str
        known : (m,) int array
            Nodes on it.
        nodes : (n, 3) array
            All nodes.
        """
        patch, face, domain = self._by_name[name]
        points = nodes[known]
        u, v = self._parameters(patch, known, points).T
        if domain is None:
            return distance_of_points(points, u, v, face, None)
        ways = [(v, u)] if self._turned(patch) else [(u, v)]
        if self._turned(patch) is None:
            ways = [(u, v), (v, u)]
        return min(distance_of_points(points, s, t, face, domain) for s, t in ways)

    @cached_property
    def _by_name(self) -> dict[str, tuple[int, Any, tuple | None]]:
        """Patch, CAD face and its rectangle of parameters by the face's name."""
        patches = {patch.face: k for k, patch in enumerate(self.surface.patches)}
        faces = self.body.shape.Faces
        return {
            face.name: (patches[face.name], faces[_number(face.name) - 1], domain)
            for face, domain in zip(self.body.faces, self.body.domains, strict=True)
        }

    def _turned(self, patch: int) -> bool | None:
        turned = self.surface.turned
        return bool(turned[patch]) if len(turned) else None

    def _parameters(self, patch: int, known: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Parameters of nodes on a patch, (m, 2); of nodes of a neighbour too."""
        uv = self.uv[known].copy()
        others = np.flatnonzero(self.patch[known] != patch)
        if len(others):
            # sides that meet have the same parameters, either way: one of these is the place
            t = uv[others].ravel()
            ends = [np.zeros_like(t), np.ones_like(t)]
            along = [t, 1.0 - t]
            tried = [np.column_stack([e, a]) for e in ends for a in along]
            tried = np.stack([*tried, *(pair[:, ::-1] for pair in tried)])
            tried = tried.reshape(8, len(others), 2, 2).transpose(1, 0, 2, 3).reshape(-1, 16, 2)
            at = self.surface.evaluate(patch, *tried.reshape(-1, 2).T).reshape(-1, 16, 3)
            best = np.linalg.norm(at - points[others, None], axis=2).argmin(axis=1)
            uv[others] = tried[np.arange(len(others)), best]
        return uv


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
        measured = {name: places.distance(name, n, arrays.nodes) for name, n in known.items()}
    found = _Search(arrays, known, shape, seconds).result
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
    """Looks for the nodes of a mesh on a shape as the FEM workbench does."""

    def __init__(
        self, arrays: MeshArrays, known: Mapping[str, np.ndarray], shape: Any, seconds: float
    ) -> None:
        self.arrays, self.known = arrays, known
        self.parts = {"Face": shape.Faces, "Edge": shape.Edges, "Vertex": shape.Vertexes}
        self.neighbours = _edges_by_faces(shape)
        self.result = _Found()
        self._faces(seconds)
        self._edges_and_vertices()

    def _faces(self, seconds: float) -> None:
        share = max(4, SAMPLED_NODES // max(1, len(self.known)))
        sample = {name: _spread(nodes, share) for name, nodes in self.known.items()}
        started = time.thread_time()
        self.result.bad = [name for name in self.known if self._missing(name, sample[name])]
        spent = time.thread_time() - started
        looked, total = (sum(map(len, table.values())) for table in (sample, self.known))
        self.result.searched = looked
        if self.result.bad or spent * total > seconds * looked:
            return
        rest = {name: np.setdiff1d(nodes, sample[name]) for name, nodes in self.known.items()}
        self.result.bad = [name for name, nodes in rest.items() if self._missing(name, nodes)]
        self.result.searched = total
        self.result.strangers = [name for name in self.known if self._acts_on_others(name)]

    def _missing(self, name: str, nodes: np.ndarray) -> bool:
        return len(self._find(name, "Face", nodes)) != len(nodes)

    def _acts_on_others(self, name: str) -> bool:
        """Whether a whole triangle of another face lies on a face as well."""
        own = self.known[name]
        around = [
            rows[np.isin(rows, own).any(axis=1)]
            for other, (_, rows) in self.arrays.faces.items()
            if other != name
        ]
        around = [rows for rows in around if len(rows)]
        if not around:
            return False
        near = np.setdiff1d(np.concatenate([rows.ravel() for rows in around]), own)
        both = np.union1d(own, self._find(name, "Face", near))
        return any(np.isin(rows, both).all(axis=1).any() for rows in around)

    def _find(self, name: str, kind: str, nodes: np.ndarray) -> np.ndarray:
        """Those of some nodes that FreeCAD finds on a part of the shape."""
        # A mesh of these nodes only: every node in the part's box costs time.
        probe = Fem.FemMesh()
        for number, (x, y, z) in enumerate(self.arrays.nodes[nodes].tolist()):
            probe.addNode(x, y, z, number + 1)
        found = getattr(probe, f"getNodesBy{kind}")(self.parts[kind][_number(name) - 1])
        return nodes[np.array(found, dtype=int) - 1]

    def _edges_and_vertices(self) -> None:
        """Nodes on the faces' common sides must be found on edges, and one on each vertex."""
        result = self.result
        every, times = np.unique(np.concatenate(list(self.known.values())), return_counts=True)
        border = every[times > 1]
        corner: dict[tuple[float, ...], int] = {}
        for number, vertex in enumerate(self.parts["Vertex"], start=1):
            apart = np.linalg.norm(self.arrays.nodes[border] - tuple(vertex.Point), axis=1)
            nearest = border[apart.argsort()[:1]]
            if len(self._find(f"Vertex{number}", "Vertex", nearest)):
                result.vertices += 1
            else:
                self._lose(f"Vertex{number}", float(apart.min(initial=np.inf)))
            if len(nearest):
                corner[tuple(vertex.Point)] = int(nearest[0])
        for faces, edges in self.neighbours.items():
            sides = [self.known[f"Face{n}"] for n in faces]
            side = np.intersect1d(sides[0], sides[-1]) if len(sides) > 1 else border
            ends = {tuple(v.Point) for n in edges for v in self.parts["Edge"][n - 1].Vertexes}
            # two faces may touch at a vertex that is on none of their common edges
            side = np.setdiff1d(side, [node for at, node in corner.items() if at not in ends])
            rest = side
            for number in edges:
                rest = np.setdiff1d(rest, self._find(f"Edge{number}", "Edge", side))
            points = self.arrays.nodes[_spread(rest, 50)].tolist()
            apart = [[_far(p, self.parts["Edge"][n - 1]) for p in points] for n in edges]
            for number, near in zip(edges, _nearest(apart), strict=True):
                if near is None:
                    result.edges += 1
                else:
                    self._lose(f"Edge{number}", near)

    def _lose(self, name: str, off: float) -> None:
        self.result.lost.append(name)
        self.result.off[name] = off


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
