# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce fig2 -o DIR``: an elastic disk dropped on a plane, and what flips in it.

The paper's Fig. 2: triangles alone against one, two and three layers of C² elements of growing
thickness, at maximal impact and at rest, for materials of growing stiffness. Writes ``fig2.json``
(``cases``), ``fig2.md`` and pictures. Every case has a process of its own with a time limit.
Finished cases are kept in ``DIR/cases`` and not done again, unless `fig2_drop` has changed or
``--again`` says so.
"""

from __future__ import annotations

import argparse
import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from HybridVolume.errors import WorkerError

from .cases import CaseJob, add_case_arguments, chosen_cases, one_thread_each, told_figures
from .fem import Runner
from .midstructure import write_json
from .shell import machine

VERSION = 1
"""Of the JSON file."""
BODIES = ("triangles", "one-layer", "two-layers", "three-layers")
"""Names of :data:`.fig2_drop.BODIES`."""
YOUNG = (0.020, 0.025, 0.0275, 0.030, 0.0325, 0.035, 0.045)
"""Young's moduli of the scan, MPa."""
SHOWN = 0.030
"""The one of the pictures; there the mesh is also turned, the step halved, the unknowns doubled."""
TURNS = (8.0,)
"""Degrees by which meshes are turned against the direction of the fall."""
FINER = {"unknowns": 480}
"""Twice the unknowns,"""
HIGHER = {"young": 0.09, "height": 150.0, "step": 6e-4, "duration": 0.12, "viscosity": 8.66e-4}
"""and the same impact with a third of the weight: three times as high and as stiff."""
THICKER = {"one-layer": 0.2, "two-layers": 0.4, "three-layers": 0.6}
"""Depths of the layers, one and a third times those of the scan,"""
THICKER_YOUNG = (0.025, 0.030, 0.035)
"""and the stiffnesses where they are tried, MPa."""
SMALL = {"unknowns": 150, "step": 1.5e-3, "duration": 0.12}
"""What ``--small`` does instead, at the stiffness of the pictures,"""
SMALL_BODIES = ("triangles", "three-layers")
"""and with which bodies."""
PARTS = ("scan", "turned", "step", "finer", "higher", "thicker")


class DropJob(CaseJob):
    """One case; its process writes it to the folder of cases."""

    module = "HybridVolume.reproduce.fig2_case"


@dataclass
class Case:
    """One drop.

    Attributes
    ----------
    name : str
        Of its file.
    part : str
        One of ``PARTS``.
    case : str
        Name of the body.
    task : dict
        ``drop``: arguments of :class:`.fig2_drop.Drop`; ``depth``: of the layers, where it is not
        the body's own.
    """

    name: str
    part: str
    case: str
    task: dict[str, Any] = field(default_factory=dict)
    after: None = None
    """No case waits for another one."""

    def key(self) -> str:
        """What the figures depend on."""
        told = [self.name, sorted(self.task["drop"].items())]
        if self.task.get("depth") is not None:
            told.append(self.task["depth"])
        words = repr((VERSION, _program(), *told))
        return hashlib.sha256(words.encode()).hexdigest()[:16]


@cache
def _program() -> str:
    """The experiment, as it was when this program started."""
    return hashlib.sha256((Path(__file__).parent / "fig2_drop.py").read_bytes()).hexdigest()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command line takes."""
    small = "few unknowns and one stiffness, in some seconds"
    add_case_arguments(parser, 1500.0, "case", parts=PARTS, small=small)


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
    from .fig2_drop import COUPLING, DEGREE, height
    from .fig2_pictures import draw
    from .fig2_table import as_markdown, demands

    started = time.perf_counter()
    folder = Path(options.output)
    cases = chosen_cases(all_cases(options.small), options.only, PARTS)
    for name in ("cases", "pictures"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    # two cases at a time, one thread each: their seconds do not depend on one another
    one_thread_each()
    runner = DropRunner(folder, options.time_limit, options.again)
    if not options.gather:
        runner.run(cases)
    found: dict[str, Any] = {
        "version": VERSION,
        "command": "./run.sh reproduce fig2 -o DIR" + (" --small" if options.small else ""),
        "machine": machine(),
        "missing": [],
        "shown": SHOWN,
        **runner.collected(cases),
    }
    found["demands"] = demands(found["cases"], SHOWN)
    found["pictures"] = []
    if any(not case["error"] for case in found["cases"]):
        write_json(folder / "fig2.json", found)
        try:
            found["pictures"] = draw(folder, runner.python)
        except WorkerError as error:
            runner.screen.line(f"no pictures: {error.line}")
    for case in found["cases"]:
        if not case["error"]:
            case |= {"p": DEGREE if case["body"]["layers"] else 0, "k": 1, "coupling": COUPLING}
            for state in (case["impact"], case["rest"]):
                state["height"] = height(state.pop("outline"))
    found["seconds"] = time.perf_counter() - started
    write_json(folder / "fig2.json", found)
    text = as_markdown(found)
    return told_figures(found, text, folder / "fig2.md", runner.screen, ("cases",))


def all_cases(small: bool = False) -> list[Case]:
    """All drops, those of the pictures first.

    Parameters
    ----------
    small : bool
        Few unknowns, one stiffness.
    """
    if small:
        return [_case("scan", body, SHOWN, f"{body}-small", SMALL) for body in SMALL_BODIES]
    scan = sorted(YOUNG, key=lambda young: young != SHOWN)
    return [
        *(_case("scan", body, young, f"{body}-{1e3 * young:g}") for young in scan
          for body in BODIES),
        *(_case("turned", body, SHOWN, f"{body}-turned-{turn:g}", {"turn": turn})
          for turn in TURNS for body in BODIES),
        *(_case("step", body, SHOWN, f"{body}-half-step", {"step": 5e-4}) for body in BODIES),
        *(_case("finer", body, SHOWN, f"{body}-finer", FINER) for body in BODIES),
        *(_case("higher", body, SHOWN, f"{body}-higher", HIGHER) for body in BODIES),
        *(_case("thicker", body, young, f"{body}-thicker-{1e3 * young:g}", depth=depth)
          for young in THICKER_YOUNG for body, depth in THICKER.items()),
    ]  # fmt: skip


def _case(
    part: str,
    body: str,
    young: float,
    name: str,
    more: Mapping[str, float] | None = None,
    depth: float | None = None,
) -> Case:
    return Case(name, part, body, {"drop": {"young": young, **(more or {})}, "depth": depth})


class DropRunner(Runner):
    """Works on drops, two at a time."""

    def _start(self, case: Case) -> tuple[DropJob, Case, float]:
        (self.cases / f"{case.name}.json").unlink(missing_ok=True)
        own = {
            **case.task,
            "cases": str(self.cases.resolve()),
            "name": case.name,
            "part": case.part,
            "case": case.case,
            "key": case.key(),
        }
        job = DropJob((), name=case.name, options=own, python=self.python)
        job.prepare()
        job.start()
        return job, case, time.perf_counter()

    def collected(self, cases: Sequence[Case]) -> dict[str, Any]:
        """All finished cases, and the names of the others."""
        found: dict[str, Any] = {"cases": [], "not_done": []}
        for case in cases:
            values = self.read(case.name)
            if values is None or values.pop("key", "") != case.key():
                found["not_done"].append(case.name)
            if values is not None:
                found["cases"].append(values)
        return found
