# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce depth -o DIR``: the error against the ring's thickness and its layers.

The study that the paper leaves open at the end of its section 4: on its disk, for many depths of
the ring and one to three layers, the error over that of triangles alone with as many unknowns.
Writes ``depth.json``, ``depth.md`` and ``pictures``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from HybridVolume.completion import Screen
from HybridVolume.errors import WorkerError
from HybridVolume.job import worker_python

from .cases import told, told_figures
from .midstructure import write_json
from .plane_pictures import draw
from .plane_study import Family, against, measured, studied
from .shell import machine
from .table import made_on, table

VERSION = 1
"""Of the JSON file."""
DEPTHS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
LAYERS = (1, 2, 3)
WAYS: dict[int, dict[str, Any]] = {
    1: {"p": 2, "nodes": 2, "levels": 4},
    2: {"p": 2, "nodes": 1, "levels": 4},
    3: {"p": 3, "nodes": 1, "levels": 3},
}
"""By the degree of the triangles: the ring, and how many levels fine."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command line takes."""
    parser.add_argument(
        "--small", action="store_true", help="linear triangles and three depths only"
    )


def run(options: argparse.Namespace) -> int:
    """Make the study.

    Returns
    -------
    int
        0 when every case was made, else 1.
    """
    started = time.perf_counter()
    folder = Path(options.output)
    (folder / "pictures").mkdir(parents=True, exist_ok=True)
    screen = Screen()
    cases = made(options.small, screen)
    found: dict[str, Any] = {
        "version": VERSION,
        "command": "./run.sh reproduce depth -o DIR" + (" --small" if options.small else ""),
        "machine": machine(),
        "missing": [],
        "not_done": [],
        "cases": cases,
        "demands": [],
        "pictures": [],
        "seconds": time.perf_counter() - started,
    }
    write_json(folder / "depth.json", found)
    try:
        found["pictures"] = draw(folder / "depth.json", worker_python())
    except WorkerError as error:
        screen.line(f"no pictures: {error.line}")
    write_json(folder / "depth.json", found)
    return told_figures(found, _as_markdown(found), folder / "depth.md", screen, ("cases",))


def made(small: bool, screen: Screen | None = None) -> list[dict[str, Any]]:
    """All cases: triangles alone of each degree first, then rings on their finest level."""
    tell = screen.line if screen else None
    cases = []
    for k, way in list(WAYS.items())[: 1 if small else None]:
        way = {**way, "levels": 2} if small else way
        alone = studied(Family("disk", k, spans=5, levels=way["levels"] + 1), tell)
        cases.append(alone)
        for depth in (0.1, 0.3, 0.5) if small else DEPTHS:
            for layers in LAYERS:
                family = Family(
                    "disk", k, coupling="collocation", depth=depth, layers=layers, **way
                )
                case = _finest(family, alone)
                cases.append(case)
                if tell:
                    tell(f"{case['name']}: {_share(case)}")
    return cases


def _finest(family: Family, alone: Mapping[str, Any]) -> dict[str, Any]:
    """The finest level of a family, beside triangles alone."""
    case = {**asdict(family), "name": family.name, "levels": [], "error": None, "l2_share": None,
            "h1_share": None}  # fmt: skip
    try:
        for space in family.spaces():
            finest = space
        case["levels"] = [{"level": family.levels - 1, **measured(finest, family.problem())}]
    except Exception as fault:
        case["error"] = told(fault).to_dict()
        return case
    for norm in ("l2", "h1"):
        (case[f"{norm}_share"],) = against(case, alone, norm)
    return case


def _as_markdown(found: Mapping[str, Any]) -> str:
    cases = found["cases"]
    parts = [
        "## Depth of the ring",
        f"`{found['command']}`",
        made_on(found, "cases").replace(", two cases side by side with one thread each", ""),
        "The paper's disk and function; collocation; a ring of 4 x 4 spans around and the given"
        " layers on the first level, refined with everything else. Error in L2 over that of"
        " triangles alone of the same degree with as many unknowns (1 is no gain, less is better),"
        " and in brackets the unknowns and the ring's part of the squared error.",
    ]
    for k in sorted({case["k"] for case in cases}):
        parts.append(f"### Triangles of degree {k}\n\n" + _table([c for c in cases if c["k"] == k]))
    failed = [f"- {c['name']}: {c['error']['message']}" for c in cases if c["error"]]
    parts += ["\n".join(failed)] if failed else []
    parts += [f"![{words}](pictures/{name})" for name, words in found["pictures"]]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _table(cases: Sequence[Mapping[str, Any]]) -> str:
    rings = [case for case in cases if case["p"]]
    layers = sorted({case["layers"] for case in rings})
    words = [f"{n} layer" if n == 1 else f"{n} layers" for n in layers]
    rows = []
    for depth in sorted({case["depth"] for case in rings}):
        found = {case["layers"]: case for case in rings if case["depth"] == depth}
        rows.append((f"{depth:g}", *(_share(found[n]) for n in layers)))
    return table((f"depth (p {rings[0]['p']})", *words), rows)


def _share(case: Mapping[str, Any]) -> str:
    if case["error"]:
        return "no figures"
    (row,) = case["levels"]
    share = "-" if case["l2_share"] is None else f"{case['l2_share']:.2f}"
    of_ring = 100.0 * (row["ring_l2"] / row["l2"]) ** 2
    return f"{share} ({row['unknowns']}, {of_ring:.0f} %)"
