# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Pictures of ``./run.sh reproduce rates3d``: errors over unknowns, and errors on a cut.

``python -m HybridVolume.reproduce.rates3d_pictures DIR`` in the worker's Python draws what
DIR/rates3d.json and DIR/cases hold, and prints names and words as JSON.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from itertools import permutations
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.core import bspline
from HybridVolume.core.analysis.coupling import CollocationSpace, NitscheSpace
from HybridVolume.core.analysis.simplex_space import lattice, shape_functions
from HybridVolume.core.atomic import beside

from .cases import drawn_elsewhere
from .rates3d_table import short
from .small_pictures import shrunk

if TYPE_CHECKING:
    from .rates3d_problems import Problem

TIME_LIMIT = 300.0
SIZE = (900, 640)
"""Pixels of a cut."""
CELLS = 4
"""Parts of the sides of elements in pictures of cuts."""
COLOURS = ("tab:blue", "tab:red", "tab:green", "tab:orange", "tab:purple", "tab:brown")


def draw(folder: Path, python: str) -> list[list[str]]:
    """Names and words of the pictures beside ``rates3d.json``, drawn by another Python.

    Parameters
    ----------
    folder : Path
        Holds ``rates3d.json`` and ``cases``.
    python : str
        The worker's interpreter.

    Raises
    ------
    WorkerError
        It failed.
    """
    return drawn_elsewhere(__name__, folder, python, TIME_LIMIT)


# ------------------------------------------------------------------- what a case leaves for them


def sampled_errors(
    space: CollocationSpace | NitscheSpace, values: np.ndarray, problem: Problem
) -> dict[str, np.ndarray]:
    """Size of the error at places in all elements, and small cells between them.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
    values : (size, ...) array
        The answer.
    problem : Problem

    Returns
    -------
    dict
        ``points`` (m, 3), mm; ``error`` (m,); ``hexahedra`` (nh, 8) and ``tets`` (nt, 4) of them.
    """
    shell, core = (part.reshape(len(part), -1) for part in space.parts(values))
    spline, tets = space.spline, space.tets
    places, hexahedra, count = [], [], 0
    line_w = _fine(bspline.breakpoints(spline.knots_w))
    for number, patch in enumerate(spline.shell.surface.patches):
        lines = [_fine(bspline.breakpoints(knots)) for knots in patch.knots]
        u, v, w = np.meshgrid(*lines, line_w, indexing="ij")
        places.append((np.full(u.size, number), u.ravel(), v.ravel(), w.ravel()))
        grid = count + np.arange(u.size).reshape(u.shape)
        corners = [grid[a:, b:, c:][: u.shape[0] - 1, : u.shape[1] - 1, : u.shape[2] - 1]
                   for a, b, c in ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0),
                                   (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))]  # fmt: skip
        hexahedra.append(np.stack(corners, axis=-1).reshape(-1, 8))
        count += u.size
    patch, u, v, w = (np.concatenate(column) for column in zip(*places, strict=True))
    basis = spline.basis_at(patch, np.column_stack([u, v]), w)
    points, found = basis @ spline.control_points, basis @ shell

    at = lattice(3, CELLS)[:, 1:] / CELLS
    inside, _ = shape_functions(tets.degree, at)
    core_points = inside @ tets.nodes[tets.elements]
    core_found = inside @ core[tets.elements]
    first = len(points) + len(at) * np.arange(len(tets.elements))
    cells = (first[:, None, None] + _small_tets()).reshape(-1, 4)
    points = np.concatenate([points, core_points.reshape(-1, 3)])
    found = np.concatenate([found, core_found.reshape(-1, found.shape[1])])
    return {
        "points": points,
        "error": np.linalg.norm(found - problem.exact(points), axis=1),
        "hexahedra": np.concatenate(hexahedra),
        "tets": cells,
    }


def _fine(knots: np.ndarray) -> np.ndarray:
    share = np.arange(CELLS) / CELLS
    return np.append((knots[:-1, None] + np.diff(knots)[:, None] * share).ravel(), knots[-1])


def _small_tets() -> np.ndarray:
    """Cells between the lattice points of a tet, (n, 4): by cubes of six tets each."""
    place = {tuple(c[1:]): k for k, c in enumerate(lattice(3, CELLS).tolist())}
    # running sums turn the tet into the part x >= y >= z of a cube, which these tets divide
    found = []
    orders = [np.eye(3, dtype=int)[list(order)] for order in permutations(range(3))]
    for corner in np.ndindex(CELLS, CELLS, CELLS):
        for order in orders:
            steps = np.vstack([np.zeros(3, dtype=int), np.cumsum(order, axis=0)]) + corner
            if (np.diff(steps, axis=1) <= 0).all() and steps.max() <= CELLS:
                back = np.column_stack([-np.diff(steps, axis=1), steps[:, 2]])
                nodes = [place[tuple(row)] for row in back.tolist()]
                turned = np.linalg.det(back[1:] - back[:1]) < 0.0
                found.append([*nodes[:2], *nodes[:1:-1]] if turned else nodes)
    return np.array(found)


# ------------------------------------------------------------------------- in another process


def _convergence(found: Mapping[str, Any], folder: Path) -> list[list[str]]:
    """Errors over unknowns, a pair of axes for each body and problem."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    made = [case for case in found["cases"] if len(case["levels"]) > 1]
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for case in made:
        groups.setdefault((case["body"], case["problem"]), []).append(case)
    if not groups:
        return []
    alone = {(case["body"], case["problem"]): case for case in found["tets"] if case["levels"]}
    figure = Figure(figsize=(3.3 * len(groups), 8.2), layout="constrained")
    axes = np.atleast_2d(figure.subplots(2, len(groups), squeeze=False))
    for column, (key, cases) in enumerate(groups.items()):
        for row, (norm, words) in enumerate((("l2", "L2"), ("energy", "energy"))):
            here = axes[row, column]
            for colour, case in zip(COLOURS, cases, strict=False):
                label = "\n".join(wrap(short(case), 48))
                _line(here, case["levels"], norm, label, color=colour, marker="o")
            if key in alone:
                _line(here, alone[key]["levels"], norm, "ten-node tets", color="black",
                      marker="^", linestyle="--")  # fmt: skip
            here.set(xlabel="unknowns", title=f"{key[0]}, {key[1]}: {words}")
            here.grid(True, which="both", linewidth=0.3)
            here.xaxis.set_minor_formatter(NullFormatter())
            here.yaxis.set_minor_formatter(NullFormatter())
            if row == 1:
                here.legend(fontsize=6, loc="upper center", bbox_to_anchor=(0.5, -0.22))
        axes[0, 0].set_ylabel("error, share of the norm")
        axes[1, 0].set_ylabel("error, share of the norm")
    name = "rates3d_convergence.png"
    figure.savefig(folder / name, dpi=72)
    _fewer_colours(folder / name)
    return [[name, "Errors over unknowns"]]


def _fewer_colours(path: Path) -> None:
    """Write a picture anew with a palette, which is a third of its size."""
    from PIL import Image

    with Image.open(path) as file:
        picture = file.convert("RGB")
    picture = picture.quantize(64, dither=Image.Dither.NONE)
    with beside(path) as other:
        picture.save(other, format="PNG", optimize=True)


def _line(
    axes: Any, levels: Sequence[Mapping[str, Any]], norm: str, label: str, **look: Any
) -> None:
    axes.loglog([row["unknowns"] for row in levels], [row[norm] for row in levels],
                label=label, markersize=4, linewidth=1.2, **look)  # fmt: skip


def _cuts(folder: Path, cases: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Errors on a cut through the middle of bodies, of the cases that left some."""
    import pyvista

    made = []
    for case in cases:
        file = folder / "cases" / f"{case['name']}.npz"
        if not file.is_file():
            continue
        with np.load(file) as stored:
            points, error = stored["points"], stored["error"]
            hexahedra, tets = stored["hexahedra"], stored["tets"]
            outline = float(stored["level"])
        kinds = {pyvista.CellType.HEXAHEDRON: hexahedra, pyvista.CellType.TETRA: tets}
        mesh = pyvista.UnstructuredGrid(kinds, points)
        mesh["error"] = np.log10(np.maximum(error, 1e-16))
        mesh.cell_data["core"] = np.repeat([0, 1], [len(hexahedra), len(tets)])
        low = points.min(axis=0)
        span = np.ptp(points, axis=0)
        # across the second longest side, seen from the front
        normal = np.eye(3)[np.argsort(span, kind="stable")[1]]
        middle = low + 0.5 * span
        cut = mesh.slice(normal=normal, origin=middle)
        core = mesh.threshold((0.5, 1.5), scalars="core").clean(tolerance=1e-9)
        line = core.extract_surface(algorithm=None).slice(normal=normal, origin=middle)
        plot = pyvista.Plotter(off_screen=True, window_size=SIZE)
        plot.set_background("white")
        top = np.log10(np.quantile(error, 0.999))
        bar = {"title": "log10 of the error", "color": "black", "n_labels": 4, "vertical": True,
               "position_x": 0.87, "position_y": 0.15, "height": 0.7, "width": 0.06}  # fmt: skip
        plot.add_mesh(cut, scalars="error", cmap="viridis", clim=(top - 3.0, top), lighting=False,
                      scalar_bar_args=bar)  # fmt: skip
        if line.n_points:
            plot.add_mesh(line, color="white", line_width=3)
        up = np.eye(3)[2 if normal[2] == 0.0 else 1]
        plot.camera_position = [(middle - 3.0 * span.max() * normal).tolist(), middle.tolist(),
                                up.tolist()]  # fmt: skip
        plot.enable_parallel_projection()
        flat = span[normal == 0.0]
        plot.camera.parallel_scale = 0.55 * max(flat[-1], flat[0] * SIZE[1] / (0.8 * SIZE[0]))
        name = f"rates3d_cut_{case['body']}_{case['problem']}.png"
        large = folder / f"large_{name}"
        plot.screenshot(large)
        plot.close()
        shrunk(large, folder / name)
        large.unlink()
        words = (f"Error on a cut: {case['body']}, {case['problem']}, p = {case['p']}, "
                 f"k = {case['k']}, level {outline:.0f}; the line is the interface")  # fmt: skip
        made.append([name, words])
    return made


def main(arguments: list[str] | None = None) -> int:
    """Draw and print; return the exit code."""
    (name,) = sys.argv[1:] if arguments is None else arguments
    folder = Path(name)
    found = json.loads((folder / "rates3d.json").read_text(encoding="utf-8"))
    made = _convergence(found, folder) + _cuts(folder, found["cases"])
    print(json.dumps(made))
    return 0


if __name__ == "__main__":
    sys.exit(main())
