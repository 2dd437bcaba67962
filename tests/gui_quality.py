# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A result and a refused body under real clicks; test_gui_quality.py judges."""

import FreeCAD
import FreeCADGui
from gui_midstructure import click as click_at
from gui_midstructure import colour_at, drag, on_screen, press_standard, release, whole_window
from gui_scenarios import (
    FOLDER,
    can_of_height,
    message_box,
    new_can,
    new_document,
    open_panel,
    red_share,
    screenshot,
    stage,
    state,
    wait,
    wait_for,
    widget,
)
from gui_scenarios import click as click_panel
from gui_scenarios import close_panel as close_dialog
from PySide import QtCore, QtGui

PANEL = "HybridVolumeQualityPanel"


def child(name, kind=QtGui.QWidget):
    return widget(PANEL).findChild(kind, name)


def press(name):
    """Click a button; a check box beside its left end."""
    button = child(name)
    place = button.rect().center()
    if isinstance(button, QtGui.QCheckBox):
        place.setX(8)
    click_at(button.mapToGlobal(place))


def toolbar(command):
    """Click a command's button in the tool bar."""
    # FreeCAD asks the commands whether they are active only now and then
    wait(700)
    for bar in FreeCADGui.getMainWindow().findChildren(QtGui.QToolBar):
        if bar.objectName() == "HybridVolume":
            for action in bar.actions():
                if action.objectName() == command:
                    button = bar.widgetForAction(action)
                    click_at(button.mapToGlobal(button.rect().center()))
                    return
    raise LookupError(command)


def row(table, number):
    """Click a row of a table."""
    cell = table.visualItemRect(table.item(number, 0)).center()
    click_at(table.viewport().mapToGlobal(cell))


def texts(table):
    return [
        [table.item(row, column).text() for column in range(table.columnCount())]
        for row in range(table.rowCount())
    ]


def drawn(doc):
    """What FreeCAD draws of each object, and how much there is in the view besides."""
    view = FreeCADGui.activeDocument().activeView()
    return {
        "switches": {
            obj.Name: obj.ViewObject.SwitchNode.whichChild.getValue() for obj in doc.Objects
        },
        "visible": {obj.Name: obj.ViewObject.Visibility for obj in doc.Objects},
        "nodes": view.getSceneGraph().getNumChildren(),
    }


def look_along_x():
    view = FreeCADGui.activeDocument().activeView()
    view.viewRight()
    view.fitAll()
    wait(900)


def result(answer):
    """Complete a box and look at it in every way."""
    doc, box = new_document()
    whole_window()
    open_panel(box)
    click_panel("run")
    wait_for(lambda: stage() == "Done")
    close_dialog()
    FreeCADGui.Selection.clearSelection()
    look_along_x()
    before, content = drawn(doc), state(doc)
    toolbar("HybridVolume_Quality")
    wait_for(lambda: widget(PANEL))
    wait_for(lambda: child("reached", QtGui.QLabel).text())
    wait(300)
    scene, volume = quality_panel().scene, doc.HybridVolume
    faces = child("faces", QtGui.QTableWidget)
    answer["certified"] = child("certified", QtGui.QLabel).text()
    answer["reached"] = child("reached", QtGui.QLabel).text()
    answer["figures"] = {
        "elements": volume.Elements,
        "least": volume.MinimumScaledJacobian,
        "w0": volume.W0Reached,
        "histogram": child("histogram").counts.tolist(),
        "line": child("histogram").figures,
    }
    answer["faces"] = texts(faces)
    answer["hidden"] = [name for name, which in drawn(doc)["switches"].items() if which == -1]
    middle = on_screen((15.0, 10.0, 5.0))
    rim = on_screen((15.0, 0.6, 5.0))
    answer["whole"] = [colour_at(middle), colour_at(rim)]
    click_at(middle + QtCore.QPoint(3, 4))
    answer["clicked"] = child("element", QtGui.QLabel).text()
    answer["selected"] = len(FreeCADGui.Selection.getSelection())

    # cut open along x, towards the eye: grey core in the middle, coloured shell around
    press("clip")
    wait(300)
    answer["cut"] = [colour_at(middle + QtCore.QPoint(3, 4)), colour_at(rim)]
    answer["cut seconds"] = widget(PANEL).property("cutSeconds")
    slider = child("clipSlider", QtGui.QSlider)
    handle = QtGui.QStyleOptionSlider()
    slider.initStyleOption(handle)
    place = slider.style().subControlRect(
        QtGui.QStyle.CC_Slider, handle, QtGui.QStyle.SC_SliderHandle, slider
    )
    start = slider.mapToGlobal(place.center())
    # almost through: only shell is left
    drag(start, start + QtCore.QPoint(int(0.43 * slider.width()), 0))
    release()
    answer["slider"] = slider.value() / slider.maximum()
    answer["almost through"] = colour_at(middle + QtCore.QPoint(3, 4))
    press("clipFlip")
    wait(300)
    answer["flipped"] = colour_at(middle)
    press("clip")
    wait(200)

    press("worst")
    wait(200)
    worst = child("worstTable", QtGui.QTableWidget)
    answer["worst"] = {
        "rows": texts(worst),
        "marked": scene.marked.tolist(),
        "red": red_share("worst"),
    }
    screenshot("worst")
    row(worst, 2)
    answer["one of the worst"] = scene.marked.tolist()
    press("whole")
    answer["whole again"] = scene.marked.tolist()
    tabs = child("tabs", QtGui.QTabWidget)
    bar = tabs.tabBar()
    click_at(bar.mapToGlobal(bar.tabRect(0).center()))
    row(faces, 1)
    answer["row"] = [faces.item(1, 0).text(), faces_of(scene.marked)]
    press("whole")
    press("shell")
    press("core")
    press("inner")
    combo = child("colouring", QtGui.QComboBox)
    combo.setCurrentIndex(combo.findData("share"))
    wait(300)
    answer["inner boundary alone"] = colour_at(middle)
    screenshot("inner")
    press_standard("Close")
    wait(400)
    answer["changed by the panel"] = [
        *(key for key, value in before.items() if drawn(doc)[key] != value),
        *(key for key, value in content.items() if state(doc)[key] != value),
    ]

    # Undo takes the volume away under an open panel, Redo brings it back
    toolbar("HybridVolume_Quality")
    wait_for(lambda: widget(PANEL))
    wait(300)
    doc.undo()
    wait(600)
    answer["undone"] = {
        "open": widget(PANEL) is not None,
        "box": doc.Box.ViewObject.SwitchNode.whichChild.getValue() >= 0,
        "nodes": drawn(doc)["nodes"] - before["nodes"],
    }
    doc.redo()
    wait(300)

    # the inner boundary as an object, through a file
    for name in ("Shell", "Core"):
        getattr(doc, name).ViewObject.Visibility = False
    inner = doc.InnerBoundary.ViewObject
    inner.Visibility = True
    inner.ColourBy = "Thickness"
    wait(600)
    centre = (15.0, 10.0, 5.0)
    answer["object"] = colour_at(on_screen(centre))
    path = FOLDER / "saved.FCStd"
    doc.saveAs(str(path))
    FreeCAD.closeDocument(doc.Name)
    doc = FreeCAD.openDocument(str(path))
    wait(900)
    answer["reopened"] = {
        "colour": colour_at(on_screen(centre)),
        "by": doc.InnerBoundary.ViewObject.ColourBy,
        "status": doc.InnerBoundary.Status,
    }
    screenshot("reopened")
    view = doc.InnerBoundary.ViewObject
    view.Proxy.doubleClicked(view)
    wait_for(lambda: widget(PANEL))
    answer["opened by the object"] = [
        child(name, QtGui.QCheckBox).isChecked() for name in ("shell", "inner", "core")
    ]
    FreeCAD.closeDocument(doc.Name)
    wait(400)
    answer["document closed"] = widget(PANEL) is not None


def quality_panel():
    """The panel behind the form, which FreeCAD does not tell."""
    import gc

    from HybridVolume.gui.quality_panel import QualityPanel

    return next(one for one in gc.get_objects() if isinstance(one, QualityPanel))


def faces_of(elements):
    from HybridVolume.objects.inner import stored_volume

    shell = stored_volume(FreeCAD.ActiveDocument.HybridVolume).shell
    return sorted({shell.surface.patches[shell.element_patch[k]].face for k in elements})


def refused(answer):
    """A body is refused: red faces, red places, and nothing of it in the document."""
    from HybridVolume.errors import Place, SingularSurfaceError
    from HybridVolume.gui import messages, red_places

    doc, can = new_can()
    whole_window()
    look_along_x()
    view = FreeCADGui.activeDocument().activeView()
    before, content = drawn(doc), state(doc)
    answer["red before"] = colour_at(on_screen((2.0, 0.8, 5.0)))
    open_panel(can)
    click_panel("run")
    wait_for(message_box)
    answer["message"] = message_box().text()
    message_box().close()
    close_dialog()
    wait(300)
    answer["red faces"] = red_places.shown().faces
    answer["red"] = colour_at(on_screen((2.0, 0.8, 5.0)))
    screenshot("refused")
    answer["colours"] = [tuple(c) for c in can.ViewObject.DiffuseColor]
    FreeCADGui.Selection.clearSelection()
    toolbar("HybridVolume_ClearRed")
    wait(300)
    answer["cleared"] = {
        "shown": red_places.shown() is not None,
        "red": colour_at(on_screen((2.0, 0.8, 5.0))),
        "changed": [
            *(key for key, value in before.items() if drawn(doc)[key] != value),
            *(key for key, value in content.items() if state(doc)[key] != value),
        ],
    }

    where = (2.0, 0.0, 5.0)
    place = Place("Face1", 0.25, 0.5, where, "the derivative vanishes")
    error = SingularSurfaceError("folded", faces=["Face1", "Face99"], places=[place])
    messages.show_error(error, can).close()
    view.viewRight()
    wait(900)
    answer["ball"] = colour_at(on_screen(where))
    answer["beside"] = colour_at(on_screen((where[0], 1.0, 2.0)))
    answer["lines"] = red_places.lines(error)
    answer["faces that exist"] = red_places.shown().faces
    screenshot("places")
    can.Shape = can_of_height(12)
    wait(300)
    answer["after a change"] = red_places.shown() is not None
    answer["nodes"] = [before["nodes"], drawn(doc)["nodes"]]
    # OCC may fail on the very faces that are bad
    whole = red_places.triangles_of

    def broken(shape, deviation):
        raise RuntimeError("cannot be meshed")

    red_places.triangles_of = broken
    answer["cannot be meshed"] = [
        red_places.show(can, error),
        red_places.shown().faces,
        red_places.shown().balls,
        can.ViewObject.SwitchNode.whichChild.getValue() >= 0,
    ]
    red_places.triangles_of = whole
    FreeCAD.closeDocument(doc.Name)
    answer["document closed"] = red_places.shown() is not None
