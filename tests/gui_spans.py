# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The spans in the volume's panel under real clicks and keys; test_gui_spans.py judges."""

import FreeCADGui
from gui_midstructure import record, whole_window
from gui_scenarios import FOLDER, new_document, open_panel, stage, wait, wait_for
from gui_thickness import child, double_click, finish, press, type_into
from PySide import QtGui


def section():
    return {
        "title": child("spansToggle", QtGui.QToolButton).text(),
        "open": child("spansBox").isVisible(),
        "aspect": child("spanAspect").text(),
        "turn": child("spanTurn").text(),
    }


def even_box(answer):
    """Ask for spans of 8 mm and run; ask for another aspect later, OK, Undo."""
    doc, box = new_document()
    whole_window()
    record("recorded")
    open_panel(box)
    wait(300)
    answer["first"] = section()
    press("spansToggle")
    type_into(child("spanSize"), "0.8 cm")
    type_into(child("spanAspect"), "1.5")
    answer["too small an aspect"] = section()
    type_into(child("spanAspect"), "0")
    type_into(child("spanTurn"), "30")
    FreeCADGui.getMainWindow().grab().save(str(FOLDER / "spans.png"))
    press("spansToggle")
    answer["asked"] = section()
    press("run")
    wait_for(lambda: stage() == "Done", 150)
    volume = doc.HybridVolume
    answer["done"] = {
        "log": child("log", QtGui.QPlainTextEdit).toPlainText(),
        "spans": int(volume.Report["evening.after.spans"]),
        "given": int(volume.Report["evening.before.spans"]),
        "size": volume.SpanSize.Value,
        "aspect": volume.SpanAspect,
        "turn": volume.SpanTurn,
        "status": volume.Status,
        "undo": list(doc.UndoNames),
    }
    stop = "Std_MacroStopRecord"  # from 1.0 on the command that began ends as well
    FreeCADGui.runCommand(stop if stop in FreeCADGui.listCommands() else "Std_DlgMacroRecord")
    finish("Close")
    answer["macro"] = next(FOLDER.rglob("recorded*.FCMacro")).read_text()

    double_click(volume)
    answer["opened again"] = section()
    press("spansToggle")
    type_into(child("spanAspect"), "4")
    finish("OK")
    answer["after OK"] = {"aspect": volume.SpanAspect, "status": volume.Status}
    doc.undo()
    answer["undone"] = {"aspect": volume.SpanAspect, "status": volume.Status}
