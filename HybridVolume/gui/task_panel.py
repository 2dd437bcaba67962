# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The task panel: parameters, Run, progress, Cancel. The window stays usable while it computes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore, QtGui

from HybridVolume import sources
from HybridVolume.errors import HybridVolumeError, InputError
from HybridVolume.job import Job, worker_python
from HybridVolume.objects import document
from HybridVolume.objects.midstructure import METHODS, own_geometry
from HybridVolume.objects.volume import current_parameters, options_of, set_status

from . import messages, preferences
from .runner import Callbacks, Runner
from .work import NO_ENVIRONMENT, environment_setup, is_deleted, read_bodies

ORDERS = (("Second", "second order"), ("First", "first order"))


class TaskPanel:
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
        self.form = FreeCADGui.PySideUic.loadUi(str(preferences.RESOURCES / "ui" / "task_panel.ui"))
        self.form.setWindowIcon(
            QtGui.QIcon(str(preferences.RESOURCES / "icons" / "HybridVolume.svg"))
        )
        self.created: list[Any] = []
        self._source = source
        self._volume = volume
        self._document = source.Document.Name
        self._bodies: list[tuple[int, sources.Body]] = []
        self._fingerprint = ""
        self._parameters: dict[str, Any] = {}
        self._runner = Runner(
            Callbacks(self._show_progress, self._write, self._finish, self._fail), self._ready
        )
        self._fill_form()

    # What FreeCAD asks a panel.

    def getStandardButtons(self) -> Any:
        """Return the one button below the panel."""
        return QtGui.QDialogButtonBox.Close

    def reject(self) -> bool:
        """Close the panel; what is running is cancelled."""
        self.cancel()
        FreeCADGui.Control.closeDialog()
        return True

    def isAllowedAlterDocument(self) -> bool:
        """Leave the document usable while the panel is open."""
        return True

    def isAllowedAlterSelection(self) -> bool:
        """Leave the selection usable while the panel is open."""
        return True

    def isAllowedAlterView(self) -> bool:
        """Leave the view usable while the panel is open."""
        return True

    # The panel's own work.

    @property
    def running(self) -> bool:
        """Whether a computation is under way."""
        return self._runner.running

    @property
    def job(self) -> Job | None:
        """The job that is running."""
        return self._runner.job

    def run(self) -> None:
        """Read the body and start the computation; offer to make the environment if need be."""
        if self.running:
            return
        self.form.log.clear()
        try:
            setup = environment_setup()
            self._read()
        except HybridVolumeError as error:
            self._fail(error, "")
            return
        if setup is False:
            self._idle(NO_ENVIRONMENT)
            return
        self._parameters = self._read_form()
        self._busy("Starting")
        try:
            self._runner.start(self._make_jobs, setup)
        except HybridVolumeError as error:
            self._fail(error, "")

    def cancel(self) -> None:
        """Stop the computation; the document stays as it was."""
        if self.running:
            self._runner.cancel()
            self._write("cancelled; the document is as it was")
            self._idle("Cancelled")

    def _fill_form(self) -> None:
        form = self.form
        chosen = preferences.load()
        form.body.setText(self._source.Label)
        methods = METHODS if self._volume else [name for name in METHODS if name != "own"]
        form.method.addItems([method.replace("-", " ") for method in methods])
        form.order.addItems([text for _, text in ORDERS])
        form.w0.valueChanged.connect(lambda value: form.w0Slider.setValue(round(100 * value)))
        form.w0Slider.valueChanged.connect(self._slide)
        computed = self._volume is not None and bool(self._volume.Result)
        form.w0.setValue(self._volume.W0 if computed else chosen.w0)
        form.layers.setValue(self._volume.Layers if computed else chosen.layers)
        if self._volume:
            # what it is to be is decided in its own panel
            form.method.setCurrentIndex(METHODS.index(self._volume.Midstructure.Method))
            form.method.hide()
            form.parametersLayout.addWidget(form.midstructure, 3, 1, 1, 2)
            kept = self._volume.Midstructure.Kept
            found = f"{sum(kept)} of {len(kept)} sheets" if kept else "not found yet"
            form.midstructure.setText(f"{found}...")
            names = [name for name, _ in ORDERS]
            order = current_parameters(self._volume)["FemMesh.Order"]
            form.order.setCurrentIndex(names.index(order))
        form.midstructure.clicked.connect(self._open_midstructure)
        form.run.clicked.connect(self.run)
        form.cancel.clicked.connect(self.cancel)
        self._idle("Ready" if self._volume is None else self._volume.Status)

    def _slide(self, value: int) -> None:
        # A typed value between two steps of the slider must not be rounded by it.
        if round(100 * self.form.w0.value()) != value:
            self.form.w0.setValue(value / 100)

    def _read_form(self) -> dict[str, Any]:
        parameters = {
            "W0": self.form.w0.value(),
            "Layers": self.form.layers.value(),
            "FemMesh.Order": ORDERS[self.form.order.currentIndex()][0],
        }
        if self._volume:
            return {**current_parameters(self._volume), **parameters}
        return {
            **{"Degree": 3, "Tolerance": 1e-7},
            **parameters,
            "Midstructure.Method": METHODS[self.form.method.currentIndex()],
        }

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

    def _read(self) -> None:
        """Take the faces of the body; refused solids are named, the others go on."""
        self._fingerprint, read = read_bodies(self._source)
        bodies = list(enumerate(read, start=1))
        if self._volume:
            bodies = [(number, body) for number, body in bodies if number == self._volume.Solid]
            if not bodies:
                raise InputError(
                    f"{self._source.Label} has no solid {self._volume.Solid} any more",
                    remedy="remove this hybrid volume and make a new one",
                )
        for _, body in bodies:
            if body.error:
                self._write(f"{body.name} is refused: {body.error.line}")
        self._bodies = [(number, body) for number, body in bodies if body.error is None]
        if not self._bodies:
            raise bodies[0][1].error

    def _make_jobs(self) -> Sequence[Job]:
        chosen = preferences.load()
        options = options_of(self._parameters)
        options["engine"] = chosen.engine
        python = worker_python(chosen.python)
        own = own_geometry(self._volume.Midstructure) if self._volume else None
        return [
            Job(
                body.faces,
                name=body.name,
                options=options,
                source={"file": self._source.Label, "bodies": len(self._bodies)},
                own=own,
                python=python,
                free_only=chosen.free_only,
            )
            for _, body in self._bodies
        ]

    def _ready(self) -> bool:
        doc = FreeCAD.listDocuments().get(self._document)
        # A gone document is a failure to be told at once; an open transaction is waited for.
        return doc is None or not doc.HasPendingTransaction

    def _finish(self, jobs: Sequence[Job]) -> None:
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
        self.form.progress.setValue(self.form.progress.maximum())
        self._idle("Done")

    def _take_in(self, jobs: Sequence[Job]) -> list[Any]:
        """Put the results into the document."""
        doc = FreeCAD.listDocuments().get(self._document)
        if doc is None:
            raise InputError("the document was closed; the result is dropped")
        for obj in filter(None, (self._source, self._volume)):
            if is_deleted(obj):
                raise InputError("the body or its volume was deleted while it was computed")
        prepared = [
            document.Prepared(
                document.Completed(
                    body=body,
                    solid=number,
                    volume=job.result(),
                    result=job.result_file,
                    report=job.report(),
                    parameters=self._parameters,
                    fingerprint=self._fingerprint,
                )
            )
            for (number, body), job in zip(self._bodies, jobs, strict=True)
        ]
        return document.insert(doc, self._source, prepared, self._volume)

    def _fail(self, error: HybridVolumeError, log: str) -> None:
        self._write(f"error: {error.line}")
        if log:
            FreeCAD.Console.PrintError(log)
        unrelated = ("worker", "environment")
        if self._volume and not is_deleted(self._volume) and error.code not in unrelated:
            set_status(self._volume, f"Failed: {error.line}")
        self._idle("Failed")
        messages.show_error(error, self._source, log)

    def _show_progress(self, share: float | None, text: str) -> None:
        bar = self.form.progress
        bar.setMaximum(0 if share is None else 1000)
        if share is not None:
            bar.setValue(round(1000 * share))
        self.form.stage.setText(text)

    def _write(self, line: str) -> None:
        self.form.log.appendPlainText(line)
        FreeCAD.Console.PrintLog(f"HybridVolume: {line}\n")

    def _busy(self, text: str) -> None:
        self.form.progress.setValue(0)
        self.form.stage.setText(text)
        self._enable(running=True)

    def _idle(self, text: str) -> None:
        if self.form.progress.maximum() == 0:
            self.form.progress.setMaximum(1000)
        if text != "Done":
            self.form.progress.setValue(0)
        self.form.stage.setText(text)
        self._enable(running=False)

    def _enable(self, *, running: bool) -> None:
        self.form.parameters.setEnabled(not running)
        self.form.run.setEnabled(not running)
        self.form.cancel.setEnabled(running)
