# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A body that a polygon mesh became, with that mesh: another scheme makes its surface anew."""

from __future__ import annotations

import logging
import os
import tempfile
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.core.polygons import PolygonMesh
from HybridVolume.errors import FileFormatError, HybridVolumeError, InputError
from HybridVolume.sources.meshes import (
    SCHEMES,
    STEPS,
    Surfacing,
    edge_turns,
    named_bodies,
    read_mesh,
    surfaced,
)

from .properties import DocumentObject, Property, include, transaction

if TYPE_CHECKING:
    from HybridVolume.sources import Body

logger = logging.getLogger(__name__)

AS_NEEDED = -1
"""Value of ``Steps`` for as many as the scheme needs."""
UP_TO_DATE = "Up to date"
FAILED = "Failed: "
"""How a Status begins that tells why there is no surface of the scheme."""

_COUNTS_FOR = {"Steps": ("catmull-clark", "smooth"), "SharpAngle": ("catmull-clark",)}
"""Schemes that look at a property."""
_MESH = "Mesh"
_SURFACE = "Surface"
_ARRAYS = tuple(row.name for row in fields(PolygonMesh) if row.name != "notes")


class MeshBody(DocumentObject):
    """Proxy of a body from a mesh. A recompute makes its surface by the scheme."""

    Type = "HybridVolume::MeshBody"
    PROPERTIES = {
        "Scheme": Property(
            "App::PropertyEnumeration",
            _MESH,
            "How the mesh becomes patches: one bilinear patch a quad; the Catmull-Clark surface of "
            "a cage, with its creases; or smooth bicubic patches without creases.",
            choices=SCHEMES[1:],
        ),
        "Steps": Property(
            "App::PropertyIntegerConstraint",
            _MESH,
            "Subdivisions first; -1: as many as the scheme needs.",
            (AS_NEEDED, AS_NEEDED, STEPS[1], 1),
        ),
        "SharpAngle": Property(
            "App::PropertyAngle",
            _MESH,
            "Edges of a Catmull-Clark cage whose faces turn by more are creases; 0: only those "
            "that the file names.",
            0.0,
        ),
        "MeshFile": Property(
            "App::PropertyString",
            _MESH,
            "Name of the file that it was read from.",
            mode=("ReadOnly",),
        ),
        "Cage": Property(
            "App::PropertyFileIncluded",
            _MESH,
            "The mesh itself, as HybridVolume's .npz.",
            mode=("ReadOnly", "Hidden"),
        ),
        "Patches": Property(
            "App::PropertyInteger", _SURFACE, "Faces of the body.", mode=("ReadOnly",)
        ),
        "Quads": Property(
            "App::PropertyInteger",
            _SURFACE,
            "Quads of the mesh that they stand for, after the subdivisions.",
            mode=("ReadOnly",),
        ),
        "LimitDistance": Property(
            "App::PropertyLength",
            _SURFACE,
            "Largest distance from the limit surface of Catmull-Clark.",
            mode=("ReadOnly",),
        ),
        "NormalJump": Property(
            "App::PropertyAngle",
            _SURFACE,
            "Largest angle between the normals of faces that should meet smoothly.",
            mode=("ReadOnly",),
        ),
        "Notes": Property(
            "App::PropertyStringList",
            _SURFACE,
            "What was mended in the mesh, and how the faces were made.",
            mode=("ReadOnly",),
        ),
        "Status": Property(
            "App::PropertyString", "Base", "Up to date, or why not.", mode=("ReadOnly",)
        ),
    }

    def origin(self, obj: Any) -> dict[str, Any]:
        """What `sources.shapes.Body.origin` has of a mesh file, of the surface that is there."""
        figures = {
            "scheme": obj.Scheme,
            "quads": obj.Quads,
            "notes": list(obj.Notes),
            "normal_jump": float(np.radians(float(obj.NormalJump))),
        }
        if obj.Scheme == "catmull-clark":
            figures["distance"] = float(obj.LimitDistance)
        return {"mesh": figures}

    def ensure_properties(self, obj: Any) -> None:
        """Add what is absent, and hide what does not count."""
        super().ensure_properties(obj)
        _show_relevant(obj)

    def onChanged(self, obj: Any, name: str) -> None:
        """Show the properties that count for what was selected."""
        if name == "Scheme" and "SharpAngle" in obj.PropertiesList:
            _show_relevant(obj)

    def execute(self, obj: Any) -> None:
        """Make the surface by the scheme that the properties name.

        Raises
        ------
        HybridVolumeError
            The scheme does not take the mesh; the shape stays as it was, and ``Status`` says why.
        """
        if not obj.Cage:
            return
        try:
            body = _surfaced_again(obj)
        except HybridVolumeError as error:
            obj.Status = FAILED + error.line
            # FreeCAD shows the way of an error: this one is not about the program
            raise error.with_traceback(None) from None
        _show(obj, body)


def import_mesh(path: str | os.PathLike, doc: Any, surfacing: Surfacing | None = None) -> list[Any]:
    """Put the bodies of a mesh file into a document, in one step of Undo.

    Parameters
    ----------
    path : path
        OBJ, OFF or PLY.
    doc : App.Document
    surfacing : Surfacing, optional
        "auto" becomes the scheme that the mesh asks for.

    Returns
    -------
    list of App.DocumentObject
        One a body, with its mesh.

    Raises
    ------
    InputError
        The file cannot be read, or the mesh or the scheme is refused; the document is as it was.
    """
    bodies = read_mesh(path, surfacing)
    for body in bodies:
        if body.error is not None:
            raise body.error
    with transaction(doc, "Import mesh"):
        made = [make_mesh_body(doc, body) for body in bodies]
    for body in bodies:
        for note in body.origin["mesh"]["notes"]:
            logger.info("%s: %s", body.name, note)
    return made


def make_mesh_body(doc: Any, body: Body) -> Any:
    """Add a body from a mesh file, as `sources.meshes.read_mesh` has it, to a document.

    Parameters
    ----------
    doc : App.Document
    body : Body
        With its ``mesh``.
    """
    obj = doc.addObject("Part::FeaturePython", "MeshBody")
    MeshBody(obj)
    obj.Label = body.name
    obj.MeshFile = body.mesh.file
    obj.Scheme = body.mesh.scheme
    obj.Steps = AS_NEEDED if body.mesh.steps is None else body.mesh.steps
    obj.SharpAngle = body.mesh.sharp_angle
    _store(obj, body.mesh.mesh)
    _show(obj, body)
    # it is as its properties say: the long work need not be done again
    obj.purgeTouched()
    return obj


def _show_relevant(obj: Any) -> None:
    for name, schemes in _COUNTS_FOR.items():
        obj.setEditorMode(name, [] if obj.Scheme in schemes else ["Hidden"])


def surfacing_of(obj: Any) -> Surfacing:
    """How the mesh of an object becomes patches, by those of its properties that count.

    Raises
    ------
    InputError
        A value is out of its range.
    """
    counts = {name: obj.Scheme in schemes for name, schemes in _COUNTS_FOR.items()}
    return Surfacing(
        obj.Scheme,
        obj.Steps if counts["Steps"] and obj.Steps != AS_NEEDED else None,
        float(obj.SharpAngle) if counts["SharpAngle"] else 0.0,
    )


def stored_mesh(obj: Any) -> PolygonMesh:
    """The mesh that an object keeps, with the numbers of its file.

    Raises
    ------
    InputError
        There is none.
    FileFormatError
        The stored file is damaged.
    """
    if not obj.Cage:
        raise InputError(f"{obj.Label} has no mesh", remedy="import the mesh again")
    try:
        with np.load(obj.Cage, allow_pickle=False) as file:
            # what files of earlier versions have not has its default
            arrays = {name: file[name] for name in _ARRAYS if name in file}
            return PolygonMesh(**arrays, notes=tuple(file["notes"].tolist()))
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise FileFormatError(
            f"the stored mesh of {obj.Label} cannot be read ({error})",
            remedy="import the mesh again",
        ) from error


def creases_of(obj: Any, mesh: PolygonMesh) -> np.ndarray:
    """Ends (e, 2) of the edges that stay sharp by an object's scheme, at least somewhat."""
    if obj.Scheme != "catmull-clark":
        return np.zeros((0, 2), dtype=np.int64)
    angle = float(obj.SharpAngle)
    ends, turn = edge_turns(mesh)
    by_angle = ends[turn > angle] if angle else ends[:0]
    return np.concatenate([mesh.creases[mesh.sharpness > 0.0], by_angle])


def _store(obj: Any, mesh: PolygonMesh) -> None:
    with tempfile.TemporaryDirectory(prefix="hybridvolume-") as folder:
        path = os.path.join(folder, "cage.npz")
        arrays = {name: getattr(mesh, name) for name in _ARRAYS}
        np.savez_compressed(path, notes=np.array(mesh.notes, dtype=str), **arrays)
        include(obj, "Cage", path)


def _surfaced_again(obj: Any) -> Body:
    surfacing = surfacing_of(obj)
    parts = named_bodies(stored_mesh(obj), surfacing.scheme, obj.Label)
    if len(parts) != 1:
        raise InputError(
            f"{obj.Label} would be {len(parts)} bodies", remedy="import the mesh again"
        )
    ((name, mesh),) = parts.items()
    body = surfaced(mesh, name, surfacing)
    if body.error is not None:
        raise body.error
    return body


def _show(obj: Any, body: Body) -> None:
    figures = body.origin["mesh"]
    # the shape brings a placement of its own; that of the object stays
    placement = obj.Placement
    obj.Shape = body.shape
    obj.Placement = placement
    obj.Patches = len(body.faces)
    obj.Quads = figures["quads"]
    obj.LimitDistance = figures.get("distance", 0.0)
    obj.NormalJump = float(np.degrees(figures.get("normal_jump", 0.0)))
    # a mesh that was mended once is looked at again, and the same is found
    obj.Notes = list(dict.fromkeys(figures["notes"]))
    obj.Status = UP_TO_DATE
