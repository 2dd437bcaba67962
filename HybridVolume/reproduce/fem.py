# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce fem -o DIR``: finite element meshes through CalculiX and through FreeCAD.

Writes ``fem.json`` (``patch_tests``, ``load_sums``, ``accuracy``) and ``fem.md`` (the part on
finite elements of docs/verification.md). Every case has a process of its own with a time limit.
Finished cases are kept in ``DIR/cases`` and not done again, unless the program or the body has
changed.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from HybridVolume.completion import Screen
from HybridVolume.core.surface import SplineFace
from HybridVolume.errors import HybridVolumeError, InputError, WorkerError
from HybridVolume.freecad_python import import_freecad
from HybridVolume.job import worker_python

from .cases import (
    BESIDES,
    CaseJob,
    add_case_arguments,
    chosen_cases,
    digest_of,
    one_thread_each,
    told_figures,
)
from .midstructure import BESIDE, EXAMPLES, body_files, write_json
from .shell import machine

VERSION = 1
"""Of the JSON files."""
PARTS = {"patch": "patch_tests", "loads": "load_sums", "accuracy": "accuracy"}
"""Parts, and what they are called in fem.json."""
BODIES = ("torus", "fandisk", "terrific_part_02")
"""Bodies of patch tests and sums of loads; others are added with ``--body``."""
OPTIONS: dict[str, dict[str, Any]] = {"torus": {"subdivide": 2}}
"""Options of bodies whose own cells are coarse: eight around the tube."""
RUNNING = 2
"""Cases that are worked on side by side."""
_SOURCES = {
    "volume": ("core/**/*.py", "reproduce/bodies.py"),
    "patch": ("core/**/*.py", "reproduce/calculix.py", "reproduce/fem_patch.py",
              "reproduce/fem_mesh.py", "reproduce/fem_rivals.py"),
    "loads": ("core/**/*.py", "objects/*.py", "exports/inp.py", "reproduce/calculix.py",
              "reproduce/fem_loads.py"),
    "accuracy": ("core/**/*.py", "reproduce/calculix.py", "reproduce/bodies.py",
                 "reproduce/fem_*.py"),
}  # fmt: skip
"""Files that decide whether a case has to be done again."""
_OTHERS = {
    "accuracy": (
        "fem_case.py",
        "fem_table.py",
        "fem_patch.py",
        "fem_loads.py",
        "fem_pictures.py",
        "fem_accuracy_table.py",
    )
}
"""Of these files, those that do not."""


class FemJob(CaseJob):
    """One case; its process writes it to the folder of cases."""

    module = "HybridVolume.reproduce.fem_case"


@dataclass
class Case:
    """One case.

    Attributes
    ----------
    name : str
        Of its file.
    part : {"volume", "patch", "loads", "accuracy"}
    case : str
        The body, or the name of the accuracy case.
    task : dict
        What its process is told besides.
    faces : sequence of SplineFace
        Of the body that is to be completed.
    after : Case or None
        What has to be there before.
    """

    name: str
    part: str
    case: str
    task: dict[str, Any] = field(default_factory=dict)
    faces: Sequence[SplineFace] = ()
    after: Case | None = None

    def key(self) -> str:
        """What the figures depend on."""
        words = repr((VERSION, _program(self.part), self.name, sorted(self.task.items())))
        digest = hashlib.sha256(words.encode())
        for face in self.faces:
            for array in (face.control_points, face.weights, *face.knots):
                digest.update(array.tobytes())
        if self.after is not None:
            digest.update(self.after.key().encode())
        return digest.hexdigest()[:16]


@cache
def _program(part: str) -> str:
    """What the numbers of a part are made by, as it was when this program started."""
    package = Path(__file__).resolve().parents[1]
    files = {path for pattern in _SOURCES[part] for path in package.glob(pattern)}
    return digest_of(path for path in files if path.name not in _OTHERS.get(part, ()))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command line takes."""
    parser.add_argument(
        "--body",
        action="append",
        metavar="NAME",
        help=f"patch tests and sums of loads of this body (repeatable; {', '.join(BODIES)})",
    )
    add_case_arguments(
        parser,
        1800.0,
        "case",
        data=BESIDES,
        parts=PARTS,
        example="names of cases as patch-torus",
    )


def run(options: argparse.Namespace) -> int:
    """Make all figures.

    Returns
    -------
    int
        0 when every demand that could be asked is met, else 1.

    Raises
    ------
    HybridVolumeError
        A file is not there, a name is unknown, or there is no worker.
    """
    from .fem_pictures import draw
    from .fem_table import as_markdown, demands

    started = time.perf_counter()
    folder = Path(options.output)
    for name in ("cases", "bodies", "volumes"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    bodies, missing = _bodies(options, folder / "bodies")
    cases = _chosen(_cases(bodies, folder), options.only)
    # two cases at a time, one thread each: their seconds do not depend on one another
    one_thread_each()
    runner = Runner(folder, options.time_limit, options.again)
    if not options.gather:
        runner.run(cases)
    found: dict[str, Any] = {
        "version": VERSION,
        "machine": machine(),
        "missing": missing,
        **runner.collected(cases),
    }
    found["demands"] = demands(found)
    found["pictures"] = []
    found["seconds"] = time.perf_counter() - started
    write_json(folder / "fem.json", found)
    if any(not case["error"] for case in found["accuracy"]):
        try:
            found["pictures"] = draw(folder, runner.python)
        except WorkerError as error:
            runner.screen.line(f"no pictures: {error.line}")
        write_json(folder / "fem.json", found)
    text = as_markdown(found)
    return told_figures(found, text, folder / "fem.md", runner.screen, PARTS.values())


@dataclass
class _Body:
    """A body, stored as FreeCAD reads it."""

    name: str
    words: str
    brep: Path
    faces: Sequence[SplineFace]
    split: int = 1
    error: HybridVolumeError | None = None


def _bodies(options: argparse.Namespace, folder: Path) -> tuple[list[_Body], list[str]]:
    """Bodies of patch tests and sums of loads, and names of those that are not there.

    Raises
    ------
    InputError
        A body is named that is neither made here nor in the files.
    """
    wanted = list(options.body or BODIES)
    if not _asked(options.only, ("patch", "loads")):
        return [], []
    found = {body.name: body for body in (*_made(wanted, folder), *_read(options, wanted, folder))}
    absent = [name for name in wanted if name not in found]
    if absent and options.body:
        raise InputError(f"{', '.join(absent)}: no such body", remedy="--data names further files")
    return [found[name] for name in wanted if name in found], absent


def _asked(only: Sequence[str] | None, parts: Sequence[str]) -> bool:
    return not only or any(word.split("-")[0] in parts for word in only)


def _made(wanted: Sequence[str], folder: Path) -> list[_Body]:
    """Bodies made here, written and read again, so that all have a shape of FreeCAD's."""
    from HybridVolume.core.assembly import build_surface

    from ..exports.step import write_solid
    from .shell_bodies import made_bodies

    import_freecad()
    from HybridVolume import sources

    bodies = []
    for made in made_bodies():
        if made.name in wanted:
            path = folder / f"{made.name}.brep"
            write_solid(path, build_surface(list(made.faces())))
            (body,) = sources.read_file(path)
            bodies.append(_Body(made.name, made.words, path, body.faces, made.split, body.error))
    return bodies


def _read(options: argparse.Namespace, wanted: Sequence[str], folder: Path) -> list[_Body]:
    """Bodies of files."""
    import_freecad()
    from HybridVolume import sources

    more = list(options.data or ([str(BESIDE)] if BESIDE.is_dir() else []))
    bodies = []
    for file in body_files([str(EXAMPLES), *more]):
        if not any(name.startswith(file.stem) for name in wanted):
            continue
        for body in sources.read_file(file, cover=False):
            if body.name in wanted:
                path = folder / f"{body.name}.brep"
                body.shape.exportBrep(str(path))
                bodies.append(_Body(body.name, file.name, path, body.faces, error=body.error))
    return bodies


def _cases(bodies: Sequence[_Body], folder: Path) -> list[Case]:
    """All cases, each after what it needs."""
    cases = []
    for body in bodies:
        if body.error:
            raise body.error
        stored = {
            "volume": str((folder / "volumes" / f"{body.name}.npz").resolve()),
            "words": body.words,
        }
        volume = Case(
            f"volume-{body.name}",
            "volume",
            body.name,
            {**stored, "split": body.split, "options": OPTIONS.get(body.name, {})},
            body.faces,
        )
        brep = {"brep": str(body.brep.resolve())}
        cases += [
            volume,
            Case(f"patch-{body.name}", "patch", body.name, stored, after=volume),
            Case(f"loads-{body.name}", "loads", body.name, {**stored, **brep}, after=volume),
        ]
    return cases + [Case(f"accuracy-{name}", "accuracy", name) for name in _accuracy_cases()]


def _accuracy_cases() -> tuple[str, ...]:
    if importlib.util.find_spec("HybridVolume.reproduce.fem_accuracy") is None:
        return ()
    from .fem_accuracy import CASES

    return tuple(CASES)


def _chosen(cases: Sequence[Case], only: Sequence[str] | None) -> list[Case]:
    """Cases that are asked for, and those that they need.

    Raises
    ------
    InputError
        A word is no part and no case.
    """
    chosen = chosen_cases(cases, only, PARTS)
    needed = {case.after.name for case in chosen if case.after} | {case.name for case in chosen}
    return [case for case in cases if case.name in needed]


class Runner:
    """Works on cases, two at a time.

    Parameters
    ----------
    folder : Path
    time_limit : float
        Seconds for a case.
    again : bool
        Do finished cases again.
    """

    def __init__(self, folder: Path, time_limit: float, again: bool) -> None:
        self.folder, self.time_limit, self.again = folder, time_limit, again
        self.cases = folder / "cases"
        self.screen = Screen()
        self.python = worker_python()
        self._done: set[str] = set()

    def run(self, cases: Sequence[Case]) -> None:
        """Make all cases that are not finished."""
        waiting = []
        for case in cases:
            if not self.again and self._finished(case):
                self._done.add(case.name)
            else:
                waiting.append(case)
        if self._done:
            self.screen.line(f"{len(self._done)} of {len(cases)} cases finished before")
        running: list[tuple[FemJob, Case, float]] = []
        try:
            while waiting or running:
                ready = [c for c in waiting if c.after is None or c.after.name in self._done]
                while ready and len(running) < RUNNING:
                    case = ready.pop(0)
                    waiting.remove(case)
                    if not self._lost_before(case):
                        running.append(self._start(case))
                for one in list(running):
                    if self._ended(*one):
                        running.remove(one)
        finally:
            for job, _, _ in running:
                job.close()

    def _lost_before(self, case: Case) -> bool:
        """Whether what a case needs is an error; the case then has the same one."""
        before = self.read(case.after.name) if case.after else None
        if not before or not before["error"]:
            return False
        # one that is tried again next time has no key, and so have those after it
        self._write(case, before["error"], case.key() if before.get("key") else "")
        self._done.add(case.name)
        return True

    def _start(self, case: Case) -> tuple[FemJob, Case, float]:
        (self.cases / f"{case.name}.json").unlink(missing_ok=True)
        options = {
            "words": "",
            **case.task,
            "cases": str(self.cases.resolve()),
            "name": case.name,
            "part": case.part,
            "case": case.case,
            "key": case.key(),
        }
        job = FemJob(case.faces, name=case.name, options=options, python=self.python)
        job.prepare()
        if case.part == "loads":
            # FreeCAD's modules belong to the Python that runs this
            job.python = sys.executable
        job.start()
        return job, case, time.perf_counter()

    def _ended(self, job: FemJob, case: Case, started: float) -> bool:
        """Whether a case's process is over."""
        for news in job.poll(wait=0.1):
            self.screen.progress(case.name, news)
        spent = time.perf_counter() - started
        error = job.error
        if job.state == "running":
            if spent < self.time_limit:
                return False
            job.cancel()
            error = WorkerError(
                f"not finished within {self.time_limit:g} s",
                figure=self.time_limit,
                remedy="raise --time-limit",
            )
        job.close()
        if self.read(case.name) is None:
            # without a key: tried again next time
            self._write(case, (error or WorkerError("the case was not made")).to_dict(), "")
        self._done.add(case.name)
        self.screen.line(f"{case.name}: {_words(self.read(case.name))}")
        return True

    def _write(self, case: Case, error: Mapping[str, Any], key: str) -> None:
        values = {
            "name": case.name, "part": case.part, "case": case.case, "key": key,
            "words": case.task.get("words", ""), "error": dict(error),
            "seconds": 0.0, "seconds_cpu": 0.0,
        }  # fmt: skip
        write_json(self.cases / f"{case.name}.json", values)

    def _finished(self, case: Case) -> bool:
        found = self.read(case.name)
        if found is None or found.get("key") != case.key():
            return False
        return case.part != "volume" or Path(case.task["volume"]).is_file()

    def read(self, name: str) -> dict[str, Any] | None:
        """A case that was written, if it can be read."""
        try:
            return json.loads((self.cases / f"{name}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None

    def collected(self, cases: Sequence[Case]) -> dict[str, Any]:
        """All finished cases, by their part, and the names of the others."""
        found: dict[str, Any] = {name: [] for name in PARTS.values()}
        found["volumes"], found["not_done"] = [], []
        for case in cases:
            values = self.read(case.name)
            if values is None or values.pop("key", "") != case.key():
                found["not_done"].append(case.name)
            if values is not None:
                found[PARTS.get(case.part, "volumes")].append(values)
        return found


def _words(case: Mapping[str, Any] | None) -> str:
    if not case:
        return "nothing"
    if case["error"]:
        return f"{case['error']['code']}: {case['error']['message']}"
    return f"done ({case['seconds_cpu']:.1f} s of the processor)"
