# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A histogram of the scaled Jacobian, with the figures that count."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from PySide import QtCore, QtGui

from .colour_scale import ColourScale

BINS = 40
_MARGIN, _ABOVE, _BELOW = 4, 18, 18
_LEAST = 2
"""Height of a bar of one element, pixels: a single bad one must be seen."""


class Histogram(QtGui.QWidget):
    """Bars of values in [0, 1]; a click on a bar tells which values it stands for.

    Parameters
    ----------
    clicked : callable(low, high)
        The interval of the bar; negative values belong to the first one.
    """

    def __init__(self, clicked: Callable[[float, float], None]) -> None:
        super().__init__()
        self.setObjectName("histogram")
        self.setFixedHeight(104)
        self.setToolTip("Scaled Jacobian: 1 is a box, 0 is folded. Click a bar to see its elements")
        self._clicked = clicked
        self._values = np.zeros(0)
        self._counts = np.zeros(BINS, dtype=int)
        self._scale: ColourScale | None = None

    def show_values(self, values: np.ndarray, scale: ColourScale) -> None:
        """Take other values.

        Parameters
        ----------
        values : (n,) array
        scale : ColourScale
            Colours of the bars.
        """
        self._values = np.sort(values)
        self._scale = scale
        self._counts = np.bincount(self._bins(values), minlength=BINS)
        self.update()

    @staticmethod
    def _bins(values: np.ndarray) -> np.ndarray:
        return np.clip((values * BINS).astype(int), 0, BINS - 1)

    @property
    def counts(self) -> np.ndarray:
        """Elements in each bar, (BINS,)."""
        return self._counts

    @property
    def figures(self) -> str:
        """Number, least, 1 %, median as one line."""
        values = self._values
        if not len(values):
            return ""
        one = values[max(0, int(np.ceil(0.01 * len(values))) - 1)]
        return (
            f"Scaled Jacobian of {len(values)}: least {values[0]:.3f}, 1 % {one:.3f}, "
            f"median {np.median(values):.3f}"
        )

    def _plot(self) -> QtCore.QRectF:
        return QtCore.QRectF(
            *(_MARGIN, _ABOVE, self.width() - 2 * _MARGIN, self.height() - _ABOVE - _BELOW)
        )

    def paintEvent(self, event: Any) -> None:
        """Draw the bars, the axis and the figures."""
        painter = QtGui.QPainter(self)
        plot, ink = self._plot(), self.palette().color(QtGui.QPalette.WindowText)
        painter.setPen(ink)
        top = QtCore.QRectF(_MARGIN, 0, plot.width(), 17)
        painter.drawText(top, QtCore.Qt.AlignLeft | QtCore.Qt.AlignVCenter, self.figures)
        if self._scale is not None and len(self._values):
            self._draw_bars(painter, plot)
        painter.setPen(ink)
        painter.drawLine(plot.bottomLeft(), plot.bottomRight())
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            x = plot.left() + share * plot.width()
            painter.drawLine(QtCore.QPointF(x, plot.bottom()), QtCore.QPointF(x, plot.bottom() + 3))
            place = QtCore.QRectF(x - 20, plot.bottom() + 3, 40, 14)
            side = {0.0: QtCore.Qt.AlignLeft, 1.0: QtCore.Qt.AlignRight}.get(share)
            if side is not None:
                place.moveLeft(plot.left() if share == 0.0 else plot.right() - 40)
            painter.drawText(place, side or QtCore.Qt.AlignHCenter, f"{share:g}")
        painter.end()

    def _draw_bars(self, painter: Any, plot: QtCore.QRectF) -> None:
        width = plot.width() / BINS
        highest = max(1, self._counts.max())
        colours = self._scale.rgb((np.arange(BINS) + 0.5) / BINS)
        for number in np.flatnonzero(self._counts):
            height = max(_LEAST, plot.height() * self._counts[number] / highest)
            bar = QtCore.QRectF(
                plot.left() + number * width, plot.bottom() - height, width - 1, height
            )
            painter.fillRect(bar, QtGui.QColor.fromRgbF(*(0.9 * colours[number])))

    def mousePressEvent(self, event: Any) -> None:
        """Tell the interval of the bar below the mouse."""
        plot = self._plot()
        number = int(BINS * (event.pos().x() - plot.left()) / plot.width())
        if 0 <= number < BINS:
            low = -np.inf if number == 0 else number / BINS
            high = np.inf if number == BINS - 1 else (number + 1) / BINS
            self._clicked(low, high)
