# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What happens in FreeCAD's window; test_gui_workbench.py judges the answers.

Everything goes through widgets and documents, as a user's hands would.
"""

import os
import re
import signal
import subprocess
import time
from pathlib import Path

import FreeCAD
import FreeCADGui
from PySide import QtCore, QtGui

FOLDER = Path(os.environ["HYBRIDVOLUME_ANSWER"]).parent
WORKBENCH = "HybridVolumeWorkbench"
COMMAND = "HybridVolume_Create"


def wait(milliseconds=100):
    loop = QtCore.QEventLoop()
    QtCore.QTimer.singleShot(milliseconds, loop.quit)
    loop.exec_()


def wait_for(condition, seconds=90.0):
    end = time.monotonic() + seconds
    while not condition():
        if stage() == "Failed" and condition is not message_box:
            raise RuntimeError(panel().findChild(QtGui.QPlainTextEdit, "log").toPlainText())
        if time.monotonic() > end:
            raise TimeoutError(f"waited {seconds} s in vain; the panel says {stage()!r}")
        wait(50)


def widget(name, kind=QtGui.QWidget):
    return FreeCADGui.getMainWindow().findChild(kind, name)


def panel():
    return widget("HybridVolumePanel")


def stage():
    return panel().findChild(QtGui.QLabel, "stage").text() if panel() else "(no panel)"


def click(name):
    panel().findChild(QtGui.QPushButton, name).click()


def screenshot(name):
    wait(400)
    subprocess.run(["import", "-window", "root", str(FOLDER / f"{name}.png")], check=False)


def workers(words=b"HybridVolume.worker"):
    """Processes that this FreeCAD started with some words in their command line."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                command = (entry / "cmdline").read_bytes()
                parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            except OSError:
                continue
            if parent == os.getpid() and words in command:
                found.append(int(entry.name))
    return found


def job_folders():
    return sorted(entry.name for entry in FOLDER.glob("hybridvolume-*"))


def message_box():
    boxes = [w for w in QtGui.QApplication.topLevelWidgets() if isinstance(w, QtGui.QMessageBox)]
    return next((box for box in boxes if box.isVisible()), None)


def objects(doc):
    return sorted(obj.Name for obj in doc.Objects)


def state(doc):
    """Everything of a document that a cancelled computation must leave alone."""
    return {
        "objects": objects(doc),
        "undo": doc.UndoNames,
        "visible": {obj.Name: obj.ViewObject.Visibility for obj in doc.Objects},
        # without the flags by which FreeCAD remembers that a value was once changed
        "content": {obj.Name: re.sub(r' status="\d+"', "", obj.Content) for obj in doc.Objects},
    }


def new_document(kind="Part::Box", name="Box"):
    FreeCADGui.activateWorkbench(WORKBENCH)
    doc = FreeCAD.newDocument()
    body = doc.addObject(kind, name)
    doc.recompute()
    if kind == "Part::Box":
        body.Length, body.Width, body.Height = 30, 20, 10
    doc.recompute()
    doc.clearUndos()
    FreeCADGui.activeDocument().activeView().viewIsometric()
    FreeCADGui.SendMsgToActiveView("ViewFit")
    wait(500)
    return doc, body


def new_can():
    """A document with a cylinder whose bottom is missing: refused, whatever is covered."""
    doc, can = new_document("Part::Feature", "Can")
    can.Shape = can_of_height(10)
    doc.recompute()
    doc.clearUndos()
    FreeCADGui.SendMsgToActiveView("ViewFit")
    wait(500)
    return doc, can


def can_of_height(height):
    import Part

    return Part.makeShell(Part.makeCylinder(2.0, height).Faces[:2])


def open_panel(obj):
    FreeCADGui.setActiveDocument(obj.Document.Name)
    FreeCADGui.Selection.clearSelection()
    FreeCADGui.Selection.addSelection(obj)
    FreeCADGui.runCommand(COMMAND)
    wait_for(panel)


def close_panel():
    FreeCADGui.Control.closeDialog()
    wait(300)


def red_share(name):
    """Share of the 3D view that is red."""
    path = FOLDER / f"{name}.png"
    FreeCADGui.activeDocument().activeView().saveImage(str(path), 320, 240, "White")
    image = QtGui.QImage(str(path))
    red = 0
    for x in range(image.width()):
        for y in range(image.height()):
            r, g, b, _ = QtGui.QColor(image.pixel(x, y)).getRgb()
            red += r > 2 * g and r > 2 * b
    return red / (image.width() * image.height())


def complete_a_box(answer):
    """Run, undo, redo, save, reopen, change the body, run again."""
    answer["workbenches"] = list(FreeCADGui.listWorkbenches())
    doc, box = new_document()
    answer["toolbar"] = [
        action.objectName()
        for bar in FreeCADGui.getMainWindow().findChildren(QtGui.QToolBar)
        if bar.objectName() == "HybridVolume"
        for action in bar.actions()
    ]
    command = FreeCADGui.Command.get(COMMAND)
    FreeCADGui.Selection.clearSelection()
    answer["active without selection"] = command.isActive()
    FreeCADGui.Selection.addSelection(box)
    answer["active with a body"] = command.isActive()
    before = state(doc)
    open_panel(box)
    screenshot("1_panel")

    beats = []
    timer = QtCore.QTimer()
    timer.timeout.connect(lambda: beats.append(time.monotonic()))
    timer.start(20)
    click("run")
    wait_for(lambda: workers())
    wait_for(lambda: stage().startswith(("field", "shell")))
    screenshot("2_running")
    answer["enabled while running"] = [
        panel().findChild(QtGui.QPushButton, name).isEnabled() for name in ("run", "cancel")
    ]
    gaps = sorted(b - a for a, b in zip(beats, beats[1:], strict=False))
    answer["longest pause while running"] = gaps[-1]
    wait_for(lambda: stage() == "Done")
    timer.stop()
    screenshot("3_done")
    answer["log"] = panel().findChild(QtGui.QPlainTextEdit, "log").toPlainText()
    close_panel()
    answer["undo names"] = doc.UndoNames
    answer["objects"] = objects(doc)
    answer["status"] = doc.HybridVolume.Status
    answer["visible"] = {obj.Name: obj.ViewObject.Visibility for obj in doc.Objects}
    answer["volumes"] = doc.FemMesh.FemMesh.VolumeCount
    answer["red"] = red_share("view")
    doc.Shell.ViewObject.ColourBy = "Quality"
    wait()
    answer["red by quality"] = red_share("quality")
    answer["children"] = [child.Name for child in doc.HybridVolume.ViewObject.claimChildren()]
    answer["pending"] = doc.HasPendingTransaction
    answer["job folders"] = job_folders()

    doc.undo()
    wait(200)
    answer["undone"] = [key for key, value in state(doc).items() if value != before[key]]
    doc.redo()
    wait(200)
    answer["redone"] = objects(doc)

    path = FOLDER / "saved.FCStd"
    doc.saveAs(str(path))
    FreeCAD.closeDocument(doc.Name)
    doc = FreeCAD.openDocument(str(path))
    wait(500)
    volume = doc.HybridVolume
    answer["reopened"] = {
        "status": volume.Status,
        "objects": objects(doc),
        "visible": {obj.Name: obj.ViewObject.Visibility for obj in doc.Objects},
        "volumes": doc.FemMesh.FemMesh.VolumeCount,
        "red by quality": red_share("reopened"),
    }
    doc.Shell.ViewObject.ColourBy = "Part"
    wait()
    answer["reopened"]["red"] = red_share("reopened")
    doc.Box.Height = 12
    doc.recompute()
    answer["after a change"] = volume.Status
    doc.clearUndos()
    open_panel(volume)
    click("run")
    wait_for(lambda: stage() == "Done")
    close_panel()
    answer["again"] = {"status": volume.Status, "objects": objects(doc), "undo": doc.UndoNames}
    answer["volume again"] = float(volume.Report["input.volume"])
    doc.undo()
    doc.recompute()
    answer["undone again"] = volume.Status


def stop_on_the_way(answer):
    """Cancel, kill the worker, refuse a body, close the document: nothing may change."""
    doc, box = new_document()
    before = state(doc)
    open_panel(box)
    click("run")
    wait_for(lambda: stage().startswith("field"))
    (pid,) = workers()
    click("cancel")
    answer["cancelled"] = {
        "stage": stage(),
        "same": state(doc) == before,
        "workers": workers(),
        "alive": Path(f"/proc/{pid}").exists(),
        "folders": job_folders(),
    }
    click("run")
    wait_for(lambda: stage().startswith("field"))
    (pid,) = workers()
    os.kill(pid, signal.SIGKILL)
    wait_for(message_box)
    screenshot("4_killed")
    answer["killed"] = {
        "message": message_box().text(),
        "same": state(doc) == before,
        "workers": workers(),
        "folders": job_folders(),
        "stage": stage(),
    }
    message_box().close()
    wait(200)
    close_panel()

    other, can = new_can()
    before = state(other)
    open_panel(can)
    click("run")
    wait_for(message_box)
    screenshot("5_refused")
    answer["refused"] = {
        "message": message_box().text(),
        "selected": list(FreeCADGui.Selection.getSelectionEx()[0].SubElementNames),
        "same": state(other) == before,
    }
    message_box().close()
    close_panel()

    open_panel(box)
    click("run")
    wait_for(lambda: stage().startswith("field"))
    name = doc.Name
    FreeCAD.closeDocument(name)
    wait_for(message_box)
    answer["document closed"] = {"message": message_box().text(), "folders": job_folders()}


def without_environment(answer):
    """No environment: a question; No leaves everything, Yes makes it, in vain or with success."""
    doc, box = new_document()
    before = state(doc)
    asked = []

    def reply(button):
        def press():
            box = message_box()
            if box is None:
                QtCore.QTimer.singleShot(100, press)
                return
            asked.append(box.text())
            box.button(button).click()

        QtCore.QTimer.singleShot(300, press)

    open_panel(box)
    reply(QtGui.QMessageBox.No)
    click("run")
    answer["question"] = asked[-1]
    answer["declined"] = {"stage": stage(), "same": state(doc) == before}
    reply(QtGui.QMessageBox.Yes)
    click("run")
    wait_for(message_box)
    screenshot("6_no_environment")
    answer["failed"] = {"message": message_box().text(), "same": state(doc) == before}
    message_box().close()
    wait(300)

    os.environ["HYBRIDVOLUME_BASE_PYTHON"] = os.environ["HYBRIDVOLUME_STUB"]
    reply(QtGui.QMessageBox.Yes)
    click("run")
    wait_for(lambda: stage() == "the first step")
    screenshot("7_setup")
    click("cancel")
    answer["set-up cancelled"] = {"stage": stage(), "same": state(doc) == before}
    reply(QtGui.QMessageBox.Yes)
    click("run")
    wait_for(lambda: stage() == "Done")
    answer["in the end"] = objects(doc)


def open_a_document(answer):
    """A document that was made without a window gets its looks."""
    FreeCADGui.activateWorkbench("PartWorkbench")
    doc = FreeCAD.openDocument(os.environ["HYBRIDVOLUME_DOCUMENT"])
    FreeCADGui.activeDocument().activeView().viewIsometric()
    FreeCADGui.SendMsgToActiveView("ViewFit")
    wait(500)
    screenshot("7_opened")
    answer["visible"] = {obj.Name: obj.ViewObject.Visibility for obj in doc.Objects}
    answer["red"] = red_share("opened")
