# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The commands of the workbench."""

from __future__ import annotations

from typing import Any

import FreeCAD
import FreeCADGui
from PySide.QtCore import QT_TRANSLATE_NOOP

CREATE = "HybridVolume_Create"
NAMES = [CREATE]


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
        obj = FreeCADGui.Selection.getSelection()[0]
        FreeCADGui.doCommandGui("from HybridVolume.gui import commands")
        FreeCADGui.doCommandGui(f"commands.open_panel({obj.Document.Name!r}, {obj.Name!r})")


def usable(obj: Any) -> bool:
    """Whether an object can be a body (cheap: its faces are not looked at)."""
    kinds = ("Part::Feature", "App::Part", "App::Link")
    return is_volume(obj) or any(obj.isDerivedFrom(kind) for kind in kinds)


def is_volume(obj: Any) -> bool:
    """Whether an object is a hybrid volume."""
    return getattr(getattr(obj, "Proxy", None), "Type", "") == "HybridVolume::Volume"


def open_panel(document: str, name: str) -> Any:
    """Show the task panel for an object of a document and return it.

    Parameters
    ----------
    document, name : str
        A body, or a hybrid volume, which is then computed again.
    """
    from .task_panel import TaskPanel

    obj = FreeCAD.getDocument(document).getObject(name)
    panel = TaskPanel(obj.Source, obj) if is_volume(obj) else TaskPanel(_body_of(obj))
    FreeCADGui.Control.showDialog(panel)
    return panel


def _body_of(obj: Any) -> Any:
    """The PartDesign body that an object is a feature of, or the object itself."""
    parent = obj.getParentGeoFeatureGroup()
    return parent if parent is not None and parent.isDerivedFrom("PartDesign::Body") else obj


def register() -> list[str]:
    """Make the commands known to FreeCAD and return their names."""
    FreeCADGui.addCommand(CREATE, CreateCommand())
    return NAMES
