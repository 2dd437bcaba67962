# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A computed hybrid volume into a document, in one step of Undo."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import FreeCAD
import numpy as np

from HybridVolume.core.hybrid import save_midstructure
from HybridVolume.errors import FaultError, InputError
from HybridVolume.sources import check_against_cad, global_shape

from . import density, face_geometry, spans, thickness
from .fem_mesh import AnalysisMesh, PartMesh, inputs_of_mesh, make_mesh_object
from .inner import make_inner_boundary, stored_volume
from .mesh_body import make_mesh_body
from .midstructure import PARAMETERS, insert_found, make_midstructure, search_inputs
from .prepared_mesh import PARTS, PreparedMesh
from .properties import include, transaction
from .stored_body import body_of_volume, body_to_search
from .stored_mesh import volume_object_of
from .volume import (
    GEOMETRY,
    UP_TO_DATE,
    changes,
    complete_parameters,
    current_inputs,
    inputs_of,
    make_volume,
    mesh_parameters_of,
    mesh_values,
    set_status,
    source_fingerprint,
    update_status,
)

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh
    from HybridVolume.core.hybrid import HybridVolume
    from HybridVolume.core.surface import PatchSurface
    from HybridVolume.sources import Body


@dataclass(frozen=True)
class Completed:
    """One computed body.

    Attributes
    ----------
    body : Body
        The solid that was computed, in global coordinates.
    solid : int
        Which solid of the source it is, from 1.
    volume : HybridVolume
    result : Path
        The stored volume (.npz); the document takes a copy.
    report : dict
        As in report.json.
    parameters : mapping
        What it was computed with, by the names of `volume.current_parameters`; what is absent had
        its default.
    fingerprint : str
        Of the source when it was read.
    geometry : Part.Shape, optional
        Geometry for the midstructure ``own`` that is in no document yet.
    """

    body: Body
    solid: int
    volume: HybridVolume
    result: Path
    report: Mapping[str, Any]
    parameters: Mapping[str, Any]
    fingerprint: str
    geometry: Any | None = None


class Prepared:
    """A computed body as FreeCAD meshes, checked before any document changes.

    Parameters
    ----------
    completed : Completed

    Attributes
    ----------
    completed : Completed
    mesh : PreparedMesh
    report : dict
        The report with what FreeCAD adds: ``input.max_deviation``, and the figures of
        `Coverage.figures` in ``fem``.

    Raises
    ------
    HybridVolumeError
        Patches or nodes lie beside the body's faces, or FreeCAD did not take the meshes.
    """

    def __init__(self, completed: Completed) -> None:
        volume = completed.volume
        self.completed = completed
        self.mesh = PreparedMesh(volume.fem, completed.body, volume.surface)
        self.report = dict(completed.report)
        self.report["input"] = {
            **self.report["input"],
            "max_deviation": check_against_cad(completed.body, volume.surface),
        }
        self.report["fem"] = {**self.report["fem"], **self.mesh.coverage.figures()}
        if self.mesh.coverage.notes:
            told = self.report.get("notes", ())
            self.report["notes"] = [*told, *self.mesh.coverage.notes]


def insert(
    doc: Any, source: Any, prepared: Sequence[Prepared], replaced: Any | None = None
) -> list[Any]:
    """Put computed bodies into a document, all in one step of Undo.

    Parameters
    ----------
    doc : App.Document
    source : App.DocumentObject
        The body.
    prepared : sequence of Prepared
    replaced : App.DocumentObject, optional
        A hybrid volume that takes the (single) new result instead of a new object; parts that it
        has not yet are made. Its decisions stay: they are replayed on the new midstructure.

    Returns
    -------
    list of App.DocumentObject
        The hybrid volumes.

    Raises
    ------
    HybridVolumeError
        The document did not take something; it is as it was.
    """
    with transaction(doc, "Complete the volume"):
        volumes = []
        for one in prepared:
            obj = replaced
            if obj is None:
                obj = make_volume(doc)
                obj.Label = f"{one.completed.body.name} hybrid volume"
            obj.Source = source
            # Shell and body have the same outside.
            source.Visibility = False
            _fill(doc, obj, one, keep_decisions=replaced is not None)
            volumes.append(obj)
        doc.recompute()
        for obj in volumes:
            update_status(obj)
    return volumes


def insert_mesh(
    doc: Any, fem: FiniteElementMesh, body: Any | None = None, surface: PatchSurface | None = None
) -> Any:
    """Put a conforming mesh alone into a document, in one step of Undo.

    Parameters
    ----------
    doc : App.Document
    fem : FiniteElementMesh
    body : App.DocumentObject, optional
        The body that it belongs to, one solid.
    surface : PatchSurface, optional
        The body's surface; with it every node is measured against its CAD face.

    Returns
    -------
    App.DocumentObject

    Raises
    ------
    HybridVolumeError
        FreeCAD did not take the whole mesh, or does not find its nodes on the body's faces.
    """
    read = body_to_search(body, surface) if body is not None else None
    if body is not None and not _stands_still(body):
        raise InputError(
            f"a container moves {body.Label}: the FEM workbench would look for nodes elsewhere",
            remedy="give a copy of the body outside of the container",
        )
    prepared = PreparedMesh(fem, read, surface)
    coverage = prepared.coverage
    if coverage is not None and coverage.copy is not None and not coverage.converted:
        raise FaultError(
            "mesh nodes lie beside the body's faces by more than their tolerance",
            figure=coverage.tolerance,
            remedy="widen the body's tolerance with Shape.fixTolerance",
        )
    with transaction(doc, "Add the FEM mesh"):
        obj = make_mesh_object(doc, "FemMesh", AnalysisMesh)
        obj.Shape = body
        _set_density(obj, fem)
        prepared.fill(obj)
        if body is not None:
            # loads go on the body itself here
            obj.Lost = [*coverage.lost, *coverage.converted]
            obj.ComputedFrom = inputs_of_mesh(obj)
        obj.Status = UP_TO_DATE
        if obj.ViewObject:
            obj.ViewObject.Visibility = True
    return obj


def replace_mesh(
    obj: Any,
    volume: HybridVolume,
    *,
    result: str | os.PathLike | None = None,
    report: Mapping[str, Any] | None = None,
) -> Any:
    """Give a hybrid volume of a document another mesh; its shell stays. One step of Undo.

    Parameters
    ----------
    obj : App.DocumentObject
        A hybrid volume, its mesh, another part of it, or its body.
    volume : HybridVolume
        What `HybridVolume.core.remesh.remesh` made of the one that the object stores. The
        properties of the mesh object are set to its density and order.
    result : path, optional
        Where it is stored already; the document takes a copy.
    report : mapping, optional
        Its report, as in report.json; made here otherwise.

    Returns
    -------
    App.DocumentObject
        The mesh object: the same as before, so that analyses keep it. Groups that materials have
        in it are made again; results of a solver still show the mesh that they were computed on.

    Raises
    ------
    InputError
        The body was changed since the shell was computed, or the volume has another shell.
    HybridVolumeError
        FreeCAD did not take the mesh, or does not find its nodes on the body's faces. The document
        is as it was.
    """
    obj = volume_object_of(obj)
    if obj.ComputedFrom.get("Source") != source_fingerprint(obj.Source):
        raise InputError(
            f"{obj.Label} is out of date: the body changed",
            remedy="complete the hybrid volume again",
        )
    before = stored_volume(obj).shell
    if not np.array_equal(before.layers, volume.shell.layers):
        raise InputError(
            f"the mesh belongs to another shell than that of {obj.Label}",
            remedy="complete the hybrid volume again",
        )
    body = body_of_volume(obj, volume.surface)
    prepared = PreparedMesh(volume.fem, body, volume.surface)
    if report is None:
        from HybridVolume.report import volume_report

        report = volume_report(volume, {}, {})
    fem = {**report["fem"], **prepared.coverage.figures()}
    fresh = flat({"interior": report["interior"], "interface": report["interface"], "fem": fem})
    kept = ("interior.", "interface.", "fem.")
    with transaction(obj.Document, "Mesh again"), tempfile.TemporaryDirectory() as folder:
        if result is None:
            result = os.path.join(folder, "result.npz")
            volume.save(result)
        _set_density(obj.FemMesh, volume.fem)
        obj.FemMesh.Shape = _analysis_body(obj, body, prepared)
        _fill_meshes(obj, prepared)
        include(obj, "Result", result)
        obj.Report = {k: v for k, v in obj.Report.items() if not k.startswith(kept)} | fresh
        made = {k: v for k, v in current_inputs(obj).items() if k.startswith("FemMesh.")}
        rest = {k: v for k, v in obj.ComputedFrom.items() if not k.startswith("FemMesh.")}
        obj.ComputedFrom = {**rest, **made}
        obj.Document.recompute()
        update_status(obj)
    return obj.FemMesh


def _set_density(obj: Any, fem: FiniteElementMesh) -> None:
    """Let the properties of a mesh object ask for the mesh that it has."""
    parameters = mesh_parameters_of(fem)
    obj.Order = parameters["FemMesh.Order"]
    density.set_values(obj, mesh_values(parameters))


def save_new(prepared: Sequence[Prepared], path: str | os.PathLike) -> None:
    """Write a new document with the bodies and what was computed from them.

    Raises
    ------
    HybridVolumeError
        The document did not take something, or was not written.
    """
    doc = FreeCAD.newDocument(Path(path).stem, hidden=True, temp=True)
    try:
        for one in prepared:
            insert(doc, _body_object(doc, one.completed.body), [one])
        doc.saveAs(str(path))
        if not Path(path).is_file():
            raise FaultError(f"FreeCAD did not write {path}")
    finally:
        FreeCAD.closeDocument(doc.Name)
    _check_saved(path, prepared)


def _body_object(doc: Any, body: Body) -> Any:
    """A body as an object of its own; one from a mesh file keeps its mesh."""
    if body.mesh is not None:
        return make_mesh_body(doc, body)
    source = doc.addObject("Part::Feature", "Body")
    source.Label = body.name
    source.Shape = body.shape
    return source


def _check_saved(path: str | os.PathLike, prepared: Sequence[Prepared]) -> None:
    """Open a document again and compare its meshes with what they were made of."""
    doc = FreeCAD.openDocument(str(path), hidden=True)
    try:
        volumes = [obj for obj in doc.Objects if hasattr(obj, "AnalysisBody")]
        if len(volumes) != len(prepared):
            raise FaultError(f"{path} has {len(volumes)} hybrid volumes, not {len(prepared)}")
        for obj, one in zip(volumes, prepared, strict=True):
            wrong = one.mesh.differences(obj)
            if wrong:
                raise FaultError(f"FreeCAD did not store the whole mesh: {'; '.join(wrong)}")
    finally:
        FreeCAD.closeDocument(doc.Name)


def _make_parts(doc: Any, obj: Any) -> None:
    """Make what a volume has not yet."""
    if obj.Midstructure is None:
        obj.Midstructure = make_midstructure(doc)
    for part in PARTS:
        if getattr(obj, part) is None:
            setattr(obj, part, make_mesh_object(doc, part, PartMesh))
    if obj.InnerBoundary is None:
        obj.InnerBoundary = make_inner_boundary(doc)
    if obj.FemMesh is None:
        obj.FemMesh = make_mesh_object(doc, "FemMesh", AnalysisMesh)


def _fill(doc: Any, obj: Any, prepared: Prepared, *, keep_decisions: bool) -> None:
    one = prepared.completed
    _make_parts(doc, obj)
    parameters = complete_parameters(one.parameters)
    thickness.set_values(obj, parameters)
    spans.set_values(obj, parameters)
    face_geometry.set_values(obj, parameters)
    obj.Tolerance = parameters["Tolerance"]
    obj.Solid = one.solid
    for name in PARAMETERS:
        # what the user decided while the worker was busy must not be lost
        if not (keep_decisions and name == "Decisions"):
            value = parameters[f"Midstructure.{name}"]
            setattr(obj.Midstructure, name, list(value) if name == "Decisions" else value)
    if one.geometry is not None:
        obj.Midstructure.Geometry = [_geometry_object(doc, one)]
    obj.FemMesh.Order = parameters["FemMesh.Order"]
    density.set_values(obj.FemMesh, mesh_values(parameters))
    obj.FemMesh.Shape = _analysis_body(obj, one.body, prepared.mesh)
    _fill_meshes(obj, prepared.mesh)
    _fill_midstructure(obj.Midstructure, prepared)
    include(obj, "Result", one.result)
    geometry = prepared.report["input"].get("geometry")
    face_geometry.fill(obj, geometry)
    obj.Report = flat(_without_face_rows(prepared.report))
    shell = prepared.report["shell"]
    obj.W0Reached = shell["w0"]
    obj.ThicknessReached = reached_text(shell)
    obj.FaceThickness = {row["face"]: face_text(row) for row in shell.get("faces", ())}
    obj.Elements = shell["elements"]
    obj.MinimumScaledJacobian = shell["min_scaled_jacobian"]
    # Body, geometry and decisions may have been edited while the worker was busy: then the result
    # is out of date.
    computed_from = {**inputs_of(parameters), "Source": one.fingerprint}
    if one.body.cover is None:
        del computed_from[face_geometry.COVER]
    obj.ComputedFrom = computed_from
    edited = ("Source", GEOMETRY, *(("Midstructure.Decisions",) if keep_decisions else ()))
    stale = [name for name in changes(computed_from, current_inputs(obj)) if name not in edited]
    if stale:
        raise FaultError(f"the document did not take {', '.join(stale)}")
    set_status(obj, UP_TO_DATE)


def _without_face_rows(report: Mapping[str, Any]) -> dict[str, Any]:
    """A report for the property editor: what became of each face has a property of its own."""
    given = report["input"]
    if "geometry" not in given:
        return dict(report)
    geometry = {name: value for name, value in given["geometry"].items() if name != "faces"}
    return {**report, "input": {**given, "geometry": geometry}}


def _geometry_object(doc: Any, completed: Completed) -> Any:
    """The user's geometry as an object of the document."""
    obj = doc.addObject("Part::Feature", "MidstructureGeometry")
    obj.Label = f"{completed.body.name} midstructure geometry"
    obj.Shape = completed.geometry
    obj.Visibility = False
    return obj


def _analysis_body(obj: Any, body: Body, prepared: PreparedMesh) -> Any:
    """The object that loads and supports go on: the source, or a copy with a wider tolerance.

    A source without a shape of its own (a container of parts) gets a copy too, and one that a
    container moves: the FEM workbench of FreeCAD 0.20 looks at it where it would be without. A copy
    stays where loads or supports are on it.
    """
    doc, held = obj.Document, obj.AnalysisBody
    shape = prepared.coverage.copy
    used = held is not None and any(one not in (obj, obj.FemMesh) for one in held.InList)
    if shape is None and (used or not _stands_still(obj.Source)):
        shape = body.shape
    if shape is None:
        if held is not None:
            obj.FemMesh.Shape = None
            doc.removeObject(held.Name)
        return obj.Source
    if held is None:
        held = obj.AnalysisBody = doc.addObject("Part::Feature", "AnalysisBody")
        held.Label = f"{body.name} for analysis"
        held.Visibility = False
    held.Shape = shape
    return held


def _stands_still(source: Any) -> bool:
    """Whether an object has a shape of its own, and no container moves it."""
    if not hasattr(source, "Shape"):
        return False
    places = (source.Shape.Placement, global_shape(source).Placement)
    return np.allclose(*(place.toMatrix().A for place in places), rtol=1e-12, atol=1e-12)


def _fill_meshes(obj: Any, prepared: PreparedMesh) -> None:
    prepared.fill(obj.FemMesh)
    coverage = prepared.coverage
    obj.FemMesh.Lost = list(coverage.lost)
    obj.FemMesh.FaceTolerance = coverage.tolerance if coverage.copy is not None else 0.0
    for part in PARTS:
        prepared.fill_part(obj, part)


def _fill_midstructure(obj: Any, prepared: Prepared) -> None:
    with tempfile.TemporaryDirectory(prefix="hybridvolume-") as folder:
        path = os.path.join(folder, "facets.npz")
        save_midstructure(prepared.completed.volume.midstructure, path)
        one = prepared.completed
        found_from = {**search_inputs(obj), "Source": one.fingerprint}
        if GEOMETRY in one.parameters:
            found_from["Geometry"] = one.parameters[GEOMETRY]
        insert_found(obj, path, found_from)


def reached_text(shell: Mapping[str, Any]) -> str:
    """How thick a shell has become, from its part of the report; empty where it does not tell."""
    if not shell.get("thickness"):
        return ""
    return shell.get("sentence") or f"{_range(shell['thickness'])} mm, as asked"


def face_text(row: Mapping[str, Any]) -> str:
    """What a face has become, e.g. ``"1.71 mm (1.2 to 2.1), w0 0.48 (0.3 to 0.5)"``."""
    return f"{_range(row['thickness'], ' mm')}, w0 {_range(row['w0'])}"


def _range(figures: Mapping[str, float], unit: str = "") -> str:
    return f"{figures['mean']:.3g}{unit} ({figures['min']:.3g} to {figures['max']:.3g})"


def flat(report: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """A report as text by dotted names, for the property editor."""
    values: dict[str, str] = {}
    for name, value in report.items():
        if isinstance(value, Mapping):
            values.update(flat(value, f"{prefix}{name}."))
        elif isinstance(value, float):
            values[f"{prefix}{name}"] = f"{value:.6g}"
        else:
            values[f"{prefix}{name}"] = str(value)
    return values
