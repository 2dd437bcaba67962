# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Commands on the way to an analysis of the FEM workbench, and back with better stresses.

They can be used whenever a document is open: what is missing is said, where they are pressed.
"""

from __future__ import annotations

from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore, QtGui
from PySide.QtCore import QT_TRANSLATE_NOOP

from HybridVolume.errors import HybridVolumeError, InputError

from . import messages
from .dock import WideDock

ANALYSIS = "HybridVolume_Analysis"
SOLVE = "HybridVolume_Solve"
STRESS = "HybridVolume_Stress"

WIDTH = 430
"""Of the dock with the FEM workbench's panel of results, pixels."""

READY = (
    "Next: pick a face of {body}, then a support or a load in the menu Model; at last "
    "HybridVolume's Solve, which shows the stresses."
)


class _Command:
    """A command that says itself what it lacks."""

    NAME, MENU, TIP = "", "", ""

    def GetResources(self) -> dict[str, str]:
        """Return icon and texts."""
        return {"Pixmap": self.NAME, "MenuText": self.MENU, "ToolTip": self.TIP}

    def IsActive(self) -> bool:
        """Tell whether a document is open, and no panel."""
        return FreeCAD.ActiveDocument is not None and not FreeCADGui.Control.activeDialog()

    def Activated(self) -> None:
        """Do it as soon as FreeCAD is idle."""
        # a step of Undo that begins inside a running command is not committed
        QtCore.QTimer.singleShot(0, self.run)

    def run(self) -> None:
        """Do it, or say what is missing."""
        raise NotImplementedError


class AnalysisCommand(_Command):
    """Makes an analysis of the selected volume and goes to the FEM workbench."""

    NAME = ANALYSIS
    MENU = QT_TRANSLATE_NOOP(ANALYSIS, "Analysis")
    TIP = QT_TRANSLATE_NOOP(
        ANALYSIS,
        "Make an analysis of the FEM workbench with the mesh of a completed volume, a "
        "material and the CalculiX solver; supports and loads go on the faces of the body",
    )

    def run(self) -> None:
        """Make it."""
        from . import commands

        try:
            volume = commands.meant_volume()
        except InputError as error:
            messages.tell("Analysis", error.line)
            return
        make_analysis(volume.Document.Name, volume.Name)


class SolveCommand(_Command):
    """Solves the active analysis beside the living window and shows the stresses."""

    NAME = SOLVE
    MENU = QT_TRANSLATE_NOOP(SOLVE, "Solve")
    TIP = QT_TRANSLATE_NOOP(
        SOLVE,
        "Check the analysis of a hybrid volume, solve it with CalculiX, and show the stresses "
        "that are taken from the displacements",
    )

    def run(self) -> None:
        """Begin."""
        from . import solve

        try:
            analysis = meant_analysis()
        except InputError as error:
            messages.tell("Solve", error.line)
            return
        solve.start(analysis)


class StressCommand(_Command):
    """Adds the stresses from displacements to a solved analysis and shows them."""

    NAME = STRESS
    MENU = QT_TRANSLATE_NOOP(STRESS, "Accurate stresses")
    TIP = QT_TRANSLATE_NOOP(
        STRESS,
        "Add a result to the solved analysis whose stresses are taken from the "
        "displacements at the nodes: at the boundary they are closer than the solver's",
    )

    def run(self) -> None:
        """Add and show them."""
        try:
            analysis = meant_analysis()
        except InputError as error:
            messages.tell("Accurate stresses", error.line)
            return
        show_stress(analysis.Document.Name, analysis.Name)


def meant_analysis() -> Any:
    """The analysis of a hybrid volume that is meant: selected, active, or the only one.

    Raises
    ------
    InputError
        There is none, or there are several and none is selected or active.
    """
    import FemGui

    from HybridVolume.objects.analysis import is_mesh

    doc = FreeCAD.ActiveDocument
    every = doc.findObjects("Fem::FemAnalysis")
    found = [one for one in every if any(is_mesh(part) for part in one.Group)]
    if not found:
        raise InputError(
            "there is no analysis of a hybrid volume",
            remedy="select the hybrid volume and press Analysis first",
        )
    selected = FreeCADGui.Selection.getSelection()
    meant = [one for one in found if one in selected or set(one.Group) & set(selected)]
    meant = meant or [one for one in found if one is FemGui.getActiveAnalysis()] or found
    if len(meant) > 1:
        raise InputError(
            f"there are {len(meant)} analyses of hybrid volumes",
            remedy="select one of them in the tree",
        )
    return meant[0]


def make_analysis(document: str, name: str) -> Any | None:
    """Make an analysis of a volume and show the body to pick faces of; None where it is refused."""
    volume = FreeCAD.getDocument(document).getObject(name)
    before = set(volume.Document.findObjects("Fem::FemAnalysis"))
    try:
        FreeCADGui.doCommand("import HybridVolume")
        FreeCADGui.doCommand(f"HybridVolume.make_analysis({object_text(volume)})")
    except HybridVolumeError as error:
        refuse(error, volume)
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
    # a long name would hide what is to be done
    short = body.Label if len(body.Label) < 16 else "the body"
    FreeCADGui.getMainWindow().statusBar().showMessage(READY.format(body=short), 60_000)
    _tell_without_solver()
    return analysis


def _tell_without_solver() -> None:
    from HybridVolume.objects.analysis import find_calculix

    try:
        find_calculix()
    except HybridVolumeError as error:
        messages.tell(
            "Analysis", f"The analysis can be prepared, but not solved here: {error.line}."
        )


def show_stress(document: str, name: str) -> Any | None:
    """Add the stresses to a solved analysis and show them; None where that is refused."""
    analysis = FreeCAD.getDocument(document).getObject(name)
    try:
        FreeCADGui.doCommand("import HybridVolume")
        FreeCADGui.doCommand(f"HybridVolume.recover_stress({object_text(analysis)})")
    except HybridVolumeError as error:
        refuse(error, analysis)
        return None
    return show_result(analysis)


def show_result(analysis: Any) -> Any:
    """Open the last result of an analysis in the FEM workbench's own panel: von Mises stress."""
    result = analysis.Group[-1]
    for one in analysis.Document.Objects:
        # what covers the result
        covers = one.isDerivedFrom("Part::Feature") or one.isDerivedFrom("Fem::Constraint")
        if one.ViewObject and covers:
            one.ViewObject.Visibility = False
    if result.Mesh and result.Mesh.ViewObject:
        result.Mesh.ViewObject.Visibility = True
        # the colours count: the lines of a fine mesh would cover them
        result.Mesh.ViewObject.DisplayMode = "Faces"
    # what the workbench's panel begins with: von Mises stress, on the undeformed mesh
    FreeCAD.FEM_dialog = {
        **{"results_type": "Sabs", "show_disp": False},
        **{"disp_factor": 0.0, "disp_factor_max": 100.0},
    }
    FreeCADGui.getDocument(analysis.Document.Name).setEdit(result.Name)
    choice = FreeCADGui.getMainWindow().findChild(QtGui.QWidget, "rb_vm_stress")
    if choice is not None:
        dock = WideDock(choice, WIDTH)
        choice.destroyed.connect(lambda *_: dock.close())
    return result


def refuse(error: HybridVolumeError, obj: Any) -> None:
    """Say why something about an analysis or its volume is not done; offer what would help.

    Parameters
    ----------
    error : HybridVolumeError
    obj : App.DocumentObject
        A hybrid volume or an analysis of one.
    """
    from HybridVolume.errors import OutOfDateError
    from HybridVolume.objects.analysis import mesh_in
    from HybridVolume.objects.stored_mesh import volume_object_of
    from HybridVolume.objects.volume import remesh_suffices

    from . import commands

    if not isinstance(error, OutOfDateError):
        messages.show_error(error, obj)
        return
    try:
        mesh = mesh_in(obj) if obj.isDerivedFrom("Fem::FemAnalysis") else obj
        volume = volume_object_of(mesh)
    except InputError:  # a mesh without a hybrid volume
        messages.show_error(error, obj)
        return
    only_mesh = remesh_suffices(volume)
    document, name = volume.Document.Name, volume.Name

    def again() -> None:
        if FreeCADGui.Control.activeDialog():
            return
        opened = commands.open_mesh_panel if only_mesh else commands.open_panel
        panel = opened(document, name)
        if panel is not None:
            panel.run()

    messages.offer(error, "Mesh again" if only_mesh else "Compute again", again)


def object_text(obj: Any) -> str:
    """Expression for an object of a document."""
    return f"App.getDocument({obj.Document.Name!r}).getObject({obj.Name!r})"
