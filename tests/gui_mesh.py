# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The panel of the FEM mesh under real clicks, and what is said to bad use; test_gui_mesh.py
judges.
"""

import os

import FreeCAD
import FreeCADGui
import ObjectsFem
from gui_fandisk import button_of, command_button, fem_toolbar, pick, show_tree
from gui_midstructure import click, colour_at, on_screen, press_standard, whole_window, xdotool
from gui_quality import toolbar
from gui_scenarios import click as click_panel
from gui_scenarios import (
    close_panel,
    message_box,
    new_document,
    open_panel,
    panel,
    screenshot,
    stage,
    state,
    wait,
    wait_for,
    widget,
)
from gui_thickness import scroll_to
from PySide import QtCore, QtGui

PANEL = "HybridVolumeMeshPanel"


def child(name, kind=QtGui.QWidget):
    return widget(PANEL).findChild(kind, name)


def press(name, parent=None):
    """Click a button; a check box beside its left end."""
    button = (parent or widget(PANEL)).findChild(QtGui.QWidget, name)
    scroll_to(button)
    place = button.rect().center()
    if isinstance(button, QtGui.QCheckBox):
        place.setX(8)
    click(button.mapToGlobal(place))


def texts(table):
    return {
        table.verticalHeaderItem(row).text(): [
            table.item(row, column).text() for column in range(table.columnCount())
        ]
        for row in range(table.rowCount())
    }


def type_into(field, text):
    scroll_to(field)
    click(field.mapToGlobal(QtCore.QPoint(20, field.height() // 2)))
    xdotool("key", "ctrl+a")
    xdotool("type", text)
    xdotool("key", "Tab")
    wait(200)


def mesh_stage():
    return child("stage", QtGui.QLabel).text() if widget(PANEL) else "(no panel)"


def look_along_x():
    view = FreeCADGui.activeDocument().activeView()
    view.viewRight()
    view.fitAll()
    wait(900)


def said(action):
    """Text of the window that an action brings up, which is then closed."""
    action()
    wait_for(message_box, 20.0)
    box = message_box()
    text, buttons = box.text(), [button.text().replace("&", "") for button in box.buttons()]
    box.close()
    wait(300)
    return [text, buttons]


def mesh_and_words(answer):
    """Look at a mesh, make a finer one, undo; then all that cannot be done."""
    doc, box = new_document()
    whole_window()
    show_tree()
    answer["no volume"] = said(lambda: toolbar("HybridVolume_Analysis"))[0]
    answer["no mesh"] = said(lambda: toolbar("HybridVolume_Mesh"))[0]
    answer["no analysis"] = said(lambda: toolbar("HybridVolume_Solve"))[0]
    open_panel(box)
    click_panel("run")
    wait_for(lambda: stage() == "Done")
    close_panel()
    FreeCADGui.Selection.clearSelection()
    doc.clearUndos()
    before = state(doc)
    look_along_x()
    toolbar("HybridVolume_Mesh")
    wait_for(lambda: widget(PANEL))
    wait(800)
    fem = stored(doc).fem
    answer["counts"] = [
        child("counts", QtGui.QLabel).text(),
        *(len(fem.nodes), len(fem.wedges), len(fem.tets)),
    ]
    answer["table"] = texts(child("groups", QtGui.QTableWidget))
    answer["histogram"] = child("histogram").counts.tolist()
    answer["least"] = [float(fem.wedge_quality.min()), float(fem.tet_quality.min())]
    middle = on_screen((30.0, 9.0, 4.0))
    answer["coloured"] = colour_at(middle)
    click(middle)
    answer["clicked"] = child("element", QtGui.QLabel).text()
    press("colour")
    answer["one colour"] = colour_at(middle)
    press("clip")
    wait(300)
    answer["cut"] = colour_at(middle)
    press("clip")
    press("worst")
    wait(300)
    answer["worst"] = mesh_panel().scene.marked.tolist()
    press("whole")

    # finer at one face, which is picked
    child("tabs").setCurrentIndex(0)
    wait(200)
    type_into(child("subdivide"), "2")
    press("sizesToggle")
    wait(300)
    answer["picked"] = pick(box, "Face2")
    press("addSizes")
    field = child("sizes", QtGui.QTableWidget).cellWidget(0, 1)
    type_into(field, "3")
    press("sizesToggle")
    screenshot("mesh")
    press("run")
    wait_for(lambda: mesh_stage() == "Done", 90.0)
    wait(800)
    fem = stored(doc).fem
    answer["finer"] = {
        "counts": [child("counts", QtGui.QLabel).text(), len(fem.nodes)],
        "volume": fem.volume,
        "in the document": doc.FemMesh.FemMesh.NodeCount,
        "properties": [doc.FemMesh.Subdivide, list(doc.FemMesh.FaceSizes), doc.FemMesh.Status],
        "shell": doc.HybridVolume.Status,
        "undo": list(doc.UndoNames),
    }
    screenshot("finer")
    press_standard("OK")
    wait(300)
    answer["kept by OK"] = [list(doc.UndoNames), doc.FemMesh.Status]
    doc.undo()
    wait(500)
    answer["undone"] = [
        stored(doc).fem.nodes.shape[0],
        doc.FemMesh.FemMesh.NodeCount,
        [name for name, value in before.items() if state(doc)[name] != value],
    ]
    in_the_fem_workbench(answer, doc, box)


def in_the_fem_workbench(answer, doc, box):
    """A face of another body, no support, a body that changed meanwhile."""
    cube = doc.addObject("Part::Box", "Cube")
    cube.Placement.Base = FreeCAD.Vector(0.0, 60.0, 0.0)
    doc.recompute()
    FreeCADGui.Selection.clearSelection()
    toolbar("HybridVolume_Analysis")
    wait_for(lambda: doc.findObjects("Fem::FemAnalysis"))
    wait_for(lambda: FreeCADGui.activeWorkbench().name() == "FemWorkbench")
    wait(700)
    analysis = doc.findObjects("Fem::FemAnalysis")[0]
    answer["not loaded"] = said(lambda: fem_toolbar("HybridVolume_Solve"))[0]
    answer["not solved"] = said(lambda: fem_toolbar("HybridVolume_Stress"))[0]
    command_button("FEM_ConstraintFixed")
    wait_for(FreeCADGui.Control.activeDialog)
    view = FreeCADGui.activeDocument().activeView()
    view.viewIsometric()
    view.fitAll()
    wait(900)
    press("btnAdd", FreeCADGui.getMainWindow())
    pick(cube, "Face2")
    answer["other body"] = said(lambda: press_standard("OK"))[0]
    answer["other body, solved"] = said(lambda: fem_toolbar("HybridVolume_Solve"))[0]
    (fixed,) = [one for one in analysis.Group if one.isDerivedFrom("Fem::ConstraintFixed")]
    fixed.References = [(box, "Face1")]
    force = ObjectsFem.makeConstraintForce(doc)
    force.References = [(box, "Face2")]
    analysis.addObject(force)
    path, os.environ["PATH"] = os.environ["PATH"], ""
    answer["no solver"] = said(lambda: FreeCADGui.runCommand("HybridVolume_Solve"))[0]
    os.environ["PATH"] = path
    box.Length = 32
    doc.recompute()
    answer["out of date"] = said(lambda: fem_toolbar("HybridVolume_Solve"))
    fem_toolbar("HybridVolume_Solve")
    wait_for(message_box, 20.0)
    again = next(b for b in message_box().buttons() if "again" in b.text())
    click(again.mapToGlobal(again.rect().center()))
    wait_for(panel)
    wait_for(lambda: stage() == "Done")
    answer["computed again"] = doc.FemMesh.Status
    close_panel()
    FreeCADGui.activateWorkbench("PartWorkbench")
    wait(300)
    answer["bar elsewhere"] = button_of("HybridVolume_Solve", "HybridVolumeFem") is not None


def mesh_panel():
    """The panel's own object, by the form that is on the screen."""
    import gc

    from HybridVolume.gui.mesh_panel import MeshPanel

    form = widget(PANEL)
    return next(one for one in gc.get_objects() if isinstance(one, MeshPanel) and one.form is form)


def stored(doc):
    from HybridVolume.objects.inner import stored_volume

    return stored_volume(doc.HybridVolume)
