# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One computation in a worker process: the side of FreeCAD, of macros and of the command line.

:mod:`HybridVolume.protocol` tells what the two sides share, :mod:`HybridVolume.worker` is the
other one. Importing this module needs the standard library only.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from HybridVolume.errors import HybridVolumeError, WorkerError, from_dict
from HybridVolume.protocol import (
    ELEMENTS,
    EXPORTS,
    FIELD_FILE,
    GOALS,
    LOG_FILE,
    MESH_EXPORTS,
    OPTIONS_FILE,
    OWN_FILE,
    PICTURES,
    PROTOCOL,
    REPORT_FILE,
    RESULT_FILE,
    SHELL_EXPORTS,
    SURFACE_EXPORTS,
    SURFACE_FILE,
    VOLUME_FILE,
    Progress,
    check_exports,
    exit_code,
    exported_files,
    parse_line,
)
from HybridVolume.worker_process import (
    PREFERENCES,
    WorkerProcess,
    tail,
    wait_for,
    worker_python,
)

if TYPE_CHECKING:
    import numpy as np

    from HybridVolume.core.hybrid import HybridVolume
    from HybridVolume.core.midstructure import Midstructure
    from HybridVolume.core.surface import SplineFace

__all__ = [
    "ELEMENTS",
    "EXPORTS",
    "FIELD_FILE",
    "GOALS",
    "MESH_EXPORTS",
    "OPTIONS_FILE",
    "OWN_FILE",
    "PICTURES",
    "PREFERENCES",
    "PROTOCOL",
    "REPORT_FILE",
    "RESULT_FILE",
    "SHELL_EXPORTS",
    "SURFACE_EXPORTS",
    "SURFACE_FILE",
    "VOLUME_FILE",
    "Job",
    "Progress",
    "exit_code",
    "exported_files",
    "worker_python",
]


class Job:
    """The completion of one body in a process of its own, or a part of it.

    ``prepare`` writes the input, ``start`` launches the worker, ``poll`` (from a timer) tells how
    far it is; ``run`` does the three and waits. Afterwards ``result`` and ``report`` read the
    answer, and ``close`` removes the folder. A job that fails or is cancelled removes it at once.

    Parameters
    ----------
    faces : sequence of SplineFace
        The faces of one closed body, as the file gives them (mm); of the goal mesh none.
    name : str
        Stem of the files that are exported.
    options : mapping, optional
        Keyword arguments of :class:`HybridVolume.core.pipeline.Options`.
    source : mapping, optional
        What is known about the input (its file), for the report.
    goal : {"volume", "midstructure", "thickness", "mesh"}
        What :meth:`result` gives: a ``HybridVolume``, a ``Midstructure``, the dict of
        :func:`HybridVolume.core.reached.expected_figures`, or the ``HybridVolume`` given with
        another finite element mesh.
    own : (vertices (m, 3), facets (f, 3)), optional
        Geometry for the midstructure ``own``, mm.
    volume : HybridVolume or path, optional
        Of the goal mesh: the volume whose shell is kept, or the file that it is stored in. Of the
        options only those of the mesh count: ``order``, ``engine`` and the fields of ``density``.
    exports : sequence of {"vtu", "inp", "png", "pictures", "mfem", "gismo", "core"}
        Only of the goals volume and mesh, the latter without pictures.
    elements : {"wedges", "hex20"}
        What the shell consists of in NAME.inp.
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
        volume: HybridVolume | str | os.PathLike | None = None,
        exports: Sequence[str] = (),
        elements: str = "wedges",
        python: str | None = None,
        free_only: bool = False,
        parent: str | os.PathLike | None = None,
    ) -> None:
        check_exports(tuple(exports), goal)
        if elements not in ELEMENTS:
            raise ValueError(f"unknown elements {elements!r}")
        if (goal == "mesh") != (volume is not None):
            raise ValueError("the goal mesh, and no other, needs a volume")
        self.faces = faces
        self.name = name
        self.options = dict(options or {})
        self.source = dict(source or {})
        self.goal = goal
        self.own = own
        self.volume = volume
        self.elements = elements
        self.exports = tuple(exports)
        self.python = python
        self.free_only = free_only
        self.parent = parent
        self.folder: Path | None = None
        self.state = "new"
        self.error: HybridVolumeError | None = None
        self.log = ""
        self._process: WorkerProcess | None = None
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
            "elements": self.elements,
        }
        try:
            text = json.dumps(task, indent=1)
            (self.folder / OPTIONS_FILE).write_text(text, encoding="utf-8")
            if self.goal == "mesh":
                self._write_volume()
            else:
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
        try:
            self._process = WorkerProcess(
                self.python,
                self.module,
                self.folder,
                self.folder / LOG_FILE,
                free_only=self.free_only,
            )
        except OSError as fault:
            error = WorkerError(f"the worker did not start: {fault}", remedy="check Preferences")
            self._end("failed", error)
            raise error from fault
        self.state = "running"

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
                line = self._process.line(wait)
                wait = 0.0
                if line is not None:
                    said = parse_line(line)
                    if isinstance(said, Progress):
                        news.append(said)
                    else:
                        self._answer = said
                if line is None or self._answer is not None:
                    self._finish()
        if self.state == "running" and self._process.gone:
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
        wait_for(self, progress)
        return self.outcome()

    def outcome(self) -> HybridVolume | Midstructure | dict:
        """The result of a job that has ended; raises what it failed with, as :meth:`run` does."""
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

        read = hybrid.load_midstructure if self.goal == "midstructure" else hybrid.load
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

    def _finish(self) -> None:
        """Turn the worker's answer, or its death, into the job's end."""
        answer = self._answer
        if answer is None:
            self._end("failed", self._process.death())
        elif "error" in answer:
            self._end("failed", from_dict(answer["error"]))
        else:
            absent = [name for name in self.answers() if not (self.folder / name).is_file()]
            if absent:
                self._end("failed", WorkerError(f"the worker did not write {', '.join(absent)}"))
            else:
                self._end("done", None)

    def _end(self, state: str, error: HybridVolumeError | None) -> None:
        self.state, self.error = state, error
        if self._process is not None:
            self._process.stop(gently=state == "done")
        if self.folder:
            self.log = tail(self.folder / LOG_FILE)
        if state != "done":
            self._remove_folder()

    def _write_volume(self) -> None:
        """Put the volume given into the folder."""
        path = self.folder / VOLUME_FILE
        if isinstance(self.volume, str | os.PathLike):
            shutil.copyfile(self.volume, path)
        else:
            self.volume.save(path)

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
