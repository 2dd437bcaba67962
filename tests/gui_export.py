# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A mesh goes to files, in FreeCAD's real window; test_gui_export.py judges."""

import os

import FreeCADGui
from gui_midstructure import whole_window
from gui_quality import toolbar
from gui_scenarios import FOLDER, message_box, new_document, screenshot, wait, wait_for
from PySide import QtCore, QtGui


def said(action):
    """Text of the window that an action brings up, which is then closed."""
    action()
    wait_for(message_box, 20.0)
    box = message_box()
    text = box.text()
    box.close()
    wait(300)
    return text


def dialog():
    window = FreeCADGui.getMainWindow()
    found = window.findChildren(QtGui.QFileDialog, "HybridVolume_Export")
    return next((one for one in found if one.isVisible()), None)


def fill(path, words):
    """Open the dialog from the tool bar, choose a kind, type a name, press Save."""
    toolbar("HybridVolume_Export")
    wait_for(dialog, 20.0)
    box = dialog()
    kinds = box.nameFilters()
    combo = box.findChild(QtGui.QComboBox, "fileTypeCombo")
    index = next(i for i in range(combo.count()) if words in combo.itemText(i))
    # as a hand does it, for signals that only a hand's choice sends
    key = QtCore.Qt.Key_Up if combo.currentIndex() > index else QtCore.Qt.Key_Down
    while combo.currentIndex() != index:
        for kind in (QtCore.QEvent.KeyPress, QtCore.QEvent.KeyRelease):
            event = QtGui.QKeyEvent(kind, key, QtCore.Qt.NoModifier)
            QtGui.QApplication.sendEvent(combo, event)
        wait(50)
    line = box.findChild(QtGui.QLineEdit, "fileNameEdit")
    proposed = line.text()
    line.setText(path)
    wait(300)
    return box, kinds, proposed


def files(answer):
    """A volume that was stored is written as four kinds; then what cannot be."""
    from HybridVolume.objects.volume import make_volume

    doc, body = new_document()
    whole_window()
    answer["no volume"] = said(lambda: toolbar("HybridVolume_Export"))
    volume = make_volume(doc)
    volume.Source, volume.Result = body, os.environ["HYBRIDVOLUME_STORED"]
    doc.recompute()
    steps = doc.UndoNames
    kinds = ("Code_Aster", "one"), ("Gmsh", "two.msh"), ("CalculiX", "three"), ("G+Smo", "shell")
    for words, name in kinds:
        box, answer["kinds"], answer["proposed"] = fill(str(FOLDER / name), words)
        if name == "one":
            screenshot("dialog")
        box.accept()
        wait_for(lambda: dialog() is None, 20.0)
        wait_for(lambda n=name: list(FOLDER.glob(f"{n.split('.')[0]}.*")), 20.0)
        wait(300)
    answer["told"] = message_box() is not None
    box, _, _ = fill(str(FOLDER / "four.stl"), "ParaView")
    answer["ending"] = said(box.accept)
    answer["steps"] = doc.UndoNames == steps
