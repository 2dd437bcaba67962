# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce midstructure -o DIR``: automatic midstructures, each up to its shell.

For every body of some files, and for bodies made here whose midstructure is known: ``NAME.json``
with the figures, ``NAME.png`` with the sheets in the body, and a table of all. Nothing is chosen by
hand. What is finished is not done again.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from HybridVolume.completion import Screen
from HybridVolume.errors import HybridVolumeError, InputError, SetupError, WorkerError
from HybridVolume.freecad_python import import_freecad
from HybridVolume.job import Job, worker_python

if TYPE_CHECKING:
    import numpy as np

    from HybridVolume.core.hybrid import HybridVolume
    from HybridVolume.core.midstructure import Midstructure
    from HybridVolume.core.surface import SplineFace

    from .bodies import ExactBody

PROJECT = Path(__file__).resolve().parents[2]
EXAMPLES = PROJECT / "resources" / "examples"
BESIDE = PROJECT.parent / "shared" / "data" / "untrimmed"
SUFFIXES = (".step", ".stp", ".brep", ".brp")
PARTS = ("bodies", "exact", "timing")
VERSION = 1
"""Of the JSON files."""

SHELL, REFUSED, FAILED = "shell", "refused", "failed"


@dataclass
class Entry:
    """A body to work on: its faces, or why it is refused, or what is known about it."""

    name: str
    source: str
    faces: Sequence[SplineFace] = ()
    error: HybridVolumeError | None = None
    exact: ExactBody | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    def key(self, w0: float) -> str:
        """What the figures depend on, besides the program."""
        digest = hashlib.sha256(repr((w0, sorted(self.options.items()))).encode())
        for face in self.faces:
            for array in (face.control_points, face.weights, *face.knots):
                digest.update(array.tobytes())
        return digest.hexdigest()[:16]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command line takes."""
    parser.add_argument(
        "--bodies",
        nargs="+",
        metavar="FILE|DIR",
        help="STEP and BREP files, or folders of them, instead of the examples",
    )
    parser.add_argument("--w0", type=float, default=0.5, help="thickness asked for (default: 0.5)")
    parser.add_argument("--again", action="store_true", help="do finished bodies again")
    parser.add_argument(
        "--time-limit", type=float, default=900.0, metavar="S", help="seconds for a body (900)"
    )
    parser.add_argument(
        "--parts", nargs="+", choices=PARTS, default=PARTS, help="leave the other parts out"
    )


def run(options: argparse.Namespace) -> int:
    """Make all figures.

    Returns
    -------
    int
        0 when every body that is not refused by name has a shell, else 1.

    Raises
    ------
    HybridVolumeError
        A file is not there, or there is no worker.
    """
    from HybridVolume.core.pipeline import Options

    Options(w0=options.w0)
    files = body_files(options.bodies)
    folder = Path(options.output)
    folder.mkdir(parents=True, exist_ok=True)
    maker = Maker(folder, options.w0, options.time_limit, options.again)
    found: dict[str, list[dict[str, Any]]] = {}
    if "bodies" in options.parts:
        found["bodies"] = [maker.figures(entry) for entry in read_entries(files)]
    if "exact" in options.parts:
        found["exact"] = [maker.figures(entry) for entry in exact_entries()]
    if "timing" in options.parts:
        found["timing"] = maker.timing()
    write_json(folder / "midstructure.json", {"version": VERSION, **found})
    from .table import as_markdown

    text = as_markdown(found)
    (folder / "midstructure.md").write_text(text, encoding="utf-8")
    maker.screen.line(text)
    done = [one for part in ("bodies", "exact") for one in found.get(part, ())]
    failed = [one["name"] for one in done if one["state"] == FAILED]
    if failed:
        maker.screen.line(f"without a shell: {', '.join(failed)}")
    return 1 if failed else 0


def body_files(named: Sequence[str] | None) -> list[Path]:
    """Files with bodies.

    Raises
    ------
    InputError
        A name is neither a file nor a folder.
    """
    places = [Path(name) for name in named] if named else [EXAMPLES]
    if not named and BESIDE.is_dir():
        places.append(BESIDE)
    files: list[Path] = []
    for place in places:
        if place.is_dir():
            files.extend(p for p in sorted(place.iterdir()) if p.suffix.lower() in SUFFIXES)
        elif place.is_file():
            files.append(place)
        else:
            raise InputError(f"{place} is neither a file nor a folder", remedy="check --bodies")
    return files


def read_entries(files: Sequence[Path]) -> Iterator[Entry]:
    """Bodies of files; those that the reader refuses with their errors."""
    import_freecad()
    from HybridVolume import sources

    taken: dict[str, int] = {}
    for file in files:
        try:
            # covers have a command of their own
            bodies = sources.read_file(file, cover=False)
        except InputError as error:
            yield Entry(_unique(file.stem, taken), file.name, error=error)
            continue
        for body in bodies:
            yield Entry(_unique(body.name, taken), file.name, body.faces, body.error)


def _unique(name: str, taken: dict[str, int]) -> str:
    taken[name] = taken.get(name, 0) + 1
    return name if taken[name] == 1 else f"{name}-{taken[name]}"


def exact_entries() -> Iterator[Entry]:
    """Bodies made here."""
    from .bodies import exact_bodies

    for body in exact_bodies():
        name = f"exact-{body.name}"
        yield Entry(name, "made here", body.faces, exact=body, options=body.options)


class Maker:
    """Makes the figures of one body after the other.

    Parameters
    ----------
    folder : Path
    w0 : float
    time_limit : float
        Seconds for a body.
    again : bool
        Do finished bodies again.
    """

    def __init__(self, folder: Path, w0: float, time_limit: float, again: bool) -> None:
        self.folder, self.w0, self.time_limit, self.again = folder, w0, time_limit, again
        self.screen = Screen()
        self.python = worker_python()

    def figures(self, entry: Entry) -> dict[str, Any]:
        """Figures of a body, from its file if it is finished."""
        path = self.folder / f"{entry.name}.json"
        key = entry.key(self.w0)
        found = None if self.again else _finished(path, key)
        if found is not None:
            self.screen.line(f"{entry.name}: {_words(found)} (finished before)")
            return found
        started = time.perf_counter()
        found = {"version": VERSION, "name": entry.name, "source": entry.source, "key": key}
        try:
            if entry.error:
                raise entry.error
            found.update(self._made(entry, started + self.time_limit))
        except InputError as error:
            found.update(state=REFUSED, error=error.to_dict())
        except HybridVolumeError as error:
            found.update(state=FAILED, error=error.to_dict())
        found["seconds_all"] = time.perf_counter() - started
        write_json(path, found)
        self.screen.line(f"{entry.name}: {_words(found)} ({found['seconds_all']:.1f} s)")
        return found

    def _made(self, entry: Entry, end: float) -> dict[str, Any]:
        from HybridVolume.core.midstructure.hints import hints

        options = {"w0": self.w0, **entry.options}
        thickness, _ = self._job(entry, "thickness", options, end)
        volume, report = self._job(entry, "volume", options, end)
        self._draw(entry, volume)
        told = asdict(hints(volume.midstructure, self.w0))
        shell = report["shell"]
        found = {
            "state": SHELL,
            "faces": report["input"]["faces"],
            "genus": report["input"]["genus"],
            "midstructure": report["midstructure"],
            "field": report["field"],
            "w0": {
                "asked": shell["w0_asked"],
                "reached": shell["w0"],
                "rms": shell["w0_rms"],
                "largest": thickness["largest_w0"],
            },
            "elements": {"all": shell["elements"], "proved": shell["valid"]},
            "hints": told,
            "thickness": {name: thickness[name] for name in ("w0", "min", "mean", "max")},
            "seconds": report["seconds"],
        }
        if entry.exact:
            found["exact"] = compared(volume.midstructure, entry.exact)
        return found

    def _job(self, entry: Entry, goal: str, options: dict[str, Any], end: float) -> tuple[Any, Any]:
        """Result and report of a job that is ended in time."""
        with Job(
            entry.faces, name=entry.name, options=options, goal=goal, python=self.python
        ) as job:
            job.start()
            while job.state == "running":
                for news in job.poll(wait=0.2):
                    self.screen.progress(entry.name, news)
                if time.perf_counter() > end and job.state == "running":
                    job.cancel()
                    raise WorkerError(
                        f"no shell within {self.time_limit:g} s",
                        figure=self.time_limit,
                        remedy="raise --time-limit",
                    )
            if job.error:
                raise job.error
            return job.result(), job.report()

    def _draw(self, entry: Entry, volume: HybridVolume) -> None:
        from HybridVolume.exports.picture import write_scene

        from .picture import inside

        path = self.folder / f"{entry.name}.png"
        try:
            write_scene(path, inside(volume.surface, volume.midstructure), self.python)
        except SetupError as error:
            self.screen.line(f"{entry.name}: no picture: {error.line}")

    def timing(self) -> list[dict[str, Any]]:
        """Seconds of 20 000 samples, measured in the worker's environment."""
        command = [self.python, "-m", "HybridVolume.reproduce.timing"]
        self.screen.line("timing: medial axis of 20000 samples, median of three runs")
        done = subprocess.run(
            command, cwd=PROJECT, stdin=subprocess.DEVNULL, capture_output=True, text=True,
            check=False, timeout=self.time_limit,
        )  # fmt: skip
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["no reason"])[-1]
            raise WorkerError(f"the timing ended with code {done.returncode}: {last}")
        return json.loads(done.stdout)


def compared(midstructure: Midstructure, body: ExactBody) -> dict[str, Any]:
    """Kept area and length, and how far what is kept lies off its place."""
    import numpy as np

    facets = midstructure.facets[midstructure.kept]
    x = midstructure.vertices[facets]
    places = np.concatenate([x.reshape(-1, 3), x.mean(axis=1)])
    off = body.off(places)
    length = None
    if body.along:
        # steps along the line; larger ones are gaps
        step = np.diff(np.sort(body.along(np.concatenate([places, _halfway(x)]))))
        length = float(step[step < 0.25 * body.size].sum())
    return {
        "place": body.place,
        "area": midstructure.area,
        "area_exact": _plain(body.area),
        "length": length,
        "length_exact": _plain(body.length),
        "off_max": float(off.max()),
        "off_mean": float(off.mean()),
        "half_thickness": body.size,
    }


def _halfway(x: np.ndarray) -> np.ndarray:
    """Places on the sides of facets, (k, 3) from (f, 3, 3)."""
    import numpy as np

    share = np.linspace(0.0, 1.0, 33)[:, None, None, None]
    return ((1.0 - share) * x + share * np.roll(x, -1, axis=1)).reshape(-1, 3)


def _plain(value: float) -> float | None:
    return None if value != value else float(value)


def _finished(path: Path, key: str) -> dict[str, Any] | None:
    """What a file says, if it is of the same body and was finished."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    same = isinstance(found, dict) and found.get("version") == VERSION and found.get("key") == key
    return found if same and found.get("state") in (SHELL, REFUSED) else None


def _words(found: Mapping[str, Any]) -> str:
    if found["state"] != SHELL:
        error = found["error"]
        faces = ", ".join(error["faces"][:4]) + (" ..." if len(error["faces"]) > 4 else "")
        return f"{found['state']}: {faces + ': ' if faces else ''}{error['message']}"
    middle, w0 = found["midstructure"], found["w0"]
    return (
        f"{middle['kept']} of {middle['sheets']} sheets, w0 {w0['reached']:.2f} of "
        f"{w0['asked']:.2f}, {found['elements']['proved']} elements proved"
    )


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write a file whole or not at all."""
    from HybridVolume.core.atomic import replacing

    with replacing(path) as file:
        file.write((json.dumps(values, indent=1) + "\n").encode())


if __name__ == "__main__":
    from HybridVolume.reproduce import main

    sys.exit(main(["midstructure", *sys.argv[1:]]))
