# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A table of figures that is sorted by a click on a column and tells which rows are selected."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

from PySide import QtCore, QtGui


class _Cell(QtGui.QTableWidgetItem):
    """A cell that is sorted by its figure, or by the number in its name."""

    def __init__(self, row: int, text: str, value: float | None) -> None:
        super().__init__(text)
        self.row_key = row
        if value is None:
            number = re.search(r"\d+$", text)
            value = float(number.group()) if number else 0.0
        else:
            self.setTextAlignment(QtCore.Qt.AlignRight | QtCore.Qt.AlignVCenter)
        self.value = value
        self.setFlags(QtCore.Qt.ItemIsSelectable | QtCore.Qt.ItemIsEnabled)

    def __lt__(self, other: Any) -> bool:
        return self.value < other.value


class FigureTable:
    """Rows of names and figures in a QTableWidget.

    Parameters
    ----------
    widget : QTableWidget
    columns : sequence of (title, explanation)
    selected : callable(list of int)
        Told the keys of the selected rows, whenever the user changes them.
    """

    def __init__(
        self,
        widget: Any,
        columns: Sequence[tuple[str, str]],
        selected: Callable[[list[int]], None],
    ) -> None:
        self._widget = widget
        self._selected = selected
        self._silent = False
        font = widget.font()
        font.setPointSizeF(0.9 * font.pointSizeF())
        for part in (widget, widget.horizontalHeader()):
            part.setFont(font)
        widget.setColumnCount(len(columns))
        for number, (title, explanation) in enumerate(columns):
            head = QtGui.QTableWidgetItem(title)
            head.setToolTip(explanation)
            widget.setHorizontalHeaderItem(number, head)
        widget.setSelectionBehavior(QtGui.QAbstractItemView.SelectRows)
        widget.setEditTriggers(QtGui.QAbstractItemView.NoEditTriggers)
        widget.verticalHeader().hide()
        widget.verticalHeader().setDefaultSectionSize(20)
        widget.setAlternatingRowColors(True)
        widget.horizontalHeader().setMinimumSectionSize(24)
        widget.itemSelectionChanged.connect(self._tell)

    def show(self, rows: Sequence[Sequence[tuple]]) -> None:
        """Take other rows.

        Parameters
        ----------
        rows : sequence of sequences of (text, figure) or (text, figure, picture)
            The figure is what the cell is sorted by; None for a name. Keys are the places here.
        """
        table = self._widget
        self._silent = True
        try:
            table.setSortingEnabled(False)
            table.clearSelection()
            table.setRowCount(len(rows))
            for row, cells in enumerate(rows):
                for column, (text, value, *picture) in enumerate(cells):
                    cell = _Cell(row, text, value)
                    if picture:
                        cell.setIcon(picture[0])
                        cell.setTextAlignment(QtCore.Qt.AlignLeft | QtCore.Qt.AlignVCenter)
                    table.setItem(row, column, cell)
            table.setSortingEnabled(True)
            table.resizeColumnsToContents()
        finally:
            self._silent = False

    def sort(self, column: int) -> None:
        """Sort by a column, the smallest first."""
        self._widget.sortItems(column, QtCore.Qt.AscendingOrder)

    def select(self, keys: Sequence[int]) -> None:
        """Select just these rows, without telling anybody."""
        self._silent = True
        try:
            model = self._widget.selectionModel()
            model.clearSelection()
            for key in keys:
                place = self._place(key)
                model.select(
                    self._widget.model().index(place, 0),
                    QtCore.QItemSelectionModel.Select | QtCore.QItemSelectionModel.Rows,
                )
                self._widget.scrollToItem(self._widget.item(place, 0))
        finally:
            self._silent = False

    def clear_selection(self) -> None:
        """Select nothing, without telling anybody."""
        self._silent = True
        self._widget.clearSelection()
        self._silent = False

    @property
    def selection(self) -> list[int]:
        """Keys of the selected rows."""
        rows = self._widget.selectionModel().selectedRows()
        return sorted(self._widget.item(index.row(), 0).row_key for index in rows)

    def _place(self, key: int) -> int:
        """Where a row is now."""
        table = self._widget
        return next(k for k in range(table.rowCount()) if table.item(k, 0).row_key == key)

    def _tell(self) -> None:
        if not self._silent:
            self._selected(self.selection)
