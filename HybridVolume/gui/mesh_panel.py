# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The panel of the finite element mesh: how fine it should be, how good it is, mesh it again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import FreeCAD
import FreeCADGui
import numpy as np
from PySide import QtCore, QtGui

import HybridVolume
from HybridVolume.core.fem_quality import MeshQuality, mesh_quality
from HybridVolume.core.mesh_cells import MeshCells
from HybridVolume.errors import HybridVolumeError, InputError
from HybridVolume.job import Job, worker_python
from HybridVolume.mesh_job import density_keywords
from HybridVolume.objects import density
from HybridVolume.objects.inner import stored_volume
from HybridVolume.objects.mesh_editor import MeshEditor
from HybridVolume.objects.volume import CHILDREN
from HybridVolume.sources import global_shape

from . import colour_scale, messages, preferences
from .clip import ClipControls, plane_across
from .density_form import ORDER, DensityForm
from .face_table import face_names
from .figure_table import FigureTable
from .histogram import Histogram
from .macro import document_text
from .mesh_view import GROUPS, MeshScene
from .picking import Clicks
from .quality_table import QualityTable
from .run_panel import RunPanel
from .stage import Added, Hidden
from .volume_macro import VolumeMacro
from .work import NO_ENVIRONMENT, environment_setup, is_deleted, waiting

OTHERS, LEAST_TABLE, LEAST_OPEN, MOST_TABLE = 620, 230, 350, 420
"""Pixels: height of what is above, beside and below the pages, and of the pages, also with the
table of faces open."""

CLICK = "Click an element in the 3D view to read its figures."

WORST_COLUMNS = (
    ("No.", "As in the 3D view"),
    ("Element", "Number of the element in the mesh object and in the solver's input"),
    ("Group", "Shell or core"),
    ("Face", "CAD face above it"),
    ("Layer", "1 is at the faces"),
    ("J", "Scaled Jacobian: 1 is a regular element, 0 is folded"),
)
REPAIRS = {
    "straightened": "mid nodes straightened",
    "untangled": "nodes moved",
    "flipped": "diagonals flipped",
    "refined": "cells cut finer",
    "withdrawn": "columns shortened",
}
"""What the repairs of a mesh are called."""


class MeshPanel(RunPanel):
    """Shows the mesh of a hybrid volume, its figures, and makes another one of the same shell.

    Parameters
    ----------
    volume : App.DocumentObject
        A hybrid volume with a result.

    Raises
    ------
    HybridVolumeError
        There is no result, or its file is damaged.
    """

    WIDTH = 440

    def __init__(self, volume: Any) -> None:
        self._editor = MeshEditor(volume)
        self._fem = stored_volume(volume).fem
        super().__init__("mesh_panel", "HybridVolume_FemMesh", self._ready)
        self._volume, self._source = volume, volume.Source
        self._document, self._name = volume.Document.Name, volume.Name
        self._hidden, self._added = Hidden(), None
        self._scene: MeshScene | None = None
        self._groups = QualityTable(self.form.groups)
        self._worst = FigureTable(self.form.worstTable, WORST_COLUMNS, self._select_worst)
        self._histogram = Histogram(self._select_interval)
        self.form.histogramLayout.addWidget(self._histogram)
        names = face_names(self._source, volume.Solid) if self._source else {}
        self._density = DensityForm(
            *(self.form.densityLayout, self._source, names, _size(self._source)),
            opened=self._set_stage,
        )
        self._fill_form()
        self._clip: ClipControls | None = None
        self._show_mesh()
        self._clip = ClipControls(self.form, self._looking, self._cut)
        self._clicks = Clicks(self._document, self._tell_element)
        FreeCAD.addDocumentObserver(self)
        self._opened()

    # What FreeCAD asks a panel.

    def getStandardButtons(self) -> Any:
        """Return the buttons beside the panel: OK keeps the values, for a later run."""
        return QtGui.QDialogButtonBox.Ok | QtGui.QDialogButtonBox.Cancel

    def accept(self) -> bool:
        """Keep the values and close."""
        if self.running:
            messages.tell("FEM mesh", "It is still being meshed. Wait, or press Cancel.")
            return False
        try:
            changed = {} if is_deleted(self._volume) else self._changed()
            if changed:
                VolumeMacro(self._volume).run("set", changed)
        except HybridVolumeError as error:
            messages.show_error(error, self._source)
            return False
        self._close()
        return True

    def reject(self) -> bool:
        """Close; what is running is cancelled, values without a run are forgotten."""
        self.cancel()
        self._close()
        return True

    @property
    def scene(self) -> MeshScene:
        """What is drawn."""
        return self._scene

    def _put_back(self) -> None:
        FreeCAD.removeDocumentObserver(self)
        self._density.close()
        self._clicks.close()
        self._leave_stage()

    # Meshing again.

    def run(self) -> None:
        """Mesh again; offer to make the environment if need be."""
        if self.running:
            return
        self.form.log.clear()
        try:
            if is_deleted(self._volume):
                raise InputError("the hybrid volume was deleted", remedy="close the panel")
            wanted, order = self._wanted()
            setup = environment_setup()
        except HybridVolumeError as error:
            self._fail(error, "")
            return
        if setup is False:
            self._idle(NO_ENVIRONMENT)
            return
        self._busy("Starting")
        chosen = preferences.load()
        self._runner.start(
            lambda: [
                self._editor.job(
                    *(wanted, order),
                    engine=chosen.engine,
                    python=worker_python(chosen.python),
                    free_only=chosen.free_only,
                )
            ],
            setup,
        )

    def cancel(self) -> None:
        """Stop; the document stays as it was."""
        if self.running:
            self._runner.cancel()
            self._write("cancelled; the document is as it was")
            self._idle("Cancelled")

    def _wanted(self) -> tuple[Any, int]:
        """Density and order that the form asks for."""
        values = self._density.values
        orders = {"First": 1, "Second": 2}
        return density.density_of(values), orders[values.pop(ORDER)]

    def _keywords(self) -> dict[str, Any]:
        wanted, order = self._wanted()
        return {"order": order, **density_keywords(wanted)}

    def _changed(self) -> dict[str, Any]:
        """Keywords for what differs from the mesh object's properties."""
        before, order = self._editor.wanted()
        old, new = {"order": order, **density_keywords(before)}, self._keywords()
        return {name: value for name, value in new.items() if old[name] != value}

    def _ready(self) -> bool:
        doc = FreeCAD.listDocuments().get(self._document)
        # A gone document is a failure to be told at once; an open transaction is waited for.
        return doc is None or not doc.HasPendingTransaction

    def _finish(self, jobs: Sequence[Job]) -> None:
        try:
            if is_deleted(self._volume):
                raise InputError("the hybrid volume was deleted while it was meshed")
            self._record(jobs[0])
        except HybridVolumeError as error:
            self._fail(error, "")
            return
        self.form.progress.setValue(self.form.progress.maximum())
        self._idle("Done")

    def _record(self, job: Job) -> None:
        """Put a mesh into the document as a line that a macro can repeat."""
        keywords = {name: value for name, value in self._keywords().items() if value != {}}
        given = ", ".join(f"{name}={value!r}" for name, value in keywords.items())
        volume = f"{document_text(self._volume.Document)}.getObject({self._name!r})"
        FreeCADGui.doCommand("import HybridVolume")
        # this once the worker has done already what the line asks for
        HybridVolume.remesh = lambda *_, **__: self._editor.insert(job)
        try:
            FreeCADGui.doCommand(f"HybridVolume.remesh({volume}, {given})")
        finally:
            del HybridVolume.remesh

    def _fail(self, error: HybridVolumeError, log: str) -> None:
        self._write_error(error, log)
        self._idle("Failed")
        messages.show_error(error, self._source, log)

    def _enable(self, *, running: bool) -> None:
        self.form.densityBox.setEnabled(not running)
        self.form.run.setEnabled(not running)
        self.form.cancel.setEnabled(running)

    # The form.

    def _fill_form(self) -> None:
        form, mesh = self.form, self._volume.FemMesh
        self._density.show({ORDER: mesh.Order, **density.values_of(mesh)})
        form.run.clicked.connect(self.run)
        form.cancel.clicked.connect(self.cancel)
        form.group.addItems(GROUPS)
        form.group.currentIndexChanged.connect(lambda *_: self._refresh())
        form.colour.toggled.connect(lambda *_: self._refresh())
        form.worst.toggled.connect(lambda *_: self._show_worst())
        form.worstCount.valueChanged.connect(lambda *_: self._count_worst())
        form.whole.clicked.connect(self._show_all)
        form.element.setText(CLICK)
        self._idle(mesh.Status)

    def _show_mesh(self) -> None:
        """Draw the mesh and fill the tables."""
        fem = self._fem
        self._leave_stage()
        with waiting():
            self._quality: MeshQuality = mesh_quality(fem)
            self._scene = MeshScene(MeshCells(fem), self._quality.scaled_jacobian)
        self._set_stage()
        repairs = [f"{n} {REPAIRS.get(what, what)}" for what, n in fem.repairs.items() if n]
        layers = int(fem.wedge_layer.max(initial=-1)) + 1
        self.form.counts.setText(
            f"{len(fem.nodes)} nodes; {len(fem.wedges)} wedges in {layers} layers, "
            f"{len(fem.tets)} tets, every one proved valid"
            + (f" ({', '.join(repairs)})" if repairs else "")
        )
        self._groups.show(self._quality)
        self._refresh()
        self._count_worst()

    def _leave_stage(self) -> None:
        if self._added is not None:
            self._added.close()
            self._added = None
        self._hidden.close()

    def _set_stage(self) -> None:
        """Show the mesh; or the body, whose faces can be picked, while their table is open."""
        if self._scene is None:  # the form is still being made
            return
        room = FreeCADGui.getMainWindow().height() - OTHERS
        least = LEAST_OPEN if self._density.faces.open else LEAST_TABLE
        self.form.tabs.setFixedHeight(max(least, min(room, MOST_TABLE)))
        self._leave_stage()
        for part in (getattr(self._volume, name) for name in (*CHILDREN, "AnalysisBody")):
            if part is not None and part.ViewObject is not None:
                self._hidden.hide(part)
        if self._density.faces.open:
            self._hidden.show(self._source)
            return
        if self._source is not None:
            self._hidden.hide(self._source)
        self._added = Added(self._document, self._scene.root)

    def _refresh(self) -> None:
        form, scene = self.form, self._scene
        scene.group, scene.coloured = form.group.currentText(), form.colour.isChecked()
        scene.refresh()
        self._leave_worst()
        scene.mark(np.zeros(0, dtype=int))
        values = self._quality.scaled_jacobian[scene.elements]
        self._histogram.show_values(values, colour_scale.quality_scale())

    def _select_interval(self, low: float, high: float) -> None:
        """Show the elements of one bar of the histogram."""
        self._leave_worst()
        elements = self._scene.elements
        value = self._quality.scaled_jacobian[elements]
        self._scene.mark(elements[(value >= low) & (value < high)])

    # The worst elements.

    def _count_worst(self) -> None:
        self._listed = self._quality.worst(self.form.worstCount.value())
        rows = []
        for place, one in enumerate(self._listed):
            layer = f"{one.layer + 1}" if one.layer >= 0 else ""
            rows.append(
                [
                    *((f"{place + 1}", None), (f"{self._number(one.number - 1)}", one.number)),
                    *((one.group, None), (one.face, None), (layer, one.layer)),
                    (f"{one.scaled_jacobian:.4f}", one.scaled_jacobian),
                ]
            )
        self._worst.show(rows)
        self._worst.sort(0)
        if self.form.worst.isChecked():
            self._show_worst()

    def _number(self, element: int) -> int:
        """Number in the mesh object: there the faces of the boundary come first."""
        return element + len(self._fem.boundary) + 1

    def _select_worst(self, rows: list[int]) -> None:
        if not self.form.worst.isChecked():
            self.form.worst.setChecked(True)  # comes back through _show_worst
            return
        self._show_worst()

    def _show_worst(self) -> None:
        form = self.form
        if not form.worst.isChecked():
            self._worst.clear_selection()
            self._scene.mark(np.zeros(0, dtype=int))
            return
        form.tabs.setCurrentWidget(form.worstTableTab)
        places = self._worst.selection or range(len(self._listed))
        labels = {self._listed[place].number - 1: f"{place + 1}" for place in places}
        self._scene.mark(np.array(list(labels)), labels)

    def _leave_worst(self) -> None:
        self.form.worst.blockSignals(True)
        self.form.worst.setChecked(False)
        self.form.worst.blockSignals(False)
        self._worst.clear_selection()

    def _show_all(self) -> None:
        self._leave_worst()
        self._scene.mark(np.zeros(0, dtype=int))

    # The view.

    def _looking(self) -> tuple[float, float, float]:
        view = FreeCADGui.getDocument(self._document).activeView()
        return tuple(view.getViewDirection())

    def _cut(self, direction: tuple[float, float, float] | None, share: float) -> None:
        if direction is None:
            self._scene.clip(None)
        else:
            self._scene.clip(*plane_across(*self._scene.box, direction, share))
        FreeCADGui.updateGui()

    def _tell_element(self, view: Any, place: tuple[int, int]) -> None:
        """Tell the figures of the element that was clicked in the 3D view."""
        element = None if self._density.faces.open else self._scene.element_at(view, place)
        if element is None:
            self.form.element.setText(CLICK)
            return
        quality = self._quality
        wedge = element < len(quality.shell)
        row, part = (
            (element, quality.shell) if wedge else (element - len(quality.shell), quality.core)
        )
        where = "core"
        if wedge:
            face = quality.face_names[quality.wedge_face[row]]
            where = f"{face}, layer {quality.wedge_layer[row] + 1}"
        self.form.element.setText(
            f"Element {self._number(element)}, {where}: J {part.scaled_jacobian[row]:.3f}, angles "
            f"{part.dihedral[row, 0]:.0f}° to {part.dihedral[row, 1]:.0f}°, aspect "
            f"{part.aspect[row]:.3g}, edges {part.shortest_edge[row]:.3g} to "
            f"{part.longest_edge[row]:.3g} mm"
        )

    # What documents tell an observer.

    def slotChangedObject(self, obj: Any, name: str) -> None:
        """Show another mesh as soon as there is one."""
        if name == "Result" and obj.Name == self._name and obj.Document.Name == self._document:
            QtCore.QTimer.singleShot(0, self._reload)

    def slotDeletedObject(self, obj: Any) -> None:
        """Close with the volume."""
        if obj.Name == self._name and obj.Document.Name == self._document:
            QtCore.QTimer.singleShot(0, self._close_if_gone)

    def slotDeletedDocument(self, doc: Any) -> None:
        """Close with the document."""
        if doc.Name == self._document:
            self.cancel()
            self._close()

    def _close_if_gone(self) -> None:
        if not self._closed and is_deleted(self._volume):
            self.cancel()
            self._close()

    def _reload(self) -> None:
        if self._closed or is_deleted(self._volume):
            return
        try:
            self._fem = stored_volume(self._volume).fem
        except HybridVolumeError:
            self._close()
            return
        self._show_mesh()
        self._clip.show()
        if not self.running:
            self._density.show(self._values())

    def _values(self) -> Mapping[str, Any]:
        mesh = self._volume.FemMesh
        return {ORDER: mesh.Order, **density.values_of(mesh)}


def _size(source: Any) -> float:
    """Half of the smallest side of a body's box, mm."""
    shape = None if source is None else global_shape(source)
    if shape is None or shape.isNull():
        return 1.0
    box = shape.BoundBox
    return max(0.5 * min(box.XLength, box.YLength, box.ZLength), 1e-9)
