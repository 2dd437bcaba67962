# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce dynamics -o DIR``: elastic hybrid volumes in motion, in space.

An elastic fandisk that falls onto a plane and bounces (the paper's video), energies over time,
frames as pictures and as a series for ParaView; bodies in free flight by each rule in time; natural
frequencies of a sphere beside the exact ones; the energy of rigid motions. Writes ``dynamics.json``
and ``dynamics.md``. Every case has a process of its own with a time limit; finished ones are kept
in ``DIR/cases`` and not done again, unless what moves bodies, or the body, has changed.
"""

from __future__ import annotations

import argparse
import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from HybridVolume.core.surface import SplineFace
from HybridVolume.errors import WorkerError

from . import fem
from .bodies import box, sphere, torus
from .cases import (
    BESIDES,
    CaseJob,
    add_case_arguments,
    chosen_cases,
    one_thread_each,
    told_figures,
)
from .midstructure import write_json
from .rates3d import read_bodies
from .shell import machine

VERSION = 1
"""Of the JSON file."""
PARTS = ("drops", "flights", "modes", "rest")
MADE = {
    "box": lambda: box((3.0, 2.0, 1.0), (1, 1, 1)),
    "torus": lambda: torus(3.0, 1.0),
    "sphere": lambda: sphere(1.0),
}
"""Bodies that are made here."""
READ = ("fandisk", "twisted_fichera")
"""Bodies of files."""
RULES = ("newmark", "midpoint", "conserving")
_STEPS = ("svk", "layout", "newmark", "newton", "contact")
_SOURCES = {"drops": _STEPS, "flights": _STEPS, "modes": ("modal",), "rest": ("svk", "nitsche_svk")}
"""Modules of the analysis that decide whether a case of a part has to be done again."""


class MotionJob(CaseJob):
    """One case; its process writes it to the folder of cases."""

    module = "HybridVolume.reproduce.dynamics_case"


@dataclass(frozen=True)
class Asked:
    """A case as it is asked for.

    Attributes
    ----------
    part : {"drops", "flights", "modes", "rest"}
    body : str
    task : dict
        ``k`` and ``coupling`` of the core, and what the part needs besides.
    small : bool
        Whether it is part of the small run.
    name : str
        Of the case and its file.
    """

    part: str
    body: str
    task: dict[str, Any]
    small: bool = False

    @property
    def name(self) -> str:
        """Of the case and its file."""
        words = [self.part, self.body, *(str(self.task[w]) for w in ("rule",) if w in self.task)]
        if self.part in ("modes", "rest"):
            words += [f"k{self.task['k']}", self.task["coupling"]]
        return "-".join(words) + ("-small" if self.small else "")


def _coupled(k: int, coupling: str = "collocation", **more: Any) -> dict[str, Any]:
    return {"k": k, "coupling": coupling, **more}


_BOX_DROP = {"up": (0.3, 0.2, 1.0), "young": 0.004, "contact": 10.0, "step": 1e-3, "steps": 12,
             "every": 6, "pictures": 3}  # fmt: skip
ASKED = (
    Asked("drops", "fandisk", _coupled(1, p=2, drop={})),
    *(Asked("flights", "torus", _coupled(1, own_spans=True, p=2, rule=rule, steps=24))
      for rule in RULES),
    Asked("modes", "sphere", _coupled(2, own_spans=True, p=4, levels=2)),
    Asked("modes", "sphere", _coupled(2, "nitsche", own_spans=True, p=4, levels=2)),
    Asked("modes", "sphere", _coupled(3, "nitsche", own_spans=True, p=4, levels=2)),
    *(Asked("rest", body, _coupled(2, coupling, own_spans=own))
      for body, own in (("sphere", True), ("torus", True))
      for coupling in ("collocation", "nitsche")),
    Asked("rest", "fandisk", _coupled(1)),
    Asked("drops", "box", _coupled(2, own_spans=True, drop=_BOX_DROP), small=True),
    Asked("flights", "box", _coupled(2, own_spans=True, rule="conserving", steps=6), small=True),
    Asked("modes", "sphere", _coupled(2, own_spans=True, p=4, levels=2), small=True),
    Asked("rest", "torus", _coupled(2, "nitsche", own_spans=True), small=True),
)  # fmt: skip


@dataclass
class Case:
    """A case with its body.

    Attributes
    ----------
    asked : Asked
    faces : sequence of SplineFace
    """

    asked: Asked
    faces: Sequence[SplineFace] = ()
    after: None = field(default=None, init=False)

    @property
    def name(self) -> str:
        """Of its file."""
        return self.asked.name

    @property
    def part(self) -> str:
        """The part of the tables that it belongs to."""
        return self.asked.part

    def key(self) -> str:
        """What the figures depend on."""
        digest = hashlib.sha256(repr((VERSION, _program(self.part), self.asked)).encode())
        for face in self.faces:
            for array in (face.control_points, face.weights, *face.knots):
                digest.update(array.tobytes())
        return digest.hexdigest()[:16]


@cache
def _program(part: str) -> str:
    """What the numbers of a part are made by, as it was when this program started."""
    package = Path(__file__).resolve().parents[1]
    names = [f"core/analysis/{name}.py" for name in _SOURCES[part]]
    names += [f"reproduce/{name}.py" for name in ("bodies", "dynamics_case", "dynamics_motion")]
    return hashlib.sha256(b"".join((package / name).read_bytes() for name in names)).hexdigest()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command line takes."""
    small = "a few small cases, in less than a minute"
    add_case_arguments(parser, 5400.0, "case", data=BESIDES, parts=PARTS, small=small)


def run(options: argparse.Namespace) -> int:
    """Make all figures.

    Returns
    -------
    int
        0 when every demand is met and every case was made, else 1.

    Raises
    ------
    HybridVolumeError
        A name is unknown, or there is no worker.
    """
    from .dynamics_pictures import draw
    from .dynamics_table import as_markdown, demands

    started = time.perf_counter()
    folder = Path(options.output)
    for name in ("cases", "pictures"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    asked = [one for one in ASKED if one.small == options.small]
    asked = chosen_cases(asked, options.only, PARTS)
    wanted = {one.body for one in asked}
    bodies, missing = read_bodies(MADE, READ, options.data, wanted)
    cases = [Case(one, bodies[one.body]) for one in asked if one.body in bodies]
    # two cases at a time, one thread each: their seconds do not depend on one another
    one_thread_each()
    runner = Runner(folder, options.time_limit, options.again)
    if not options.gather:
        runner.run(cases)
    found: dict[str, Any] = {
        "version": VERSION,
        "command": "./run.sh reproduce dynamics -o DIR"
        + (" --small" if options.small else "")
        + (" --data DATA" if options.data else ""),
        "machine": machine(),
        "missing": missing,
        **runner.collected(cases),
    }
    found["demands"] = demands(found)
    found["pictures"] = []
    write_json(folder / "dynamics.json", found)
    if any(not case["error"] for case in found["drops"]):
        try:
            found["pictures"] = draw(folder, runner.python)
        except WorkerError as error:
            runner.screen.line(f"no pictures: {error.line}")
    found["seconds"] = time.perf_counter() - started
    write_json(folder / "dynamics.json", found)
    text = as_markdown(found)
    return told_figures(found, text, folder / "dynamics.md", runner.screen, PARTS)


class Runner(fem.Runner):
    """Works on cases, two at a time; see :class:`.fem.Runner`."""

    def _start(self, case: Case) -> tuple[MotionJob, Case, float]:
        (self.cases / f"{case.name}.json").unlink(missing_ok=True)
        own = {
            **case.asked.task,
            "cases": str(self.cases.resolve()),
            "name": case.name,
            "part": case.part,
            "case": case.asked.body,
            "key": case.key(),
        }
        job = MotionJob(case.faces, name=case.name, options=own, python=self.python)
        job.prepare()
        job.start()
        return job, case, time.perf_counter()

    def _write(self, case: Case, error: Any, key: str) -> None:
        values = {
            "name": case.name, "part": case.part, "case": case.asked.body, "key": key,
            "error": dict(error), "seconds": 0.0, "seconds_cpu": 0.0,
        }  # fmt: skip
        write_json(self.cases / f"{case.name}.json", values)

    def _finished(self, case: Case) -> bool:
        found = self.read(case.name)
        return found is not None and found.get("key") == case.key()

    def collected(self, cases: Sequence[Case]) -> dict[str, Any]:
        """All finished cases, by their part, and the names of the others."""
        found: dict[str, Any] = {part: [] for part in PARTS}
        found["not_done"] = []
        for case in cases:
            values = self.read(case.name)
            if values is None or values.pop("key", "") != case.key():
                found["not_done"].append(case.name)
            if values is not None:
                found[case.part].append(values)
        return found
