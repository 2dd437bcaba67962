# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What ``./run.sh reproduce rates3d`` measured, as Markdown, and what is demanded of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .table import demand_table, made_on, table

Case = Mapping[str, Any]

QUADRATIC = {"l2": 2.8, "h1": 1.9}
"""Least rates of quadratic tets by collocation on these bodies:"""
QUADRATIC_BODIES = ("sphere", "torus", "twisted_fichera")
CUBIC = {"l2": 3.7, "h1": 2.7}
"""Least rates of cubic tets after Nitsche, of a shell of degree 3, on one curved body at least."""
EXACT = 1e-12
"""Most by which the core misses linear fields at the interface's nodes, of the diagonal."""
PATCH = 1e-9
"""Most of the patch test where the interface is flat."""
RIGID = 1e-10
"""Most energy of a rigid motion, of that of a stretch of the same size."""
SHARE = 1.0 / 3.0
"""Of the unknowns of tets alone, for the same error of energy."""
SLACK = 0.2
"""By which a measured rate of a gap may stay below its order."""
FLAT = ("box",)
"""Bodies whose interface is flat."""
_NAMES = {"l2": "L2", "h1": "H1", "energy": "energy"}
_GAPS = {
    "transfer": "linear fields at the nodes",
    "gap": "gap, root mean square",
    "patch_l2": "patch test, L2",
    "patch_h1": "patch test, H1",
    "rigid": "energy of rigid motions",
}
"""Figures of the interface, and what they are called."""
_STARTS = {"user": "spans as a user has them", "scaled": "towards half of the body"}


def as_markdown(found: Mapping[str, Any]) -> str:
    """The part of docs/verification.md on rates in space."""
    parts = [
        "## Rates in space\n\n`" + found["command"] + "`\n\n" + made_on(found, "cases"),
        demand_table(found["demands"]),
    ]
    solved = any(case["levels"] for case in found["cases"])
    if solved:
        parts.append("### Errors\n\n" + _rates(found["cases"]))
    if any(case["levels"] for case in found["tets"]):
        parts.append("### Equal unknowns\n\n" + _equal(found["cases"], found["tets"]))
    if any(case["levels"] for case in found["gaps"]):
        parts.append("### At the interface\n\n" + _gaps(found["gaps"]))
    if solved:
        parts.append("### Time and memory\n\n" + _times(found["cases"]))
    failed = [case for part in ("cases", "tets", "gaps") for case in found[part] if case["error"]]
    if failed:
        parts.append("\n".join(f"- {one['name']}: {one['error']['message']}" for one in failed))
    parts += [f"![{words}](pictures/{name})" for name, words in found["pictures"]]
    return "\n".join(parts) + "\n"


# ---------------------------------------------------------------------------------- demands


def demands(found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What is asked, with the figures.

    Returns
    -------
    list of dict
        ``case``, ``demand``, ``figure`` (text) and ``met`` (None: not asked, its body is missing).
    """
    cases = found["cases"]
    rows = []
    for body in QUADRATIC_BODIES:
        chosen = [
            case
            for case in cases
            if (case["body"], case["problem"], case["k"], case["coupling"])
            == (body, "poisson", 2, "collocation")
        ]
        rows.append(_asked(f"{body}, quadratic tets, collocation", QUADRATIC, chosen))
    cubic = [case for case in cases if (case["k"], case["coupling"]) == (3, "nitsche")]
    of_three = [case for case in cubic if case["p"] == 3 and case["body"] not in FLAT]
    rows.append(_asked("p = 3, cubic tets, Nitsche, one curved body", CUBIC, of_three))
    rows += _asked_gaps(found["gaps"])
    rows += _asked_share(cases, found["tets"])
    return rows


def _asked(name: str, least: Mapping[str, float], cases: Sequence[Case]) -> dict:
    """A row that is met by one of the cases; the figures are those of all."""
    demand = ", ".join(f"{_NAMES[norm]} ≥ {value}" for norm, value in least.items())
    if not cases:
        return {"case": name, "demand": demand, "figure": "", "met": None}
    figures, good = [], []
    for case in cases:
        last = [case.get(f"{norm}_rate") for norm in least]
        good.append(
            not case["error"]
            and all(rate is not None and rate >= value
                    for rate, value in zip(last, least.values(), strict=True))
        )  # fmt: skip
        words = " and ".join("-" if rate is None else f"{rate:.2f}" for rate in last)
        figures.append(f"{short(case)}: {words}")
    return {
        "case": name,
        "demand": demand,
        "figure": "; ".join(figures),
        "met": any(good),
    }


def _asked_gaps(cases: Sequence[Case]) -> list[dict[str, Any]]:
    rows = []
    made = [case for case in cases if case["levels"]]
    if made:
        worst = max(row["transfer"] for case in made for row in case["levels"])
        rows.append({"case": "linear fields over the interface", "demand": f"≤ {EXACT:.0e}",
                     "figure": f"{worst:.1e}", "met": worst <= EXACT})  # fmt: skip
    flat = [case for case in made if case["body"] in FLAT and case["coupling"] == "nitsche"]
    if flat:
        worst = max(
            row["patch_h1"]
            for case in flat
            for row in case["levels"]
            if row["patch_h1"] is not None
        )
        rows.append({"case": "patch test, flat interface, Nitsche", "demand": f"≤ {PATCH:.0e}",
                     "figure": f"{worst:.1e}", "met": worst <= PATCH})  # fmt: skip
    rigid = [row["rigid"] for case in made for row in case["levels"] if row["rigid"] is not None]
    if rigid:
        rows.append({"case": "energy of rigid motions, of a stretch", "demand": f"≤ {RIGID:.0e}",
                     "figure": f"{max(rigid):.1e}", "met": max(rigid) <= RIGID})  # fmt: skip
    for case in made:
        if case["body"] in FLAT:
            continue
        for name, words in (
            ("gap", "gap between the core's faces and the inner surface"),
            ("patch_l2", "patch test in L2, curved interface"),
        ):
            rate = _last_rate(case, name)
            rows.append({
                "case": f"{case['body']}, {short(case)}: {words}",
                "demand": f"falls like h^{case['k'] + 1}",
                "figure": "-" if rate is None else f"h^{rate:.2f}",
                "met": rate is not None and rate >= case["k"] + 1 - SLACK,
            })  # fmt: skip
    return rows


def _last_rate(case: Case, name: str) -> float | None:
    """Rate of a figure on the finest mesh that has one."""
    rates = [one.get(f"{name}_rate") for one in reversed(case["levels"])]
    return next((rate for rate in rates if rate is not None), None)


def _asked_share(cases: Sequence[Case], tets: Sequence[Case]) -> list[dict[str, Any]]:
    rows = []
    for alone in tets:
        best: tuple[float, str] | None = None
        for case in _beside(cases, alone):
            share = _share(case, alone, "energy")
            if share is not None and (best is None or share < best[0]):
                best = share, short(case)
        if best is None:
            continue
        rows.append({
            "case": f"{alone['body']}, {alone['problem']}: unknowns of the best hybrid volume for "
                    "the energy error of its finest mesh, against quadratic tets alone",
            "demand": "≤ 1/3 (aim)", "figure": f"{best[0]:.2f} ({best[1]})",
            "met": best[0] <= SHARE,
        })  # fmt: skip
    return rows


# ------------------------------------------------------------------------- equal unknowns


def _beside(cases: Sequence[Case], alone: Case) -> list[Case]:
    """Hybrid volumes of the same body and problem."""
    same = (alone["body"], alone["problem"])
    return [case for case in cases if (case["body"], case["problem"]) == same and case["levels"]]


def _at(rows: Sequence[Case], norm: str, unknowns: float) -> float | None:
    """Error of tets alone at a number of unknowns, by a straight line in logarithms."""
    count = np.log([row["unknowns"] for row in rows])
    error = np.log([row[norm] for row in rows])
    if len(rows) < 2 or not count[0] <= np.log(unknowns) <= count[-1] + np.log(2.0):
        return None
    at = min(max(int(np.searchsorted(count, np.log(unknowns))), 1), len(rows) - 1)
    slope = (error[at] - error[at - 1]) / (count[at] - count[at - 1])
    return float(np.exp(error[at] + slope * (np.log(unknowns) - count[at])))


def _share(case: Case, alone: Case, norm: str) -> float | None:
    """Unknowns of a hybrid volume over those of tets alone with its error; of its finest mesh.

    Beyond the finest mesh of tets alone their last rate is carried on, by three times its unknowns
    at most.
    """
    rows = alone["levels"]
    if len(rows) < 2 or not case["levels"]:
        return None
    count = np.log([row["unknowns"] for row in rows])
    error = np.log([row[norm] for row in rows])
    wanted = np.log(case["levels"][-1][norm])
    if wanted > error[0]:
        return None
    after = np.flatnonzero(error <= wanted)
    at = int(after[0]) if len(after) else len(rows) - 1
    at = max(at, 1)
    slope = (error[at] - error[at - 1]) / (count[at] - count[at - 1])
    if slope >= 0.0:
        return None
    needed = count[at] + (wanted - error[at]) / slope
    return float(case["levels"][-1]["unknowns"] / np.exp(needed))


def _equal(cases: Sequence[Case], tets: Sequence[Case]) -> str:
    head = ("body", "problem", "hybrid volume", "unknowns", "L2 of tets alone / own", "energy",
            "unknowns for the same L2 error", "energy error")  # fmt: skip
    rows = []
    for alone in tets:
        if alone["error"]:
            continue
        for case in _beside(cases, alone):
            last = case["levels"][-1]
            gains = []
            for norm in ("l2", "energy"):
                error = _at(alone["levels"], norm, last["unknowns"])
                gains.append("-" if error is None else f"{error / last[norm]:.2f}")
            shares = [_share(case, alone, norm) for norm in ("l2", "energy")]
            rows.append((
                alone["body"], alone["problem"], short(case), _count(last["unknowns"]), *gains,
                *("-" if share is None else f"{share:.2f}" for share in shares),
            ))  # fmt: skip
    words = (
        "Beside curved ten-node tets of the same body by Gmsh (order 2, mid nodes on the CAD "
        "faces), of even size. The first two ratios tell how many times larger their error is at "
        "as many unknowns as the finest hybrid volume has; the last two, how many unknowns it "
        "needs of theirs for its own error. Lines through their errors are straight in "
        "logarithms, and carried on beyond their finest mesh where that is not fine enough.\n\n"
    )
    tail = [_errors_row(alone) for alone in tets if alone["levels"]]
    return (
        words
        + table(head, rows)
        + "\n"
        + table(("tets alone", "unknowns", "L2", "H1", "energy"), tail)
    )


def _errors_row(case: Case) -> tuple[str, ...]:
    levels = case["levels"]
    return (
        f"{case['body']}, {case['problem']}",
        " / ".join(_count(row["unknowns"]) for row in levels),
        *(" / ".join(f"{row[norm]:.2e}" for row in levels) for norm in ("l2", "h1", "energy")),
    )


# ---------------------------------------------------------------------------------- tables


def _rates(cases: Sequence[Case]) -> str:
    head = ("body", "problem", "p", "k", "coupling", "", "unknowns", "L2", "rates", "H1", "rates")
    rows = []
    for case in cases:
        levels = case["levels"]
        if not levels:
            continue
        row = [case["body"], case["problem"], _degrees(case), str(case["k"]), case["coupling"]]
        row += [", ".join(_ways(case)), " / ".join(_count(one["unknowns"]) for one in levels)]
        for norm in ("l2", "h1"):
            row.append(" / ".join(f"{one[norm]:.1e}" for one in levels))
            found = [one[f"{norm}_rate"] for one in levels[1:]]
            row.append(" ".join("-" if rate is None else f"{rate:.2f}" for rate in found))
        rows.append(tuple(row))
    words = (
        "p are the degrees of the shell along the faces (and through the thickness), k that of the "
        "core. Errors are shares of the norm of the exact solution, over the elements as they "
        "are; rates are in h, which halves from one mesh to the next: all knot spans are halved in "
        "u, v and w, and every tet is cut into eight. The volume stays the same, point for point. "
        "The coarsest shell has one knot span a patch, where nothing else is said.\n\n"
    )
    problems = {case["problem"]: case["words"] for case in cases if case.get("words")}
    told = "".join(f"- {name}: {text}\n" for name, text in problems.items())
    return words + told + "\n" + table(head, rows)


def _degrees(case: Case) -> str:
    along = "-".join(map(str, dict.fromkeys((case["degrees"][0], case["degrees"][-1]))))
    kind = ", rational" if case["rational"] else ""
    return f"{along} ({case['degree_w']}){kind}"


def _gaps(cases: Sequence[Case]) -> str:
    made = [case for case in cases if case["levels"]]
    names = [name for name in _GAPS if name in made[0]["levels"][0]]
    head = ("body", "p", "k", "coupling", *(_GAPS[name] for name in names))
    rows = []
    for case in made:
        row = [case["body"], str(case["p"]), str(case["k"]), case["coupling"]]
        for name in names:
            found = [one[name] for one in case["levels"] if one[name] is not None]
            text = " / ".join(f"{value:.1e}" for value in found)
            rate = _last_rate(case, name)
            if rate is not None and name.startswith(("gap", "patch")) and case["body"] not in FLAT:
                text += f" (h^{rate:.2f})"
            row.append(text)
        rows.append(tuple(row))
    return table(head, rows)


def _times(cases: Sequence[Case]) -> str:
    head = ("case", "unknowns", "solver", "iterations", "seconds of the processor", "solving",
            "memory MB")  # fmt: skip
    rows = []
    for case in cases:
        if not case["levels"]:
            continue
        last = case["levels"][-1]
        solver = last.get("solver") or {}
        rows.append((
            f"{case['body']}, {case['problem']}, {short(case)}",
            _count(last["unknowns"]),
            str(solver.get("method", "-")),
            str(solver.get("iterations", "-")),
            f"{last['seconds_cpu']:.1f}",
            _figure(solver.get("seconds")),
            _figure(solver.get("memory")),
        ))  # fmt: skip
    return "Of the finest mesh: assembly of both sides, coupling and solution.\n\n" + table(
        head, rows
    )


def _figure(value: Any) -> str:
    return f"{value:.1f}" if isinstance(value, float | int) else "-"


def short(case: Case) -> str:
    """Degrees, coupling, and what is not as usual in a case."""
    words = [f"p = {case['p']}", f"k = {case['k']}", case["coupling"]]
    return ", ".join([*words, *_ways(case)])


def _ways(case: Case) -> list[str]:
    """What is not as usual in a case."""
    found = []
    if case["cuts"] > 1:
        found.append(f"interface {case['cuts']} x {case['cuts']} a span")
    if case["finer"]:
        found.append("shell halved once more than the core")
    if case["start"] in _STARTS:
        found.append(_STARTS[case["start"]])
    elif case["start"] != "own":
        found.append(f"spans of {case['start']:g} mm at most")
    return found


def _count(number: float) -> str:
    return f"{number / 1000:.3g}k" if number >= 1000 else str(int(number))
