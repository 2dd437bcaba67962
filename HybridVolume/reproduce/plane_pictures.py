# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Pictures of the studies in the plane, drawn in the worker's Python, whose matplotlib is known.

``python -m HybridVolume.reproduce.plane_pictures DIR/NAME.json`` draws what the file holds to
``DIR/pictures`` and prints names and titles as JSON.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .cases import drawn_elsewhere

TIME_LIMIT = 300.0
RED, DARK = "#c0392b", "#2c3e50"
COLOURS = ("#c0392b", "#1f6fb2", "#2e8b57", "#e08e0b", "#7d3c98", "#117a8b")
DPI, SHADES = 88, 64
"""Of the pictures, which are as small as that."""


def draw(file: Path, python: str) -> list[list[str]]:
    """Names and titles of the pictures of a study, drawn by another Python.

    Parameters
    ----------
    file : Path
        ``rates2d.json``, ``fig7.json`` or ``depth.json``.
    python : str
        The worker's interpreter.

    Raises
    ------
    WorkerError
        It failed.
    """
    return [list(pair) for pair in drawn_elsewhere(__name__, file, python, TIME_LIMIT)]


# ------------------------------------------------------------------------- in another process


def rates2d(found: Mapping[str, Any], folder: Path) -> list[list[str]]:
    """Errors over unknowns: the paper's mode, higher degrees, other bodies."""
    from matplotlib.figure import Figure

    cases = [case for case in found["cases"] if len(case["levels"]) > 1]
    groups = {
        "disk, linear triangles": [c for c in cases if (c["body"], c["k"]) == ("disk", 1)],
        "disk, higher degrees": [c for c in cases if c["body"] == "disk" and c["k"] > 1],
        "other bodies": [c for c in cases if c["body"] != "disk"],
    }
    groups = {title: chosen for title, chosen in groups.items() if chosen}
    figure = Figure(figsize=(4.9 * len(groups), 7.0), layout="constrained")
    axes = figure.subplots(1, len(groups), squeeze=False)[0]
    for here, (title, chosen) in zip(axes, groups.items(), strict=True):
        for number, case in enumerate(chosen):
            look = {"color": COLOURS[number % len(COLOURS)]} if case["p"] else {"color": "black"}
            style = "--" if not case["p"] else ("-", "-.", ":")[number // len(COLOURS) % 3]
            _line(here, case, _label(case, title), linestyle=style, **look)
        _slopes(here, sorted({case["k"] + 1 for case in chosen}))
        here.set_title(title)
        here.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.14), frameon=False)
    axes[0].set_ylabel("error in L2")
    name = "rates2d_convergence.png"
    _save(figure, folder / name)
    return [[name, "Errors over unknowns in the plane, with slopes in h"]]


def fig7(found: Mapping[str, Any], folder: Path) -> list[list[str]]:
    """Errors on both representations."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2, 4.4), layout="constrained")
    here = figure.subplots()
    for case, colour in zip(found["cases"], (RED, DARK), strict=True):
        words = "ring of NURBS and triangles" if case["p"] else "triangles only"
        _line(here, case, words, color=colour)
    _slopes(here, [2])
    here.set_ylabel("error in L2")
    here.legend()
    _save(figure, folder / "fig7_convergence.png")
    return [["fig7_convergence.png", "Errors on both representations, as in the paper's Fig. 7"]]


def depth(found: Mapping[str, Any], folder: Path) -> list[list[str]]:
    """Errors over those of triangles alone against the depth of the ring, lines by its layers."""
    from matplotlib.figure import Figure

    degrees = sorted({case["k"] for case in found["cases"]})
    figure = Figure(figsize=(4.6 * len(degrees), 4.2), layout="constrained")
    axes = figure.subplots(1, len(degrees), squeeze=False)[0]
    for here, k in zip(axes, degrees, strict=True):
        chosen = [case for case in found["cases"] if case["k"] == k and case["p"]]
        for colour, layers in zip(COLOURS, sorted({c["layers"] for c in chosen}), strict=False):
            line = [(c["depth"], c["l2_share"]) for c in chosen
                    if c["layers"] == layers and c["l2_share"]]  # fmt: skip
            here.plot(*zip(*sorted(line), strict=True), marker="o", markersize=4, color=colour,
                      label=f"{layers} layer{'s' * (layers > 1)} at the start")  # fmt: skip
        here.axhline(1.0, color="black", linestyle="--", linewidth=1.0)
        here.set(xlabel="depth of the ring, share of the radius", yscale="log",
                 title=f"triangles of degree {k}")  # fmt: skip
        here.grid(True, which="both", linewidth=0.3)
        here.legend(fontsize=8)
    axes[0].set_ylabel("error over that of triangles alone")
    name = "depth_share.png"
    _save(figure, folder / name)
    return [[name, "Error at equal unknowns against the depth of the ring"]]


def _save(figure: Any, path: Path) -> None:
    """Write a figure with few colours."""
    from PIL import Image

    figure.savefig(path, dpi=DPI)
    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(SHADES)
    small.save(path, optimize=True)


def _label(case: Mapping[str, Any], title: str) -> str:
    body = (
        ""
        if title.startswith("disk")
        else case["body"] + (" elastic" if case["elastic"] else "") + ", "
    )
    degree = "" if title.endswith("linear triangles") else f"k {case['k']}, "
    if not case["p"]:
        return f"{body}{degree}triangles only"
    edges = {"greville": "nodes t_l", 1: "1 edge a span"}.get(
        case["nodes"], f"{case['nodes']} edges a span"
    )
    way = f"{edges}{', anew' if case['anew'] else ''}"
    if case["k"] > 1:
        way = case["coupling"] + (f", {edges}" if case["nodes"] != 1 else "")
    return f"{body}{degree}p {case['p']}, depth {case['depth']:g}, {way}"


def _line(axes: Any, case: Mapping[str, Any], label: str, **look: Any) -> None:
    rows = case["levels"]
    axes.loglog([row["unknowns"] for row in rows], [row["l2"] for row in rows], label=label,
                marker="o", markersize=3.5, linewidth=1.2, **look)  # fmt: skip
    axes.set_xlabel("unknowns n")
    axes.grid(True, which="both", linewidth=0.3)


def _slopes(axes: Any, orders: Sequence[int]) -> None:
    """Lines of h^order, h = n^(-1/2), below the curves."""
    low, high = axes.get_xlim()
    bottom = axes.get_ylim()[0]
    x = np.array([low * (high / low) ** 0.08, low * (high / low) ** 0.38])
    for number, order in enumerate(orders):
        y = 1.5**number * 2.0 * bottom * (x / x[-1]) ** (-0.5 * order)
        axes.loglog(x, y, color="grey", linewidth=1.0, linestyle=":")
        axes.annotate(f"$h^{order}$", (x[0], y[0]), fontsize=9, color="grey",
                      ha="right", va="bottom")  # fmt: skip
    axes.set_xlim(low, high)


def main(arguments: list[str] | None = None) -> int:
    """Draw and print; return the exit code."""
    (name,) = sys.argv[1:] if arguments is None else arguments
    file = Path(name)
    folder = file.parent / "pictures"
    folder.mkdir(exist_ok=True)
    found = json.loads(file.read_text(encoding="utf-8"))
    print(json.dumps({"rates2d": rates2d, "fig7": fig7, "depth": depth}[file.stem](found, folder)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
