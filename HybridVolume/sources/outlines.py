# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The outline of a FreeCAD solid: its vertices, edges and loops as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import errors
from ..core.covering.outline import Outline

SAMPLES = 33
"""Points of an edge at which its tangent is looked at."""


def outline_of(solid: Any) -> Outline:
    """Describe a solid.

    Parameters
    ----------
    solid : Part.Solid
        Without seams, see :func:`.imprint.imprint_seams`. Degenerate edges at poles are left out:
        the loop has a corner there.

    Raises
    ------
    InputError
        A face has no edges at all, or a loop that cannot be followed; it is named.
    """
    vertices, edges = _Register(solid.Vertexes), _Register(solid.Edges)
    ends = np.zeros((len(solid.Edges), 2), dtype=int)
    middle = np.zeros((len(solid.Edges), 3))
    length, turning = np.zeros(len(solid.Edges)), np.zeros(len(solid.Edges))
    for k, edge in enumerate(solid.Edges):
        if edge.Degenerated:
            continue
        ends[k] = [vertices.number(edge.firstVertex()), vertices.number(edge.lastVertex())]
        first, last = edge.ParameterRange
        middle[k] = tuple(edge.valueAt(0.5 * (first + last)))
        length[k] = edge.Length
        tangents = np.array(
            [tuple(edge.tangentAt(t)) for t in np.linspace(first, last, SAMPLES).tolist()]
        )
        turning[k] = _angles(tangents[:-1], tangents[1:]).sum()
    rows = []
    loops = 0
    for number, face in enumerate(solid.Faces):
        name = f"Face{number + 1}"
        found = [_loop(wire, face, edges, name) for wire in face.Wires]
        if not any(found):
            raise errors.InputError(
                "a face has no edges", faces=[name], remedy="split this face in the CAD program"
            )
        for loop in found:
            rows += [(number, loops, *row) for row in loop]
            loops += 1
    table = np.array(rows)
    points = np.array([tuple(vertex.Point) for vertex in solid.Vertexes])
    return Outline(
        points,
        ends,
        middle,
        length,
        turning,
        table[:, 0].astype(int),
        table[:, 1].astype(int),
        table[:, 2].astype(int),
        table[:, 3] > 0.5,
        table[:, 4],
    )


class _Register:
    """Numbers of shapes, which OCC hands out as ever new objects."""

    def __init__(self, shapes: list) -> None:
        self._known: dict[int, list] = {}
        for number, shape in enumerate(shapes):
            self._known.setdefault(shape.hashCode(), []).append((shape, number))

    def number(self, shape: Any) -> int:
        for other, number in self._known.get(shape.hashCode(), ()):
            if other.isSame(shape):
                return number
        raise KeyError("a shape that the solid has not")


def _loop(wire: Any, face: Any, edges: _Register, name: str) -> list[tuple[int, float, float]]:
    """Edges of a wire along it: number, whether forward, turn at its end."""
    ordered = [edge for edge in wire.OrderedEdges if not edge.Degenerated]
    if len(ordered) != sum(not edge.Degenerated for edge in wire.childShapes(True, True)):
        raise errors.InputError(
            "the edges of a face do not form closed loops",
            faces=[name],
            remedy="check and repair the solid in the CAD program",
        )
    if not ordered:
        return []
    begins, ends, points = [], [], []
    for edge in ordered:
        first, last = edge.ParameterRange
        forward = edge.Orientation == "Forward"
        sign = 1.0 if forward else -1.0
        begins.append(sign * np.array(tuple(edge.tangentAt(first if forward else last))))
        ends.append(sign * np.array(tuple(edge.tangentAt(last if forward else first))))
        points.append(edge.valueAt(last if forward else first))
    after = np.roll(np.array(begins), -1, axis=0)
    before = np.array(ends)
    normals = np.array([_normal(face, point) for point in points])
    # wires run such that the face lies to the left of them, seen along its outward normal
    sine = np.einsum("ij,ij->i", np.cross(before, after), normals)
    turn = np.arctan2(sine, np.einsum("ij,ij->i", before, after))
    return [
        (edges.number(edge), float(edge.Orientation == "Forward"), angle)
        for edge, angle in zip(ordered, turn.tolist(), strict=True)
    ]


def _normal(face: Any, point: Any) -> tuple:
    """The face's outward normal at one of its points; nothing where it has none."""
    try:
        return tuple(face.normalAt(*face.Surface.parameter(point)))
    except Exception as error:  # FreeCAD raises its base exception at poles
        if type(error).__module__ not in ("Base", "Part", "builtins"):
            raise
        return (0.0, 0.0, 0.0)


def _angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b))
