# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Sides of quads on CAD edges: where their ends stand on the edge's curve, and its exact pieces.

The curve belongs to the edge, so both faces beside it take the same piece, whatever they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .. import bspline
from .geometry import SplineCurve
from .quad_mesh import QuadCover

MOST_SPANS = 40
"""Curves of more knot spans are followed within the tolerance only, but for sides of kept faces."""
CLOSE = 1e-6
"""Knots of two sides that are nearer than this become one, as shares of the sides: patches of a
strip take over all knots, and nothing can be proved of a span between two that are nearly equal."""


@dataclass(frozen=True)
class Piece:
    """A part of a curve as a spline over [0, 1].

    Attributes
    ----------
    knots : array
        Clamped.
    points : (n, 4) array
        (w x, w y, w z, w)
    """

    knots: np.ndarray
    points: np.ndarray

    @property
    def degree(self) -> int:
        """Polynomial degree."""
        return len(self.knots) - len(self.points) - 1

    def turned(self) -> Piece:
        """The same part run along the other way."""
        return Piece(1.0 - self.knots[::-1], self.points[::-1])


@dataclass(frozen=True)
class Rims:
    """Sides of quads on edges, with what is exact about them.

    Attributes
    ----------
    exact : (k,) bool array
        Whether the side is the piece of the curve itself,
    piece : dict
        then by its number in ``cover.rim`` this piece, from the smaller corner to the larger one.
    weight : (n,) array
        Weight at each corner of the cover; 1 but for corners on rational edges.
    """

    exact: np.ndarray
    piece: dict[int, Piece]
    weight: np.ndarray


def rims_of(
    cover: QuadCover,
    curves: Sequence[SplineCurve | None],
    chains: Mapping[int, np.ndarray],
    places: Mapping[int, np.ndarray],
    wanted: np.ndarray,
    needed: np.ndarray,
    simple: bool = False,
) -> tuple[Rims, list[int]]:
    """Pieces of all sides on edges, and edges that must be exact and cannot.

    Around a strip of faces the weights at the ends of rational edges may multiply to another
    number than 1; then one of them cannot keep its parameters.

    Parameters
    ----------
    cover : QuadCover
    curves : sequence of SplineCurve
    chains : mapping
        Corners along each edge, from :func:`.places.edge_chains`.
    places : mapping
        Shares of the curve's range at these corners, where they are known.
    wanted : (ne,) bool array
        Edges whose pieces should be exact,
    needed : (ne,) int array
        and those whose pieces must be: the higher, the more so.
    simple : bool
        Knots that nearly agree become one where an edge need not be exact.
    """
    exact = np.zeros(len(cover.rim), dtype=bool)
    weight = np.ones(len(cover.points))
    pieces: dict[int, Piece] = {}
    factors, at_ends, torn = _factors(curves, chains, wanted, needed)
    weight[list(at_ends)] = list(at_ends.values())
    table = cover.rim[:, 0] * len(cover.points) + cover.rim[:, 1]
    for edge, factor in factors.items():
        curve, chain = curves[edge], chains[edge]
        t = parameters(curve, cover.points[chain], places.get(edge))
        found = _pieces(curve, t, factor)
        pairs = np.sort(np.column_stack([chain[:-1], chain[1:]]), axis=1)
        rows = np.searchsorted(table, pairs[:, 0] * len(cover.points) + pairs[:, 1])
        exact[rows] = True
        weight[chain[1:-1]] = [piece.points[0, 3] for piece in found[1:]]
        for row, piece, back in zip(
            rows.tolist(), found, (chain[:-1] > chain[1:]).tolist(), strict=True
        ):
            pieces[row] = piece.turned() if back else piece
    if simple:
        free = {row for row in pieces if not needed[cover.rim_edge[row]]}
        pieces = _with_common_knots(pieces, free)
    return Rims(exact, pieces, weight), torn


def _with_common_knots(pieces: dict[int, Piece], free: set[int]) -> dict[int, Piece]:
    """Pieces whose inner knots are equal where they were nearly equal.

    Parameters
    ----------
    pieces : dict
    free : set
        Those whose knots may be moved. Files write the knots of edges that are copies of each other
        with other last digits.
    """
    inner = {
        row: piece.knots[piece.degree + 1 : -piece.degree - 1] for row, piece in pieces.items()
    }
    inner = {row: knots for row, knots in inner.items() if len(knots)}
    if not inner:
        return pieces
    rows = np.repeat(list(inner), [len(knots) for knots in inner.values()])
    knots = np.concatenate(list(inner.values()))
    fixed = ~np.isin(rows, list(free))
    # sides run both ways: a knot and its mirror image are one
    place = np.minimum(knots, 1.0 - knots)
    place[place > 0.5 - CLOSE] = 0.5
    order = np.lexsort([~fixed, place])
    group = np.cumsum(np.append(0, np.diff(place[order]) > CLOSE))
    count = group[-1] + 1
    # what must not be moved is what the others are moved to
    first = np.full(count, len(order))
    np.minimum.at(first, group, np.where(fixed[order], np.arange(len(order)), len(order)))
    own = np.searchsorted(group, np.arange(count))
    chosen = place[order][np.where(first < len(order), first, own)]
    new = np.empty(len(place))
    new[order] = chosen[group]
    new = np.where(knots > 0.5, 1.0 - new, new)
    # equal knots of one piece stay equal, and different ones different
    same = {row: new[rows == row] for row in free & set(inner)}
    changed = dict(pieces)
    for row, moved in same.items():
        piece, old = pieces[row], inner[row]
        if np.array_equal(np.diff(moved) > 0.0, np.diff(old) > 0.0):
            ends = np.repeat([0.0, 1.0], piece.degree + 1)
            changed[row] = Piece(np.insert(ends, piece.degree + 1, moved), piece.points)
    return changed


def parameters(curve: SplineCurve, points: np.ndarray, share: np.ndarray | None) -> np.ndarray:
    """Parameters of the corners along an edge, rising from one end of the curve to the other."""
    low, high = curve.knots[0], curve.knots[-1]
    if share is None:
        t = np.maximum.accumulate(curve.project(points))
    else:
        t = low + share * (high - low)
    t[[0, -1]] = low, high
    lines = bspline.breakpoints(curve.knots)
    near = lines[np.abs(t[:, None] - lines).argmin(axis=1)]
    return np.where(np.abs(near - t) <= 1e-9 * (high - low), near, t)


def _factors(
    curves: Sequence[SplineCurve | None],
    chains: Mapping[int, np.ndarray],
    wanted: np.ndarray,
    needed: np.ndarray,
) -> tuple[dict[int, float], dict[int, float], list[int]]:
    """Factor of the weights of each edge that is exact, weights at its ends, and torn edges.

    A curve may be multiplied by one factor. Its weights at both ends must be those of the other
    curves there: a curve for which that cannot be is left out.
    """
    group: dict[int, tuple[int, float]] = {}  # corner: root, logarithm of its weight to the root's

    def root(corner: int) -> tuple[int, float]:
        level = 0.0
        while corner in group:
            corner, more = group[corner]
            level += more
        return corner, level

    begins, torn = {}, []
    order = sorted(chains, key=lambda edge: (-needed[edge], edge))
    for edge in order:
        curve, chain = curves[edge], chains[edge]
        spans = len(bspline.breakpoints(curve.knots)) - 1
        if not (needed[edge] or (wanted[edge] and spans <= MOST_SPANS)):
            continue
        ratio = float(np.log(curve.weights[-1] / curve.weights[0]))
        (a, at_a), (b, at_b) = root(int(chain[0])), root(int(chain[-1]))
        if a != b:
            group[b] = (a, at_a + ratio - at_b)
        elif abs(at_a + ratio - at_b) > 1e-9:
            if needed[edge]:
                torn.append(edge)
            continue
        begins[edge] = int(chain[0])
    factors, weights = {}, {}
    for edge, first in begins.items():
        for corner in (first, int(chains[edge][-1])):
            weights[corner] = float(np.exp(root(corner)[1]))
        factors[edge] = weights[first] / float(curves[edge].weights[0])
    return factors, weights, torn


def _pieces(curve: SplineCurve, t: np.ndarray, factor: float) -> list[Piece]:
    """Parts of a curve between rising parameters."""
    degree = curve.degree
    values, counts = bspline.multiplicities(curve.knots)
    every = np.unique(np.concatenate([values, t]))
    times = np.zeros(len(every), dtype=int)
    times[np.searchsorted(every, values)] = counts
    corner = np.searchsorted(every, t)
    times[corner] = np.maximum(times[corner], degree)
    knots = np.repeat(every, times)
    points = np.hstack([curve.control_points * curve.weights[:, None], curve.weights[:, None]])
    points = factor * (bspline.insertion_matrix(degree, curve.knots, knots) @ points)
    first = np.searchsorted(knots, t[:-1], side="right") - degree - 1
    last = np.searchsorted(knots, t[1:], side="left") - 1
    found = []
    for a, b, low, high in zip(
        first.tolist(), last.tolist(), t[:-1].tolist(), t[1:].tolist(), strict=True
    ):
        inner = knots[a + degree + 1 : b + 1]
        ends = np.repeat([0.0, 1.0], degree + 1)
        own = np.insert(ends, degree + 1, (inner - low) / (high - low))
        found.append(Piece(own, points[a : b + 1]))
    return found
