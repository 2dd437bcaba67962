# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce rates2d -o DIR``: how fast analysis on hybrid bodies converges in the plane.

The paper's section 4 on its disk, beside triangles alone; then higher orders, other bodies and
elasticity. Writes ``rates2d.json`` (``cases``), ``rates2d.md`` and ``pictures``.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from HybridVolume.completion import Screen

from .plane_report import reported
from .plane_study import Family, against, rates, studied
from .table import demand_table, table

COLLOCATION, NITSCHE = "collocation", "nitsche"
PAPER = {0.15: 1.05, 0.3: 0.8}
"""Depths of the ring, and the share of the error of triangles alone that is allowed there."""
SLOPES = {"l2": 2.0, "h1": 1.0}
"""Of the paper's mode; in L2 to 0.15 either way, in H1 as well."""
OFF = 0.15
HIGHER = {2: 2.9, 3: 3.8}
"""Least rates in L2 after Nitsche by the degree of the triangles."""


def paper_mode(depth: float, **more: Any) -> Family:
    """Section 4 of the paper: a biquadratic ring of this depth, linear triangles, collocation."""
    return Family("disk", 1, 2, COLLOCATION, depth, **{"nodes": 2, **more})


WORDS = (
    "Rates are in h, which is halved from one level to the next: 2 is a slope of -2 over 1/h and of"
    " -1 over the number n of unknowns. *Share*: the error over that of triangles alone of the same"
    " degree with as many unknowns, interpolated. Errors are absolute and integrated over the"
    " elements as they are. *Ring*: elements through it x parts of each of the body's own spans x"
    " edges of triangles on each part (0.5: an edge over two; t_l: corners at the node locations of"
    " its control points, the paper's), on the first level; all further levels are the same space,"
    " cut finer. *anew*: each level meshed anew, with layers about as thick as the ring's spans are"
    " long."
)
ALONE = (
    Family("disk", 1, spans=6, levels=6),
    Family("disk", 2, spans=5),
    Family("disk", 3),
    Family("ellipse", 2),
    Family("clover", 3, spans=1),
    Family("hook", 2, spans=1),
    Family("heart", 2),
    Family("heart", 3),
    Family("heart", 2, elastic=True),
)
"""Triangles alone, with which the others are compared."""
HYBRID = (
    *(paper_mode(depth) for depth in (0.15, 0.3, 0.5)),
    *(paper_mode(depth, nodes=1) for depth in PAPER),
    *(paper_mode(depth, nodes="greville") for depth in PAPER),
    *(paper_mode(depth, nodes="greville", anew=True) for depth in PAPER),
    *(Family("disk", 2, 2, coupling, 0.4, 2) for coupling in (COLLOCATION, NITSCHE)),
    Family("disk", 2, 3, COLLOCATION, 0.4, 2),
    *(Family("disk", 3, 3, coupling, 0.4, 2, levels=4) for coupling in (COLLOCATION, NITSCHE)),
    *(
        Family("disk", 3, 3, coupling, 0.4, 3, spans=8, nodes=0.5, levels=4)
        for coupling in (COLLOCATION, NITSCHE)
    ),
    *(Family("ellipse", 2, 2, coupling, 0.4, 2) for coupling in (COLLOCATION, NITSCHE)),
    Family("clover", 3, 3, NITSCHE, 0.4, 2, spans=1, levels=4),
    Family("clover", 3, 3, NITSCHE, 0.4, 2, spans=2, nodes=0.5, levels=4),
    Family("hook", 2, 3, COLLOCATION, 0.4, spans=1),
    Family("heart", 2, 3, COLLOCATION, 0.4, 2),
    Family("heart", 3, 3, NITSCHE, 0.4, 2, levels=4),
    Family("heart", 3, 3, NITSCHE, 0.4, 2, spans=8, nodes=0.5, levels=4),
    Family("heart", 2, 3, COLLOCATION, 0.4, 2, elastic=True),
    Family("heart", 2, 3, NITSCHE, 0.4, 2, elastic=True),
)
"""Rings with triangles inside."""
SMALL = (
    Family("disk", 1, spans=6, levels=4),
    *(paper_mode(depth, levels=3) for depth in PAPER),
    Family("disk", 2, 2, NITSCHE, 0.4, 2, levels=3),
    Family("disk", 3, 3, NITSCHE, 0.4, 2, levels=3),
)
"""What ``--small`` does."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command line takes."""
    parser.add_argument(
        "--small", action="store_true", help="few cases on few levels, in some seconds"
    )


def run(options: argparse.Namespace) -> int:
    """Make all figures.

    Returns
    -------
    int
        0 when every demand is met and every case was made, else 1.
    """

    def make(screen: Screen) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        families = SMALL if options.small else (*ALONE, *HYBRID)
        cases = [studied(family, screen.line) for family in families]
        compare(cases)
        return cases, demands(cases)

    return reported("rates2d", options, make, paragraphs)


def compare(cases: Sequence[dict[str, Any]]) -> None:
    """Put beside each level its error over that of triangles alone with as many unknowns."""
    for case in cases:
        alone = alone_of(case, cases)
        for norm in ("l2", "h1"):
            shares = against(case, alone, norm) if alone else [None] * len(case["levels"])
            for row, share in zip(case["levels"], shares, strict=True):
                row[f"{norm}_share"] = share


def alone_of(
    case: Mapping[str, Any], cases: Sequence[Mapping[str, Any]]
) -> Mapping[str, Any] | None:
    """Triangles alone of the same degree on the same problem, if they were made."""
    same = ("body", "k", "elastic")
    for other in cases:
        if not other["p"] and other["levels"] and all(other[key] == case[key] for key in same):
            return other if other is not case else None
    return None


# ---------------------------------------------------------------------------------- demands


def demands(cases: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """What is asked, with the figures.

    Returns
    -------
    list of dict
        ``case``, ``demand``, ``figure`` (text) and ``met`` (None: not asked, it was not done).
    """
    rows = [row for depth in PAPER for row in paper_demands(cases, depth)]
    for k, least in HIGHER.items():
        chosen = [c for c in cases if c["k"] == k and c["coupling"] == NITSCHE]
        for case in chosen:
            rows.append(_row(
                f"{case['body']}{', elastic' if case['elastic'] else ''}, p {case['p']}, k {k}, "
                f"Nitsche, ring {_ring(case)}, slope of L2 in h", f"≥ {least}",
                "-" if case["l2_rate"] is None else f"{case['l2_rate']:.2f}",
                not case["error"] and (case["l2_rate"] or 0.0) >= least,
            ))  # fmt: skip
    return rows


def paper_demands(cases: Sequence[Mapping[str, Any]], depth: float) -> list[dict[str, Any]]:
    """What is asked of the paper's mode at one depth, as :func:`demands`."""
    name = paper_mode(depth).name
    case = next((c for c in cases if c["name"] == name and len(c["levels"]) > 2), None)
    what = f"paper's mode, depth {depth:g}"
    rows = []
    for norm, slope in SLOPES.items():
        # the coarsest meshes have a few triangles for each wave
        slopes = rates(case["levels"], norm)[1:] if case else []
        rows.append(_row(
            f"{what}, slope of {norm.upper()} in h", f"{slope:.1f} ± {OFF}",
            ", ".join(f"{r:.2f}" for r in slopes),
            all(abs(r - slope) <= OFF for r in slopes) if slopes else None,
        ))  # fmt: skip
    shares = [r["l2_share"] for r in case["levels"] if r["l2_share"]] if case else []
    rows.append(_row(
        f"{what}, error over that of triangles alone, equal unknowns", f"≤ {PAPER[depth]}",
        f"{max(shares):.2f} at most, {shares[-1]:.2f} on the finest level" if shares else "",
        max(shares) <= PAPER[depth] if shares else None,
    ))  # fmt: skip
    return rows


def _row(case: str, demand: str, figure: str, met: bool | None) -> dict[str, Any]:
    return {"case": case, "demand": demand, "figure": figure, "met": met}


# ----------------------------------------------------------------------------------- tables


def paragraphs(found: Mapping[str, Any]) -> list[str]:
    """The part of docs/verification.md on rates in the plane."""
    cases = found["cases"]
    return [
        "## Rates in the plane",
        WORDS,
        demand_table(found["demands"]),
        "### Finest levels",
        _finest(cases),
        "### The paper's disk, level by level",
        as_levels([c for c in cases if _is_paper(c)]),
    ]


def _is_paper(case: Mapping[str, Any]) -> bool:
    return case["body"] == "disk" and case["k"] == 1


def _finest(cases: Sequence[Mapping[str, Any]]) -> str:
    head = ("body", "p", "k", "coupling", "depth", "ring", "unknowns", "L2", "H1", "rate L2",
            "rate H1", "share L2", "share H1", "s")  # fmt: skip
    rows = []
    for case in cases:
        if len(case["levels"]) < 2:
            continue
        last = case["levels"][-1]
        # the last level that triangles alone were made for
        shared = next((r for r in reversed(case["levels"]) if r["l2_share"]), {})
        rows.append((
            case["body"] + (", elastic" if case["elastic"] else ""),
            str(case["p"] or "-"), str(case["k"]), case["coupling"] or "triangles alone",
            f"{case['depth']:g}" if case["p"] else "-", _ring(case), str(last["unknowns"]),
            f"{last['l2']:.2e}", f"{last['h1']:.2e}",
            f"{last['l2_rate']:.2f}", f"{last['h1_rate']:.2f}",
            _share(shared.get("l2_share")), _share(shared.get("h1_share")),
            f"{last['seconds']:.1f}",
        ))  # fmt: skip
    return table(head, rows)


def as_levels(cases: Sequence[Mapping[str, Any]]) -> str:
    """Cases with all their levels, as a table."""
    head = ("depth", "ring", "unknowns", "L2", "rates L2", "rates H1", "share L2")
    rows = [
        (
            f"{case['depth']:g}" if case["p"] else "triangles alone",
            _ring(case),
            " / ".join(str(r["unknowns"]) for r in case["levels"]),
            " / ".join(f"{r['l2']:.1e}" for r in case["levels"]),
            " ".join(f"{r:.2f}" for r in rates(case["levels"], "l2")),
            " ".join(f"{r:.2f}" for r in rates(case["levels"], "h1")),
            " ".join(_share(r["l2_share"]) for r in case["levels"]),
        )
        for case in cases
        if case["levels"]
    ]
    return table(head, rows)


def _ring(case: Mapping[str, Any]) -> str:
    if not case["p"]:
        return "-"
    if case["anew"]:
        return "anew, nodes t_l" if case["nodes"] == "greville" else "anew"
    edges = "t_l" if case["nodes"] == "greville" else str(case["nodes"])
    return f"{case['layers']} x {case['spans']} x {edges}"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
