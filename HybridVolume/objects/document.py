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
import Part

from HybridVolume.core.hybrid import save_midstructure
from HybridVolume.errors import FaultError
from HybridVolume.sources import check_against_cad, global_shape

from . import thickness
from .fem_mesh import (
    AnalysisMesh,
    PartMesh,
    arrays_of,
    build,
    cover,
    make_mesh_object,
)
from .inner import make_inner_boundary
from .midstructure import PARAMETERS, insert_found, make_midstructure, search_inputs
from .properties import include, transaction
from .volume import (
    GEOMETRY,
    UP_TO_DATE,
    changes,
    complete_parameters,
    current_inputs,
    inputs_of,
    make_volume,
    set_status,
    update_status,
)

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh
    from HybridVolume.core.hybrid import HybridVolume
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
    report : dict
        The report with what FreeCAD adds: ``input.max_deviation``, ``fem.faces_covered`` and
        ``fem.face_tolerance``.
    analysis_body : Part.Shape or None
        A copy of the body whose faces have a wider tolerance, where FreeCAD would not find the
        mesh's nodes on the body itself.

    Raises
    ------
    HybridVolumeError
        Patches or nodes lie beside the body's faces, or FreeCAD did not take the meshes.
    """

    def __init__(self, completed: Completed) -> None:
        arrays = arrays_of(completed.volume.fem)
        self.completed = completed
        self.analysis_body, covered = cover(arrays, completed.body.shape)
        self.report = dict(completed.report)
        self.report["input"] = {
            **self.report["input"],
            "max_deviation": check_against_cad(completed.body, completed.volume.surface),
        }
        self.report["fem"] = {
            **self.report["fem"],
            "faces_covered": covered,
            "face_tolerance": (self.analysis_body or completed.body.shape).getTolerance(
                1, Part.Face
            ),
        }
        self.analysis = build(arrays)
        self.groups = [*arrays.volumes, *arrays.node_groups, *arrays.faces]
        self.parts: dict[str, tuple[Any, int]] = {}
        for part in ("Shell", "Core"):
            alone = arrays.part(part)
            self.parts[part] = (build(alone), len(alone.volumes[part][1]))


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


def insert_mesh(doc: Any, fem: FiniteElementMesh, body: Any | None = None) -> Any:
    """Put a conforming mesh alone into a document, in one step of Undo.

    Parameters
    ----------
    doc : App.Document
    fem : FiniteElementMesh
    body : App.DocumentObject, optional
        The body that it belongs to.

    Returns
    -------
    App.DocumentObject

    Raises
    ------
    FaultError
        FreeCAD did not take the whole mesh, or does not find its nodes on the body's faces.
    """
    arrays = arrays_of(fem)
    if body is not None:
        copy, _ = cover(arrays, global_shape(body))
        if copy is not None:
            raise FaultError(
                "mesh nodes lie beside the body's faces by more than their tolerance",
                figure=copy.getTolerance(1),
                remedy="widen the body's tolerance with Shape.fixTolerance",
            )
    mesh = build(arrays)
    with transaction(doc, "Add the FEM mesh"):
        obj = make_mesh_object(doc, "FemMesh", AnalysisMesh)
        obj.Shape = body
        obj.Order = "Second" if fem.order == 2 else "First"
        obj.FemMesh = mesh
        obj.Groups = [*arrays.volumes, *arrays.node_groups, *arrays.faces]
        obj.Status = UP_TO_DATE
        if obj.ViewObject:
            obj.ViewObject.Visibility = True
    return obj


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
            source = doc.addObject("Part::Feature", "Body")
            source.Label = one.completed.body.name
            source.Shape = one.completed.body.shape
            insert(doc, source, [one])
        doc.saveAs(str(path))
        if not Path(path).is_file():
            raise FaultError(f"FreeCAD did not write {path}")
    finally:
        FreeCAD.closeDocument(doc.Name)


def _make_parts(doc: Any, obj: Any) -> None:
    """Make what a volume has not yet."""
    if obj.Midstructure is None:
        obj.Midstructure = make_midstructure(doc)
    for part in ("Shell", "Core"):
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
    obj.FemMesh.Density = parameters["FemMesh.Density"]
    obj.FemMesh.Shape = _analysis_body(obj, prepared)
    obj.FemMesh.FemMesh = prepared.analysis
    obj.FemMesh.Groups = prepared.groups
    for part, (mesh, count) in prepared.parts.items():
        child = getattr(obj, part)
        child.FemMesh = mesh
        child.Elements = count
    _fill_midstructure(obj.Midstructure, prepared)
    include(obj, "Result", one.result)
    obj.Report = flat(prepared.report)
    shell = prepared.report["shell"]
    obj.W0Reached = shell["w0"]
    obj.ThicknessReached = reached_text(shell)
    obj.FaceThickness = {row["face"]: face_text(row) for row in shell.get("faces", ())}
    obj.Elements = shell["elements"]
    obj.MinimumScaledJacobian = shell["min_scaled_jacobian"]
    # Body, geometry and decisions may have been edited while the worker was busy: then the result
    # is out of date.
    computed_from = {**inputs_of(parameters), "Source": one.fingerprint}
    obj.ComputedFrom = computed_from
    edited = ("Source", GEOMETRY, *(("Midstructure.Decisions",) if keep_decisions else ()))
    stale = [name for name in changes(computed_from, current_inputs(obj)) if name not in edited]
    if stale:
        raise FaultError(f"the document did not take {', '.join(stale)}")
    set_status(obj, UP_TO_DATE)


def _geometry_object(doc: Any, completed: Completed) -> Any:
    """The user's geometry as an object of the document."""
    obj = doc.addObject("Part::Feature", "MidstructureGeometry")
    obj.Label = f"{completed.body.name} midstructure geometry"
    obj.Shape = completed.geometry
    obj.Visibility = False
    return obj


def _analysis_body(obj: Any, prepared: Prepared) -> Any:
    """The object that loads and supports go on: the source, or a copy with a wider tolerance.

    A source without a shape of its own (a container of parts) gets a copy too.
    """
    doc = obj.Document
    shape = prepared.analysis_body
    if shape is None and not hasattr(obj.Source, "Shape"):
        shape = prepared.completed.body.shape
    if shape is None:
        if obj.AnalysisBody:
            doc.removeObject(obj.AnalysisBody.Name)
        return obj.Source
    if obj.AnalysisBody is None:
        obj.AnalysisBody = doc.addObject("Part::Feature", "AnalysisBody")
        obj.AnalysisBody.Label = f"{prepared.completed.body.name} for analysis"
        obj.AnalysisBody.Visibility = False
    obj.AnalysisBody.Shape = shape
    return obj.AnalysisBody


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
