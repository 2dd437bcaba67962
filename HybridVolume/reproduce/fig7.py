# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce fig7 -o DIR``: the paper's Fig. 7 remade.

The disk with a biquadratic ring and linear triangles, and with triangles only: errors over three
refinements and more, and both solutions as heights on an intermediate level. Writes ``fig7.json``,
``fig7.md``, ``fig7_fields.npz`` and ``pictures``.
"""

from __future__ import annotations

import argparse
import time
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from HybridVolume.completion import Screen
from HybridVolume.core.analysis.plane_ring import PlaneRing
from HybridVolume.core.analysis.simplex_space import lattice, shape_functions
from HybridVolume.core.atomic import replacing
from HybridVolume.errors import WorkerError
from HybridVolume.job import worker_python

from .cases import told_figures
from .midstructure import write_json
from .plane_pictures import draw
from .plane_study import Family, Space, solved, studied
from .rates2d import WORDS, as_levels, compare, paper_demands, paper_mode
from .shell import machine
from .table import demand_table, made_on

VERSION = 1
"""Of the JSON file."""
DEPTH = 0.3
SHOWN = 1
"""Level whose solutions are drawn."""
HEIGHT = 0.5
"""Of the drawing, over the largest value."""
_FINE = 6
"""Facets along the side of an element in the drawing."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command line takes."""
    parser.add_argument("--small", action="store_true", help="two refinements only")


def run(options: argparse.Namespace) -> int:
    """Make the figure.

    Returns
    -------
    int
        0 when every demand is met, else 1.
    """
    started = time.perf_counter()
    folder = Path(options.output)
    (folder / "pictures").mkdir(parents=True, exist_ok=True)
    screen = Screen()
    levels = 3 if options.small else 5
    hybrid = paper_mode(DEPTH, levels=levels)
    alone = Family("disk", 1, spans=6, levels=levels + 1)
    cases = [studied(family, screen.line) for family in (hybrid, alone)]
    compare(cases)
    found: dict[str, Any] = {
        "version": VERSION,
        "command": "./run.sh reproduce fig7 -o DIR" + (" --small" if options.small else ""),
        "machine": machine(),
        "missing": [],
        "not_done": [],
        "cases": cases,
        "demands": paper_demands(cases, DEPTH),
        "pictures": [],
        "seconds": time.perf_counter() - started,
    }
    fields: dict[str, np.ndarray] = {}
    for which, family in (("hybrid", hybrid), ("triangles", alone)):
        space = next(islice(family.spaces(), SHOWN, None))
        fields |= {f"{which}_{key}": part for key, part in _facets(space, family).items()}
    with replacing(folder / "fig7_fields.npz") as file:
        np.savez_compressed(file, **fields)
    write_json(folder / "fig7.json", found)
    try:
        found["pictures"] = draw(folder / "fig7.json", worker_python())
    except WorkerError as error:
        screen.line(f"no pictures: {error.line}")
    write_json(folder / "fig7.json", found)
    return told_figures(found, _as_markdown(found), folder / "fig7.md", screen, ("cases",))


def _as_markdown(found: dict[str, Any]) -> str:
    parts = [
        "## Fig. 7 of the paper",
        f"`{found['command']}`",
        made_on(found, "cases").replace(", two cases side by side with one thread each", ""),
        WORDS,
        demand_table(found["demands"]),
        as_levels(found["cases"]),
    ]
    parts += [f"![{words}](pictures/{name})" for name, words in found["pictures"]]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _facets(space: Space, family: Family) -> dict[str, np.ndarray]:
    """The answer as heights: triangles of points (x, y, z), and the elements' edges."""
    answer = solved(space, family.problem())
    shell, core = space.parts(answer.values)
    scale = HEIGHT / max(np.abs(shell).max(initial=0.0), np.abs(core).max())
    found = {}
    if isinstance(space.spline, PlaneRing):
        found["ring"], found["ring_edges"] = _of_ring(space.spline, scale * shell)
    values, _ = shape_functions(space.tets.degree, lattice(2, _FINE)[:, 1:] / _FINE)
    points = values @ space.tets.nodes[space.tets.elements]
    heights = scale * core[space.tets.elements] @ values.T
    points = np.concatenate([points, heights[..., None]], axis=2)
    counts = lattice(2, _FINE)
    place = {tuple(c): k for k, c in enumerate(counts.tolist())}
    up = [(i, j, _FINE - i - j) for i in range(_FINE) for j in range(_FINE - i)]
    facets = [[place[i + 1, j, k - 1], place[i, j + 1, k - 1], place[i, j, k]]
              for i, j, k in up]  # fmt: skip
    facets += [[place[i + 1, j, k - 1], place[i + 1, j + 1, k - 2], place[i, j + 1, k - 1]]
               for i, j, k in up if k > 1]  # fmt: skip
    found["core"] = points[:, np.array(facets)].reshape(-1, 3, 3)
    sides = [np.flatnonzero(counts[:, c] == 0) for c in range(3)]
    sides = [side[np.argsort(counts[side, (c + 1) % 3])] for c, side in enumerate(sides)]
    lines = np.concatenate([points[:, side] for side in sides])
    found["core_edges"] = np.stack([lines[:, :-1], lines[:, 1:]], 2).reshape(-1, 2, 3)
    return found


def _of_ring(ring: PlaneRing, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Facets and edges of all elements of a ring."""
    spans = ring.curve.spans
    x = np.linspace(0.0, 1.0, _FINE + 1)
    lines = np.unique(ring.knots_w)
    u = spans.ends[:, :1] + np.diff(spans.ends, axis=1) * x
    w = lines[:-1, None] + np.diff(lines)[:, None] * x
    shape = (len(u), len(w), len(x), len(x))
    at_u = np.broadcast_to(u[:, None, :, None], shape).ravel()
    at_w = np.broadcast_to(w[None, :, None, :], shape).ravel()
    patch = np.broadcast_to(spans.patch[:, None, None, None], shape).ravel()
    basis = ring.basis_at(patch, at_u[:, None], at_w)
    points = np.column_stack([basis @ ring.control_points, basis @ values]).reshape(*shape, 3)
    points = points.reshape(-1, len(x), len(x), 3)
    a, b, c, d = (points[:, i : i + _FINE, j : j + _FINE].reshape(-1, 3)
                  for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))  # fmt: skip
    facets = np.concatenate([np.stack(three, axis=1) for three in ((a, b, c), (a, c, d))])
    rims = [points[:, 0], points[:, -1], points[:, :, 0], points[:, :, -1]]
    edges = np.concatenate([np.stack([rim[:, :-1], rim[:, 1:]], 2).reshape(-1, 2, 3)
                            for rim in rims])  # fmt: skip
    return facets, edges
