# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Solids each of whose faces is an untrimmed patch; what is none is refused by name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from .. import errors
from .faces import FaceReading, Refusal, face_edges, seam_edges, take_face

_UNTRIM = "give a body whose faces are whole, four-sided NURBS patches"

COVERED = (
    errors.TrimmedFaceError,
    errors.SeamError,
    errors.DegenerateSideError,
    errors.TJunctionError,
    errors.InexactFaceError,
)
"""Faces that are no patches, but can be covered with some."""


class EdgeUses:
    """How often each edge of a set of faces is used, and by which faces."""

    def __init__(self, faces: Iterable) -> None:
        self._buckets: dict[int, list[tuple[Any, list[int]]]] = {}
        for number, face in enumerate(faces):
            for edge in [*face_edges(face), *seam_edges(face)]:
                if not edge.Degenerated:
                    self._slot(edge).append(number)

    def _slot(self, edge: Any) -> list[int]:
        bucket = self._buckets.setdefault(edge.hashCode(), [])
        for known, uses in bucket:
            if known.isSame(edge):
                return uses
        bucket.append((edge, []))
        return bucket[-1][1]

    def faces_where(self, count: Any) -> list[int]:
        """Numbers of the faces with an edge whose number of uses satisfies ``count``."""
        return sorted(
            {
                k
                for bucket in self._buckets.values()
                for _, uses in bucket
                if count(len(uses))
                for k in uses
            }
        )


def free_faces(faces: list) -> list[str]:
    """Names of the faces with an edge that no other face has."""
    return names_of(EdgeUses(faces).faces_where(lambda n: n == 1))


def count_of(number: int, one: str, many: str = "") -> str:
    """A number and what it counts, in the singular or plural."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def names_of(numbers: Iterable[int]) -> list[str]:
    """Names of faces by their numbers from 0."""
    return [f"Face{k + 1}" for k in numbers]


def take_faces(solid: Any) -> list[FaceReading]:
    """Read a solid each of whose faces is a patch.

    Parameters
    ----------
    solid : Part.Solid

    Raises
    ------
    NonManifoldError, OpenBodyError
        It is no closed body.
    InputError
        One of `COVERED`: faces are no patches.
    """
    faces = solid.Faces
    box = solid.BoundBox
    if not faces or not np.isfinite(box.DiagonalLength):
        raise errors.InputError("the solid has no faces", remedy="give a closed solid")
    uses = EdgeUses(faces)
    crowded = uses.faces_where(lambda n: n > 2)
    if crowded:
        raise errors.NonManifoldError(
            "more than two faces meet at an edge",
            faces=names_of(crowded),
            figure=float(len(crowded)),
            remedy="give solids that are joined in faces, or separate solids",
        )
    free = uses.faces_where(lambda n: n == 1)
    if free:
        raise errors.OpenBodyError(
            f"the body is open: {count_of(len(free), 'face')} of {len(faces)}"
            f" {'has' if len(free) == 1 else 'have'} an edge without a neighbour",
            faces=names_of(free),
            figure=float(len(free)),
            remedy="close the body and make a solid of it",
        )
    found = [take_face(f, f"Face{i + 1}", box.DiagonalLength) for i, f in enumerate(faces)]
    _refuse(faces, found)
    return found


_REASONS = {
    "pole": (
        errors.DegenerateSideError,
        ("ends in a pole (a side without length)", "end in a pole (a side without length)"),
        ("pole face", "pole faces"),
        "rebuild the body with four-sided faces only",
    ),
    "seam": (
        errors.SeamError,
        ("meets itself along a seam", "meet themselves along a seam"),
        ("seam face", "seam faces"),
        "split the face along iso-parameter lines",
    ),
    "t-junction": (
        errors.TJunctionError,
        ("has a side that two neighbours share", "have a side that two neighbours share"),
        ("face with T-junctions", "faces with T-junctions"),
        "split the face at the vertex in its side",
    ),
    "trimmed": (
        errors.TrimmedFaceError,
        ("is trimmed", "are trimmed"),
        ("trimmed face", "trimmed faces"),
        _UNTRIM,
    ),
    "inexact": (
        errors.InexactFaceError,
        ("has no exact NURBS form", "have no exact NURBS form"),
        ("face without exact NURBS form", "faces without exact NURBS form"),
        "convert the body to NURBS first",
    ),
}
"""Kinds of refusal, the most telling first: class, words and names (one, many), remedy."""


def _refuse(faces: list, found: list[FaceReading | Refusal]) -> None:
    """Raise one error for all the faces of a body that cannot be taken."""
    by_kind: dict[str, list[int]] = {}
    for k, reading in enumerate(found):
        if isinstance(reading, Refusal):
            by_kind.setdefault(reading.kind, []).append(k)
    stops = _t_junctions(faces, found)
    if stops:
        by_kind["t-junction"] = stops
    kinds = [kind for kind in _REASONS if kind in by_kind]
    if not kinds:
        return
    first, numbers = kinds[0], by_kind[kinds[0]]
    error, words, _, remedy = _REASONS[first]
    message = f"{len(numbers)} of {count_of(len(faces), 'face')} {words[len(numbers) > 1]}"
    figure = float(len(numbers))
    if first == "inexact":
        figure = max(found[k].figure for k in numbers)
        message += f" (off by {figure:.2g} mm)"
    others = [count_of(len(by_kind[kind]), *_REASONS[kind][2]) for kind in kinds[1:]]
    if others:
        message += "; besides " + ", ".join(others)
    splines = ("Part::GeomBSplineSurface", "Part::GeomBezierSurface")
    if not any(face.Surface.TypeId in splines for face in faces):
        message += "; none of its faces is a B-spline face"
    raise error(message, faces=names_of(numbers), figure=figure, remedy=remedy)


def _t_junctions(faces: list, found: list[FaceReading | Refusal]) -> list[int]:
    """Faces with a vertex in a side that is a corner of another face.

    A vertex that stands in the middle of a side for every face around it does no harm.
    """
    middle: dict[int, list[tuple[Any, set[int]]]] = {}
    for k, reading in enumerate(found):
        for vertex in reading.vertices if isinstance(reading, FaceReading) else ():
            bucket = middle.setdefault(vertex.hashCode(), [])
            for known, owners in bucket:
                if known.isSame(vertex):
                    owners.add(k)
                    break
            else:
                bucket.append((vertex, {k}))
    if not middle:
        return []
    stopped: set[int] = set()
    for k, face in enumerate(faces):
        for vertex in face.Vertexes:
            for known, owners in middle.get(vertex.hashCode(), ()):
                if known.isSame(vertex) and k not in owners:
                    stopped |= owners
    return sorted(stopped)
