# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Tables and pictures of the accuracy cases, and what they show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

GRADED = "tet10-graded"
WAYS = {"ccx": "CalculiX", "recovered": "recovered"}
TITLES = {
    "hybrid": "hybrid",
    "tet10": "tet10, uniform (Gmsh)",
    GRADED: "tet10, graded (Gmsh)",
    "netgen-layers": "boundary layers (Netgen)",
}
SHARES = {"rms": 1.0 / 3.0, "max": 1.0 / 5.0}
"""Of the nodes of graded tet10 that the hybrid mesh may need for 1 %."""
PEAK_NODES, PEAK = 2000, 0.3
"""Per cent by which the largest von Mises stress may be off on a mesh of about so many nodes."""
_NEAR = 1.2
_FAR = 10.0
"""How far beyond the finest mesh a number of nodes is extrapolated."""
_TICKS = (500, 1000, 2000, 5000, 10000, 20000)

Case = Mapping[str, Any]


def _rows(case: Case) -> list[Mapping[str, Any]]:
    """Refinements that were solved, coarse first."""
    rows = [row for row in case.get("rows", ()) if "error" not in row]
    return sorted(rows, key=lambda row: row["nodes"])


def _by_problem(cases: Iterable[Case]) -> dict[str, dict[str, Case]]:
    found: dict[str, dict[str, Case]] = {}
    for case in cases:
        if "problem" in case:
            found.setdefault(case["problem"], {})[case["mesher"]] = case
    return found


def nodes_needed(
    rows: Sequence[Mapping[str, Any]], way: str, figure: str, per_cent: float = 1.0
) -> tuple[float, bool]:
    """Nodes with which an error stays below a bound from there on.

    Between two meshes, and beyond the finest up to `_FAR` times its nodes, the error is taken as a
    power of the number of nodes; the power beyond is that from the coarsest mesh to the finest.

    Returns
    -------
    nodes : float
        Not a number where it cannot be told.
    measured : bool
        Whether it lies among the meshes that were solved, and is not extrapolated; where even the
        coarsest is below the bound, its nodes are told.
    """
    if not rows:
        return float("nan"), False
    count = np.log([row["nodes"] for row in rows])
    error = np.log([max(row[way][figure], 1e-12) / per_cent for row in rows])
    above = np.flatnonzero(error > 0.0)
    if not len(above):
        return float(np.exp(count[0])), True
    last = int(above[-1])
    if last < len(rows) - 1:
        share = error[last] / (error[last] - error[last + 1])
        return float(np.exp(count[last] + share * (count[last + 1] - count[last]))), True
    if len(rows) < 2 or error[-1] >= error[0]:
        return float("nan"), False
    power = (error[0] - error[-1]) / (count[-1] - count[0])
    return float(np.exp(count[-1] + min(error[-1] / power, np.log(_FAR)))), False


def as_markdown(cases: Sequence[Case]) -> str:
    """Section of the documentation, without a heading."""
    parts = []
    for name, meshers in _by_problem(cases).items():
        words = next(iter(meshers.values()))["words"]
        parts += [f"**{name}**: {words}.", "", *_errors(meshers), "", *_orders(meshers), ""]
    parts += ["Nodes for 1 % of boundary stress:", "", *_needs(cases), "", *_words(cases)]
    return "\n".join(parts).rstrip() + "\n"


def _errors(meshers: Mapping[str, Case]) -> list[str]:
    lines = [
        "| mesh | nodes | displacement % | energy % | CalculiX: rms / max / peak % |"
        " recovered: rms / max / peak % |",
        "|---|---|---|---|---|---|",
    ]
    for mesher, title in TITLES.items():
        case = meshers.get(mesher)
        if case is None:
            continue
        for row in case.get("rows", ()):
            if "error" in row:
                lines.append(f"| {title} | - | {row['error']} | | | |")
                continue
            stress = " | ".join(_triple(row[way]) for way in WAYS)
            lines.append(
                f"| {title} | {row['nodes']} | {_short(row['displacement'])} |"
                f" {_short(row['energy'])} | {stress} |"
            )
    return lines


def _orders(meshers: Mapping[str, Case]) -> list[str]:
    """Powers of h (nodes to the power -1/3) by which errors fall, from coarsest to finest mesh."""
    words = []
    for mesher, title in TITLES.items():
        rows = _rows(meshers.get(mesher, {}))
        if len(rows) < 2:
            continue
        step = np.log(rows[-1]["nodes"] / rows[0]["nodes"]) / 3.0
        orders = [
            float(np.log(value(rows[0]) / value(rows[-1])) / step)
            for value in (
                lambda row: row["displacement"],
                lambda row: row["energy"],
                lambda row: row["ccx"]["rms"],
                lambda row: row["recovered"]["rms"],
            )
        ]
        words.append(f"{title} " + ", ".join(f"{order:.1f}" for order in orders))
    if not words:
        return []
    return [
        "Rates in h (displacement, energy, rms by CalculiX, rms recovered): "
        + "; ".join(words)
        + "."
    ]


def _triple(figures: Mapping[str, float]) -> str:
    return f"{_short(figures['rms'])} / {_short(figures['max'])} / {figures['peak']:+.2f}"


def _short(value: float) -> str:
    return f"{value:.3f}" if value < 1.0 else f"{value:.3g}"


def _needs(cases: Sequence[Case]) -> list[str]:
    lines = [
        "| problem | error | hybrid, recovered | graded tet10, CalculiX | graded tet10, recovered |"
        " share of nodes | with the same recovery |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, meshers in _by_problem(cases).items():
        for figure in SHARES:
            own, theirs, same = (_needed(meshers, m, w, figure) for m, w in _COMPARED)
            lines.append(
                f"| {name} | {figure} | {_count(own)} | {_count(theirs)} | {_count(same)} |"
                f" {_ratio(own, theirs)} | {_ratio(own, same)} |"
            )
    return lines


_COMPARED = (("hybrid", "recovered"), (GRADED, "ccx"), (GRADED, "recovered"))


def _needed(meshers: Mapping[str, Case], mesher: str, way: str, figure: str) -> tuple[float, bool]:
    case = meshers.get(mesher)
    return nodes_needed(_rows(case), way, figure) if case else (float("nan"), False)


def _count(needed: tuple[float, bool]) -> str:
    nodes, measured = needed
    if not np.isfinite(nodes):
        return "-"
    return f"{nodes:.0f}" if measured else f"about {float(f'{nodes:.2g}'):.0f}"


def _ratio(own: tuple[float, bool], other: tuple[float, bool]) -> str:
    ratio = own[0] / other[0]
    if not np.isfinite(ratio):
        return "-"
    return f"{'' if own[1] and other[1] else 'about '}{ratio:.2f}"


def _words(cases: Sequence[Case]) -> list[str]:
    """What the figures say of energy and displacement, where there is least to gain."""
    gains: dict[str, list[float]] = {"energy": [], "displacement": []}
    for meshers in _by_problem(cases).values():
        if not {"hybrid", GRADED} <= set(meshers):
            continue
        own, theirs = _rows(meshers["hybrid"]), _rows(meshers[GRADED])
        for figure, found in gains.items():
            found += [_at(theirs, figure, row["nodes"]) / row[figure] for row in own]
    lines = []
    for figure, found in gains.items():
        found = [gain for gain in found if np.isfinite(gain)]
        if found:
            lines.append(
                f"At equal numbers of nodes graded tet10 has {min(found):.2f} to {max(found):.2f}"
                f" times the hybrid mesh's error of {figure} (median {np.median(found):.2f})."
            )
    return lines


def _at(rows: Sequence[Mapping[str, Any]], figure: str, nodes: float) -> float:
    """Error of a mesh of so many nodes, between those that were solved."""
    if len(rows) < 2:
        return float("nan")
    count = [row["nodes"] for row in rows]
    error = np.log([row[figure] for row in rows])
    if not count[0] <= nodes <= count[-1]:
        return float("nan")
    return float(np.exp(np.interp(np.log(nodes), np.log(count), error)))


def demands(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """What is asked of the accuracy, with the figures.

    Returns
    -------
    list of dict
        ``case``, ``demand``, ``figure`` (text) and ``met`` (None: only told).
    """
    found: list[dict[str, Any]] = []
    for name, meshers in _by_problem(cases).items():
        if not {"hybrid", GRADED} <= set(meshers):
            continue
        for figure, share in SHARES.items():
            own, theirs, same = (_needed(meshers, m, w, figure) for m, w in _COMPARED)
            ratio = own[0] / theirs[0]
            found.append(
                {
                    "case": name,
                    "demand": f"1 % {figure} of boundary stress with {share:.2f} of the nodes of"
                    " graded tet10",
                    "figure": f"{_count(own)} of {_count(theirs)} nodes, {_ratio(own, theirs)};"
                    f" graded tet10 with the same recovery {_count(same)}, {_ratio(own, same)}",
                    "met": bool(ratio <= share) if np.isfinite(ratio) else False,
                }
            )
        near = [row for row in _rows(meshers["hybrid"]) if row["nodes"] <= _NEAR * PEAK_NODES]
        if near:
            peak = near[-1]["recovered"]["peak"]
            found.append(
                {
                    "case": name,
                    "demand": f"largest von Mises stress within {PEAK} % at 2000 nodes",
                    "figure": f"{peak:+.2f} % at {near[-1]['nodes']} nodes; CalculiX"
                    f" {near[-1]['ccx']['peak']:+.2f} %",
                    "met": bool(abs(peak) <= PEAK),
                }
            )
    return found


def pictures(cases: Sequence[Case], folder: Path) -> list[str]:
    """Errors of boundary stress over the nodes, one picture a problem.

    Returns
    -------
    list of str
        Names of the files in ``folder``.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    names = []
    colours = dict(zip(TITLES, ("tab:blue", "tab:gray", "tab:red", "tab:green"), strict=True))
    for name, meshers in _by_problem(cases).items():
        figure = Figure(figsize=(10.0, 4.8), layout="constrained")
        for axes, (error, words) in zip(
            figure.subplots(1, 2), (("rms", "mean square"), ("max", "largest")), strict=True
        ):
            for mesher, case in meshers.items():
                rows = _rows(case)
                for way, style in (("ccx", "--"), ("recovered", "-")):
                    axes.loglog(
                        [row["nodes"] for row in rows], [row[way][error] for row in rows],
                        style, marker="o", markersize=3, color=colours[mesher],
                        label=f"{TITLES[mesher]}, {WAYS[way]}",
                    )  # fmt: skip
            axes.axhline(1.0, color="black", linewidth=0.6)
            axes.set(xlabel="nodes", ylabel="error of boundary stress, %", title=f"{name}: {words}")
            axes.set_xticks(_TICKS, [f"{tick}" for tick in _TICKS])
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.grid(True, which="both", linewidth=0.3)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4,
                      fontsize=7, handlelength=4.0)  # fmt: skip
        names.append(f"accuracy_{name}.png")
        figure.savefig(folder / names[-1], dpi=110)
    return names
