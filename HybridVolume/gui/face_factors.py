# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The table of faces at which the shell is thicker or thinner than elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import FreeCADGui
from PySide import QtCore, QtGui

COLUMNS = ("Face", "Factor")
FIRST = 1.5
"""Factor of a face that is new in the table."""
RANGE = (0.05, 20.0)
SELECT_FIRST = "First click faces of the body in the 3D view (several with Ctrl), then this button."


class FaceFactors:
    """Lets the user pick faces and give them factors.

    Parameters
    ----------
    form : QWidget
        The panel.
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
        form: Any,
        source: Any,
        names: Mapping[str, str],
        changed: Callable[[], None],
        opened: Callable[[], None],
    ) -> None:
        self._form = form
        self._source = source
        self._document = source.Document.Name
        self._names = dict(names)
        self._in_source = {own: name for name, own in self._names.items()}
        self._changed = changed
        self._opened = opened
        self._marking = False
        table = form.faces
        table.setColumnCount(len(COLUMNS))
        table.setHorizontalHeaderLabels(COLUMNS)
        table.verticalHeader().hide()
        table.verticalHeader().setDefaultSectionSize(24)
        table.horizontalHeader().setStretchLastSection(True)
        table.horizontalHeader().setHighlightSections(False)
        table.itemSelectionChanged.connect(self._mark_faces)
        form.facesToggle.toggled.connect(self._open)
        form.addFaces.clicked.connect(self._add_selected)
        form.removeFaces.clicked.connect(self._remove)
        FreeCADGui.Selection.addObserver(self)
        self._title()
        self._open(False)

    def close(self) -> None:
        """Stop watching the selection."""
        FreeCADGui.Selection.removeObserver(self)

    @property
    def open(self) -> bool:
        """Whether the section is open."""
        return self._form.facesToggle.isChecked()

    @property
    def factors(self) -> dict[str, float]:
        """Factor of each face of the table, by its name in the solid."""
        table = self._form.faces
        return {
            table.item(row, 0).text(): table.cellWidget(row, 1).value()
            for row in range(table.rowCount())
        }

    def show(self, factors: Mapping[str, float]) -> None:
        """Show factors of faces."""
        self._form.faces.setRowCount(0)
        for face, factor in factors.items():
            self._add(face, factor)
        self._title()

    # The section.

    def _open(self, on: bool) -> None:
        arrow = QtCore.Qt.DownArrow if on else QtCore.Qt.RightArrow
        self._form.facesToggle.setArrowType(arrow)
        self._form.facesBox.setVisible(on)
        self._hint("")
        self._opened()

    def _title(self) -> None:
        count = self._form.faces.rowCount()
        text = "Faces with another thickness"
        self._form.facesToggle.setText(f"{text} ({count})" if count else text)

    def _hint(self, text: str) -> None:
        usual = (
            "Click a face in the 3D view, add it here, and give it a factor: "
            "2 is twice as thick there, 0.5 half as thick."
        )
        self._form.facesHint.setText(text or usual)

    # The table.

    def _add(self, face: str, factor: float) -> None:
        table = self._form.faces
        row = table.rowCount()
        table.setRowCount(row + 1)
        table.setItem(row, 0, QtGui.QTableWidgetItem(face))
        box = QtGui.QDoubleSpinBox()
        box.setRange(*RANGE)
        box.setDecimals(2)
        box.setSingleStep(0.25)
        box.setPrefix("× ")
        box.setFrame(False)
        box.setValue(factor)
        box.valueChanged.connect(lambda *_: self._changed())
        table.setCellWidget(row, 1, box)

    def _rows(self) -> list[int]:
        model = self._form.faces.selectionModel()
        return sorted({index.row() for index in model.selectedRows()})

    def _add_selected(self) -> None:
        faces = self._selected()
        if not faces:
            self._hint(SELECT_FIRST)
            return
        self._hint("")
        for face in faces:
            if face not in self.factors:
                self._add(face, FIRST)
        self._title()
        self._select_rows(faces)
        self._changed()

    def _remove(self) -> None:
        for row in reversed(self._rows()):
            self._form.faces.removeRow(row)
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
        self._form.removeFaces.setEnabled(bool(rows))
        if self._marking:
            return
        names = [self._form.faces.item(row, 0).text() for row in rows]
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
        table = self._form.faces
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
