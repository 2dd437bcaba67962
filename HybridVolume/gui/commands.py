# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The commands of the workbench."""

from __future__ import annotations

from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore
from PySide.QtCore import QT_TRANSLATE_NOOP

import HybridVolume
from HybridVolume.errors import HybridVolumeError, InputError

from .analysis_commands import (
    ANALYSIS,
    SOLVE,
    STRESS,
    AnalysisCommand,
    SolveCommand,
    StressCommand,
)
from .export_command import EXPORT, ExportCommand
from .import_mesh import IMPORT, ImportMeshCommand

CREATE = "HybridVolume_Create"
QUALITY = "HybridVolume_Quality"
MESH = "HybridVolume_Mesh"
CLEAR = "HybridVolume_ClearRed"
NAMES = [CREATE, QUALITY, CLEAR, MESH, EXPORT, ANALYSIS, SOLVE, STRESS, IMPORT]


class CreateCommand:
    """Opens the task panel for the selected body, or for a hybrid volume that is there."""

    def GetResources(self) -> dict[str, str]:
        """Return icon and texts."""
        return {
            "Pixmap": CREATE,
            "MenuText": QT_TRANSLATE_NOOP(CREATE, "Complete the volume"),
            "ToolTip": QT_TRANSLATE_NOOP(
                CREATE,
                "Complete the volume of the selected body: a shell of NURBS elements along its "
                "faces, tetrahedra in the core, and a mesh for FEM",
            ),
        }

    def IsActive(self) -> bool:
        """Tell whether one thing with a shape is selected and no panel is open."""
        selected = FreeCADGui.Selection.getSelection()
        return len(selected) == 1 and usable(selected[0]) and not FreeCADGui.Control.activeDialog()

    def Activated(self) -> None:
        """Open the panel."""
        open_soon(FreeCADGui.Selection.getSelection()[0])


class QualityCommand:
    """Opens the quality panel of a computed volume, by the volume, a part of it or its body."""

    def GetResources(self) -> dict[str, str]:
        """Return icon and texts."""
        return {
            "Pixmap": QUALITY,
            "MenuText": QT_TRANSLATE_NOOP(QUALITY, "Quality"),
            "ToolTip": QT_TRANSLATE_NOOP(
                QUALITY,
                "Look at a completed volume: cut it open, see its layers and its worst elements, "
                "and what thickness was reached",
            ),
        }

    def IsActive(self) -> bool:
        """Tell whether a result is meant and no panel is open."""
        return not FreeCADGui.Control.activeDialog() and computed_volume() is not None

    def Activated(self) -> None:
        """Open the panel."""
        open_quality_soon(computed_volume())


class MeshCommand:
    """Opens the panel of the finite element mesh of a computed volume."""

    def GetResources(self) -> dict[str, str]:
        """Return icon and texts."""
        return {
            "Pixmap": "HybridVolume_FemMesh",
            "MenuText": QT_TRANSLATE_NOOP(MESH, "FEM mesh"),
            "ToolTip": QT_TRANSLATE_NOOP(
                MESH,
                "Look at the mesh for the FEM workbench, its quality by group and its worst "
                "elements, and make it finer or coarser without computing the shell again",
            ),
        }

    def IsActive(self) -> bool:
        """Tell whether a document is open, and no panel."""
        return FreeCAD.ActiveDocument is not None and not FreeCADGui.Control.activeDialog()

    def Activated(self) -> None:
        """Open the panel, or say which volume is missing."""
        from . import messages

        try:
            open_mesh_soon(meant_volume())
        except InputError as error:
            messages.tell("FEM mesh", error.line)


class ClearCommand:
    """Shows a refused body as it was."""

    def GetResources(self) -> dict[str, str]:
        """Return icon and texts."""
        return {
            "Pixmap": CLEAR,
            "MenuText": QT_TRANSLATE_NOOP(CLEAR, "Clear the red places"),
            "ToolTip": QT_TRANSLATE_NOOP(
                CLEAR, "Show the body as it was, without the places for which it was refused"
            ),
        }

    def IsActive(self) -> bool:
        """Tell whether there are red places."""
        from . import red_places

        return red_places.shown() is not None

    def Activated(self) -> None:
        """Clear them."""
        from . import red_places

        red_places.clear()


def computed_volume() -> Any | None:
    """The volume with a result that is selected, itself, by a part or by its body, or the only one.

    Several volumes of the selected body count as none.
    """
    doc = FreeCAD.ActiveDocument
    if doc is None:
        return None
    selected = FreeCADGui.Selection.getSelection()
    if len(selected) > 1:
        return None
    volumes = [
        obj for obj in doc.findObjects("App::FeaturePython") if is_volume(obj) and obj.Result
    ]
    if selected:
        (one,) = selected
        volumes = [obj for obj in volumes if one is obj or one in obj.OutList]
    return volumes[0] if len(volumes) == 1 else None


def meant_volume() -> Any:
    """The volume with a result that is meant; see :func:`computed_volume`.

    Raises
    ------
    InputError
        None is meant; the error says why.
    """
    found = computed_volume()
    if found is not None:
        return found
    doc, selected = FreeCAD.ActiveDocument, FreeCADGui.Selection.getSelection()
    volumes = [obj for obj in doc.findObjects("App::FeaturePython") if is_volume(obj)]
    computed = [obj for obj in volumes if obj.Result]
    if not computed:
        raise InputError(
            "there is no completed volume in this document",
            remedy="select a body and press Complete the volume first",
        )
    if len(selected) == 1:
        raise InputError(
            f"{selected[0].Label} is no hybrid volume, and none of one body",
            remedy="select a hybrid volume in the tree",
        )
    raise InputError(
        f"it is not clear which of {len(computed)} hybrid volumes is meant",
        remedy="select one of them in the tree, and nothing else",
    )


def open_quality_soon(volume: Any, *, inner: bool = False) -> None:
    """Show the quality panel of a volume as soon as FreeCAD is idle.

    Parameters
    ----------
    volume : App.DocumentObject
    inner : bool
        Begin with the inner boundary alone.
    """
    document, name = volume.Document.Name, volume.Name
    QtCore.QTimer.singleShot(0, lambda: open_quality_panel(document, name, inner=inner))


def open_quality_panel(document: str, name: str, *, inner: bool = False) -> Any | None:
    """Show the quality panel of a volume; None where there is no result, which is then told."""
    from . import messages, red_places
    from .quality_panel import QualityPanel

    volume = FreeCAD.getDocument(document).getObject(name)
    red_places.clear()
    try:
        return _show(QualityPanel(volume, inner=inner))
    except HybridVolumeError as error:
        messages.show_error(error, volume.Source)
        return None


def open_mesh_soon(obj: Any) -> None:
    """Show the panel of a finite element mesh as soon as FreeCAD is idle.

    Parameters
    ----------
    obj : App.DocumentObject
        A hybrid volume, or its mesh.
    """
    document, name = obj.Document.Name, obj.Name
    QtCore.QTimer.singleShot(0, lambda: open_mesh_panel(document, name))


def open_mesh_panel(document: str, name: str) -> Any | None:
    """Show the panel of a finite element mesh; None where there is none, which is then told."""
    from HybridVolume.objects.stored_mesh import volume_object_of

    from . import messages, red_places
    from .mesh_panel import MeshPanel

    obj = FreeCAD.getDocument(document).getObject(name)
    red_places.clear()
    try:
        return _show(MeshPanel(volume_object_of(obj)))
    except HybridVolumeError as error:
        messages.show_error(error, obj)
        return None


def open_soon(obj: Any) -> None:
    """Show the panel of an object as soon as FreeCAD is idle.

    FreeCAD holds a transaction open as long as it runs a command or handles a double click, and
    does not commit those that begin inside: steps of Undo would become one.
    """
    document, name = obj.Document.Name, obj.Name

    # not a recorded line: a macro repeats what is done in the panel, not that it was open
    QtCore.QTimer.singleShot(0, lambda: open_panel(document, name))


def usable(obj: Any) -> bool:
    """Whether an object can be a body (cheap: its faces are not looked at)."""
    kinds = ("Part::Feature", "App::Part", "App::Link")
    ours = _type(obj) in ("HybridVolume::Volume", "HybridVolume::Midstructure")
    return ours or any(obj.isDerivedFrom(kind) for kind in kinds)


def is_volume(obj: Any) -> bool:
    """Whether an object is a hybrid volume."""
    return _type(obj) == "HybridVolume::Volume"


def _type(obj: Any) -> str:
    return getattr(getattr(obj, "Proxy", None), "Type", "")


def open_panel(document: str, name: str) -> Any | None:
    """Show the task panel for an object of a document and return it.

    Parameters
    ----------
    document, name : str
        A body; or a hybrid volume, which is then computed again; or a midstructure.

    Returns
    -------
    panel or None
        None where the body is refused, which is then told.
    """
    from . import preferences

    obj = FreeCAD.getDocument(document).getObject(name)
    if is_volume(obj):
        return open_volume_panel(obj)
    if _type(obj) == "HybridVolume::Midstructure":
        from HybridVolume.objects.midstructure import volume_of

        return open_midstructure_panel(volume_of(obj))
    body = _body_of(obj)
    if preferences.load().ask_midstructure:
        return begin_with_midstructure(body)
    return _open_body_panel(body)


def open_volume_panel(volume: Any) -> Any:
    """Show the panel that computes a hybrid volume."""
    from .task_panel import TaskPanel

    return _show(TaskPanel(volume.Source, volume))


def _open_body_panel(body: Any) -> Any:
    from .task_panel import TaskPanel

    return _show(TaskPanel(body))


def open_midstructure_panel(volume: Any, *, goes_on: bool = False) -> Any:
    """Show the panel of a volume's midstructure; what was never found is looked for at once.

    Parameters
    ----------
    volume : App.DocumentObject
    goes_on : bool
        Whether OK opens the panel of the volume.
    """
    from .midstructure_panel import MidstructurePanel
    from .undo import UndoMark

    panel = _show(MidstructurePanel(volume, UndoMark(volume.Document, volume), goes_on=goes_on))
    if not volume.Midstructure.Facets:
        panel.find()
    return panel


def begin_with_midstructure(body: Any) -> Any | None:
    """Make a volume of a body of one solid and show its midstructure before its shell.

    Several solids, which nobody wants to be asked about one after the other, go to the panel of
    the volume, with the automatic choice.

    Returns
    -------
    panel or None
        None where the body is refused, which is then told.
    """
    from . import messages
    from .macro import start_volume
    from .midstructure_panel import MidstructurePanel
    from .undo import UndoMark
    from .work import count_solids

    try:
        solids = count_solids(body)
    except HybridVolumeError as error:
        messages.show_error(error, body)
        return None
    if solids != 1:
        panel = _open_body_panel(body)
        panel.tell(
            f"{body.Label} has {solids} solids: the midstructure of each is chosen "
            "automatically. It can be changed afterwards by a double click on it in the tree."
        )
        return panel
    mark = UndoMark(body.Document)
    volume = start_volume(body, 1)
    mark.made(volume)
    steps = set(body.Document.UndoNames[:1])
    try:
        panel = _show(MidstructurePanel(volume, mark, goes_on=True))
    except BaseException:
        mark.go_back(steps)
        raise
    panel.find()
    return panel


def _show(panel: Any) -> Any:
    FreeCADGui.Control.showDialog(panel)
    return panel


def _body_of(obj: Any) -> Any:
    """The PartDesign body that an object is a feature of, or the object itself."""
    parent = obj.getParentGeoFeatureGroup()
    return parent if parent is not None and parent.isDerivedFrom("PartDesign::Body") else obj


_COMMANDS = dict(
    zip(
        NAMES,
        (
            *(CreateCommand(), QualityCommand(), ClearCommand(), MeshCommand(), ExportCommand()),
            *(AnalysisCommand(), SolveCommand(), StressCommand(), ImportMeshCommand()),
        ),
        strict=True,
    )
)


def resources(name: str) -> dict[str, str]:
    """Icon and texts of a command."""
    return _COMMANDS[name].GetResources()


def register() -> list[str]:
    """Make the commands known to FreeCAD, if they are not yet, and return their names."""
    from . import fem_workbench

    # FreeCAD begins the macro of a command with an import of the file that made the command known,
    # by its bare name. "import commands" would fail; "import HybridVolume" is what is needed.
    line = compile("add(name, command)", f"{HybridVolume.__name__}.py", "exec")
    known = set(FreeCADGui.listCommands())
    for name, command in _COMMANDS.items():
        if name not in known:
            exec(line, {"add": FreeCADGui.addCommand, "name": name, "command": command})
    fem_workbench.install()
    return NAMES
