# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The midstructure's panel under real clicks and keys; test_gui_midstructure.py judges."""

import subprocess
import time

import FreeCAD
import FreeCADGui
from gui_scenarios import (
    FOLDER,
    message_box,
    new_document,
    objects,
    screenshot,
    state,
    wait,
    wait_for,
    widget,
    workers,
)
from PySide import QtCore, QtGui

PANEL = "HybridVolumeMidstructurePanel"
NEXT_PANEL = "HybridVolumePanel"


def form():
    return widget(PANEL)


def child(name, kind=QtGui.QWidget):
    return form().findChild(kind, name)


def wait_until(condition, what, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            stage = child("stage", QtGui.QLabel).text() if form() else "(no panel)"
            screenshot("waited_in_vain")
            raise TimeoutError(f"{what}: waited {seconds} s in vain; the panel says {stage!r}")
        wait(50)


def idle():
    return child("findAgain", QtGui.QPushButton).text() != "Cancel"


def create(body, found=True):
    """Complete the volume, as far as the panel, with the automatic choice or still without."""
    FreeCADGui.Selection.clearSelection()
    FreeCADGui.Selection.addSelection(body)
    FreeCADGui.runCommand("HybridVolume_Create")
    wait_until(form, "panel")
    if found:
        wait_until(lambda: idle() and table().rowCount(), "sheets")
        wait(200)
        look_from_above()


def whole_window():
    """Hide what a first start shows below: the panel takes the whole height."""
    for dock in FreeCADGui.getMainWindow().findChildren(QtGui.QDockWidget):
        if dock.objectName() in ("Python console", "Report view", "Selection view"):
            dock.hide()
    wait(200)


def look_from_above():
    view = FreeCADGui.activeDocument().activeView()
    view.viewTop()
    view.fitAll()
    # the camera flies there
    wait(900)
    FreeCADGui.updateGui()


# ------------------------------------------------------------------ hands


def xdotool(*words):
    subprocess.run(["xdotool", *map(str, words)], check=True)
    wait(60)


def move(place):
    """Move the mouse in two steps: a view that is reached in one jump sees no movement."""
    xdotool("mousemove", place.x() - 3, place.y() - 2)
    xdotool("mousemove", place.x(), place.y())


def click(place, *, control=False):
    move(place)
    if control:
        xdotool("keydown", "ctrl")
    xdotool("click", 1)
    if control:
        xdotool("keyup", "ctrl")
    wait(200)


def key(name):
    xdotool("key", name)
    wait(200)


def press(name):
    button = child(name)
    click(button.mapToGlobal(button.rect().center()))


def press_standard(text):
    """Click a button of FreeCAD's own above the panel."""
    for box in FreeCADGui.getMainWindow().findChildren(QtGui.QDialogButtonBox):
        for button in box.buttons():
            if box.isVisible() and button.text().replace("&", "") == text:
                click(button.mapToGlobal(button.rect().center()))
                return
    raise LookupError(text)


def drag(start, end):
    move(start)
    xdotool("mousedown", 1)
    for k in range(1, 6):
        step = start + (end - start) * (k / 5)
        xdotool("mousemove", step.x(), step.y())
    wait(200)


def release():
    xdotool("mouseup", 1)
    wait(300)


def viewport():
    window = FreeCADGui.getMainWindow().findChild(QtGui.QMdiArea).currentSubWindow()
    return window.findChild(QtGui.QGraphicsView).viewport()


def on_screen(point):
    x, y = FreeCADGui.activeDocument().activeView().getPointOnScreen(FreeCAD.Vector(*point))
    area = viewport()
    return area.mapToGlobal(QtCore.QPoint(int(x), area.height() - 1 - int(y)))


def colour_at(place):
    image = FreeCADGui.getMainWindow().screen().grabWindow(0).toImage()
    return QtGui.QColor(image.pixel(place.x(), place.y())).getRgb()[:3]


# ------------------------------------------------------------------ what is seen


def table():
    return child("sheets", QtGui.QTableWidget)


def checked():
    """Names of the sheets that the table shows as kept."""
    names = table()
    cells = [names.item(row, 0) for row in range(names.rowCount())]
    return sorted(cell.text() for cell in cells if cell.checkState() == QtCore.Qt.Checked)


def rows_selected():
    names = table()
    rows = {index.row() for index in names.selectionModel().selectedRows()}
    return sorted(names.item(row, 0).text() for row in rows)


def picked():
    return sorted(
        sub
        for one in FreeCADGui.Selection.getSelectionEx()
        for sub in one.SubElementNames
        if one.ObjectName == "Midstructure"
    )


def drawn(doc):
    """Names of the sheets that the 3D view draws in colour."""
    scene = doc.Midstructure.ViewObject.Proxy.scene
    return sorted(f"Sheet{k + 1}" for k, sheet in enumerate(scene.sheets) if sheet.any_kept)


def seen(doc):
    return {
        "table": checked(),
        "view": drawn(doc),
        "decisions": list(doc.Midstructure.Decisions),
        "undo": list(doc.UndoNames),
        "hint": child("hint", QtGui.QLabel).text(),
        "warning": child("warning", QtGui.QLabel).text() if child("warning").isVisible() else "",
    }


def seeds(doc):
    from HybridVolume.objects.midstructure import chosen

    return [sheet.seed for sheet in chosen(doc.Midstructure).sheets]


# ------------------------------------------------------------------ scenarios


def by_mouse(answer):
    """Remove, undo, bring back, select, slide, refuse, go on, save and open again."""
    doc, box = new_document()
    whole_window()
    create(box)
    answer["found"] = seen(doc)
    answer["objects"] = objects(doc)
    middle = on_screen(seeds(doc)[0])
    aside = middle + QtCore.QPoint(-40, 30)

    before = colour_at(aside)
    move(aside)
    wait(300)
    answer["hovered"] = [before, colour_at(aside + QtCore.QPoint(8, 8))]
    click(aside)
    # hints come a moment after the change
    wait_for(lambda: child("hint", QtGui.QLabel).text().startswith("0 of"))
    answer["removed"] = seen(doc)
    key("ctrl+z")
    answer["undone"] = seen(doc)
    key("ctrl+shift+z")
    answer["redone"] = seen(doc)
    click(aside)
    answer["brought back"] = seen(doc)

    click(aside, control=True)
    answer["with Ctrl"] = {**seen(doc), "rows": rows_selected(), "picked": picked()}
    other = table().visualItemRect(table().item(2, 0)).center()
    click(table().viewport().mapToGlobal(other + QtCore.QPoint(20, 0)))
    answer["row clicked"] = {"rows": rows_selected(), "picked": picked()}
    press("keep")
    answer["kept by the button"] = seen(doc)
    press("automatic")
    answer["automatic again"] = seen(doc)
    press("box")
    area = viewport()
    drag(
        area.mapToGlobal(QtCore.QPoint(15, 140)),
        area.mapToGlobal(QtCore.QPoint(area.width() - 15, area.height() - 15)),
    )
    release()
    answer["in the box"] = {"picked": picked(), "undo": list(doc.UndoNames)}

    slider = child("angleSlider", QtGui.QSlider)
    handle = QtGui.QStyleOptionSlider()
    slider.initStyleOption(handle)
    place = slider.style().subControlRect(
        QtGui.QStyle.CC_Slider, handle, QtGui.QStyle.SC_SliderHandle, slider
    )
    start = slider.mapToGlobal(place.center())
    drag(start, QtCore.QPoint(slider.mapToGlobal(slider.rect().topLeft()).x() + 2, start.y()))
    answer["while dragged"] = {**seen(doc), "angle": doc.Midstructure.Angle}
    answer["preview seconds"] = form().property("previewSeconds")
    release()
    answer["slider released"] = {**seen(doc), "angle": doc.Midstructure.Angle}
    doc.undo()
    wait(300)
    answer["slider undone"] = {
        **seen(doc),
        "angle": doc.Midstructure.Angle,
        "slider": slider.value(),
    }

    click(aside)
    press_standard("OK")
    answer["refused"] = {"message": message_box().text(), "open": form() is not None}
    message_box().close()
    doc.undo()
    wait(300)
    # a sheet along an edge: seen from above, on the left
    edge = next(k for k, seed in enumerate(seeds(doc)) if seed[0] < 4.0 and seed[2] > 5.0)
    click(on_screen(seeds(doc)[edge]))
    answer["edge"] = f"Sheet{edge + 1}"
    answer["before OK"] = seen(doc)
    press_standard("OK")
    wait_until(lambda: widget(NEXT_PANEL), "next panel")
    answer["after OK"] = {
        "open": form() is not None,
        "objects": objects(doc),
        "kept": list(doc.Midstructure.Kept),
        "visible": {obj.Name: obj.ViewObject.Visibility for obj in doc.Objects},
        "box can be selected": selectable(box),
    }
    FreeCADGui.Control.closeDialog()
    wait(200)

    path = FOLDER / "saved.FCStd"
    doc.saveAs(str(path))
    FreeCAD.closeDocument(doc.Name)
    doc = FreeCAD.openDocument(str(path))
    wait(500)
    view = doc.Midstructure.ViewObject
    view.Proxy.doubleClicked(view)
    wait_until(form, "panel")
    wait(400)
    look_from_above()
    answer["reopened"] = {**seen(doc), "kept": list(doc.Midstructure.Kept)}
    screenshot("9_reopened")
    FreeCAD.closeDocument(doc.Name)
    wait(400)
    answer["document closed"] = form() is not None


def selectable(obj):
    """Whether FreeCAD lets an object be selected, and its observers are quiet about it."""
    FreeCADGui.Selection.clearSelection()
    FreeCADGui.Selection.addSelection(obj.Document.Name, obj.Name, "Face1")
    return [one.ObjectName for one in FreeCADGui.Selection.getSelectionEx()] == [obj.Name]


def record(name):
    """Begin to record a macro, through FreeCAD's dialog."""

    def fill():
        for dialog in QtGui.QApplication.topLevelWidgets():
            start = dialog.findChild(QtGui.QPushButton, "buttonStart")
            if isinstance(dialog, QtGui.QDialog) and start and dialog.isVisible():
                dialog.findChild(QtGui.QLineEdit, "lineEditPath").setText(name)
                start.click()
                return
        QtCore.QTimer.singleShot(100, fill)

    folder = FOLDER / "macros"
    folder.mkdir()
    settings = FreeCAD.ParamGet("User parameter:BaseApp/Preferences/Macro")
    settings.SetString("MacroPath", str(folder))
    QtCore.QTimer.singleShot(300, fill)
    FreeCADGui.runCommand("Std_DlgMacroRecord")
    wait(300)


def cancelled_and_recorded(answer):
    """Cancel leaves the document as it was; a recorded macro does the same again."""
    doc, box = new_document()
    whole_window()
    before = state(doc)
    create(box)
    middle = on_screen(seeds(doc)[0]) + QtCore.QPoint(-40, 30)
    click(middle)
    answer["on the way"] = seen(doc)
    press_standard("Cancel")
    wait(500)
    after = state(doc)
    answer["cancelled"] = {
        "open": form() is not None,
        "changed": [name for name, value in before.items() if after[name] != value],
        "box can be selected": selectable(box),
        "box is shown": box.ViewObject.SwitchNode.whichChild.getValue() >= 0,
    }

    # Undo takes away what Create made: the panel goes as well
    create(box, found=False)
    wait_until(workers, "worker")
    while doc.UndoCount:
        doc.undo()
    wait(500)
    answer["undone to the start"] = {
        "open": form() is not None,
        "objects": objects(doc),
        "workers": workers(),
    }

    # a stranger's step on top of ours is not undone by Cancel
    create(box)
    doc.openTransaction("Move")
    box.Label = "moved"
    doc.commitTransaction()
    click(on_screen(seeds(doc)[0]) + QtCore.QPoint(-40, 30))
    press_standard("Cancel")
    wait(500)
    answer["with a stranger's step"] = {"objects": objects(doc), "label": box.Label}
    FreeCAD.closeDocument(doc.Name)

    doc, box = new_document()
    record("recorded")
    create(box)
    edge = next(k for k, seed in enumerate(seeds(doc)) if seed[0] < 4.0 and seed[2] > 5.0)
    click(on_screen(seeds(doc)[edge]))
    press("invert")
    stop = "Std_MacroStopRecord"  # from 1.0 on the command that began ends as well
    FreeCADGui.runCommand(stop if stop in FreeCADGui.listCommands() else "Std_DlgMacroRecord")
    wait(200)
    answer["recorded"] = {
        "decisions": list(doc.Midstructure.Decisions),
        "kept": list(doc.Midstructure.Kept),
    }
    press_standard("Cancel")
    wait(300)
    FreeCAD.closeDocument(doc.Name)

    macro = next(FOLDER.rglob("recorded*.FCMacro")).read_text()
    answer["macro"] = macro
    doc, box = new_document()
    exec(macro, {"App": FreeCAD, "Gui": FreeCADGui})
    wait(300)
    answer["replayed"] = {
        "decisions": list(doc.Midstructure.Decisions),
        "kept": list(doc.Midstructure.Kept),
        "objects": objects(doc),
    }
