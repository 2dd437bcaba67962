# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce shell -o DIR``: shells of many bodies at many levels, and what is demanded.

Writes ``shell.json`` with all figures, ``shell.md`` with the tables (docs/verification.md), and
pictures. Every body has a process of its own with a time limit. Finished cases are kept in
``DIR/cases`` and not done again, unless the program or the body has changed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from HybridVolume.completion import Screen
from HybridVolume.errors import HybridVolumeError, InputError, WorkerError
from HybridVolume.freecad_python import import_freecad
from HybridVolume.job import worker_python

from .cases import BESIDES, CaseJob, add_case_arguments, one_thread_each
from .midstructure import BESIDE, EXAMPLES, Entry, body_files, read_entries, write_json
from .shell_bodies import RIVALS_FILE, SPEED_BODY, no_shell

if TYPE_CHECKING:
    from HybridVolume.core.surface import SplineFace

VERSION = 1
"""Of the JSON files."""
LEVELS = (0.1, 0.3, 0.5, 0.7, 0.9)
PARTS = ("shells", "shape", "layers", "paper", "rivals", "time", "pictures")
QUICK = ("box_coarse", "L", "wedge_30", "sphere", "torus")
"""Bodies of ``--quick``, at .5 only."""
LEVEL_BODIES = ("box", "L", "twisted_fichera", "chair_stand")
"""Bodies of the table of layers."""
PAPER_LEVELS = (0.1, 0.3, 0.5, 0.7)
RIVAL_LEVELS = (0.1, 0.5)
"""Levels of our shells whose mean thickness other meshers are asked for."""
LAYERS = 2
RUNNING = 2
"""Bodies that are worked on side by side."""


class BodyJob(CaseJob):
    """The cases of one body; each is written to the folder of cases when it is finished."""

    module = "HybridVolume.reproduce.shell_case"


@dataclass
class Body:
    """A body and its cases.

    Attributes
    ----------
    name : str
    words : str
        What it is, or its file.
    kind : {"table", "random", "other"}
    faces : sequence of SplineFace
    split : int
        Parts that each knot span is cut into.
    error : HybridVolumeError or None
        Why the reader refuses it.
    options : mapping
        Of :class:`HybridVolume.core.pipeline.Options`, besides those of all bodies.
    asked : dict
        What is asked: name of the case -> its head.
    free_only : bool
    """

    name: str
    words: str
    kind: str
    faces: Sequence[SplineFace] = ()
    split: int = 1
    error: HybridVolumeError | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    asked: dict[str, dict[str, Any]] = field(default_factory=dict)
    free_only: bool = False

    def key(self, program: str) -> str:
        """What the figures depend on."""
        digest = hashlib.sha256(repr((VERSION, program, self.split, LAYERS)).encode())
        digest.update(repr(sorted(self.options.items())).encode())
        digest.update(repr(self.free_only or bool(os.environ.get(_FREE))).encode())
        for face in self.faces:
            for array in (face.control_points, face.weights, *face.knots):
                digest.update(array.tobytes())
        return digest.hexdigest()[:16]


_FREE = "HYBRIDVOLUME_FREE_ONLY"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command line takes."""
    parser.add_argument(
        "--body", action="append", metavar="NAME", help="this body only (repeatable)"
    )
    parser.add_argument(
        "--w0",
        action="append",
        type=float,
        metavar="W",
        help="this level only (repeatable; default: .1 .3 .5 .7 .9)",
    )
    parser.add_argument(
        "--quick", action="store_true", help=f"{', '.join(QUICK)} at .5 only, without rivals"
    )
    parser.add_argument(
        "--parts", nargs="+", choices=PARTS, default=PARTS, help="leave the other parts out"
    )
    add_case_arguments(parser, 600.0, "body", data=BESIDES)


def run(options: argparse.Namespace) -> int:
    """Make all figures.

    Returns
    -------
    int
        0 when every demand that could be asked is met, else 1.

    Raises
    ------
    HybridVolumeError
        A file is not there, a level is out of its range, or there is no worker.
    """
    from HybridVolume.core.pipeline import Options

    from .shell_demands import demands
    from .shell_pictures import draw
    from .shell_table import as_markdown

    levels = tuple(options.w0 or (LEVELS if not options.quick else (0.5,)))
    for level in levels:
        Options(w0=level)
    started = time.perf_counter()
    bodies, missing = chosen_bodies(options)
    parts = ("shells",) if options.quick else tuple(options.parts)
    for body in bodies:
        ask(body, levels, parts)
    bodies += [
        # the same body without what is under the GPL
        replace(b, asked={f"{b.name}@0.5-free": {"kind": "free", "w0_asked": 0.5}}, free_only=True)
        for b in bodies
        if b.name == SPEED_BODY and 0.5 in levels and "time" in parts
    ]
    folder = Path(options.output)
    (folder / "cases").mkdir(parents=True, exist_ok=True)
    # two bodies at a time, one thread each: their seconds do not depend on one another
    one_thread_each()
    runner = Runner(folder, options.time_limit, options.again)
    open_cases: list[str] = []
    if options.gather:
        open_cases = runner.without_open(bodies)
    else:
        runner.run(bodies)
    found = {
        "version": VERSION,
        "machine": machine(),
        "missing": missing,
        "not_done": open_cases,
        **runner.collected(bodies),
    }
    found["demands"] = demands(found)
    found["pictures"] = []
    if "pictures" in parts and not options.gather:
        found["pictures"] = draw(runner, bodies, found["cases"])
    found["seconds"] = time.perf_counter() - started
    write_json(folder / "shell.json", found)
    text = as_markdown(found)
    (folder / "shell.md").write_text(text, encoding="utf-8")
    runner.screen.line(text)
    unmet = [row for row in found["demands"] if row["met"] is False]
    runner.screen.line(f"{folder / 'shell.md'}: {len(unmet)} of {len(found['demands'])} demands "
                       f"not met ({found['seconds']:.0f} s)")  # fmt: skip
    return 1 if unmet else 0


def chosen_bodies(options: argparse.Namespace) -> tuple[list[Body], list[str]]:
    """Bodies to work on, and names of those of the tables that are not there.

    Raises
    ------
    InputError
        A body is named that is neither made here nor in the files.
    """
    from .shell_bodies import DEMANDS, made_bodies, random_bodies

    wanted = options.body or (QUICK if options.quick else None)
    found = {m.name: Body(m.name, m.words, "table", m.faces(), m.split) for m in made_bodies()}
    if wanted is None or not set(wanted) <= set(found):
        for entry in read_entries(_files(options.data)):
            for body in _of_file(entry, found):
                found[body.name] = body
        for made in random_bodies():
            if wanted is None or made.name in wanted:
                found[made.name] = Body(made.name, made.words, "random", made.faces(), made.split)
    unknown = sorted(set(wanted or ()) - set(found))
    if unknown:
        raise InputError(
            f"{', '.join(unknown)}: no such body",
            remedy=f"--data names further files; there are {', '.join(sorted(found))}",
        )
    order = {name: number for number, name in enumerate(DEMANDS)}
    bodies = [body for name, body in found.items() if wanted is None or name in wanted]
    bodies.sort(key=lambda b: (b.kind == "random", order.get(b.name, len(order))))
    return bodies, [] if wanted else [name for name in DEMANDS if name not in found]


def _files(named: Sequence[str] | None) -> list[Path]:
    """The example, and the files that are named, or those that stand beside the project."""
    more = list(named or ([str(BESIDE)] if BESIDE.is_dir() else []))
    return body_files([str(EXAMPLES), *more])


def _of_file(entry: Entry, taken: Mapping[str, Body]) -> list[Body]:
    """A body of a file, and its variants."""
    from .shell_bodies import DEMANDS, OPTIONS, VARIANTS

    name = entry.name if entry.name not in taken else entry.source
    kind = "table" if name in DEMANDS else "other"
    body = Body(name, entry.source, kind, entry.faces, error=entry.error)
    variants = [
        replace(body, name=other, options=options, asked={})
        for other, (original, options) in VARIANTS.items()
        if original == name
    ]
    return [replace(body, options=OPTIONS.get(name, {}), asked={}), *variants]


def ask(body: Body, levels: Sequence[float], parts: Sequence[str]) -> None:
    """Add the cases of a body."""
    from .shell_bodies import DEMANDS

    def add(kind: str, level: float) -> None:
        end = "" if kind == "shell" else f"-{kind}"
        body.asked[f"{body.name}@{level:g}{end}"] = {"kind": kind, "w0_asked": level}

    if "shells" in parts:
        for level in levels:
            add("shell", level)
    if 0.5 not in levels:
        return
    if "shape" in parts and body.name in DEMANDS and DEMANDS[body.name].shapely:
        add("shape", 0.5)
    if "layers" in parts and body.name in LEVEL_BODIES:
        add("levels", 0.5)
    if body.kind == "random" or body.error:
        return
    if "paper" in parts:
        for level in PAPER_LEVELS:
            add("paper", level)
    if "rivals" in parts:
        for level in RIVAL_LEVELS:
            add("rivals", level)


class Runner:
    """Works on bodies, two at a time.

    Parameters
    ----------
    folder : Path
    time_limit : float
        Seconds for a body.
    again : bool
        Do finished cases again.
    """

    def __init__(self, folder: Path, time_limit: float, again: bool) -> None:
        self.folder, self.time_limit, self.again = folder, time_limit, again
        self.cases = folder / "cases"
        self.screen = Screen()
        self.python = worker_python()
        self.program = program_digest()

    def run(self, bodies: Sequence[Body]) -> None:
        """Make all cases that are not finished."""
        waiting = [body for body in bodies if self._open(body)]
        running: list[tuple[BodyJob, Body, float]] = []
        done = len(bodies) - len(waiting)
        if done:
            self.screen.line(f"{done} of {len(bodies)} bodies finished before")
        try:
            while waiting or running:
                while waiting and len(running) < RUNNING:
                    running.append(self._start(waiting.pop(0)))
                for one in list(running):
                    if self._ended(*one):
                        running.remove(one)
        finally:
            for job, _, _ in running:
                job.close()

    def without_open(self, bodies: Sequence[Body]) -> list[str]:
        """Take cases that are not finished out of what is asked; return their names."""
        names = []
        for body in bodies:
            for name in self._open(body, again=False):
                names.append(name)
                del body.asked[name]
        return names

    def _start(self, body: Body) -> tuple[BodyJob, Body, float]:
        job = BodyJob(
            body.faces,
            name=body.name,
            options={
                "cases": str(self.cases.resolve()),
                "asked": self._open(body),
                "key": body.key(self.program),
                "words": body.words,
                "split": body.split,
                "layers": LAYERS,
                "options": dict(body.options),
            },
            python=self.python,
            free_only=body.free_only,
        )
        job.prepare()
        if any(head["kind"] == "rivals" for head in job.options["asked"].values()):
            self._write_for_rivals(body, job.folder / RIVALS_FILE)
        job.start()
        return job, body, time.perf_counter()

    def _write_for_rivals(self, body: Body, path: Path) -> None:
        """Write the body as other meshers read it; without the file they have no answer."""
        from HybridVolume.core.assembly import build_surface

        from ..exports.step import write_solid

        import_freecad()
        try:
            write_solid(path, build_surface(list(body.faces)))
        except HybridVolumeError as error:
            self.screen.line(f"{body.name}: not for other meshers: {error.line}")

    def _ended(self, job: BodyJob, body: Body, started: float) -> bool:
        """Whether a body's process is over; cases that it did not make are told."""
        for news in job.poll(wait=0.1):
            if news.stage == "case":
                self.screen.line(f"{news.text}: {_words(self.read(news.text))}")
            else:
                self.screen.progress(body.name, news)
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
        for name, head in self._open(body, again=False).items():
            lost = error or WorkerError("the case was not made")
            self._refuse(body, name, head, lost, finished=False)
            self.screen.line(f"{name}: {lost.line}")
        return True

    def _refuse(
        self, body: Body, name: str, head: Mapping[str, Any], error: HybridVolumeError, *,
        finished: bool,
    ) -> None:  # fmt: skip
        """Write a case that is an error; one that is not finished is tried again next time."""
        values = {
            "body": body.name, "key": body.key(self.program) if finished else "",
            "words": body.words, "options": dict(body.options), **head,
            **no_shell(error), "seconds": 0.0,
        }  # fmt: skip
        write_json(self.cases / f"{name}.json", values)

    def _open(self, body: Body, again: bool | None = None) -> dict[str, dict[str, Any]]:
        """Cases of a body that are not finished."""
        if body.error:
            for name, head in body.asked.items():
                self._refuse(body, name, head, body.error, finished=True)
            return {}
        if self.again if again is None else again:
            return dict(body.asked)
        key = body.key(self.program)
        return {
            name: head
            for name, head in body.asked.items()
            if (self.read(name) or {}).get("key") != key
        }

    def read(self, name: str) -> dict[str, Any] | None:
        """A case that was written, if it can be read."""
        try:
            return json.loads((self.cases / f"{name}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None

    def collected(self, bodies: Sequence[Body]) -> dict[str, list[dict[str, Any]]]:
        """All cases, by what was asked."""
        kinds = {"shell": "cases", "shape": "shape_first", "levels": "layers", "paper": "paper",
                 "rivals": "rivals", "free": "free"}  # fmt: skip
        found: dict[str, list[dict[str, Any]]] = {name: [] for name in kinds.values()}
        for body in bodies:
            for name, head in body.asked.items():
                case = {**(self.read(name) or {}), "group": body.kind}
                case.pop("key", None)
                found[kinds[head["kind"]]].append(case)
        return found


def program_digest() -> str:
    """What the program's numbers are made by: cases of another program are done again."""
    digest = hashlib.sha256()
    package = Path(__file__).resolve().parents[1]
    own = Path(__file__).parent
    files = [*sorted(package.glob("core/**/*.py")), own / "shell_case.py", own / "rivals.py"]
    for path in files:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def machine() -> dict[str, Any]:
    """Where the seconds were measured."""
    return {"processor": _processor_name(), "cores": os.cpu_count(), "system": platform.system(),
            "python": platform.python_version()}  # fmt: skip


def _processor_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _mesh(one: Mapping[str, Any]) -> str:
    return f"{one['prisms']} prisms" if one["made"] else one["error"]


def _words(case: Mapping[str, Any] | None) -> str:
    if not case:
        return "nothing"
    if case.get("error"):
        return f"{case['error']['code']}: {case['error']['message']}"
    if "levels" in case:
        return f"{len(case['levels'])} ways of layers"
    if "paper" in case:
        return case["paper"]["error"] or f"{case['paper']['valid']} of {case['paper']['elements']}"
    if "made" in case:
        return ", ".join(f"{who}: {_mesh(one)}" for who, one in case["made"].items())
    return (
        f"w0 {case['w0']:.3f}, {case['valid']} of {case['elements']} proved, scaled Jacobian "
        f"{case['min_scaled_jacobian']:.3f} ({case['seconds_cpu']:.1f} s of the processor)"
    )
