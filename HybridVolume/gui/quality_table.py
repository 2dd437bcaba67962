# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The table of a mesh's figures: a column for each group of elements, a row for each figure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from PySide import QtCore, QtGui

from HybridVolume.core.fem_quality import GroupQuality, MeshQuality

_Row = tuple[str, str, Callable[[GroupQuality], str]]

ROWS: tuple[_Row, ...] = (
    ("Elements", "Number of elements", lambda g: f"{g.elements}"),
    ("Kind", "", lambda g: g.kinds[0] if len(g.kinds) == 1 else ""),
    (
        "Scaled Jacobian, least",
        "1 is a regular element, 0 is folded",
        lambda g: f"{g.scaled_jacobian.min:.4f}",
    ),
    ("Scaled Jacobian, mean", "", lambda g: f"{g.scaled_jacobian.mean:.3f}"),
    (
        "Proved bound, least",
        "det J is nowhere below it, in units of the element's mean edges",
        lambda g: f"{g.min_bound:.2g}",
    ),
    (
        "Dihedral angle, smallest",
        "Between two faces of an element. A regular tet has 70.5°, a regular wedge 60° and 90°.",
        lambda g: f"{g.min_dihedral:.1f}°",
    ),
    ("Dihedral angle, largest", "", lambda g: f"{g.max_dihedral:.1f}°"),
    (
        "Aspect, mean",
        "Longest edge over smallest height; 1 is a regular element. Thin layers have large ones.",
        lambda g: f"{g.aspect.mean:.2f}",
    ),
    ("Aspect, worst", "", lambda g: f"{g.aspect.max:.3g}"),
    ("Edges, shortest, mm", "", lambda g: f"{g.edge.min:.3g}"),
    ("Edges, mean, mm", "", lambda g: f"{g.edge.mean:.3g}"),
    ("Edges, longest, mm", "", lambda g: f"{g.edge.max:.3g}"),
    ("Volume, smallest, mm³", "Of an element", lambda g: f"{g.volume.min:.2g}"),
    ("Volume, largest, mm³", "Of an element", lambda g: f"{g.volume.max:.2g}"),
    ("Volume together, mm³", "", lambda g: f"{g.total_volume:.6g}"),
)


class QualityTable:
    """Fills a QTableWidget.

    Parameters
    ----------
    widget : QTableWidget
    """

    def __init__(self, widget: Any) -> None:
        self._widget = widget
        font = widget.font()
        font.setPointSizeF(0.9 * font.pointSizeF())
        for part in (widget, widget.horizontalHeader(), widget.verticalHeader()):
            part.setFont(font)
        widget.setEditTriggers(QtGui.QAbstractItemView.NoEditTriggers)
        widget.setAlternatingRowColors(True)
        widget.setRowCount(len(ROWS))
        for number, (title, explanation, _) in enumerate(ROWS):
            head = QtGui.QTableWidgetItem(title)
            head.setToolTip(explanation or title)
            widget.setVerticalHeaderItem(number, head)
        widget.verticalHeader().setDefaultSectionSize(20)
        widget.horizontalHeader().setSectionResizeMode(QtGui.QHeaderView.Stretch)

    def show(self, quality: MeshQuality) -> None:
        """Take the figures of a mesh."""
        table = self._widget
        table.setColumnCount(len(quality.groups))
        table.setHorizontalHeaderLabels([group.name for group in quality.groups])
        for column, group in enumerate(quality.groups):
            for row, (_, explanation, text) in enumerate(ROWS):
                cell = QtGui.QTableWidgetItem(text(group))
                cell.setTextAlignment(QtCore.Qt.AlignRight | QtCore.Qt.AlignVCenter)
                cell.setToolTip(explanation)
                table.setItem(row, column, cell)
