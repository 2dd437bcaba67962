# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The part of the volume's panel that says how thick the shell should be, and its layers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from PySide import QtCore

KINDS = (
    ("Level w0", "Level w0", "0 is at the faces, 1 in the middle: thin where the body is thin."),
    ("Even", "Even thickness", "The same everywhere that the body is thick enough."),
    ("Mean", "Mean thickness", "One level w0 everywhere, so thick in the mean."),
    ("Minimum", "Smallest thickness", "One level w0 everywhere, nowhere thinner than that."),
    (
        "Share of radius",
        "Share of the local radius",
        "Of half the body's thickness at each place; 100 % would reach the middle.",
    ),
)
"""Choices of ``ThicknessKind``, as the list shows them, and what the line below says."""

SPACINGS = (
    ("Equal volume", "equal volume"),
    ("Equal height", "equal height"),
    ("Ratio", "growing by the factor"),
    ("First layer", "first layer of"),
)
"""Choices of ``Spacing``, as the list shows them."""

STEPS = 100
"""Of the slider."""


class Length:
    """A field for a length, in whatever unit the user types.

    FreeCAD's own widget reaches Python without its methods; its properties and signals do.

    Parameters
    ----------
    widget : Gui::QuantitySpinBox
    changed : callable()
    """

    def __init__(self, widget: Any, changed: Callable[[], None]) -> None:
        self.widget = widget
        QtCore.QObject.connect(widget, QtCore.SIGNAL("valueChanged(double)"), lambda *_: changed())

    @property
    def value(self) -> float:
        """Millimetres."""
        return float(self.widget.property("rawValue"))

    @value.setter
    def value(self, value: float) -> None:
        blocked = self.widget.blockSignals(True)
        self.widget.setProperty("rawValue", float(value))
        self.widget.blockSignals(blocked)

    def step(self, step: float) -> None:
        """Set what one click on an arrow adds, mm."""
        self.widget.setProperty("singleStep", step)


class ThicknessForm:
    """Kind and value of the thickness.

    Parameters
    ----------
    form : QWidget
        The panel.
    size : float
        A length that is thicker than any shell of the body, mm.
    changed : callable()
        The user changed something.
    """

    def __init__(self, form: Any, size: float, changed: Callable[[], None]) -> None:
        self._form = form
        self._changed = changed
        self._top = size
        self._length = Length(form.length, self._typed)
        self._length.step(_round(size / 20.0))
        form.kind.addItems([text for _, text, _ in KINDS])
        form.kind.currentIndexChanged.connect(self._choose)
        form.w0.valueChanged.connect(lambda *_: self._typed())
        form.share.valueChanged.connect(lambda *_: self._typed())
        form.w0Slider.valueChanged.connect(self._slide)
        self._choose()

    @property
    def kind(self) -> str:
        """The choice of ``ThicknessKind``."""
        return KINDS[self._form.kind.currentIndex()][0]

    @property
    def values(self) -> dict[str, Any]:
        """Properties of a hybrid volume, by name."""
        return {
            "ThicknessKind": self.kind,
            "W0": self._form.w0.value(),
            "Thickness": self._length.value,
            "Share": self._form.share.value(),
        }

    def show(self, values: Mapping[str, Any]) -> None:
        """Show properties of a hybrid volume."""
        form = self._form
        for widget, name in ((form.w0, "W0"), (form.share, "Share")):
            _set(widget, values[name])
        self._length.value = values["Thickness"]
        form.kind.setCurrentIndex([row[0] for row in KINDS].index(values["ThicknessKind"]))
        self._choose()

    def reach(self, length: float) -> None:
        """Let the slider end at a length, mm, which is the largest thickness there can be."""
        self._top = length
        self._place_slider()

    def _choose(self, *_: Any) -> None:
        form, kind = self._form, self.kind
        form.w0.setVisible(kind == "Level w0")
        form.share.setVisible(kind == "Share of radius")
        form.length.setVisible(kind in ("Even", "Mean", "Minimum"))
        form.meaning.setText(KINDS[form.kind.currentIndex()][2])
        self._place_slider()
        self._changed()

    def _typed(self) -> None:
        self._place_slider()
        self._changed()

    def _place_slider(self) -> None:
        form, kind = self._form, self.kind
        top = {"Level w0": 1.0, "Share of radius": 100.0}.get(kind, self._top)
        slider = form.w0Slider
        blocked = slider.blockSignals(True)
        low, high = {"Level w0": (1, 99), "Share of radius": (1, 95)}.get(kind, (1, STEPS))
        slider.setRange(low, high)
        slider.setValue(round(STEPS * self._value() / top))
        slider.blockSignals(blocked)

    def _value(self) -> float:
        form = self._form
        shown = {"Level w0": form.w0.value, "Share of radius": form.share.value}
        return shown.get(self.kind, lambda: self._length.value)()

    def _slide(self, step: int) -> None:
        form, kind = self._form, self.kind
        if kind == "Level w0":
            _set(form.w0, step / STEPS)
        elif kind == "Share of radius":
            _set(form.share, float(step))
        else:
            self._length.value = float(f"{self._top * step / STEPS:.3g}")
        self._changed()


class LayersForm:
    """Number, degree and spacing of the layers.

    Parameters
    ----------
    form : QWidget
        The panel.
    size : float
        A length that is thicker than any shell of the body, mm.
    """

    def __init__(self, form: Any, size: float) -> None:
        self._form = form
        self._first = Length(form.firstLayer, lambda: None)
        self._first.step(_round(size / 100.0))
        form.spacing.addItems([text for _, text in SPACINGS])
        form.spacing.currentIndexChanged.connect(self._choose)
        self._choose()

    @property
    def values(self) -> dict[str, Any]:
        """Properties of a hybrid volume, by name."""
        form = self._form
        return {
            "Layers": form.layers.value(),
            "Degree": form.degree.value(),
            "Spacing": SPACINGS[form.spacing.currentIndex()][0],
            "LayerRatio": form.layerRatio.value(),
            "FirstLayer": self._first.value,
        }

    def show(self, values: Mapping[str, Any]) -> None:
        """Show properties of a hybrid volume."""
        form = self._form
        form.layers.setValue(values["Layers"])
        # a document may ask for more than the panel offers
        form.degree.setMaximum(max(form.degree.maximum(), values["Degree"]))
        form.degree.setValue(values["Degree"])
        form.layerRatio.setValue(values["LayerRatio"])
        self._first.value = values["FirstLayer"]
        form.spacing.setCurrentIndex([row[0] for row in SPACINGS].index(values["Spacing"]))

    def _choose(self, *_: Any) -> None:
        kind = SPACINGS[self._form.spacing.currentIndex()][0]
        self._form.layerRatio.setVisible(kind == "Ratio")
        self._form.firstLayer.setVisible(kind == "First layer")


def _set(widget: Any, value: float) -> None:
    blocked = widget.blockSignals(True)
    widget.setValue(value)
    widget.blockSignals(blocked)


def _round(value: float) -> float:
    return float(f"{value:.1g}")
