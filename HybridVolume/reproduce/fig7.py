# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce fig7 -o DIR``: the paper's Fig. 7 remade.

The disk with a biquadratic ring and linear triangles, and with triangles only: errors over three
refinements and more, and both solutions as heights on an intermediate level. Writes ``fig7.json``,
``fig7.md`` and ``pictures``.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from HybridVolume.completion import Screen
from HybridVolume.core.analysis.plane_ring import PlaneRing
from HybridVolume.core.analysis.simplex_space import SimplexSpace, lattice, shape_functions
from HybridVolume.exports.picture import write_scenes
from HybridVolume.exports.scene import Scene, Skin, Wire
from HybridVolume.job import worker_python

from .plane_problems import Problem
from .plane_report import reported
from .plane_study import Family, Space, solved, studied
from .rates2d import WORDS, as_levels, compare, paper_demands, paper_mode
from .table import demand_table

DEPTH = 0.3
SHOWN = 1
"""Level whose solutions are drawn; of triangles only that of"""
DRAWN_ALONE = Family("disk", 1, spans=8)
"""these, which has about as many unknowns."""
HEIGHT = 0.5
"""Of the drawing, over the largest value."""
SIZE = (680, 480)
"""Pixels."""
DIRECTION = np.array([0.45, -0.75, 0.62])
"""Towards the eye."""
RED, GREY, DARK = (0.80, 0.27, 0.20), (0.80, 0.83, 0.86), (0.16, 0.20, 0.25)
_FINE = 8
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
    levels = 3 if options.small else 5
    hybrid = paper_mode(DEPTH, levels=levels)

    def make(screen: Screen) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        alone = Family("disk", 1, spans=6, levels=levels + 1)
        cases = [studied(family, screen.line) for family in (hybrid, alone)]
        compare(cases)
        return cases, paper_demands(cases, DEPTH)

    def draw(folder: Path) -> list[list[str]]:
        return _reliefs({"hybrid": hybrid, "triangles": DRAWN_ALONE}, folder)

    return reported("fig7", options, make, _paragraphs, draw)


def _paragraphs(found: Mapping[str, Any]) -> list[str]:
    return [
        "## Fig. 7 of the paper",
        WORDS,
        demand_table(found["demands"]),
        as_levels(found["cases"]),
    ]


def _reliefs(families: Mapping[str, Family], folder: Path) -> list[list[str]]:
    """Draw solutions as heights; return names and titles."""
    words = {
        "hybrid": "The solution along z on ring and triangles, as in the paper's Fig. 7",
        "triangles": "The solution along z on triangles only, as in the paper's Fig. 7",
    }
    scenes = {}
    for which, family in families.items():
        space = next(islice(family.spaces(), SHOWN, None))
        scenes[folder / f"fig7_{which}.png"] = relief(space, family.problem())
    write_scenes(scenes, worker_python(), size=SIZE)
    return [[f"fig7_{which}.png", words[which]] for which in families]


def relief(space: Space, problem: Problem) -> Scene:
    """The answer as heights over the plane: elements of the ring red, triangles grey."""
    answer = solved(space, problem)
    shell, core = space.parts(answer.values)
    scale = HEIGHT / max(np.abs(shell).max(initial=0.0), np.abs(core).max())
    parts = [(_of_triangles(space.tets, scale * core), GREY)]
    if isinstance(space.spline, PlaneRing):
        parts.append((_of_ring(space.spline, scale * shell), RED))
    skins = [
        Skin(facets.reshape(-1, 3), None, np.arange(3 * len(facets)).reshape(-1, 3), colour)
        for (facets, _), colour in parts
    ]
    wires = [Wire(lines, DARK, 1.0) for (_, lines), _ in parts]
    everything = np.concatenate([skin.points for skin in skins])
    reach = 0.5 * float(np.linalg.norm(np.ptp(everything, axis=0)))
    return Scene(tuple(skins), tuple(wires), DIRECTION, np.array([0.0, 0.0, 1.0]), reach)


def _of_triangles(core: SimplexSpace, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Facets (m, 3, 3) of the heights on triangles, and lines along their edges."""
    counts = lattice(2, _FINE)
    functions, _ = shape_functions(core.degree, counts[:, 1:] / _FINE)
    heights = values[core.elements] @ functions.T
    points = np.concatenate([functions @ core.nodes[core.elements], heights[..., None]], axis=2)
    place = {tuple(c): k for k, c in enumerate(counts.tolist())}
    steps = [(i, j, _FINE - i - j) for i in range(_FINE) for j in range(_FINE - i)]
    facets = [[place[i + 1, j, k - 1], place[i, j + 1, k - 1], place[i, j, k]]
              for i, j, k in steps]  # fmt: skip
    facets += [[place[i + 1, j, k - 1], place[i + 1, j + 1, k - 2], place[i, j + 1, k - 1]]
               for i, j, k in steps if k > 1]  # fmt: skip
    sides = [np.flatnonzero(counts[:, c] == 0) for c in range(3)]
    sides = [side[np.argsort(counts[side, (c + 1) % 3])] for c, side in enumerate(sides)]
    lines = np.concatenate([points[:, side] for side in sides])
    return points[:, np.array(facets)].reshape(-1, 3, 3), lines


def _of_ring(ring: PlaneRing, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Facets (m, 3, 3) of the heights on all elements of a ring, and lines along their edges."""
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
    points = np.column_stack([basis @ ring.control_points, basis @ values])
    points = points.reshape(-1, len(x), len(x), 3)
    a, b, c, d = (points[:, i : i + _FINE, j : j + _FINE].reshape(-1, 3)
                  for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))  # fmt: skip
    facets = np.concatenate([np.stack(three, axis=1) for three in ((a, b, c), (a, c, d))])
    return facets, np.concatenate([points[:, 0], points[:, -1], points[:, :, 0], points[:, :, -1]])
