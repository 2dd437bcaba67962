# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Solids of one file that touch in an edge or a vertex only.

Parts of an assembly may touch in faces; solids that are joined in an edge or a vertex alone come
from a union that is not manifold. STEP keeps no record of the common edge: it is found again by
geometry.
"""

from __future__ import annotations

import logging
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from .. import errors

logger = logging.getLogger(__name__)

_TOUCH = 1e-7
"""Points closer than this share of the diagonal are one."""


class _Part:
    """A solid with the boxes of its pieces."""

    def __init__(self, solid: Any, name: str) -> None:
        self.solid, self.name = solid, name
        self.box = _boxes([solid])[0]

    @cached_property
    def vertices(self) -> list:
        return self.solid.Vertexes

    @cached_property
    def points(self) -> np.ndarray:
        return np.array([tuple(v.Point) for v in self.vertices]).reshape(-1, 3)

    @cached_property
    def edges(self) -> list:
        return [edge for edge in self.solid.Edges if not edge.Degenerated]

    @cached_property
    def edge_boxes(self) -> np.ndarray:
        return _boxes(self.edges)

    @cached_property
    def faces(self) -> list:
        return self.solid.Faces

    @cached_property
    def face_boxes(self) -> np.ndarray:
        return _boxes(self.faces)

    def near(self, point: np.ndarray, tolerance: float) -> bool:
        """Whether the solid's box holds a point."""
        return bool(_inside(self.box, point, tolerance))

    def has_on_edge(self, vertex: Any, point: np.ndarray, tolerance: float) -> bool:
        """Whether a vertex lies on a vertex or an edge of the solid."""
        if np.linalg.norm(self.points - point, axis=1).min(initial=np.inf) <= tolerance:
            return True
        close = np.flatnonzero(_inside(self.edge_boxes, point, tolerance))
        return any(vertex.distToShape(self.edges[k])[0] <= tolerance for k in close)

    def faces_at(self, point: np.ndarray, tolerance: float) -> list[int]:
        """Numbers of the faces that hold a point."""
        import FreeCAD
        import Part

        vertex = Part.Vertex(FreeCAD.Vector(*point))
        close = np.flatnonzero(_inside(self.face_boxes, point, tolerance))
        return [int(k) for k in close if vertex.distToShape(self.faces[k])[0] <= tolerance]


def _boxes(shapes: list) -> np.ndarray:
    boxes = [shape.BoundBox for shape in shapes]
    rows = [[(b.XMin, b.YMin, b.ZMin), (b.XMax, b.YMax, b.ZMax)] for b in boxes]
    return np.array(rows).reshape(-1, 2, 3)


def _inside(boxes: np.ndarray, point: np.ndarray, tolerance: float) -> np.ndarray:
    low, high = boxes[..., 0, :] - 2.0 * tolerance, boxes[..., 1, :] + 2.0 * tolerance
    return np.all((low <= point) & (point <= high), axis=-1)


def find_point_contacts(solids: list, names: list[str]) -> list[errors.NonManifoldError | None]:
    """For each solid the error that it is joined to another one in an edge or vertex only.

    Parameters
    ----------
    solids : list of Part.Solid
    names : list of str
        Their names.

    Returns
    -------
    list of NonManifoldError or None
    """
    found: list[errors.NonManifoldError | None] = [None] * len(solids)
    if len(solids) < 2:
        return found
    parts = [_Part(solid, name) for solid, name in zip(solids, names, strict=True)]
    boxes = np.array([part.box for part in parts])
    tolerance = _TOUCH * float(np.linalg.norm(boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0)))
    overlaps: dict[tuple, bool] = {}
    for i, j in combinations(range(len(parts)), 2):
        if np.any(boxes[i, 0] > boxes[j, 1] + tolerance):
            continue
        if np.any(boxes[j, 0] > boxes[i, 1] + tolerance):
            continue
        points = _contact_points(parts[i], parts[j], tolerance)
        for point in points:
            if _joined_in_faces(parts, i, j, point, tolerance, overlaps):
                continue
            where = "a vertex" if len(points) == 1 else "an edge"
            message = (
                f"{names[i]} and {names[j]} are joined in {where} only,"
                f" at ({point[0]:.6g}, {point[1]:.6g}, {point[2]:.6g}) mm"
            )
            for k in (i, j):
                if found[k] is None:
                    faces = parts[k].faces_at(point, tolerance)
                    found[k] = errors.NonManifoldError(
                        message,
                        faces=[f"Face{n + 1}" for n in faces],
                        remedy="join them in a face, move them apart, or save them as two files",
                    )
            break
    return found


def _contact_points(first: _Part, second: _Part, tolerance: float) -> np.ndarray:
    """Vertices of either solid that lie on an edge or vertex of the other."""
    found: list[np.ndarray] = []
    for one, other in ((first, second), (second, first)):
        for vertex, point in zip(one.vertices, one.points, strict=True):
            if not other.near(point, tolerance):
                continue
            if any(np.linalg.norm(point - known) <= 2.0 * tolerance for known in found):
                continue
            if other.has_on_edge(vertex, point, tolerance):
                found.append(point)
    return np.array(found).reshape(-1, 3)


def _joined_in_faces(
    parts: list[_Part],
    i: int,
    j: int,
    point: np.ndarray,
    tolerance: float,
    overlaps: dict[tuple, bool],
) -> bool:
    """Whether a chain of solids that touch in faces around the point leads from i to j."""
    around = {k: parts[k].faces_at(point, tolerance) for k in (i, j)}
    for k, part in enumerate(parts):
        if k not in around and part.near(point, tolerance):
            around[k] = part.faces_at(point, tolerance)

    def touch(k: int, other: int) -> bool:
        for a in around[k]:
            for b in around[other]:
                key = (k, a, other, b) if k < other else (other, b, k, a)
                if key not in overlaps:
                    overlaps[key] = _overlap(
                        parts[key[0]].faces[key[1]], parts[key[2]].faces[key[3]]
                    )
                if overlaps[key]:
                    return True
        return False

    reached, todo = {i}, [i]
    while todo and j not in reached:
        k = todo.pop()
        for other in [n for n in around if n not in reached]:
            if touch(k, other):
                reached.add(other)
                todo.append(other)
    return j in reached


def _overlap(first: Any, second: Any) -> bool:
    """Whether two faces have a common area."""
    import Part

    try:
        common = first.common(second)
    except (Part.OCCError, RuntimeError):
        logger.warning("the overlap of two faces could not be computed; they count as joined")
        return True
    return common.Area > 1e-6 * min(first.Area, second.Area)
