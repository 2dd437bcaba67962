# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Tables of ``./run.sh reproduce fig2``, and what is demanded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .fig2_drop import AGAINST, BODIES, CALM
from .fig2_pictures import WORDS
from .table import demand_table, made_on, table

Case = Mapping[str, Any]
DRIFT = 1e-6
"""Share of the energy that may be lost or gained."""


def demands(cases: Sequence[Case], shown: float) -> list[dict[str, Any]]:
    """What the figure has to show, and whether it does.

    Parameters
    ----------
    cases : sequence of mapping
        Those that failed too.
    shown : float
        Young's modulus of the pictures, MPa.
    """
    made = [case for case in cases if not case["error"]]
    scan = [case for case in made if case["part"] == "scan"]
    at = {case["case"]: case for case in scan if case["drop"]["young"] == shown}
    rows = []

    def row(case: str, demand: str, figure: str, met: bool | None) -> None:
        rows.append({"case": case, "demand": demand, "figure": figure, "met": met})

    if made:
        spread = max(abs(case["unknowns"] / case["drop"]["unknowns"] - 1.0) for case in made)
        row("all", f"unknowns within {100 * AGAINST:g} % of the number wanted",
            f"{100 * spread:.1f} % at most", spread <= AGAINST)  # fmt: skip
        left = max(case["rest"]["forces_left"] for case in made)
        row("all", f"at rest: forces balance to {100 * CALM:g} % of the weight",
            f"{100 * left:.2g} %", left <= CALM)  # fmt: skip
        drift = max(case["drift"] for case in made)
        row("all", f"energy with viscous heat kept to {DRIFT:g} of the fall's while bouncing",
            f"{drift:.1e}", drift <= DRIFT)  # fmt: skip
    if "triangles" in at:
        state = at["triangles"]["rest"]
        row(WORDS["triangles"], f"flipped elements stay ({1e3 * shown:g} kPa, at rest)",
            str(state["flipped"]), state["flipped"] > 0)  # fmt: skip
    if "three-layers" in at:
        state = at["three-layers"]["rest"]
        row(WORDS["three-layers"], f"no flipped element stays ({1e3 * shown:g} kPa, at rest)",
            str(state["flipped"]), state["flipped"] == 0)  # fmt: skip
    limits = {body.name: safe_from(scan, body.name) for body in BODIES}
    if len({case["drop"]["young"] for case in scan}) > 1:
        figures = [f"{WORDS[name]} {'none' if least is None else f'{1e3 * least:g}'}"
                   for name, least in limits.items()]  # fmt: skip
        alone, layers = (limits[name] or float("inf") for name in ("triangles", "three-layers"))
        row("scan", "least stiffness without flips at rest, kPa: three layers stand less than "
            "triangles alone", ", ".join(figures), layers < alone)  # fmt: skip
    return rows


def safe_from(scan: Sequence[Case], body: str) -> float | None:
    """Least Young's modulus, MPa, from which on a body has no flipped element at rest."""
    rows = sorted((case for case in scan if case["case"] == body),
                  key=lambda case: -case["drop"]["young"])  # fmt: skip
    found = None
    for case in rows:
        if case["rest"]["flipped"]:
            break
        found = case["drop"]["young"]
    return found


def as_markdown(found: Mapping[str, Any]) -> str:
    """The part of docs/verification.md that tells of the drop."""
    made = [case for case in found["cases"] if not case["error"]]
    text = ["## An elastic disk dropped on a plane (Fig. 2)\n", "```", found["command"], "```\n"]
    text.append(made_on(found, "cases"))
    if made:
        text += [_set_up(made[0]), demand_table(found["demands"])]
    parts = {
        "scan": "Flipped elements by stiffness",
        "turned": "The same with meshes turned in the disk",
        "step": "The same with half the time step",
        "finer": "The same with twice the unknowns",
        "thicker": "Thicker layers",
        "higher": "The same impact with a third of the weight: three times as high, and as stiff",
    }
    shown = found["shown"]
    if "fig2_states.png" in found["pictures"]:
        text.append(
            f"![Maximal impact (above) and rest (below) at {1e3 * shown:g} kPa; red is flipped]"
            "(pictures/fig2_states.png)\n"
        )
    for part, head in parts.items():
        rows = [case for case in made if case["part"] == part]
        if rows:
            text.append(f"### {head}\n\n{_table(rows)}")
    captions = {
        "fig2_scan.png": "Flipped share of the area by stiffness",
        "fig2_energies.png": f"Elastic energy and flipped elements over time, {1e3 * shown:g} kPa",
    }
    for name, words in captions.items():
        if name in found["pictures"]:
            text.append(f"![{words}](pictures/{name})\n")
    for case in found["cases"]:
        if case["error"]:
            text.append(f"- {case['name']}: {case['error']['message']}\n")
    return "\n".join(text)


def _set_up(case: Case) -> str:
    drop = case["drop"]
    depths = ", ".join(f"{100 * body.depth:g}" for body in BODIES if body.layers)
    return (
        f"A disk of radius {drop['radius']:g} mm (a closed C² cubic spline) falls"
        f" {drop['height']:g} mm onto a plane without friction."
        f" St. Venant-Kirchhoff material, plane strain, density"
        f" {drop['density']:g} t/mm³, Poisson's ratio {drop['poisson']:g}; viscosity"
        f" {1e3 * drop['viscosity']:g} ms times Young's modulus; penalty of"
        f" {drop['contact']:g} E for each mm of depth. The rule that keeps energy, with steps of"
        f" {1e3 * drop['step']:g} ms for {1e3 * drop['duration']:g} ms from the first touch; then"
        " the body comes to rest with more viscosity, a rule that damps and steps that grow as it"
        " slows down, the same for all. One, two and three layers of bicubic"
        f" elements (C² along the boundary) take {depths} % of the radius; linear triangles inside"
        " are tied by collocation, the paper's mode. *Maximal impact* is the state of the largest"
        " elastic energy, as in the paper.\n\n"
        "A mirrored triangle of this material has no energy, and a crease along edges of linear"
        " triangles costs none: what an impact turns inside out may stay so. A crease in a C² layer"
        " bends elements, which costs energy, so that it can open again. Materials much softer than"
        " the least that is free of flips fold whatever the elements are.\n\n"
        "A triangle counts as flipped with det F < 0, a spline element as soon as det J > 0 is"
        " not proved on all of it (Bernstein coefficients); *area* is that of all places with"
        " det F < 0, as a share of the disk; *most* is the largest number of elements that are"
        " flipped at any time (at quadrature points).\n"
    )


def _table(rows: Sequence[Case]) -> str:
    head = (
        "E kPa", "rho v²/E", "turned", "step ms", "body", "depth %", "unknowns", "triangles",
        "spline elements", "impact ms", "flipped at impact", "area %", "most",
        "flipped at rest", "area %", "height at rest mm", "drift", "CPU s",
    )  # fmt: skip
    order = [body.name for body in BODIES]
    rows = sorted(
        rows,
        key=lambda c: (c["drop"]["young"], c["drop"]["turn"], order.index(c["case"])),
    )
    return table(head, [_row(case) for case in rows])


def _row(case: Case) -> tuple[str, ...]:
    drop, impact, rest = case["drop"], case["impact"], case["rest"]
    return (
        f"{1e3 * drop['young']:g}",
        f"{case['softness']:.3f}",
        f"{drop['turn']:g}°",
        f"{1e3 * drop['step']:g}",
        WORDS[case["case"]],
        f"{100 * case['body']['depth']:g}",
        str(case["unknowns"]),
        str(case["triangles"]),
        str(case["ring_elements"]),
        f"{1e3 * impact['time']:.0f}",
        _flips(impact),
        f"{100 * impact['area']:.1f}",
        str(case["most"]),
        _flips(rest),
        f"{100 * rest['area']:.1f}",
        f"{rest['height']:.1f}",
        f"{case['drift']:.0e}",
        f"{case['seconds_cpu']:.0f}",
    )


def _flips(state: Mapping[str, Any]) -> str:
    """Flipped triangles and spline elements."""
    return f"{state['triangles']} + {state['ring']}" if state["ring"] else str(state["triangles"])
