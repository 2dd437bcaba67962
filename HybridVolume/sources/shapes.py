# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""FreeCAD shapes to bodies of untrimmed NURBS faces; what cannot be taken is refused by name."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .. import errors
from ..core.polygons import PolygonMesh
from ..core.surface import SplineFace
from ..protocol import Progress
from .contacts import find_point_contacts
from .covering import Covered, Covering, is_known
from .faces import FaceReading, Refusal, face_edges, take_face
from .geometry import converted_geometry, covered_geometry

logger = logging.getLogger(__name__)

_UNTRIM = "give a body whose faces are whole, four-sided NURBS patches"

_COVERED = (
    errors.TrimmedFaceError,
    errors.SeamError,
    errors.DegenerateSideError,
    errors.TJunctionError,
    errors.InexactFaceError,
)
"""Faces that are no patches, but can be covered with some."""


@dataclass(frozen=True)
class MeshOrigin:
    """The mesh that a body was made from, and how.

    Attributes
    ----------
    file : str
        Name of its file.
    mesh : PolygonMesh
        Mended, with the numbers of the file.
    scheme : str
    steps : int or None
    sharp_angle : float
        As `sources.meshes.Surfacing` has them.
    """

    file: str
    mesh: PolygonMesh
    scheme: str
    steps: int | None
    sharp_angle: float


@dataclass(frozen=True)
class Body:
    """One solid as the source gives it.

    Attributes
    ----------
    name : str
    faces : tuple of SplineFace
        Named ``Face1``, ``Face2``, ... after FreeCAD's faces, in their order where each is one
        patch; of a covered body the name of a face stands as often as it has patches. Empty when
        the body is refused.
    shape : Part.Solid
        As it was given, in global coordinates, mm.
    error : InputError or None
        Why the body is refused.
    domains : tuple
        For each face the rectangle ``(u0, u1, v0, v1)`` of its B-spline surface, or None where a
        converted face has other parameters.
    origin : dict
        What is known about where the body comes from, for the report: ``geometry``, see
        :mod:`.geometry`; of a mesh file ``mesh``.
    mesh : MeshOrigin or None
        The mesh itself that it was made from.
    cover : Covered or None
        How the faces were covered with patches; None where each is one patch itself.
    """

    name: str
    faces: tuple[SplineFace, ...]
    shape: Any = field(repr=False)
    error: errors.InputError | None = None
    domains: tuple = ()
    origin: dict[str, Any] = field(default_factory=dict)
    mesh: MeshOrigin | None = field(default=None, repr=False)
    cover: Covered | None = field(default=None, repr=False)


def read_object(document_object: Any, **keywords: Any) -> list[Body]:
    """Bodies of a FreeCAD document object, in global coordinates.

    Parameters
    ----------
    document_object : App.DocumentObject
        Anything with a shape: a Part feature, a PartDesign body, a Part container, a link.
    **keywords
        As for :func:`read_shape`.

    Raises
    ------
    InputError
        As :func:`read_shape`.
    """
    found = read_shape(global_shape(document_object), document_object.Label, **keywords)
    proxy = getattr(document_object, "Proxy", None)
    if getattr(proxy, "Type", "") != "HybridVolume::MeshBody":
        return found
    own = proxy.origin(document_object)
    return [replace(body, origin={**body.origin, **own}) for body in found]


def coverings(
    document_object: Any,
    *,
    tolerance: float | None = None,
    free_only: bool = False,
    python: str | None = None,
) -> list[Covering]:
    """What has to be done before a document object can be read at once.

    Parameters
    ----------
    document_object : App.DocumentObject
    tolerance, free_only, python
        As for :func:`read_shape`.

    Returns
    -------
    list of Covering
        New ones, one for each solid that needs a cover and has neither one nor a refusal in
        memory. None of an object that is refused altogether: reading tells why.

    Raises
    ------
    InputError
        The tolerance is no length.
    """
    shape = global_shape(document_object)
    if shape.isNull():
        return []
    try:
        solids = _solids(shape)
    except errors.InputError:
        return []
    names = _body_names(document_object.Label, len(solids))
    return [
        Covering(solid, tolerance, free_only=free_only, python=python, name=name)
        for solid, name, body in zip(solids, names, _read_solids(names, solids), strict=True)
        if isinstance(body.error, _COVERED) and not is_known(solid, tolerance, free_only=free_only)
    ]


def global_shape(document_object: Any) -> Any:
    """The shape of a document object (Part.Shape) in global coordinates."""
    import Part

    shape = Part.getShape(document_object)
    if hasattr(document_object, "getGlobalPlacement") and hasattr(document_object, "Placement"):
        parent = document_object.getGlobalPlacement() * document_object.Placement.inverse()
        # our own handle on the document's geometry is moved, nothing else
        shape.Placement = parent * shape.Placement
    return shape


def read_shape(
    shape: Any,
    name: str = "Body",
    *,
    cover: bool = True,
    tolerance: float | None = None,
    free_only: bool = False,
    python: str | None = None,
    progress: Callable[[str, Progress], None] | None = None,
) -> list[Body]:
    """Bodies of a shape, one a solid.

    A solid with a face that is no untrimmed patch is covered with patches, see :mod:`.covering`,
    in a process that this waits for.

    Parameters
    ----------
    shape : Part.Shape
        A solid, or anything that holds solids or closed shells.
    name : str
        Name of the body; several bodies get a number behind it.
    cover : bool
        False: refuse trimmed faces, seams, poles and T-junctions.
    tolerance : float, optional
        Largest distance of patches from the faces of a solid that is covered, mm; 1e-4 of the
        diagonal by default.
    free_only : bool
        Cover without the GPL parts.
    python : str, optional
        Interpreter for the covering; :func:`..worker_process.worker_python` otherwise.
    progress : callable, optional
        Called now and then with the name of the body that is covered and how far it is.

    Returns
    -------
    list of Body
        Refused bodies carry their error; at least one is not refused.

    Raises
    ------
    InputError
        One of its kinds, when there is no solid or every body is refused.
    SetupError
        A solid has to be covered, and there is no Python for it.
    """
    if shape.isNull():
        raise errors.InputError("the shape is empty", remedy="give a closed solid")
    solids = _solids(shape)
    names = _body_names(name, len(solids))
    bodies = _read_solids(names, solids)
    for k, body in enumerate(bodies if cover else ()):
        if isinstance(body.error, _COVERED):
            covering = Covering(
                body.shape, tolerance, free_only=free_only, python=python, name=body.name
            )
            bodies[k] = _covered(covering, progress)
    refused = [body for body in bodies if body.error is not None]
    if len(refused) == len(bodies):
        _raise_all(refused)
    for body in refused:
        logger.warning("%s is refused: %s", body.name, body.error.line)
    return bodies


def _body_names(name: str, count: int) -> list[str]:
    return [name] if count == 1 else [f"{name}_{i + 1}" for i in range(count)]


def _read_solids(names: Sequence[str], solids: Sequence[Any]) -> list[Body]:
    """Solids as they are; those with faces that are no patches carry an error of `_COVERED`."""
    bodies = [_read_solid(solid, own) for solid, own in zip(solids, names, strict=True)]
    usable = [
        k for k, body in enumerate(bodies) if not body.error or isinstance(body.error, _COVERED)
    ]
    contacts = find_point_contacts([solids[k] for k in usable], [names[k] for k in usable])
    for k, error in zip(usable, contacts, strict=True):
        if error is not None:
            bodies[k] = Body(names[k], (), solids[k], error)
    return bodies


def _covered(covering: Covering, progress: Callable[[str, Progress], None] | None) -> Body:
    """A body of patches on the faces of a solid."""
    try:
        cover = covering.run(lambda news: progress(covering.name, news) if progress else None)
    except errors.SetupError:
        raise
    except errors.HybridVolumeError as error:
        return Body(covering.name, (), covering.solid, error)
    return Body(
        covering.name,
        cover.faces,
        covering.solid,
        None,
        (None,) * len(cover.faces),
        {"geometry": covered_geometry(covering.solid, cover)},
        cover=cover,
    )


def _raise_all(bodies: list[Body]) -> None:
    first = bodies[0].error
    if len(bodies) == 1:
        raise first
    raise type(first)(
        f"{first.message} ({bodies[0].name}; {_count(len(bodies) - 1, 'more solid')} refused too)",
        faces=first.faces,
        figure=first.figure,
        remedy=first.remedy,
    ) from first


def _solids(shape: Any) -> list:
    """The solids of a shape; closed shells count when there are no solids."""
    import Part

    if shape.Solids:
        loose = len(shape.Faces) - len({f.hashCode() for s in shape.Solids for f in s.Faces})
        if loose > 0:
            logger.warning("%d faces that belong to no solid are left out", loose)
        return list(shape.Solids)
    closed = [shell for shell in shape.Shells if shell.isClosed()]
    if closed and len(closed) == len(shape.Shells):
        return [Part.Solid(shell) for shell in closed]
    if not shape.Faces:
        raise errors.OpenBodyError(
            f"there is no solid and no face, only {_count(len(shape.Edges), 'edge')}"
            f" and {_count(len(shape.Vertexes), 'vertex', 'vertices')}",
            figure=0.0,
            remedy="give a closed solid",
        )
    free = _free_faces(shape.Faces)
    raise errors.OpenBodyError(
        f"there is no closed solid, only {_count(len(shape.Faces), 'loose face')}",
        faces=free or [f"Face{i + 1}" for i in range(len(shape.Faces))],
        figure=float(len(free)),
        remedy="sew the faces and make a solid of them",
    )


def _count(number: int, one: str, many: str = "") -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"


class EdgeUses:
    """How often each edge of a set of faces is used, and by which faces."""

    def __init__(self, faces: Iterable) -> None:
        self._buckets: dict[int, list[tuple[Any, list[int]]]] = {}
        for number, face in enumerate(faces):
            for edge in face_edges(face):
                if not edge.Degenerated:
                    self._slot(edge).extend([number] * (2 if edge.isSeam(face) else 1))

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


def _free_faces(faces: list) -> list[str]:
    return _names(EdgeUses(faces).faces_where(lambda n: n == 1))


def _names(numbers: Iterable[int]) -> list[str]:
    return [f"Face{k + 1}" for k in numbers]


def _read_solid(solid: Any, name: str) -> Body:
    try:
        readings = _take_faces(solid)
    except errors.InputError as error:
        return Body(name, (), solid, error)
    faces = tuple(reading.face for reading in readings)
    return Body(
        name,
        faces,
        solid,
        None,
        tuple(reading.domain for reading in readings),
        {"geometry": converted_geometry(solid, faces)},
    )


def _take_faces(solid: Any) -> list[FaceReading]:
    faces = solid.Faces
    box = solid.BoundBox
    if not faces or not np.isfinite(box.DiagonalLength):
        raise errors.InputError("the solid has no faces", remedy="give a closed solid")
    uses = EdgeUses(faces)
    crowded = uses.faces_where(lambda n: n > 2)
    if crowded:
        raise errors.NonManifoldError(
            "more than two faces meet at an edge",
            faces=_names(crowded),
            figure=float(len(crowded)),
            remedy="give solids that are joined in faces, or separate solids",
        )
    free = uses.faces_where(lambda n: n == 1)
    if free:
        raise errors.OpenBodyError(
            f"the body is open: {_count(len(free), 'face')} of {len(faces)}"
            f" {'has' if len(free) == 1 else 'have'} an edge without a neighbour",
            faces=_names(free),
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
    message = f"{len(numbers)} of {_count(len(faces), 'face')} {words[len(numbers) > 1]}"
    figure = float(len(numbers))
    if first == "inexact":
        figure = max(found[k].figure for k in numbers)
        message += f" (off by {figure:.2g} mm)"
    others = [_count(len(by_kind[kind]), *_REASONS[kind][2]) for kind in kinds[1:]]
    if others:
        message += "; besides " + ", ".join(others)
    splines = ("Part::GeomBSplineSurface", "Part::GeomBezierSurface")
    if not any(face.Surface.TypeId in splines for face in faces):
        message += "; none of its faces is a B-spline face"
    raise error(message, faces=_names(numbers), figure=figure, remedy=remedy)


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
