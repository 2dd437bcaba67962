# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What every panel of the workbench is: a form, a wider dock, and answers to FreeCAD."""

from __future__ import annotations

from typing import Any

import FreeCADGui
from PySide import QtCore, QtGui

from .dock import WideDock
from .forms import load_form, load_icon

SETTLED = 150
"""Milliseconds after which FreeCAD has laid a panel out anew."""

TITLE = 0.75
"""Largest width of a title, as a share of the dock's."""


class Panel:
    """Base of the task panels, which leave document, selection and view usable.

    Parameters
    ----------
    name : str
        Of the file in resources/ui.
    icon : str
        Of the file in resources/icons.

    Attributes
    ----------
    form : QWidget
    """

    WIDTH = 370
    """Of the dock, pixels."""

    def __init__(self, name: str, icon: str) -> None:
        self.form = load_form(name)
        self.form.setWindowIcon(load_icon(icon))
        self._closed = False
        self._dock: WideDock | None = None

    def _opened(self) -> None:
        """Call this where nothing can fail any more: from now on closing puts everything back."""
        self._dock = WideDock(self.form, self.WIDTH)
        for kind in (QtGui.QAbstractSpinBox, QtGui.QComboBox, QtGui.QSlider):
            for widget in self.form.findChildren(kind):
                leave_wheel(widget)
        # whoever closes the dialog: observers, gates and what was added to the view must go
        self.form.destroyed.connect(lambda *_: self._clean())

    # What FreeCAD asks a panel.

    def getStandardButtons(self) -> Any:
        """Return the buttons beside the panel."""
        return QtGui.QDialogButtonBox.Close

    def reject(self) -> bool:
        """Close the panel."""
        self._close()
        return True

    def isAllowedAlterDocument(self) -> bool:
        """Leave the document, and Undo, usable while the panel is open."""
        return True

    def isAllowedAlterSelection(self) -> bool:
        """Leave the selection usable while the panel is open."""
        return True

    def isAllowedAlterView(self) -> bool:
        """Leave the view usable while the panel is open."""
        return True

    # Closing.

    def _close(self) -> None:
        self._clean()
        FreeCADGui.Control.closeDialog()

    def _clean(self) -> None:
        if not self._closed:
            self._closed = True
            self._put_back()
            if self._dock is not None:
                self._dock.close()

    def _put_back(self) -> None:
        """Take back what the panel did to the window; called once."""


class _WheelGuard(QtCore.QObject):
    """Hands the wheel on to what is around a field, as long as nobody clicked into the field."""

    def eventFilter(self, watched: Any, event: Any) -> bool:
        """Take the turns of the wheel; they go to the field's parent then."""
        if event.type() != QtCore.QEvent.Wheel or watched.hasFocus():
            return False
        event.ignore()
        return True


def leave_wheel(widget: Any) -> None:
    """Let the wheel scroll the panel over a field, not change its value unseen.

    Parameters
    ----------
    widget : QWidget
        A field with a number or a choice.
    """
    widget.setFocusPolicy(QtCore.Qt.StrongFocus)
    widget.installEventFilter(_WheelGuard(widget))


def elided(text: str, form: Any) -> str:
    """Return a text that is no wider than a title in a panel may be, cut at its end.

    Parameters
    ----------
    text : str
    form : QWidget
        Of the panel: its letters count.
    """
    metrics = QtGui.QFontMetrics(form.font())
    return metrics.elidedText(text, QtCore.Qt.ElideRight, round(TITLE * Panel.WIDTH))


def show_in_panel(widget: Any) -> None:
    """Scroll a panel until a widget is seen, once what was shown or hidden has its place.

    Parameters
    ----------
    widget : QWidget
        Somewhere in a panel.
    """

    def scroll() -> None:
        above = widget.parentWidget()
        while above is not None and not isinstance(above, QtGui.QScrollArea):
            above = above.parentWidget()
        if above is not None:
            above.ensureWidgetVisible(widget, 0, 0)

    QtCore.QTimer.singleShot(SETTLED, scroll)
