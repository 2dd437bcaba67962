# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce rates3d -o DIR``: how fast analysis on hybrid volumes converges in space.

Poisson's equation and elasticity with known solutions, on bodies that are refined without a change
of their volume, beside curved quadratic tets of the same bodies. Writes ``rates3d.json``
(``cases``, ``tets``, ``gaps``) and ``rates3d.md``. Every case has a process of its own with a time
limit; finished ones are kept in ``DIR/cases`` and not done again, unless program or body changed.
"""

from __future__ import annotations

import argparse
import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from HybridVolume.completion import Screen
from HybridVolume.core.surface import SplineFace
from HybridVolume.errors import HybridVolumeError, InputError, WorkerError
from HybridVolume.freecad_python import import_freecad
from HybridVolume.job import worker_python

from . import fem
from .bodies import box, sphere, torus
from .cases import (
    BESIDES,
    CaseJob,
    add_case_arguments,
    chosen_cases,
    digest_of,
    one_thread_each,
    told_figures,
)
from .fem_bodies import even, hollow_sphere
from .midstructure import BESIDE, EXAMPLES, body_files, write_json
from .shell import machine

VERSION = 1
"""Of the JSON file."""
PARTS = {"rates": "cases", "tets": "tets", "gaps": "gaps"}
"""Parts, and what they are called in rates3d.json."""
MADE = {
    "sphere": lambda: sphere(1.0),
    "torus": lambda: torus(3.0, 1.0),
    "hollow_sphere": lambda: hollow_sphere(1.0, 2.0, even(1)).faces,
    "box": lambda: box((3.0, 2.0, 1.0), (1, 1, 1)),
}
"""Bodies that are made here, of one knot span a patch."""
READ = ("twisted_fichera", "fandisk")
"""Bodies of files."""
COLLOCATION, NITSCHE = "collocation", "nitsche"
W0 = 0.5
MESHER_LIMIT = 300.0
"""Seconds for a mesher of tets."""
_TETS = (
    "reproduce/bodies.py", "reproduce/fem_bodies.py", "reproduce/fem_measure.py",
    "reproduce/fem_rivals.py", "reproduce/rates3d_measure.py", "reproduce/rates3d_problems.py",
    "core/analysis/assembly.py", "core/analysis/linear.py", "core/analysis/samples.py",
    "core/analysis/simplex_space.py",
)  # fmt: skip
_HYBRID = (
    *_TETS, "core/*.py", "reproduce/rates3d_case.py",
    *(f"core/analysis/{name}.py" for name in (
        "boundary", "core_repair", "coupling", "elasticity", "elevation", "hybrid_space",
        "interface_figures", "poisson", "refine", "spline_space", "subdivision", "tet_space",
        "unfold")),
)  # fmt: skip
_SOURCES = {"rates": _HYBRID, "gaps": _HYBRID, "tets": _TETS}
"""Files that decide whether a case has to be done again."""


@dataclass(frozen=True)
class Asked:
    """A case as it is asked for.

    Attributes
    ----------
    part : {"rates", "tets", "gaps"}
    body, problem : str
    p, k : int
        Least degree of the shell, and degree of the core.
    coupling : str
    levels : int
        Meshes, each with half the h of the one before.
    small : bool
        Whether it is part of the small run.
    w0 : float
    start : {"own", "user", "scaled"} or float
        Knot spans of the first shell, as for :func:`.rates3d_case.made_shell`.
    cuts, finer : int
        As for :func:`.rates3d_case.made_space`.
    sizes : tuple of float
        Edges of tets alone, as shares of the diagonal.
    pictured : int
        Level whose errors are drawn on a cut; -1: none.
    """

    part: str
    body: str
    problem: str = "poisson"
    p: int = 0
    k: int = 2
    coupling: str = ""
    levels: int = 5
    small: bool = False
    w0: float = W0
    start: str | float = "own"
    cuts: int = 1
    finer: int = 0
    sizes: tuple[float, ...] = ()
    pictured: int = -1

    @property
    def name(self) -> str:
        """Of the case and its file."""
        if self.part == "tets":
            return f"tets-{self.body}-{self.problem}"
        words = [self.part, self.body, self.problem, f"p{self.p}", f"k{self.k}", self.coupling]
        if self.cuts > 1:
            words.append(f"cut{self.cuts}")
        if self.finer:
            words.append(f"finer{self.finer}")
        if self.start != "own":
            words.append(self.start if isinstance(self.start, str) else f"even{self.start:g}")
        return "-".join(words)


def _rates(
    body: str, problem: str, p: int, k: int, coupling: str, levels: int, **more: Any
) -> Asked:
    return Asked("rates", body, problem, p, k, coupling, levels, **more)


ASKED = (
    _rates("torus", "poisson", 2, 2, COLLOCATION, 4),
    _rates("sphere", "poisson", 4, 2, COLLOCATION, 4, cuts=3, pictured=2),
    _rates("twisted_fichera", "poisson", 3, 2, COLLOCATION, 4, pictured=2),
    _rates("twisted_fichera", "poisson", 3, 2, COLLOCATION, 3, cuts=2),
    _rates("twisted_fichera", "poisson", 2, 2, COLLOCATION, 4),
    _rates("twisted_fichera", "poisson", 3, 2, NITSCHE, 3),
    _rates("torus", "poisson", 3, 3, NITSCHE, 4),
    _rates("torus", "poisson", 3, 3, NITSCHE, 2, start=1.6, finer=1, pictured=1),
    _rates("sphere", "poisson", 4, 2, COLLOCATION, 3),
    _rates("sphere", "poisson", 4, 2, NITSCHE, 3),
    _rates("sphere", "poisson", 4, 3, NITSCHE, 3),
    _rates("torus", "poisson", 3, 2, COLLOCATION, 3),
    _rates("fandisk", "poisson", 3, 2, COLLOCATION, 2, start="user", pictured=1),
    _rates("hollow_sphere", "lame", 4, 2, COLLOCATION, 2, cuts=3),
    _rates("torus", "elasticity", 2, 2, COLLOCATION, 3),
    _rates("torus", "elasticity", 3, 3, NITSCHE, 2, start=1.6, finer=1),
    _rates("hollow_sphere", "lame", 4, 3, NITSCHE, 2),
    _rates("twisted_fichera", "poisson", 3, 3, NITSCHE, 2),
    *(Asked("tets", body, problem, sizes=sizes) for body, problem, sizes in (
        ("sphere", "poisson", (0.085, 0.05, 0.03, 0.02)),
        ("torus", "poisson", (0.07, 0.042, 0.026, 0.016)),
        ("twisted_fichera", "poisson", (0.1, 0.06, 0.04, 0.026)),
        ("fandisk", "poisson", (0.1, 0.06, 0.04, 0.026)),
        ("hollow_sphere", "lame", (0.072, 0.05, 0.035, 0.026)),
        ("torus", "elasticity", (0.08, 0.051, 0.036, 0.025)),
    )),
    Asked("gaps", "box", "linear", 2, 2, NITSCHE, 3, start="scaled"),
    Asked("gaps", "box", "linear", 3, 3, NITSCHE, 2, start="scaled"),
    Asked("gaps", "box", "linear", 2, 2, COLLOCATION, 3, start="scaled"),
    *(Asked("gaps", body, "linear", p, k, coupling, levels)
      for body, p, k, coupling, levels in (
          ("sphere", 4, 1, COLLOCATION, 4), ("sphere", 4, 2, COLLOCATION, 4),
          ("torus", 2, 2, COLLOCATION, 4), ("torus", 2, 2, NITSCHE, 4),
          ("torus", 3, 3, NITSCHE, 3))),
    _rates("torus", "poisson", 2, 2, COLLOCATION, 3, small=True),
    _rates("torus", "poisson", 3, 3, NITSCHE, 3, small=True),
)  # fmt: skip
"""All cases. Small ones stand beside the large ones that have the same name."""


class RateJob(CaseJob):
    """One case; its process writes it to the folder of cases."""

    module = "HybridVolume.reproduce.rates3d_case"


@dataclass
class Case:
    """A case with its body.

    Attributes
    ----------
    asked : Asked
    faces : sequence of SplineFace
    error : HybridVolumeError or None
        Why there is no body.
    """

    asked: Asked
    faces: Sequence[SplineFace] = ()
    error: HybridVolumeError | None = None
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
    return digest_of(path for pattern in _SOURCES[part] for path in package.glob(pattern))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command line takes."""
    small = "a few small cases, in less than a minute"
    add_case_arguments(parser, 1800.0, "case", data=BESIDES, parts=PARTS, small=small)


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
    from .rates3d_pictures import draw
    from .rates3d_table import as_markdown, demands

    started = time.perf_counter()
    folder = Path(options.output)
    (folder / "cases").mkdir(parents=True, exist_ok=True)
    asked = [one for one in ASKED if one.small == options.small]
    asked = chosen_cases(asked, options.only, PARTS)
    bodies, missing = read_bodies(MADE, READ, options.data, {one.body for one in asked})
    cases = [Case(one, bodies[one.body]) for one in asked if one.body in bodies]
    # two cases at a time, one thread each: their seconds do not depend on one another
    one_thread_each()
    runner = Runner(folder, options.time_limit, options.again)
    if not options.gather:
        runner.run(cases)
    found: dict[str, Any] = {
        "version": VERSION,
        "command": _command(options),
        "machine": machine(),
        "missing": missing,
        **runner.collected(cases),
    }
    found["demands"] = demands(found)
    found["pictures"] = []
    found["seconds"] = time.perf_counter() - started
    write_json(folder / "rates3d.json", found)
    try:
        found["pictures"] = draw(folder, runner.python)
    except WorkerError as error:
        runner.screen.line(f"no pictures: {error.line}")
    write_json(folder / "rates3d.json", found)
    file = folder / "rates3d.md"
    return told_figures(found, as_markdown(found), file, runner.screen, PARTS.values())


def _command(options: argparse.Namespace) -> str:
    words = ["./run.sh reproduce rates3d -o DIR"]
    if options.small:
        words.append("--small")
    if options.only:
        words.append(f"--only {' '.join(options.only)}")
    if options.data:
        words.append("--data DATA")
    return " ".join(words)


def read_bodies(
    made: Mapping[str, Callable[[], Sequence[SplineFace]]],
    read: Sequence[str],
    data: Sequence[str] | None,
    wanted: set[str],
) -> tuple[dict[str, Sequence[SplineFace]], list[str]]:
    """Faces of the bodies that are wanted, and names of those that are not there.

    Parameters
    ----------
    made : mapping of str to callable
        Bodies that are made here.
    read : sequence of str
        Names of files with bodies, without their endings.
    data : sequence of str, optional
        Files and folders besides the example, and the folders in these; the folder beside the
        project by default.
    wanted : set of str

    Raises
    ------
    HybridVolumeError
        A body cannot be read.
    """
    found = {name: make() for name, make in made.items() if name in wanted}
    if not wanted.intersection(read):
        return found, []
    import_freecad()
    from HybridVolume import sources

    places = [Path(name) for name in data] if data else [BESIDE] if BESIDE.is_dir() else []
    # a folder may keep its files in folders by kind
    places += [inner for place in places if place.is_dir() for inner in sorted(place.iterdir())
               if inner.is_dir()]  # fmt: skip
    for file in body_files([str(EXAMPLES), *map(str, places)]):
        if file.stem in wanted and file.stem in read and file.stem not in found:
            bodies = sources.read_file(file, cover=False)
            if len(bodies) != 1:
                raise InputError(f"{file.name} has {len(bodies)} bodies, not one")
            if bodies[0].error:
                raise bodies[0].error
            found[file.stem] = bodies[0].faces
    return found, sorted(wanted - set(found))


class Runner(fem.Runner):
    """Works on cases, two at a time; see :class:`.fem.Runner`."""

    def __init__(self, folder: Path, time_limit: float, again: bool) -> None:
        super().__init__(folder, time_limit, again)
        self.screen = Screen()
        self.python = worker_python()

    def _start(self, case: Case) -> tuple[RateJob, Case, float]:
        (self.cases / f"{case.name}.json").unlink(missing_ok=True)
        job = RateJob(case.faces, name=case.name, options=self._task(case), python=self.python)
        job.prepare()
        job.start()
        return job, case, time.perf_counter()

    def _task(self, case: Case) -> dict[str, Any]:
        return {
            **vars(case.asked),
            "name": case.name,
            "mesher_limit": MESHER_LIMIT,
            "cases": str(self.cases.resolve()),
            "key": case.key(),
        }

    def _write(self, case: Case, error: Any, key: str) -> None:
        asked = case.asked
        values = {
            "name": case.name, "part": case.part, "body": asked.body, "problem": asked.problem,
            "p": asked.p, "k": asked.k, "coupling": asked.coupling, "w0": asked.w0,
            "start": asked.start, "cuts": asked.cuts, "finer": asked.finer, "key": key,
            "levels": [], "error": dict(error), "seconds": 0.0, "seconds_cpu": 0.0,
        }  # fmt: skip
        write_json(self.cases / f"{case.name}.json", values)

    def _finished(self, case: Case) -> bool:
        found = self.read(case.name)
        return found is not None and found.get("key") == case.key()

    def collected(self, cases: Sequence[Case]) -> dict[str, Any]:
        """All finished cases, by their part, and the names of the others."""
        found: dict[str, Any] = {name: [] for name in PARTS.values()}
        found["not_done"] = []
        for case in cases:
            values = self.read(case.name)
            if values is None or values.pop("key", "") != case.key():
                found["not_done"].append(case.name)
            if values is None:
                continue
            # the finest level stands for the case
            last = values["levels"][-1] if values["levels"] else {}
            found[PARTS[case.part]].append({**last, **values})
        return found
