# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The curves and surfaces below a body's edges and faces, exactly as NURBS: values and feet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from .. import bspline
from .feet import project
from .surface_values import evaluate

__all__ = ["SplineCurve", "clamped_part", "evaluate", "project"]

SEEDS = 4
"""Seeds in a knot span and direction, at least; the nearest of all is where a search begins."""

_BLOCK = 1_000
"""Points that are treated at once, which bounds the memory."""

STEPS = 30
"""Longest search for a foot; nearly all end after five."""


@dataclass(frozen=True)
class SplineCurve:
    """The curve of an edge over the edge's own range.

    Attributes
    ----------
    degree : int
    knots : array
        Full clamped knot vector.
    control_points : (n, 3) array
        mm
    weights : (n,) array
        Positive.
    tolerance : float
        How far the file lets the curve be from the faces that it bounds, mm.
    """

    degree: int
    knots: np.ndarray
    control_points: np.ndarray
    weights: np.ndarray
    tolerance: float = 0.0

    def evaluate(self, t: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Points, or first or second derivatives, at m parameters, (m, 3)."""
        rows = np.hstack([self.control_points * self.weights[:, None], self.weights[:, None]])
        homogeneous = []
        for order in range(derivative + 1):
            first, values = bspline.basis_functions(self.degree, self.knots, t, order)
            local = rows[first[:, None] + np.arange(self.degree + 1)]
            homogeneous.append(np.einsum("mi,mid->md", values, local))
        return _quotient(homogeneous)

    def cut(self, low: float, high: float) -> SplineCurve:
        """The part between two parameters."""
        knots, matrix = clamped_part(self.degree, self.knots, low, high)
        weights = matrix @ self.weights
        points = matrix @ (self.control_points * self.weights[:, None])
        return SplineCurve(self.degree, knots, points / weights[:, None], weights, self.tolerance)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Parameters of the nearest places of m points, (m,).

        Searches begin at all seeds that are nearer than those beside them, if anything there can
        be the nearest.
        """
        lines = bspline.breakpoints(self.knots)
        seeds = _refined(lines, max(2 * SEEDS, 4 * self.degree))
        places = self.evaluate(seeds)
        # how far the curve gets from a seed, at most about, before the next one
        reach = 1.5 * np.linalg.norm(np.diff(places, axis=0), axis=1)
        reach = np.maximum(np.append(reach, 0.0), np.append(0.0, reach))
        found = np.empty(len(points))
        for first in range(0, len(points), _BLOCK):
            part = np.asarray(points[first : first + _BLOCK], dtype=float)
            away = cdist(part, places)
            nearest = away <= np.minimum(
                np.pad(away, ((0, 0), (1, 0)), constant_values=np.inf)[:, :-1],
                np.pad(away, ((0, 0), (0, 1)), constant_values=np.inf)[:, 1:],
            )
            row, seed = np.nonzero(nearest & (away - reach <= away.min(axis=1)[:, None]))
            low, high = seeds[np.maximum(seed - 1, 0)], seeds[np.minimum(seed + 1, len(seeds) - 1)]
            t = self._descend(part[row], seeds[seed], low, high)
            distance = np.linalg.norm(self.evaluate(t) - part[row], axis=1)
            # the nearest last, and the first of those that are equally near
            order = np.lexsort((-seed, -distance, row))
            found[first + row[order]] = t[order]
        return found

    def _descend(
        self, points: np.ndarray, t: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> np.ndarray:
        """Newton's method from parameters to feet, (m,), halving what is left between two others.

        Distances fall to the right of ``low`` and grow to the left of ``high`` all the time, or
        these are still the ends given.
        """
        ends = low, high
        for _ in range(STEPS):
            off = self.evaluate(t) - points
            along, bent = self.evaluate(t, 1), self.evaluate(t, 2)
            slope = np.einsum("md,md->m", off, along)
            square = np.einsum("md,md->m", along, along)
            curved = square + np.einsum("md,md->m", off, bent)
            low, high = np.where(slope <= 0.0, t, low), np.where(slope >= 0.0, t, high)
            convex = curved > 1e-6 * square
            new = t - slope / np.where(convex, curved, np.maximum(square, 1e-300))
            middle = 0.5 * (low + high)
            new = np.where(new < low, np.where(low == ends[0], low, middle), new)
            new = np.where(new > high, np.where(high == ends[1], high, middle), new)
            # where the function is not convex, long steps may go back and forth
            new = np.where(convex | (np.abs(new - t) < 0.25 * (high - low)), new, middle)
            done = np.abs(new - t) <= 1e-14 * (self.knots[-1] - self.knots[0])
            t = new
            if done.all():
                break
        return t


def clamped_part(
    degree: int, knots: np.ndarray, low: float, high: float
) -> tuple[np.ndarray, np.ndarray]:
    """Knots of the part of a spline between two parameters, and the matrix to its points.

    Ends that are knots but for rounding are these knots.

    Returns
    -------
    knots : array
        Clamped.
    matrix : (m, n) array
        From the (homogeneous) control points of the whole.
    """
    values, counts = bspline.multiplicities(knots)
    size = values[-1] - values[0]
    ends = []
    for x in (low, high):
        k = int(np.abs(values - x).argmin())
        if abs(values[k] - x) <= 1e-9 * size:
            if 0 < k < len(values) - 1:
                counts[k] = max(counts[k], degree)
            ends.append(values[k])
        else:
            k = int(np.searchsorted(values, x))
            values, counts = np.insert(values, k, x), np.insert(counts, k, degree)
            ends.append(x)
    full = np.repeat(values, counts)
    matrix = bspline.insertion_matrix(degree, knots, full)
    inner = full[(full > ends[0]) & (full < ends[1])]
    first = 0 if ends[0] <= values[0] else int(np.searchsorted(full, ends[0])) - 1
    new = np.concatenate([[ends[0]] * (degree + 1), inner, [ends[1]] * (degree + 1)])
    return new, matrix[first : first + len(new) - degree - 1]


def _refined(lines: np.ndarray, parts: int) -> np.ndarray:
    share = np.arange(parts) / parts
    inside = (lines[:-1, None] + np.diff(lines)[:, None] * share).ravel()
    return np.append(inside, lines[-1])


def _quotient(homogeneous: list[np.ndarray]) -> np.ndarray:
    """The last derivative of x/w from those of x and w, of order at most 2."""
    w = homogeneous[0][:, 3:]
    x = homogeneous[0][:, :3] / w
    if len(homogeneous) == 1:
        return x
    first = (homogeneous[1][:, :3] - homogeneous[1][:, 3:] * x) / w
    if len(homogeneous) == 2:
        return first
    second = homogeneous[2]
    return (second[:, :3] - second[:, 3:] * x - 2.0 * homogeneous[1][:, 3:] * first) / w
