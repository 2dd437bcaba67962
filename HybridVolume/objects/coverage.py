# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Whether loads and supports on faces, edges and vertices of a body find the mesh's nodes.

The FEM workbench looks for nodes by distance, closer than the tolerance of the face, edge or
vertex. What it does not find gets no load, without a message: therefore every node is measured
against its CAD face here, at its own parameters, and looked for as the workbench does.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import Part

from HybridVolume.errors import FaultError

from .face_boxes import by_length, in_boxes
from .fem_mesh import MeshArrays
from .node_places import Places
from .node_search import SAMPLED_NODES, Found, Search, far, number_of, spread_out

logger = logging.getLogger(__name__)

SECONDS = 2.0
"""CPU seconds that looking for all nodes may take; where it would take longer, the sample does."""

WIDEST = 1e-5
"""Widest tolerance of a face that is used, as a share of the body's diagonal, where its patches
are exact."""

BEYOND = 3.0
"""Widest tolerance of a face that was covered, as a multiple of what the patches were allowed."""

_NAMED = 12
"""Names in a sentence at most; the others are counted."""

_NARROWEST = 1e-6
"""Smallest tolerance that is given to a face, mm."""

_ROUNDS = 3
"""So often faces on which nodes are missed still get wider tolerances."""

_ROOM = (2.0, 1.1)
"""Tolerances that are tried, as multiples of the distances of nodes: the next one where a face
would take nodes of its neighbours."""

_NARROWER = (0.7, 0.5, 0.35)
"""Shares of these tolerances that are tried for faces on which nodes are missed all the same. OCC
takes a face's tolerance for one of its parameters too, and loses nodes that are nearer to the
border by that; nodes are often nearer than they were measured at their own parameters."""


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
    inside : tuple of str
        Those of ``lost`` that no two faces share, such as seams and poles: where a face was
        covered, no line of the mesh need follow them; and walls inside the material.
    crowded : tuple of str
        Those faces among ``lost`` on which more than their nodes are found.
    widened : tuple of str
        Faces that have a wider tolerance in the copy because the patches on them were allowed to
        be beside them.
    converted : tuple of str
        Faces that are B-spline faces in the copy, because FreeCAD looks for nodes in a box that is
        smaller than the face as it was.
    relaid : tuple of str
        Faces whose parameters are lengths in the copy, because OCC misses places on them else.
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
    inside: tuple[str, ...] = ()
    crowded: tuple[str, ...] = ()
    widened: tuple[str, ...] = ()
    converted: tuple[str, ...] = ()
    relaid: tuple[str, ...] = ()

    @property
    def notes(self) -> list[str]:
        """What is to be told, for report.json's ``notes``."""
        return [*self.warnings, *self._about_copy()]

    @property
    def warnings(self) -> list[str]:
        """What loads would miss, or reach beside what they are put on."""
        told = []
        missed = [name for name in self.lost if name not in {*self.inside, *self.crowded}]
        if missed:
            remedy = (
                "cover the body with a smaller tolerance"
                if {*missed} & {*self.widened}
                else "a body in larger units may help"
            )
            told.append(
                f"FreeCAD does not find every node of the mesh on {_listed(missed)}: loads and"
                f" supports on them would be incomplete; {remedy}"
            )
        if self.crowded:
            told.append(
                f"FreeCAD finds nodes of other elements too on {_listed(self.crowded)}: loads and"
                " supports on them would reach too far; cover the body with a smaller tolerance"
            )
        return told

    def _about_copy(self) -> list[str]:
        """Why loads go on a copy of the body."""
        told = []
        if self.widened:
            told.append(
                f"loads and supports go on a copy of the body: {_listed(self.widened)}"
                f" {'has' if len(self.widened) == 1 else 'have'} a tolerance of up to"
                f" {self.tolerance:.2g} mm there, for the mesh's nodes are up to"
                f" {self.distance or 0.0:.2g} mm beside the CAD faces"
            )
        if self.converted:
            one = len(self.converted) == 1
            told.append(
                f"loads and supports go on a copy of the body: {_listed(self.converted)}"
                f" {'is a B-spline face' if one else 'are B-spline faces'} there, for FreeCAD looks"
                f" for nodes in a box that is smaller than the {'face' if one else 'faces'}"
            )
        if self.relaid:
            told.append(
                f"loads and supports go on a copy of the body: {_listed(self.relaid)}"
                f" {'has' if len(self.relaid) == 1 else 'have'} lengths as parameters there, for"
                " FreeCAD does not find every node otherwise"
            )
        return told

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
            "faces_widened": list(self.widened),
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
    # no mesh has nodes on walls inside the material
    inside = () if places is None or places.body.cover is None else places.body.cover.inside
    numbers = [n for n in range(1, len(shape.Faces) + 1) if n - 1 not in inside]
    known = {f"Face{n}": _nodes_of(arrays, f"Face{n}") for n in numbers}
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
    shape, converted, outside = in_boxes(arrays.nodes, known, shape)
    covered = places is not None and places.body.cover is not None
    search = partial(Search, arrays, known, seconds=seconds, covered=covered)
    found = search(shape, spread=places is not None).result
    relaid: list[str] = []
    measured_bad = [name for name in found.bad if measured[name] < shape.getTolerance(1, Part.Face)]
    other = by_length(shape, measured_bad) if places is not None and measured_bad else None
    if other is not None:
        again = search(other, spread=True).result
        if len(again.bad) < len(found.bad) and len(again.lost) <= len(found.lost):
            relaid = [name for name in measured_bad if name not in again.bad]
            shape, found = other, again
    # not only just within the tolerance
    allowed = {f"Face{n}": 0.9 * face.Tolerance for n, face in enumerate(shape.Faces, start=1)}
    beside = {name: value for name, value in measured.items() if value >= allowed[name]}
    copy, widened = shape if converted or relaid else None, []
    if beside or found.bad or found.lost or outside:
        slack = BEYOND * places.tolerance if places is not None else 0.0
        widest = max(WIDEST * shape.BoundBox.DiagonalLength, slack)
        wide, wider = _widened(search, arrays, shape, found, beside, outside, widest)
        if wide is not None:
            widened = sorted(beside, key=number_of) if slack else []
            copy, found, beside = wide, wider, {}
    if places is None:
        # nothing but the search tells where the nodes are
        beside |= _off(arrays, known, shape, found.bad)
    if beside:
        worst = max(beside.values())
        raise FaultError(
            f"mesh nodes lie up to {worst:.2g} mm beside the CAD faces; loads on them would be"
            " lost",
            faces=sorted(beside, key=number_of),
            figure=worst,
            remedy="heal the body and run again",
        )
    if found.strangers and not widened:
        raise FaultError(
            "loads on some CAD faces would act on elements of their neighbours too, so wide is"
            " the faces' tolerance",
            faces=found.strangers,
            figure=float(len(found.strangers)),
            remedy="heal the body, or choose larger elements",
        )
    used = copy or shape
    count = sum(map(len, known.values()))
    crowded = [name for name in found.strangers if name not in found.bad]
    walls = [f"Face{n + 1}" for n in sorted(inside)]
    coverage = Coverage(
        copy=copy,
        faces=len(known) - len(found.bad) - len(crowded),
        edges=found.edges,
        vertices=found.vertices,
        lost=(*found.bad, *crowded, *walls, *found.lost),
        nodes=count,
        measured=count if places is not None else 0,
        searched=found.searched,
        distance=max(measured.values()) if places is not None else None,
        tolerance=used.getTolerance(1, Part.Face),
        inside=(*walls, *(name for name in found.lost if name in found.inside)),
        crowded=tuple(crowded),
        widened=tuple(widened),
        converted=tuple(converted),
        relaid=tuple(relaid),
    )
    for note in coverage.warnings:
        logger.warning("%s", note)
    return coverage


def _widened(
    search: Callable[..., Search],
    arrays: MeshArrays,
    shape: Any,
    found: Found,
    beside: Mapping[str, float],
    outside: Mapping[str, float],
    widest: float,
) -> tuple[Any, Found] | tuple[None, None]:
    """A copy of a shape with wider tolerances and what is found on it; None where none helps.

    ``widest`` is the largest tolerance that may be given, mm.
    """
    needed: dict[str, float] = {}
    copy, wider = None, found
    for _ in range(_ROUNDS):
        # faces after the first bad one are looked at in full only once that one is mended; where
        # patches are beside a face, nodes on its border may be farther away than measured
        missed = {
            name: max(off, outside.get(name, 0.0))
            for name, off in _off(arrays, wider.missed, shape, wider.bad).items()
            if copy is not None or name not in beside
        }
        more = {k: v for k, v in {**missed, **wider.off}.items() if 2.0 * v <= widest}
        # of few nodes that were looked for first, others may be farther
        more = {k: v for k, v in more.items() if v > needed.get(k, 0.0)}
        if copy is None:
            more |= {k: v for k, v in outside.items() if 2.0 * v <= widest} | dict(beside)
        if not more:
            break
        needed |= more
        if 2.0 * max(needed.values()) > widest:
            return None, None
        copy, wider = _copy_with(search, shape, needed, beside)
        if not wider.bad and not wider.lost:
            break
    if copy is None:
        return None, None
    for share in _NARROWER:
        less = {name: share * needed[name] for name in wider.bad if name in needed}
        if not less:
            break
        trial, other = _copy_with(search, shape, needed | less, beside)
        if len(other.bad) < len(wider.bad) and len(other.strangers) <= len(wider.strangers):
            copy, wider = trial, other
            needed |= {name: value for name, value in less.items() if name not in other.bad}
    if wider.strangers and not beside:
        # some nodes that are missed do less harm than loads on neighbours
        return None, None
    fewer = len(wider.bad) + len(wider.lost) < len(found.bad) + len(found.lost)
    return (copy, wider) if beside or fewer else (None, None)


def _copy_with(
    search: Callable[..., Search],
    shape: Any,
    needed: Mapping[str, float],
    beside: Mapping[str, float],
) -> tuple[Any, Found]:
    """A copy whose parts are as wide as is needed, mm, and what is found on it."""
    for room in _ROOM:
        copy = shape.copy()
        for name, value in needed.items():
            kind = name.rstrip("0123456789")
            part = getattr(copy, "Vertexes" if kind == "Vertex" else f"{kind}s")
            # with its edges and vertices, which are never narrower than it
            part[number_of(name) - 1].limitTolerance(max(_NARROWEST, room * value))
        wider = search(copy, wide=beside).result
        if not wider.strangers:
            break
    return copy, wider


def _off(
    arrays: MeshArrays, known: Mapping[str, np.ndarray], shape: Any, names: Iterable[str]
) -> dict[str, float]:
    """Largest distance of some of the nodes of faces from them, as FreeCAD measures, mm."""
    faces, table = shape.Faces, {}
    for name in names:
        points = arrays.nodes[spread_out(known[name], SAMPLED_NODES)].tolist()
        table[name] = max(far(point, faces[number_of(name) - 1]) for point in points)
    return table


def _nodes_of(arrays: MeshArrays, name: str) -> np.ndarray:
    """Nodes on a face, sorted."""
    return np.unique(arrays.faces[name][1]) if name in arrays.faces else np.zeros(0, dtype=int)


def _listed(names: Iterable[str]) -> str:
    """Names in a sentence; of many the first."""
    names = list(names)
    return ", ".join(names[:_NAMED]) + (
        f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    )
