# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One computation in a worker process: the side of FreeCAD, of macros and of the command line.

The two sides share a folder and two pipes. The folder holds what :meth:`Job.prepare` writes
(:data:`OPTIONS_FILE`, :data:`SURFACE_FILE`, with geometry of the user's :data:`OWN_FILE`) and what
the worker answers (:data:`RESULT_FILE` or, by the goal, :data:`FIELD_FILE`; :data:`REPORT_FILE`
and the exports). On its output the
worker writes one JSON object a line: ``{"stage", "fraction", "text"}`` while it works, then
``{"done": true}`` or ``{"error": {...}}``. Its input carries nothing and stays open: when it
closes, our process is gone and the worker ends.

Importing this module needs the standard library only; :mod:`HybridVolume.worker` is the other side.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from HybridVolume import environment
from HybridVolume.errors import (
    FileFormatError,
    HybridVolumeError,
    InputError,
    SetupError,
    ThicknessError,
    WorkerError,
    from_dict,
)

if TYPE_CHECKING:
    import numpy as np

    from HybridVolume.core.hybrid import HybridVolume
    from HybridVolume.core.midstructure import Midstructure
    from HybridVolume.core.surface import SplineFace

PROTOCOL = 2
GOALS = ("volume", "midstructure", "thickness")
"""What a job ends with: the hybrid volume, the midstructure alone, or how thick a shell will be."""

OPTIONS_FILE = "job.json"
SURFACE_FILE = "surface.npz"
OWN_FILE = "own.npz"
RESULT_FILE = "result.npz"
FIELD_FILE = "field.npz"
REPORT_FILE = "report.json"
LOG_FILE = "worker.log"
EXPORTS = ("vtu", "inp", "png")
"""What a worker can write besides the result, each as ``NAME.<export>``."""
PICTURES = ("field", "columns", "shell", "level", "thickness", "histogram", "worst")
"""What the export ``pictures`` writes, each as ``NAME_<picture>.png``."""

PREFERENCES = "User parameter:BaseApp/Preferences/Mod/HybridVolume"
GRACE = 2.0
"""Seconds between asking a worker to end and killing it."""


@dataclass(frozen=True)
class Progress:
    """How far a worker is: the stage's name, the share of the whole work done, a line of text."""

    stage: str
    fraction: float
    text: str


def exit_code(error: BaseException) -> int:
    """2 for an input that is refused, 1 for a fault of this program or its surroundings."""
    return 2 if isinstance(error, InputError | ThicknessError | FileFormatError) else 1


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


def exported_files(name: str, export: str) -> list[str]:
    """Names of the files of one export of a body.

    Parameters
    ----------
    name : str
        Stem of the files.
    export : {"vtu", "inp", "png", "pictures"}
    """
    if export == "pictures":
        return [f"{name}_{picture}.png" for picture in PICTURES]
    return [f"{name}.{export}"]


class Job:
    """The completion of one body in a process of its own, or a part of it.

    ``prepare`` writes the input, ``start`` launches the worker, ``poll`` (from a timer) tells how
    far it is; ``run`` does the three and waits. Afterwards ``result`` and ``report`` read the
    answer, and ``close`` removes the folder. A job that fails or is cancelled removes it at once.

    Parameters
    ----------
    faces : sequence of SplineFace
        The faces of one closed body, as the file gives them (mm).
    name : str
        Stem of the files that are exported.
    options : mapping, optional
        Keyword arguments of :class:`HybridVolume.core.pipeline.Options`.
    source : mapping, optional
        What is known about the input (its file), for the report.
    goal : {"volume", "midstructure", "thickness"}
        What :meth:`result` gives: a ``HybridVolume``, a ``Midstructure``, or the dict of
        :func:`HybridVolume.core.reached.expected_figures`.
    own : (vertices (m, 3), facets (f, 3)), optional
        Geometry for the midstructure ``own``, mm.
    exports : sequence of {"vtu", "inp", "png", "pictures"}
        Only of a volume.
    python : str, optional
        Interpreter of the worker; :func:`worker_python` otherwise.
    free_only : bool
        Leave the GPL parts out.
    parent : path, optional
        Where the job's folder is made; the system's temporary folder otherwise.

    Attributes
    ----------
    folder : Path or None
    state : {"new", "prepared", "running", "done", "failed", "cancelled"}
    error : HybridVolumeError or None
        Why the job failed or ended.
    log : str
        The last lines of the worker's log, kept when the folder is removed.
    """

    module = "HybridVolume.worker"
    """What runs in the worker's process."""

    def __init__(
        self,
        faces: Sequence[SplineFace],
        *,
        name: str = "body",
        options: Mapping[str, Any] | None = None,
        source: Mapping[str, Any] | None = None,
        goal: str = "volume",
        own: tuple[np.ndarray, np.ndarray] | None = None,
        exports: Sequence[str] = (),
        python: str | None = None,
        free_only: bool = False,
        parent: str | os.PathLike | None = None,
    ) -> None:
        unknown = set(exports) - set((*EXPORTS, "pictures") if goal == "volume" else ())
        if unknown:
            raise ValueError(f"unknown exports {sorted(unknown)} of a {goal}")
        if goal not in GOALS:
            raise ValueError(f"unknown goal {goal!r}")
        self.faces = faces
        self.name = name
        self.options = dict(options or {})
        self.source = dict(source or {})
        self.goal = goal
        self.own = own
        self.exports = tuple(exports)
        self.python = python
        self.free_only = free_only
        self.parent = parent
        self.folder: Path | None = None
        self.state = "new"
        self.error: HybridVolumeError | None = None
        self.log = ""
        self._process: subprocess.Popen | None = None
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._answer: dict | None = None

    def __enter__(self) -> Job:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def prepare(self) -> Path:
        """Write the worker's input into a new folder and return the folder.

        Raises
        ------
        SetupError
            There is no interpreter for the worker.
        """
        from HybridVolume import exchange

        self.python = worker_python(self.python)
        self.folder = Path(tempfile.mkdtemp(prefix="hybridvolume-", dir=self.parent))
        task = {
            "protocol": PROTOCOL,
            "name": self.name,
            "options": self.options,
            "source": self.source,
            "goal": self.goal,
            "exports": list(self.exports),
        }
        try:
            text = json.dumps(task, indent=1)
            (self.folder / OPTIONS_FILE).write_text(text, encoding="utf-8")
            exchange.write_surface(self.folder / SURFACE_FILE, self.faces)
            if self.own is not None:
                exchange.write_own(self.folder / OWN_FILE, *self.own)
        except BaseException:
            self._remove_folder()
            raise
        self.state = "prepared"
        return self.folder

    def start(self) -> None:
        """Launch the worker; return at once.

        Raises
        ------
        WorkerError
            The process cannot be made.
        """
        if self.state == "new":
            self.prepare()
        if self.state != "prepared":
            raise RuntimeError(f"a job that is {self.state} cannot be started")
        command = [self.python, "-m", self.module, str(self.folder)]
        try:
            with open(self.folder / LOG_FILE, "wb") as log:
                self._process = subprocess.Popen(
                    command,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=log,
                    env=_variables(self.folder, self.free_only),
                    # A group of its own: Cancel must reach the meshers that the worker starts,
                    # and Ctrl-C in a terminal must not reach the worker before us.
                    **_new_group(),
                )
        except OSError as fault:
            error = WorkerError(f"the worker did not start: {fault}", remedy="check Preferences")
            self._end("failed", error)
            raise error from fault
        self.state = "running"
        # A thread reads the pipe: that works on every system, and nothing of FreeCAD runs in it.
        threading.Thread(target=self._read_lines, daemon=True).start()

    def poll(self, wait: float = 0.0) -> list[Progress]:
        """Return the progress since the last call; update ``state`` and ``error``.

        Parameters
        ----------
        wait : float
            Seconds to wait for the first line.
        """
        news: list[Progress] = []
        if self.state != "running":
            return news
        with contextlib.suppress(queue.Empty):
            while self.state == "running":
                line = self._lines.get(timeout=wait) if wait else self._lines.get_nowait()
                wait = 0.0
                if line is not None:
                    self._take(line, news)
                if line is None or self._answer is not None:
                    self._finish()
        # Killed, the worker may leave children that hold the pipe open: its death is seen here.
        if self.state == "running" and self._process.poll() is not None and self._lines.empty():
            self._finish()
        return news

    def run(
        self, progress: Callable[[Progress], None] | None = None
    ) -> HybridVolume | Midstructure | dict:
        """Prepare, start, wait, and return the result (blocking: for macros and scripts).

        Raises
        ------
        HybridVolumeError
            What the worker found, or :class:`WorkerError` where it died; a fault carries the
            worker's log as a note.
        """
        try:
            self.start()
            while self.state == "running":
                for news in self.poll(wait=0.1):
                    if progress:
                        progress(news)
        except BaseException:
            # Ctrl-C, or a fault in the caller's progress: the worker must not go on.
            self.cancel()
            raise
        if self.error:
            if self.log and self.error.code in ("fault", "mesher", "worker"):
                self.error.add_note(self.log)
            raise self.error
        return self.result()

    def cancel(self) -> None:
        """End the worker and everything it started, and remove the folder."""
        if self.state in ("prepared", "running"):
            self._end("cancelled", WorkerError("the computation was cancelled"))

    def close(self) -> None:
        """Cancel if need be, and remove the folder."""
        self.cancel()
        self._remove_folder()

    def result(self) -> HybridVolume | Midstructure | dict:
        """Read what the worker wrote, by the goal."""
        if self.goal == "thickness":
            return self.report()["thickness"]
        from HybridVolume.core import hybrid

        read = hybrid.load if self.goal == "volume" else hybrid.load_midstructure
        return read(self.result_file)

    @property
    def result_file(self) -> Path:
        """Path of the stored hybrid volume or midstructure."""
        return self._file(RESULT_FILE)

    @property
    def field_file(self) -> Path:
        """Path of the harmonic field, as :class:`HybridVolume.core.field_view.FieldView` reads it.

        Only of the goal ``thickness``.
        """
        return self._file(FIELD_FILE)

    def report(self) -> dict:
        """Read the worker's part of report.json (docs/report.md)."""
        return json.loads(self._file(REPORT_FILE).read_text(encoding="utf-8"))

    def exported(self, export: str) -> Path:
        """Return the path of an exported file."""
        return self._file(f"{self.name}.{export}")

    def exported_files(self, export: str) -> list[Path]:
        """Return the paths of all files of an export."""
        return [self._file(name) for name in exported_files(self.name, export)]

    def _file(self, name: str) -> Path:
        if self.state != "done" or self.folder is None:
            raise RuntimeError(f"a job that is {self.state} has no {name}")
        return self.folder / name

    def answers(self) -> list[str]:
        """Names of the files that a worker must have written."""
        exported = [file for export in self.exports for file in exported_files(self.name, export)]
        names = [REPORT_FILE, *exported]
        return [FIELD_FILE if self.goal == "thickness" else RESULT_FILE, *names]

    def _read_lines(self) -> None:
        with contextlib.suppress(ValueError, OSError):  # closed while we read: cancelled
            for line in self._process.stdout:
                self._lines.put(line.decode("utf-8", "replace"))
        self._lines.put(None)

    def _take(self, line: str, news: list[Progress]) -> None:
        try:
            values = json.loads(line)
            if "stage" in values:
                fraction = min(max(float(values["fraction"]), 0.0), 1.0)
                news.append(Progress(str(values["stage"]), fraction, str(values["text"])))
            elif "done" in values or "error" in values:
                self._answer = values
            else:
                raise ValueError("neither progress nor answer")
        except (ValueError, TypeError, KeyError) as fault:
            self._answer = {
                "error": WorkerError(f"the worker wrote {line.strip()[:80]!r}: {fault}").to_dict()
            }

    def _finish(self) -> None:
        """Turn the worker's answer, or its death, into the job's end."""
        answer = self._answer
        if answer is None:
            self._end("failed", self._death())
        elif "error" in answer:
            self._end("failed", from_dict(answer["error"]))
        else:
            absent = [name for name in self.answers() if not (self.folder / name).is_file()]
            if absent:
                self._end("failed", WorkerError(f"the worker did not write {', '.join(absent)}"))
            else:
                self._end("done", None)

    def _death(self) -> WorkerError:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(GRACE)
        code = self._process.poll()
        if code is None:
            return WorkerError("the worker closed its output and goes on")
        if code >= 0:
            lines = _tail(self.folder / LOG_FILE).strip().splitlines() or ["no reason"]
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

    def _end(self, state: str, error: HybridVolumeError | None) -> None:
        self.state, self.error = state, error
        self._stop_process(gently=state == "done")
        if self.folder:
            self.log = _tail(self.folder / LOG_FILE)
        if state != "done":
            self._remove_folder()

    def _stop_process(self, gently: bool) -> None:
        process = self._process
        if process is None:
            return
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

    def _remove_folder(self) -> None:
        if self.folder is None:
            return
        # Windows lets go of a killed process's files a little later.
        for pause in (0.0, 0.1, 0.5, 1.0):
            time.sleep(pause)
            shutil.rmtree(self.folder, ignore_errors=True)
            if not self.folder.exists():
                break
        self.folder = None


def _variables(folder: Path, free_only: bool) -> dict[str, str]:
    """Variables for the worker: its Python must find its own libraries, and our package."""
    variables = dict(os.environ)
    for name in ("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP"):
        variables.pop(name, None)
    if "APPDIR" in variables:
        # An AppImage's libraries belong to its own programs.
        for name in ("LD_LIBRARY_PATH", "LD_PRELOAD"):
            variables.pop(name, None)
    variables["PYTHONPATH"] = str(Path(__file__).resolve().parent.parent)
    variables["PYTHONIOENCODING"] = "utf-8"
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


def _tail(path: Path, size: int = 20000) -> str:
    try:
        with open(path, "rb") as file:
            file.seek(max(0, path.stat().st_size - size))
            return file.read().decode("utf-8", "replace")
    except OSError:
        return ""
