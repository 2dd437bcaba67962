# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Jobs beside the living window: a timer watches the worker, FreeCAD never waits for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from PySide import QtCore

from HybridVolume.errors import FaultError, HybridVolumeError, InputError
from HybridVolume.job import Job
from HybridVolume.sources.covering import Covering, forget_limits

from .setup import EnvironmentSetup
from .work import waiting

INTERVAL = 100
"""Milliseconds between two looks at the worker."""

COVERING = 0.25
"""Share of the whole that the covering of faces takes in the progress."""

ROUNDS = 5
"""So often bodies that change while they are covered are covered again."""


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
    """Makes the environment if asked to, covers bodies, then runs jobs one after the other.

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
        self._cover: Callable[[], Sequence[Covering]] | None = None
        self._coverings: list[Covering] = []
        self._rounds = 0
        self._covered = False
        self._make_jobs: Callable[[], Sequence[Job]] | None = None
        self._made = False
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
        self,
        make_jobs: Callable[[], Sequence[Job]],
        setup: EnvironmentSetup | None = None,
        cover: Callable[[], Sequence[Covering]] | None = None,
    ) -> None:
        """Begin; return at once.

        Parameters
        ----------
        make_jobs : callable
            Gives the jobs, called when the environment and the covers are there; none is none.
        setup : EnvironmentSetup, optional
            To be run first.
        cover : callable, optional
            Gives the coverings that reading the bodies needs, and does not find in memory yet.
        """
        self._make_jobs, self._made, self._jobs, self._stage = make_jobs, False, [], ""
        self._cover, self._coverings, self._covered, self._rounds = cover, [], False, 0
        forget_limits()
        self._setup = setup
        if setup:
            setup.start()
            self._callbacks.progress(None, "Making the environment")
        self._timer.start()

    def cancel(self) -> None:
        """End what is under way, and everything that it started."""
        self._timer.stop()
        if self._setup:
            self._setup.cancel()
        for covering in self._coverings:
            covering.cancel()
        self._coverings = []
        self._close_jobs()

    def _tick(self) -> None:
        try:
            if self._setup:
                self._watch_setup()
            elif self._coverings:
                self._watch_coverings()
            elif self._cover is not None:
                self._begin_covering()
            elif not self._made:
                self._jobs, self._made = list(self._make_jobs()), True
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

    def _begin_covering(self) -> None:
        """Cover what has to be: also what became another body while it was covered."""
        self._coverings = list(self._cover())
        if not self._coverings:
            self._cover = None
        elif self._rounds == ROUNDS:
            raise FaultError(
                "the body has to be covered again and again",
                remedy="do not change it meanwhile, and report it otherwise",
            )
        self._rounds += 1

    def _watch_coverings(self) -> None:
        self._covered = True
        for number, covering in enumerate(self._coverings):
            if covering.state == "new":
                share = COVERING * number / len(self._coverings)
                self._show(share, "covering the faces", covering.name)
                with waiting():
                    covering.start()
            for news in covering.poll():
                share = (number + news.fraction) / len(self._coverings)
                text = f"covering: {news.text}" if news.text else "covering the faces"
                self._show(COVERING * share, text, covering.name)
            if covering.state == "running":
                return
            if covering.error is not None and not isinstance(covering.error, InputError):
                raise covering.error
        # who is refused is said when the bodies are read; the others go on
        self._coverings = []

    def _show(self, share: float, text: str, name: str) -> None:
        """Tell progress of a body, also as a line of the log where it is new."""
        if len(self._jobs) > 1 or len(self._coverings) > 1:
            text = f"{name} - {text}"
        self._callbacks.progress(share, text)
        if text != self._stage:
            self._stage = text
            self._callbacks.line(text)

    def _watch_jobs(self) -> None:
        before = COVERING if self._covered else 0.0
        for number, job in enumerate(self._jobs):
            if job.state == "done":
                continue
            if job.state == "new":
                job.start()
            for news in job.poll():
                share = (number + news.fraction) / len(self._jobs)
                text = f"{news.stage}: {news.text}" if news.text else news.stage
                self._show(before + (1.0 - before) * share, text, job.name)
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
        log = next((one.log for one in (*self._coverings, *self._jobs) if one.log), "")
        self.cancel()
        self._callbacks.failed(error, log)

    def _close_jobs(self) -> None:
        for job in self._jobs:
            job.close()
        self._jobs = []
