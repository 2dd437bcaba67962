# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The task panel: thickness, layers, Run, progress. The window stays usable while it computes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore, QtGui

from HybridVolume import sources
from HybridVolume.core.goals import Thickness
from HybridVolume.errors import HybridVolumeError, InputError
from HybridVolume.job import Job, worker_python
from HybridVolume.mesh_job import KEYWORDS
from HybridVolume.objects import thickness as shell
from HybridVolume.objects.midstructure import METHODS, UP_TO_DATE
from HybridVolume.objects.volume import inputs_of, options_of, set_status
from HybridVolume.objects.volume_editor import VolumeEditor
from HybridVolume.sources import global_shape

from . import messages, preferences, red_places
from .density_form import DensityForm
from .face_table import FACTORS, FaceTable, Widgets, face_names
from .geometry_form import GeometryForm, body_geometry, volume_geometry
from .panel import elided, show_in_panel
from .run_panel import RunPanel
from .runner import Callbacks
from .spans_form import SpansForm
from .thickness_form import LayersForm, ThicknessForm
from .thickness_preview import ThicknessPreview
from .volume_macro import VolumeMacro
from .work import (
    NO_ENVIRONMENT,
    coverings,
    environment_setup,
    is_deleted,
    reading,
    waiting,
)

_MESH = "FemMesh."


class TaskPanel(RunPanel):
    """Computes the hybrid volume of a body.

    Parameters
    ----------
    source : App.DocumentObject
        The body.
    volume : App.DocumentObject, optional
        A hybrid volume to compute again; otherwise new objects are made.

    Attributes
    ----------
    form : QWidget
    created : list of App.DocumentObject
        Hybrid volumes of the last run.
    """

    def __init__(self, source: Any, volume: Any | None = None) -> None:
        super().__init__("task_panel", "HybridVolume", self._ready)
        self.created: list[Any] = []
        self._source = source
        self._volume = volume
        self._editor = VolumeEditor(volume or source)
        self._macro = VolumeMacro(volume or source)
        self._document = source.Document.Name
        self._bodies: list[tuple[int, sources.Body]] = []
        self._fingerprint = ""
        self._parameters: dict[str, Any] = {}
        self._filled = False
        solids = _solids(source)
        self._single = volume is not None or len(solids) == 1
        solid = volume.Solid if volume else 1
        size = _size(solids[solid - 1] if len(solids) >= solid else None)
        self._preview = ThicknessPreview(
            self.form,
            source,
            volume,
            thickness=self._asked,
            parameters=self._read_form,
            cover=self._coverings,
            make_job=self._field_job,
            callbacks=Callbacks(
                self._show_progress, self._write, lambda _: None, self._fail_preview
            ),
            changed=self._preview_changed,
        )
        self._thickness = ThicknessForm(self.form, size, self._preview_update)
        self._layers = LayersForm(self.form, size)
        self._spans = SpansForm(self.form, size)
        names = face_names(source, solid) if self._single else {}
        form = self.form
        self._faces = FaceTable(
            Widgets(
                *(form.facesToggle, form.facesBox, form.facesHint),
                *(form.faces, form.addFaces, form.removeFaces),
            ),
            FACTORS,
            source,
            names,
            self._preview_update,
            self._faces_opened,
        )
        self._density = DensityForm(
            form.densityLayout, source, names, size, self._show_summary, self._faces_opened
        )
        self._geometry = GeometryForm(
            form, source, solids, check=self.check, opened=self._faces_opened
        )
        self._fill_form(size)
        self._keys = _ReturnKey(self.form)
        self._opened()

    # What FreeCAD asks a panel.

    def getStandardButtons(self) -> Any:
        """Return the buttons beside the panel: OK keeps the values of a volume that is there."""
        if self._volume is None:
            return QtGui.QDialogButtonBox.Close
        return QtGui.QDialogButtonBox.Ok | QtGui.QDialogButtonBox.Cancel

    def accept(self) -> bool:
        """Keep the values, for a later run, and close."""
        if self.running:
            messages.tell("Hybrid volume", "It is still being computed. Wait, or press Cancel.")
            return False
        try:
            changed = {} if self._gone() else self._changed_values()
            if changed:
                self._macro.run("set", changed)
        except HybridVolumeError as error:
            self._write(f"error: {error.line}")
            messages.show_error(error, self._source)
            return False
        self._close()
        return True

    def reject(self) -> bool:
        """Close the panel; what is running is cancelled, values without a run are forgotten."""
        self.cancel()
        self._close()
        return True

    def _gone(self) -> bool:
        """Whether what the panel is about was deleted, or its document closed."""
        return any(map(is_deleted, filter(None, (self._source, self._volume))))

    def _put_back(self) -> None:
        self._preview.close()
        self._faces.close()
        self._density.close()
        self._geometry.close()

    # The panel's own work.

    def run(self) -> None:
        """Start the computation; offer to make the environment if need be."""
        self._start(self._make_jobs)

    def check(self) -> None:
        """Tell how exactly the faces can be kept; nothing else is computed."""
        self._start(self._make_no_jobs)

    def _start(self, make_jobs: Callable[[], Sequence[Job]]) -> None:
        if self.running or self._preview.running:
            return
        self.form.log.clear()
        red_places.clear()
        self._geometry.forget()
        try:
            if self._gone():
                raise InputError("the body or its volume was deleted", remedy="close the panel")
            setup = environment_setup()
            self._parameters = self._read_form()
            options_of(self._parameters)  # a value out of its range is refused at once
        except HybridVolumeError as error:
            self._fail(error, "")
            return
        if setup is False:
            self._idle(NO_ENVIRONMENT)
            return
        self._busy("Starting")
        try:
            self._runner.start(make_jobs, setup, lambda: self._coverings(self._parameters))
        except HybridVolumeError as error:
            self._fail(error, "")

    def cancel(self) -> None:
        """Stop the computation; the document stays as it was."""
        if self._preview.running:
            self._preview.cancel()
            self._idle("Cancelled")
        if self.running:
            self._runner.cancel()
            self._write("cancelled; the document is as it was")
            self._idle("Cancelled")

    def _fill_form(self, size: float) -> None:
        form = self.form
        chosen = preferences.load()
        # labels of imported files are long: a panel wider than its dock is cut off
        form.thicknessBox.setTitle(elided(f"Shell thickness of {self._source.Label}", form))
        form.thicknessBox.setToolTip(self._source.Label)
        methods = METHODS if self._volume else [name for name in METHODS if name != "own"]
        form.method.addItems([method.replace("-", " ") for method in methods])
        values = self._editor.parameters()
        if shell.relevant(values) == shell.relevant(shell.DEFAULTS) and not _computed(self._volume):
            values |= {"W0": chosen.w0, "Layers": chosen.layers}
        counting = shell.relevant(values)
        lengths = {"Thickness": 0.25 * size, "FirstLayer": 0.03 * size}
        values |= {
            name: float(f"{length:.1g}") for name, length in lengths.items() if name not in counting
        }
        self._thickness.show(values)
        self._layers.show(values)
        self._spans.show(values)
        self._geometry.show(values)
        self._faces.show(shell.face_factors(values["FaceFactors"]))
        for widget in (form.showInner, form.facesToggle, self._density.widget.sizesToggle):
            widget.setEnabled(self._single)
            if not self._single:
                widget.setToolTip(
                    "The body has several solids: open the hybrid volume of one of them instead."
                )
        if self._volume:
            # what it is to be is decided in its own panel
            form.method.setCurrentIndex(METHODS.index(self._volume.Midstructure.Method))
            form.method.hide()
            kept = self._volume.Midstructure.Kept
            found = f"{sum(kept)} of {len(kept)} sheets" if kept else "not found yet"
            form.midstructure.setText(f"{found}...")
        self._density.show(_of_mesh(values))
        form.meshToggle.toggled.connect(self._open_mesh)
        self._open_mesh(False)
        form.midstructure.clicked.connect(self._open_midstructure)
        form.run.clicked.connect(self.run)
        form.cancel.clicked.connect(self.cancel)
        self._filled = True
        if _computed(self._volume) and self._volume.Status == UP_TO_DATE:
            self._tell_reached([self._volume])
            self._geometry.show_geometry(volume_geometry(self._volume))
        self._idle("Ready" if self._volume is None else self._volume.Status)

    def _read_form(self) -> dict[str, Any]:
        values = {
            **self._editor.parameters(),
            **self._thickness.values,
            **self._layers.values,
            **self._spans.values,
            **self._geometry.values,
            "FaceFactors": shell.factor_texts(self._faces.values),
            **{f"{_MESH}{name}": value for name, value in self._density.values.items()},
        }
        if self._volume is None:
            values["Midstructure.Method"] = METHODS[self.form.method.currentIndex()]
        return values

    def _changed_values(self) -> dict[str, Any]:
        """Keywords of the editor for what differs from the volume's values."""
        from HybridVolume.objects.volume_editor import keywords_of

        before, now = self._editor.parameters(), self._read_form()
        if inputs_of(before) == inputs_of(now):
            return {}
        old, new = keywords_of(before), keywords_of(now)
        if not self._volume.FemMesh:
            new = {name: value for name, value in new.items() if name not in ("order", *KEYWORDS)}
        return {name: value for name, value in new.items() if old[name] != value}

    # The inner boundary.

    def _asked(self) -> Thickness:
        return shell.thickness_of(self._read_form())

    def _field_job(self, parameters: dict[str, Any]) -> Job:
        self._read(parameters)
        chosen = preferences.load()
        # the field is the same for every thickness
        plain = {**parameters, "ThicknessKind": "Level w0", "FaceFactors": ()}
        (job,) = self._editor.jobs(
            self._bodies,
            plain,
            goal="thickness",
            python=worker_python(chosen.python),
            free_only=chosen.free_only,
        )
        return job

    def _preview_update(self) -> None:
        if self._filled:
            self._preview.update()

    def _faces_opened(self) -> None:
        if self._filled:
            wanted = self._faces.open or self._density.faces.open or self._geometry.coloured
            self._preview.show_body(wanted)

    def _open_mesh(self, on: bool) -> None:
        form = self.form
        form.meshToggle.setArrowType(QtCore.Qt.DownArrow if on else QtCore.Qt.RightArrow)
        form.densityBox.setVisible(on)
        self._show_summary()

    def _show_summary(self) -> None:
        form = self.form
        closed = not form.meshToggle.isChecked()
        form.meshToggle.setText(f"FEM mesh: {self._density.summary}" if closed else "FEM mesh")

    def _preview_changed(self) -> None:
        if not self.running and self._filled:
            if self._preview.field is not None:
                self._thickness.reach(float(self._preview.field.distance.max()))
            self._idle(self.form.stage.text() if self._preview.running else "Ready")

    def _fail_preview(self, error: HybridVolumeError, log: str) -> None:
        self._write_error(error, log)
        self._idle("Failed")
        messages.show_error(error, self._source, log)

    def tell(self, line: str) -> None:
        """Write a line for the user."""
        self._write(line)

    def _open_midstructure(self) -> None:
        """Go to the midstructure's panel, which comes back here."""
        from . import commands

        source, volume = self._source, self._volume
        self.reject()

        def show() -> None:
            if volume:
                commands.open_midstructure_panel(volume, goes_on=True)
            else:
                commands.begin_with_midstructure(source)

        # Later: FreeCAD is still closing this dialog.
        QtCore.QTimer.singleShot(0, show)

    def _coverings(self, parameters: Mapping[str, Any]) -> list[sources.Covering]:
        """What has to be done before the body can be read at once."""
        return coverings(self._source, parameters["CoverTolerance"])

    def _read(self, parameters: Mapping[str, Any]) -> None:
        """Take the faces of the body; refused solids are named, the others go on."""
        if self._gone():
            raise InputError("the body or its volume was deleted", remedy="close the panel")
        with waiting():
            self._fingerprint, bodies = self._editor.read(parameters, **reading())
        for _, body in bodies:
            if body.error:
                self._write(f"{body.name} is refused: {body.error.line}")
        self._bodies = [(number, body) for number, body in bodies if body.error is None]
        if not self._bodies:
            raise bodies[0][1].error
        for _, body in self._bodies:
            self._write(f"{body.name}: {body.origin['geometry']['sentence']}")
        self._geometry.show_geometry([body_geometry(self._source, *one) for one in self._bodies])
        # the table moved what tells of the run, and Cancel
        show_in_panel(self.form.log)

    def _make_no_jobs(self) -> Sequence[Job]:
        """Read the body only."""
        self._read(self._parameters)
        return []

    def _make_jobs(self) -> Sequence[Job]:
        self._read(self._parameters)
        chosen = preferences.load()
        return self._editor.jobs(
            self._bodies,
            self._parameters,
            engine=chosen.engine,
            python=worker_python(chosen.python),
            free_only=chosen.free_only,
        )

    def _ready(self) -> bool:
        doc = FreeCAD.listDocuments().get(self._document)
        # A gone document is a failure to be told at once; an open transaction is waited for.
        return doc is None or not doc.HasPendingTransaction

    def _finish(self, jobs: Sequence[Job]) -> None:
        if not jobs:
            self.form.progress.setValue(self.form.progress.maximum())
            self._geometry.open()
            self._idle("Checked")
            return
        try:
            self.created = self._take_in(jobs)
        except HybridVolumeError as error:
            self._fail(error, "")
            return
        FreeCADGui.updateGui()
        for volume in self.created:
            self._write(
                f"{volume.Label}: w0 {volume.W0Reached:.3g}, {volume.Elements} elements of the "
                f"shell, all proved valid, {volume.Core.Elements} tets"
            )
            if volume.Report.get("evening.sentence"):
                self._write(f"{volume.Label}: {volume.Report['evening.sentence']}")
            if volume.Report.get("shell.sentence"):
                self._write(f"{volume.Label}: {volume.Report['shell.sentence']}")
        # the shell itself is there now
        self._preview.hide()
        self._tell_reached(self.created)
        self.form.progress.setValue(self.form.progress.maximum())
        self._idle("Done")

    def _tell_reached(self, volumes: Sequence[Any]) -> None:
        """Say beside the thickness what the last run made of it."""
        told = [(one, one.Report.get("shell.sentence", "")) for one in volumes]
        short = [
            f"{one.Label}: {text}" if len(told) > 1 else f"The last run: {text}."
            for one, text in told
            if text
        ]
        reached = told[0][0].ThicknessReached if len(told) == 1 else ""
        as_asked = f"The last run: {reached}." if reached and not short else ""
        self._preview.tell(as_asked, "\n".join(short))

    def _take_in(self, jobs: Sequence[Job]) -> list[Any]:
        """Put the results into the document."""
        doc = FreeCAD.listDocuments().get(self._document)
        if doc is None:
            raise InputError("the document was closed; the result is dropped")
        if self._gone():
            raise InputError("the body or its volume was deleted while it was computed")
        engine = preferences.load().engine
        return self._macro.completed(
            self._parameters,
            engine,
            lambda: self._editor.insert(self._bodies, jobs, self._parameters, self._fingerprint),
        )

    def _fail(self, error: HybridVolumeError, log: str) -> None:
        self._write_error(error, log)
        unrelated = ("worker", "environment")
        if self._volume and not is_deleted(self._volume) and error.code not in unrelated:
            set_status(self._volume, f"Failed: {error.line}")
        self._idle("Failed")
        messages.show_error(error, self._source, log)

    def _enable(self, *, running: bool) -> None:
        field = self._preview.running
        self.form.parameters.setEnabled(not running)
        self.form.run.setEnabled(not (running or field))
        self.form.cancel.setEnabled(running or field)


class _ReturnKey(QtCore.QObject):
    """Keeps the Return that ends the typing of a value from pressing OK, as FreeCAD lets it do."""

    def __init__(self, form: Any) -> None:
        super().__init__(form)
        form.installEventFilter(self)

    def eventFilter(self, watched: Any, event: Any) -> bool:
        """Take the keys that nobody in the form took."""
        returns = (QtCore.Qt.Key_Return, QtCore.Qt.Key_Enter)
        return event.type() == QtCore.QEvent.KeyPress and event.key() in returns


def _of_mesh(values: Mapping[str, Any]) -> dict[str, Any]:
    """The mesh object's values among a volume's."""
    return {k.removeprefix(_MESH): value for k, value in values.items() if k.startswith(_MESH)}


def _computed(volume: Any | None) -> bool:
    return volume is not None and bool(volume.Result)


def _solids(source: Any) -> list[Any]:
    shape = global_shape(source)
    return [] if shape is None or shape.isNull() else shape.Solids


def _size(shape: Any | None) -> float:
    """Half of the smallest side of a shape's box, mm: no shell is thicker."""
    if shape is None:
        return 1.0
    box = shape.BoundBox
    return max(0.5 * min(box.XLength, box.YLength, box.ZLength), 1e-9)
