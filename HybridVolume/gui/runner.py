# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Jobs beside the living window: a timer watches the worker, FreeCAD never waits for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from PySide import QtCore

from HybridVolume.errors import HybridVolumeError
from HybridVolume.job import Job

from .setup import EnvironmentSetup

INTERVAL = 100
"""Milliseconds between two looks at the worker."""


@dataclass(frozen=True)
class Callbacks:
    """What the owner of a runner wants to hear; all are called on the window's thread.

    Attributes
    ----------
    progress : callable(share, text)
        ``share`` of the whole in [0, 1], or None where it is not known.
    line : callable(text)
        A line for the log.
    finished : callable(jobs)
        All jobs are done; their folders go away when it returns.
    failed : callable(error, log)
    """

    progress: Callable[[float | None, str], None]
    line: Callable[[str], None]
    finished: Callable[[Sequence[Job]], None]
    failed: Callable[[HybridVolumeError, str], None]


class Runner(QtCore.QObject):
    """Makes the environment if asked to, then runs jobs one after the other.

    Parameters
    ----------
    callbacks : Callbacks
    ready : callable, optional
        Asked before ``finished`` is called; False puts it off (another command has the document).
    """

    def __init__(self, callbacks: Callbacks, ready: Callable[[], bool] = lambda: True) -> None:
        super().__init__()
        self._callbacks = callbacks
        self._ready = ready
        self._setup: EnvironmentSetup | None = None
        self._make_jobs: Callable[[], Sequence[Job]] | None = None
        self._jobs: list[Job] = []
        self._stage = ""
        self._timer = QtCore.QTimer(self)
        self._timer.setInterval(INTERVAL)
        self._timer.timeout.connect(self._tick)

    @property
    def running(self) -> bool:
        """Whether anything is under way."""
        return self._timer.isActive()

    @property
    def job(self) -> Job | None:
        """The job that is running."""
        return next((job for job in self._jobs if job.state == "running"), None)

    def start(
        self, make_jobs: Callable[[], Sequence[Job]], setup: EnvironmentSetup | None = None
    ) -> None:
        """Begin; return at once.

        Parameters
        ----------
        make_jobs : callable
            Gives the jobs, called when the environment is there.
        setup : EnvironmentSetup, optional
            To be run first.
        """
        self._make_jobs, self._setup, self._jobs, self._stage = make_jobs, setup, [], ""
        if setup:
            setup.start()
            self._callbacks.progress(None, "Making the environment")
        self._timer.start()

    def cancel(self) -> None:
        """End what is under way, and everything that it started."""
        self._timer.stop()
        if self._setup:
            self._setup.cancel()
        self._close_jobs()

    def _tick(self) -> None:
        try:
            if self._setup:
                self._watch_setup()
            elif not self._jobs:
                self._jobs = list(self._make_jobs())
            else:
                self._watch_jobs()
        except HybridVolumeError as error:
            self._fail(error)
        except Exception:
            # A timer that goes on after a fault would repeat it ten times a second.
            self.cancel()
            raise

    def _watch_setup(self) -> None:
        for line in self._setup.poll():
            self._callbacks.line(line)
            self._callbacks.progress(None, line)
        if not self._setup.running:
            error, self._setup = self._setup.error, None
            if error:
                raise error

    def _watch_jobs(self) -> None:
        for number, job in enumerate(self._jobs):
            if job.state == "done":
                continue
            if job.state == "new":
                job.start()
            for news in job.poll():
                share = (number + news.fraction) / len(self._jobs)
                text = f"{news.stage}: {news.text}" if news.text else news.stage
                if len(self._jobs) > 1:
                    text = f"{job.name} - {text}"
                self._callbacks.progress(share, text)
                if text != self._stage:
                    self._stage = text
                    self._callbacks.line(text)
            if job.error:
                raise job.error
            return
        if not self._ready():
            self._callbacks.progress(1.0, "Waiting for the command that is open in the document")
            return
        self._timer.stop()
        try:
            self._callbacks.finished(self._jobs)
        finally:
            self._close_jobs()

    def _fail(self, error: HybridVolumeError) -> None:
        log = next((job.log for job in self._jobs if job.log), "")
        self.cancel()
        self._callbacks.failed(error, log)

    def _close_jobs(self) -> None:
        for job in self._jobs:
            job.close()
        self._jobs = []
