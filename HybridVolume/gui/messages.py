# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Messages to the user in windows of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import FreeCADGui
from PySide import QtCore, QtGui

from HybridVolume.errors import HybridVolumeError

from . import red_places

TITLE = "HybridVolume"


def show_error(error: HybridVolumeError, source: Any, log: str = "") -> Any:
    """Show an error beside the living window, its places in red, and select the faces it names.

    Parameters
    ----------
    error : HybridVolumeError
    source : App.DocumentObject
        The body.
    log : str
        The worker's log, shown on demand.

    Returns
    -------
    QMessageBox
    """
    box = QtGui.QMessageBox(FreeCADGui.getMainWindow())
    box.setAttribute(QtCore.Qt.WA_DeleteOnClose)
    box.setIcon(QtGui.QMessageBox.Warning)
    box.setWindowTitle(TITLE)
    box.setTextFormat(QtCore.Qt.PlainText)
    box.setText(error.line)
    if log:
        box.setDetailedText(log)
    box.setStandardButtons(QtGui.QMessageBox.Ok)
    box.open()
    _select(error.faces, source)
    if red_places.show(source, error):
        # not in front of what it is about
        window = FreeCADGui.getMainWindow().geometry()
        box.move(window.left() + 8, window.bottom() - box.frameGeometry().height() - 32)
    return box


def tell(title: str, text: str) -> Any:
    """Tell something beside the living window.

    Returns
    -------
    QMessageBox
    """
    box = QtGui.QMessageBox(FreeCADGui.getMainWindow())
    box.setAttribute(QtCore.Qt.WA_DeleteOnClose)
    box.setIcon(QtGui.QMessageBox.Information)
    box.setWindowTitle(f"{TITLE}: {title}")
    box.setText(text)
    box.open()
    return box


def offer(error: HybridVolumeError, what: str, accepted: Callable[[], None]) -> Any:
    """Show an error beside the living window, with a button that does what would help.

    Parameters
    ----------
    error : HybridVolumeError
    what : str
        On the button.
    accepted : callable()

    Returns
    -------
    QMessageBox
    """
    box = QtGui.QMessageBox(FreeCADGui.getMainWindow())
    box.setAttribute(QtCore.Qt.WA_DeleteOnClose)
    box.setIcon(QtGui.QMessageBox.Warning)
    box.setWindowTitle(TITLE)
    box.setTextFormat(QtCore.Qt.PlainText)
    box.setText(error.line)
    button = box.addButton(what, QtGui.QMessageBox.AcceptRole)
    box.addButton(QtGui.QMessageBox.Cancel)
    # Later: the window is still closing.
    button.clicked.connect(lambda *_: QtCore.QTimer.singleShot(0, accepted))
    box.open()
    return box


def _select(faces: tuple[str, ...], source: Any) -> None:
    try:
        count = len(source.Shape.Faces) if hasattr(source, "Shape") else 0
        document, name = source.Document.Name, source.Name
    except ReferenceError:  # the body is gone
        return
    if not faces or not count:
        return
    FreeCADGui.Selection.clearSelection()
    known = {f"Face{number + 1}" for number in range(count)}
    for face in faces:
        if face in known:
            FreeCADGui.Selection.addSelection(document, name, face)


def ask(title: str, text: str) -> bool:
    """Ask a question that is answered by Yes or No."""
    answer = QtGui.QMessageBox.question(
        FreeCADGui.getMainWindow(),
        f"{TITLE}: {title}",
        text,
        QtGui.QMessageBox.Yes | QtGui.QMessageBox.No,
        QtGui.QMessageBox.Yes,
    )
    return answer == QtGui.QMessageBox.Yes
