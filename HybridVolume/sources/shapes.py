# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""FreeCAD shapes to bodies of untrimmed NURBS faces; what cannot be taken is refused by name."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .. import errors
from ..core.covering.kinds import BIT, EXACT
from ..core.polygons import PolygonMesh
from ..core.surface import SplineFace
from ..geometry_figures import geometry_figures
from ..protocol import Progress
from .contacts import find_point_contacts
from .covering import Covered, Covering, is_known
from .untrimmed import COVERED, count_of, free_faces, take_faces

logger = logging.getLogger(__name__)


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
        :mod:`..geometry_figures`; of a mesh file ``mesh``.
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
        if isinstance(body.error, COVERED) and not is_known(solid, tolerance, free_only=free_only)
    ]


def solids_of_object(document_object: Any) -> list[tuple[str, Any]]:
    """Names and solids (Part.Solid) of a document object, as :func:`read_object` has them.

    Nothing is read or covered.

    Raises
    ------
    InputError
        There is no solid.
    """
    shape = global_shape(document_object)
    if shape.isNull():
        raise errors.InputError("the shape is empty", remedy="give a closed solid")
    solids = _solids(shape)
    return [*zip(_body_names(document_object.Label, len(solids)), solids, strict=True)]


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
    bodies = _read_solids(names, solids, cover)
    for k, body in enumerate(bodies if cover else ()):
        if isinstance(body.error, COVERED):
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


def _read_solids(names: Sequence[str], solids: Sequence[Any], cover: bool = True) -> list[Body]:
    """Solids as they are; those with faces that are no patches carry an error of `COVERED`."""
    bodies = [_read_solid(solid, own) for solid, own in zip(solids, names, strict=True)]
    usable = [
        k
        for k, body in enumerate(bodies)
        if not body.error or (cover and isinstance(body.error, COVERED))
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
    figures = geometry_figures(
        cover.kinds,
        np.bincount(cover.origin, minlength=len(cover.kinds)).tolist(),
        cover.deviation.tolist(),
        _areas(covering.solid),
        cover.tolerance,
        cover.inside,
        cover.merged,
    )
    return Body(
        covering.name,
        cover.faces,
        covering.solid,
        None,
        (None,) * len(cover.faces),
        {"geometry": figures},
        cover=cover,
    )


def _raise_all(bodies: list[Body]) -> None:
    first = bodies[0].error
    if len(bodies) == 1:
        raise first
    others = count_of(len(bodies) - 1, "more solid")
    raise type(first)(
        f"{first.message} ({bodies[0].name}; {others} refused too)",
        faces=first.faces,
        figure=first.figure,
        remedy=first.remedy,
        places=first.places,
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
            f"there is no solid and no face, only {count_of(len(shape.Edges), 'edge')}"
            f" and {count_of(len(shape.Vertexes), 'vertex', 'vertices')}",
            figure=0.0,
            remedy="give a closed solid",
        )
    free = free_faces(shape.Faces)
    raise errors.OpenBodyError(
        f"there is no closed solid, only {count_of(len(shape.Faces), 'loose face')}",
        faces=free or [f"Face{i + 1}" for i in range(len(shape.Faces))],
        figure=float(len(free)),
        remedy="sew the faces and make a solid of them",
    )


def _read_solid(solid: Any, name: str) -> Body:
    try:
        readings = take_faces(solid)
    except errors.InputError as error:
        return Body(name, (), solid, error)
    faces = tuple(reading.face for reading in readings)
    kinds = [EXACT if face.exact else BIT for face in faces]
    count = len(faces)
    figures = geometry_figures(kinds, [1] * count, [0.0] * count, _areas(solid))
    return Body(
        name,
        faces,
        solid,
        None,
        tuple(reading.domain for reading in readings),
        {"geometry": figures},
    )


def _areas(solid: Any) -> list[float]:
    """Areas of the faces, mm^2."""
    return [float(face.Area) for face in solid.Faces]
