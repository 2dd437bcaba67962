# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The part of the volume's panel that says how even the spans of the faces should be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PySide import QtCore

from .thickness_form import Length

LEAST_ASPECT = 2.0
"""Below this no aspect can be asked for but 0, which the field shows as "as needed"."""


class SpansForm:
    """Size, aspect and turn of spans, in a section that opens and closes.

    Parameters
    ----------
    form : QWidget
        The panel.
    size : float
        A length such as the body's parts have, mm.
    """

    def __init__(self, form: Any, size: float) -> None:
        self._form = form
        self._size = Length(form.spanSize, self._tell)
        self._size.step(float(f"{0.1 * size:.1g}"))
        self._aspect = form.spanAspect.value()
        form.spanAspect.valueChanged.connect(self._lift)
        form.spanTurn.valueChanged.connect(lambda *_: self._tell())
        form.spansToggle.toggled.connect(self._open)
        self._open(False)

    @property
    def values(self) -> dict[str, float]:
        """Values of `objects.spans.DEFAULTS`, by name."""
        form = self._form
        return {
            "SpanSize": self._size.value,
            "SpanAspect": form.spanAspect.value(),
            "SpanTurn": form.spanTurn.value(),
        }

    @property
    def summary(self) -> str:
        """The values in a few words."""
        values = self.values
        texts = {"SpanSize": "to {:.3g} mm", "SpanAspect": "aspect to {:.3g}"}
        texts |= {"SpanTurn": "turn to {:.3g}°"}
        words = [text.format(values[name]) for name, text in texts.items() if values[name]]
        return ", ".join(words) or "as the shell needs"

    def show(self, values: Mapping[str, float]) -> None:
        """Show values, as :attr:`values` gives them."""
        form = self._form
        self._size.value = values["SpanSize"]
        form.spanAspect.setValue(values["SpanAspect"])
        form.spanTurn.setValue(values["SpanTurn"])
        self._tell()

    def _open(self, on: bool) -> None:
        form = self._form
        form.spansToggle.setArrowType(QtCore.Qt.DownArrow if on else QtCore.Qt.RightArrow)
        form.spansBox.setVisible(on)
        self._tell()

    def _lift(self, value: float) -> None:
        """Leave out what lies between "as needed" and the least: a step up ends at the least."""
        if 0.0 < value < LEAST_ASPECT:
            down = value == self._aspect - self._form.spanAspect.singleStep()
            self._form.spanAspect.setValue(0.0 if down else LEAST_ASPECT)
            return
        self._aspect = value
        self._tell()

    def _tell(self) -> None:
        closed = not self._form.spansToggle.isChecked()
        self._form.spansToggle.setText(f"Spans: {self.summary}" if closed else "Spans")
