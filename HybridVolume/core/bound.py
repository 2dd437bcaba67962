# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How good a shell on a given surface can be at best: an upper bound of its scaled Jacobian.

At a place of the outer boundary the derivatives x_u, x_v of all elements that meet there are those
of the surface, and the third derivative has one direction d for all of them. The scaled Jacobian
of an element there is sin(x_u, x_v) n . d with its inward unit normal n, so that no shell exceeds

    min over places of  max over d of  min over the elements of  sin(x_u, x_v) n . d.

Inside of a smooth patch the best d is the normal and sin(x_u, x_v) is left; at a corner of a cube
the three normals leave 1 / sqrt(3).
"""

from __future__ import annotations

import numpy as np

from .cones import most_inward, widest_direction
from .surface import PatchSurface

_FEW = 8
"""Up to so many vectors the best direction is found exactly."""


def place_numbers(surface: PatchSurface, points: int) -> tuple[np.ndarray, int]:
    """Numbers of the sample places of all elements, equal where elements meet.

    Parameters
    ----------
    surface : PatchSurface
    points : int
        Places a direction, equally spaced in the element, ends included.

    Returns
    -------
    place : (ne, points, points) int array
        In the order of the element numbers; first index along u.
    count : int
    """
    steps = np.arange(points)
    u, v = surface.grid_parameters(points - 1)
    grids, count = surface.shared_grid([(len(a), len(b)) for a, b in zip(u, v, strict=True)])
    found = []
    for grid in grids:
        first = [np.arange(0, n - 1, points - 1) for n in grid.shape]
        rows = first[0][:, None, None, None] + steps[:, None]
        columns = first[1][:, None, None] + steps
        found.append(grid[rows, columns].reshape(-1, points, points))
    return np.concatenate(found), count


def scaled_normals(surface: PatchSurface, points: int) -> np.ndarray:
    """sin(s_u, s_v) times the inward unit normal at sample places, (ne, points, points, 3).

    Zero where a derivative vanishes.
    """
    x = np.linspace(0.0, 1.0, points)
    _, x_u, x_v = surface.element_samples(x, x).surface(surface.control_points)
    size = np.linalg.norm(x_u, axis=1) * np.linalg.norm(x_v, axis=1)
    normals = -np.cross(x_u, x_v) / np.maximum(size, 1e-300)[:, None]
    return normals.reshape(-1, points, points, 3)


def scaled_jacobian_bound(surface: PatchSurface, points: int = 6) -> np.ndarray:
    """Upper bound of the scaled Jacobian that any shell on a surface can have.

    Parameters
    ----------
    surface : PatchSurface
        The outer boundary of the shell, as refined as it is there.
    points : int
        Places a direction of every element, ends included; at least 2. The default are the places
        at which :func:`HybridVolume.core.validity.scaled_jacobian` looks, so that no shell can
        show more.

    Returns
    -------
    (elements,) array
        Bound of each knot span of the surface, at most 1; the body's bound is the smallest. Not
        positive where no shell is valid.
    """
    normals = scaled_normals(surface, points).reshape(-1, 3)
    place, count = place_numbers(surface, points)
    margin = common_margin(normals, place.ravel(), count)[1]
    return np.minimum(margin[place].min(axis=(1, 2)), 1.0)


def common_margin(
    vectors: np.ndarray, place: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Best common direction of the vectors at each place.

    Parameters
    ----------
    vectors : (m, 3) array
    place : (m,) int array
        Place of each vector; every place has one.
    count : int
        Number of places.

    Returns
    -------
    direction : (count, 3) array
    margin : (count,) array
        The smallest v . d over the vectors of the place, as large as it can be.
    """
    order = np.argsort(place, kind="stable")
    number = np.bincount(place, minlength=count)
    start = np.concatenate([[0], np.cumsum(number)[:-1]])
    direction, margin = np.zeros((count, 3)), np.zeros(count)
    # along smooth knot lines the elements have one normal
    first = vectors[order[start]]
    spread = np.zeros(count)
    np.maximum.at(spread, place, np.abs(vectors - first[place]).max(axis=1))
    length = np.linalg.norm(first, axis=1)
    direction[:] = first / np.maximum(length, 1e-300)[:, None]
    margin[:] = length
    several = spread > 1e-9
    for k in np.unique(number[several]):
        members = np.flatnonzero(several & (number == k))
        chosen = vectors[order[start[members][:, None] + np.arange(k)]]
        if k <= _FEW:
            direction[members], margin[members] = widest_direction(chosen)
        else:
            found = most_inward(chosen, np.ones(chosen.shape[:2], dtype=bool))
            direction[members] = found
            margin[members] = np.einsum("mki,mi->mk", chosen, found).min(axis=1)
    return direction, margin
