# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Points of the surface that know their patch and normal, denser where the body is thin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .. import bspline
from ..surface import PatchSurface

# Samples in one medial radius: fewer lose the sheet of a thin wall, more cost time.
SAMPLES_PER_RADIUS = 3.0
# The thinnest wall that is looked for, relative to the even spacing.
FINEST = 1.0 / 32.0
# Samples where the caller names none.
DEFAULT = 16000


@dataclass(frozen=True)
class Samples:
    """Sample points of a surface.

    Attributes
    ----------
    points : (n, 3) array
        mm.
    normals : (n, 3) array
        Unit normals out of the material.
    patch : (n,) int array
    uv : (n, 2) array
        Parameters in [0, 1]².
    spacing : (n,) array
        Distance to the next samples that was aimed at, mm.
    """

    points: np.ndarray
    normals: np.ndarray
    patch: np.ndarray
    uv: np.ndarray
    spacing: np.ndarray


@dataclass(frozen=True)
class _Cells:
    """Parameter rectangles of about equal size."""

    patch: np.ndarray
    low: np.ndarray
    size: np.ndarray
    length: np.ndarray
    area: np.ndarray


def sample_surface(surface: PatchSurface, count: int, group: np.ndarray, seed: int = 0) -> Samples:
    """About ``count`` samples: half of them even by area, the rest where the body is thin.

    Parameters
    ----------
    surface : PatchSurface
    count : int
        Aimed at; every patch has at least one sample.
    group : (np,) int array
        Smooth group of every patch.
    seed : int
        The samples are jittered, but always the same.
    """
    count = count or DEFAULT
    even = np.sqrt(surface.area() / (0.5 * count))
    cells = _cells(surface, 3.0 * even)
    spacing = np.full(len(cells.patch), even)
    thin = np.full(len(cells.patch), np.inf)
    for _ in range(4):
        samples, cell = _draw(surface, cells, _within(cells, spacing, count), seed)
        asked = np.flatnonzero(_first_of(cell, 4))
        radius, opposite = inner_radius(samples, asked, SAMPLES_PER_RADIUS * even)
        np.minimum.at(thin, cell[asked], np.where(opposite, radius, np.inf))
        # square bars have no opposite sides near: the largest ball around tells the width
        reach = np.maximum(2.0 * radius, 3.0 * even)
        widest = _widest_near(samples.points[asked], radius, reach, group[samples.patch[asked]])
        np.minimum.at(thin, cell[asked], widest)
        wanted = np.clip(thin / SAMPLES_PER_RADIUS, FINEST * even, even)
        if (wanted >= 0.8 * spacing).all():
            return samples
        spacing = np.minimum(spacing, wanted)
    return _draw(surface, cells, _within(cells, spacing, count), seed)[0]


def _widest_near(
    points: np.ndarray, radius: np.ndarray, reach: np.ndarray, group: np.ndarray
) -> np.ndarray:
    """Largest ball on the way from each point to where the balls of its smooth group grow.

    Beside an edge the balls are small although the body is not thin: a few steps of the given
    reach lead away from it.
    """
    around = cKDTree(points).query_ball_point(points, reach)
    size = np.array([len(a) for a in around])
    near = np.concatenate([np.asarray(a, dtype=np.int64) for a in around])
    owner = np.repeat(np.arange(len(points)), size)
    same = group[near] == group[owner]
    near, owner = near[same], owner[same]
    start = np.searchsorted(owner, np.arange(len(points)))
    widest = radius
    for _ in range(6):
        widest = np.maximum.reduceat(widest[near], start)
    return widest


def _first_of(group: np.ndarray, count: int) -> np.ndarray:
    """Whether each entry is among ``count`` evenly spread ones of its (sorted) group."""
    start = np.searchsorted(group, group)
    size = np.searchsorted(group, group, side="right") - start
    place = np.arange(len(group)) - start
    return place * count // size != (place - 1) * count // size


def _within(cells: _Cells, spacing: np.ndarray, count: int) -> np.ndarray:
    """Spacing enlarged where it is small until no more than ``count`` samples come out."""
    for _ in range(60):
        if (cells.area / spacing**2).sum() <= count:
            break
        spacing = np.maximum(spacing, 1.2 * spacing.min())
    return spacing


def _even_lines(breaks: np.ndarray, length: np.ndarray, step: float) -> np.ndarray:
    """Parameters that cut a direction into pieces of equal length of at most about ``step``."""
    along = np.concatenate([[0.0], np.cumsum(length)])
    if along[-1] <= 0.0:
        return breaks[[0, -1]]
    pieces = max(1, int(np.ceil(along[-1] / step)))
    grow = along + np.linspace(0.0, 1e-9 * along[-1], len(along))
    return np.interp(np.linspace(0.0, grow[-1], pieces + 1), grow, breaks)


def _cells(surface: PatchSurface, step: float) -> _Cells:
    parts = []
    for k, patch in enumerate(surface.patches):
        lines = []
        for knots in patch.knots:
            breaks = bspline.breakpoints(knots)
            cut = max(1, -(-8 // (len(breaks) - 1)))
            share = np.arange(cut) / cut
            inner = breaks[:-1, None] + np.diff(breaks)[:, None] * share
            lines.append(np.append(inner.ravel(), breaks[-1]))
        grid = surface.evaluate_grid(k, *lines)
        u = _even_lines(lines[0], np.linalg.norm(np.diff(grid, axis=0), axis=2).max(axis=1), step)
        v = _even_lines(lines[1], np.linalg.norm(np.diff(grid, axis=1), axis=2).max(axis=0), step)
        iu, iv = (a.ravel() for a in np.indices((len(u) - 1, len(v) - 1)))
        low = np.column_stack([u[iu], v[iv]])
        size = np.column_stack([np.diff(u)[iu], np.diff(v)[iv]])
        _, x_u, x_v = surface.evaluate(k, *(low + 0.5 * size).T, derivative=1)
        x_u, x_v = x_u * size[:, :1], x_v * size[:, 1:]
        length = np.column_stack([np.linalg.norm(x_u, axis=1), np.linalg.norm(x_v, axis=1)])
        area = np.linalg.norm(np.cross(x_u, x_v), axis=1)
        parts.append((np.full(len(low), k), low, size, length, area))
    return _Cells(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _draw(
    surface: PatchSurface, cells: _Cells, spacing: np.ndarray, seed: int
) -> tuple[Samples, np.ndarray]:
    """Jittered samples of every cell, and the cell of each."""
    pieces = np.maximum(1, np.round(cells.length / spacing[:, None])).astype(int)
    number = pieces.prod(axis=1)
    cell = np.repeat(np.arange(len(number)), number)
    place = np.arange(len(cell)) - np.repeat(np.cumsum(number) - number, number)
    across = pieces[cell, 1]
    index = np.column_stack([place // across, place % across])
    jitter = np.random.default_rng(seed).uniform(0.15, 0.85, (len(cell), 2))
    uv = cells.low[cell] + cells.size[cell] * (index + jitter) / pieces[cell]
    patch = cells.patch[cell]
    points = np.empty((len(cell), 3))
    normals = np.empty((len(cell), 3))
    bounds = np.searchsorted(patch, np.arange(len(surface.patches) + 1))
    for k in range(len(surface.patches)):
        part = slice(bounds[k], bounds[k + 1])
        x, x_u, x_v = surface.evaluate(k, *uv[part].T, derivative=1)
        points[part], normals[part] = x, np.cross(x_u, x_v)
    length = np.linalg.norm(normals, axis=1)
    good = length > 1e-12 * np.median(length)
    normals[good] /= length[good, None]
    samples = Samples(points[good], normals[good], patch[good], uv[good], spacing[cell[good]])
    return samples, cell[good]


def inner_radius(
    samples: Samples, query: np.ndarray, limit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Radius of the largest inner ball that touches a sample, up to a limit.

    Shrinking balls after Ma, Bae and Choi 2012.

    Parameters
    ----------
    samples : Samples
    query : (m,) int array
        The samples asked for.
    limit : float
        mm.

    Returns
    -------
    radius : (m,) array
        mm.
    opposite : (m,) bool array
        Whether the ball is stopped by the opposite side (normals more than 127° apart) and not by
        a neighbouring face, as beside every convex edge, nor by the limit.
    """
    points, normals = samples.points, samples.normals
    tree = cKDTree(points)
    radius = np.full(len(query), float(limit))
    touched = np.full(len(query), -1)
    active = np.arange(len(query))
    for _ in range(20):
        mine = query[active]
        distance, nearest = tree.query(points[mine] - normals[mine] * radius[active, None])
        inside = (distance < radius[active] * (1.0 - 1e-6)) & (nearest != mine)
        active, nearest, mine = active[inside], nearest[inside], mine[inside]
        if not len(active):
            break
        apart = points[mine] - points[nearest]
        depth = np.einsum("ij,ij->i", apart, normals[mine])
        length2 = np.einsum("ij,ij->i", apart, apart)
        # a neighbour almost in the tangent plane is the surface itself
        real = depth > 0.2 * np.sqrt(length2)
        active, nearest = active[real], nearest[real]
        radius[active] = np.minimum(
            0.5 * length2[real] / depth[real], radius[active] * (1.0 - 1e-9)
        )
        touched[active] = nearest
    cosine = np.einsum("ij,ij->i", normals[query], normals[touched])
    return radius, (touched >= 0) & (cosine < -0.6)
