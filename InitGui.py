# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""FreeCAD runs this when its window starts: it announces the workbench and loads nothing of it."""

import os

import FreeCADGui

import HybridVolume

# FreeCAD executes this file without __file__, and inside a function: neither the class nor its
# methods see the names of this file.
_RESOURCES = os.path.join(os.path.dirname(os.path.dirname(HybridVolume.__file__)), "resources")


class HybridVolumeWorkbench(FreeCADGui.Workbench):
    """Completes the volume of NURBS bodies."""

    MenuText = "HybridVolume"
    ToolTip = "Complete the volume of a body with NURBS faces"

    def Initialize(self):
        """Make the commands known; called when the workbench is opened for the first time."""
        from HybridVolume.gui import commands

        names = commands.register()
        self.appendToolbar("HybridVolume", names)
        self.appendMenu("HybridVolume", names)

    def ContextMenu(self, recipient):
        """Offer the command on a body that is clicked with the right button."""
        if recipient == "View":
            from HybridVolume.gui import commands

            self.appendContextMenu("HybridVolume", commands.NAMES)

    def GetClassName(self):
        """Return the C++ class behind a workbench in Python."""
        return "Gui::PythonWorkbench"


HybridVolumeWorkbench.Icon = os.path.join(_RESOURCES, "icons", "HybridVolume.svg")
FreeCADGui.addIconPath(os.path.join(_RESOURCES, "icons"))
FreeCADGui.addPreferencePage(os.path.join(_RESOURCES, "ui", "preferences.ui"), "HybridVolume")
FreeCADGui.addWorkbench(HybridVolumeWorkbench())
