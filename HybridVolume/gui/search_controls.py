# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The part of the midstructure's panel that looks for it: method, samples, progress, Cancel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import FreeCAD
import FreeCADGui

from HybridVolume.errors import HybridVolumeError
from HybridVolume.job import Job, worker_python
from HybridVolume.objects import midstructure as objects
from HybridVolume.objects.midstructure_editor import Editor
from HybridVolume.sources import Covering

from . import messages, preferences
from .macro import Macro
from .runner import Callbacks, Runner
from .work import NO_ENVIRONMENT, coverings, environment_setup, is_deleted

METHODS = (
    ("auto", "automatic: medial axis"),
    ("skeleton", "skeleton: curves in the middle"),
    ("distance", "even depth below the faces"),
    ("own", "own geometry"),
)
SELECT_FIRST = "Select points, wires or faces inside the body, then press Take selected."


class SearchControls:
    """Changes how a midstructure is found, and finds it in the worker.

    Parameters
    ----------
    form : QWidget
        The panel's.
    volume : App.DocumentObject
    macro : Macro
    command : callable(call)
        Runs a method of the editor; whether it went well.
    changed : callable()
        A computation began or ended.
    told : callable(figures)
        The exact thickness is there: what ``shell_thickness`` returns.
    """

    def __init__(
        self,
        form: Any,
        volume: Any,
        macro: Macro,
        command: Callable[[str], bool],
        changed: Callable[[], None],
        told: Callable[[dict[str, Any]], None],
    ) -> None:
        self._form = form
        self._volume = volume
        self._obj = volume.Midstructure
        self._document = volume.Document.Name
        self._macro = macro
        self._command = command
        self._changed = changed
        self._told = told
        self._found_from: dict[str, str] = {}
        self._goal = ""
        self._showing = False
        self._runner = Runner(
            Callbacks(self._show_progress, self._write, self._finish, self._fail), self._ready
        )
        form.method.addItems([text for _, text in METHODS])
        form.method.activated.connect(lambda *_: self._set_method())
        form.depthText.editingFinished.connect(self._set_depth)
        form.take.clicked.connect(self._take_selected)
        form.samples.valueChanged.connect(lambda *_: self._set_samples())
        form.findAgain.clicked.connect(self._find_or_cancel)
        form.progress.hide()

    @property
    def running(self) -> bool:
        """Whether a computation is under way."""
        return self._runner.running

    @property
    def w0(self) -> float:
        """Thickness that is asked for, or will be by default."""
        return self._volume.W0 if self._volume.Result else preferences.load().w0

    @property
    def by_user(self) -> bool:
        """Whether the user's own geometry is to be selected."""
        return self._obj.Method == "own"

    def show(self) -> None:
        """Show what the properties say."""
        obj, form = self._obj, self._form
        self._showing = True
        try:
            method = _shown(obj.Method)
            form.method.setCurrentIndex([name for name, _ in METHODS].index(method))
            form.depthText.setVisible(method == "distance")
            form.depthText.setText(obj.Depth)
            form.take.setVisible(method == "own")
            for widget in (form.samples, form.samplesCaption):
                widget.setVisible(method in ("auto", "skeleton"))
            form.samples.setValue(obj.Samples)
        finally:
            self._showing = False
        if not self.running and obj.Status.startswith("Out of date"):
            form.stage.setText(f"{obj.Status}. Press Find again.")
        elif form.stage.text().startswith("Out of date"):
            form.stage.setText("")
        self.enable()

    def enable(self) -> None:
        """Enable what can be used now."""
        form, running = self._form, self.running
        for widget in (form.method, form.depthText, form.take, form.samples):
            widget.setEnabled(not running)
        form.findAgain.setText("Cancel" if running else "Find again")
        form.progress.setVisible(running)
        form.stage.setVisible(bool(form.stage.text()))

    def find(self) -> None:
        """Find the midstructure in the worker."""
        self._start("midstructure", "Finding the midstructure")

    def compute_thickness(self) -> None:
        """Compute in the worker how thick the shell will be."""
        self._start("thickness", "Computing the exact thickness")

    def cancel(self) -> None:
        """End what is running."""
        self._runner.cancel()

    def _find_or_cancel(self) -> None:
        if self.running:
            self._runner.cancel()
            self._idle("Cancelled")
        else:
            self.find()

    def _start(self, goal: str, text: str) -> None:
        if self.running:
            return
        self._goal = goal
        try:
            setup = environment_setup()
        except HybridVolumeError as error:
            self._fail(error, "")
            return
        if setup is False:
            self._idle(NO_ENVIRONMENT)
            return
        self._form.stage.setText(text)
        self._form.progress.setValue(0)
        try:
            self._runner.start(self._make_jobs, setup, self._coverings)
        except HybridVolumeError as error:
            self._fail(error, "")
        self._changed()

    def _coverings(self) -> Sequence[Covering]:
        if is_deleted(self._volume):
            return []
        return coverings(self._volume.Source, self._volume.CoverTolerance.Value)

    def _make_jobs(self) -> Sequence[Job]:
        chosen = preferences.load()
        editor = Editor(self._obj)
        keywords = {"python": worker_python(chosen.python), "free_only": chosen.free_only}
        self._found_from = objects.search_inputs(self._obj)
        if self._goal == "midstructure":
            return [editor.job(**keywords)]
        return [editor.thickness_job(self.w0, **keywords)]

    def _ready(self) -> bool:
        doc = FreeCAD.listDocuments().get(self._document)
        return doc is None or not doc.HasPendingTransaction

    def _finish(self, jobs: Sequence[Job]) -> None:
        (job,) = jobs
        try:
            if self._goal == "midstructure":
                self._macro.found(job.result_file, self._found_from)
                self._idle("")
            else:
                self._idle("")
                self._told(job.result())
        except HybridVolumeError as error:
            self._fail(error, "")

    def _fail(self, error: HybridVolumeError, log: str) -> None:
        if log:
            FreeCAD.Console.PrintError(log)
        self._idle(f"Failed: {error.line}")
        if not is_deleted(self._volume):
            messages.show_error(error, self._volume.Source, log)

    def _show_progress(self, share: float | None, text: str) -> None:
        bar = self._form.progress
        bar.setMaximum(0 if share is None else 1000)
        if share is not None:
            bar.setValue(round(1000 * share))
        self._form.stage.setText(text)

    def _write(self, line: str) -> None:
        FreeCAD.Console.PrintLog(f"HybridVolume: {line}\n")

    def _idle(self, text: str) -> None:
        self._form.stage.setText(text)
        self._changed()

    def _set_method(self) -> None:
        method = METHODS[self._form.method.currentIndex()][0]
        if method == _shown(self._obj.Method):
            return
        if self._command(f"set(method={method!r})") and (method != "own" or self._obj.Geometry):
            self.find()
        elif method == "own":
            self._idle(SELECT_FIRST)

    def _set_depth(self) -> None:
        depth = self._form.depthText.text().strip()
        if (
            not self._showing
            and depth != self._obj.Depth
            and self._command(f"set(depth={depth!r})")
        ):
            self.find()

    def _set_samples(self) -> None:
        samples = self._form.samples.value()
        # below the smallest number there is only 0, which chooses by the body
        low = objects.SAMPLES[0]
        if 0 < samples < low:
            samples = low if samples > self._obj.Samples else 0
        if self._showing or samples == self._obj.Samples:
            return
        if self._command(f"set(samples={samples})"):
            self.find()

    def _take_selected(self) -> None:
        selected = [
            obj
            for obj in FreeCADGui.Selection.getSelection(self._document)
            if obj not in (self._obj, self._volume, self._volume.Source)
        ]
        if not selected:
            self._idle(SELECT_FIRST)
            return
        names = ", ".join(self._macro.object_text(obj) for obj in selected)
        if self._command(f"set(geometry=[{names}])"):
            FreeCADGui.Selection.clearSelection()
            self.find()


def _shown(method: str) -> str:
    """The method that stands in the list for one of the object's."""
    return "auto" if method == "medial-axis" else method
