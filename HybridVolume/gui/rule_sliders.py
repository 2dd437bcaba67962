# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Sliders with boxes for the smallest angle and the smallest size in the midstructure's panel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from PySide import QtCore

IDLE = 400
"""Milliseconds without a change after which a typed or wheeled value is taken."""


class RuleSliders:
    """Tells every change at once, and once when the user is done with it.

    Parameters
    ----------
    form : QWidget
        With ``angle`` and ``angleSlider``, ``sizeValue`` and ``sizeSlider``.
    moved : callable()
        The values changed, perhaps while a slider is held.
    taken : callable()
        A slider was released, or nothing was typed for a while.
    """

    def __init__(self, form: Any, moved: Callable[[], None], taken: Callable[[], None]) -> None:
        self._form = form
        self._moved = timer(form, 0, moved)
        self._taken = taken
        self._idle = timer(form, IDLE, self.finish)
        self._pending = False
        form.angleSlider.valueChanged.connect(self._slide_angle)
        form.sizeSlider.valueChanged.connect(self._slide_size)
        form.angle.valueChanged.connect(self._typed)
        form.sizeValue.valueChanged.connect(self._typed)
        form.angleSlider.sliderReleased.connect(self.finish)
        form.sizeSlider.sliderReleased.connect(self.finish)

    @property
    def values(self) -> tuple[float, float]:
        """Angle in degrees, and size."""
        return self._form.angle.value(), self._form.sizeValue.value()

    @property
    def held(self) -> bool:
        """Whether the mouse holds one of the sliders."""
        return self._form.angleSlider.isSliderDown() or self._form.sizeSlider.isSliderDown()

    def show(self, angle: float, size: float) -> None:
        """Set both without telling; what the user is changing just now stays."""
        if not self._pending:
            _set(self._form.angle, angle)
            _set(self._form.sizeValue, size)
            self._place_sliders()

    def changed_from(self, angle: float, size: float) -> dict[str, float]:
        """What differs from an angle and a size by more than the boxes show: their keywords."""
        found = {}
        for name, box, value in (
            ("angle", self._form.angle, angle),
            ("minimum_size", self._form.sizeValue, size),
        ):
            if abs(box.value() - value) > 0.51 * 10.0 ** -box.decimals():
                found[name] = box.value()
        return found

    def finish(self) -> None:
        """Tell now what would be told after a while."""
        self._idle.stop()
        if self._pending:
            self._pending = False
            self._taken()

    def _slide_angle(self, value: int) -> None:
        _set(self._form.angle, value)
        self._tell()

    def _slide_size(self, value: int) -> None:
        _set(self._form.sizeValue, size_of_slider(value))
        self._tell()

    def _typed(self, _: float) -> None:
        self._place_sliders()
        self._tell()

    def _tell(self) -> None:
        self._pending = True
        self._moved.start()
        if not self.held:
            self._idle.start()

    def _place_sliders(self) -> None:
        angle, size = self.values
        _set(self._form.angleSlider, round(angle))
        _set(self._form.sizeSlider, slider_of_size(size))


def size_of_slider(value: int) -> float:
    """Size for a place of the slider: small sizes, which matter most, have much of its length."""
    return (value / 100.0) ** 3


def slider_of_size(size: float) -> int:
    """Reverse :func:`size_of_slider`."""
    return round(100.0 * size ** (1.0 / 3.0))


def timer(parent: Any, milliseconds: int, action: Callable[[], None]) -> Any:
    """A timer that calls once, a while after its last start."""
    made = QtCore.QTimer(parent)
    made.setSingleShot(True)
    made.setInterval(milliseconds)
    made.timeout.connect(action)
    return made


def _set(widget: Any, value: float) -> None:
    blocked = widget.blockSignals(True)
    widget.setValue(value)
    widget.blockSignals(blocked)
