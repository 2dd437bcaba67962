# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The table of sheets in the midstructure's panel."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from PySide import QtCore, QtGui

from .sheets_view import sheet_colour, sheet_name

if TYPE_CHECKING:
    from HybridVolume.core.midstructure import Midstructure, Sheet

COLUMNS = ("Sheet", "Area", "Distance", "Between", "Why")
NAME, AREA, RADIUS, FACES, WHY = range(5)
WIDTHS = (104, 48, 88, 86)

_NUMBER = QtCore.Qt.UserRole
_SORTED_BY = QtCore.Qt.UserRole + 1


class _Cell(QtGui.QTableWidgetItem):
    """A cell that is sorted by a figure instead of its text."""

    def __lt__(self, other: Any) -> bool:
        mine, others = self.data(_SORTED_BY), other.data(_SORTED_BY)
        if mine is None or others is None:
            return self.text() < other.text()
        return mine < others


class SheetTable:
    """Fills a table widget with sheets and tells what the user does with it.

    Parameters
    ----------
    widget : QTableWidget
    toggled : callable(number, kept)
        The check box of a sheet was clicked.
    selected : callable(numbers)
        Other rows are selected.
    """

    def __init__(
        self,
        widget: Any,
        toggled: Callable[[int, bool], None],
        selected: Callable[[list[int]], None],
    ) -> None:
        self._widget = widget
        self._toggled = toggled
        self._selected = selected
        self._names: tuple[tuple[str, ...], ...] = ()
        widget.setColumnCount(len(COLUMNS))
        widget.setHorizontalHeaderLabels(COLUMNS)
        widget.verticalHeader().hide()
        widget.verticalHeader().setDefaultSectionSize(21)
        widget.horizontalHeader().setStretchLastSection(True)
        widget.horizontalHeader().setHighlightSections(False)
        for column, width in enumerate(WIDTHS):
            widget.setColumnWidth(column, width)
        for column, text in enumerate(
            (
                "Checked sheets are kept: the shell grows towards them.",
                "Area of the whole sheet, mm².",
                "Distance of the sheet to the faces, mm: half the thickness of the body there.",
                "The two faces that the sheet lies between.",
                "Why the sheet is kept or removed.",
            )
        ):
            widget.horizontalHeaderItem(column).setToolTip(text)
        widget.setSortingEnabled(True)
        widget.sortByColumn(AREA, QtCore.Qt.DescendingOrder)
        widget.itemChanged.connect(self._changed)
        widget.itemSelectionChanged.connect(self._tell_selection)

    def show(self, midstructure: Midstructure | None) -> None:
        """Show the sheets of a midstructure; the selection stays."""
        sheets = midstructure.sheets if midstructure is not None else ()
        blocked = self._widget.blockSignals(True)
        try:
            self._widget.setSortingEnabled(False)
            self._widget.setRowCount(len(sheets))
            rows = self._rows()
            for number, sheet in enumerate(sheets):
                self._fill(rows.get(number, number), number, sheet)
            self._widget.setSortingEnabled(True)
        finally:
            self._widget.blockSignals(blocked)

    def select(self, numbers: Iterable[int]) -> None:
        """Select just these sheets, without telling so."""
        wanted = set(numbers)
        blocked = self._widget.blockSignals(True)
        try:
            model = self._widget.selectionModel()
            model.clearSelection()
            rows = self._rows()
            for number in sorted(wanted & rows.keys()):
                model.select(
                    self._widget.model().index(rows[number], 0),
                    QtCore.QItemSelectionModel.Select | QtCore.QItemSelectionModel.Rows,
                )
            last = [rows[number] for number in sorted(wanted & rows.keys())]
            if last:
                self._widget.scrollToItem(self._widget.item(last[-1], NAME))
        finally:
            self._widget.blockSignals(blocked)
            self._widget.viewport().update()

    def selection(self) -> list[int]:
        """Numbers of the selected sheets."""
        rows = {index.row() for index in self._widget.selectionModel().selectedRows()}
        return sorted(self._number(row) for row in rows)

    def _number(self, row: int) -> int:
        return self._widget.item(row, NAME).data(_NUMBER)

    def _rows(self) -> dict[int, int]:
        """Row of each sheet that has one."""
        rows = range(self._widget.rowCount())
        return {self._number(row): row for row in rows if self._widget.item(row, NAME)}

    def _fill(self, row: int, number: int, sheet: Sheet) -> None:
        low, high = sheet.radius
        least, most = f"{low:.2g}", f"{high:.2g}"
        radius = most if least == most else f"{least} - {most}"
        faces = pair_text(sheet.faces)
        cells = (
            (sheet_name(number), number),
            (f"{sheet.area:.3g}" if sheet.area > 0.0 else "", sheet.area),
            (radius, high),
            (faces, None),
            (sheet.reason, None),
        )
        for column, (text, figure) in enumerate(cells):
            item = self._widget.item(row, column)
            if item is None:
                item = _Cell()
                self._widget.setItem(row, column, item)
            if item.text() != text:
                item.setText(text)
                item.setToolTip(text)
            item.setData(_SORTED_BY, figure)
            grey = self._widget.palette().color(QtGui.QPalette.Disabled, QtGui.QPalette.Text)
            item.setForeground(QtGui.QBrush() if sheet.kept else QtGui.QBrush(grey))
        first = self._widget.item(row, NAME)
        first.setData(_NUMBER, number)
        first.setCheckState(QtCore.Qt.Checked if sheet.kept else QtCore.Qt.Unchecked)
        first.setIcon(_swatch(sheet_colour(number)) if sheet.kept else _swatch(None))
        for column in (AREA, RADIUS):
            self._widget.item(row, column).setTextAlignment(
                QtCore.Qt.AlignRight | QtCore.Qt.AlignVCenter
            )

    def _changed(self, item: Any) -> None:
        if item.column() == NAME:
            self._toggled(item.data(_NUMBER), item.checkState() == QtCore.Qt.Checked)

    def _tell_selection(self) -> None:
        self._selected(self.selection())


def pair_text(faces: tuple[str, str]) -> str:
    """Two faces in few letters: ``Face3 + 9``."""
    one, two = faces
    if one == two:
        return one
    return f"{one} + {two.removeprefix('Face') if one.startswith('Face') else two}"


def _swatch(colour: tuple[float, float, float] | None) -> Any:
    picture = QtGui.QPixmap(12, 12)
    picture.fill(QtGui.QColor.fromRgbF(*colour) if colour else QtCore.Qt.transparent)
    if colour is None:
        painter = QtGui.QPainter(picture)
        painter.setPen(QtGui.QColor(128, 128, 128))
        painter.drawRect(0, 0, 11, 11)
        painter.end()
    return QtGui.QIcon(picture)
