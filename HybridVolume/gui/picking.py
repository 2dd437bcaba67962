# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Sheets under the mouse: their colours, what a click means, and a box that selects several."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import FreeCAD
import FreeCADGui
import numpy as np
from PySide import QtCore, QtGui

from .sheets_view import SheetsScene, sheet_name, sheet_number

NOWHERE = (0.0, 0.0, 0.0)
"""The point of a selection that was not made by the mouse."""


BOX_SAMPLES = 50
"""Facets of a sheet that say whether it lies in a box on the screen, about."""


class _Colours:
    """Observer of FreeCAD's selection: colours sheets that are selected or under the mouse.

    FreeCAD colours only nodes of its own kinds.
    """

    def setPreselection(self, document: str, name: str, sub: str) -> None:
        scene = _scene(document, name)
        if scene:
            scene.hover(sheet_number(sub))

    def removePreselection(self, document: str, name: str, sub: str) -> None:
        scene = _scene(document, name)
        if scene:
            scene.hover(None)

    def addSelection(self, document: str, name: str, sub: str, point: Any) -> None:
        self._mark(document, name)

    def removeSelection(self, document: str, name: str, sub: str) -> None:
        self._mark(document, name)

    def setSelection(self, document: str) -> None:
        self.clearSelection(document)

    def clearSelection(self, document: str) -> None:
        for doc in FreeCAD.listDocuments().values():
            for obj in doc.findObjects("App::FeaturePython"):
                self._mark(doc.Name, obj.Name)

    def _mark(self, document: str, name: str) -> None:
        scene = _scene(document, name)
        if scene:
            obj = FreeCAD.getDocument(document).getObject(name)
            scene.mark(frozenset(selected_sheets(obj)))


_colours: _Colours | None = None


def colour_what_is_picked() -> None:
    """Begin to colour sheets that are picked; once for all documents."""
    global _colours
    if _colours is None:
        _colours = _Colours()
        FreeCADGui.Selection.addObserver(_colours)


def _scene(document: str, name: str) -> SheetsScene | None:
    doc = FreeCAD.listDocuments().get(document)
    obj = doc.getObject(name) if doc else None
    view = getattr(obj, "ViewObject", None)
    scene = getattr(getattr(view, "Proxy", None), "scene", None)
    return scene if isinstance(scene, SheetsScene) else None


def selected_sheets(obj: Any) -> list[int]:
    """Places in ``Midstructure.sheets`` of the sheets of an object that are selected."""
    found = []
    for one in FreeCADGui.Selection.getSelectionEx(obj.Document.Name):
        if one.ObjectName == obj.Name:
            found += [sheet_number(name) for name in one.SubElementNames]
    return sorted({number for number in found if number is not None})


def select_sheets(obj: Any, numbers: Iterable[int]) -> None:
    """Make sheets of an object the selection of its document."""
    FreeCADGui.Selection.clearSelection(obj.Document.Name)
    for number in numbers:
        FreeCADGui.Selection.addSelection(obj.Document.Name, obj.Name, sheet_name(number))


def remove_sheets(obj: Any, numbers: Sequence[int]) -> None:
    """Remove sheets of a midstructure as a recorded line."""
    from HybridVolume.objects.midstructure import chosen

    from .macro import Macro

    found = chosen(obj)
    if found is not None:
        macro = Macro(obj)
        macro.run(macro.decision("remove", [found.sheets[number] for number in numbers]))


class SheetPicking:
    """While it is open, only sheets of one midstructure are picked, and clicks are told.

    Parameters
    ----------
    obj : App.DocumentObject
        The midstructure.
    clicked : callable(number)
        A sheet was clicked without Ctrl.
    selected : callable()
        The selection changed.
    hovered : callable(number or None)
    """

    def __init__(
        self,
        obj: Any,
        clicked: Callable[[int], None],
        selected: Callable[[], None],
        hovered: Callable[[int | None], None],
    ) -> None:
        self._obj = obj
        self._place = (obj.Document.Name, obj.Name)
        self._clicked = clicked
        self._selected = selected
        self._hovered = hovered
        self.anything = False
        """Whether other objects can be selected as well."""
        self._gate = _Gate(self)
        self._clicks = Clicks(self._place[0], self._click_below)
        FreeCADGui.Selection.clearSelection()
        FreeCADGui.Selection.addSelectionGate(self._gate)
        FreeCADGui.Selection.addObserver(self)

    def close(self) -> None:
        """Remove gate and observer; sheets are no longer selected."""
        self._clicks.close()
        FreeCADGui.Selection.removeSelectionGate()
        FreeCADGui.Selection.removeObserver(self)
        FreeCADGui.Selection.clearSelection()

    def allows(self, document: str, name: str, sub: str) -> bool:
        """Whether something can be selected."""
        ours = (document, name) == self._place and sheet_number(sub) is not None
        return ours or self.anything or document != self._place[0]

    # What FreeCAD tells an observer.

    def addSelection(self, document: str, name: str, sub: str, point: Any) -> None:
        # a plain click selects as well, for FreeCAD; it is told by _click_below, which ends that
        control = QtGui.QApplication.keyboardModifiers() & QtCore.Qt.ControlModifier
        if tuple(point) == NOWHERE or control:
            self._selected()

    def _click_below(self, view: Any, place: tuple[int, int]) -> None:
        below = view.getObjectInfo(place) or {}
        number = sheet_number(below.get("Component", ""))
        if below.get("Object", "") == self._place[1] and number is not None:
            FreeCADGui.Selection.clearSelection()
            self._clicked(number)

    def removeSelection(self, document: str, name: str, sub: str) -> None:
        self._selected()

    def setSelection(self, document: str) -> None:
        self._selected()

    def clearSelection(self, document: str) -> None:
        self._selected()

    def setPreselection(self, document: str, name: str, sub: str) -> None:
        if (document, name) == self._place:
            self._hovered(sheet_number(sub))

    def removePreselection(self, document: str, name: str, sub: str) -> None:
        self._hovered(None)


class _Gate:
    """What FreeCAD asks whether something can be selected."""

    def __init__(self, picking: SheetPicking) -> None:
        self._picking = picking

    def allow(self, document: Any, obj: Any, sub: str) -> bool:
        return obj is None or self._picking.allows(document.Name, obj.Name, sub or "")


class Clicks(QtCore.QObject):
    """Plain clicks in the 3D views of a document.

    FreeCAD tells a selection only where it changes, not a click on what is selected already.

    Parameters
    ----------
    document : str
    clicked : callable(view, place)
        The 3D view, and pixels from its lower left corner.
    """

    FAR = 4
    """Pixels: a mouse that moves so far between press and release does not click."""

    def __init__(self, document: str, clicked: Callable[[Any, tuple[int, int]], None]) -> None:
        super().__init__()
        self._document = document
        self._clicked = clicked
        self._start: QtCore.QPoint | None = None
        windows = FreeCADGui.getMainWindow().findChild(QtGui.QMdiArea)
        self._viewports = [view.viewport() for view in windows.findChildren(QtGui.QGraphicsView)]
        for viewport in self._viewports:
            viewport.installEventFilter(self)

    def close(self) -> None:
        """Stop listening."""
        for viewport in self._viewports:
            with contextlib.suppress(RuntimeError):  # closed with its window
                viewport.removeEventFilter(self)
        self._viewports = []

    def eventFilter(self, watched: Any, event: Any) -> bool:
        """Look at the mouse's events; the view gets them all the same."""
        kind = event.type()
        if kind == QtCore.QEvent.MouseButtonPress:
            plain = event.button() == QtCore.Qt.LeftButton and not event.modifiers()
            self._start = event.pos() if plain else None
        elif kind == QtCore.QEvent.MouseButtonRelease and self._start is not None:
            start, self._start = self._start, None
            if (event.pos() - start).manhattanLength() < self.FAR and not event.modifiers():
                ratio = watched.devicePixelRatio()
                place = (
                    int(ratio * event.pos().x()),
                    int(ratio * (watched.height() - 1 - event.pos().y())),
                )
                # Later: FreeCAD selects first.
                QtCore.QTimer.singleShot(0, lambda: self._tell(place))
        return False

    def _tell(self, place: tuple[int, int]) -> None:
        active = FreeCADGui.activeDocument()
        if self._viewports and active is not None and active.Document.Name == self._document:
            self._clicked(active.activeView(), place)


class BoxSelection(QtCore.QObject):
    """The next drag of the mouse over a 3D view draws a box.

    Parameters
    ----------
    view : Gui.View3DInventor
    done : callable(rectangle or None)
        ``(x0, y0, x1, y1)`` in pixels of the view from its lower left corner; None where the user
        pressed Escape or another button.
    """

    def __init__(self, view: Any, done: Callable[[tuple[float, ...] | None], None]) -> None:
        self._viewport = _viewport(view)
        super().__init__(self._viewport)
        self._done = done
        self._start: QtCore.QPoint | None = None
        self._band = QtGui.QRubberBand(QtGui.QRubberBand.Rectangle, self._viewport)
        self._viewport.installEventFilter(self)
        self._viewport.setFocus()
        QtGui.QApplication.setOverrideCursor(QtCore.Qt.CrossCursor)

    def close(self) -> None:
        """Stop waiting for a drag."""
        if self._viewport is not None:
            QtGui.QApplication.restoreOverrideCursor()
            self._viewport.removeEventFilter(self)
            self._viewport = None
            self._band.hide()
            self._band.deleteLater()

    def eventFilter(self, watched: Any, event: Any) -> bool:
        """Take the mouse's events away from the view."""
        kind = event.type()
        if kind == QtCore.QEvent.KeyPress and event.key() == QtCore.Qt.Key_Escape:
            self._finish(None)
        elif kind == QtCore.QEvent.MouseButtonPress and event.button() == QtCore.Qt.LeftButton:
            self._start = event.pos()
            self._band.setGeometry(QtCore.QRect(self._start, QtCore.QSize()))
            self._band.show()
        elif kind == QtCore.QEvent.MouseMove and self._start is not None:
            self._band.setGeometry(QtCore.QRect(self._start, event.pos()).normalized())
        elif kind == QtCore.QEvent.MouseButtonRelease and self._start is not None:
            box = QtCore.QRect(self._start, event.pos()).normalized()
            height, ratio = watched.height(), watched.devicePixelRatio()
            self._finish(
                tuple(
                    ratio * value
                    for value in (
                        *(box.left(), height - 1 - box.bottom()),
                        *(box.right(), height - 1 - box.top()),
                    )
                )
            )
        elif kind == QtCore.QEvent.MouseButtonPress:
            self._finish(None)
        else:
            return False
        return True

    def _finish(self, box: tuple[float, ...] | None) -> None:
        self.close()
        self._done(box)


def _viewport(view: Any) -> Any:
    """The widget that a 3D view is drawn on."""
    window = FreeCADGui.getMainWindow().findChild(QtGui.QMdiArea).currentSubWindow()
    return window.findChild(QtGui.QGraphicsView).viewport()


def sheets_in_box(
    view: Any, points: np.ndarray, facets: np.ndarray, sheet: np.ndarray, box: tuple[float, ...]
) -> list[int]:
    """Sheets of which more than half of the facets appear inside a box on the screen.

    Parameters
    ----------
    view : Gui.View3DInventor
    points : (m, 3) array
        mm.
    facets : (f, 3) int array
    sheet : (f,) int array
    box : (x0, y0, x1, y1)
        Pixels from the lower left corner.
    """
    # the projection is FreeCAD's own, point by point: some facets of each sheet must do
    order = np.argsort(sheet, kind="stable")
    first = np.searchsorted(sheet[order], sheet[order])
    stride = np.maximum(np.bincount(sheet)[sheet[order]] // BOX_SAMPLES, 1)
    some = order[(np.arange(len(order)) - first) % stride == 0]
    middle = points[facets[some]].mean(axis=1)
    place = np.array([view.getPointOnScreen(FreeCAD.Vector(*p)) for p in middle.tolist()])
    x, y = place.reshape(-1, 2).T
    inside = (x >= box[0]) & (x <= box[2]) & (y >= box[1]) & (y <= box[3])
    count = int(sheet.max()) + 1 if len(sheet) else 0
    owner = sheet[some]
    share = np.bincount(owner, inside, count) / np.maximum(np.bincount(owner, minlength=count), 1)
    return np.flatnonzero(share > 0.5).tolist()
