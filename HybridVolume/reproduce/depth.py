# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce depth -o DIR``: the error against the ring's thickness and its layers.

The study that the paper leaves open at the end of its section 4: on its disk, for many depths of
the ring and one to three layers, the error over that of triangles alone with as many unknowns.
Writes ``depth.json``, ``depth.md`` and ``pictures``.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from HybridVolume.completion import Screen

from .cases import told
from .plane_report import reported
from .plane_study import Family, against, measured, studied
from .table import table

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
    return reported("depth", options, lambda screen: (made(options.small, screen), []), _paragraphs)


def made(small: bool, screen: Screen | None = None) -> list[dict[str, Any]]:
    """All cases: triangles alone of each degree first, then rings on their finest level."""
    tell = screen.line if screen else None
    cases = []
    for k, way in list(WAYS.items())[: 1 if small else None]:
        way = {**way, "levels": 2} if small else way
        alone = studied(Family("disk", k, spans=6 if k == 1 else 5, levels=way["levels"] + 1), tell)
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


def _paragraphs(found: Mapping[str, Any]) -> list[str]:
    cases = found["cases"]
    parts = [
        "## Depth of the ring",
        "The paper's disk and function; collocation; a ring of 4 x 4 spans around and the given"
        " layers on the first level, refined with everything else. Error in L2 over that of"
        " triangles alone of the same degree with as many unknowns (1 is no gain, less is better),"
        " and in brackets the unknowns and the ring's part of the squared error.",
    ]
    for k in sorted({case["k"] for case in cases}):
        parts += [f"### Triangles of degree {k}", _table([c for c in cases if c["k"] == k])]
    return parts


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
