# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Faces that reach out of the box in which FreeCAD looks for their nodes.

``getNodesByFace`` measures only nodes within the box that OCC gives for the face without
triangles. OCC samples extruded and revolved surfaces, and some tori, for it: a cam of 27 mm reaches
out of its box by 0.05 mm. Boxes of B-spline surfaces hold all their poles.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import Part

from .node_search import edges_by_faces, number_of

_SAFE = 0.5
"""Nodes are outside where they are farther from the box than this share of the tolerance."""

_SPLINES = ("Part::GeomBSplineSurface", "Part::GeomBezierSurface", "Part::GeomPlane")
"""Surfaces that conversion does not change, or whose box comes from their edges."""


def in_boxes(
    nodes: np.ndarray, known: Mapping[str, np.ndarray], shape: Any
) -> tuple[Any, list[str], dict[str, float]]:
    """A shape whose faces do not reach out of their boxes, as far as conversion helps.

    Parameters
    ----------
    nodes : (n, 3) array
        mm.
    known : mapping of str to int array
        Nodes of each face ``FaceN``.
    shape : Part.Shape

    Returns
    -------
    shape : Part.Shape
        The given one, or a copy with the same numbers of faces, edges and vertices.
    converted : list of str
        Faces that are B-spline faces in the copy.
    outside : dict of str to float
        How far nodes of other faces are outside their boxes, mm.
    """
    outside = _outside(nodes, known, shape)
    faces = shape.Faces if outside else ()
    odd = [name for name in outside if _face(faces, name).Surface.TypeId not in _SPLINES]
    copy = _with_splines(shape, odd) if odd else None
    if copy is None:
        return shape, [], outside
    left = _outside(nodes, known, copy)
    return copy, odd, left


def _outside(nodes: np.ndarray, known: Mapping[str, np.ndarray], shape: Any) -> dict[str, float]:
    """How far nodes are outside the boxes of their faces, mm, where that is too far."""
    found = {}
    faces = shape.Faces  # a new list of all at each call
    for name, own in known.items():
        face = _face(faces, name)
        # a copy has no triangles, which would make the box a good one
        box = face.copy().BoundBox
        low, high = nodes[own].min(axis=0), nodes[own].max(axis=0)
        off = max(
            float((np.array([box.XMin, box.YMin, box.ZMin]) - low).max()),
            float((high - np.array([box.XMax, box.YMax, box.ZMax])).max()),
        )
        if off > _SAFE * face.Tolerance:
            found[name] = off
    return found


def _face(faces: Sequence[Any], name: str) -> Any:
    return faces[number_of(name) - 1]


def _with_splines(shape: Any, names: list[str]) -> Any | None:
    """A copy in which faces are B-spline faces; None where it is not the same otherwise."""
    splines = shape.toNurbs()
    if not _is_same(shape, splines):
        return None
    # FreeCAD measures distances from B-spline planes several times as slowly as from planes
    faces, others = shape.Faces, splines.Faces
    for number in map(number_of, names):
        faces[number - 1] = others[number - 1]
    mixed = Part.makeCompound(faces).copy()
    mixed.sewShape(max(face.Tolerance for face in faces))
    shells = mixed.Shells
    if len(shells) == 1 and shells[0].isClosed():
        solid = Part.Solid(shells[0])
        if solid.Volume < 0.0:
            solid.reverse()
        if solid.isValid() and _is_same(shape, solid):
            return solid
    return splines


def by_length(shape: Any, names: Iterable[str]) -> Any | None:
    """A copy in which B-spline faces without holes have lengths in mm as their parameters.

    OCC misses places on faces whose parameters are far from lengths, however near the places are:
    14 of 189 nodes on a face of .03 mm over the unit square.

    Parameters
    ----------
    shape : Part.Shape
    names : iterable of str
        Faces ``FaceN``; those with holes, or no B-spline faces, stay as they are.

    Returns
    -------
    Part.Shape or None
        With the same numbers of faces, edges and vertices; None where nothing could be changed,
        or the numbers would.
    """
    # of copied edges, for curves on the new surfaces are added to them
    own = shape.copy()
    faces, pairs = own.Faces, []
    for name in names:
        face = _face(faces, name)
        if face.Surface.TypeId != _SPLINES[0] or len(face.Wires) > 1:
            continue
        pairs.append((face, Part.Face(_of_lengths(face.Surface), face.OuterWire)))
    if not pairs:
        return None
    copy = own.replaceShape(pairs).copy()
    widest = shape.getTolerance(1)
    copy.fix(widest, widest, 10.0 * widest)
    sound = copy.isValid() and abs(copy.Volume - shape.Volume) < 1e-6 * abs(shape.Volume)
    return copy if sound and _is_same(shape, copy) else None


def _of_lengths(surface: Any) -> Any:
    """The same B-spline surface with parameters as long as the lines in its middle."""
    low_u, high_u, low_v, high_v = surface.bounds()
    along = [surface.vIso(0.5 * (low_v + high_v)), surface.uIso(0.5 * (low_u + high_u))]
    knots = [np.array(surface.getUKnots()), np.array(surface.getVKnots())]
    for axis in (0, 1):
        knots[axis] *= along[axis].toShape().Length / np.ptp(knots[axis])
    made = Part.BSplineSurface()
    made.buildFromPolesMultsKnots(
        surface.getPoles(),
        surface.getUMultiplicities(),
        surface.getVMultiplicities(),
        knots[0].tolist(),
        knots[1].tolist(),
        surface.isUPeriodic(),
        surface.isVPeriodic(),
        surface.UDegree,
        surface.VDegree,
        surface.getWeights(),
    )
    return made


def _is_same(shape: Any, copy: Any) -> bool:
    """Whether a copy has the same faces, edges and vertices at the same numbers."""
    kinds = ("Faces", "Edges", "Vertexes")
    if any(len(getattr(shape, kind)) != len(getattr(copy, kind)) for kind in kinds):
        return False
    reach = 1e-6 * shape.BoundBox.DiagonalLength
    for one, other in zip(shape.Vertexes, copy.Vertexes, strict=True):
        if one.Point.distanceToPoint(other.Point) > reach + other.Tolerance:
            return False
    for one, other in zip(shape.Edges, copy.Edges, strict=True):
        if one.Degenerated or other.Degenerated:
            if one.Degenerated != other.Degenerated:
                return False
            continue
        middle = one.valueAt(0.5 * sum(one.ParameterRange))
        if Part.Vertex(middle).distToShape(other)[0] > reach + other.Tolerance:
            return False
    return edges_by_faces(shape) == edges_by_faces(copy)
