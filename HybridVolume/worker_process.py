# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The process of a worker as its parent sees it: which Python, its lines, its death, its end.

This module needs the standard library only.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from HybridVolume import environment
from HybridVolume.errors import SetupError, WorkerError

PREFERENCES = "User parameter:BaseApp/Preferences/Mod/HybridVolume"
GRACE = 2.0
"""Seconds between asking a worker to end and killing it."""
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that tell libraries for matrices how many threads to use."""


def worker_python(preference: str | None = None) -> str:
    """Return the Python that runs the worker.

    ``HYBRIDVOLUME_PYTHON``, else the preference, else the environment that the set-up makes.

    Parameters
    ----------
    preference : str, optional
        Interpreter named by the user; inside FreeCAD the preference page is asked.

    Raises
    ------
    SetupError
        It does not exist or cannot be run.
    """
    named = os.environ.get("HYBRIDVOLUME_PYTHON") or preference or _preferred_python()
    python = Path(named).expanduser() if named else environment.interpreter()
    if not (python.is_file() and os.access(python, os.X_OK)):
        what = "is no interpreter" if named else "does not exist yet"
        raise SetupError(
            f"the worker's Python {python} {what}",
            remedy="run ./run.sh once or open Preferences > HybridVolume",
        )
    return str(python)


def _preferred_python() -> str:
    # Only a FreeCAD that already runs is asked: this module works without one.
    freecad = sys.modules.get("FreeCAD")
    return freecad.ParamGet(PREFERENCES).GetString("Python", "") if freecad else ""


class WorkerProcess:
    """A running worker.

    Parameters
    ----------
    python : str
        Interpreter.
    module : str
        What it runs; the folder is its only argument.
    folder : Path
        The job's folder; temporary files go there as well.
    log : Path
        Gets what the worker and its meshers say.
    free_only : bool
        Leave the GPL parts out.

    Attributes
    ----------
    pid : int

    Raises
    ------
    OSError
        The process cannot be made.
    """

    def __init__(
        self, python: str, module: str, folder: Path, log: Path, *, free_only: bool = False
    ) -> None:
        self._log = log
        self._lines: queue.Queue[str | None] = queue.Queue()
        with open(log, "wb") as file:
            self._process = subprocess.Popen(
                [python, "-m", module, str(folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=file,
                env=worker_variables(folder, free_only),
                # A group of its own: Cancel must reach the meshers that the worker starts,
                # and Ctrl-C in a terminal must not reach the worker before us.
                **_new_group(),
            )
        self.pid = self._process.pid
        # A thread reads the pipe: that works on every system, and nothing of FreeCAD runs in it.
        self._reader = threading.Thread(target=self._read_lines, daemon=True)
        self._reader.start()
        self._ended: float | None = None

    def line(self, wait: float = 0.0) -> str | None:
        """Return the next line, None at the end of the output.

        Parameters
        ----------
        wait : float
            Seconds to wait for it.

        Raises
        ------
        queue.Empty
            There is none yet.
        """
        return self._lines.get(timeout=wait) if wait else self._lines.get_nowait()

    @property
    def gone(self) -> bool:
        """Whether it has ended and all of its lines are taken.

        Killed, a worker may leave children that hold the pipe open: its output then has no end.
        What it wrote last may still be on its way through the pipe and our thread, though, so this
        waits `GRACE` seconds from when its end was first seen.
        """
        reading = self._reader.is_alive()  # asked first: what it still adds is seen below
        if self._process.poll() is None or not self._lines.empty():
            return False
        if self._ended is None:
            self._ended = time.monotonic()
        return not reading or time.monotonic() > self._ended + GRACE

    @property
    def code(self) -> int | None:
        """Its exit code, the negative number of a signal; None where it goes on without output."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(GRACE)
        return self._process.poll()

    def death(self) -> WorkerError:
        """Why it ended without an answer."""
        code = self.code
        if code is None:
            return WorkerError("the worker closed its output and goes on")
        if code >= 0:
            lines = tail(self._log).strip().splitlines() or ["no reason"]
            return WorkerError(f"the worker ended with code {code}: {lines[-1].strip()[:200]}")
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        kills = {"SIGKILL": "too little memory, or killed from outside", "SIGSEGV": "a crash"}
        reason = f" ({kills[name]})" if name in kills else ""
        return WorkerError(
            f"the worker process was ended by {name}{reason}",
            remedy="the document and the files are untouched; try again",
        )

    def stop(self, gently: bool) -> None:
        """End it and everything that it started; ``gently`` where it has answered."""
        process = self._process
        if gently:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(GRACE)
        elif process.poll() is None:
            _signal_group(process, "SIGTERM")
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(GRACE)
        # The worker's own end is not enough: the group may hold a mesher that goes on.
        _signal_group(process, "SIGKILL")
        process.wait()
        process.stdin.close()

    def _read_lines(self) -> None:
        with contextlib.suppress(ValueError, OSError):  # closed while we read: cancelled
            for line in self._process.stdout:
                self._lines.put(line.decode("utf-8", "replace"))
        self._lines.put(None)


def worker_variables(folder: Path, free_only: bool = False) -> dict[str, str]:
    """Variables for the worker: its Python must find its own libraries, and our package.

    Parameters
    ----------
    folder : Path
        For its temporary files.
    free_only : bool
        Leave the GPL parts out.
    """
    variables = dict(os.environ)
    for name in ("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP"):
        variables.pop(name, None)
    if "APPDIR" in variables:
        # An AppImage's libraries belong to its own programs.
        for name in ("LD_LIBRARY_PATH", "LD_PRELOAD"):
            variables.pop(name, None)
    variables["PYTHONPATH"] = str(Path(__file__).resolve().parent.parent)
    variables["PYTHONIOENCODING"] = "utf-8"
    # Our matrices are many and small: more threads than one wait for each other (four times the
    # processor's time on two cores), and the last bits would depend on how many there are.
    variables.update(dict.fromkeys(THREADS, "1"))
    if free_only:
        variables["HYBRIDVOLUME_FREE_ONLY"] = "1"
    # What a killed mesher leaves in its temporary folder goes away with the job's.
    for name in ("TMPDIR", "TMP", "TEMP"):
        variables[name] = str(folder)
    return variables


def _new_group() -> dict[str, Any]:
    if os.name == "posix":
        return {"start_new_session": True}
    flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
    return {"creationflags": flags}


def _signal_group(process: subprocess.Popen, name: str) -> None:
    if os.name == "posix":
        # PermissionError: only zombies are left in the group (macOS).
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, getattr(signal, name))
    elif process.poll() is None:
        subprocess.run(
            ["taskkill", "/T", "/F", "/PID", str(process.pid)],
            capture_output=True,
            check=False,
            creationflags=subprocess.CREATE_NO_WINDOW,
        )


def tail(path: Path, size: int = 20000) -> str:
    """Return the last bytes of a log as text; nothing where it cannot be read."""
    try:
        with open(path, "rb") as file:
            file.seek(max(0, path.stat().st_size - size))
            return file.read().decode("utf-8", "replace")
    except OSError:
        return ""


class Work(Protocol):
    """What goes on in a process of its own, and is looked at now and then."""

    state: str

    def start(self) -> None:
        """Begin."""

    def poll(self, wait: float = 0.0) -> list[Any]:
        """Tell what is new, after some seconds at most, and update the state."""

    def cancel(self) -> None:
        """End it."""


def wait_for(work: Work, progress: Callable[[Any], None] | None = None) -> None:
    """Start some work unless it is running, and wait until it is not any more.

    Parameters
    ----------
    work : Work
    progress : callable, optional
        Called with what is new.
    """
    try:
        if work.state != "running":
            work.start()
        while work.state == "running":
            for news in work.poll(wait=0.1):
                if progress:
                    progress(news)
    except BaseException:
        # Ctrl-C, or a fault in the caller's progress: the process must not go on
        work.cancel()
        raise
