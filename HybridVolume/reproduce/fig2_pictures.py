# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Pictures of ``./run.sh reproduce fig2``, drawn in the worker's Python, whose matplotlib is known.

``python -m HybridVolume.reproduce.fig2_pictures DIR`` draws what DIR/fig2.json holds and prints the
names of the files as JSON.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from HybridVolume.core.atomic import replacing

from .cases import drawn_elsewhere

TIME_LIMIT = 300.0
COLOURS, DOTS = 48, 90
"""Colours of a picture, and its dots an inch."""
WORDS = {
    "triangles": "triangles only",
    "one-layer": "one layer",
    "two-layers": "two layers",
    "three-layers": "three layers",
}
INSIDE, RING, FLIPPED, PLANE = "#f4f1e8", "#dbe6f4", "#d62728", "#2e7d32"

Case = Mapping[str, Any]


def draw(folder: Path, python: str) -> list[str]:
    """Names of the pictures in a folder that holds ``fig2.json``, drawn by another Python.

    Parameters
    ----------
    folder : Path
    python : str
        The worker's interpreter.

    Raises
    ------
    WorkerError
        It failed.
    """
    return drawn_elsewhere(__name__, folder, python, TIME_LIMIT)


def states(cases: Sequence[Case], path: Path) -> None:
    """Two rows as in the paper's figure: maximal impact above, rest below."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        2,
        len(cases),
        dpi=DOTS,
        figsize=(3.1 * len(cases), 5.6),
        sharex=True,
        sharey="row",
        squeeze=False,
    )
    for column, case in zip(axes.T, cases, strict=True):
        radius = case["drop"]["radius"]
        for axis, when in zip(column, ("impact", "rest"), strict=True):
            _state(axis, case[when])
            axis.axhline(-radius, color=PLANE, linewidth=1.5)
            state = case[when]
            flips = f"{state['triangles']} triangles flipped"
            if case["ring_elements"]:
                flips += f", {state['ring']} spline elements"
            axis.set_title(flips, fontsize=8, y=-0.08)
            axis.set_aspect("equal")
            axis.axis("off")
        column[0].text(
            0.5,
            1.0,
            f"{WORDS[case['case']]}, {case['unknowns']} unknowns",
            transform=column[0].transAxes,
            ha="center",
            fontsize=10,
        )
    for axis, words in zip(axes[:, 0], ("maximal impact", "at rest"), strict=True):
        axis.text(-0.02, 0.5, words, transform=axis.transAxes, rotation=90, va="center")
    figure.tight_layout()
    _save(figure, path)


def _state(axis: Any, state: Mapping[str, Any]) -> None:
    """One body: triangles, spline elements, and red what is flipped."""
    from matplotlib.collections import LineCollection, PolyCollection

    outline = state["outline"]
    vertices, triangles = np.array(outline["vertices"]), np.array(outline["triangles"])
    colours = np.full(len(triangles), INSIDE, dtype=object)
    colours[outline["turned"]] = FLIPPED
    if outline["lines"]:
        axis.fill(*np.array(outline["lines"][0]).T, color=RING, linewidth=0)
    # flipped ones last, so that nothing hides them
    order = np.argsort(colours == FLIPPED, kind="stable")
    axis.add_collection(
        PolyCollection(
            vertices[triangles[order]],
            facecolors=list(colours[order]),
            edgecolors=["#5a0000" if one == FLIPPED else "0.35" for one in colours[order]],
            linewidths=0.3,
        )
    )
    if outline["folded"]:
        axis.add_collection(PolyCollection(outline["folded"], facecolors=FLIPPED, linewidths=0))
    if outline["lines"]:
        lines = [np.array(line) for line in outline["lines"]]
        axis.add_collection(LineCollection(lines, colors="#1f4e9c", linewidths=0.7))
    axis.autoscale_view()


def _save(figure: Any, path: Path) -> None:
    """Write a picture with few colours, which makes a small file."""
    import matplotlib.pyplot as plt
    from PIL import Image

    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3]
    plt.close(figure)
    few = Image.fromarray(np.ascontiguousarray(pixels)).quantize(COLOURS)
    with replacing(path) as file:
        few.save(file, format="PNG", optimize=True)


def scan(cases: Sequence[Case], path: Path) -> None:
    """Flipped elements at impact and at rest over the stiffness."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, dpi=DOTS, figsize=(8.0, 3.2))
    for axis, when, title in zip(
        axes, ("impact", "rest"), ("maximal impact", "at rest"), strict=True
    ):
        for name, words in WORDS.items():
            rows = sorted((c for c in cases if c["case"] == name), key=lambda c: c["drop"]["young"])
            axis.plot(
                [1e3 * row["drop"]["young"] for row in rows],
                [100.0 * row[when]["area"] for row in rows],
                "o-",
                label=words,
            )
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("Young's modulus, kPa")
        axis.set_ylabel("area that is flipped, %")
    axes[1].legend(fontsize=8)
    figure.tight_layout()
    _save(figure, path)


def energies(cases: Sequence[Case], path: Path) -> None:
    """Elastic energy, and the number of flipped elements, over time."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, dpi=DOTS, figsize=(8.0, 3.2))
    for case in cases:
        time = [1e3 * row["time"] for row in case["energies"]]
        axes[0].plot(time, [row["elastic"] for row in case["energies"]], label=WORDS[case["case"]])
        axes[1].plot(time, [row["flipped"] for row in case["energies"]])
    axes[0].set_ylabel("elastic energy, mJ a mm of thickness")
    axes[1].set_ylabel("elements that are flipped")
    axes[0].legend(fontsize=8)
    for axis in axes:
        axis.set_xlabel("time from the first touch, ms")
    figure.tight_layout()
    _save(figure, path)


def main(arguments: list[str] | None = None) -> int:
    """Draw and print; return the exit code."""
    import matplotlib

    matplotlib.use("Agg")
    (name,) = sys.argv[1:] if arguments is None else arguments
    folder = Path(name)
    found = json.loads((folder / "fig2.json").read_text(encoding="utf-8"))
    made = [case for case in found["cases"] if not case["error"] and case["part"] == "scan"]
    shown = [case for case in made if case["drop"]["young"] == found["shown"]]
    names = []
    if shown:
        states(shown, folder / "pictures" / "fig2_states.png")
        energies(shown, folder / "pictures" / "fig2_energies.png")
        names += ["fig2_states.png", "fig2_energies.png"]
    if len({case["drop"]["young"] for case in made}) > 1:
        scan(made, folder / "pictures" / "fig2_scan.png")
        names.append("fig2_scan.png")
    print(json.dumps(names))
    return 0


if __name__ == "__main__":
    sys.exit(main())
