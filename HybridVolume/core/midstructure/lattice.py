# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Graded points in and around the body, from an octree, and the tetrahedra between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay

from .distances import SurfaceDistance

# Points are moved by this share of their cell: qhull is slow on points in planes.
JITTER = 0.05
_CORNERS = np.array(list(np.ndindex(2, 2, 2)), dtype=np.int64)
_HALF = 3.0**0.5 / 2.0


@dataclass(frozen=True)
class Lattice:
    """Points and Delaunay tetrahedra.

    Attributes
    ----------
    points : (n, 3) array
        mm, relative to ``origin``.
    origin : (3,) array
        mm.
    depth : (n,) array
        Distance to the surface, negative outside, mm; that to the nearest sample where a point is
        more than three cells away from where the depth was asked for.
    inward : (n, 3) array
        Unit vectors from the nearest point of the surface to each point inside, and towards it
        from a point outside; zero where the depth is not exact.
    size : (n,) array
        Cell size around each point, mm.
    tets : (m, 4) int array
        Positive.
    """

    points: np.ndarray
    origin: np.ndarray
    depth: np.ndarray
    inward: np.ndarray
    size: np.ndarray
    tets: np.ndarray


def build_lattice(
    distance: SurfaceDistance,
    wanted: Callable[[np.ndarray, np.ndarray], np.ndarray],
    needed: Callable[[np.ndarray, np.ndarray], np.ndarray],
    level: float,
    *,
    limit: int,
) -> Lattice | None:
    """Refine cubes where they are needed until they are as small as wanted.

    Parameters
    ----------
    distance : SurfaceDistance
    wanted : callable
        Cell size, mm, from the number of the nearest sample and the depth (both (k,)) at the
        middle of cells.
    needed : callable
        Whether cells are to be refined, from the depth at their middle and half their diagonal.
    level : float
        Depth near which exact distances are needed, mm; not finite for everywhere.
    limit : int
        Of the number of cells.

    Returns
    -------
    Lattice or None
        None where the limit is exceeded.
    """
    low, high = distance.samples.min(axis=0), distance.samples.max(axis=0)
    origin = 0.5 * (low + high)
    largest = 1.1 * float((high - low).max())
    cells = np.zeros((1, 3), dtype=np.int64)
    side = np.zeros(1, dtype=np.int8)
    leaves: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    count = 0
    for depth_of_tree in range(21):
        size = largest / 2**depth_of_tree
        middle = (cells + 0.5) * size - 0.5 * largest
        # half the way between samples is the error of this distance
        far, sample = distance.rough(middle + origin)
        half = _HALF * size
        ask = np.flatnonzero(side == 0)
        side[ask] = np.where(distance.inside(middle[ask] + origin), 1, -1)
        depth = far * side
        split = needed(depth, half) & (wanted(sample, depth) < size)
        if depth_of_tree < 2:
            split[:] = True
        # farther from the surface than its own extent, a cell is all inside or all outside
        side[far <= 1.1 * half + distance.spacing] = 0
        rest = ~split
        scale = np.full(int(rest.sum()), depth_of_tree)
        leaves.append((cells[rest], scale, side[rest]))
        count += len(scale) + 8 * int(split.sum())
        if count > limit:
            return None
        if not split.any():
            break
        cells = (2 * cells[split][:, None] + _CORNERS).reshape(-1, 3)
        side = np.repeat(side[split], 8)
    return _points(distance, leaves, origin, largest, level)


def _points(
    distance: SurfaceDistance,
    leaves: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
    origin: np.ndarray,
    largest: float,
    level: float,
) -> Lattice:
    """Corners and middles of all leaves, with depths, and the tetrahedra between them."""
    cells, scale, side = (np.concatenate(column) for column in zip(*leaves, strict=True))
    finest = int(scale.max()) + 1
    unit = 2 ** (finest - scale)
    corners = (cells[:, None] + _CORNERS) * unit[:, None, None]
    middles = cells * unit[:, None] + unit[:, None] // 2
    index = np.vstack([corners.reshape(-1, 3), middles])
    size = np.concatenate([np.repeat(unit, 8), unit])
    side = np.concatenate([np.repeat(side, 8), side])
    # the smallest cell around a point comes first
    width = 2**finest + 1
    key = (index[:, 0] * width + index[:, 1]) * width + index[:, 2]
    order = np.lexsort([side == 0, size, key])
    first = order[np.unique(key[order], return_index=True)[1]]
    index, size = index[first], size[first] * (largest / 2**finest)
    known = np.zeros(len(first), dtype=np.int8)
    # any cell around the point that lies on one side tells
    place = np.searchsorted(key[first], key)
    known[place[side != 0]] = side[side != 0]

    noise = np.random.default_rng(0).uniform(-JITTER, JITTER, index.shape)
    points = index * (largest / 2**finest) - 0.5 * largest + noise * size[:, None]
    far, _ = distance.rough(points + origin)
    ask = np.flatnonzero(known == 0)
    known[ask] = np.where(distance.inside(points[ask] + origin), 1, -1)
    exact = np.ones(len(points), dtype=bool)
    if np.isfinite(level):
        exact = np.abs(far * known - level) < 3.0 * size
    depth, inward = far, np.zeros_like(points)
    feet = distance.nearest(points[exact] + origin)
    depth[exact] = feet.distance
    inward[exact] = points[exact] + origin - feet.points
    depth *= known
    inward /= np.where(depth == 0.0, 1.0, depth)[:, None]
    tets = Delaunay(points / largest).simplices.astype(np.int64)
    x = points[tets]
    turn = np.einsum("mi,mi->m", x[:, 1] - x[:, 0], np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 0]))
    tets[turn < 0.0] = tets[turn < 0.0][:, [0, 1, 3, 2]]
    return Lattice(points, origin, depth, inward, size, tets)
