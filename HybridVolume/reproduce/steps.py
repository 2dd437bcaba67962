# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce steps -o DIR``: CAD bodies of any faces, the whole way to finite elements.

Writes ``steps.json`` and ``steps.md`` (the part on CAD bodies of docs/verification.md). Every body
has a process of its own with limits of time and memory. Finished bodies are kept in ``DIR/cases``
and not done again; the text tells which of them another version of the program made.
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
from .shell import machine
from .steps_bodies import BODIES

VERSION = 1
"""Of the JSON files."""
PARTS = {"scripted": "scripted", "files": "files"}
"""Parts, and what they are called in steps.json."""
DATA = PROJECT.parent / "shared" / "data"
ALONE = ("tesla_t_junctions.step", "moebius_torus.step")
"""Files that are needed besides those in folders called ``trimmed``."""
SOLIDS = {"as1": 18}
"""Bodies in files that have more than one."""
SUFFIXES = (".step", ".stp", ".brep", ".brp")
SECONDS = 1200.0
"""Of the processor, for a body: more than covering may take, so that its refusal is told."""
MEMORY = 8 << 30
"""Bytes of address space of each process."""
WAIT = (5.0, 120.0)
"""Seconds by the clock for each second of the processor, which others may use too, and besides, for
measuring."""
_SOURCES = ("core/**/*.py", "sources/*.py", "objects/*.py", "*.py")


class StepJob(CaseJob):
    """One body; its process writes it to the folder of cases."""

    module = "HybridVolume.reproduce.steps_case"


@dataclass
class Case:
    """One file.

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
        None for one that is made by script.
    """

    name: str
    part: str
    case: str
    task: dict[str, Any] = field(default_factory=dict)
    file: Path | None = None
    after: None = None
    """No case waits for another one."""

    def key(self) -> str:
        """What the figures depend on, besides the program."""
        digest = hashlib.sha256(repr((VERSION, self.name, self.task["words"])).encode())
        if self.file is not None:
            digest.update(self.file.read_bytes())
        return digest.hexdigest()[:16]


@cache
def program() -> str:
    """The program as it was when this command started."""
    package = Path(__file__).resolve().parents[1]
    return digest_of(path for pattern in _SOURCES for path in package.glob(pattern))[:16]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command line takes."""
    add_case_arguments(
        parser,
        SECONDS,
        "body, of the processor",
        data="STEP and BREP files, or folders that have them in a folder `trimmed` (default: "
        "../shared/data)",
        parts=PARTS,
        example="names of bodies as drilled",
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
    from .steps_pictures import draw
    from .steps_table import as_markdown, demands

    started = time.perf_counter()
    folder = Path(options.output)
    (folder / "cases").mkdir(parents=True, exist_ok=True)
    every, missing = all_cases(folder, options.data, options.time_limit)
    cases = chosen_cases(every, options.only, PARTS)
    # two bodies at a time, one thread each: their seconds do not depend on one another
    one_thread_each()
    longest = max((case.task["seconds_limit"] for case in cases), default=options.time_limit)
    runner = StepRunner(folder, WAIT[0] * longest + WAIT[1], options.again)
    if not options.gather:
        import_freecad()
        runner.run(cases)
    found: dict[str, Any] = {
        "version": VERSION,
        "machine": machine(),
        "missing": missing,
        "whole": len(cases) == len(every),
        "limits": {"seconds": options.time_limit, "memory": MEMORY},
        **runner.collected(cases),
    }
    found["other_programs"] = [
        case["name"]
        for part in PARTS.values()
        for case in found[part]
        if case.get("program") != program()
    ]
    found["demands"] = demands(found)
    found["pictures"] = []
    try:
        found["pictures"] = draw(folder, runner.python)
    except WorkerError as error:
        runner.screen.line(f"no pictures: {error.line}")
    found["seconds"] = time.perf_counter() - started
    write_json(folder / "steps.json", found)
    text = as_markdown(found)
    return told_figures(found, text, folder / "steps.md", runner.screen, PARTS.values())


def step_files(given: Sequence[str] | None) -> dict[str, Path]:
    """Files by their names, of folders those that are wanted.

    Parameters
    ----------
    given : sequence of str, optional
        Files and folders.
    """
    found: dict[str, Path] = {}
    for path in map(Path, given or ([str(DATA)] if DATA.is_dir() else [])):
        if path.is_dir():
            inside = [*path.glob("trimmed/*"), *(path.glob("*") if path.name == "trimmed" else ())]
            inside += [one for name in ALONE for one in path.rglob(name)]
        else:
            inside = [path]
        for one in sorted(inside):
            if one.suffix.lower() in SUFFIXES:
                found.setdefault(one.name, one.resolve())
    return found


def all_cases(
    folder: Path, data: Sequence[str] | None, seconds: float
) -> tuple[list[Case], list[str]]:
    """All cases, the longest first, and names of files that are not there.

    Parameters
    ----------
    folder : Path
        Where the volumes are written.
    data : sequence of str, optional
        Files and folders.
    seconds : float
        Of the processor for a body.
    """
    files = step_files(data)

    def task(name: str, bodies: int = 1, **more: Any) -> dict[str, Any]:
        return {
            "words": [],
            "output": str((folder / "volumes" / name).resolve()),
            "seconds_limit": seconds * bodies,
            "memory_limit": MEMORY,
            **more,
        }

    cases = [
        Case(path.stem, "files", path.name,
             task(path.stem, SOLIDS.get(path.stem, 1), file=str(path)), path)
        for path in files.values()
    ]  # fmt: skip
    cases.sort(key=lambda case: -case.task["seconds_limit"])
    cases += [Case(one.name, "scripted", one.name, task(one.name)) for one in BODIES]
    missing = [name for name in ALONE if name not in files]
    if not any(path.parent.name == "trimmed" for path in files.values()):
        missing.append("trimmed/*")
    return cases, missing


class StepRunner(Runner):
    """Works on files, two at a time, in FreeCAD's Python."""

    def _start(self, case: Case) -> tuple[StepJob, Case, float]:
        (self.cases / f"{case.name}.json").unlink(missing_ok=True)
        own = {
            **case.task,
            "cases": str(self.cases.resolve()),
            "name": case.name,
            "part": case.part,
            "case": case.case,
            "key": case.key(),
            "program": program(),
        }
        job = StepJob((), name=case.name, options=own, python=self.python)
        job.prepare()
        # FreeCAD's modules belong to the Python that runs this
        job.python = sys.executable
        job.start()
        return job, case, time.perf_counter()

    def _finished(self, case: Case) -> bool:
        # a fault is no figure: it is tried again
        found = self.read(case.name)
        return super()._finished(case) and not found["error"] and found["state"] != "failed"

    def _ended(self, job: StepJob, case: Case, started: float) -> bool:
        over = super()._ended(job, case, started)
        if over:
            self.screen.line(f"{case.name}: {_words(self.read(case.name))}")
        return over

    def collected(self, cases: Sequence[Case]) -> dict[str, Any]:
        """All finished cases, by their part, and the names of the others."""
        found: dict[str, Any] = {name: [] for name in PARTS.values()}
        found["not_done"] = []
        for case in cases:
            values: Mapping[str, Any] | None = self.read(case.name)
            if values is None or values.get("key") != case.key():
                found["not_done"].append(case.name)
            if values is not None:
                found[PARTS[case.part]].append(values)
        return found


def _words(case: Mapping[str, Any] | None) -> str:
    if not case or case["error"]:
        return "nothing"
    found = "; ".join(
        f"w0 {body['w0']:.2f}, {body['patches']} patches, {body['nodes']} nodes, "
        f"{body['faces_found']} of {body['faces_asked']} faces"
        for body in case["bodies"]
    )
    said = "; ".join(case["said"])
    return f"{case['state']} {' | '.join(text for text in (found, said) if text)}"
