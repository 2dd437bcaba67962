# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Pictures of ``./run.sh reproduce dynamics``, drawn in the worker's Python.

``python -m HybridVolume.reproduce.dynamics_pictures DIR`` draws what DIR/dynamics.json and
DIR/cases hold and prints the names of the files as JSON.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from HybridVolume.exports.picture import write_scenes
from HybridVolume.exports.render import SIDE
from HybridVolume.exports.scene import DARK, Bar, Scene, Skin, Wire

from .cases import drawn_elsewhere

TIME_LIMIT = 600.0
SIZE = (640, 440)
"""Pixels of a moment."""
FLOOR = (0.86, 0.88, 0.90)
COLOURS = "coolwarm"
_TOP = 0.98
"""Share of the surface's points with less than the largest stress that colours show."""


def draw(folder: Path, python: str) -> list[str]:
    """Names of the pictures of a folder that holds ``dynamics.json``, drawn by another Python.

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


def frames(case: Mapping[str, Any], folder: Path, path: Path) -> None:
    """Moments of a drop beside each other."""
    from matplotlib.figure import Figure
    from matplotlib.image import imread

    with np.load(folder / "cases" / f"{case['name']}.npz") as file:
        data = {name: file[name] for name in file.files}
    high = float(np.quantile(data["stress"], _TOP))
    scenes = _scenes(data, high)
    columns = (len(scenes) + 1) // 2
    with tempfile.TemporaryDirectory(prefix="hybridvolume-") as place:
        names = {Path(place) / f"{k}.png": scene for k, scene in enumerate(scenes)}
        write_scenes(names, sys.executable, size=SIZE)
        figure = Figure(figsize=(2.7 * columns + 0.8, 4.6), layout="constrained")
        axes = figure.subplots(2, columns, squeeze=False).ravel()
        for axis in axes:
            axis.axis("off")
        for axis, name, time in zip(axes, names, data["time"], strict=False):
            image = imread(name)
            # the bar on the right is that of all moments
            axis.imshow(image[:, : int((1.0 - SIDE) * image.shape[1])])
            axis.set_title(f"{1e3 * time:.1f} ms", fontsize=9)
        bar = figure.colorbar(_scale(high), ax=list(axes), shrink=0.6, aspect=30)
        bar.set_label("von Mises stress, kPa")
        figure.savefig(path, dpi=72)


def _scale(high: float) -> Any:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    return ScalarMappable(Normalize(0.0, 1e3 * high), COLOURS)


def _scenes(data: Mapping[str, np.ndarray], high: float) -> list[Scene]:
    up = data["up"]
    points = data["points"].astype(float)
    low, top = points.reshape(-1, 3).min(axis=0), points.reshape(-1, 3).max(axis=0)
    radius = 0.5 * float(np.linalg.norm(top - low))
    across = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    across /= np.linalg.norm(across)
    third = np.cross(up, across)
    direction = 0.9 * across + 0.35 * third + 0.3 * up
    middle = points.reshape(-1, 3).mean(axis=0)
    middle = middle + (data["floor"] - middle @ up) * up
    corners = [middle + 0.7 * radius * (a * across + b * third)
               for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]  # fmt: skip
    floor = Skin(np.array(corners), None, np.array([[0, 1, 2], [0, 2, 3]]), FLOOR)
    bar = Bar("", 0.0, high, COLOURS)
    # points that no line shows: all moments are seen from the same place
    whole = np.concatenate([low + (top - low) * np.eye(3), top - (top - low) * np.eye(3)])
    frame = Wire(np.repeat(whole[:, None], 2, axis=1), (1.0, 1.0, 1.0), 0.1)
    found = []
    for x, stress in zip(points, data["stress"].astype(float), strict=True):
        triangles = data["triangles"]
        skin = Skin(x, _normals(x, triangles), triangles, FLOOR, values=np.minimum(stress, high))
        wires = (frame, Wire(x[data["lines"]], DARK, 0.6))
        found.append(Scene((floor, skin), wires, direction, up, radius, bar=bar))
    return found


def _normals(x: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals of points by the triangles around them; patches have points of their own."""
    corners = x[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(x)
    for corner in triangles.T:
        np.add.at(total, corner, across)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.maximum(length, 1e-300)


def energies(case: Mapping[str, Any], path: Path) -> None:
    """Energies over time, and the change of their sum."""
    from matplotlib.figure import Figure

    rows = case["energies"]
    time = [1e3 * row["time"] for row in rows]
    figure = Figure(figsize=(8.6, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2, 1))
    for word in ("kinetic", "elastic", "contact", "gravity", "total"):
        left.plot(time, [row[word] / case["kinetic"] for row in rows], label=word,
                  color="black" if word == "total" else None)  # fmt: skip
    left.set_xlabel("time, ms")
    left.set_ylabel("share of the energy of the fall")
    left.legend(fontsize=8)
    right.plot(time, [row["total"] / case["kinetic"] - rows[0]["total"] / case["kinetic"]
                      for row in rows], color="black")  # fmt: skip
    right.set_xlabel("time, ms")
    right.set_title("change of the total energy", fontsize=10)
    figure.savefig(path, dpi=72)


def main(arguments: list[str] | None = None) -> int:
    """Draw and print; return the exit code."""
    (name,) = sys.argv[1:] if arguments is None else arguments
    folder = Path(name)
    found = json.loads((folder / "dynamics.json").read_text(encoding="utf-8"))
    names = []
    for case in found["drops"]:
        if case["error"]:
            continue
        for ending, make in (("frames", frames), ("energy", energies)):
            names.append(f"dynamics_{case['case']}_{ending}.png")
            path = folder / "pictures" / names[-1]
            make(case, folder, path) if ending == "frames" else make(case, path)
    print(json.dumps(names))
    return 0


if __name__ == "__main__":
    sys.exit(main())
