# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""An analysis of the FEM workbench on a hybrid volume: all but the loads and supports."""

from __future__ import annotations

from typing import Any

import ObjectsFem

from HybridVolume.errors import InputError

from .fem_mesh import AnalysisMesh
from .properties import transaction
from .volume import UP_TO_DATE

STEEL = {
    "Name": "CalculiX-Steel",
    "YoungsModulus": "210000 MPa",
    "PoissonRatio": "0.3",
    "Density": "7900 kg/m^3",
    "ThermalConductivity": "43 W/m/K",
    "ThermalExpansionCoefficient": "0.000012 m/m/K",
    "SpecificHeat": "590 J/kg/K",
}
"""FreeCAD's own card of that name; the user changes it as any material."""

PARTS = ("Shell", "Core")
"""Groups of volume elements that can have a material each."""

_SOLVERS = ("makeSolverCalculiXCcxTools", "makeSolverCalculixCcxTools")
"""Names of the same maker in FreeCAD 1.x and 0.20."""


def mesh_of(obj: Any) -> Any:
    """The mesh for analyses that an object stands for.

    Parameters
    ----------
    obj : App.DocumentObject
        A hybrid volume, one of its parts, its mesh, or the body it was made of.

    Raises
    ------
    InputError
        There is none, or several, or it was not computed yet.
    """
    if is_mesh(obj):
        found = [obj]
    else:
        volumes = [
            one for one in (obj, *obj.InList) if getattr(one, "FemMesh", None) and not is_mesh(one)
        ]
        found = list(dict.fromkeys(one.FemMesh for one in volumes if is_mesh(one.FemMesh)))
    if len(found) != 1:
        raise InputError(
            f"{obj.Label} has {len(found) or 'no'} meshes of hybrid volumes",
            remedy="select the hybrid volume, and complete it first if there is none",
        )
    if not found[0].FemMesh.VolumeCount:
        raise InputError(
            f"{found[0].Label} has no elements yet", remedy="complete the volume first"
        )
    return found[0]


def is_mesh(obj: Any) -> bool:
    """Whether an object is the mesh of a hybrid volume for analyses."""
    return getattr(getattr(obj, "Proxy", None), "Type", "") == AnalysisMesh.Type


def require_current(mesh: Any) -> None:
    """Refuse a mesh that is older than its body.

    Raises
    ------
    InputError
    """
    if mesh.Status and mesh.Status != UP_TO_DATE:
        raise InputError(
            f"{mesh.Label}: {mesh.Status[:1].lower()}{mesh.Status[1:]}",
            remedy="compute the hybrid volume again",
        )


def make_analysis(obj: Any, *, materials_apart: bool = False) -> Any:
    """Make an analysis of a hybrid volume, ready for loads and supports, in one step of Undo.

    Parameters
    ----------
    obj : App.DocumentObject
        A hybrid volume, its mesh, or the body it was made of.
    materials_apart : bool
        A material for the shell and another for the core; otherwise one for both.

    Returns
    -------
    App.DocumentObject
        The analysis: mesh, material (steel, to be changed), CalculiX solver (linear, static).

    Raises
    ------
    InputError
        There is no mesh, or it is out of date.
    """
    mesh = mesh_of(obj)
    require_current(mesh)
    doc = mesh.Document
    with transaction(doc, "Make an analysis"):
        analysis = ObjectsFem.makeAnalysis(doc, "Analysis")
        maker = next(getattr(ObjectsFem, name) for name in _SOLVERS if hasattr(ObjectsFem, name))
        solver = maker(doc)
        solver.AnalysisType = "static"
        solver.GeometricalNonlinearity = "linear"
        names = [f"{part}Material" for part in PARTS] if materials_apart else ["Material"]
        materials = [ObjectsFem.makeMaterialSolid(doc, name) for name in names]
        for material in materials:
            material.Material = STEEL
        if materials_apart:
            _name_groups(mesh, materials)
            # the workbench lets one material be without a reference; the groups are what counts
            if mesh.Shape is not None:
                materials[0].References = [(mesh.Shape, ("Solid1",))]
        analysis.addObjects([solver, *materials, mesh])
        doc.recompute()
    return analysis


def _name_groups(mesh: Any, materials: list[Any]) -> None:
    """Add groups to a mesh by which the FEM workbench gives each part its material."""
    changed = mesh.FemMesh.copy()
    held = {changed.getGroupName(number): number for number in changed.Groups}
    for part, material in zip(PARTS, materials, strict=True):
        # the FEM workbench looks for the material's own name before an underscore
        name = f"{material.Name}_{part}"
        if name not in held:
            group = changed.addGroup(name, "Volume")
            changed.addGroupElements(group, list(changed.getGroupElements(held[part])))
    mesh.FemMesh = changed
