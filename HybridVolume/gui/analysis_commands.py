# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Commands on the way to an analysis of the FEM workbench, and back with better stresses."""

from __future__ import annotations

import shutil
from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore
from PySide.QtCore import QT_TRANSLATE_NOOP

from HybridVolume.errors import HybridVolumeError

ANALYSIS = "HybridVolume_Analysis"
STRESS = "HybridVolume_Stress"

NO_SOLVER = (
    "CalculiX (ccx) is not installed: the analysis can be prepared, but not solved. Install the "
    "package calculix-ccx, or name the program under Edit > Preferences > FEM > CalculiX."
)
READY = (
    "The analysis is ready: pick faces of {body} and give them supports and loads (menu Model), "
    "then run the solver. Stresses at the boundary are best seen by "
    "HybridVolume > Accurate stresses afterwards."
)


class AnalysisCommand:
    """Makes an analysis of the selected volume and goes to the FEM workbench."""

    def GetResources(self) -> dict[str, str]:
        """Return icon and texts."""
        return {
            "Pixmap": ANALYSIS,
            "MenuText": QT_TRANSLATE_NOOP(ANALYSIS, "Analysis"),
            "ToolTip": QT_TRANSLATE_NOOP(
                ANALYSIS,
                "Make an analysis of the FEM workbench with the mesh of a completed volume, a "
                "material and the CalculiX solver; supports and loads go on the faces of the body",
            ),
        }

    def IsActive(self) -> bool:
        """Tell whether a computed volume is meant and no panel is open."""
        from . import commands

        return not FreeCADGui.Control.activeDialog() and commands.computed_volume() is not None

    def Activated(self) -> None:
        """Make it."""
        from . import commands

        volume = commands.computed_volume()
        document, name = volume.Document.Name, volume.Name
        # a step of Undo that begins inside a running command is not committed
        QtCore.QTimer.singleShot(0, lambda: make_analysis(document, name))


class StressCommand:
    """Adds the stresses from displacements to the active analysis and shows them."""

    def GetResources(self) -> dict[str, str]:
        """Return icon and texts."""
        return {
            "Pixmap": STRESS,
            "MenuText": QT_TRANSLATE_NOOP(STRESS, "Accurate stresses"),
            "ToolTip": QT_TRANSLATE_NOOP(
                STRESS,
                "Add a result to the solved analysis whose stresses are taken from the "
                "displacements at the nodes: at the boundary they are closer than the solver's",
            ),
        }

    def IsActive(self) -> bool:
        """Tell whether there is a solved analysis of a hybrid volume and no panel is open."""
        return not FreeCADGui.Control.activeDialog() and solved_analysis() is not None

    def Activated(self) -> None:
        """Add and show them."""
        analysis = solved_analysis()
        document, name = analysis.Document.Name, analysis.Name
        QtCore.QTimer.singleShot(0, lambda: show_stress(document, name))


def solved_analysis() -> Any | None:
    """The analysis that is meant: the selected one, the active one, or the only one."""
    doc = FreeCAD.ActiveDocument
    if doc is None:
        return None
    found = [one for one in doc.findObjects("Fem::FemAnalysis") if _is_ours(one)]
    selected = FreeCADGui.Selection.getSelection()
    meant = [one for one in found if one in selected or set(one.Group) & set(selected)]
    if not meant and len(found) > 1:
        import FemGui

        meant = [one for one in found if one is FemGui.getActiveAnalysis()]
    meant = meant or found
    return meant[0] if len(meant) == 1 else None


def _is_ours(analysis: Any) -> bool:
    kinds = [getattr(getattr(one, "Proxy", None), "Type", "") for one in analysis.Group]
    solved = any(one.isDerivedFrom("Fem::FemResultObject") for one in analysis.Group)
    return solved and "HybridVolume::AnalysisMesh" in kinds


def make_analysis(document: str, name: str) -> Any | None:
    """Make an analysis of a volume and show the body to pick faces of; None where it is refused."""
    from . import messages

    volume = FreeCAD.getDocument(document).getObject(name)
    words = f"App.getDocument({document!r}).getObject({name!r})"
    before = set(volume.Document.findObjects("Fem::FemAnalysis"))
    try:
        FreeCADGui.doCommand("import HybridVolume")
        FreeCADGui.doCommand(f"HybridVolume.make_analysis({words})")
    except HybridVolumeError as error:
        messages.show_error(error, volume.Source)
        return None
    (analysis,) = set(volume.Document.findObjects("Fem::FemAnalysis")) - before
    body = volume.FemMesh.Shape or volume.Source
    FreeCADGui.activateWorkbench("FemWorkbench")
    import FemGui

    FemGui.setActiveAnalysis(analysis)
    for one in (volume.Shell, volume.Core, volume.InnerBoundary, volume.FemMesh):
        if one and one.ViewObject:
            one.ViewObject.Visibility = False
    body.ViewObject.Visibility = True
    FreeCADGui.Selection.clearSelection()
    FreeCAD.Console.PrintMessage(READY.format(body=body.Label) + "\n")
    FreeCADGui.getMainWindow().statusBar().showMessage(READY.format(body=body.Label), 20_000)
    if not _solver_found():
        messages.tell("Analysis", NO_SOLVER)
    return analysis


def _solver_found() -> bool:
    """Whether FreeCAD will find CalculiX."""
    settings = FreeCAD.ParamGet("User parameter:BaseApp/Preferences/Mod/Fem/Ccx")
    named = settings.GetString("ccxBinaryPath", "")
    return bool(shutil.which("ccx") or (named and shutil.which(named)))


def show_stress(document: str, name: str) -> Any | None:
    """Add the stresses to an analysis and open them in the FEM workbench's own panel."""
    from . import messages

    analysis = FreeCAD.getDocument(document).getObject(name)
    words = f"App.getDocument({document!r}).getObject({name!r})"
    try:
        FreeCADGui.doCommand("import HybridVolume")
        FreeCADGui.doCommand(f"HybridVolume.recover_stress({words})")
    except HybridVolumeError as error:
        messages.show_error(error, analysis)
        return None
    result = analysis.Group[-1]
    for one in analysis.Document.Objects:
        # what covers the result
        if one.ViewObject and one.isDerivedFrom("Part::Feature"):
            one.ViewObject.Visibility = False
    if result.Mesh and result.Mesh.ViewObject:
        result.Mesh.ViewObject.Visibility = True
    # what the workbench's panel begins with: von Mises stress, on the undeformed mesh
    FreeCAD.FEM_dialog = {
        **{"results_type": "Sabs", "show_disp": False},
        **{"disp_factor": 0.0, "disp_factor_max": 100.0},
    }
    FreeCADGui.getDocument(document).setEdit(result.Name)
    return result
