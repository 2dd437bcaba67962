# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A body of trimmed faces in the volume's panel, by hand; test_gui_covering.py judges."""

import math
import time

import FreeCAD
import FreeCADGui
import Part
from gui_midstructure import (
    checked,
    click,
    colour_at,
    create,
    form,
    move,
    on_screen,
    press_standard,
    whole_window,
    xdotool,
)
from gui_scenarios import (
    FOLDER,
    job_folders,
    message_box,
    new_document,
    open_panel,
    panel,
    screenshot,
    stage,
    state,
    wait,
    wait_for,
    workers,
)
from gui_thickness import (
    child,
    double_click,
    finish,
    nodes_of,
    picked,
    press,
    scroll_to,
    type_into,
)
from PySide import QtCore, QtGui

SIZE = (24.0, 16.0, 8.0)
RADIUS, SLANT = 3.0, 0.5
AT = (10.0, -5.0, 2.0)
"""Where the plate stands."""


def plate():
    """A plate with a slanted hole: its wall is a trimmed cylinder, all other faces are plane."""
    axis = FreeCAD.Vector(SLANT, 0.0, 1.0)
    hole = Part.makeCylinder(RADIUS, 30.0, FreeCAD.Vector(4.0, 8.0, -8.0), axis)
    return Part.makeBox(*SIZE).cut(hole).Solids[0]


def new_plate():
    doc, body = new_document("Part::Feature", "Plate")
    body.Shape = plate()
    body.Placement.Base = FreeCAD.Vector(*AT)
    doc.recompute()
    doc.clearUndos()
    view = FreeCADGui.activeDocument().activeView()
    view.viewTop()
    view.fitAll()
    wait(900)
    whole_window()
    return doc, body


def places():
    """Points on the top of the plate, and on the wall of the hole as it is seen from above."""
    height = 4.0
    middle = 4.0 + SLANT * (height + 8.0)
    # the cylinder's section at that height is an ellipse, longer along x
    wall = middle + RADIUS * math.sqrt(1.0 + SLANT**2)
    top, wall = (20.0, 3.0, SIZE[2]), (wall, 7.0, height)
    return [tuple(a + b for a, b in zip(point, AT, strict=True)) for point in (top, wall)]


def colours():
    return [colour_at(on_screen(point)) for point in places()]


def meshers():
    """Processes of this FreeCAD that cover faces."""
    return workers(b"covering")


def rows():
    table = child("geometryTable", QtGui.QTableWidget)
    if not table.isVisible():
        return []
    return [
        [table.item(row, column).text() for column in range(table.columnCount())]
        for row in range(table.rowCount())
    ]


def marked():
    table = child("geometryTable", QtGui.QTableWidget)
    chosen = table.selectionModel().selectedRows()
    return sorted(table.item(index.row(), 0).text() for index in chosen)


def click_row(face):
    table = child("geometryTable", QtGui.QTableWidget)
    scroll_to(table)
    (item,) = table.findItems(face, QtCore.Qt.MatchExactly)
    table.scrollToItem(item)
    click(table.viewport().mapToGlobal(table.visualItemRect(item).center()))


def section():
    return child("geometryToggle", QtGui.QToolButton).text()


def check():
    press("geometryCheck")
    wait_for(lambda: stage() == "Checked", 150)
    wait(300)


def turn_wheel():
    """What the wheel does to fields that it passes, and to one that was clicked into."""
    found = {}
    level = child("w0", QtGui.QDoubleSpinBox)
    for name in ("w0", "w0Slider", "kind", "layers", "coverTolerance"):
        field = child(name)
        before = level.value(), child("layers", QtGui.QSpinBox).value()
        if field.isVisible():
            move(field.mapToGlobal(field.rect().center()))
            xdotool("click", 4)
            wait(200)
            after = level.value(), child("layers", QtGui.QSpinBox).value()
            found[name] = before == after and child("kind", QtGui.QComboBox).currentIndex() == 0
    before = level.value()
    click(level.mapToGlobal(QtCore.QPoint(20, level.height() // 2)))
    xdotool("click", 4)
    wait(200)
    found["clicked into"] = level.value() > before
    level.setValue(before)
    move_away()
    return found


def drilled(answer):
    """Check, cancel, look at the colours, pick faces by rows and rows by faces, close."""
    doc, body = new_plate()
    nodes, before = nodes_of(body), state(doc)
    plain, answer["nodes at first"] = colours(), places_below(body)
    open_panel(body)
    FreeCADGui.Selection.clearSelection()
    answer["at first"] = {"section": section(), "rows": rows()}
    answer["wheel"] = turn_wheel()
    press("geometryToggle")
    press("geometryCheck")
    wait_for(meshers)
    screenshot("1_covering")
    answer["covering"] = {
        "stage": stage(),
        "enabled": [child(name).isEnabled() for name in ("run", "cancel", "parameters")],
    }
    press("cancel")
    wait(500)
    answer["cancelled"] = {
        "stage": stage(),
        "meshers": meshers(),
        "folders": job_folders(),
        "rows": rows(),
    }
    beats = []
    timer = QtCore.QTimer()
    timer.timeout.connect(lambda: beats.append(time.monotonic()))
    timer.start(20)
    check()
    timer.stop()
    answer["longest pause"] = max(b - a for a, b in zip(beats, beats[1:], strict=False))
    move_away()
    screenshot("2_checked")
    answer["checked"] = {
        "rows": rows(),
        "hint": child("geometryHint", QtGui.QLabel).text(),
        "colours": colours(),
        "log": child("log", QtGui.QPlainTextEdit).toPlainText(),
    }
    click_row("Face7")
    answer["row clicked"] = {"picked": picked(), "marked": marked()}
    screenshot("3_row")
    click(on_screen(places()[0]))
    answer["top clicked"] = {"picked": picked(), "marked": marked()}
    FreeCADGui.Selection.clearSelection()
    move_away()
    press("geometryColours")
    move_away()
    answer["not coloured"] = {
        "as before": colours() == plain,
        "nodes": nodes_of(body) == nodes and places_below(body) == answer["nodes at first"],
    }
    press("geometryColours")
    press("geometryToggle")
    move_away()
    answer["section closed"] = {"section": section(), "as before": colours() == plain}
    press("geometryToggle")
    body.Placement.Base = FreeCAD.Vector(0.0, 0.0, 0.0)
    doc.recompute()
    wait(300)
    answer["body moved"] = rows()
    body.Placement.Base = FreeCAD.Vector(*AT)
    doc.recompute()
    finish("Close")
    after = state(doc)
    answer["changed"] = [
        name for name, value in before.items() if name != "undo" and after[name] != value
    ]


def refused(answer):
    """The cover is refused: a face in red; with a larger tolerance the body is taken."""
    from HybridVolume.gui import red_places

    doc, body = new_plate()
    FreeCADGui.activeDocument().activeView().viewIsometric()
    before = state(doc)
    open_panel(body)
    press("geometryToggle")
    press("geometryCheck")
    wait_for(message_box, 200)
    screenshot("refused")
    shown = red_places.shown()
    answer["refused"] = {
        "message": message_box().text(),
        "red": shown.faces if shown else [],
        "picked": picked(),
        "stage": stage(),
        "rows": rows(),
    }
    message_box().close()
    wait(300)
    type_into(child("coverTolerance"), "0.5 mm")
    check()
    answer["with another"] = {
        "kinds": sorted({row[1] for row in rows()}),
        "red": red_places.shown() is not None,
        "changed": [name for name, value in before.items() if state(doc)[name] != value],
    }


def wedge(answer):
    """From the midstructure of a prism with three sides to its volume, and its panels."""
    FreeCADGui.activateWorkbench("HybridVolumeWorkbench")
    doc = FreeCAD.newDocument()
    body = doc.addObject("Part::Feature", "Wedge")
    corners = [FreeCAD.Vector(*p) for p in ((0, 0, 0), (20, 0, 0), (5, 14, 0), (0, 0, 0))]
    body.Shape = Part.Face(Part.makePolygon(corners)).extrude(FreeCAD.Vector(0, 0, 8))
    doc.recompute()
    doc.clearUndos()
    FreeCADGui.activeDocument().activeView().viewIsometric()
    FreeCADGui.SendMsgToActiveView("ViewFit")
    whole_window()
    create(body)
    screenshot("1_sheets")
    answer["sheets"] = {
        "between": sorted({name for row in sheet_faces() for name in row}),
        "kept": len(checked()),
        "hint": form().findChild(QtGui.QLabel, "hint").text(),
    }
    press_standard("OK")
    wait_for(panel)
    wait(300)
    child("layers", QtGui.QSpinBox).setValue(1)
    press("run")
    wait_for(lambda: stage() == "Done", 300)
    press("geometryToggle")
    wait(300)
    screenshot("2_done")
    volume = doc.HybridVolume
    answer["done"] = {
        "rows": rows(),
        "section": section(),
        "log": child("log", QtGui.QPlainTextEdit).toPlainText(),
        "status": volume.Status,
        "kept": volume.FacesKept,
        "volume": float(volume.Report["input.volume"]),
    }
    finish("Cancel")
    path = FOLDER / "saved.FCStd"
    doc.saveAs(str(path))
    FreeCAD.closeDocument(doc.Name)
    doc = FreeCAD.openDocument(str(path))
    wait(500)
    volume = doc.HybridVolume
    double_click(volume)
    answer["reopened"] = {"rows": [], "section": section(), "status": volume.Status}
    press("geometryToggle")
    move_away()
    screenshot("3_reopened")
    answer["reopened"] |= {"rows": rows(), "coloured": coloured_faces(doc.Wedge)}
    type_into(child("coverTolerance"), "0.1 mm")
    answer["another tolerance"] = {"rows": rows(), "section": section()}
    finish("OK")
    answer["after OK"] = {
        "undo": list(doc.UndoNames),
        "tolerance": volume.CoverTolerance.Value,
        "status": volume.Status,
    }
    doc.undo()
    wait(200)
    answer["undone"] = volume.Status
    answer["quality"] = quality(doc, volume)
    answer["mesh"] = mesh(doc, volume)


def quality(doc, volume):
    """Faces that the quality panel tells of, and the elements of one of them."""
    from HybridVolume.gui import commands

    shown = commands.open_quality_panel(doc.Name, volume.Name)
    wait(800)
    table = shown.form.faces
    names = [table.item(row, 0).text() for row in range(table.rowCount())]
    counts = {
        table.item(row, 0).text(): int(table.item(row, 1).text()) for row in range(table.rowCount())
    }
    table.selectRow(names.index("Face5"))
    wait(300)
    screenshot("4_quality")
    found = {
        "faces": sorted(names),
        "elements": sum(counts.values()) == volume.Elements,
        "marked": len(shown.scene.marked) == counts["Face5"],
        "told": shown.form.element.text(),
        "levels": [table.item(row, 3).text() != "..." for row in range(table.rowCount())],
    }
    FreeCADGui.Control.closeDialog()
    wait(200)
    return found


def mesh(doc, volume):
    """A finer mesh at one face of the body, in its panel; the shell stays."""
    from HybridVolume.gui import commands

    shown = commands.open_mesh_panel(doc.Name, volume.Name)
    wait(500)
    before = doc.FemMesh.FemMesh.NodeCount
    table = shown._density.faces
    table.show({"Face4": 1.0})
    shown.form.run.click()
    wait_for(lambda: shown.form.stage.text() in ("Done", "Failed"), 200)
    found = {
        "stage": shown.form.stage.text(),
        "log": shown.form.log.toPlainText(),
        "finer": doc.FemMesh.FemMesh.NodeCount > before,
        "status": volume.Status,
    }
    screenshot("5_mesh")
    FreeCADGui.Control.closeDialog()
    wait(200)
    return found


def sheet_faces():
    """The two faces of each sheet of the table."""
    from HybridVolume.objects.midstructure import chosen

    return [sheet.faces for sheet in chosen(FreeCAD.ActiveDocument.Midstructure).sheets]


def move_away():
    """Put the mouse where it picks nothing."""
    move(panel().mapToGlobal(QtCore.QPoint(5, 5)))
    wait(300)


def coloured_faces(body):
    """How many faces of a body FreeCAD itself draws in colours of their own."""
    from pivy import coin

    search = coin.SoSearchAction()
    search.setType(coin.SoType.fromName("SoBrepFaceSet"))
    search.setSearchingAll(True)
    search.apply(body.ViewObject.RootNode)
    path = search.getPath()
    if path is None:
        return 0
    group = path.getNodeFromTail(1)
    before = group.getChild(group.findChild(path.getTail()) - 1)
    is_material = before.isOfType(coin.SoMaterial.getClassTypeId())
    return before.getField("diffuseColor").getNum() if is_material else 0


def places_below(body):
    """How many nodes draw the body's faces: none may be left behind."""
    from pivy import coin

    search = coin.SoSearchAction()
    search.setType(coin.SoNode.getClassTypeId())
    search.setInterest(coin.SoSearchAction.ALL)
    search.setSearchingAll(True)
    search.apply(body.ViewObject.RootNode)
    return search.getPaths().getLength()
