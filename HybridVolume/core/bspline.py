# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Univariate B-splines as matrices: evaluation, extraction, exact refinement.

Knot vectors are full, non-decreasing and clamped: the first and last knot stand ``degree + 1``
times. Everything that changes a spline exactly (insertion, elevation, extraction) is a matrix that
is applied to control points, so that it acts on any number of coordinates at once.

Source: Piegl and Tiller, The NURBS Book, chapters 2 and 5; Borden et al. 2011 for the extraction.
"""

from __future__ import annotations

from math import comb

import numpy as np
from scipy import sparse

KNOT_TOLERANCE = 1e-10
"""Knots of [0, 1] that are closer than this are one knot."""


def breakpoints(knots: np.ndarray) -> np.ndarray:
    """Distinct knots of a clamped knot vector, (ne + 1,)."""
    return np.unique(knots)


def multiplicities(knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct knots and how often each stands."""
    return np.unique(knots, return_counts=True)


def clamped_knots(degree: int, spans: int, multiplicity: int = 1) -> np.ndarray:
    """Uniform clamped knots on [0, 1] with inner knots of one multiplicity."""
    inner = np.repeat(np.arange(1, spans) / spans, multiplicity)
    return np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])


def find_spans(degree: int, knots: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Index ``s`` with ``knots[s] <= x < knots[s + 1]``; the last span takes its right end."""
    n = len(knots) - degree - 1
    return np.clip(np.searchsorted(knots, x, side="right") - 1, degree, n - 1)


def basis_functions(
    degree: int, knots: np.ndarray, x: np.ndarray, derivative: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """The ``degree + 1`` functions that do not vanish at each point.

    Parameters
    ----------
    degree : int
    knots : (n + degree + 1,) array
    x : (m,) array
    derivative : int
        Order of the derivative.

    Returns
    -------
    first : (m,) int array
        Number of the first of these functions.
    values : (m, degree + 1) array
    """
    x = np.asarray(x, dtype=float)
    if derivative > degree:
        span = find_spans(degree, knots, x)
        return span - degree, np.zeros((len(x), degree + 1))
    span = find_spans(degree, knots, x)
    values = np.ones((len(x), 1))
    for p in range(1, degree - derivative + 1):
        left = x[:, None] - knots[span[:, None] + np.arange(1 - p, 1)]
        right = knots[span[:, None] + np.arange(1, p + 1)] - x[:, None]
        ratio = values / (right + left)
        values = np.zeros((len(x), p + 1))
        values[:, :-1] = right * ratio
        values[:, 1:] += left * ratio
    for p in range(degree - derivative + 1, degree + 1):
        width = (
            knots[span[:, None] + np.arange(1, p + 1)] - knots[span[:, None] + np.arange(1 - p, 1)]
        )
        ratio = p * values / width
        values = np.zeros((len(x), p + 1))
        values[:, :-1] = -ratio
        values[:, 1:] += ratio
    return span - degree, values


def basis_matrix(
    degree: int, knots: np.ndarray, x: np.ndarray, derivative: int = 0
) -> sparse.csr_matrix:
    """Matrix that takes n control points to values (or derivatives) at m points, (m, n)."""
    first, values = basis_functions(degree, knots, x, derivative)
    m, n = len(values), len(knots) - degree - 1
    columns = first[:, None] + np.arange(degree + 1)
    rows = np.arange(0, m * (degree + 1) + 1, degree + 1)
    return sparse.csr_matrix((values.ravel(), columns.ravel(), rows), shape=(m, n))


def greville(degree: int, knots: np.ndarray) -> np.ndarray:
    """Greville abscissae (the paper's node locations t_l), (n,)."""
    n = len(knots) - degree - 1
    if degree == 0:
        return 0.5 * (knots[:-1] + knots[1:])
    windows = np.lib.stride_tricks.sliding_window_view(knots[1:-1], degree)[:n]
    # the mean of equal knots may miss them by a rounding: the ends must be exact
    return np.clip(windows.mean(axis=1), knots[0], knots[-1])


def insertion_matrix(degree: int, knots: np.ndarray, new_knots: np.ndarray) -> np.ndarray:
    """Matrix from the control points over ``knots`` to those over the finer ``new_knots``.

    Oslo algorithm: every knot of ``knots`` must stand in ``new_knots``.

    Returns
    -------
    (m, n) array
    """
    n, m = len(knots) - degree - 1, len(new_knots) - degree - 1
    span = find_spans(degree, knots, new_knots[:m])
    rows = np.arange(m)
    values = np.ones((m, 1))
    for p in range(1, degree + 1):
        x = new_knots[rows + p][:, None]
        low = knots[span[:, None] + np.arange(1 - p, 1)]
        high = knots[span[:, None] + np.arange(1, p + 1)]
        share = (x - low) / (high - low)
        fresh = np.zeros((m, p + 1))
        fresh[:, :-1] = (1.0 - share) * values
        fresh[:, 1:] += share * values
        values = fresh
    matrix = np.zeros((m, n))
    matrix[rows[:, None], span[:, None] - degree + np.arange(degree + 1)] = values
    return matrix


def bezier_extraction(degree: int, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Extraction operators of all knot spans.

    Returns
    -------
    first : (ne,) int array
        First control point of each span.
    operators : (ne, degree + 1, degree + 1) array
        Bézier points of span e are ``operators[e] @ points[first[e] : first[e] + degree + 1]``.
    """
    values, counts = multiplicities(knots)
    full = np.repeat(values, np.maximum(counts, degree))
    # inner knots that already stand degree + 1 times split the spline; keep them as they are
    matrix = insertion_matrix(degree, knots, full)
    spans = find_spans(degree, knots, 0.5 * (values[:-1] + values[1:]))
    first = spans - degree
    row_start = np.cumsum(np.concatenate([[0], np.maximum(counts, degree)[1:-1]])).astype(int)
    rows = row_start[:, None] + np.arange(degree + 1)
    columns = first[:, None] + np.arange(degree + 1)
    return first, matrix[rows[:, :, None], columns[:, None, :]]


def bezier_elevation(degree: int, times: int) -> np.ndarray:
    """Degree elevation of one Bézier segment, (degree + times + 1, degree + 1)."""
    new = degree + times
    matrix = np.zeros((new + 1, degree + 1))
    for i in range(new + 1):
        for j in range(max(0, i - times), min(degree, i) + 1):
            matrix[i, j] = comb(degree, j) * comb(times, i - j) / comb(new, i)
    return matrix


def elevation_matrix(degree: int, knots: np.ndarray, times: int) -> tuple[np.ndarray, np.ndarray]:
    """Exact degree elevation.

    Returns
    -------
    matrix : (m, n) array
    new_knots : array
        Every distinct knot stands ``times`` times more.
    """
    values, counts = multiplicities(knots)
    new = degree + times
    new_knots = np.repeat(values, counts + times)
    if times == 0:
        return np.eye(len(knots) - degree - 1), knots.copy()
    first, operators = bezier_extraction(degree, knots)
    raised = bezier_elevation(degree, times) @ operators
    n, m = len(knots) - degree - 1, len(new_knots) - new - 1
    # The dual functional of each new function lives on one span: read it from there by blossoming.
    matrix = np.zeros((m, n))
    spans = find_spans(new, new_knots, np.clip(greville(new, new_knots), 0.0, 1.0))
    element = np.searchsorted(values, new_knots[spans], side="right") - 1
    element = np.clip(element, 0, len(values) - 2)
    for i in range(m):
        e = element[i]
        a, b = values[e], values[e + 1]
        arguments = (new_knots[i + 1 : i + new + 1] - a) / (b - a)
        points = raised[e]
        for t in arguments:
            points = (1.0 - t) * points[:-1] + t * points[1:]
        matrix[i, first[e] : first[e] + degree + 1] = points[0]
    return matrix, new_knots


def merge_knots(degree: int, knot_vectors: list[np.ndarray]) -> np.ndarray:
    """Smallest knot vector that contains all the given ones (same degree, on [0, 1])."""
    found: list[tuple[float, int]] = []
    for knots in knot_vectors:
        values, counts = multiplicities(knots)
        for value, count in zip(values, counts, strict=True):
            for k, (known, highest) in enumerate(found):
                if abs(known - value) <= KNOT_TOLERANCE:
                    found[k] = (known, max(highest, int(count)))
                    break
            else:
                found.append((float(value), int(count)))
    found.sort()
    return np.repeat([v for v, _ in found], [c for _, c in found])


def snap_knots(knots: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The same knot vector with knots that nearly stand in ``target`` set to exactly those."""
    values = np.unique(target)
    nearest = values[np.argmin(np.abs(knots[:, None] - values), axis=1)]
    return np.where(np.abs(nearest - knots) <= KNOT_TOLERANCE, nearest, knots)


def torn_knots(degree: int, knots: np.ndarray) -> np.ndarray:
    """Distinct inner knots that stand more than ``degree`` times (the spline is torn there)."""
    values, counts = multiplicities(knots)
    inner = (values > values[0]) & (values < values[-1])
    return values[inner & (counts > degree)]
