# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The curves and surfaces below a body's edges and faces, exactly as NURBS: values and feet."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .. import bspline
from ..surface import SplineFace

SEEDS = 4
"""Seeds in a knot span and direction, at least; the nearest of all is where a search begins."""

MOST_SEEDS = 20_000
"""Surfaces of many knot spans get fewer seeds in each, but two."""

SETTLED = 1e-10
"""Steps by less, as a share of the range, are the last: the next would be its square."""

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
        """Parameters of the nearest places of m points, (m,)."""
        lines = bspline.breakpoints(self.knots)
        seeds = _refined(lines, max(2 * SEEDS, 4 * self.degree))
        t = seeds[cKDTree(self.evaluate(seeds)).query(points)[1]]
        for _ in range(STEPS):
            off = self.evaluate(t) - points
            along, bent = self.evaluate(t, 1), self.evaluate(t, 2)
            slope = np.einsum("md,md->m", off, along)
            square = np.einsum("md,md->m", along, along)
            curved = square + np.einsum("md,md->m", off, bent)
            # where the function is not convex, the step of Gauss and Newton leads down anyway
            step = slope / np.where(curved > 0.1 * square, curved, np.maximum(square, 1e-300))
            new = np.clip(t - step, lines[0], lines[-1])
            done = np.abs(new - t) <= 1e-14 * (lines[-1] - lines[0])
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


def evaluate(face: SplineFace, uv: np.ndarray, derivative: int = 0) -> list[np.ndarray]:
    """Points of a face at m places, and first (and second) derivatives.

    Parameters
    ----------
    face : SplineFace
    uv : (m, 2) array
    derivative : {0, 1, 2}

    Returns
    -------
    list of (m, 3) array
        The point; along u, v; along uu, uv, vv.
    """
    orders = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)][: (1, 3, 6)[derivative]]
    tables = [
        [
            bspline.basis_functions(degree, knots, x, order)
            for order in range(min(derivative, 2) + 1)
        ]
        for degree, knots, x in zip(face.degrees, face.knots, np.asarray(uv).T, strict=True)
    ]
    rows = np.concatenate([face.control_points * face.weights[..., None],
                           face.weights[..., None]], axis=2)  # fmt: skip
    first = [table[0][0] for table in tables]
    local = rows[
        first[0][:, None, None] + np.arange(face.degrees[0] + 1)[:, None],
        first[1][:, None, None] + np.arange(face.degrees[1] + 1),
    ]
    across = np.matmul(
        np.stack([values for _, values in tables[0]], axis=1), local.reshape(*local.shape[:2], -1)
    ).reshape(len(local), len(tables[0]), face.degrees[1] + 1, 4)
    value = {(a, b): np.matmul(tables[1][b][1][:, None], across[:, a])[:, 0] for a, b in orders}
    weight = value[0, 0][:, 3:]
    x = value[0, 0][:, :3] / weight
    found = [x]
    if derivative:
        u, v = ((value[key][:, :3] - value[key][:, 3:] * x) / weight for key in ((1, 0), (0, 1)))
        found += [u, v]
    if derivative == 2:
        for key, (one, other) in zip(
            ((2, 0), (1, 1), (0, 2)), (((1, 0), (1, 0)), ((1, 0), (0, 1)), ((0, 1), (0, 1))),
            strict=True,
        ):  # fmt: skip
            slopes = {(1, 0): u, (0, 1): v}
            found.append(
                (
                    value[key][:, :3]
                    - value[key][:, 3:] * x
                    - value[one][:, 3:] * slopes[other]
                    - value[other][:, 3:] * slopes[one]
                )
                / weight
            )
    return found


def project(face: SplineFace, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Feet of points on the untrimmed surface of a face.

    Parameters
    ----------
    face : SplineFace
    points : (m, 3) array
        mm; near the face.

    Returns
    -------
    uv : (m, 2) array
    feet : (m, 3) array
        mm
    """
    points = np.asarray(points, dtype=float)
    seeds, tree, low, high = _seeds(face)
    uv = seeds[tree.query(points)[1]]
    best = np.linalg.norm(evaluate(face, uv)[0] - points, axis=1)
    active = np.arange(len(points))
    for _ in range(STEPS):
        if not len(active):
            break
        step = _step(face, uv[active], points[active], low, high)
        moved = np.zeros(len(active))
        for share in (1.0, 0.25, 0.0625):
            rows = np.flatnonzero(moved == 0.0)
            if not len(rows):
                break
            own = active[rows]
            trial = np.clip(uv[own] - share * step[rows], low, high)
            reached = np.linalg.norm(evaluate(face, trial)[0] - points[own], axis=1)
            # near a foot distances differ by rounding only, the place does not
            better = reached <= best[own] * (1.0 + 1e-14)
            own, rows, trial = own[better], rows[better], trial[better]
            moved[rows] = (np.abs(trial - uv[own]) / (high - low)).max(axis=1)
            uv[own], best[own] = trial, reached[better]
        active = active[moved > SETTLED]
    return uv, evaluate(face, uv)[0]


def _step(
    face: SplineFace, uv: np.ndarray, points: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Steps (m, 2) of Newton's method towards feet; subtracted from parameters."""
    x, u, v, uu, uw, vv = evaluate(face, uv, 2)
    off = x - points
    slope = np.stack([_dot(off, u), _dot(off, v)], axis=1)
    a, b, c = _dot(u, u), _dot(u, v), _dot(v, v)
    bent = a + _dot(off, uu), b + _dot(off, uw), c + _dot(off, vv)
    # second derivatives count where they leave the function convex
    convex = (bent[0] * bent[2] - bent[1] ** 2 > 1e-3 * (a * c - b**2)) & (bent[0] > 0.0)
    floor = 1e-14 * np.maximum(a + c, 1e-300)
    p, r, q = (np.where(convex, x, y) for x, y in zip(bent, (a, b, c), strict=True))
    p, q = p + floor, q + floor
    determinant = p * q - r**2
    determinant = np.where(np.abs(determinant) > 1e-300, determinant, 1e-300)
    step = np.stack([q * slope[:, 0] - r * slope[:, 1], p * slope[:, 1] - r * slope[:, 0]], axis=1)
    step /= determinant[:, None]
    # at a border of the parameters only the other one moves
    out = ((uv <= low) & (slope > 0.0)) | ((uv >= high) & (slope < 0.0))
    alone = slope / np.maximum(np.stack([a, c], axis=1), 1e-300)
    return np.where(out, 0.0, np.where(out[:, ::-1], alone, step))


_KNOWN: OrderedDict[int, tuple] = OrderedDict()
"""Seeds of the faces that were looked at last, by their control points."""


def _seeds(face: SplineFace) -> tuple[np.ndarray, cKDTree, np.ndarray, np.ndarray]:
    """Parameters of seeds, a tree of their points, and the ends of the parameters."""
    key = id(face.control_points)
    known = _KNOWN.get(key)
    if known is not None and known[0] is face.control_points:
        _KNOWN.move_to_end(key)
        return known[1]
    spans = [bspline.breakpoints(knots) for knots in face.knots]
    parts = [max(SEEDS, 2 * degree) for degree in face.degrees]
    while np.prod([(len(x) - 1) * n for x, n in zip(spans, parts, strict=True)]) > MOST_SEEDS and (
        max(parts) > 2
    ):
        parts = [max(2, n - 1) for n in parts]
    lines = [_refined(x, n) for x, n in zip(spans, parts, strict=True)]
    low, high = (np.array([line[k] for line in lines]) for k in (0, -1))
    # at a pole no step leads away along it: the first seeds are beside it
    size = float(np.ptp(face.control_points, axis=(0, 1)).max())
    for axis, line in enumerate(lines):
        for end, beside in ((0, 1), (-1, -2)):
            side = np.take(face.control_points, end, axis=axis)
            if np.ptp(side, axis=0).max() <= 1e-9 * size:
                line[end] += 0.125 * (line[beside] - line[end])
    seeds = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    found = seeds, cKDTree(evaluate(face, seeds)[0]), low, high
    _KNOWN[key] = (face.control_points, found)
    while len(_KNOWN) > 500:
        _KNOWN.popitem(last=False)
    return found


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("md,md->m", a, b)


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
