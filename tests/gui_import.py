# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Mesh files become bodies in FreeCAD's real window; test_gui_import.py judges."""

import FreeCAD
import FreeCADGui
from gui_midstructure import click as click_at
from gui_midstructure import key, record, whole_window, xdotool
from gui_quality import toolbar
from gui_scenarios import (
    FOLDER,
    WORKBENCH,
    close_panel,
    message_box,
    objects,
    open_panel,
    screenshot,
    stage,
    wait,
    wait_for,
)
from gui_scenarios import click as press_in_panel
from PySide import QtCore, QtGui

OURS = "HybridVolume quad mesh or cage"
SCHEMES = ("bilinear", "catmullClark", "smooth")


def window(kind, name="", *, other=()):
    """An open window of a kind, of a name, or of none of some names."""
    for one in QtGui.QApplication.topLevelWidgets():
        if isinstance(one, kind) and one.isVisible() and one.objectName() not in other:
            if not name or one.objectName() == name:
                return one
    return None


def question():
    return window(QtGui.QDialog, "HybridVolumeImportDialog")


def child(name):
    return question().findChild(QtGui.QWidget, name)


def standard(text):
    buttons = question().findChild(QtGui.QDialogButtonBox).buttons()
    return next(button for button in buttons if button.text().replace("&", "") == text)


def press(button):
    """Click a button in the middle, a radio button beside its left end."""
    place = button.rect().center()
    if isinstance(button, QtGui.QRadioButton):
        place.setX(8)
    click_at(button.mapToGlobal(place))


def type_into(name, text):
    box = child(name)
    click_at(box.mapToGlobal(box.rect().center()))
    key("ctrl+a")
    xdotool("type", text)
    key("Tab")


def shown():
    """What the question tells, and what can be chosen."""
    labels = ("found", "refusal", "bilinearWords", "stepsWords", "angleWords")
    return {
        "enabled": [name for name in (*SCHEMES, "steps", "angle") if child(name).isEnabled()],
        "checked": [name for name in SCHEMES if child(name).isChecked()],
        "import": standard("Import").isEnabled(),
        "why": standard("Import").toolTip(),
        **{name: child(name).text() if child(name).isVisible() else "" for name in labels},
    }


def file_menu(command, path, words):
    """Choose a file in the dialog of FreeCAD's own File menu, by the filter with these words.

    Returns
    -------
    list of str
        The filters.
    """
    seen = []

    def fill():
        box = window(QtGui.QFileDialog)
        if box is None:
            QtCore.QTimer.singleShot(100, fill)
            return
        seen.extend(box.nameFilters())
        box.selectNameFilter(next(text for text in seen if words in text))
        box.findChild(QtGui.QLineEdit).setText(str(path))
        QtCore.QTimer.singleShot(300, box.accept)

    QtCore.QTimer.singleShot(300, fill)
    FreeCADGui.runCommand(command)
    return seen


def choose_module():
    """Answer FreeCAD when it asks which of its modules should read a file.

    Returns
    -------
    list of str
        What it offers, as soon as it has asked.
    """
    seen = []

    def fill():
        box = window(QtGui.QDialog, other=("HybridVolumeImportDialog",))
        buttons = box.findChildren(QtGui.QRadioButton) if box is not None else []
        if not buttons:
            QtCore.QTimer.singleShot(100, fill)
            return
        seen.extend(button.text() for button in buttons)
        next(button for button in buttons if OURS in button.text()).click()
        QtCore.QTimer.singleShot(100, box.accept)

    QtCore.QTimer.singleShot(300, fill)
    return seen


def by_button(path):
    """Choose a file through the tool bar."""
    toolbar("HybridVolume_ImportMesh")
    wait_for(lambda: window(QtGui.QFileDialog, "HybridVolume_ImportMesh"))
    box = window(QtGui.QFileDialog, "HybridVolume_ImportMesh")
    box.findChild(QtGui.QLineEdit).setText(str(path))
    box.accept()
    wait_for(question)
    wait(300)


def body(obj):
    """Figures of a body from a mesh, and what is drawn of its mesh."""
    scene = obj.ViewObject.Proxy
    return {
        "scheme": obj.Scheme,
        "steps": obj.Steps,
        "angle": float(obj.SharpAngle),
        "patches": obj.Patches,
        "faces": len(obj.Shape.Faces),
        "volume": obj.Shape.Volume,
        "status": obj.Status,
        "drawn": scene.cage.whichChild.getValue() != -1,
        "edges": _lines(scene.cage, 0),
        "creases": _lines(scene.cage, 1),
    }


def _lines(cage, which):
    """How many lines are drawn of the mesh, or of its creases."""
    from pivy import coin

    search = coin.SoSearchAction()
    search.setType(coin.SoIndexedLineSet.getClassTypeId())
    search.setInterest(coin.SoSearchAction.ALL)
    search.setSearchingAll(True)
    search.apply(cage)
    path = search.getPaths()[which]
    values = coin.cast(path.getTail(), "SoIndexedLineSet").coordIndex.getValues()
    return sum(value < 0 for value in values)


def imported(answer):
    """The File menu and a macro; another scheme; what is refused; several bodies; reopened."""
    FreeCADGui.activateWorkbench(WORKBENCH)
    doc = FreeCAD.newDocument()
    whole_window()
    record("imported")
    answer["filters"] = file_menu("Std_Import", FOLDER / "creased.obj", OURS)
    wait_for(question)
    wait(300)
    answer["first"] = shown()
    press(child("bilinear"))
    answer["bilinear"] = shown()
    press(child("catmullClark"))
    type_into("angle", "60")
    type_into("steps", "2")
    answer["by angle"] = shown()
    screenshot("1_question")
    press(standard("Import"))
    wait_for(lambda: objects(doc))
    stop = "Std_MacroStopRecord"  # from 1.0 on the command that began ends as well
    FreeCADGui.runCommand(stop if stop in FreeCADGui.listCommands() else "Std_DlgMacroRecord")
    wait(800)
    screenshot("2_imported")
    answer["objects"], answer["undo"] = objects(doc), doc.UndoNames
    (cage,) = doc.Objects
    answer["imported"] = body(cage)

    macro = next(FOLDER.rglob("imported*.FCMacro")).read_text()
    answer["macro"] = macro
    doc.undo()
    answer["undone"] = objects(doc)
    exec(macro, {"App": FreeCAD, "Gui": FreeCADGui})
    wait(600)
    answer["asked again"] = question() is not None
    (cage,) = doc.Objects
    answer["replayed"] = body(cage)

    cage.Placement.Base = FreeCAD.Vector(3, 0, 0)
    for name, scheme in (("smooth", "smooth"), ("mesh", "bilinear")):
        cage.Scheme = scheme
        doc.recompute()
        wait(300)
        answer[name] = {**body(cage), "box": cage.Shape.BoundBox.XMax}
    cage.Scheme, cage.SharpAngle = "catmull-clark", 200
    doc.recompute()
    wait_for(message_box)
    answer["refused"] = {"text": message_box().text(), "state": cage.State, **body(cage)}
    message_box().close()
    cage.Scheme, cage.SharpAngle = "bilinear", 60
    cage.ViewObject.ShowCage = False
    doc.recompute()
    wait(300)
    answer["without cage"] = body(cage)
    path = FOLDER / "saved.FCStd"
    doc.saveAs(str(path))
    FreeCAD.closeDocument(doc.Name)
    doc = FreeCAD.openDocument(str(path))
    wait(600)
    (cage,) = doc.Objects
    answer["reopened"] = body(cage)
    cage.ViewObject.ShowCage = True
    cage.Scheme = "catmull-clark"
    doc.recompute()
    wait(300)
    answer["changed after all"] = body(cage)
    cage.ViewObject.Visibility = False
    wait(300)
    answer["hidden"] = body(cage)["drawn"]
    cage.ViewObject.Visibility = True

    by_button(FOLDER / "open.obj")
    answer["open"] = shown()
    screenshot("3_refused")
    press(standard("Cancel"))
    wait(300)
    by_button(FOLDER / "no.ply")
    answer["unreadable"] = shown()
    press(standard("Cancel"))
    wait(300)
    answer["nothing"] = objects(doc)
    by_button(FOLDER / "dart.obj")
    press(standard("Import"))
    wait_for(lambda: question() is not None and child("refusal").text())
    wait(300)
    answer["folded"] = shown()
    screenshot("4_folded")
    press(child("smooth"))
    press(standard("Import"))
    wait_for(lambda: len(doc.Objects) == 2)
    wait(300)
    answer["after all"] = body(doc.Objects[1])

    answer["modules"] = choose_module()
    file_menu("Std_Open", FOLDER / "two.off", "Supported formats")
    wait_for(question)
    wait(300)
    answer["two"] = shown()
    screenshot("5_two")
    press(standard("Import"))
    wait_for(lambda: len(FreeCAD.listDocuments()) == 2)
    wait(500)
    both = FreeCAD.ActiveDocument
    answer["new document"] = both.Label
    answer["opened"] = [(obj.Label, round(obj.Shape.Volume, 9)) for obj in both.Objects]

    first = both.Objects[0]
    FreeCADGui.Selection.clearSelection()
    open_panel(first)
    press_in_panel("run")
    wait_for(lambda: stage() == "Done", 120.0)
    screenshot("6_completed")
    close_panel()
    volume = both.getObject("HybridVolume")
    answer["completed"] = {
        "status": volume.Status,
        "source": volume.Source.Name == first.Name,
        "elements": volume.Elements,
        "report": volume.Report["input.mesh.scheme"],
        "cage": body(first)["drawn"],
    }
    first.Scheme = "smooth"
    both.recompute()
    answer["outdated"] = volume.Status
