# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A panel with a run of its own: its progress, its stage, its log and its Cancel."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import FreeCAD

from HybridVolume.errors import HybridVolumeError
from HybridVolume.job import Job

from . import red_places
from .panel import Panel
from .runner import Callbacks, Runner


class RunPanel(Panel):
    """Base of the panels whose form has ``run``, ``cancel``, ``progress``, ``stage`` and ``log``.

    Parameters
    ----------
    name, icon : str
        As of `Panel`.
    ready : callable
        As of `Runner`.
    """

    def __init__(self, name: str, icon: str, ready: Callable[[], bool]) -> None:
        super().__init__(name, icon)
        self._runner = Runner(
            Callbacks(self._show_progress, self._write, self._finish, self._fail), ready
        )

    @property
    def running(self) -> bool:
        """Whether a computation is under way."""
        return self._runner.running

    @property
    def job(self) -> Job | None:
        """The job that is running."""
        return self._runner.job

    def _finish(self, jobs: Sequence[Job]) -> None:
        """Take in what was computed."""
        raise NotImplementedError

    def _fail(self, error: HybridVolumeError, log: str) -> None:
        """Tell what went wrong."""
        raise NotImplementedError

    def _enable(self, *, running: bool) -> None:
        """Enable and disable what can be used meanwhile."""
        raise NotImplementedError

    def _show_progress(self, share: float | None, text: str) -> None:
        bar = self.form.progress
        bar.setMaximum(0 if share is None else 1000)
        if share is not None:
            bar.setValue(round(1000 * share))
        self.form.stage.setText(text)

    def _write(self, line: str) -> None:
        log = self.form.log
        log.appendPlainText(line)
        # Qt itself stays behind once the panel has become lower
        log.verticalScrollBar().setValue(log.verticalScrollBar().maximum())
        FreeCAD.Console.PrintLog(f"HybridVolume: {line}\n")

    def _write_error(self, error: HybridVolumeError, log: str = "") -> None:
        for line in (f"error: {error.line}", *red_places.lines(error)):
            self._write(line)
        if log:
            FreeCAD.Console.PrintError(log)

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
