# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The inner curve of a ring on any plane body: nodes of its boundary go inward along a field.

The field is the torsion function, -laplace phi = 1 inside and phi = 0 on the boundary: smooth, like
the distance near the boundary, and growing up to the middle of each part. On a disk and on an
ellipse the level 1 - (1 - depth)² of its largest value is the boundary scaled by 1 - depth; in a
strip it is the depth's share of half the width. Each node stops at that share of what the field
comes to on its own path, at the first ridge. So inner curves follow bodies that have no middle to
scale to, and their narrow parts (the paper's 3.2 has a harmonic field for that).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from .assembly import load, stiffness
from .linear import solve_fixed
from .plane_curve import PlaneCurve
from .plane_mesh import fill_polygon
from .simplex_space import SimplexSpace

FINENESS = 0.125
"""Edges of the field's triangles over the body's mean half width 2 A / P."""
RIDGE = 0.2
"""Slope of a path that has come to a ridge, over the slope at the walls of a strip around it."""
_STEP = 0.25
"""Steps along a path over the edges of the triangles."""
_SAMPLES = 4096
"""Points of each arc from which a polygon's corners are taken."""
_LONGEST = 12.0
"""Length of a path at most, over the mean half width."""
_ALIKE = 8
"""Rounds in which levels of neighbouring nodes are made alike."""
SPREAD = (0, 2, 5, 10, 20, 40)
"""Rounds in which nodes are spread along the level, as the paper's 3.5 spreads its front."""


def inner_points(boundary: PlaneCurve, depth: float) -> Iterator[np.ndarray]:
    """Control points of inner curves with the boundary's knots, and weights 1.

    Parameters
    ----------
    boundary : PlaneCurve
    depth : float
        Share of the way from the boundary to the middle, in (0, 1).

    Yields
    ------
    (n, 2) array
        mm, in the order of the boundary's control points. The first ones are spread least along
        the level: what is right depends on the thickness over the length of the spans, so the
        caller takes the one whose ring is best.
    """
    places = boundary.greville
    patch = np.repeat(np.arange(len(places)), [len(place) for place in places])
    u = np.concatenate(places)
    outer = boundary.evaluate(patch, u)
    field, half_width = _field(boundary)
    paths, values, slopes = _paths(field, outer, half_width)
    low = _at_ridge(values, slopes)
    end = np.where(low.any(axis=0), low.argmax(axis=0), len(slopes) - 1)
    top = values[end, np.arange(len(outer))] / (1.0 - RIDGE**2)
    level = (1.0 - (1.0 - depth) ** 2) * np.minimum(top, field.largest)
    for _ in range(_ALIKE):
        level = np.minimum(level, 0.5 * level + 0.25 * (np.roll(level, 1) + np.roll(level, -1)))
    inner = _reached(paths, values, level)
    basis = boundary.basis(patch, u).toarray()
    done = 0
    for rounds in SPREAD:
        inner = _spread(field, outer, inner, level, rounds - done)
        done = rounds
        yield np.linalg.solve(basis, inner)


class _Torsion:
    """The field on linear triangles, with slopes that are continuous."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, values: np.ndarray) -> None:
        x = vertices[triangles]
        edges = np.roll(x, -2, axis=1) - np.roll(x, -1, axis=1)
        area = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
        # gradient of corner k's function: its edge turned by a quarter, over twice the area
        turned = np.stack([-edges[..., 1], edges[..., 0]], axis=2)
        flat = np.einsum("ek,ekc->ec", values[triangles], turned)
        corners = triangles.ravel()
        total = np.bincount(corners, np.repeat(area, 3), len(vertices))
        self.slopes = np.column_stack(
            [np.bincount(corners, np.repeat(part, 3), len(vertices)) / total for part in flat.T]
        )
        self.vertices, self.values = vertices, values
        self.largest = float(values.max())
        self.origin, self.size = vertices.mean(axis=0), float(np.ptp(vertices, axis=0).max())
        self._triangles = Delaunay((vertices - self.origin) / self.size)
        self._tree = cKDTree(vertices)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and slopes at places; beside the triangles those of the nearest vertex."""
        scaled = (x - self.origin) / self.size
        found = self._triangles.find_simplex(scaled)
        inside = self._triangles.transform[found]
        two = np.einsum("mij,mj->mi", inside[:, :2], scaled - inside[:, 2])
        share = np.column_stack([two, 1.0 - two.sum(axis=1)])
        corners = self._triangles.simplices[found]
        values = (share * self.values[corners]).sum(axis=1)
        slopes = np.einsum("mk,mkc->mc", share, self.slopes[corners])
        out = found < 0
        if out.any():
            _, near = self._tree.query(x[out])
            values[out], slopes[out] = self.values[near], self.slopes[near]
        return values, slopes


def _field(boundary: PlaneCurve) -> tuple[_Torsion, float]:
    """The torsion function of a body, and its mean half width, mm."""
    patch = np.repeat(np.arange(len(boundary.knots)), _SAMPLES)
    u = np.tile(np.arange(_SAMPLES) / _SAMPLES, len(boundary.knots))
    polygon = boundary.evaluate(patch, u)
    length = float(np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1).sum())
    half_width = 2.0 * boundary.area / length
    size = FINENESS * half_width
    along = np.cumsum(np.linalg.norm(np.diff(polygon, axis=0, append=polygon[:1]), axis=1))
    # corners of the body stay corners of the polygon
    number = np.floor(np.concatenate([[0.0], along[:-1]]) / size)
    kept = (np.diff(number, prepend=-1.0) > 0) | (u == 0.0)
    vertices, triangles = fill_polygon(polygon[kept], size)
    rim = np.arange(np.count_nonzero(kept))
    nothing = np.zeros(0, dtype=int)
    space = SimplexSpace(
        1, vertices, triangles, nothing, nothing, np.zeros((0, 1)), np.zeros(0),
        np.zeros((0, 2), dtype=int), nothing, np.zeros((0, 2, 1)), np.zeros((0, 2)),
    )  # fmt: skip
    right = load(space, lambda x: np.ones(len(x)))
    values = solve_fixed(stiffness(space), right, rim, np.zeros(len(rim)))
    return _Torsion(vertices, triangles, values), half_width


def _paths(
    field: _Torsion, start: np.ndarray, half_width: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points on paths up the field, its values and its slopes there: (m, n, 2), (m, n), (m, n)."""
    step = _STEP * FINENESS * half_width
    x = start
    points, values, slopes = [], [], []
    over = np.zeros(len(start), dtype=bool)
    for _ in range(round(_LONGEST * half_width / step)):
        value, slope = field(x)
        points.append(x)
        values.append(value)
        slopes.append(np.linalg.norm(slope, axis=1))
        _, ahead = field(x + 0.5 * step * _unit(slope))
        x = x + step * _unit(ahead)
        over |= _at_ridge(values[-1], slopes[-1])
        if over.all():
            break
    values[0] = np.zeros(len(start))
    return np.array(points), np.array(values), np.array(slopes)


def _spread(
    field: _Torsion, outer: np.ndarray, inner: np.ndarray, level: np.ndarray, rounds: int
) -> np.ndarray:
    """Inner points spread like the outer ones, each back on its level.

    Paths from both sides of a corner run together; a front of points that is smoothed along its
    level does not.
    """
    after = np.linalg.norm(np.roll(outer, -1, axis=0) - outer, axis=1)[:, None]
    before = np.roll(after, 1, axis=0)
    for _ in range(rounds):
        ahead, behind = np.roll(inner, -1, axis=0), np.roll(inner, 1, axis=0)
        middle = (ahead * before + behind * after) / (before + after)
        inner = 0.5 * (inner + middle)
        value, slope = field(inner)
        size = (slope**2).sum(axis=1)
        reach = (level - value) / np.maximum(size, 0.01 * size.max())
        inner = inner + reach[:, None] * slope
    return inner


def _at_ridge(values: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Whether places are near a ridge.

    In a strip of half width R slope² + 2 phi is R² everywhere, and at the ridge the slope is 0.
    """
    return slopes**2 < RIDGE**2 * (slopes**2 + 2.0 * values)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-300)[:, None]


def _reached(paths: np.ndarray, values: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Points where the values on paths first come to the levels, or their last points."""
    above = values >= level
    after = np.where(above.any(axis=0), above.argmax(axis=0), len(values) - 1)
    after = np.maximum(after, 1)
    column = np.arange(len(level))
    low, high = values[after - 1, column], values[after, column]
    share = np.clip((level - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)
    return (1.0 - share)[:, None] * paths[after - 1, column] + share[:, None] * paths[after, column]
