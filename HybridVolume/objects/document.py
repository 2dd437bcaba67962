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
import Part

from HybridVolume.errors import FaultError
from HybridVolume.sources import check_against_cad, global_shape

from .fem_mesh import (
    AnalysisMesh,
    PartMesh,
    arrays_of,
    build,
    cover,
    make_mesh_object,
)
from .midstructure import make_midstructure
from .properties import transaction
from .volume import UP_TO_DATE, changes, current_inputs, make_volume, set_status, update_status

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh
    from HybridVolume.core.hybrid import HybridVolume
    from HybridVolume.core.midstructure import Sheet
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
        Properties of the volume that it was computed with, and ``"Midstructure.Method"``,
        ``"FemMesh.Order"``, ``"FemMesh.Density"``.
    fingerprint : str
        Of the source when it was read.
    """

    body: Body
    solid: int
    volume: HybridVolume
    result: Path
    report: Mapping[str, Any]
    parameters: Mapping[str, Any]
    fingerprint: str


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
        A hybrid volume that takes the (single) new result instead of a new object.

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
            obj = replaced or _make_objects(doc, one)
            obj.Source = source
            # Shell and body have the same outside.
            source.Visibility = False
            _fill(obj, one)
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


def _make_objects(doc: Any, prepared: Prepared) -> Any:
    obj = make_volume(doc)
    obj.Label = f"{prepared.completed.body.name} hybrid volume"
    obj.Midstructure = make_midstructure(doc)
    for part in ("Shell", "Core"):
        setattr(obj, part, make_mesh_object(doc, part, PartMesh))
    obj.FemMesh = make_mesh_object(doc, "FemMesh", AnalysisMesh)
    return obj


def _fill(obj: Any, prepared: Prepared) -> None:
    one = prepared.completed
    for name in ("W0", "Layers", "Degree", "Tolerance"):
        setattr(obj, name, one.parameters[name])
    obj.Solid = one.solid
    obj.Midstructure.Method = one.parameters["Midstructure.Method"]
    obj.FemMesh.Order = one.parameters["FemMesh.Order"]
    obj.FemMesh.Density = one.parameters["FemMesh.Density"]
    obj.FemMesh.Shape = _analysis_body(obj, prepared)
    obj.FemMesh.FemMesh = prepared.analysis
    obj.FemMesh.Groups = prepared.groups
    for part, (mesh, count) in prepared.parts.items():
        child = getattr(obj, part)
        child.FemMesh = mesh
        child.Elements = count
    _fill_midstructure(obj.Midstructure, prepared)
    _include(obj, "Result", one.result)
    obj.Report = flat(prepared.report)
    shell = prepared.report["shell"]
    obj.W0Reached = shell["w0"]
    obj.Elements = shell["elements"]
    obj.MinimumScaledJacobian = shell["min_scaled_jacobian"]
    inputs = current_inputs(obj)
    # The body may have been edited while the worker was busy: then the result is out of date.
    obj.ComputedFrom = {**inputs, "Source": one.fingerprint}
    stale = [name for name in changes(obj.ComputedFrom, inputs) if name != "Source"]
    if stale:
        raise FaultError(f"the document did not take {', '.join(stale)}")
    set_status(obj, UP_TO_DATE)


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
    found = prepared.completed.volume.midstructure
    obj.MethodUsed = found.method
    obj.Decisions = [decision(sheet) for sheet in found.sheets]
    with tempfile.TemporaryDirectory(prefix="hybridvolume-") as folder:
        path = os.path.join(folder, "facets.npz")
        np.savez(
            path, vertices=found.vertices, facets=found.facets, sheet=found.sheet, kept=found.kept
        )
        _include(obj, "Facets", path)


def decision(sheet: Sheet) -> str:
    """What was decided about a sheet, in words that find it again: faces and a point (mm)."""
    point = " ".join(f"{x:.9g}" for x in sheet.seed)
    return f"{'kept' if sheet.kept else 'removed'} {'+'.join(sheet.faces)} @ {point}"


def _include(obj: Any, name: str, path: str | os.PathLike) -> None:
    """Take a copy of a file into a document."""
    setattr(obj, name, (str(path), f"{obj.Name}_{name}.npz"))


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
