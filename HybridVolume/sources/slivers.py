# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Faces narrower than the tolerance, and narrow pieces of one surface, become part of a neighbour.

Quads on such a face would be as narrow, and so would be the elements below. Two ways are tried:
where the neighbour lies on the same surface both become one face, which changes no point of the
body; elsewhere the face is taken away and its neighbours are extended until they meet. What comes
out is checked against the body as it was given; where no way passes the face stays.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

logger = logging.getLogger(__name__)

NARROW = 10.0
"""Pieces of one surface are joined up to so many tolerances of width: that costs nothing."""

MOST = 50
"""More narrow faces than this are looked at together only, not one by one."""

_PLACES = (0.1, 0.3, 0.5, 0.7, 0.9)
_ALONG = np.linspace(0.0, 1.0, 9)


@dataclass(frozen=True)
class Merged:
    """A solid without its narrowest faces.

    Attributes
    ----------
    solid : Part.Solid
        The given one where nothing is merged.
    numbers : (n,) int array
        Face of the given solid that each face is, from 0.
    into : dict of int to int
        Faces of the given solid that are gone, and the neighbour that each became part of.
    moved : dict of int to float
        Faces whose border moved, and by how much at most, mm, at samples.
    """

    solid: Any
    numbers: np.ndarray
    into: dict[int, int]
    moved: dict[int, float]


def without_slivers(solid: Any, tolerance: float) -> Merged:
    """Merge narrow faces of a solid with their neighbours.

    Parameters
    ----------
    solid : Part.Solid
    tolerance : float
        Largest distance between the solid and what comes out, mm; the width (twice the area by the
        length of the border) below which a face is merged.

    Returns
    -------
    Merged
    """
    body = _Body(solid)
    found = Merged(solid, np.arange(len(body.faces)), {}, {})
    width = np.array([2.0 * face.Area / max(face.Length, 1e-300) for face in body.faces])
    narrow = np.flatnonzero(width < NARROW * tolerance).tolist()
    if not narrow or len(narrow) == len(body.faces):
        return found
    joined = body.same_surface(narrow)
    if joined:
        found = _tried(body, [joined], found, tolerance, _unified)
    left = [k for k in np.flatnonzero(width < tolerance).tolist() if k not in found.into]
    if left:
        wanted = {k: body.widest_neighbour(k, left) for k in left}
        wanted = {k: into for k, into in wanted.items() if into is not None}
        found = _tried(body, [wanted], found, tolerance, _without)
        single = [{k: into} for k, into in wanted.items() if k not in found.into]
        if 1 < len(wanted) <= MOST:
            found = _tried(body, single, found, tolerance, _without)
    if found.into:
        logger.info("%d narrow faces merged with neighbours", len(found.into))
    return found


class _Body:
    """Faces, edges and who is beside whom in the solid as it was given."""

    def __init__(self, solid: Any) -> None:
        self.solid = solid
        self.faces = list(solid.Faces)
        beside: dict[int, list[tuple[Any, list[int]]]] = {}
        for k, face in enumerate(self.faces):
            for edge in face.Edges:
                known = beside.setdefault(edge.hashCode(), [])
                own = next((faces for other, faces in known if other.isSame(edge)), None)
                if own is None:
                    known.append((edge, [k]))
                elif k not in own:
                    own.append(k)
        self.edges = [row for rows in beside.values() for row in rows]

    def between(self, a: int, b: int) -> list:
        """Edges of two faces."""
        return [edge for edge, faces in self.edges if a in faces and b in faces]

    def neighbours(self, k: int) -> dict[int, float]:
        """Faces beside a face and the length of what they share, mm."""
        found: dict[int, float] = {}
        for edge, faces in self.edges:
            if k in faces and not edge.Degenerated:
                for other in faces:
                    if other != k:
                        found[other] = found.get(other, 0.0) + edge.Length
        return found

    def widest_neighbour(self, k: int, narrow: Sequence[int]) -> int | None:
        """The neighbour that shares most with a narrow face and stays; None of an island."""
        near = {other: size for other, size in self.neighbours(k).items() if other not in narrow}
        return max(near, key=lambda other: (near[other], -other)) if near else None

    def same_surface(self, narrow: Sequence[int]) -> dict[int, int]:
        """Narrow faces with a neighbour, which is not narrow, that goes on on the same surface."""
        found = {}
        for k in narrow:
            near = self.neighbours(k)
            for other in sorted(near, key=lambda n: -near[n]):
                if other not in narrow and self._goes_on(k, other):
                    found[k] = other
                    break
        return found

    def _goes_on(self, k: int, other: int) -> bool:
        """Whether points of a face lie on the surface of another, which has the same normals."""
        a, b = self.faces[k], self.faces[other]
        if a.Surface.TypeId != b.Surface.TypeId:
            return False
        reach = 1e-9 * self.solid.BoundBox.DiagonalLength + 1e-12
        points = [p for edge in self.between(k, other) for p in _points_of_edge(edge)]
        for point in (*points, *_points_of_face(a)):
            foot = b.Surface.value(*b.Surface.parameter(point))
            if foot.distanceToPoint(point) > reach:
                return False
            n = a.normalAt(*a.Surface.parameter(point))
            if n.dot(b.normalAt(*b.Surface.parameter(point))) < 1.0 - 1e-9:
                return False
        return True


def _tried(
    body: _Body, ways: Sequence[dict[int, int]], found: Merged, tolerance: float, merge: Any
) -> Merged:
    """What was found, with those faces merged that can be; each way is narrow faces at once."""
    import Part

    for wanted in ways:
        try:
            made = merge(body, found, wanted)
        except (Part.OCCError, RuntimeError) as error:
            logger.info("narrow faces cannot be merged (%s)", error)
            continue
        better = made and _checked(body, found, made, wanted, tolerance)
        if better:
            found = better
    return found


def _unified(body: _Body, found: Merged, wanted: dict[int, int]) -> Any:
    """The solid with pieces of one surface joined."""
    import Part

    seams = [edge for k, into in wanted.items() for edge in body.between(k, into)]
    joining = Part.ShapeUpgrade.UnifySameDomain(found.solid, False, True, False)
    # everything else that lies on one surface was divided on purpose, for loads for instance
    for edge in found.solid.Edges:
        if not any(edge.isSame(seam) for seam in seams):
            joining.keepShape(edge)
    joining.build()
    return joining.shape()


def _without(_: _Body, found: Merged, wanted: dict[int, int]) -> Any:
    """The solid without faces, the others extended."""
    gone = [
        face
        for face, number in zip(found.solid.Faces, found.numbers.tolist(), strict=True)
        if number in wanted
    ]
    return found.solid.defeaturing(gone)


def _checked(
    body: _Body, before: Merged, made: Any, wanted: dict[int, int], tolerance: float
) -> Merged | None:
    """What was made, if it is a sound solid within the tolerance; None otherwise."""
    import Part

    if len(made.Solids) != 1 or len(made.Shells) != len(body.solid.Shells):
        return None
    (solid,) = made.Solids
    if not (solid.isClosed() and solid.isValid()):
        return None
    into = {**before.into, **wanted}
    if len(solid.Faces) != len(body.faces) - len(into):
        return None
    around = {*wanted, *(other for k in wanted for other in body.neighbours(k))}
    area = sum(body.faces[k].Area for k in around)
    if abs(solid.Volume - body.solid.Volume) > tolerance * area:
        return None
    numbers = _numbers(body, solid, set(into))
    if numbers is None:
        return None
    faces = solid.Faces
    new = [k for k, face in enumerate(faces) if not face.isSame(body.faces[int(numbers[k])])]
    here = Part.makeCompound(body.faces)
    there = Part.makeCompound([faces[k] for k in new])
    old_edges = {edge.hashCode() for edge, _ in body.edges}
    edges = [e for k in new for e in faces[k].Edges if e.hashCode() not in old_edges]
    off = _farthest([p for k in wanted for p in _points_of_face(body.faces[k])], there)
    off = max(off, _farthest([p for edge in edges for p in _points_of_edge(edge)], here))
    if not off <= tolerance:
        return None
    exact = off <= 1e-9 * body.solid.BoundBox.DiagonalLength
    moved = {} if exact else {k: off for k in sorted(around - set(wanted))}
    logger.info("%d narrow faces merged, %.2g mm off", len(wanted), off)
    return Merged(solid, numbers, into, {**before.moved, **moved})


def _numbers(body: _Body, solid: Any, gone: set[int]) -> np.ndarray | None:
    """Faces of the given solid that the faces of another are; None where that is not one each."""
    import Part

    left = [k for k in range(len(body.faces)) if k not in gone]
    known: dict[int, list[int]] = {}
    for k in left:
        known.setdefault(body.faces[k].hashCode(), []).append(k)
    found: list[int] = []
    for face in solid.Faces:
        same = [k for k in known.get(face.hashCode(), ()) if body.faces[k].isSame(face)]
        found.append(same[0] if same else -1)
    open_ = [k for k in left if k not in found]
    for row, number in enumerate(found):
        if number >= 0:
            continue
        points = _points_of_face(solid.Faces[row])
        # most of a face's points are on the one that it was
        off = [
            np.median([Part.Vertex(p).distToShape(body.faces[k])[0] for p in points]) for k in open_
        ]
        if not off:
            return None
        found[row] = open_[int(np.argmin(off))]
    return np.array(found) if sorted(found) == left else None


def _farthest(points: Sequence[Any], shape: Any) -> float:
    """Largest distance of points from a shape, mm."""
    import Part

    return max((Part.Vertex(point).distToShape(shape)[0] for point in points), default=0.0)


def _points_of_edge(edge: Any) -> list:
    if edge.Degenerated:
        return []
    first, last = edge.ParameterRange
    return [edge.valueAt(first + s * (last - first)) for s in _ALONG.tolist()]


def _points_of_face(face: Any) -> list:
    """Points inside a face; the middle of its edges where no point of a grid is inside."""
    limits = face.ParameterRange
    found = [
        face.valueAt(u, v)
        for u in (limits[0] + s * (limits[1] - limits[0]) for s in _PLACES)
        for v in (limits[2] + t * (limits[3] - limits[2]) for t in _PLACES)
        if face.isPartOfDomain(u, v)
    ]
    return found or [p for edge in face.Edges for p in _points_of_edge(edge)[4:5]]
