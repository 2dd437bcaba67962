# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce quads -o DIR``: quad meshes and cages, the whole way to finite elements.

Writes ``quads.json`` (``cases``, ``many_patches``, ``smoothness``, ``limit_distance``,
``exactness``, ``broken``) and ``quads.md`` (the part on quad meshes of docs/verification.md). Every
case has a process of its own with a time limit. Finished cases are kept in ``DIR/cases`` and not
done again, unless the program or the file has changed.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from HybridVolume.errors import WorkerError
from HybridVolume.freecad_python import import_freecad

from .cases import (
    CaseJob,
    add_case_arguments,
    chosen_cases,
    digest_of,
    one_thread_each,
    told_figures,
)
from .fem import Runner
from .midstructure import PROJECT, write_json
from .quads_broken import catalogue
from .quads_inputs import INPUTS, MANY, SHELL, SURFACES, VALENCES, mesh_files
from .shell import machine

VERSION = 1
"""Of the JSON files."""
PARTS = {
    "cases": "cases",
    "many": "many_patches",
    "smoothness": "smoothness",
    "limit": "limit_distance",
    "exactness": "exactness",
    "broken": "broken",
}
"""Parts, and what they are called in quads.json."""
DATA = PROJECT.parent / "shared" / "data"
TORUS_CELLS = (76, 31)
"""Quads of the torus that ant is measured against: its patches have as many control points."""
MANY_CASES = ("ant-patches", "ant-joined", "torus")
BROKEN_LIMIT = 240.0
"""Seconds for a broken mesh, which is small."""
_SOURCES = ("core/**/*.py", "sources/*.py", "solids.py", "completion.py")
_OWN = {
    "cases": ("quads_case.py", "quads_shell.py", "quads_clock.py"),
    "many": ("quads_case.py", "quads_clock.py", "quads_inputs.py"),
    "smoothness": ("quads_smoothness.py", "quads_pieces.py"),
    "limit": ("quads_limit.py", "quads_pieces.py"),
    "exactness": ("quads_exactness.py",),
    "broken": ("quads_case.py", "quads_broken.py"),
}
"""Files that decide whether a case has to be done again, of the package and of this folder."""


class QuadJob(CaseJob):
    """One case; its process writes it to the folder of cases."""

    module = "HybridVolume.reproduce.quads_case"


@dataclass
class Case:
    """One case.

    Attributes
    ----------
    name : str
        Of its file.
    part : str
        One of ``PARTS``.
    case : str
        What it is about.
    task : dict
        What its process is told besides.
    file : Path or None
        The mesh that it needs.
    """

    name: str
    part: str
    case: str
    task: dict[str, Any] = field(default_factory=dict)
    file: Path | None = None
    after: None = None
    """No case waits for another one."""

    def key(self) -> str:
        """What the figures depend on."""
        told = {name: value for name, value in self.task.items() if name != "output"}
        words = repr((VERSION, _program(self.part), self.name, sorted(told.items())))
        digest = hashlib.sha256(words.encode())
        if self.file is not None:
            digest.update(self.file.read_bytes())
        return digest.hexdigest()[:16]


@cache
def _program(part: str) -> str:
    """What the numbers of a part are made by, as it was when this program started."""
    package = Path(__file__).resolve().parents[1]
    files = {path for pattern in _SOURCES for path in package.glob(pattern)}
    return digest_of(files | {Path(__file__).parent / name for name in _OWN[part]})


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command line takes."""
    add_case_arguments(
        parser,
        1500.0,
        "case",
        data="mesh files, or folders that have them (default: ../shared/data)",
        parts=PARTS,
        example="names of cases as fish",
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
        A name is unknown, or there is no worker.
    """
    from .quads_demands import demands
    from .quads_pictures import draw
    from .quads_table import as_markdown

    started = time.perf_counter()
    folder = Path(options.output)
    (folder / "cases").mkdir(parents=True, exist_ok=True)
    files = mesh_files(options.data or ([DATA] if DATA.is_dir() else []))
    every, missing = all_cases(files, folder)
    cases = chosen_cases(every, options.only, PARTS)
    # two cases at a time, one thread each: their seconds do not depend on one another
    one_thread_each()
    runner = QuadRunner(folder, options.time_limit, options.again)
    if not options.gather:
        import_freecad()
        runner.run(cases)
    found: dict[str, Any] = {
        "version": VERSION,
        "machine": machine(),
        "missing": missing,
        **runner.collected(cases),
    }
    found["demands"] = demands(found)
    found["pictures"] = []
    if any(not case["error"] for case in found["cases"]):
        try:
            found["pictures"] = draw(folder, runner.python)
        except WorkerError as error:
            runner.screen.line(f"no pictures: {error.line}")
    found["seconds"] = time.perf_counter() - started
    write_json(folder / "quads.json", found)
    text = as_markdown(found)
    return told_figures(found, text, folder / "quads.md", runner.screen, PARTS.values())


def all_cases(files: Mapping[str, Path], folder: Path) -> tuple[list[Case], list[str]]:
    """All cases, the longest first, and names of files that are not there.

    Parameters
    ----------
    files : mapping of str to Path
        As of :func:`mesh_files`.
    folder : Path
        Where the volumes are written.
    """
    wanted = dict.fromkeys([*(one.file for one in INPUTS), *SURFACES, MANY])
    missing = [name for name in wanted if name not in files]
    cases = []
    for one in INPUTS:
        if one.file in files:
            task = {
                "input": one.file, "file": str(files[one.file]), "scheme": one.scheme,
                "way": one.way, "words": ["--scheme", one.scheme],
                "output": str((folder / "volumes" / one.name).resolve()),
            }  # fmt: skip
            cases.append(Case(one.name, "cases", one.name, task, files[one.file]))
    return [
        *cases,
        *_many(files, folder),
        *_surfaces(files),
        *(Case(f"exactness-{name}", "exactness", name, {"body": name}) for name in _bodies()),
        *(
            Case(f"broken-{one.name}", "broken", one.name,
                 {"mesh": one.name, "time_limit": BROKEN_LIMIT})
            for one in catalogue()
        ),
    ], missing  # fmt: skip


def _many(files: Mapping[str, Path], folder: Path) -> list[Case]:
    """A body of thousands of patches, and bodies of as many control points in few patches."""
    if MANY not in files:
        return []
    file = {"file": str(files[MANY])}
    tasks: dict[str, dict[str, Any]] = {
        "ant-patches": {**file, "words": ["--scheme", "bilinear"]},
        "ant-joined": {**file, "made": "joined", "words": []},
        "torus": {
            "made": "torus",
            "cells": list(TORUS_CELLS),
            "words": ["--scheme", "catmull-clark", "--steps", "0"],
        },
    }
    return [
        Case(f"many-{name}", "many", name,
             {**tasks[name], "output": str((folder / "volumes" / f"many-{name}").resolve())},
             files[MANY])
        for name in MANY_CASES
    ]  # fmt: skip


def _surfaces(files: Mapping[str, Path]) -> list[Case]:
    """Smoothness of all meshes and of spindles of many valences, and distances from limits."""
    cases = []
    for name in SURFACES:
        if name in files:
            stem, path = Path(name).stem, files[name]
            for scheme in ("smooth", "catmull-clark"):
                cases.append(Case(f"smoothness-{stem}-{scheme}", "smoothness", stem,
                                  {"file": str(path), "scheme": scheme}, path))  # fmt: skip
            cases.append(Case(f"limit-{stem}", "limit", stem, {"file": str(path)}, path))
    for valence in VALENCES:
        cases.append(Case(f"smoothness-spindle-{valence}", "smoothness", f"spindle {valence}",
                          {"spindle": valence, "scheme": "smooth"}))  # fmt: skip
    cases.append(Case("limit-torus", "limit", "torus of regular quads", {"torus": [12, 8]}))
    return cases


def _bodies() -> tuple[str, ...]:
    from .quads_exactness import BODIES

    return BODIES


class QuadRunner(Runner):
    """Works on cases of quad meshes, two at a time, in FreeCAD's Python."""

    def _start(self, case: Case) -> tuple[QuadJob, Case, float]:
        (self.cases / f"{case.name}.json").unlink(missing_ok=True)
        own = {
            **case.task,
            "cases": str(self.cases.resolve()),
            "name": case.name,
            "part": "shell" if case.task.get("way") == SHELL else case.part,
            "case": case.case,
            "key": case.key(),
        }
        job = QuadJob((), name=case.name, options=own, python=self.python)
        job.prepare()
        # FreeCAD's modules belong to the Python that runs this
        job.python = sys.executable
        job.start()
        return job, case, time.perf_counter()

    def collected(self, cases: Sequence[Case]) -> dict[str, Any]:
        """All finished cases, by their part, and the names of the others."""
        found: dict[str, Any] = {name: [] for name in PARTS.values()}
        found["not_done"] = []
        for case in cases:
            values = self.read(case.name)
            if values is None or values.pop("key", "") != case.key():
                found["not_done"].append(case.name)
            if values is not None:
                found[PARTS[case.part]].append(values)
        return found
