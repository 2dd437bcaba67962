# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The part of a panel that says how fine the finite element mesh should be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from HybridVolume.objects import density

from . import face_table
from .face_table import FaceTable, Widgets
from .forms import load_form
from .thickness_form import Length

ORDERS = (("Second", "second order"), ("First", "first order"))
"""Choices of ``Order``, as the list shows them."""

SIZED = ("as the shell's", "at most")
NODES = (("knots", "from the knots"), ("greville", "Greville abscissae"))
"""Choices of ``Density``, as the list shows them."""

ORDER = "Order"


class DensityForm:
    """Order, edge lengths and layers of a finite element mesh.

    Parameters
    ----------
    place : QLayout
        Where the form goes.
    source : App.DocumentObject
        The body.
    names : mapping of str to str
        For every face of the source, by its name in the selection, its name in the solid.
    size : float
        A length such as the body's parts have, mm.
    changed : callable()
        The user changed something.
    opened : callable()
        The section of faces was opened or closed.

    Attributes
    ----------
    widget : QWidget
    """

    def __init__(
        self,
        place: Any,
        source: Any,
        names: Mapping[str, str],
        size: float,
        changed: Callable[[], None] = lambda: None,
        opened: Callable[[], None] = lambda: None,
    ) -> None:
        form = self.widget = load_form("density_form")
        place.addWidget(form)
        self._changed = changed
        first = float(f"{0.2 * size:.1g}")
        self._size = Length(form.edgeLength, self._tell)
        self._size.step(float(f"{0.2 * first:.1g}"))
        self._size.value = first
        form.order.addItems([text for _, text in ORDERS])
        form.sized.addItems(SIZED)
        form.nodes.addItems([text for _, text in NODES])
        self._faces = FaceTable(
            Widgets(
                *(form.sizesToggle, form.sizesBox, form.sizesHint),
                *(form.sizes, form.addSizes, form.removeSizes),
            ),
            face_table.sizes(first),
            source,
            names,
            self._tell,
            opened,
        )
        for box in (form.order, form.sized, form.nodes):
            box.currentIndexChanged.connect(lambda *_: self._tell())
        for box in (form.subdivide, form.femLayers, form.growth, form.gradation):
            box.valueChanged.connect(lambda *_: self._tell())
        self._show_relevant()

    @property
    def faces(self) -> FaceTable:
        """The table of faces with an edge length of their own."""
        return self._faces

    @property
    def values(self) -> dict[str, Any]:
        """Values of `objects.density.DEFAULTS`, and of ``Order``, by name."""
        form = self.widget
        nodes = NODES[form.nodes.currentIndex()][0]
        return {
            ORDER: ORDERS[form.order.currentIndex()][0],
            "Density": nodes,
            "Subdivide": form.subdivide.value(),
            "Size": self._size.value if form.sized.currentIndex() and nodes == "knots" else 0.0,
            "FaceSizes": density.size_texts(self._faces.values) if nodes == "knots" else (),
            "Gradation": form.gradation.value(),
            "Layers": form.femLayers.value(),
            "Growth": form.growth.value(),
        }

    @property
    def summary(self) -> str:
        """The values in a few words."""
        values = self.values
        words = [dict(ORDERS)[values[ORDER]]]
        if values["Size"]:
            words.append(f"edges to {values['Size']:.3g} mm")
        if values["Subdivide"] > 1:
            words.append(f"in {values['Subdivide']} parts")
        if values["FaceSizes"]:
            count = len(values["FaceSizes"])
            words.append(f"{count} face{'s' if count > 1 else ''} apart")
        if values["Layers"]:
            words.append(f"{values['Layers']} layers")
        return ", ".join(words)

    def show(self, values: Mapping[str, Any]) -> None:
        """Show values, as :attr:`values` gives them.

        Raises
        ------
        InputError
            The size at a face cannot be read.
        """
        form = self.widget
        sizes = density.face_sizes(values["FaceSizes"])
        form.order.setCurrentIndex([name for name, _ in ORDERS].index(values[ORDER]))
        form.nodes.setCurrentIndex([name for name, _ in NODES].index(values["Density"]))
        form.subdivide.setValue(values["Subdivide"])
        form.sized.setCurrentIndex(1 if values["Size"] else 0)
        if values["Size"]:
            self._size.value = values["Size"]
        self._faces.show(sizes)
        form.gradation.setValue(values["Gradation"])
        form.femLayers.setValue(values["Layers"])
        form.growth.setValue(values["Growth"])
        self._show_relevant()

    def close(self) -> None:
        """Stop watching the selection."""
        self._faces.close()

    def _tell(self) -> None:
        self._show_relevant()
        self._changed()

    def _show_relevant(self) -> None:
        form = self.widget
        free = NODES[form.nodes.currentIndex()][0] == "knots"
        for widget in (form.sized, form.sizesToggle, form.sizesBox):
            widget.setEnabled(free)
        form.edgeLength.setVisible(form.sized.currentIndex() == 1)
        form.edgeLength.setEnabled(free)
        counts = density.relevant(self.values)
        for widget in (form.growth, form.growthCaption):
            widget.setEnabled("Growth" in counts)
        form.gradation.setEnabled("Gradation" in counts)
