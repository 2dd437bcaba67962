# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The shell of a plane body: NURBS elements between its boundary and an inner curve.

What :class:`.spline_space.SplineSpace` is in space: an unknown belongs to a control point, column l
and layer k, number k n + l, and its function is R = w N / W, which also maps the ring.
:class:`.plane_rim.TriangleRim` stands in its place where a body consists of triangles alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from .. import bspline
from ..bezier import bernstein
from ..elements import gauss_line
from ..jacobian import halving_matrix
from .plane_curve import PlaneCurve
from .samples import BoundarySamples, Samples
from .spline_space import check_faces

_BLOCK = 2_000_000
"""Values of basis functions that are held at once, which bounds the memory."""
_HALVINGS = 5
"""How often an element is halved, both ways, until the sign of det J is given up."""
_ROUNDING = 1e-15
"""Relative error of a sampled determinant: a few units in the last place."""


@dataclass(frozen=True)
class PlaneRing:
    """Spline space over the ring of a plane body.

    Attributes
    ----------
    curve : PlaneCurve
        The outer boundary: w = 0.
    degree_w : int
        Degree through the ring.
    knots_w : array
        Clamped knots through the ring, on [0, 1].
    homogeneous : (nw, n, 3) array
        Control points (w x, w y, w), mm, of layers and columns; layer 0 is the curve's.
    """

    curve: PlaneCurve
    degree_w: int
    knots_w: np.ndarray
    homogeneous: np.ndarray

    @property
    def dimension(self) -> int:
        """2: a ring bounds a body in the plane."""
        return 2

    @property
    def degree(self) -> int:
        """Degree of the boundary's arcs."""
        return self.curve.degree

    @property
    def layers(self) -> int:
        """Number of elements through the ring."""
        return len(bspline.breakpoints(self.knots_w)) - 1

    @property
    def face_names(self) -> tuple[str, ...]:
        """Names of the boundary's arcs."""
        return self.curve.names

    @property
    def patch_faces(self) -> tuple[str, ...]:
        """The same: an arc is a patch."""
        return self.curve.names

    @property
    def breaks(self) -> tuple[tuple[np.ndarray, ...], ...]:
        """Distinct knots of each arc."""
        return tuple((breaks,) for breaks in self.curve.breaks)

    @property
    def columns(self) -> int:
        """Number of columns."""
        return self.homogeneous.shape[1]

    @property
    def size(self) -> int:
        """Number of unknowns (of one component)."""
        return self.homogeneous.shape[0] * self.columns

    @cached_property
    def control_points(self) -> np.ndarray:
        """Control points of all unknowns, (size, 2), mm: coefficients of the map itself."""
        points = self.homogeneous.reshape(-1, 3)
        return points[:, :2] / points[:, 2:]

    @cached_property
    def outer(self) -> np.ndarray:
        """Unknowns whose functions do not vanish on the outer boundary."""
        return np.arange(self.columns)

    @cached_property
    def inner(self) -> np.ndarray:
        """Unknowns whose functions do not vanish on the inner boundary."""
        return np.arange(self.size - self.columns, self.size)

    @cached_property
    def inner_curve(self) -> PlaneCurve:
        """The inner boundary, w = 1, with the same arcs and knots."""
        return replace(self.curve, points=self.homogeneous[-1])

    def samples(self, points: int | None = None) -> Iterator[Samples]:
        """Functions at Gauss points of all elements, a block at a time.

        Parameters
        ----------
        points : int, optional
            Gauss points a direction; by default three more than the highest degree: of rational
            elements products are no polynomials, and constant strains shall pass.
        """
        degrees = self.degree, self.degree_w
        count = points or max(degrees) + 3
        spans = self.curve.spans
        size = int(np.prod([d + 1 for d in degrees])) * count**2 * 3
        first, operators = bspline.bezier_extraction(self.degree_w, self.knots_w)
        blocks = 1 + len(spans.patch) * size // _BLOCK
        for rows in np.array_split(np.arange(len(spans.patch)), blocks):
            for layer in range(self.layers):
                yield self._sampled(rows, layer, int(first[layer]), operators[layer], count)

    def _sampled(
        self, rows: np.ndarray, layer: int, first: int, operator: np.ndarray, count: int
    ) -> Samples:
        """Samples of one layer over some spans."""
        spans = self.curve.spans
        x, weight = gauss_line(count)
        unknowns = self._unknowns(rows, first)
        net = self.homogeneous.reshape(-1, 3)[unknowns]
        heavy, euclidean = net[..., 2], net[..., :2] / net[..., 2:]
        # values and derivatives of w N along u and w at all points
        tables_u = [bernstein(self.degree, x, d) @ spans.extraction[rows] for d in (0, 1)]
        tables_w = [(bernstein(self.degree_w, x, d) @ operator)[None] for d in (0, 1)]
        parts = [
            _product(tables_u[u], tables_w[w]) * heavy[:, None, :]
            for u, w in ((0, 0), (1, 0), (0, 1))
        ]
        total = [part.sum(axis=2)[..., None] for part in parts]
        values = parts[0] / total[0]
        along = np.stack(
            [(part - values * sums) / total[0]
             for part, sums in zip(parts[1:], total[1:], strict=True)], axis=2
        )  # fmt: skip
        jacobian = along @ euclidean[:, None]
        return Samples(
            rows * self.layers + layer,
            unknowns,
            values @ euclidean,
            values,
            np.linalg.inv(jacobian) @ along,
            np.linalg.det(jacobian) * np.outer(weight, weight).ravel(),
        )

    def _unknowns(self, rows: np.ndarray, first: int) -> np.ndarray:
        """Unknowns of elements: columns of each span, first index, and the layers from one on."""
        index = self.curve.spans.index[rows]
        layers = first + np.arange(self.degree_w + 1)
        return (layers * self.columns + index[..., None]).reshape(len(rows), -1)

    def basis_at(self, patch: np.ndarray, uv: np.ndarray, w: np.ndarray) -> sparse.csr_matrix:
        """Functions of all unknowns at m places, (m, size).

        Parameters
        ----------
        patch : (m,) int array
            Arc.
        uv : (m, 1) array
            Parameter on it.
        w : (m,) array
            0 on the outer boundary, 1 on the inner one.
        """
        (values,), unknowns, row = self._at(patch, uv, w, ((0, 0),))
        return self._matrix(values, unknowns, row, len(w))

    def gradients_at(
        self, patch: np.ndarray, uv: np.ndarray, w: np.ndarray
    ) -> tuple[sparse.csr_matrix, ...]:
        """Gradients of all unknowns' functions at m places: two (m, size) matrices, 1/mm.

        Parameters are those of :meth:`basis_at`.
        """
        (values, *slopes), unknowns, row = self._at(patch, uv, w, ((0, 0), (1, 0), (0, 1)))
        # R_u = N_u w / W - R W_u / W
        along = []
        for slope in slopes:
            total = np.bincount(row, slope.sum(axis=1), len(w))[row]
            along.append(slope - values * total[:, None])
        points = self.control_points[unknowns]
        jacobian = np.zeros((len(w), 2, 2))
        for k, part in enumerate(along):
            np.add.at(jacobian[:, k], row, (part[..., None] * points).sum(axis=1))
        inverse = np.linalg.inv(jacobian)[row]
        return tuple(
            self._matrix(
                inverse[:, c, 0, None] * along[0] + inverse[:, c, 1, None] * along[1],
                unknowns,
                row,
                len(w),
            )
            for c in (0, 1)
        )

    def _at(
        self,
        patch: np.ndarray,
        uv: np.ndarray,
        w: np.ndarray,
        derivatives: tuple[tuple[int, int], ...],
    ) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
        """Derivatives of w N, divided by W, at places; unknowns, and the place of each row."""
        u = np.reshape(uv, len(w))
        parts = []
        for order_u, order_w in derivatives:
            along = self.curve.basis(patch, u, order_u)
            first, across = bspline.basis_functions(self.degree_w, self.knots_w, w, order_w)
            row = np.repeat(np.arange(len(w)), np.diff(along.indptr))
            layers = first[row][:, None] + np.arange(self.degree_w + 1)
            unknowns = layers * self.columns + along.indices[:, None]
            heavy = self.homogeneous.reshape(-1, 3)[unknowns, 2]
            parts.append(along.data[:, None] * across[row] * heavy)
            if not (order_u or order_w):
                total = np.bincount(row, parts[-1].sum(axis=1), len(w))[row][:, None]
        return [part / total for part in parts], unknowns, row

    def _matrix(
        self, values: np.ndarray, unknowns: np.ndarray, row: np.ndarray, count: int
    ) -> sparse.csr_matrix:
        """Rows of values on unknowns as a (count, size) matrix."""
        rows = np.broadcast_to(row[:, None], unknowns.shape)
        data = values.ravel(), (rows.ravel(), unknowns.ravel())
        return sparse.csr_matrix(data, shape=(count, self.size))

    def boundary_samples(
        self, faces: Sequence[str] | None = None, points: int | None = None
    ) -> Iterator[BoundarySamples]:
        """Quadrature points on the boundary's arcs.

        Parameters
        ----------
        faces : sequence of str, optional
            Names of arcs, all by default.
        points : int, optional
            Gauss points a span; by default three more than the degree.

        Raises
        ------
        InputError
            There is no such arc.
        """
        spans = self.curve.spans
        chosen = chosen_edges(self.face_names, faces, spans.patch)
        x, weight = gauss_line(points or self.degree + 3)
        length = np.diff(spans.ends[chosen], axis=1)
        u = (spans.ends[chosen][:, :1] + length * x).ravel()
        patch = np.repeat(spans.patch[chosen], len(x))
        basis = self.curve.basis(patch, u)
        weighted = basis @ sparse.diags(self.curve.points[:, 2])
        total = basis @ self.curve.points[:, 2]
        tangent = self.curve.tangents(patch, u)
        speed = np.linalg.norm(tangent, axis=1)
        yield BoundarySamples(
            self.curve.evaluate(patch, u),
            np.column_stack([tangent[:, 1], -tangent[:, 0]]) / speed[:, None],
            (sparse.diags(1.0 / total) @ weighted).tocsr(),
            speed * (length * weight).ravel(),
        )

    def refined(self, parts: int = 2) -> PlaneRing:
        """The same ring, point for point, with all spans cut into parts, along and through it."""
        curve = self.curve.refined(parts)
        along = self.curve.finer(curve.knots)
        lines = bspline.breakpoints(self.knots_w)
        share = np.arange(1, parts) / parts
        new = (lines[:-1, None] + np.diff(lines)[:, None] * share).ravel()
        knots_w = np.sort(np.concatenate([self.knots_w, new]))
        through = bspline.insertion_matrix(self.degree_w, self.knots_w, knots_w)
        net = np.stack([along @ layer for layer in np.tensordot(through, self.homogeneous, 1)])
        # the boundary keeps the bits of its own refinement
        net[0] = curve.points
        return PlaneRing(curve, self.degree_w, knots_w, net)

    @cached_property
    def jacobian_bounds(self) -> np.ndarray:
        """Lower bounds of det J times W³ of each element, (spans, layers), mm².

        With H = (w x, w y, w), det J W³ = det [H, H_u, H_w], a polynomial of degree 3p - 1 along
        both directions: its smallest Bernstein coefficient bounds it. Elements that this does not
        decide are halved a few times.
        """
        p, q = self.degree, self.degree_w
        rows = np.arange(len(self.curve.spans.patch))
        first, operators = bspline.bezier_extraction(q, self.knots_w)
        degrees = 3 * p - 1, 3 * q - 1
        nodes = [0.5 - 0.5 * np.cos(np.pi * np.arange(d + 1) / d) for d in degrees]
        inverse = [np.linalg.inv(bernstein(d, x)) for d, x in zip(degrees, nodes, strict=True)]
        found = np.empty((len(rows), self.layers))
        for layer in range(self.layers):
            net = self.homogeneous.reshape(-1, 3)[self._unknowns(rows, int(first[layer]))]
            tables_u = [bernstein(p, nodes[0], d) @ self.curve.spans.extraction for d in (0, 1)]
            tables_w = [(bernstein(q, nodes[1], d) @ operators[layer])[None] for d in (0, 1)]
            matrix = np.stack(
                [_product(tables_u[u], tables_w[w]) @ net for u, w in ((0, 0), (1, 0), (0, 1))], 2
            )
            # the weight comes last in H and first in det [H, H_u, H_w]: an even permutation
            samples = np.linalg.det(matrix).reshape(len(rows), degrees[0] + 1, degrees[1] + 1)
            # what the roundings of samples and inverses can be at most
            grown = np.abs(inverse[0]).sum(axis=1).max() * np.abs(inverse[1]).sum(axis=1).max()
            rounding = _ROUNDING * grown * np.abs(samples).max(axis=(1, 2))
            found[:, layer] = _smallest(
                inverse[0] @ samples @ inverse[1].T - rounding[:, None, None]
            )
        return found


def _product(u: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Tensor products of two tables (ne or 1, n, m), as (ne, n n', m m')."""
    both = u[:, :, None, :, None] * w[:, None, :, None, :]
    return both.reshape(len(both), u.shape[1] * w.shape[1], -1)


def _smallest(coefficients: np.ndarray) -> np.ndarray:
    """Lower bounds of polynomials with (ne, n, m) Bernstein coefficients, by halving."""
    bound = coefficients.min(axis=(1, 2))
    halves = [halving_matrix(n - 1) for n in coefficients.shape[1:]]
    open_ = np.flatnonzero(bound <= 0.0)
    pieces = coefficients[open_][:, None]
    for _ in range(_HALVINGS):
        if not len(open_):
            break
        n, m = pieces.shape[2:]
        cut = halves[0] @ pieces @ halves[1].T
        pieces = cut.reshape(len(open_), -1, 2, n, 2, m).swapaxes(3, 4).reshape(
            len(open_), -1, n, m
        )  # fmt: skip
        bound[open_] = pieces.min(axis=(1, 2, 3))
        # a corner is a value: where it is not positive nothing can be proved
        corner = pieces[:, :, [0, 0, -1, -1], [0, -1, 0, -1]].min(axis=(1, 2))
        go_on = (bound[open_] <= 0.0) & (corner > 0.0)
        open_, pieces = open_[go_on], pieces[go_on]
    return bound


def chosen_edges(
    names: Sequence[str], faces: Sequence[str] | None, patch: np.ndarray
) -> np.ndarray:
    """Spans or edges on the arcs that are named, all where none is.

    Parameters
    ----------
    names : sequence of str
        Of all arcs.
    faces : sequence of str, optional
    patch : (m,) int array
        Arc of each span or edge.

    Raises
    ------
    InputError
        There is no such arc.
    """
    if faces is None:
        return np.arange(len(patch))
    check_faces(names, faces)
    wanted = [k for k, name in enumerate(names) if name in set(faces)]
    return np.flatnonzero(np.isin(patch, wanted))
