# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A wider dock for as long as a panel needs it."""

from __future__ import annotations

from typing import Any

import FreeCADGui
from PySide import QtCore, QtGui


class WideDock:
    """Widens the dock that a panel is in, where it is narrower, until :meth:`close`.

    Parameters
    ----------
    form : QWidget
        The panel, which is shown soon.
    width : int
        Pixels.
    """

    def __init__(self, form: Any, width: int) -> None:
        self._form = form
        self._width = width
        self._dock: Any | None = None
        self._before = 0
        QtCore.QTimer.singleShot(0, self._widen)

    def _widen(self) -> None:
        dock = None if self._form is None else self._form.parentWidget()
        while dock is not None and not isinstance(dock, QtGui.QDockWidget):
            dock = dock.parentWidget()
        if dock is not None and dock.width() < self._width and not dock.isFloating():
            self._dock, self._before = dock, dock.width()
            self._resize(self._width)

    def _resize(self, width: int) -> None:
        FreeCADGui.getMainWindow().resizeDocks([self._dock], [width], QtCore.Qt.Horizontal)

    def close(self) -> None:
        """Make the dock as wide as it was, if nobody changed it meanwhile."""
        self._form = None
        if self._dock is not None and abs(self._dock.width() - self._width) < 10:
            self._resize(self._before)
        self._dock = None
