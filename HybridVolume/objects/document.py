# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A computed hybrid volume into a document, in one step of Undo."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import FreeCAD
import numpy as np

from HybridVolume.errors import FaultError

from .fem_mesh import (
    AnalysisMesh,
    MeshArrays,
    PartMesh,
    arrays_of,
    build,
    check_covered,
    make_mesh_object,
)
from .midstructure import make_midstructure
from .properties import attach_view, transaction
from .volume import UP_TO_DATE, changes, current_inputs, make_volume, set_status, update_status

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume


@dataclass(frozen=True)
class Completed:
    """One computed body.

    Attributes
    ----------
    name : str
        Label of the hybrid volume.
    shape : Part.Shape
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

    name: str
    shape: Any
    solid: int
    volume: HybridVolume
    result: Path
    report: Mapping[str, Any]
    parameters: Mapping[str, Any]
    fingerprint: str


def insert(
    doc: Any, source: Any, completed: Sequence[Completed], replaced: Any | None = None
) -> list[Any]:
    """Put computed bodies into a document, all in one step of Undo.

    Parameters
    ----------
    doc : App.Document
    source : App.DocumentObject or None
        The body.
    completed : sequence of Completed
    replaced : App.DocumentObject, optional
        A hybrid volume that takes the (single) new result instead of a new object.

    Returns
    -------
    list of App.DocumentObject
        The hybrid volumes.

    Raises
    ------
    HybridVolumeError
        A check failed; the document is as it was.
    """
    # Everything that can be refused is made and checked before the document is touched.
    meshes = [_Meshes(one) for one in completed]
    with transaction(doc, "Complete the volume"):
        volumes = []
        for one, mesh in zip(completed, meshes, strict=True):
            obj = replaced or _make_objects(doc, one)
            obj.Source = source
            _fill(obj, one, mesh)
            volumes.append(obj)
        doc.recompute()
        for obj in volumes:
            update_status(obj)
    return volumes


class _Meshes:
    """FreeCAD meshes of one computed body, checked."""

    def __init__(self, one: Completed) -> None:
        arrays = arrays_of(one.volume.fem)
        self.faces_covered = check_covered(arrays, one.shape)
        self.analysis = build(arrays)
        self.groups = [*arrays.volumes, *arrays.node_groups, *arrays.faces]
        self.parts: dict[str, tuple[Any, int]] = {}
        for part in ("Shell", "Core"):
            alone: MeshArrays = arrays.part(part)
            self.parts[part] = (build(alone), len(alone.volumes[part][1]))


def _make_objects(doc: Any, one: Completed) -> Any:
    obj = make_volume(doc)
    obj.Label = f"{one.name} hybrid volume"
    obj.Midstructure = make_midstructure(doc)
    for part in ("Shell", "Core"):
        mesh = make_mesh_object(doc, part, PartMesh)
        mesh.Part = part
        attach_view(mesh)
        setattr(obj, part, mesh)
    obj.FemMesh = make_mesh_object(doc, "FemMesh", AnalysisMesh)
    return obj


def _fill(obj: Any, one: Completed, meshes: _Meshes) -> None:
    for name in ("W0", "Layers", "Degree", "Tolerance"):
        setattr(obj, name, one.parameters[name])
    obj.Solid = one.solid
    obj.Midstructure.Method = one.parameters["Midstructure.Method"]
    obj.FemMesh.Order = one.parameters["FemMesh.Order"]
    obj.FemMesh.Density = one.parameters["FemMesh.Density"]
    obj.FemMesh.Shape = obj.Source
    obj.FemMesh.FemMesh = meshes.analysis
    obj.FemMesh.Groups = meshes.groups
    for part, (mesh, count) in meshes.parts.items():
        child = getattr(obj, part)
        child.FemMesh = mesh
        child.Elements = count
    _fill_midstructure(obj.Midstructure, one)
    _include(obj, "Result", one.result)
    obj.Report = flat(one.report)
    shell = one.report["shell"]
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


def _fill_midstructure(obj: Any, one: Completed) -> None:
    found = one.volume.midstructure
    obj.MethodUsed = found.method
    obj.Decisions = one.report["midstructure"].get("decisions", [])
    path = os.path.join(obj.Document.TransientDir, f"{obj.Name}_facets.npz")
    np.savez(path, vertices=found.vertices, facets=found.facets, sheet=found.sheet, kept=found.kept)
    _include(obj, "Facets", path)
    os.remove(path)


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


def save(doc: Any, path: str | os.PathLike) -> None:
    """Save a document in a file.

    Raises
    ------
    FaultError
        FreeCAD wrote nothing.
    """
    doc.saveAs(str(path))
    if not Path(path).is_file():
        raise FaultError(f"FreeCAD did not write {path}")
    FreeCAD.Console.PrintLog(f"saved {path}\n")
