# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The whole way from a STEP file to its stresses by mouse and keys; test_gui_fandisk.py judges."""

import os
import shutil
import tempfile
from pathlib import Path

import FreeCAD
import FreeCADGui
import ObjectsFem
from gui_midstructure import click, on_screen, press_standard, whole_window, xdotool
from gui_quality import toolbar
from gui_scenarios import (
    FOLDER,
    WORKBENCH,
    message_box,
    panel,
    screenshot,
    stage,
    wait,
    wait_for,
    widget,
)
from PySide import QtCore, QtGui

FANDISK = Path(__file__).resolve().parent.parent / "resources" / "examples" / "fandisk.step"
FIXED, PUSHED, FORCE = "Face4", "Face84", 50.0
"""The front of the foot, and the top of the blade with a force on it, N."""


def press(button):
    click(button.mapToGlobal(button.rect().center()))


def show_tree():
    """The combo view's first tab, which a first start hides until there is a panel."""
    for dock in FreeCADGui.getMainWindow().findChildren(QtGui.QDockWidget):
        if dock.objectName() in ("Combo View", "Model"):
            dock.show()
            for tabs in dock.findChildren(QtGui.QTabWidget):
                if tabs.objectName() == "combiTab":
                    tabs.setCurrentIndex(0)
    wait(300)


def button_of(command, bar_name=None):
    """The visible button of a command in the window's tool bars."""
    for bar in FreeCADGui.getMainWindow().findChildren(QtGui.QToolBar):
        for action in bar.actions() if bar_name in (None, bar.objectName()) else ():
            button = bar.widgetForAction(action)
            if action.objectName() == command and button is not None and button.isVisible():
                return button
    return None


def command_button(command):
    """Click a command's button; from 1.0 on some are in a menu of their group's button."""
    wait(700)
    button = button_of(command)
    if button is None:
        FreeCADGui.runCommand(command)
    else:
        press(button)


def fem_toolbar(command):
    """Click a button that this workbench adds to the FEM workbench."""
    wait(700)
    press(button_of(command, "HybridVolumeFem"))


def open_file(path):
    """File > Open, in FreeCAD's dialog."""

    def fill():
        xdotool("type", path)
        xdotool("key", "Return")
        QtCore.QTimer.singleShot(1000, accept)

    def accept():
        # from 1.0 on FreeCAD asks how to read a STEP file
        asked = QtGui.QApplication.activeModalWidget()
        if asked is not None and not isinstance(asked, QtGui.QFileDialog):
            xdotool("key", "Return")
        if FreeCAD.ActiveDocument is None:
            QtCore.QTimer.singleShot(500, accept)

    QtCore.QTimer.singleShot(1200, fill)
    FreeCADGui.runCommand("Std_Open")
    wait(800)
    return FreeCAD.ActiveDocument


def pick(body, name):
    """Click a face of a body in the 3D view."""
    face = body.Shape.getElement(name)
    first_u, last_u, first_v, last_v = face.ParameterRange
    place = on_screen(tuple(face.valueAt((first_u + last_u) / 2, (first_v + last_v) / 2)))
    for _ in range(3):
        click(place)
        wait(300)
        found = [s for one in FreeCADGui.Selection.getSelectionEx() for s in one.SubElementNames]
        # a constraint's panel takes what is picked out of the selection
        if found or FreeCADGui.Control.activeDialog():
            return found
    screenshot("not_picked")
    raise LookupError(f"{name} is not selected by a click")


def add_face(body, name):
    """Give a face to the constraint whose panel is open."""
    press(widget("btnAdd"))
    pick(body, name)
    wait(200)
    obj = FreeCADGui.activeDocument().getInEdit().Object
    return [[one.Name, list(names)] for one, names in obj.References]


def from_file_to_stress(answer):
    """Open the fandisk, complete it, fix a face, push at another, solve, look at von Mises."""
    FreeCADGui.activateWorkbench(WORKBENCH)
    wait(300)
    whole_window()
    doc = open_file(FANDISK)
    (body,) = doc.Objects
    view = FreeCADGui.activeDocument().activeView()
    view.viewIsometric()
    FreeCADGui.SendMsgToActiveView("ViewFit")
    wait(900)
    answer["picked"] = {"body": pick(body, PUSHED)}
    toolbar("HybridVolume_Create")
    wait_for(panel)
    if os.environ.get("HYBRIDVOLUME_ORDER") == "1":
        press(widget("meshToggle"))
        widget("order", QtGui.QComboBox).setCurrentIndex(1)
        press(widget("meshToggle"))
    press(widget("run", QtGui.QPushButton))
    wait_for(lambda: stage() == "Done", 300.0)
    press_standard("Close")
    wait(500)
    analyse(answer, doc, body)
    by_macro(answer)


def analyse(answer, doc, body):
    """From the completed body to its stresses; the document is saved and opened again."""
    view = FreeCADGui.activeDocument().activeView()
    FreeCADGui.Selection.clearSelection()
    show_tree()
    toolbar("HybridVolume_Analysis")
    wait_for(lambda: doc.findObjects("Fem::FemAnalysis"))
    wait_for(lambda: FreeCADGui.activeWorkbench().name() == "FemWorkbench")
    wait(1000)
    analysis = doc.findObjects("Fem::FemAnalysis")[0]
    answer["status bar"] = FreeCADGui.getMainWindow().statusBar().currentMessage()
    screenshot("analysis")

    command_button("FEM_ConstraintFixed")
    wait_for(FreeCADGui.Control.activeDialog)
    wait(700)
    view.fitAll()
    wait(900)
    answer["picked"]["fixed"] = add_face(body, FIXED)
    press_standard("OK")
    wait(400)
    command_button("FEM_ConstraintForce")
    wait_for(FreeCADGui.Control.activeDialog)
    wait(700)
    answer["picked"]["pushed"] = add_face(body, PUSHED)
    field = widget("spinForce")
    click(field.mapToGlobal(QtCore.QPoint(20, field.height() // 2)))
    xdotool("key", "ctrl+a")
    xdotool("type", f"{FORCE:g}")
    xdotool("key", "Tab")
    wait(200)
    screenshot("force")
    press_standard("OK")
    wait(500)
    (force,) = [one for one in analysis.Group if one.isDerivedFrom("Fem::ConstraintForce")]
    answer["force"] = [
        float(getattr(force.Force, "Value", 1000.0 * force.Force)) / 1000.0,
        *force.DirectionVector,
    ]
    answer["told"] = message_box() is not None

    fem_toolbar("HybridVolume_Solve")
    wait_for(lambda: FreeCADGui.Control.activeDialog() or message_box(), 300.0)
    answer["refused"] = message_box().text() if message_box() else ""
    wait(800)
    view.viewIsometric()
    FreeCADGui.SendMsgToActiveView("ViewFit")
    wait(900)
    screenshot("stress")
    answer["von Mises is chosen"] = widget("rb_vm_stress").isChecked()
    result = doc.HybridVolume_Results
    answer["mises"] = list(result.vonMises)
    answer["length"] = list(result.DisplacementLengths)
    press_standard("Close")
    wait(300)
    # once more from the displacements alone, as after the FEM workbench's own solver panel
    steps = doc.UndoCount
    fem_toolbar("HybridVolume_Stress")
    wait_for(lambda: FreeCADGui.Control.activeDialog() or message_box())
    wait(300)
    answer["again"] = [doc.UndoCount - steps, max(doc.HybridVolume_Results.vonMises)]
    press_standard("Close")
    wait(300)
    doc.saveAs(str(FOLDER / "fandisk.FCStd"))


def by_macro(answer):
    """The same by the lines of a macro, on the shell that the panel has computed."""
    import HybridVolume
    from HybridVolume.core.hybrid import load

    with tempfile.TemporaryDirectory() as folder:
        path = shutil.copy(FreeCAD.ActiveDocument.HybridVolume.Result, folder)
        volume = load(path)
    doc = FreeCAD.newDocument()
    body = doc.addObject("Part::Feature", "Body")
    body.Shape = HybridVolume.read_step(FANDISK)[0].shape
    analysis = HybridVolume.make_analysis(HybridVolume.to_document(volume, doc, body))
    fixed = ObjectsFem.makeConstraintFixed(doc)
    fixed.References = [(body, FIXED)]
    force = ObjectsFem.makeConstraintForce(doc)
    force.References = [(body, PUSHED)]
    force.Force = FORCE if FreeCAD.Version()[0] == "0" else f"{FORCE} N"
    analysis.addObjects([fixed, force])
    doc.recompute()
    # as the panel does: along the normal of the first face
    force.DirectionVector = FreeCAD.Vector(0.0, 0.0, 1.0)
    result = HybridVolume.solve(analysis)
    answer["macro"] = {
        "mises": list(result.vonMises),
        "length": list(result.DisplacementLengths),
        "direction": list(force.DirectionVector),
    }
