# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""An analysis of the FEM workbench on a hybrid volume: all but the loads and supports."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from typing import Any

import FreeCAD
import ObjectsFem

from HybridVolume.errors import HybridVolumeError, InputError, OutOfDateError, SetupError

from .fem_mesh import AnalysisMesh
from .loads import misplaced, references
from .properties import transaction
from .volume import UP_TO_DATE, remesh_suffices

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

_LINEAR = {
    "AnalysisType": "static",
    "GeometricalNonlinearity": "linear",
    "MaterialNonlinearity": "linear",
}
"""What a solver does whose stress is Hooke's law of the displacement's derivative."""

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


def mesh_in(analysis: Any) -> Any:
    """The mesh of a hybrid volume in an analysis.

    Raises
    ------
    InputError
        There is none, or several.
    """
    meshes = [one for one in analysis.Group if is_mesh(one)]
    if len(meshes) != 1:
        raise InputError(
            f"{analysis.Label} has {len(meshes) or 'no'} meshes of hybrid volumes",
            remedy="make the analysis of a hybrid volume",
        )
    return meshes[0]


def require_current(mesh: Any) -> None:
    """Refuse a mesh that is older than its body.

    Raises
    ------
    OutOfDateError
    """
    if mesh.Status and mesh.Status != UP_TO_DATE:
        again = [one for one in mesh.InList if getattr(one, "FemMesh", None) == mesh]
        only_mesh = again and remesh_suffices(again[0])
        raise OutOfDateError(
            f"{mesh.Label}: {mesh.Status[:1].lower()}{mesh.Status[1:]}",
            remedy="mesh the volume again" if only_mesh else "compute the hybrid volume again",
        )


def require_static(analysis: Any) -> Any:
    """The solver of an analysis, which must be a linear static one.

    Raises
    ------
    InputError
        There is no solver, or it does something else.
    """
    solvers = [one for one in analysis.Group if one.isDerivedFrom("Fem::FemSolverObject")]
    solvers = [one for one in solvers if not getattr(one, "Suppressed", False)]
    if not solvers:
        raise InputError(f"{analysis.Label} has no solver", remedy="add CalculiX to it")
    for solver in solvers:
        for name, wanted in _LINEAR.items():
            value = getattr(solver, name, wanted)
            if value != wanted:
                raise InputError(
                    f"{solver.Label} has {name} {value}; stresses from displacements need {wanted}",
                    remedy=f"set {name} to {wanted} and solve again",
                )
    return solvers[-1]


def problems(analysis: Any) -> list[HybridVolumeError]:
    """What keeps an analysis from a right answer, as far as it can be told before it is solved.

    Returns
    -------
    list of HybridVolumeError
        Nothing is raised: a mesh that is out of date, a support or load on another body, no
        support at all, no program to solve it.
    """
    try:
        mesh = mesh_in(analysis)
    except InputError as error:
        return [error]
    found: list[HybridVolumeError] = []
    for check in (lambda: require_current(mesh), lambda: require_static(analysis)):
        try:
            check()
        except InputError as error:
            found.append(error)
    found += misplaced(analysis, mesh)
    if not any(True for _ in references(analysis)):
        found.append(
            InputError(
                f"{analysis.Label} has no supports and no loads",
                remedy="pick faces of the body and add them (menu Model of the FEM workbench)",
            )
        )
    try:
        find_calculix()
    except SetupError as error:
        found.append(error)
    return found


def find_calculix() -> str:
    """Path of the CalculiX program that the FEM workbench would take.

    Raises
    ------
    SetupError
        There is none.
    """
    settings = FreeCAD.ParamGet("User parameter:BaseApp/Preferences/Mod/Fem/Ccx")
    named = settings.GetString("ccxBinaryPath", "")
    own = not settings.GetBool("UseStandardCcxLocation", True) or FreeCAD.Version()[0] != "0"
    found = (shutil.which(named) if own and named else None) or shutil.which("ccx")
    if not found:
        raise SetupError(
            "CalculiX (ccx) is not installed",
            remedy="install the package calculix-ccx, or name the program under Edit > Preferences"
            " > FEM > CalculiX",
        )
    return found


def solve(analysis: Any, folder: str | os.PathLike | None = None) -> Any:
    """Solve an analysis with CalculiX and put the accurate stresses into it.

    Parameters
    ----------
    analysis : App.DocumentObject
    folder : path, optional
        Where the solver's files go and stay; else they are removed.

    Returns
    -------
    App.DocumentObject
        The result with the stresses from the displacements; the solver's own is beside it.

    Raises
    ------
    HybridVolumeError
        The first of `problems`, or what the solver or the FEM workbench complained of.
    """
    for problem in problems(analysis):
        raise problem
    with contextlib.ExitStack() as stack:
        if folder is None:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="hybridvolume_"))
        os.makedirs(folder, exist_ok=True)
        run = prepare_run(analysis, folder)
        failed = run.ccx_run()
        return take_results(analysis, run, failed=bool(failed))


def prepare_run(analysis: Any, folder: str | os.PathLike) -> Any:
    """Write the solver's input; what the solver left before is removed from the analysis.

    Parameters
    ----------
    analysis : App.DocumentObject
        Without `problems`.
    folder : path
        It exists.

    Returns
    -------
    femtools.ccxtools.FemToolsCcx
        Its ``inp_file_name`` is what CalculiX is to be given.

    Raises
    ------
    InputError
        The FEM workbench complains.
    """
    from femtools import ccxtools

    run = ccxtools.FemToolsCcx(analysis, require_static(analysis), test_mode=False)
    run.update_objects()
    run.setup_working_dir(str(folder))
    run.setup_ccx(find_calculix())
    complaint = run.check_prerequisites().strip()
    if complaint:
        raise InputError(
            f"{analysis.Label} cannot be solved: {' '.join(complaint.split())}",
            remedy="complete the analysis",
        )
    run.purge_results()
    run.write_inp_file()
    return run


def take_results(analysis: Any, run: Any, *, failed: bool = False) -> Any:
    """Load what the solver wrote, and add the accurate stresses.

    Parameters
    ----------
    analysis : App.DocumentObject
    run : femtools.ccxtools.FemToolsCcx
        Of `prepare_run`, after the solver.
    failed : bool
        Whether the solver said so.

    Returns
    -------
    App.DocumentObject
        As of `solve`.

    Raises
    ------
    HybridVolumeError
    """
    from .stress import recover_stress

    if not failed:
        run.load_results()
    solved = [one for one in analysis.Group if one.isDerivedFrom("Fem::FemResultObject")]
    if failed or not solved:
        raise InputError(
            f"CalculiX did not solve {analysis.Label}",
            remedy="look at its messages in the report view, and at the supports",
        )
    return recover_stress(analysis)


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
        The analysis: mesh, material (steel, to be changed), CalculiX solver (linear, static). Its
        property LoadsOn says which object supports and loads go on, and why where that is a copy
        of the body.

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
        _tell_body(analysis, mesh)
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


def _tell_body(analysis: Any, mesh: Any) -> None:
    """Say in a property of an analysis what loads go on."""
    if mesh.Shape is None:
        return
    text = mesh.Shape.Label
    if mesh.FaceTolerance.Value:
        text += (
            f": a copy whose faces have tolerances of up to {mesh.FaceTolerance.Value:.2g} mm, for"
            " the mesh's nodes are not quite on the CAD faces"
        )
    analysis.addProperty(
        "App::PropertyString", "LoadsOn", "Analysis", "The body that supports and loads go on."
    )
    analysis.LoadsOn = text
    analysis.setEditorMode("LoadsOn", ["ReadOnly"])


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
