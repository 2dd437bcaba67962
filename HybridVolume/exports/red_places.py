# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""NAME_refused.png: a body that is refused, its faces red, the exact places as balls with words."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from HybridVolume.core import bspline
from HybridVolume.core.surface import SplineFace
from HybridVolume.errors import HybridVolumeError, Place

from .picture import write_scene
from .scene import Label, Scene, Skin, Wire

RED = (0.80, 0.05, 0.05)
FACE_RED = (0.93, 0.45, 0.40)
GRAY = (0.80, 0.81, 0.83)
LINE = (0.35, 0.37, 0.40)
BALL = 0.010
"""Radius of a ball, as a share of the body's diagonal."""
LABELS = 8
"""Places that words stand at, at most."""
_CELLS = 48


def write_refusal(
    path: str | os.PathLike,
    name: str,
    faces: Sequence[SplineFace],
    error: HybridVolumeError,
    python: str,
    *,
    time_limit: float = 60.0,
) -> None:
    """Draw where a body is refused.

    Parameters
    ----------
    path : path
    name : str
        Of the body, for the title.
    faces : sequence of SplineFace
    error : HybridVolumeError
        Its faces become red, its places balls.
    python : str
        An interpreter that has pyvista.
    time_limit : float
        Seconds for each way of drawing that is tried.

    Raises
    ------
    SetupError
        Nothing on this system can draw.
    OSError
        The place cannot be written.
    """
    write_scene(path, refusal_scene(name, faces, error), python, time_limit=time_limit)


def refusal_scene(name: str, faces: Sequence[SplineFace], error: HybridVolumeError) -> Scene:
    """The body from the side where most places are in front.

    Parameters
    ----------
    name : str
    faces : sequence of SplineFace
    error : HybridVolumeError
        With places.
    """
    named = {*error.faces, *(place.face for place in error.places)}
    grids = [_grid(face) for face in faces]
    points = np.concatenate([grid.reshape(-1, 3) for grid in grids])
    low, high = points.min(axis=0), points.max(axis=0)
    diagonal = float(np.linalg.norm(high - low))
    skins, wires = [], []
    for face, grid in zip(faces, grids, strict=True):
        colour = FACE_RED if face.name in named else GRAY
        skins.append(Skin(grid.reshape(-1, 3), None, _triangles(*grid.shape[:2]), colour))
        for rim in (grid[[0, -1]], np.swapaxes(grid[:, [0, -1]], 0, 1)):
            wires.append(Wire(rim, LINE, 1.5))
    balls = [_ball(np.array(place.point), BALL * diagonal) for place in error.places]
    skins += [Skin(x, x_normals, triangles, RED) for x, x_normals, triangles in balls]
    middle = 0.5 * (low + high)
    direction, up = _view(np.array([place.point for place in error.places]), middle, high - low)
    return Scene(
        tuple(skins),
        tuple(wires),
        direction,
        up,
        0.5 * diagonal,
        title=f"{name}: refused",
        lines=_lines(error),
        labels=_labels(error.places, direction, 0.04 * diagonal),
        legend=((FACE_RED, "faces named"), (RED, "places"), (GRAY, "other faces")),
        ruler=True,
    )


def _lines(error: HybridVolumeError) -> tuple[str, ...]:
    """What is wrong and what helps, in lines that fit."""
    text = error.message.split(" (")[0]
    return tuple(line for line in (text, error.remedy) if line)


def _grid(face: SplineFace) -> np.ndarray:
    """Points of a face on a grid that has all knots, (m, k, 3)."""
    lines = []
    for degree, knots in zip(face.degrees, face.knots, strict=True):
        breaks = bspline.breakpoints(np.asarray(knots, dtype=float))
        cells = max(1, -(-_CELLS // (len(breaks) - 1))) if degree > 1 else 1
        share = np.arange(cells) / cells
        inner = breaks[:-1, None] + np.diff(breaks)[:, None] * share
        x = np.append(inner.ravel(), breaks[-1])
        lines.append(bspline.basis_matrix(degree, np.asarray(knots, dtype=float), x).toarray())
    weights = np.asarray(face.weights, dtype=float)[..., None]
    net = np.concatenate([face.control_points * weights, weights], axis=-1)
    value = np.einsum("ai,bj,ijc->abc", *lines, net)
    return value[..., :3] / value[..., 3:]


def _triangles(rows: int, columns: int) -> np.ndarray:
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    return np.concatenate(
        [np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)]
    )


def _ball(centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals and triangles of a ball."""
    rows, columns = 9, 17
    polar, around = np.linspace(0.0, np.pi, rows), np.linspace(0.0, 2.0 * np.pi, columns)
    p, a = np.meshgrid(polar, around, indexing="ij")
    normals = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], axis=-1)
    normals = normals.reshape(-1, 3)
    return centre + radius * normals, normals, _triangles(rows, columns)


def _view(
    places: np.ndarray, middle: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Direction towards the eye and upward, from the corner that the places look to."""
    axes = np.eye(3)
    up = axes[int(np.argmin(size))] if size.min() < 0.5 * np.median(size) else axes[2]
    signs = np.sign((places - middle).sum(axis=0))
    signs = np.where(signs == 0.0, [1.0, -1.0, 1.0], signs)
    direction = signs * np.where(up > 0.5, 0.55, [0.8, 0.6, 0.7])
    return direction / np.linalg.norm(direction), up


def _labels(places: Sequence[Place], direction: np.ndarray, distance: float) -> tuple[Label, ...]:
    """Words at places apart from each other, those in front first."""
    found: list[Label] = []
    order = sorted(places, key=lambda place: -float(np.dot(place.point, direction)))
    for place in order:
        point = np.array(place.point)
        if len(found) == LABELS or any(
            np.linalg.norm(point - label.point) < distance for label in found
        ):
            continue
        text = f"{place.face}, {place.where}:\n{place.what}"
        found.append(Label(point, text, RED))
    return tuple(found)
