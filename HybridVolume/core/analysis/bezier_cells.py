# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The Bézier elements of a space over the shell: fields as their coefficients, values inside.

Coefficients of splines become coefficients of Bézier elements exactly (extraction, with the weights
of rational elements). What is no spline, such as a stress, is interpolated at the lattice of each
element, ends included, so that its values on a side depend on that side alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from .. import bspline
from ..bezier import bernstein
from .spline_space import SplineSpace

_SAME = 1e-11
"""Control points of neighbours this close, as a share of the body's size, are one point."""
_FLAT = 1e-9
"""A derivative of the map this flat, relative to its size, has no inverse: gradients there are
those beside it."""
_BLOCK = 4_000_000
"""Numbers that are held at once when fields are evaluated, which bounds the memory."""


@dataclass(frozen=True)
class BezierBatch:
    """Bézier elements of one degree in one layer, right-handed: along (v, u, w) of their patches.

    Attributes
    ----------
    degrees : (int, int, int)
    points : (ne, p + 1, q + 1, r + 1, 3) array
        Euclidean control points, mm.
    weights : (ne, p + 1, q + 1, r + 1) array
    element : (ne,) int array
        Number of each element of the space: surface element * layers + layer.
    patch, layer : (ne,) int arrays
    unknowns : (ne, p + 1, q + 1, r + 1) int array
        Unknowns whose functions do not vanish on an element, in the order of the extraction.
    heavy : (ne, p + 1, q + 1, r + 1) array
        Their weights.
    extraction : three arrays (ne or 1, n, n)
        From the unknowns to the Bézier points along each direction.
    """

    degrees: tuple[int, int, int]
    points: np.ndarray
    weights: np.ndarray
    element: np.ndarray
    patch: np.ndarray
    layer: np.ndarray
    unknowns: np.ndarray
    heavy: np.ndarray
    extraction: tuple[np.ndarray, np.ndarray, np.ndarray]

    def __len__(self) -> int:
        return len(self.element)

    def coefficients(self, values: np.ndarray) -> np.ndarray:
        """Bézier coefficients of the spline with coefficients (size, k), (ne, ..., k)."""
        found = _along(self.extraction, values[self.unknowns] * self.heavy[..., None])
        return found / self.weights[..., None]

    def interpolated(self, values: np.ndarray) -> np.ndarray:
        """Bézier coefficients of the field with values (ne, ..., k) at the lattice."""
        lattice = [np.linspace(0.0, 1.0, d + 1) for d in self.degrees]
        tables = [bernstein(d, t) for d, t in zip(self.degrees, lattice, strict=True)]
        total = _along([t[None] for t in tables], self.weights[..., None])
        found = _along([np.linalg.inv(t)[None] for t in tables], values * total)
        return found / self.weights[..., None]

    def at(
        self, rows: np.ndarray, local: np.ndarray, coefficients: np.ndarray, slopes: bool = False
    ) -> tuple[np.ndarray, ...]:
        """Values of a field in elements, (m, k), and its derivatives along (v, u, w), (m, 3, k).

        Parameters
        ----------
        rows : (m,) int array
            Positions in the batch.
        local : (m, 3) array
            Parameters in [0, 1] of the element.
        coefficients : (ne, p + 1, q + 1, r + 1, k) array
        slopes : bool
            Whether the derivatives are wanted.
        """
        weights = self.weights[rows][..., None]
        net = np.concatenate([coefficients[rows] * weights, weights], axis=-1)
        tables = [
            [bernstein(d, t, n) for n in range(1 + slopes)]
            for d, t in zip(self.degrees, local.T, strict=True)
        ]

        def product(a: int, b: int, c: int) -> np.ndarray:
            found = np.einsum("mi,mijkd->mjkd", tables[0][a], net)
            found = np.einsum("mj,mjkd->mkd", tables[1][b], found)
            return np.einsum("mk,mkd->md", tables[2][c], found)

        full = product(0, 0, 0)
        value = full[:, :-1] / full[:, -1:]
        if not slopes:
            return (value,)
        parts = [product(*np.eye(3, dtype=int)[axis]) for axis in range(3)]
        along = [(one[:, :-1] - value * one[:, -1:]) / full[:, -1:] for one in parts]
        return value, np.stack(along, axis=1)

    def on_lattice(
        self, rows: slice, lines: tuple[np.ndarray, ...], coefficients: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Values (ne, ..., k) and derivatives (ne, ..., 3, k) over a lattice of each element.

        Parameters
        ----------
        rows : slice
            Of the batch.
        lines : three arrays
            Parameters along each direction.
        coefficients : (ne, p + 1, q + 1, r + 1, k) array
        """
        weights = self.weights[rows][..., None]
        net = np.concatenate([coefficients[rows] * weights, weights], axis=-1)
        tables = [
            [bernstein(d, t, n)[None] for n in (0, 1)]
            for d, t in zip(self.degrees, lines, strict=True)
        ]
        full = _along([t[0] for t in tables], net)
        value = full[..., :-1] / full[..., -1:]
        slopes = []
        for axis in range(3):
            one = _along([t[int(k == axis)] for k, t in enumerate(tables)], net)
            slopes.append((one[..., :-1] - value * one[..., -1:]) / full[..., -1:])
        return value, np.stack(slopes, axis=-2)


class BezierCells:
    """All Bézier elements of a space over the shell.

    Parameters
    ----------
    spline : SplineSpace

    Attributes
    ----------
    spline : SplineSpace
    batches : list of BezierBatch
    layers : int
        Elements through the thickness.
    batch_of, row_of : (n,) int arrays
        Batch of each element, and its position there.
    low, high : (ns, 2) arrays
        Corners of the knot spans of the surface's elements.
    lines_w : (layers + 1,) array
        Parameters between the layers.
    """

    def __init__(self, spline: SplineSpace) -> None:
        self.spline = spline
        shell = spline.shell
        self.lines_w = bspline.breakpoints(spline.knots_w)
        self.layers = len(self.lines_w) - 1
        self.batches = list(_batches(spline, self.layers))
        count = sum(len(batch) for batch in self.batches)
        self.batch_of, self.row_of = np.empty((2, count), dtype=np.int64)
        for number, batch in enumerate(self.batches):
            self.batch_of[batch.element] = number
            self.row_of[batch.element] = np.arange(len(batch))
        self.low, self.high = np.empty((2, shell.surface.element_count, 2))
        for group in shell.surface.groups:
            self.low[group.element], self.high[group.element] = group.low, group.high

    def __len__(self) -> int:
        return len(self.batch_of)

    def coefficients(self, values: np.ndarray) -> list[np.ndarray]:
        """Bézier coefficients of a spline with coefficients (size, k), one array a batch."""
        return [batch.coefficients(values) for batch in self.batches]

    def lattice_values(
        self, coefficients: list[np.ndarray], function: Callable[..., np.ndarray]
    ) -> list[np.ndarray]:
        """Coefficients of what a function makes of a field and its gradient, see `smoothed`.

        Parameters
        ----------
        coefficients : list of (ne, p + 1, q + 1, r + 1, k) arrays
        function : callable
            Takes values (m, k), and gradients (m, 3, k) in space, and returns (m, j) values.
        """
        found = []
        for batch, part in zip(self.batches, coefficients, strict=True):
            lines = tuple(np.linspace(0.0, 1.0, d + 1) for d in batch.degrees)
            size = int(np.prod([len(t) for t in lines])) * (part.shape[-1] + 4) * 4
            step = max(1, _BLOCK // size)
            values = []
            for first in range(0, len(batch), step):
                rows = slice(first, first + step)
                field = np.concatenate([batch.points, part], axis=-1)
                value, along = batch.on_lattice(rows, lines, field)
                gradient = _gradients(along[..., :3], along[..., 3:])
                k = part.shape[-1]
                one = function(value[..., 3:].reshape(-1, k), gradient.reshape(-1, 3, k))
                values.append(one.reshape(*value.shape[:-1], -1))
            found.append(batch.interpolated(np.concatenate(values)))
        return self.smoothed(found)

    def smoothed(self, coefficients: list[np.ndarray]) -> list[np.ndarray]:
        """Coefficients with the same mean value at control points that elements share."""
        width = coefficients[0].shape[-1]
        flat = np.concatenate([part.reshape(-1, width) for part in coefficients])
        _, label = self.shared
        count = np.bincount(label)
        mean = np.stack([np.bincount(label, column) / count for column in flat.T], axis=-1)[label]
        ends = np.cumsum([part.size // width for part in coefficients])[:-1]
        return [
            rows.reshape(part.shape)
            for rows, part in zip(np.split(mean, ends), coefficients, strict=True)
        ]

    @cached_property
    def shared(self) -> tuple[np.ndarray, np.ndarray]:
        """Control points that are one: the first of each group, and every one's group.

        In the order of the batches. Neighbours compute shared points from the same ones but may
        round differently; points of different weight stay apart.
        """
        points = np.concatenate([batch.points.reshape(-1, 3) for batch in self.batches])
        weights = np.concatenate([batch.weights.ravel() for batch in self.batches])
        size = self.spline.shell.surface.diagonal
        scaled = np.column_stack([(points - points.mean(axis=0)) / size, weights])
        # far off the origin coordinates have fewer digits
        same = max(_SAME, 16.0 * np.finfo(float).eps * float(np.abs(points).max()) / size)
        pairs = cKDTree(scaled).query_pairs(same, output_type="ndarray")
        graph = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
        _, label = sparse.csgraph.connected_components(graph, directed=False)
        _, first = np.unique(label, return_index=True)
        order = np.argsort(first)
        rank = np.empty(len(first), dtype=np.int64)
        rank[order] = np.arange(len(first))
        return first[order], rank[label]

    def element_at(
        self, patch: np.ndarray, uv: np.ndarray, w: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Element of each place, (m,), and the parameters inside, (m, 3).

        Parameters
        ----------
        patch : (m,) int array
        uv : (m, 2) array
            On the surface patch.
        w : (m,) array
            0 on the outer boundary, 1 on the inner one.
        """
        surface = self.spline.shell.surface
        start = np.searchsorted(surface.element_patch, np.arange(len(surface.patches)))
        number = surface.stack_of[0][patch]
        span = np.empty(len(patch), dtype=np.int64)
        for k, stack in enumerate(surface.stacks):
            chosen = np.flatnonzero(number == k)
            lines = [np.unique(knots) for knots in stack.knots]
            i, j = (
                np.clip(np.searchsorted(x, t, side="right") - 1, 0, len(x) - 2)
                for x, t in zip(lines, uv[chosen].T, strict=True)
            )
            span[chosen] = start[patch[chosen]] + i * (len(lines[1]) - 1) + j
        layer = np.clip(np.searchsorted(self.lines_w, w, side="right") - 1, 0, self.layers - 1)
        low, high = self.low[span], self.high[span]
        along = (uv - low) / (high - low)
        across = (w - self.lines_w[layer]) / np.diff(self.lines_w)[layer]
        return span * self.layers + layer, np.column_stack([along[:, ::-1], across])

    def parameters(
        self, element: np.ndarray, local: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Patch, (u, v) on the surface patch and w of places in elements; reverses `element_at`."""
        span, layer = np.divmod(element, self.layers)
        uv = self.low[span] + (self.high - self.low)[span] * local[:, 1::-1]
        w = self.lines_w[layer] + np.diff(self.lines_w)[layer] * local[:, 2]
        return self.spline.shell.surface.element_patch[span], uv, w

    def at(
        self, element: np.ndarray, local: np.ndarray, coefficients: list[np.ndarray]
    ) -> np.ndarray:
        """Values of a field at places in elements, (m, k)."""
        found = np.empty((len(element), coefficients[0].shape[-1]))
        for batch, rows, chosen in self.split(element):
            part = coefficients[batch]
            step = max(1, _BLOCK // (int(np.prod(part.shape[1:])) * 4))
            for first in range(0, len(rows), step):
                some = slice(first, first + step)
                (found[chosen[some]],) = self.batches[batch].at(
                    rows[some], local[chosen[some]], part
                )
        return found

    def split(self, element: np.ndarray) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Batches of elements: number, positions in it, and which of the given ones they are."""
        number = self.batch_of[element]
        for batch in np.unique(number).tolist():
            chosen = np.flatnonzero(number == batch)
            yield batch, self.row_of[element[chosen]], chosen


def _batches(spline: SplineSpace, layers: int) -> Iterator[BezierBatch]:
    """Bézier elements of each degree pair and layer."""
    shell = spline.shell
    net = spline.homogeneous.reshape(-1, 4)
    spans = bspline.bezier_extraction(shell.degree_w, spline.knots_w)
    for group in shell.surface.groups:
        for layer, (first, across) in enumerate(zip(*spans, strict=True)):
            levels = (int(first) + np.arange(shell.degree_w + 1)) * spline.columns
            # right-handed with v first
            unknowns = np.swapaxes(group.index, 1, 2)[..., None] + levels
            extraction = group.extraction_v, group.extraction_u, across[None]
            points = _along(extraction, net[unknowns])
            weights = points[..., 3]
            yield BezierBatch(
                (*group.degrees[::-1], shell.degree_w),
                points[..., :3] / weights[..., None],
                weights,
                group.element * layers + layer,
                group.patch,
                np.full(len(group.patch), layer),
                unknowns,
                net[unknowns, 3],
                extraction,
            )


def _along(tables: tuple[np.ndarray, ...] | list[np.ndarray], net: np.ndarray) -> np.ndarray:
    """Matrices (ne or 1, a, i) of each direction on nets (ne, i, j, k, d)."""
    found = np.einsum("eai,eijkd->eajkd", *_whole(tables[0], net))
    found = np.einsum("ebj,eajkd->eabkd", *_whole(tables[1], found))
    return np.einsum("eck,eabkd->eabcd", *_whole(tables[2], found))


def _whole(table: np.ndarray, net: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.broadcast_to(table, (len(net), *table.shape[1:])), net


def _gradients(jacobian: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Gradients in space, (..., 3, k), of derivatives along the element's directions.

    Where the map is singular itself (given outer boundaries may be), the mean of the rest of its
    element is taken.
    """
    size = np.linalg.norm(jacobian, axis=-1).prod(axis=-1)
    determinant = np.linalg.det(jacobian)
    flat = ~(np.abs(determinant) > _FLAT * size)
    safe = np.where(flat[..., None, None], np.eye(3), jacobian)
    found = np.linalg.solve(safe, along)
    if flat.any():
        good = np.where(flat, 0.0, 1.0)[..., None, None]
        total = np.maximum(good.sum(axis=(1, 2, 3), keepdims=True), 1.0)
        mean = (found * good).sum(axis=(1, 2, 3), keepdims=True) / total
        found = np.where(flat[..., None, None], mean, found)
    return found
