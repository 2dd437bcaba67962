# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Points of the surface that know their patch and normal, denser where the body is thin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .. import bspline
from ..surface import PatchSurface
from .points import evaluate_points
from .smooth_groups import smooth_groups

# Samples in one medial radius: fewer lose the sheet of a thin wall, more cost time.
SAMPLES_PER_RADIUS = 3.0
# The thinnest wall that is looked for, relative to the even spacing.
FINEST = 1.0 / 32.0
# Angles of the normals on opposite sides of a body and of a thin wall, degrees.
OPPOSITE = 127.0
PARALLEL = 165.0
# Samples in one radius of curvature, and the smallest of these that is looked for.
SAMPLES_PER_BEND = 3.0
FINEST_BENT = 1.0 / 4.0
# What the caller leaves to the body: as many for the shape alone, and for a patch; and all of them.
BASE = 8000
SAMPLES_PER_PATCH = 8
MOST = 50_000
# Share of the area whose thickness is not looked at for that.
TIP_SHARE = 0.1


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
    """Parameter rectangles of about equal size, with their radii of curvature."""

    patch: np.ndarray
    low: np.ndarray
    size: np.ndarray
    length: np.ndarray
    area: np.ndarray
    bend: np.ndarray


def sample_surface(
    surface: PatchSurface, count: int = 0, group: np.ndarray | None = None, seed: int = 0
) -> Samples:
    """Jittered samples: half of them even by area, the rest where the body is thin or bent.

    Parameters
    ----------
    surface : PatchSurface
    count : int
        Aimed at; every patch has at least one sample. 0 chooses from 8000 to 50,000: enough for
        :data:`SAMPLES_PER_RADIUS` in the inner radius all over, where that is possible.
    group : (np,) int array, optional
        Smooth group of every patch.
    seed : int
        Of the jitter; the samples are always the same for the same seed.
    """
    group = smooth_groups(surface).of_patch if group is None else group
    count = count or _wanted_count(surface, group, seed)
    even = np.sqrt(surface.area() / (0.5 * count))
    cells = _cells(surface, 3.0 * even)
    spacing = _refined(surface, cells, count, even, group, seed)[1]
    spacing = _within(cells, spacing, count)
    # what the thin parts did not need makes all of them denser
    spacing *= min(1.0, np.sqrt((cells.area / spacing**2).sum() / count))
    return _draw(surface, cells, spacing, seed)[0]


def _wanted_count(surface: PatchSurface, group: np.ndarray, seed: int) -> int:
    """Samples that the body needs, by its size and its smallest features."""
    even = np.sqrt(surface.area() / (0.5 * BASE))
    cells = _cells(surface, 3.0 * even)
    thin, spacing = _refined(surface, cells, BASE, even, group, seed)
    # tips of acute edges have no smallest feature
    order = np.argsort(thin)
    share = np.cumsum(cells.area[order]) / cells.area.sum()
    thin = np.maximum(thin, thin[order[np.searchsorted(share, TIP_SHARE)]])
    fine = np.minimum(spacing, thin / SAMPLES_PER_RADIUS)
    base = max(0.5 * BASE, SAMPLES_PER_PATCH * len(surface.patches))
    return int(min(base + (cells.area / fine**2).sum(), MOST))


def _refined(
    surface: PatchSurface,
    cells: _Cells,
    count: int,
    even: float,
    group: np.ndarray,
    seed: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Spacing in every cell, smaller step by step where the last samples show a thin body.

    Returns
    -------
    thin : (c,) array
        Inner radius near every cell, as far as :data:`SAMPLES_PER_RADIUS` even spacings, mm.
    spacing : (c,) array
        What was wanted in the end, mm.
    """
    bent = np.maximum(cells.bend / SAMPLES_PER_BEND, FINEST_BENT * even)
    spacing = np.minimum(even, bent)
    thin = np.full(len(cells.patch), np.inf)
    for _ in range(4):
        samples, cell = _draw(surface, cells, _within(cells, spacing, count), seed)
        asked = np.flatnonzero(_first_of(cell, 4))
        radius, touched = inner_radius(samples, asked, SAMPLES_PER_RADIUS * even)
        # acute edges get ever thinner: what is wanted there is told by their thick part
        opposite = _opposite(samples, asked, touched, PARALLEL)
        np.minimum.at(thin, cell[asked], np.where(opposite, radius, np.inf))
        # square bars have no opposite sides near: the largest ball around tells the width
        reach = np.maximum(2.0 * radius, 3.0 * even)
        widest = _widest_near(samples.points[asked], radius, reach, group[samples.patch[asked]])
        np.minimum.at(thin, cell[asked], widest)
        wanted = np.minimum(np.clip(thin / SAMPLES_PER_RADIUS, FINEST * even, even), bent)
        if (wanted >= 0.8 * spacing).all():
            break
        spacing = np.minimum(spacing, wanted)
    return thin, spacing


def probes(
    surface: PatchSurface,
    count: int = 2000,
    samples: Samples | None = None,
    group: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places spread over the surface, and how thick the body is there.

    Parameters
    ----------
    surface : PatchSurface
    count : int
        Number of places; denser where the body is thin.
    samples : Samples, optional
        Of the surface, if there are any yet.
    group : (np,) int array, optional
        Smooth group of every patch.

    Returns
    -------
    points : (s, 3) array
        mm.
    radius : (s,) array
        Half the thickness of the body near each place, mm: the radius of the largest inner ball
        that touches it, not shrunk by a convex edge beside it.
    patch : (s,) int array
    """
    group = smooth_groups(surface).of_patch if group is None else group
    samples = samples or sample_surface(surface, 0, group)
    # between even by number and even by area
    order = np.lexsort([_along_curve(samples.points), samples.patch])
    weight = np.cumsum(samples.spacing[order])
    place = (np.arange(min(count, len(weight))) + 0.5) / min(count, len(weight)) * weight[-1]
    asked = order[np.unique(np.searchsorted(weight, place))]
    points, patch = samples.points[asked], samples.patch[asked]
    radius, touched = inner_radius(samples, asked, 0.5 * surface.diagonal)
    opposite = _opposite(samples, asked, touched, OPPOSITE)
    # the ball that touches the plane of the other sample: samples need not lie face to face
    normal = samples.normals[touched]
    across = np.einsum("ij,ij->i", samples.points[touched] - points, normal)
    cosine = np.einsum("ij,ij->i", samples.normals[asked], normal)
    flat = across / np.maximum(1.0 - cosine, 0.5)
    radius = np.where(opposite & (flat > 0.4 * radius), np.minimum(radius, flat), radius)
    radius[touched < 0] = 0.0
    even = np.sqrt(surface.area() / len(asked))
    reach = np.clip(2.0 * radius, 3.0 * even, 8.0 * even)
    widest = _widest_near(points, radius, reach, group[patch])
    return points, np.where(opposite, radius, widest), patch


def _along_curve(points: np.ndarray) -> np.ndarray:
    """Place of each point on a curve through space that stays near where it was (Morton's)."""
    low = points.min(axis=0)
    size = np.ptp(points, axis=0).max()
    cell = ((points - low) * (1023.0 / size)).astype(np.int64)
    place = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            place |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return place


def _opposite(samples: Samples, asked: np.ndarray, touched: np.ndarray, angle: float) -> np.ndarray:
    """Whether balls at some samples are stopped where the normal is over ``angle`` apart, degrees.

    Beside every convex edge a ball is stopped by the neighbouring face instead.
    """
    cosine = np.einsum("ij,ij->i", samples.normals[asked], samples.normals[touched])
    return (touched >= 0) & (cosine < np.cos(np.radians(angle)))


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


def _pieces(length: np.ndarray, step: float) -> np.ndarray:
    """Number of pieces of at most about ``step`` along lines of ``length`` (m, k), (m,)."""
    return np.maximum(1, np.ceil(length.sum(axis=1) / step)).astype(int)


def _even_lines(breaks: np.ndarray, length: np.ndarray, pieces: int) -> np.ndarray:
    """Parameters that cut lines into pieces of equal length.

    Parameters
    ----------
    breaks : (k + 1,) array
        Parameters of all lines.
    length : (m, k) array
        Length of each line between them.
    pieces : int

    Returns
    -------
    (m, pieces + 1) array
    """
    along = np.pad(np.cumsum(length, axis=1), ((0, 0), (1, 0)))
    # parts without length must not stop the search
    grow = along + np.maximum(along[:, -1:], 1e-300) * np.linspace(0.0, 1e-9, len(breaks))
    wanted = grow[:, -1:] * np.linspace(0.0, 1.0, pieces + 1)
    part = (wanted[:, :, None] >= grow[:, None, 1:-1]).sum(axis=2)
    rows = np.arange(len(length))[:, None]
    low, high = grow[rows, part], grow[rows, part + 1]
    share = np.clip((wanted - low) / np.maximum(high - low, 1e-300), 0.0, 1.0)
    lines = breaks[part] + share * (breaks[part + 1] - breaks[part])
    lines[:, 0], lines[:, -1] = breaks[0], breaks[-1]
    return lines


def _cells(surface: PatchSurface, step: float) -> _Cells:
    owner, low, size = [], [], []
    for stack in surface.stacks:
        u, v = (_fine_lines(knots) for knots in stack.knots)
        uu, vv = (a.ravel() for a in np.meshgrid(u, v, indexing="ij"))
        times = len(stack.members)
        x = surface.evaluate_at(
            np.repeat(stack.members, len(uu)), np.tile(uu, times), np.tile(vv, times)
        ).reshape(times, len(u), len(v), 3)
        along_u = np.linalg.norm(np.diff(x, axis=1), axis=3).max(axis=2)
        along_v = np.linalg.norm(np.diff(x, axis=2), axis=3).max(axis=1)
        pieces = np.column_stack([_pieces(along_u, step), _pieces(along_v, step)])
        kinds, kind = np.unique(pieces, axis=0, return_inverse=True)
        for number, (nu, nv) in enumerate(kinds):
            chosen = np.flatnonzero(kind.ravel() == number)
            lu, lv = _even_lines(u, along_u[chosen], nu), _even_lines(v, along_v[chosen], nv)
            iu, iv = (a.ravel() for a in np.indices((nu, nv)))
            owner.append(np.repeat(stack.members[chosen], nu * nv))
            low.append(np.stack([lu[:, iu], lv[:, iv]], axis=-1).reshape(-1, 2))
            step_u, step_v = np.diff(lu, axis=1), np.diff(lv, axis=1)
            size.append(np.stack([step_u[:, iu], step_v[:, iv]], axis=-1).reshape(-1, 2))
    patch = np.concatenate(owner)
    order = np.argsort(patch, kind="stable")
    patch, low, size = patch[order], np.concatenate(low)[order], np.concatenate(size)[order]
    _, x_u, x_v = evaluate_points(surface, patch, low + 0.5 * size)
    x_u, x_v = x_u * size[:, :1], x_v * size[:, 1:]
    length = np.column_stack([np.linalg.norm(x_u, axis=1), np.linalg.norm(x_v, axis=1)])
    area = np.linalg.norm(np.cross(x_u, x_v), axis=1)
    bend = np.full(len(patch), np.inf)
    for axis, ends in enumerate((((0.0, 0.5), (1.0, 0.5)), ((0.5, 0.0), (0.5, 1.0)))):
        normals = []
        for end in ends:
            _, x_u, x_v = evaluate_points(surface, patch, low + size * end)
            normals.append(np.cross(x_u, x_v))
        sine = np.linalg.norm(np.cross(*normals), axis=1)
        turned = np.arctan2(sine, np.einsum("ij,ij->i", *normals))
        bend = np.minimum(bend, length[:, axis] / np.maximum(turned, 1e-9))
    return _Cells(patch, low, size, length, area, bend)


def _fine_lines(knots: np.ndarray) -> np.ndarray:
    """Knots, and parameters between them where they are few."""
    breaks = bspline.breakpoints(knots)
    cut = max(1, -(-8 // (len(breaks) - 1)))
    inner = breaks[:-1, None] + np.diff(breaks)[:, None] * (np.arange(cut) / cut)
    return np.append(inner.ravel(), breaks[-1])


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
    points, x_u, x_v = evaluate_points(surface, patch, uv)
    normals = np.cross(x_u, x_v)
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
    touched : (m,) int array
        The sample that stops the ball, -1 for the limit.
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
    return radius, touched
