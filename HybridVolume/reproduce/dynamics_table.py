# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Tables of ``./run.sh reproduce dynamics``, and what is demanded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .table import demand_table, made_on, table

Case = Mapping[str, Any]

DRIFT = 1e-4
"""Largest change of the total energy of a drop, as a share of the energy of its motion."""
MOMENTUM = 1e-9
"""Largest change of a momentum in free flight, relative."""
RIGID = 1e-10
"""Largest energy of a rigid motion, as a share of a stretch's."""
MODES = 0.01
"""Largest error of a frequency on the finest mesh, relative."""


def demands(found: Mapping[str, Sequence[Case]]) -> list[dict[str, Any]]:
    """What has to be shown, and whether it is.

    Parameters
    ----------
    found : mapping
        With the cases of each part, those that failed too.
    """
    rows = []

    def row(case: Case, demand: str, figure: str, met: bool) -> None:
        rows.append({"case": case["name"], "demand": demand, "figure": figure, "met": bool(met)})

    for case in _made(found, "drops"):
        row(case, f"energy drift of the drop <= {DRIFT:g} of the energy of its fall",
            f"{case['drift']:.1e}", case["drift"] <= DRIFT)  # fmt: skip
        row(case, "it touches the plane and leaves it", f"{case['impacts']} impacts",
            case["impacts"] >= 1 and case["energies"][-1]["height"] > case["lowest"])  # fmt: skip
    for case in _made(found, "flights"):
        row(case, f"linear momentum kept to {MOMENTUM:g}", f"{case['linear']:.1e}",
            case["linear"] <= MOMENTUM)  # fmt: skip
        if case["rule"] != "newmark":
            row(case, f"angular momentum kept to {MOMENTUM:g}", f"{case['angular']:.1e}",
                case["angular"] <= MOMENTUM)  # fmt: skip
        if case["rule"] == "conserving":
            row(case, f"energy kept to {MOMENTUM:g}", f"{case['energy']:.1e}",
                case["energy"] <= MOMENTUM)  # fmt: skip
    for case in _made(found, "modes"):
        row(case, f"slowest frequencies of a free sphere to {100 * MODES:g} % on the finest mesh",
            f"{100 * case['off']:.2g} %", case["off"] <= MODES)  # fmt: skip
    for case in _made(found, "rest"):
        row(case, f"energy of rigid motions <= {RIGID:g} of a stretch's",
            f"{case['linear']:.1e}", case["linear"] <= RIGID)  # fmt: skip
        row(case, f"energy of turns by 2 rad <= {RIGID:g} of a stretch's",
            f"{case['svk']:.1e}", case["svk"] <= RIGID)  # fmt: skip
    return rows


def _made(found: Mapping[str, Sequence[Case]], part: str) -> list[Case]:
    return [case for case in found[part] if not case["error"]]


def as_markdown(found: Mapping[str, Any]) -> str:
    """The part of docs/verification.md that tells of bodies in motion."""
    text = ["## Elastic bodies in motion\n", "```", found["command"], "```\n"]
    text += [made_on(found, "cases"), demand_table(found["demands"])]
    for case in _made(found, "drops"):
        text += _drop(case, found["pictures"])
    if _made(found, "flights"):
        text += ["### Free flight\n", _flights(_made(found, "flights"))]
    if _made(found, "modes"):
        text += ["### Natural frequencies of a free sphere\n", _modes(_made(found, "modes"))]
    if _made(found, "rest"):
        text += ["### Rigid motions\n", _rest(_made(found, "rest"))]
    for part in ("drops", "flights", "modes", "rest"):
        text += [f"- {case['name']}: {case['error']['message']}\n"
                 for case in found[part] if case["error"]]  # fmt: skip
    return "\n".join(text)


def _drop(case: Case, pictures: Sequence[str]) -> list[str]:
    drop, rows = case["drop"], case["energies"]
    files = f"`cases/{case['name']}.pvd`"
    told = (
        f"St. Venant-Kirchhoff material, Young's modulus {1e3 * drop['young']:g} kPa, Poisson's"
        f" ratio {drop['poisson']:g}, {drop['density']:g} t/mm³, no viscosity; it meets a plane"
        f" without friction at {drop['speed']:g} mm/s and falls with {drop['gravity']:g} mm/s²."
        f" {case['unknowns']} unknowns: {case['spline_elements']} spline elements (degree"
        f" {case['degree_w']} across the shell), {case['tets']} tets of degree {case['degree']},"
        " collocation."
        f" {len(rows) - 1} steps of {1e3 * drop['step']:g} ms by the rule that keeps energy,"
        f" {case['iterations']:.1f} iterations and {case['seconds_step']:.2g} s of the processor"
        f" a step. Series for ParaView: {files}, {case['files']} files of exact elements.\n"
    )
    figures = (
        f"{case['impacts']} impacts; elastic energy up to {100 * case['most_elastic']:.0f} % of"
        f" the energy of the fall; least det F {case['least_volume']:.2f}; total energy within"
        f" {case['drift']:.1e} of the energy of the fall.\n"
    )
    text = [f"### {case['case']}: dropped on a plane\n", told, figures]
    for ending, words in (("frames", "Moments of the drop; colours are von Mises stress"),
                          ("energy", "Energies over time")):  # fmt: skip
        name = f"dynamics_{case['case']}_{ending}.png"
        if name in pictures:
            text.append(f"![{words}](pictures/{name})\n")
    head = ("ms", "kinetic", "elastic", "contact", "gravity", "total", "height mm", "iterations")
    step = max(1, (len(rows) - 1) // 12)
    shown = [
        (
            f"{1e3 * row['time']:.4g}",
            *(f"{row[word] / case['kinetic']:.3f}" for word in head[1:5]),
            f"{row['total'] / case['kinetic']:.7f}",
            f"{row['height']:.3f}",
            str(row["iterations"]),
        )
        for row in rows[::step]
    ]
    return [*text, "Energies as shares of the energy of the fall:\n", table(head, shown)]


def _flights(cases: Sequence[Case]) -> str:
    head = ("body", "rule", "unknowns", "steps", "turned rad", "elastic share", "linear momentum",
            "angular momentum", "energy")  # fmt: skip
    rows = [
        (
            case["case"], case["rule"], str(case["unknowns"]), str(case["steps"]),
            f"{case['turned']:.1f}", f"{case['elastic']:.2f}", f"{case['linear']:.1e}",
            f"{case['angular']:.1e}", f"{case['energy']:.1e}",
        )
        for case in cases
    ]  # fmt: skip
    return (
        "Thrown, turning and stretched at once; the largest changes over all steps, relative.\n\n"
        + table(head, rows)
    )


def _modes(cases: Sequence[Case]) -> str:
    names = [(row["mode"], row["exact"]) for row in cases[0]["levels"][0]["modes"]]
    head = ("k", "coupling", "unknowns", *(f"{name}: {exact:.4f}" for name, exact in names),
            "worst of all", "rigid")  # fmt: skip
    rows = []
    for case in cases:
        for level in case["levels"]:
            rows.append((
                str(level["degree"]), case["coupling"], str(level["unknowns"]),
                *(f"{row['mean']:.4f}" for row in level["modes"]),
                f"{100 * level['off']:.2g} %", f"{level['rigid']:.0e}",
            ))  # fmt: skip
    poisson = cases[0]["poisson"]
    return (
        "omega R / c_s, Poisson's ratio "
        f"{poisson:g}; torsional (T) and spheroidal (S) modes of order n, the mean of 2 n + 1 equal"
        " ones, with the exact value in the head (Lamb 1882); each mesh halves all spans and"
        " tets of the one before.\n\n" + table(head, rows)
    )


def _rest(cases: Sequence[Case]) -> str:
    head = ("body", "k", "coupling", "unknowns", "linear: six rigid motions", "svk: turns by 2 rad")
    rows = [
        (
            case["case"], str(case["degree"]), case["coupling"], str(case["unknowns"]),
            f"{case['linear']:.1e}", f"{case['svk']:.1e}",
        )
        for case in cases
    ]  # fmt: skip
    return "Largest energy, as a share of that of a stretch of the same size.\n\n" + table(
        head, rows
    )
