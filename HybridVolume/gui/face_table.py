# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Tables of faces that have a value of their own: of the shell's thickness, of the edge length."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import FreeCADGui
from PySide import QtCore, QtGui

from .panel import leave_wheel

SELECT_FIRST = "First click faces of the body in the 3D view (several with Ctrl), then this button."


@dataclass(frozen=True)
class Kind:
    """What the values of a table are.

    Attributes
    ----------
    column : str
        Head of their column.
    title : str
        Of the section.
    hint : str
        What to do, where there is nothing else to say.
    first : float
        Value of a face that is new in the table.
    low, high, step : float
    decimals : int
    prefix, suffix : str
    """

    column: str
    title: str
    hint: str
    first: float
    low: float
    high: float
    step: float
    decimals: int = 2
    prefix: str = ""
    suffix: str = ""


FACTORS = Kind(
    column="Factor",
    title="Faces with another thickness",
    hint="Click a face in the 3D view, add it here, and give it a factor: "
    "2 is twice as thick there, 0.5 half as thick.",
    first=1.5,
    low=0.05,
    high=20.0,
    step=0.25,
    prefix="× ",
)


def sizes(first: float) -> Kind:
    """Edge lengths at faces.

    Parameters
    ----------
    first : float
        Of a face that is new in the table, mm.
    """
    digits = max(2, 2 - math.floor(math.log10(first)))
    return Kind(
        column="Edge length",
        title="Faces with another edge length",
        hint="Click a face in the 3D view, add it here, and say how long the edges of its "
        "elements are at most.",
        first=first,
        low=10.0**-digits,
        high=1e6,
        step=float(f"{0.2 * first:.1g}"),
        decimals=digits,
        suffix=" mm",
    )


@dataclass(frozen=True)
class Widgets:
    """The widgets of a table's section."""

    toggle: Any
    box: Any
    hint: Any
    table: Any
    add: Any
    remove: Any


class FaceTable:
    """Lets the user pick faces and give each a value.

    Parameters
    ----------
    widgets : Widgets
    kind : Kind
    source : App.DocumentObject
        The body.
    names : mapping of str to str
        For every face of the source, by its name in the selection, its name in the solid.
    changed : callable()
        The user changed something.
    opened : callable()
        The section was opened or closed.
    """

    def __init__(
        self,
        widgets: Widgets,
        kind: Kind,
        source: Any,
        names: Mapping[str, str],
        changed: Callable[[], None],
        opened: Callable[[], None],
    ) -> None:
        self._widgets, self._kind = widgets, kind
        self._source = source
        self._document = source.Document.Name
        self._names = dict(names)
        self._in_source = {own: name for name, own in self._names.items()}
        self._changed = changed
        self._opened = opened
        self._marking = False
        table = widgets.table
        table.setColumnCount(2)
        table.setHorizontalHeaderLabels(("Face", kind.column))
        table.verticalHeader().hide()
        table.verticalHeader().setDefaultSectionSize(24)
        table.horizontalHeader().setStretchLastSection(True)
        table.horizontalHeader().setHighlightSections(False)
        table.itemSelectionChanged.connect(self._mark_faces)
        widgets.toggle.toggled.connect(self._open)
        widgets.add.clicked.connect(self._add_selected)
        widgets.remove.clicked.connect(self._remove)
        FreeCADGui.Selection.addObserver(self)
        self._title()
        self._open(False)

    def close(self) -> None:
        """Stop watching the selection."""
        FreeCADGui.Selection.removeObserver(self)

    @property
    def open(self) -> bool:
        """Whether the section is open."""
        return self._widgets.toggle.isChecked()

    @property
    def values(self) -> dict[str, float]:
        """Value of each face of the table, by its name in the solid."""
        table = self._widgets.table
        return {
            table.item(row, 0).text(): table.cellWidget(row, 1).value()
            for row in range(table.rowCount())
        }

    def show(self, values: Mapping[str, float]) -> None:
        """Show values of faces."""
        self._widgets.table.setRowCount(0)
        for face, value in values.items():
            self._add(face, value)
        self._title()

    # The section.

    def _open(self, on: bool) -> None:
        arrow = QtCore.Qt.DownArrow if on else QtCore.Qt.RightArrow
        self._widgets.toggle.setArrowType(arrow)
        self._widgets.box.setVisible(on)
        self._hint("")
        self._opened()

    def _title(self) -> None:
        count, text = self._widgets.table.rowCount(), self._kind.title
        self._widgets.toggle.setText(f"{text} ({count})" if count else text)

    def _hint(self, text: str) -> None:
        self._widgets.hint.setText(text or self._kind.hint)

    # The table.

    def _add(self, face: str, value: float) -> None:
        table, kind = self._widgets.table, self._kind
        row = table.rowCount()
        table.setRowCount(row + 1)
        table.setItem(row, 0, QtGui.QTableWidgetItem(face))
        box = QtGui.QDoubleSpinBox()
        # a document may ask for more digits, and for more or less, than the panel offers
        box.setDecimals(max(kind.decimals, _digits(value)))
        box.setRange(min(kind.low, value), max(kind.high, value))
        box.setSingleStep(kind.step)
        box.setPrefix(kind.prefix)
        box.setSuffix(kind.suffix)
        box.setFrame(False)
        box.setValue(value)
        box.valueChanged.connect(lambda *_: self._changed())
        leave_wheel(box)
        table.setCellWidget(row, 1, box)

    def _rows(self) -> list[int]:
        model = self._widgets.table.selectionModel()
        return sorted({index.row() for index in model.selectedRows()})

    def _add_selected(self) -> None:
        faces = self._selected()
        if not faces:
            self._hint(SELECT_FIRST)
            return
        self._hint("")
        for face in faces:
            if face not in self.values:
                self._add(face, self._kind.first)
        self._title()
        self._select_rows(faces)
        self._changed()

    def _remove(self) -> None:
        for row in reversed(self._rows()):
            self._widgets.table.removeRow(row)
        self._title()
        self._changed()

    # Table and selection say the same.

    def _selected(self) -> list[str]:
        """Faces of the body that are selected in the 3D view, by their names in the solid."""
        found = []
        for one in FreeCADGui.Selection.getSelectionEx(self._document):
            if self._belongs(one.Object):
                found += [self._names[sub] for sub in one.SubElementNames if sub in self._names]
        return list(dict.fromkeys(found))

    def _belongs(self, obj: Any) -> bool:
        """Whether picking an object picks the body: it itself, or the tip of a PartDesign body."""
        return obj == self._source or obj == getattr(self._source, "Tip", None)

    def _mark_faces(self) -> None:
        rows = self._rows()
        self._widgets.remove.setEnabled(bool(rows))
        if self._marking:
            return
        names = [self._widgets.table.item(row, 0).text() for row in rows]
        self._marking = True
        try:
            FreeCADGui.Selection.clearSelection(self._document)
            for name in names:
                if name in self._in_source:
                    FreeCADGui.Selection.addSelection(
                        self._document, self._source.Name, self._in_source[name]
                    )
        finally:
            self._marking = False

    def _select_rows(self, faces: list[str]) -> None:
        table = self._widgets.table
        self._marking = True
        try:
            model = table.selectionModel()
            model.clearSelection()
            for row in range(table.rowCount()):
                if table.item(row, 0).text() in faces:
                    model.select(
                        table.model().index(row, 0),
                        QtCore.QItemSelectionModel.Select | QtCore.QItemSelectionModel.Rows,
                    )
                    table.scrollToItem(table.item(row, 0))
        finally:
            self._marking = False

    def _follow(self) -> None:
        if not self._marking:
            self._select_rows(self._selected())

    # What FreeCAD tells an observer.

    def addSelection(self, document: str, name: str, sub: str, point: Any) -> None:
        """Mark the row of a face that is picked."""
        self._follow()

    def removeSelection(self, document: str, name: str, sub: str) -> None:
        """Follow."""
        self._follow()

    def setSelection(self, document: str) -> None:
        """Follow."""
        self._follow()

    def clearSelection(self, document: str) -> None:
        """Follow."""
        self._follow()


def _digits(value: float) -> int:
    """Decimals that a value needs."""
    return next((n for n in range(12) if math.isclose(round(value, n), value, rel_tol=1e-9)), 12)


def face_names(source: Any, solid: int) -> dict[str, str]:
    """Names in a solid for the faces of a document object.

    Parameters
    ----------
    source : App.DocumentObject
    solid : int
        Which solid of it, from 1.
    """
    shape = getattr(source, "Shape", None)
    if shape is None or shape.isNull():
        return {}
    solids = shape.Solids
    faces = solids[solid - 1].Faces if len(solids) >= solid else []
    # the hash is a face's own; faces of equal hash are few
    place: dict[int, list[int]] = {}
    every = shape.Faces
    for number, face in enumerate(every):
        place.setdefault(face.hashCode(), []).append(number)
    names = {}
    for own, face in enumerate(faces):
        for number in place.get(face.hashCode(), ()):
            if every[number].isSame(face):
                names[f"Face{number + 1}"] = f"Face{own + 1}"
                break
    return names
