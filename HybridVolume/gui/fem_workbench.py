# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What this workbench adds to the FEM workbench's window: a tool bar, and a word on loads that
would act on nothing.
"""

from __future__ import annotations

import contextlib
from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore, QtGui

from . import messages
from .forms import load_icon

BAR = "HybridVolumeFem"
WORKBENCH = "FemWorkbench"

_installed = False


def install() -> None:
    """Begin to look after the FEM workbench; once for all documents."""
    global _installed
    if not _installed:
        _installed = True
        FreeCADGui.getMainWindow().workbenchActivated.connect(_follow)
        FreeCADGui.addDocumentObserver(_Constraints())
        _follow(FreeCADGui.activeWorkbench().name())


def _follow(workbench: str) -> None:
    """Show the tool bar in the FEM workbench; FreeCAD hides it in others."""
    window = FreeCADGui.getMainWindow()
    bar = window.findChild(QtGui.QToolBar, BAR)
    if workbench != WORKBENCH:
        if bar is not None:
            bar.hide()
        return
    if bar is None:
        bar = _make_bar(window)
    bar.toggleViewAction().setVisible(True)
    bar.show()


def _make_bar(window: Any) -> Any:
    from . import commands

    commands.register()
    bar = QtGui.QToolBar("HybridVolume", window)
    bar.setObjectName(BAR)
    for name in (commands.MESH, commands.SOLVE, commands.STRESS):
        words = commands.resources(name)
        action = bar.addAction(load_icon(words["Pixmap"]), words["MenuText"])
        action.setObjectName(name)
        action.setToolTip(words["ToolTip"])
        action.triggered.connect(lambda *_, name=name: FreeCADGui.runCommand(name))
    window.addToolBar(bar)
    return bar


class _Constraints:
    """Observer of FreeCAD's window: looks at supports and loads when their panel is closed."""

    def slotResetEdit(self, view: Any) -> None:
        """Tell a support or load that is not on the body that was meshed."""
        obj = getattr(view, "Object", None)
        if obj is not None and obj.isDerivedFrom("Fem::Constraint"):
            document, name = obj.Document.Name, obj.Name
            # Later: FreeCAD is still closing the panel.
            QtCore.QTimer.singleShot(0, lambda: _check(document, name))


def _check(document: str, name: str) -> None:
    from HybridVolume.errors import InputError
    from HybridVolume.objects.analysis import mesh_in
    from HybridVolume.objects.loads import misplaced

    doc = FreeCAD.listDocuments().get(document)
    obj = doc.getObject(name) if doc else None
    if obj is None:  # Cancel of a new one
        return
    for analysis in doc.findObjects("Fem::FemAnalysis"):
        if obj in analysis.Group:
            with contextlib.suppress(InputError):  # an analysis of others
                wrong = [
                    error
                    for error in misplaced(analysis, mesh_in(analysis))
                    if error.message.startswith(f"{obj.Label} is on ")
                ]
                if wrong:
                    messages.tell("Supports and loads", wrong[0].line)
