# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Wanted size of elements over the surface, and where grid lines must stand to keep it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..errors import InputError
from .density import Density
from .evaluation import grid_places
from .goals import check_faces
from .strips import GridLines, base_lines
from .surface import PatchSurface

_SAMPLES = 6
"""Steps in which the surface is looked at between two lines of the base."""
_FINER = 4
"""Steps between two samples, where size and speed are taken as linear."""
_SLACK = 0.05
"""Share of a part by which edges may be longer than wanted: no line for next to nothing."""
MOST_NODES = 3_000_000
"""Nodes of a mesh, beyond which the wish is taken for a slip of the pen."""
_USUAL_LAYERS = 4


def wanted_lines(surface: PatchSurface, density: Density) -> GridLines:
    """Grid lines for a wanted density.

    A line runs through a whole strip of patches; the strip's smallest size along each of its
    intervals decides how many lines there are and where they stand.

    Parameters
    ----------
    surface : PatchSurface
        The outer boundary, where sizes are measured.
    density : Density

    Raises
    ------
    InputError
        A face of the density is not there, or there would be too many nodes.
    """
    check_faces(density.face_sizes, surface)
    lines = base_lines(surface, density.nodes)
    if not (density.size or density.face_sizes):
        parts = [np.full(len(p) - 1, density.subdivide) for p in lines.places]
        _check_count(lines, parts, density)
        return lines.cut(parts)
    need = _needs(surface, density, lines)
    parts = [np.maximum(density.subdivide, np.ceil(_running(n)[:, -1] - _SLACK)) for n in need]
    _check_count(lines, parts, density)
    spread = zip(lines.places, need, parts, strict=True)
    return replace(lines, places=tuple(_spread(old, n, p.astype(int)) for old, n, p in spread))


def _check_count(lines: GridLines, parts: list[np.ndarray], density: Density) -> None:
    total = np.array([float(p.sum()) for p in parts])
    cells = float(total[lines.strips.number].prod(axis=1).sum())
    # a cell has one vertex and three edges on each level, and mid nodes of a vertex between
    nodes = cells * (5 * (density.layers or _USUAL_LAYERS) + 4)
    if nodes > MOST_NODES:
        raise InputError(
            f"the wanted density asks for {cells:.3g} cells on the faces, about {nodes:.2g} nodes;"
            f" {MOST_NODES:.0e} are the most",
            figure=nodes,
            remedy="choose a larger size (mm), fewer parts or fewer layers",
        )


def _running(need: np.ndarray) -> np.ndarray:
    """Integral of samples (m, k) over each interval, up to each sample; starts with 0."""
    steps = 0.5 * (need[:, 1:] + need[:, :-1]) / (need.shape[1] - 1)
    return np.concatenate([np.zeros((len(need), 1)), np.cumsum(steps, axis=1)], axis=1)


def _spread(places: np.ndarray, need: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Places of lines that cut each interval so that all its parts need equally much."""
    total = _running(need)[:, -1]
    # where nothing is asked for but the number of parts, they are equal
    even = need + np.maximum(parts - 1.0 - total, 0.0)[:, None] + 1e-12
    running = _running(even)
    share = np.linspace(0.0, 1.0, need.shape[1])
    found = []
    for place, count, need_there in zip(places, parts, running, strict=False):
        steps = np.arange(count) / count
        found.append(place + np.interp(steps * need_there[-1], need_there, share))
    return np.append(np.concatenate(found), places[-1])


def _needs(surface: PatchSurface, density: Density, lines: GridLines) -> list[np.ndarray]:
    """Edges that are needed per interval, at samples along each strip's intervals, (m, k) each."""
    count = _SAMPLES * _FINER + 1
    need = [np.zeros((len(p) - 1, count)) for p in lines.places]
    steps = np.linspace(0.0, _SAMPLES, count)
    left = np.minimum(steps.astype(int), _SAMPLES - 1)
    mix = np.zeros((count, _SAMPLES + 1))
    mix[np.arange(count), left] = 1.0 - (steps - left)
    mix[np.arange(count), left + 1] += steps - left
    for patch, bases, speeds, size in _sampled(surface, density, lines):
        for axis, (base, speed) in enumerate(zip(bases, speeds, strict=True)):
            along, h = (speed, size) if axis == 0 else (speed.T, size.T)
            rows = _SAMPLES * np.arange(len(base) - 1)[:, None] + np.arange(_SAMPLES + 1)
            along = mix @ (along[rows] * np.diff(base)[:, None, None])
            most = (along / (mix @ h[rows])).max(axis=2)
            strip = lines.strips.number[patch, axis]
            if lines.strips.turned[patch, axis]:
                most = most[::-1, ::-1]
            np.maximum(need[strip], most, out=need[strip])
    for n in np.flatnonzero(lines.strips.twisted):
        need[n] = np.maximum(need[n], need[n][::-1, ::-1])
    return need


def _sampled(
    surface: PatchSurface, density: Density, lines: GridLines
) -> Iterator[tuple[int, tuple[np.ndarray, ...], tuple[np.ndarray, ...], np.ndarray]]:
    """Each patch with its base lines, and on a grid of samples |s_u|, |s_v| and the wanted size."""
    fine = lines.cut([np.full(len(p) - 1, _SAMPLES) for p in lines.places])
    u, v = fine.lines()
    mu, mv = (np.array([len(x) for x in values]) for values in (u, v))
    patch, row, column = grid_places(mu, mv)
    at_u = np.concatenate(u)[(np.cumsum(mu) - mu)[patch] + row]
    at_v = np.concatenate(v)[(np.cumsum(mv) - mv)[patch] + column]
    x, x_u, x_v = surface.evaluate_at(patch, at_u, at_v, 1)
    speed_u, speed_v = (np.linalg.norm(d, axis=1) for d in (x_u, x_v))
    size = _sizes(surface, density, patch, x)
    ends = np.cumsum(mu * mv)
    for k, end in enumerate(ends):
        shape, part = (mu[k], mv[k]), slice(end - mu[k] * mv[k], end)
        yield (
            k,
            (lines.base_u[k], lines.base_v[k]),
            (speed_u[part].reshape(shape), speed_v[part].reshape(shape)),
            size[part].reshape(shape),
        )


def _sizes(surface: PatchSurface, density: Density, patch: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Wanted size at points of patches, mm; large where none is wanted."""
    least = density.size or 1e6 * surface.diagonal
    own = np.array([density.face_sizes.get(p.face, least) for p in surface.patches])
    size = own[patch]
    # the smallest first: the others then have to be looked for in fewer places
    for value in sorted(set(density.face_sizes.values())):
        on = (own == value)[patch]
        near = np.flatnonzero(size > value)
        if not on.any() or not len(near):
            continue
        reach = (size[near].max() - value) / density.gradation
        distance, _ = cKDTree(x[on]).query(x[near], distance_upper_bound=min(reach, 1e300))
        distance = np.where(on[near], 0.0, distance)
        size[near] = np.minimum(size[near], value + density.gradation * distance)
    return size
