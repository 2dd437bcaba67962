# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Pictures of ``./run.sh reproduce shell``."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.errors import HybridVolumeError
from HybridVolume.exports.picture import write_scenes
from HybridVolume.exports.scene import Chart
from HybridVolume.job import Job, exported_files

from .midstructure import write_json
from .shell_bodies import SPEED_BODY
from .shell_demands import sound

if TYPE_CHECKING:
    from .shell import Body, Runner

RANDOM = "random_scaled_jacobian.png"
LEVEL = 0.5


def draw(runner: Runner, bodies: Sequence[Body], cases: Sequence[Mapping[str, Any]]) -> list[str]:
    """Write the pictures; one that cannot be drawn is told.

    Parameters
    ----------
    runner : Runner
        Knows the folder and the worker.
    bodies : sequence of Body
    cases : sequence of mapping
        As in shell.json.

    Returns
    -------
    list of str
        Names of the files.
    """
    made: list[str] = []
    for work in (lambda: _distribution(runner, cases), lambda: _stages(runner, bodies)):
        try:
            made += work()
        except HybridVolumeError as error:
            runner.screen.line(f"no picture: {error.line}")
    return made


def distribution(cases: Sequence[Mapping[str, Any]]) -> Chart | None:
    """Scaled Jacobians of all elements of the random bodies at one level."""
    random = [c for c in cases if c["group"] == "random" and c["w0_asked"] == LEVEL and sound(c)]
    if not random:
        return None
    counts = np.sum([case["scaled_jacobian"]["histogram"] for case in random], axis=0)
    least = min(random, key=lambda case: case["min_scaled_jacobian"])
    value = least["min_scaled_jacobian"]
    return Chart(
        f"Scaled Jacobian of {counts.sum()} elements of {len(random)} random bodies",
        (f"w0 = {LEVEL}; every element proved valid",),
        np.linspace(0.0, 1.0, len(counts) + 1),
        counts,
        "smallest scaled Jacobian of an element (1: a box, 0: flat)",
        "elements",
        ((value, f"smallest {value:.3f} ({least['body']})"),),
    )


def _distribution(runner: Runner, cases: Sequence[Mapping[str, Any]]) -> list[str]:
    chart = distribution(cases)
    if chart is None:
        return []
    write_scenes({runner.folder / RANDOM: chart}, runner.python)
    return [RANDOM]


def _stages(runner: Runner, bodies: Sequence[Body]) -> list[str]:
    """The stages of one body, as ``--pictures`` draws them."""
    made: list[str] = []
    for body in bodies:
        if body.name != SPEED_BODY or body.free_only or f"{body.name}@{LEVEL}" not in body.asked:
            continue
        names = exported_files(body.name, "pictures")
        key = body.key(runner.program)
        kept = runner.read(f"{body.name}@pictures") or {}
        there = all((runner.folder / name).is_file() for name in names)
        if runner.again or not there or kept.get("key") != key:
            runner.screen.line(f"{body.name}: drawing the stages")
            job = Job(
                body.faces,
                name=body.name,
                options={"w0": LEVEL},
                exports=("pictures",),
                python=runner.python,
            )
            with job:
                job.run(lambda news, body=body: runner.screen.progress(body.name, news))
                for file in job.exported_files("pictures"):
                    shutil.copyfile(file, runner.folder / file.name)
            write_json(runner.cases / f"{body.name}@pictures.json", {"key": key})
        made += names
    return made
