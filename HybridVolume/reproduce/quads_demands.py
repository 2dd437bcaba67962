# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What is demanded of quad meshes and cages, met or not by the figures of quads.json alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .quads_broken import MENDED
from .quads_inputs import SHELL
from .quads_smoothness import SMOOTH

Case = Mapping[str, Any]
Row = dict[str, Any]

TIMES = 3.0
"""How much longer thousands of patches may take than few."""
EXACT = 1e-12
"""Share of the diagonal by which exact things may differ."""
SEVERAL = "ant-patches"
"""The case of many patches; the others are what it is measured against."""


def demands(found: Mapping[str, Any]) -> list[Row]:
    """All demands.

    Parameters
    ----------
    found : mapping
        What quads.json holds.

    Returns
    -------
    list of dict
        ``case``, ``demand`` (text), ``figure`` (text), ``met`` (None where it was not measured).
    """
    return [
        *(row for case in found["cases"] for row in _volume(case)),
        *many_patches(found["many_patches"]),
        *(row for case in found["smoothness"] for row in _smooth(case)),
        *(row for case in found["limit_distance"] for row in _limit(case)),
        *(row for case in found["exactness"] for row in _exact(case)),
        *(_broken(case) for case in found["broken"]),
    ]


def reason(error: Mapping[str, Any]) -> str:
    """An error in a line."""
    return f"{error['code']}: {error['message']}"


def _row(case: str, demand: str, figure: str, met: bool | None) -> Row:
    return {"case": case, "demand": demand, "figure": figure, "met": met}


def _volume(case: Case) -> list[Row]:
    shell_only = case.get("way") == SHELL
    whole = "certified shell" if shell_only else "certified hybrid volume and second-order mesh"
    if case["error"]:
        return [_row(case["name"], whole, reason(case["error"]), False)]
    proved = case["proved"] == case["elements"] and case["embedded"]
    figure = f"{case['proved']} of {case['elements']} proved, w0 {case['w0']:.2f}"
    if shell_only:
        return [_row(case["name"], whole, figure, proved)]
    least = case["fem_min_scaled_jacobian"]
    figure += f", {case['fem_nodes']} nodes, scaled Jacobian {least:.2g}"
    met = proved and least > 0.0 and case["fem_order"] == 2
    return [_row(case["name"], whole, figure, met)]


def many_patches(cases: Sequence[Case]) -> list[Row]:
    """Ratios of the seconds of many patches to those of few.

    Parameters
    ----------
    cases : sequence of mapping
        ``many_patches`` of quads.json.
    """
    made = {case["case"]: case for case in cases}
    if SEVERAL not in made:
        return []
    many, rows = made[SEVERAL], []
    for name, few in made.items():
        if name == SEVERAL:
            continue
        demand = f"whole run at most {TIMES:g} times that of {name}"
        lost = many["error"] or few["error"]
        if lost:
            rows.append(_row(SEVERAL, demand, reason(lost), False))
            continue
        ratio = many["seconds_cpu"] / few["seconds_cpu"]
        figure = (
            f"{ratio:.2f} times ({many['patches']} and {few['patches']} patches, "
            f"{many['control_points']} and {few['control_points']} control points)"
        )
        rows.append(_row(SEVERAL, demand, figure, ratio <= TIMES))
    return rows


def _smooth(case: Case) -> list[Row]:
    if case.get("scheme") not in ("smooth", None) and not case["error"]:
        return []
    demand = f"smooth: normals agree within {SMOOTH:.0e} rad at 50 places of every side"
    if case["error"]:
        return [_row(case["case"], demand, reason(case["error"]), False)]
    valences = ", ".join(n for n in case["valences"] if n != "4")
    figure = f"{case['angle']:.1e} rad, valences {valences or 'all 4'}"
    met = case["angle"] <= SMOOTH and not case["open_sides"]
    return [_row(case["case"], demand, figure, met)]


def _limit(case: Case) -> list[Row]:
    if case["error"]:
        return [_row(case["case"], "distance to the limit surface", reason(case["error"]), False)]
    if case["case"].startswith("torus"):
        worst = max(row["share"] for row in case["rows"])
        demand = f"regular quads: the limit surface within {EXACT:.0e} of the diagonal"
        return [_row(case["case"], demand, f"{worst:.1e}", worst <= EXACT)]
    own = [row for row in case["rows"] if row["steps"] >= 1]
    # the program takes nearest places at samples and adds a margin, so that it tells more
    met = all(row["distance"] <= 1.01 * row["told"] for row in own)
    first, last = case["rows"][0], case["rows"][-1]
    figure = f"{first['share']:.1e} of the diagonal with {first['steps']} subdivisions"
    if last is not first:
        figure += f", {last['share']:.1e} with {last['steps']}"
    return [_row(case["case"], "the distance that is told is no less than the true one",
                 figure, met)]  # fmt: skip


def _exact(case: Case) -> list[Row]:
    demand = f"refinement never moves the surface by more than {EXACT:.0e} of the diagonal"
    if case["error"]:
        return [_row(case["case"], demand, reason(case["error"]), False)]
    worst = max(row["deviation"] for row in case["rows"]) / case["diagonal"]
    return [_row(case["case"], demand, f"{worst:.1e}", worst <= EXACT)]


def _broken(case: Case) -> Row:
    name = f"broken: {case['case']}"
    if case["error"]:
        return _row(name, "an answer", reason(case["error"]), False)
    said = " ".join([case["said"], *case["notes"]])
    named = not case["named"] or any(word in said for word in case["named"])
    if case["expected"] == MENDED:
        demand = "mended, said, completed"
        met = case["code"] == 0 and named and "report.json" in case["left"]
    else:
        demand = "refused by its elements, nothing left behind"
        met = case["code"] == 2 and named and not case["left"]
    return _row(name, demand, case["said"] or "; ".join(case["notes"]),
                met and not case["traceback"])  # fmt: skip
