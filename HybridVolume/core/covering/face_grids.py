# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Regular grids on four-sided faces between given points of their edges."""

from __future__ import annotations

import numpy as np

from ..surface import SplineFace
from .face_checks import grid_quads, worst_corners
from .geometry import evaluate, project


def regular_grid(sides: list[np.ndarray], surface: SplineFace, planar: bool) -> np.ndarray:
    """Points of a regular grid on a face, (a, b, 3).

    They are interpolated between the sides (Coons) in space, and moved to the face, or in the
    parameters of the surface: whichever has the better corners.

    Parameters
    ----------
    sides : list of (n, 3) arrays
        Around the face: each begins where the one before ends; opposite ones are equally long.
    surface : SplineFace
        That the face is on.
    planar : bool
        Whether it is a plane.
    """
    straight = _coons(*sides)
    if planar or min(straight.shape[:2]) < 3:
        return straight
    rim = np.concatenate(sides)
    inside = straight[1:-1, 1:-1].reshape(-1, 3)
    uv, feet = project(surface, np.concatenate([rim, inside]))
    in_space = straight.copy()
    in_space[1:-1, 1:-1] = feet[len(rim) :].reshape(in_space[1:-1, 1:-1].shape)
    ends = np.cumsum([len(side) for side in sides])[:-1]
    places = _coons(*np.split(uv[: len(rim)], ends))
    low, high = ([knots[k] for knots in surface.knots] for k in (0, -1))
    by_parameters = straight.copy()
    by_parameters[1:-1, 1:-1] = evaluate(
        surface, np.clip(places[1:-1, 1:-1], low, high).reshape(-1, 2)
    )[0].reshape(in_space[1:-1, 1:-1].shape)
    return max((by_parameters, in_space), key=_worst)


def _coons(
    bottom: np.ndarray, right: np.ndarray, third: np.ndarray, last: np.ndarray
) -> np.ndarray:
    """Values inside a rectangle from those on its four sides, which run around it."""
    top, left = third[::-1], last[::-1]
    s = np.linspace(0.0, 1.0, len(bottom))[:, None, None]
    t = np.linspace(0.0, 1.0, len(left))[None, :, None]
    ruled = (1 - t) * bottom[:, None] + t * top[:, None]
    ruled = ruled + (1 - s) * left[None] + s * right[None]
    corners = (1 - s) * (1 - t) * bottom[0] + s * (1 - t) * bottom[-1]
    corners = corners + (1 - s) * t * top[0] + s * t * top[-1]
    found = ruled - corners
    # the sides themselves bit for bit
    found[:, 0], found[:, -1], found[0], found[-1] = bottom, top, left, right
    return found


def _worst(points: np.ndarray) -> float:
    """The smallest sine of a corner in a grid, against the mean normals of its quads."""
    quads = grid_quads(np.arange(points[..., 0].size).reshape(points.shape[:2]))
    return float(worst_corners(points.reshape(-1, 3), quads).min())
