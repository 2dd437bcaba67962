# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Runs every check and test of the project and closes with one sum; ``test.sh`` calls it.

Usage: ``run_tests.py [RUN ...]`` with the names of :data:`RUNS`; all of them otherwise.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO
from xml.etree import ElementTree

PROJECT = Path(__file__).resolve().parent.parent
DISTRIBUTION = "/usr/bin/python3"
ENVIRONMENT = os.environ.get("HYBRIDVOLUME_PYTHON", "")
TIME_LIMIT = 1800  # seconds a run: a hanging test must not hold a machine for hours
SLOW_TEST = 240  # seconds after which a test that still runs shows where it is
NO_TESTS = 5  # pytest's exit code

WITHOUT_SHARED_DATA = re.compile(r"shared", re.IGNORECASE)


@dataclass(frozen=True)
class Run:
    """One call of pytest (``files``, but ``without``: patterns below tests/) or of a checker."""

    name: str
    purpose: str
    python: str
    files: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    variables: dict[str, str] = field(default_factory=dict)
    strict_skips: bool = False
    lane: str = ""
    """Runs of one lane follow each other; lanes go on side by side where there are two cores."""
    nice: int = 10
    """How far it steps back for others: the window has to answer in time."""


RUNS = (
    Run("lint", "ruff, rules", ENVIRONMENT, command=("-m", "ruff", "check", ".")),
    Run("format", "ruff, format", ENVIRONMENT, command=("-m", "ruff", "format", "--check", ".")),
    Run(
        "core",
        "core in the worker's environment",
        ENVIRONMENT,
        files=("test_core_*.py",),
        without=("test_core_free.py",),  # the free-only run has it
        strict_skips=True,
        lane="core",
    ),
    Run(
        "distribution",
        "core in FreeCAD's Python with the distribution's numpy and scipy",
        DISTRIBUTION,
        files=(
            "test_core_imports.py",
            "test_core_bspline*.py",
            "test_core_surface*.py",
            "test_core_validity*.py",
        ),
        lane="beside",
    ),
    Run(
        "free-only",
        "what the GPL parts serve, without them",
        ENVIRONMENT,
        # what calls a mesher; nothing else asks for these parts
        files=tuple(f"test_core_{name}*.py" for name in ("tetmesh", "interior", "free")),
        variables={"HYBRIDVOLUME_FREE_ONLY": "1"},
        lane="beside",
    ),
    Run(
        "freecad",
        "inside FreeCAD's Python",
        DISTRIBUTION,
        files=("test_freecad_*.py",),
        lane="beside",
    ),
    Run(
        "gui",
        "FreeCAD's window under Xvfb",
        DISTRIBUTION,
        files=("test_gui_*.py",),
        lane="window",
        nice=0,
    ),
)


@dataclass
class Outcome:
    """What one run gave: counts, skipped tests with their reasons, and why it failed as a whole."""

    passed: int = 0
    failed: int = 0
    skipped: list[tuple[str, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def line(self) -> str:
        return f"{self.passed} passed, {self.failed} failed, {len(self.skipped)} skipped"


def execute(run: Run, quiet: bool = False) -> Outcome:
    """Start a run, let it print (at its end, if ``quiet``), and count what it did."""
    with tempfile.TemporaryFile() as kept:
        title = f"\n=== {run.name}: {run.purpose}"
        if not quiet:
            print(title, flush=True)
        outcome = _execute(run, kept if quiet else None)
        if quiet:
            kept.seek(0)
            print(title, kept.read().decode(errors="replace"), sep="\n", flush=True)
    return outcome


def _execute(run: Run, output: IO[bytes] | None) -> Outcome:
    started = time.monotonic()
    outcome = Outcome()
    if run.command:
        code = call([run.python, *run.command], run, output)
        outcome.passed, outcome.failed = int(code == 0), int(code != 0)
    else:
        files = sorted(matching(run.files) - matching(run.without))
        if not files:
            outcome.notes.append("no test files")
            return outcome
        with tempfile.TemporaryDirectory(prefix="hybridvolume-") as scratch:
            sheet = Path(scratch) / "results.xml"
            names = [str(path.relative_to(PROJECT)) for path in files]
            options = [f"--junitxml={sheet}", "--durations=5", "--durations-min=5"]
            options += ["-o", f"faulthandler_timeout={SLOW_TEST}"]
            code = call([run.python, "-m", "pytest", *options, *names], run, output)
            if sheet.is_file():
                count(sheet, outcome)
        expected = (0, NO_TESTS) if outcome.failed == 0 else (1,)
        if code not in expected:
            outcome.failed += 1
            outcome.notes.append(f"pytest ended with code {code}")
    outcome.seconds = time.monotonic() - started
    return outcome


def matching(patterns: Iterable[str]) -> set[Path]:
    """Files of tests/ that have one of these patterns."""
    return {path for pattern in patterns for path in PROJECT.glob(f"tests/{pattern}")}


def execute_all(runs: list[Run]) -> dict[str, Outcome]:
    """Execute runs, with two cores in lanes that go on side by side.

    The window's lane waits for the screen half of its time, which the other two use.
    """
    outcomes: dict[str, Outcome] = {}

    def follow(part: Iterable[Run], quiet: bool) -> None:
        for run in part:
            outcomes[run.name] = execute(run, quiet)

    # the checkers first, they take a second
    follow([run for run in runs if run.command], False)
    lanes: dict[str, list[Run]] = {}
    for run in runs:
        if not run.command:
            lanes.setdefault(run.lane, []).append(run)
    if len(lanes) < 2 or (os.cpu_count() or 1) < 2:
        follow([run for part in lanes.values() for run in part], False)
        return outcomes
    # more threads would only wait for each other
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    first, *others = lanes.values()
    names = [run.name for part in others for run in part]
    print("\n=== side by side:", *names, "are shown at their end")
    beside = [threading.Thread(target=follow, args=(part, True), daemon=True) for part in others]
    try:
        for thread in beside:
            thread.start()
        follow(first, False)
        for thread in beside:
            thread.join()
    finally:
        for child in _children:
            end(child)
    return outcomes


def call(command: list[str], run: Run, output: IO[bytes] | None) -> int:
    """Run a command in the project folder; its whole process group ends at the time limit."""
    child = subprocess.Popen(
        [*(["nice", "-n", str(run.nice)] if run.nice else []), *command],
        cwd=PROJECT,
        env={**os.environ, **run.variables},
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=subprocess.STDOUT if output else None,
        start_new_session=True,
    )
    _children.append(child)
    try:
        return child.wait(TIME_LIMIT)
    except subprocess.TimeoutExpired:
        return -signal.SIGKILL
    finally:
        end(child)


_children: list[subprocess.Popen] = []
"""Everything that was started: an interruption must leave nothing running in either lane."""


def end(child: subprocess.Popen) -> None:
    """Stop a process and all that it started, if it still runs."""
    if child.poll() is None:
        os.killpg(child.pid, signal.SIGKILL)
        child.wait()


def count(sheet: Path, outcome: Outcome) -> None:
    """Add up a JUnit file: a test with a failure or an error failed, once."""
    for case in ElementTree.parse(sheet).iter("testcase"):
        skipped = case.find("skipped")
        if case.find("failure") is not None or case.find("error") is not None:
            outcome.failed += 1
        elif skipped is not None:
            test = f"{case.get('classname', '')}::{case.get('name', '')}".lstrip(":")
            outcome.skipped.append((test, skipped.get("message") or "no reason given"))
        else:
            outcome.passed += 1


def wheels_left_out() -> set[str]:
    """Names of the optional wheels that are not there (none for this Python)."""
    code = (
        "import importlib.metadata as m\n"
        "from HybridVolume.environment import requirements\n"
        "names = {l.split('==')[0] for l in set(requirements()) - set(requirements(gpl=False))}\n"
        "held = {d.metadata['Name'].lower() for d in m.distributions()}\n"
        "print(*(names - held))"
    )
    answer = subprocess.run([ENVIRONMENT, "-c", code], capture_output=True, text=True, cwd=PROJECT)
    return set(answer.stdout.split())


def unexplained(run: Run, outcome: Outcome) -> list[str]:
    """Tests that a strict run may not skip: only what cannot be had here excuses them."""
    if not run.strict_skips or not outcome.skipped:
        return []
    excused = [WITHOUT_SHARED_DATA] + [
        re.compile(rf"\b{re.escape(name)}\b", re.IGNORECASE) for name in wheels_left_out()
    ]
    if shutil.which("ccx") is None:  # the set-up takes it wherever the distribution has it
        excused.append(re.compile(r"\bccx\b|CalculiX"))
    return [
        test
        for test, reason in outcome.skipped
        if not any(pattern.search(reason) for pattern in excused)
    ]


def main(names: list[str]) -> int:
    """Execute the named runs, print the sum, return the exit code."""
    unknown = set(names) - {run.name for run in RUNS}
    if unknown or not ENVIRONMENT:
        known = " ".join(run.name for run in RUNS)
        print(f"usage: ./test.sh [RUN ...], where RUN is one of: {known}", file=sys.stderr)
        return 2
    # told to stop, we stop what we started as well
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    runs = [run for run in RUNS if not names or run.name in names]
    outcomes = execute_all(runs)
    bad = False
    for run in runs:
        outcome = outcomes[run.name]
        for test in unexplained(run, outcome):
            outcome.notes.append(f"skipped without an accepted reason: {test}")
            bad = True
    reasons = Counter(
        (name, reason) for name, outcome in outcomes.items() for _, reason in outcome.skipped
    )
    if reasons:
        print("=== skipped")
        for (name, reason), number in sorted(reasons.items()):
            tests = [test for test, why in outcomes[name].skipped if why == reason]
            print(f"{name}: {number} x {reason} ({', '.join(tests)})")
    print("\n=== sum")
    for name, outcome in outcomes.items():
        print(f"{name + ':':14}{outcome.line} ({outcome.seconds:.0f} s)", *outcome.notes, sep="  ")
    passed = sum(outcome.passed for outcome in outcomes.values())
    failed = sum(outcome.failed for outcome in outcomes.values())
    skipped = sum(len(outcome.skipped) for outcome in outcomes.values())
    print(f"{passed} passed, {failed} failed, {skipped} skipped")
    return int(failed > 0 or bad)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
