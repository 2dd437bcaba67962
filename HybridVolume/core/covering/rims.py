# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Sides of quads on CAD edges: where their ends stand on the edge's curve, and its exact pieces.

The curve belongs to the edge, so both faces beside it take the same piece, whatever they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .. import bspline
from .geometry import SplineCurve
from .quad_mesh import QuadCover

EVEN = 1e-9
"""Weights of a curve's ends that agree to this share count as equal."""
MOST_SPANS = 40
"""Curves of more knot spans are followed within the tolerance only."""


def whole(curve: SplineCurve) -> bool:
    """Whether pieces of a curve can be taken exactly: few spans, equal weights at both ends."""
    even = abs(curve.weights[0] / curve.weights[-1] - 1.0) <= EVEN
    return even and len(bspline.breakpoints(curve.knots)) - 1 <= MOST_SPANS


@dataclass(frozen=True)
class Rims:
    """Sides of quads on edges, with what is exact about them.

    Attributes
    ----------
    low, high : (k,) arrays
        Parameters on the edge's curve at the smaller and the larger corner of each rim.
    exact : (k,) bool array
        Whether the side is the piece of the curve itself,
    piece : dict
        then by its number in ``cover.rim`` the Bézier points (w x, w y, w z, w), (n, 4), from the
        smaller corner to the larger one.
    weight : (n,) array
        Weight at each corner of the cover; 1 but for corners inside rational edges.
    """

    low: np.ndarray
    high: np.ndarray
    exact: np.ndarray
    piece: dict[int, np.ndarray]
    weight: np.ndarray


def spread(cover: QuadCover, curves: Sequence[SplineCurve | None], edges: np.ndarray) -> QuadCover:
    """Move corners on edges such that they are evenly spread along the curves' parameters.

    Parameters
    ----------
    cover : QuadCover
    curves : sequence of SplineCurve
    edges : int array
        Edges whose corners are moved; knots of their curves get a corner each where there are
        enough, so that opposite sides of an iso-parameter rectangle have the same parameters.
    """
    points = cover.points.copy()
    for edge in edges.tolist():
        rows = np.flatnonzero(cover.rim_edge == edge)
        chain, t = _chain(cover, rows, curves[edge])
        new = _even_parameters(curves[edge], len(chain) - 1)
        if t[0] > t[-1]:
            new = new[::-1]
        points[chain[1:-1]] = curves[edge].evaluate(new[1:-1])
    return replace(cover, points=points)


def _even_parameters(curve: SplineCurve, count: int) -> np.ndarray:
    """Parameters of count + 1 corners: every knot is one where there are enough."""
    lines = bspline.breakpoints(curve.knots)
    spans = np.diff(lines)
    if count < len(spans):
        return np.linspace(lines[0], lines[-1], count + 1)
    parts = np.ones(len(spans), dtype=int)
    for _ in range(count - len(spans)):
        parts[np.argmax(spans / parts)] += 1
    inside = [
        a + width * np.arange(n) / n for a, width, n in zip(lines, spans, parts, strict=False)
    ]
    return np.append(np.concatenate(inside), lines[-1])


def _chain(cover: QuadCover, rows: np.ndarray, curve: SplineCurve) -> tuple[np.ndarray, np.ndarray]:
    """Corners along an edge in the order of their parameters, and these."""
    corners = np.unique(cover.rim[rows])
    t = curve.project(cover.points[corners])
    if len(corners) == len(rows):
        # a closed curve: its first corner is its last one too
        start = np.argmin(np.minimum(t - curve.knots[0], curve.knots[-1] - t))
        t[start] = curve.knots[0]
        order = np.argsort(t)
        return np.append(corners[order], corners[start]), np.append(t[order], curve.knots[-1])
    order = np.argsort(t)
    return corners[order], t[order]


def rims_of(cover: QuadCover, curves: Sequence[SplineCurve | None], wanted: np.ndarray) -> Rims:
    """Places and pieces of all sides on edges.

    Parameters
    ----------
    cover : QuadCover
    curves : sequence of SplineCurve
    wanted : (ne,) bool array
        Edges whose pieces should be exact.
    """
    count = len(cover.rim)
    low, high = np.zeros(count), np.zeros(count)
    exact = np.zeros(count, dtype=bool)
    weight = np.ones(len(cover.points))
    pieces: dict[int, np.ndarray] = {}
    number = {tuple(pair): k for k, pair in enumerate(cover.rim.tolist())}
    for edge in np.unique(cover.rim_edge).tolist():
        curve = curves[edge]
        chain, t = _chain(cover, np.flatnonzero(cover.rim_edge == edge), curve)
        turned = chain[:-1] > chain[1:]
        rows = [number[min(a, b), max(a, b)] for a, b in zip(chain, chain[1:], strict=False)]
        low[rows] = np.where(turned, t[1:], t[:-1])
        high[rows] = np.where(turned, t[:-1], t[1:])
        found = _pieces(curve, t) if wanted[edge] and whole(curve) else None
        if found is None:
            continue
        exact[rows] = True
        weight[chain[1:-1]] = found[1:, 0, 3]
        pieces |= {
            row: piece[::-1] if back else piece
            for row, piece, back in zip(rows, found, turned.tolist(), strict=True)
        }
    return Rims(low, high, exact, pieces, weight)


def _pieces(curve: SplineCurve, t: np.ndarray) -> np.ndarray | None:
    """Bézier points of the pieces between parameters, (k, p + 1, 4); None where a knot is inside.

    Weights are 1 at both ends of the curve.
    """
    lines = bspline.breakpoints(curve.knots)
    size = lines[-1] - lines[0]
    near = np.abs(lines[1:-1, None] - t).argmin(axis=1) if len(lines) > 2 else np.zeros(0, int)
    if np.any(np.abs(lines[1:-1] - t[near]) > 1e-9 * size):
        return None
    at = t.copy()
    at[near] = lines[1:-1]
    at[[0, -1]] = lines[[0, -1]]
    values, counts = bspline.multiplicities(curve.knots)
    times = np.full(len(at), curve.degree)
    times[[0, -1]] = curve.degree + 1
    place = np.searchsorted(at, values)
    if np.any(counts[1:-1] > times[place[1:-1]]):
        return None
    points = np.hstack([curve.control_points * curve.weights[:, None], curve.weights[:, None]])
    raised = bspline.insertion_matrix(curve.degree, curve.knots, np.repeat(at, times)) @ points
    first = curve.degree * np.arange(len(at) - 1)
    found = raised[first[:, None] + np.arange(curve.degree + 1)]
    return found / curve.weights[0]
