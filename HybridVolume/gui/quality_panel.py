# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The panel of a result's quality: figures beside the elements that they belong to."""

from __future__ import annotations

import time
from typing import Any

import FreeCAD
import FreeCADGui
import numpy as np
from PySide import QtCore

from HybridVolume.errors import HybridVolumeError
from HybridVolume.objects.inner import stored_volume
from HybridVolume.objects.volume import CHILDREN

from . import colour_scale
from .clip import ClipControls, plane_across
from .figure_table import FigureTable
from .histogram import Histogram
from .panel import Panel
from .picking import Clicks
from .result_view import COLOURINGS, Result, ResultScene
from .stage import Added, Hidden
from .work import is_deleted

OTHERS, LEAST_TABLE, MOST_TABLE = 622, 150, 520
"""Pixels: height of what is above, beside and below the tables, and of the tables."""

CLICK = "Click an element in the 3D view to read its figures."

FACE_COLUMNS = (
    ("Face", "CAD face"),
    ("El.", "Elements of the shell under the face"),
    ("J", "Smallest scaled Jacobian under the face"),
    ("w0", "Level that the inner boundary reaches, in the mean"),
    ("share", "What was reached of what was asked, in the mean"),
    ("mm min", "Smallest distance of the inner boundary from the body's surface, mm"),
    ("mean", "Mean distance, mm"),
    ("max", "Largest distance, mm"),
)
LAYER_COLUMNS = (
    ("Layer", "1 is at the faces"),
    ("El.", "Elements of the layer"),
    ("J", "Smallest scaled Jacobian in the layer"),
    ("1 %", "Scaled Jacobian that 1 % of the elements do not exceed"),
    ("median", "Median of the scaled Jacobian"),
    ("mm min", "Smallest height of the layer along its columns, mm"),
    ("mean", "Mean height, mm"),
    ("max", "Largest height, mm"),
)
WORST_COLUMNS = (
    ("No.", "As in the 3D view"),
    ("Element", "Number of the element in the shell"),
    ("Face", "CAD face above it"),
    ("Layer", "1 is at the faces"),
    ("J", "Scaled Jacobian"),
    ("Proved bound", "det J is nowhere below it, in units of the element's mean edges"),
)


class QualityPanel(Panel):
    """Shows a stored result: its histogram, its figures by face, by layer and by element.

    Parameters
    ----------
    volume : App.DocumentObject
        A hybrid volume with a result.
    inner : bool
        Begin with the inner boundary alone, coloured by what was reached.

    Attributes
    ----------
    form : QWidget
        Its property ``cutSeconds`` tells what the last step of the clip slider took, with the view.

    Raises
    ------
    HybridVolumeError
        There is no result, or its file is damaged.
    """

    WIDTH = 490

    def __init__(self, volume: Any, *, inner: bool = False) -> None:
        self._result = Result(stored_volume(volume))
        super().__init__("quality_panel", "HybridVolume_Quality")
        self._volume = volume
        self._document, self._name = volume.Document.Name, volume.Name
        self._hidden, self._added = Hidden(), None
        self._faces = FigureTable(self.form.faces, FACE_COLUMNS, self._select_faces)
        self._layers = FigureTable(self.form.layers, LAYER_COLUMNS, self._select_layers)
        self._worst = FigureTable(self.form.worstTable, WORST_COLUMNS, self._select_worst)
        self._histogram = Histogram(self._select_interval)
        self.form.histogramLayout.addWidget(self._histogram)
        self._numbers = np.zeros(0, dtype=int)
        self._fill_form(inner)
        self._show_result()
        self._clip = ClipControls(self.form, self._looking, self._cut)
        self._clicks = Clicks(self._document, self._tell_element)
        FreeCAD.addDocumentObserver(self)
        self._opened()

    # Opening and closing.

    @property
    def scene(self) -> ResultScene:
        """What is drawn."""
        return self._scene

    def _fill_form(self, inner: bool) -> None:
        form = self.form
        names = self._result.colourings
        for name in names:
            form.colouring.addItem(COLOURINGS[name], name)
        if inner:
            form.shell.setChecked(False)
            form.core.setChecked(False)
            form.inner.setChecked(True)
            form.colouring.setCurrentIndex(names.index("share" if "share" in names else "quality"))
        for widget in (form.shell, form.inner, form.core):
            widget.toggled.connect(lambda *_: self._refresh())
        for widget in (form.firstLayer, form.lastLayer):
            widget.valueChanged.connect(lambda *_: self._refresh())
        form.colouring.currentIndexChanged.connect(lambda *_: self._refresh())
        form.worst.toggled.connect(lambda *_: self._show_worst())
        form.worstCount.valueChanged.connect(lambda *_: self._count_worst())
        form.whole.clicked.connect(self._show_all)
        # FreeCAD gives a panel the height that it asks for: all of it shall be seen at once
        room = FreeCADGui.getMainWindow().height() - OTHERS
        form.tabs.setFixedHeight(max(LEAST_TABLE, min(room, MOST_TABLE)))

    def _show_result(self) -> None:
        """Draw the result and fill the tables."""
        result, form = self._result, self.form
        self._scene = ResultScene(result)
        self._put_on_stage()
        count = result.cells.layers
        for widget, value in ((form.firstLayer, 1), (form.lastLayer, count)):
            widget.blockSignals(True)
            widget.setMaximum(count)
            widget.setValue(value)
            widget.blockSignals(False)
        self._refresh()
        quality = result.quality
        proved = int(quality.proved.sum())
        text = f"Certified: {proved} of {len(quality)} elements proved"
        singular = result.volume.certificate.valid_inside
        if singular:
            text += f", {singular} of them but for singular corners of the body"
        form.certified.setText(text)
        form.certified.setStyleSheet(
            f"font-weight: bold; color: {'#2b8a3e' if proved == len(quality) else '#c92a2a'};"
        )
        form.element.setText(CLICK)
        self._histogram.show_values(quality.scaled_jacobian, colour_scale.quality_scale())
        self._fill_layers()
        self._fill_faces(())
        self._count_worst()
        # Later: the view is there first, distances from the surface take longer.
        QtCore.QTimer.singleShot(0, self._fill_thickness)

    def _put_on_stage(self) -> None:
        volume = self._volume
        names = ("Source", *CHILDREN, "AnalysisBody")
        for part in (getattr(volume, name, None) for name in names):
            if part is not None and part.ViewObject is not None:
                self._hidden.hide(part)
        self._added = Added(self._document, self._scene.root)

    def _leave_stage(self) -> None:
        if self._added is not None:
            self._added.close()
        self._hidden.close()

    def _put_back(self) -> None:
        FreeCAD.removeDocumentObserver(self)
        self._clicks.close()
        self._leave_stage()

    # What documents tell an observer.

    def slotChangedObject(self, obj: Any, name: str) -> None:
        """Show another result as soon as there is one."""
        if name == "Result" and obj.Name == self._name and obj.Document.Name == self._document:
            QtCore.QTimer.singleShot(0, self._reload)

    def slotDeletedObject(self, obj: Any) -> None:
        """Close with the volume."""
        if obj.Name == self._name and obj.Document.Name == self._document:
            QtCore.QTimer.singleShot(0, self._close_if_gone)

    def slotDeletedDocument(self, doc: Any) -> None:
        """Close with the document."""
        if doc.Name == self._document:
            self._close()

    def _close_if_gone(self) -> None:
        if not self._closed and is_deleted(self._volume):
            self._close()

    def _reload(self) -> None:
        if self._closed or is_deleted(self._volume):
            return
        try:
            self._result = Result(stored_volume(self._volume))
        except HybridVolumeError:
            self._close()
            return
        self._leave_stage()
        self._show_result()
        self._clip.show()

    # Tables.

    def _fill_faces(self, reached: Any) -> None:
        quality = self._result.quality
        counts = np.bincount(quality.face, minlength=len(quality.faces))
        least = quality.least_by_face()
        figures = {row["face"]: row for row in reached}
        rows = []
        for number, face in enumerate(quality.faces):
            cells = [
                *((face, None), (str(counts[number]), counts[number])),
                (f"{least[number]:.3f}", least[number]),
            ]
            row = figures.get(face)
            if row is None:
                cells += [("...", 0.0)] * 5
            else:
                level, depth = row["w0"]["mean"], row["thickness"]
                share = row.get("share", level / max(row["w0_asked"], np.finfo(float).tiny))
                cells += [(f"{level:.3f}", level), (f"{100.0 * share:.0f} %", share)]
                cells += [(f"{depth[name]:.3g}", depth[name]) for name in ("min", "mean", "max")]
            rows.append(cells)
        self._faces.show(rows)
        self._faces.sort(2)

    def _fill_layers(self) -> None:
        quality, cells = self._result.quality, self._result.cells
        least, rows = quality.least_by_layer(), []
        for layer in range(cells.layers):
            mine = cells.of_layers(layer, layer)
            values = np.sort(quality.scaled_jacobian[mine])
            points = cells.points[mine]
            height = np.linalg.norm(points[..., -1, :] - points[..., 0, :], axis=-1)
            figures = (least[layer], values[int(np.ceil(0.01 * len(values))) - 1])
            figures += (float(np.median(values)),)
            rows.append(
                [
                    *((f"{layer + 1}", None), (f"{len(mine)}", len(mine))),
                    *((f"{x:.3f}", x) for x in figures),
                    *((f"{x:.3g}", x) for x in (height.min(), height.mean(), height.max())),
                ]
            )
        self._layers.show(rows)
        self._layers.sort(0)

    def _fill_thickness(self) -> None:
        if self._closed:
            return
        rows = self._result.by_face
        self._fill_faces(rows)
        inner = self._result.inner
        area = inner.area / inner.area.sum()
        level, depth = float(inner.level @ area), inner.thickness
        asked = float(inner.goal @ area)
        self.form.reached.setText(
            f"w0 {level:.3f} of {asked:.3f} asked; {depth.min():.3g} to {depth.max():.3g} mm "
            f"thick, mean {float(depth @ area):.3g}"
        )

    def _count_worst(self) -> None:
        quality = self._result.quality
        self._numbers = quality.worst(self.form.worstCount.value())
        rows = []
        for place, element in enumerate(self._numbers):
            value, bound = quality.scaled_jacobian[element], quality.bound[element]
            rows.append(
                [
                    *((f"{place + 1}", None), (f"{element}", element)),
                    *((quality.faces[quality.face[element]], None),),
                    *((f"{quality.layer[element] + 1}", quality.layer[element]),),
                    *((f"{value:.4f}", value), (f"{bound:.3g}", bound)),
                ]
            )
        self._worst.show(rows)
        self._worst.sort(0)
        if self.form.worst.isChecked():
            self._show_worst()

    # The view.

    def _refresh(self) -> None:
        form, scene = self.form, self._scene
        first, last = form.firstLayer.value(), form.lastLayer.value()
        if last < first:
            # whichever was moved takes the other along
            other = form.lastLayer if form.firstLayer.hasFocus() else form.firstLayer
            other.setValue(first if other is form.lastLayer else last)
            return
        for widget in (form.firstLayer, form.lastLayer, form.toLabel):
            widget.setEnabled(form.shell.isChecked())
        scene.layers = (first - 1, last - 1) if form.shell.isChecked() else None
        scene.core, scene.inner = form.core.isChecked(), form.inner.isChecked()
        scene.colouring = form.colouring.currentData() or "quality"
        scene.refresh()

    def _looking(self) -> tuple[float, float, float]:
        view = FreeCADGui.getDocument(self._document).activeView()
        return tuple(view.getViewDirection())

    def _cut(self, direction: tuple[float, float, float] | None, share: float) -> None:
        began = time.perf_counter()
        if direction is None:
            self._scene.clip(None)
        else:
            self._scene.clip(*plane_across(*self._scene.box, direction, share))
        FreeCADGui.updateGui()
        self.form.setProperty("cutSeconds", time.perf_counter() - began)

    def _select_faces(self, rows: list[int]) -> None:
        self._leave_worst()
        self._layers.clear_selection()
        quality = self._result.quality
        self._mark(np.flatnonzero(np.isin(quality.face, rows)))
        self.form.element.setText(self._face_text(quality.faces[rows[0]]) if rows else CLICK)

    def _face_text(self, face: str) -> str:
        """What was reached at a face, and why it is less than what was asked."""
        row = next(row for row in self._result.by_face if row["face"] == face)
        level, reason = row["w0"], row.get("reason", "")
        text = f"{face}: w0 {level['min']:.3f} to {level['max']:.3f} of {row['w0_asked']:.3f} asked"
        return f"{text}; {reason}" if reason else text

    def _select_layers(self, rows: list[int]) -> None:
        self._leave_worst()
        self._faces.clear_selection()
        self._mark(np.flatnonzero(np.isin(self._result.quality.layer, rows)))

    def _select_interval(self, low: float, high: float) -> None:
        """Show the elements of one bar of the histogram."""
        self._leave_worst()
        self._clear_tables()
        value = self._result.quality.scaled_jacobian
        self._mark(np.flatnonzero((value >= low) & (value < high)))

    def _select_worst(self, rows: list[int]) -> None:
        if not self.form.worst.isChecked():
            self.form.worst.setChecked(True)  # comes back through _show_worst
            return
        self._show_worst()

    def _show_worst(self) -> None:
        form = self.form
        if not form.worst.isChecked():
            self._worst.clear_selection()
            self._mark(np.zeros(0, dtype=int))
            return
        self._faces.clear_selection()
        self._layers.clear_selection()
        form.tabs.setCurrentWidget(form.worstTab)
        places = self._worst.selection or range(len(self._numbers))
        labels = {int(self._numbers[place]): f"{place + 1}" for place in places}
        self._scene.mark(np.array(list(labels)), red=True, labels=labels)

    def _tell_element(self, view: Any, place: tuple[int, int]) -> None:
        """Tell the figures of the element that was clicked in the 3D view."""
        element = self._scene.element_at(view, place)
        if element is None:
            self.form.element.setText(CLICK)
            return
        quality, inner = self._result.quality, self._result.inner
        column = self._result.cells.vertex[element // self._result.cells.layers]
        depth = inner.thickness[column]
        self.form.element.setText(
            f"Element {element}, {quality.faces[quality.face[element]]}, layer "
            f"{quality.layer[element] + 1}: J {quality.scaled_jacobian[element]:.3f}, proved bound "
            f"{quality.bound[element]:.2g}; w0 {inner.level[column].mean():.3f}, shell "
            f"{depth.min():.3g} to {depth.max():.3g} mm"
        )

    def _mark(self, elements: np.ndarray) -> None:
        self._scene.mark(elements if len(elements) else None)

    def _leave_worst(self) -> None:
        self.form.worst.blockSignals(True)
        self.form.worst.setChecked(False)
        self.form.worst.blockSignals(False)
        self._worst.clear_selection()

    def _clear_tables(self) -> None:
        for table in (self._faces, self._layers, self._worst):
            table.clear_selection()

    def _show_all(self) -> None:
        self._leave_worst()
        self._clear_tables()
        self._scene.mark(None)
