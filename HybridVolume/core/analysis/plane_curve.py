# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Closed NURBS curves in the plane: what bounds a body in two dimensions.

A curve is a row of arcs (its patches, NURBS of one degree), of which each begins where the last one
ends; or one closed spline that is smooth everywhere, whose knots go on periodically. It runs
counterclockwise: the body lies to its left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from ...errors import GapError, InputError
from .. import bspline
from ..elements import gauss_line

GAP = 1e-9
"""Gap between arcs, as a share of the curve's extent, from which on a curve is refused."""


@dataclass(frozen=True)
class Spans:
    """Knot spans of all arcs.

    Attributes
    ----------
    patch : (ne,) int array
        Arc of each span.
    ends : (ne, 2) array
        Parameters between which it lies.
    index : (ne, p + 1) int array
        Columns whose functions do not vanish there.
    extraction : (ne, p + 1, p + 1) array
        Bézier points of the span from the points of these columns.
    """

    patch: np.ndarray
    ends: np.ndarray
    index: np.ndarray
    extraction: np.ndarray


@dataclass(frozen=True)
class PlaneCurve:
    """A closed NURBS curve in the plane, counterclockwise.

    Attributes
    ----------
    degree : int
    knots : tuple of arrays
        Full knot vectors of the arcs on [0, 1]; clamped, but those of a single smooth closed
        spline, which go on periodically beyond both ends.
    points : (n, 3) array
        Control points (w x, w y, w), mm, of all arcs one after another; arcs share their ends.
    names : tuple of str
        Of the arcs, as CAD edges are named: "Edge1" ...
    """

    degree: int
    knots: tuple[np.ndarray, ...]
    points: np.ndarray
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 3 or not np.isfinite(self.points).all():
            raise InputError("control points of a plane curve are (n, 3): w x, w y, w, all finite")
        if not (self.points[:, 2] > 0.0).all():
            raise InputError("a weight of the curve is not positive", remedy="give weights > 0")
        if len(self.points) != self.index[-1].max() + 1:
            raise InputError(f"{len(self.points)} control points do not fit the knots")
        torn = [n for n, k in zip(self.names, self.knots, strict=True)
                if len(bspline.torn_knots(self.degree, k))]  # fmt: skip
        if torn:
            raise InputError("torn at a knot", faces=torn, remedy="make an arc of each piece")
        if not self.area > 0.0:
            raise InputError(
                f"the curve encloses the area {self.area:.3g} mm²",
                figure=self.area,
                remedy="its arcs must run counterclockwise and not cross",
            )

    @property
    def smooth(self) -> bool:
        """Whether it is one closed spline without an end."""
        first = self.knots[0]
        return len(self.knots) == 1 and bool(first[0] < first[self.degree])

    @cached_property
    def index(self) -> tuple[np.ndarray, ...]:
        """Columns of each arc's control points, in order."""
        return _columns(self.degree, self.knots, self.smooth)

    @cached_property
    def spans(self) -> Spans:
        """Knot spans of all arcs, with what makes Bézier segments of them."""
        p = self.degree
        parts = []
        for number, (knots, index) in enumerate(zip(self.knots, self.index, strict=True)):
            inside = bspline.breakpoints(knots[p : len(knots) - p])
            # every break as often as Bézier segments need it: Oslo's matrix is the extraction
            full = np.concatenate([inside[:1], np.repeat(inside, p), inside[-1:]])
            matrix = bspline.insertion_matrix(p, knots, full)
            first = bspline.find_spans(p, knots, 0.5 * (inside[:-1] + inside[1:])) - p
            local = first[:, None] + np.arange(p + 1)
            rows = p * np.arange(len(first))[:, None] + np.arange(p + 1)
            parts.append(
                (
                    np.full(len(first), number),
                    np.column_stack([inside[:-1], inside[1:]]),
                    index[local],
                    matrix[rows[:, :, None], local[:, None, :]],
                )
            )
        return Spans(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    @cached_property
    def breaks(self) -> tuple[np.ndarray, ...]:
        """Distinct knots of each arc, from 0 to 1."""
        p = self.degree
        return tuple(bspline.breakpoints(knots[p : len(knots) - p]) for knots in self.knots)

    @cached_property
    def greville(self) -> tuple[np.ndarray, ...]:
        """Node locations t_l of each arc's columns (paper 3.2), increasing; shared ends once."""
        found = [bspline.greville(self.degree, knots) for knots in self.knots]
        if self.smooth:
            return (np.sort(found[0][: len(self.points)] % 1.0),)
        return tuple(nodes[:-1] for nodes in found)

    def basis(self, patch: np.ndarray, u: np.ndarray, derivative: int = 0) -> sparse.csr_matrix:
        """B-splines (without weights) at m places, (m, n).

        Parameters
        ----------
        patch : (m,) int array
        u : (m,) array
            Parameters in [0, 1].
        derivative : int
        """
        columns = np.empty((len(u), self.degree + 1), dtype=np.int64)
        values = np.empty(columns.shape)
        for number, (knots, index) in enumerate(zip(self.knots, self.index, strict=True)):
            here = np.flatnonzero(patch == number)
            at = u[here] % 1.0 if self.smooth else u[here]
            first, values[here] = bspline.basis_functions(self.degree, knots, at, derivative)
            columns[here] = index[first[:, None] + np.arange(self.degree + 1)]
        rows = np.repeat(np.arange(len(u)), self.degree + 1)
        data = values.ravel(), (rows, columns.ravel())
        return sparse.csr_matrix(data, shape=(len(u), len(self.points)))

    def evaluate(self, patch: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Points on the curve, (m, 2), mm."""
        points = self.basis(patch, u) @ self.points
        return points[:, :2] / points[:, 2:]

    def tangents(self, patch: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Derivatives along the parameter, (m, 2), mm."""
        points = self.basis(patch, u) @ self.points
        slopes = self.basis(patch, u, 1) @ self.points
        return (slopes[:, :2] - points[:, :2] / points[:, 2:] * slopes[:, 2:]) / points[:, 2:]

    @cached_property
    def area(self) -> float:
        """Area that it encloses, mm²; negative where it runs clockwise."""
        spans = self.spans
        x, weight = gauss_line(2 * self.degree + 6)
        length = np.diff(spans.ends, axis=1)
        u = (spans.ends[:, :1] + length * x).ravel()
        patch = np.repeat(spans.patch, len(x))
        at, along = self.evaluate(patch, u), self.tangents(patch, u)
        turned = at[:, 0] * along[:, 1] - at[:, 1] * along[:, 0]
        return float(0.5 * turned @ (length * weight).ravel())

    def finer(self, new_knots: Sequence[np.ndarray]) -> sparse.csr_matrix:
        """Matrix from the control points to those over finer knots, exactly, (m, n).

        Parameters
        ----------
        new_knots : sequence of arrays
            Full knot vectors of the arcs, each with all knots that it had.
        """
        index = _columns(self.degree, tuple(new_knots), self.smooth)
        fresh = np.concatenate(index)
        total = int(fresh.max()) + 1
        # columns that stand twice, at the ends, are the same either way
        taken = np.zeros(len(fresh), dtype=bool)
        taken[np.unique(fresh, return_index=True)[1]] = True
        parts = np.split(taken, np.cumsum([len(part) for part in index])[:-1])
        rows, columns, values = [], [], []
        for old, new, there, mine, keep in zip(
            self.knots, new_knots, self.index, index, parts, strict=True
        ):
            matrix = bspline.insertion_matrix(self.degree, old, new)[keep]
            row, column = np.nonzero(matrix)
            rows.append(mine[keep][row])
            columns.append(there[column])
            values.append(matrix[row, column])
        place = np.concatenate(rows), np.concatenate(columns)
        shape = (total, len(self.points))
        return sparse.csr_matrix((np.concatenate(values), place), shape=shape)

    def split_knots(self, parts: int) -> tuple[np.ndarray, ...]:
        """Knot vectors with every span cut into equal parts."""
        found = []
        for knots in self.knots:
            lines = bspline.breakpoints(knots)
            share = np.arange(1, parts) / parts
            new = (lines[:-1, None] + np.diff(lines)[:, None] * share).ravel()
            knots = np.sort(np.concatenate([knots, new]))
            if self.smooth:
                # beyond the ends as many knots are needed as before
                low = np.searchsorted(knots, 0.0, side="right") - 1
                high = np.searchsorted(knots, 1.0, side="left")
                knots = knots[low - self.degree : high + self.degree + 1]
            found.append(knots)
        return tuple(found)

    def refined(self, parts: int = 2) -> PlaneCurve:
        """The same curve with every knot span cut into equal parts."""
        if parts == 1:
            return self
        knots = self.split_knots(parts)
        return PlaneCurve(self.degree, knots, self.finer(knots) @ self.points, self.names)

    def elevated(self, degree: int) -> PlaneCurve:
        """The same curve of a higher degree; functions stay as smooth at the knots as they were.

        Raises
        ------
        InputError
            The degree is lower, or the curve is one smooth closed spline.
        """
        times = degree - self.degree
        if times == 0:
            return self
        if times < 0 or self.smooth:
            raise InputError(
                f"a curve of degree {self.degree} cannot get degree {degree}",
                remedy="make it of the degree that is wanted",
            )
        knots, points = [], []
        for old, index in zip(self.knots, self.index, strict=True):
            matrix, new = bspline.elevation_matrix(self.degree, old, times)
            knots.append(new)
            points.append((matrix @ self.points[index])[:-1])
        return PlaneCurve(degree, tuple(knots), np.concatenate(points), self.names)


def _columns(degree: int, knots: tuple[np.ndarray, ...], smooth: bool) -> tuple[np.ndarray, ...]:
    """Numbers of each arc's control points, where arcs share their ends."""
    counts = [len(one) - degree - 1 for one in knots]
    total = sum(counts) - (degree if smooth else len(counts))
    starts = np.cumsum([0, *(count - 1 for count in counts[:-1])])
    return tuple((start + np.arange(n)) % total for start, n in zip(starts, counts, strict=True))


def joined(
    arcs: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], names: Sequence[str] | None = None
) -> PlaneCurve:
    """A closed curve of NURBS arcs, each of which begins where the last one ends.

    Parameters
    ----------
    arcs : sequence of (control points, weights, knots)
        (n, 2) points, mm, (n,) weights and the full clamped knot vector on [0, 1], for each arc in
        order, counterclockwise. Degrees may differ: lower ones are raised exactly.
    names : sequence of str, optional
        "Edge1", "Edge2" ... by default.

    Raises
    ------
    GapError
        Two arcs do not meet.
    InputError
        The curve does not run counterclockwise around an area, or an arc is no NURBS arc.
    """
    names = tuple(names or (f"Edge{k + 1}" for k in range(len(arcs))))
    degrees = [len(knots) - len(points) - 1 for points, _, knots in arcs]
    degree = max(degrees)
    nets, vectors = [], []
    for (points, weights, knots), own, name in zip(arcs, degrees, names, strict=True):
        knots = np.asarray(knots, dtype=float)
        ends = np.repeat([0.0, 1.0], own + 1)
        if own < 1 or not np.array_equal(np.r_[knots[: own + 1], knots[-own - 1 :]], ends):
            raise InputError("the knots are not clamped on [0, 1]", faces=[name])
        matrix, raised = bspline.elevation_matrix(own, knots, degree - own)
        weights = np.asarray(weights, dtype=float)[:, None]
        nets.append(matrix @ np.hstack([np.asarray(points, dtype=float) * weights, weights]))
        vectors.append(raised)
    everything = np.concatenate(nets)
    extent = float(np.ptp(everything[:, :2] / everything[:, 2:], axis=0).max())
    # arcs are the same with all weights times a number: the first one's end decides
    for k in range(1, len(nets)):
        nets[k] *= nets[k - 1][-1, 2] / nets[k][0, 2]
    for k, net in enumerate(nets):
        end, start = net[-1], nets[(k + 1) % len(nets)][0]
        gap = float(np.linalg.norm(end[:2] / end[2] - start[:2] / start[2]))
        if gap > GAP * extent:
            raise GapError(
                f"a gap of {gap:.3g} mm",
                faces=[names[k], names[(k + 1) % len(nets)]],
                figure=gap,
                remedy="arcs must follow each other and close",
            )
    if abs(nets[-1][-1, 2] - nets[0][0, 2]) > GAP * nets[0][0, 2]:
        raise InputError(
            "the weights do not close around the curve",
            remedy="give arcs whose end weights are 1",
        )
    return PlaneCurve(degree, tuple(vectors), np.concatenate([net[:-1] for net in nets]), names)


def ellipse(
    radii: tuple[float, float] = (1.0, 1.0), centre: tuple[float, float] = (0.0, 0.0)
) -> PlaneCurve:
    """An ellipse of four rational quadratic arcs; a circle where both radii, mm, are the same."""
    around = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]])
    points = around * np.asarray(radii, dtype=float) + centre
    weights = np.array([1.0, np.sqrt(0.5), 1.0])
    knots = bspline.clamped_knots(2, 1)
    return joined([(points[[k, k + 1, (k + 2) % 8]], weights, knots) for k in (0, 2, 4, 6)])


def closed_spline(points: np.ndarray, degree: int = 3) -> PlaneCurve:
    """A closed uniform B-spline that is C^(degree - 1) everywhere.

    Parameters
    ----------
    points : (n, 2) array
        Control points, mm, counterclockwise; more than ``degree``.
    degree : int

    Raises
    ------
    InputError
        There are too few control points, or the curve encloses no area counterclockwise.
    """
    points = np.asarray(points, dtype=float)
    count = len(points)
    if count <= degree:
        raise InputError(
            f"{count} control points for a closed curve of degree {degree}",
            remedy=f"give {degree + 1} or more",
        )
    knots = np.arange(-degree, count + degree + 1) / count
    net = np.hstack([points, np.ones((count, 1))])
    return PlaneCurve(degree, (knots,), net, ("Edge1",))
