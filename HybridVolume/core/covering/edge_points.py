# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Points on the edges of a body, the same for all faces and whichever mesher is at work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .. import bspline
from .geometry import SplineCurve
from .outline import Outline

SAMPLES = 16
"""Points of a knot span by which the length of a curve is measured, at least."""


@dataclass(frozen=True)
class EdgePoints:
    """Points that cut every edge evenly by its length: its intervals and their middles.

    Attributes
    ----------
    points : (n, 3) array
        The outline's vertices come first, mm.
    numbers : (k,) int array
        Points along all edges one after the other, both ends included.
    first : (ne + 1,) int array
        Where each edge begins in ``numbers``; edges without intervals have nothing there.
    """

    points: np.ndarray
    numbers: np.ndarray
    first: np.ndarray

    def along(self, edge: int) -> np.ndarray:
        """Numbers of the points along an edge: 2 n + 1 for n intervals."""
        return self.numbers[self.first[edge] : self.first[edge + 1]]

    @property
    def segments(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of neighbours on edges, (m, 2), and their edges (m,)."""
        edge = np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))
        same = edge[1:] == edge[:-1]
        return np.column_stack([self.numbers[:-1], self.numbers[1:]])[same], edge[1:][same]


def edge_points(
    outline: Outline, curves: Sequence[SplineCurve | None], intervals: np.ndarray
) -> EdgePoints:
    """Cut the edges of a body.

    Parameters
    ----------
    outline : Outline
    curves : sequence of SplineCurve
        Of its edges.
    intervals : (ne,) int array
        Each of them gets a point in its middle, too.
    """
    used = np.zeros(len(outline.edges), dtype=bool)
    used[outline.edge] = True
    points, numbers = [outline.vertices], []
    first = np.zeros(len(used) + 1, dtype=int)
    count = len(outline.vertices)
    for edge, there in enumerate(used.tolist()):
        first[edge + 1] = first[edge]
        if not there:
            continue
        begin, end = outline.edges[edge].tolist()
        inside = _even(curves[edge], 2 * int(intervals[edge]))
        ends = curves[edge].evaluate(curves[edge].knots[[0, -1]])
        given = outline.vertices[[begin, end]]
        if np.abs(ends - given).max() > np.abs(ends[::-1] - given).max():
            inside = inside[::-1]
        points.append(inside)
        new = count + np.arange(len(inside))
        numbers.append(np.concatenate([[begin], new, [end]]))
        count += len(inside)
        first[edge + 1] += len(inside) + 2
    return EdgePoints(np.concatenate(points), np.concatenate(numbers), first)


def _even(curve: SplineCurve, parts: int) -> np.ndarray:
    """Points inside a curve that cut it into parts of equal length, nearly."""
    lines = bspline.breakpoints(curve.knots)
    each = max(SAMPLES, -(-4 * parts // (len(lines) - 1)))
    share = np.arange(each) / each
    t = np.append((lines[:-1, None] + np.diff(lines)[:, None] * share).ravel(), lines[-1])
    length = np.linalg.norm(np.diff(curve.evaluate(t), axis=0), axis=1)
    length = np.append(0.0, np.cumsum(length))
    return curve.evaluate(np.interp(length[-1] * np.arange(1, parts) / parts, length, t))
