# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The closed surface S of a body: untrimmed NURBS patches over shared control points (Eq. 1).

Side numbers of a patch: 0 is u = 0, 1 is u = 1 (both run along v), 2 is v = 0, 3 is v = 1 (both run
along u). ``s_u x s_v`` points out of the material on every patch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import sparse

from . import bspline
from .bezier import bernstein
from .sides import meetings
from .singular import surface_flags

SIDE_DIRECTION = (1, 1, 0, 0)
"""Parameter direction (0 = u, 1 = v) that each side of a patch runs along."""


@dataclass(frozen=True)
class SplineFace:
    """One untrimmed NURBS face as a file gives it.

    Attributes
    ----------
    name : str
        Name of the CAD face, e.g. ``"Face7"``.
    degrees : (int, int)
    knots : (array, array)
        Full clamped knot vectors, any range.
    control_points : (nu, nv, 3) array
        mm.
    weights : (nu, nv) array
        Positive.
    exact : bool
        False where the file's face is used as it is, True where it was converted exactly.
    """

    name: str
    degrees: tuple[int, int]
    knots: tuple[np.ndarray, np.ndarray]
    control_points: np.ndarray
    weights: np.ndarray
    exact: bool = False


@dataclass(frozen=True)
class Patch:
    """A patch s_k(u, v) over global control points.

    Attributes
    ----------
    face : str
        CAD face that it comes from.
    degrees : (int, int)
    knots : (array, array)
        Clamped knot vectors on [0, 1].
    index : (nu, nv) int array
        Numbers of the control points.
    weights : (nu, nv) array
        Positive weights, scaled (one factor a patch) so that all patches that share a control
        point give it the same weight; a polynomial patch has equal weights, 1 where that can be.
    """

    face: str
    degrees: tuple[int, int]
    knots: tuple[np.ndarray, np.ndarray]
    index: np.ndarray
    weights: np.ndarray

    @property
    def rational(self) -> bool:
        """Whether the weights differ."""
        return bool(np.ptp(self.weights) > 0.0)

    @property
    def weighted(self) -> bool:
        """Whether any weight is not 1."""
        return bool((self.weights != 1.0).any())

    def transposed(self) -> Patch:
        """The same patch with u and v exchanged (its normal turned round)."""
        return Patch(self.face, self.degrees[::-1], self.knots[::-1], self.index.T, self.weights.T)


@dataclass(frozen=True)
class ElementGroup:
    """All knot spans of one degree pair, ready for vectorised work.

    Attributes
    ----------
    degrees : (int, int)
    element : (ne,) int array
        Number of each element among all elements of the surface (patch by patch, u then v).
    patch : (ne,) int array
    index : (ne, p + 1, q + 1) int array
        Control points that act on each element.
    weights : (ne, p + 1, q + 1) array
        Their B-spline weights.
    extraction_u, extraction_v : (ne, p + 1, p + 1), (ne, q + 1, q + 1) arrays
    low, high : (ne, 2) arrays
        Corners of the knot span.
    """

    degrees: tuple[int, int]
    element: np.ndarray
    patch: np.ndarray
    index: np.ndarray
    weights: np.ndarray
    extraction_u: np.ndarray
    extraction_v: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def bezier(self, values: np.ndarray) -> np.ndarray:
        """Bézier points of every element of B-spline coefficients given per element.

        Parameters
        ----------
        values : (ne, p + 1, q + 1, ...) array

        Returns
        -------
        array of the same shape
        """
        half = np.einsum("eai,eij...->eaj...", self.extraction_u, values)
        return np.einsum("ebj,eaj...->eab...", self.extraction_v, half)


@dataclass(frozen=True)
class ElementSamples:
    """Samples of every element as matrices on the control points.

    Rows run element by element, within an element over the (u, v) grid. Derivatives are per unit
    of the element's own parameter in [0, 1].

    Attributes
    ----------
    count : int
        Samples of one element.
    values, du, dv : (ne * count, n) sparse matrices
        Polynomial B-spline functions and derivatives.
    weighted, weighted_du, weighted_dv : sparse matrices
        The same, times the weight of each control point.
    weight, weight_du, weight_dv : (ne * count,) arrays
        The weight function and its derivatives.
    """

    count: int
    values: sparse.csr_matrix
    du: sparse.csr_matrix
    dv: sparse.csr_matrix
    weighted: sparse.csr_matrix
    weighted_du: sparse.csr_matrix
    weighted_dv: sparse.csr_matrix
    weight: np.ndarray
    weight_du: np.ndarray
    weight_dv: np.ndarray

    def surface(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rational surface points and both derivatives, three (ne * count, 3) arrays."""
        w = self.weight[:, None]
        x = (self.weighted @ points) / w
        x_u = (self.weighted_du @ points - x * self.weight_du[:, None]) / w
        x_v = (self.weighted_dv @ points - x * self.weight_dv[:, None]) / w
        return x, x_u, x_v


@dataclass(frozen=True)
class SurfaceMesh:
    """A watertight triangulation of the surface over parameter grids that agree along sides.

    Attributes
    ----------
    vertices : (nv, 3) array
    triangles : (nt, 3) int array
        Oriented outward.
    triangle_patch : (nt,) int array
    vertex_patch : (nv,) int array
        The patch with the lowest number that has the vertex.
    vertex_uv : (nv, 2) array
        Its parameters there.
    grids : tuple of (mu, mv) int arrays
        Vertex numbers of each patch.
    grid_u, grid_v : tuples of arrays
        Parameters of the grid lines of each patch.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    triangle_patch: np.ndarray
    vertex_patch: np.ndarray
    vertex_uv: np.ndarray
    grids: tuple[np.ndarray, ...]
    grid_u: tuple[np.ndarray, ...]
    grid_v: tuple[np.ndarray, ...]


def side_of(array: np.ndarray, side: int) -> np.ndarray:
    """Row of a (nu, nv, ...) array that lies on a side of a patch."""
    return (array[0], array[-1], array[:, 0], array[:, -1])[side]


@dataclass(frozen=True)
class PatchSurface:
    """A closed surface of patches.

    Attributes
    ----------
    control_points : (n, 3) array
        The c_l, mm.
    patches : tuple of Patch
    neighbour : (np, 4, 2) int array
        Patch and side that meet each side.
    reversed : (np, 4) bool array
        Whether the neighbour's side runs the other way.
    shell_of_patch : (np,) int array
        0 is the outer shell, the others are cavities.
    moved : (np,) array
        Farthest that welding or an exact conversion moved a control point of the patch, mm.
    exact : (np,) bool array
        True where the patch was converted, elevated or refined (exactly), False: bit for bit.
    """

    control_points: np.ndarray
    patches: tuple[Patch, ...]
    neighbour: np.ndarray
    reversed: np.ndarray
    shell_of_patch: np.ndarray
    moved: np.ndarray = field(default_factory=lambda: np.zeros(0))
    exact: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))

    @property
    def shells(self) -> int:
        """Number of closed surfaces that bound the body."""
        return int(self.shell_of_patch.max()) + 1

    @cached_property
    def diagonal(self) -> float:
        """Diagonal of the control points' bounding box, mm."""
        return float(np.linalg.norm(np.ptp(self.control_points, axis=0)))

    @cached_property
    def genus(self) -> tuple[int, ...]:
        """Genus of each shell, from vertices, sides and patches."""
        found = []
        for shell in range(self.shells):
            members = np.flatnonzero(self.shell_of_patch == shell)
            corners = np.concatenate([self.patches[k].index[::len(self.patches[k].index) - 1,
                                      ::self.patches[k].index.shape[1] - 1].ravel()
                                      for k in members])  # fmt: skip
            euler = len(np.unique(corners)) - 2 * len(members) + len(members)
            found.append((2 - euler) // 2)
        return tuple(found)

    @property
    def rational(self) -> bool:
        """Whether any patch is rational."""
        return any(patch.rational for patch in self.patches)

    @cached_property
    def groups(self) -> tuple[ElementGroup, ...]:
        """The knot spans, one group a degree pair."""
        return _element_groups(self.patches)

    @property
    def element_count(self) -> int:
        """Number of knot spans of all patches."""
        return sum(len(group.element) for group in self.groups)

    @cached_property
    def element_patch(self) -> np.ndarray:
        """Patch of every element, (ne,)."""
        patch = np.zeros(self.element_count, dtype=int)
        for group in self.groups:
            patch[group.element] = group.patch
        return patch

    @cached_property
    def singular_flags(self) -> np.ndarray:
        """Corners and sides of knot spans where the normal is zero, (ne, 3, 3) bool.

        See :func:`HybridVolume.core.singular.singular_flags`.
        """
        return surface_flags(self)

    def with_points(self, control_points: np.ndarray, *, polynomial: bool = False) -> PatchSurface:
        """The same patches over other control points.

        Parameters
        ----------
        control_points : (n, 3) array
        polynomial : bool
            Set all weights to 1.
        """
        patches = self.patches
        if polynomial:
            patches = tuple(
                Patch(p.face, p.degrees, p.knots, p.index, np.ones(p.weights.shape))
                for p in patches
            )
        return PatchSurface(
            control_points,
            patches,
            self.neighbour,
            self.reversed,
            self.shell_of_patch,
            self.moved,
            self.exact,
        )

    def evaluate(
        self, patch: int, u: np.ndarray, v: np.ndarray, derivative: int = 0
    ) -> np.ndarray | tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points of a patch at m parameter pairs.

        Parameters
        ----------
        patch : int
        u, v : (m,) arrays
        derivative : {0, 1}

        Returns
        -------
        (m, 3) array, or with ``derivative=1`` the three arrays x, x_u, x_v
        """
        p = self.patches[patch]
        fu, bu = bspline.basis_functions(p.degrees[0], p.knots[0], np.asarray(u, dtype=float))
        fv, bv = bspline.basis_functions(p.degrees[1], p.knots[1], np.asarray(v, dtype=float))
        iu = fu[:, None] + np.arange(p.degrees[0] + 1)
        iv = fv[:, None] + np.arange(p.degrees[1] + 1)
        pick = (iu[:, :, None], iv[:, None, :])
        weights = p.weights[pick]
        points = self.control_points[p.index[pick]]
        if not p.rational:
            # equal weights cancel: dividing by them would cost the last bits
            weights = np.ones_like(weights)
        homogeneous = np.concatenate([points * weights[..., None], weights[..., None]], axis=-1)

        def combine(left: np.ndarray, right: np.ndarray) -> np.ndarray:
            return np.einsum("ma,mb,mabd->md", left, right, homogeneous)

        value = combine(bu, bv)
        w = value[:, 3:]
        x = value[:, :3] / w if p.rational else value[:, :3]
        if not derivative:
            return x
        _, du = bspline.basis_functions(p.degrees[0], p.knots[0], u, 1)
        _, dv = bspline.basis_functions(p.degrees[1], p.knots[1], v, 1)
        first, second = combine(du, bv), combine(bu, dv)
        return (
            x,
            (first[:, :3] - x * first[:, 3:]) / w,
            (second[:, :3] - x * second[:, 3:]) / w,
        )

    def evaluate_grid(self, patch: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Points of a patch on a tensor grid, (mu, mv, 3)."""
        uu, vv = np.meshgrid(u, v, indexing="ij")
        return self.evaluate(patch, uu.ravel(), vv.ravel()).reshape(len(u), len(v), 3)

    def element_samples(
        self, u: np.ndarray, v: np.ndarray, elements: np.ndarray | None = None
    ) -> ElementSamples:
        """Matrices that sample elements at a tensor grid of their own parameters in [0, 1].

        Parameters
        ----------
        u, v : (mu,), (mv,) arrays
        elements : (ne,) int array, optional
            Which elements, in this order; all by default.
        """
        if elements is None:
            elements = np.arange(self.element_count)
        return _element_samples(self, np.asarray(u, float), np.asarray(v, float), elements)

    def _integrate(self, integrand: Callable) -> np.ndarray:
        """Integral of a function of (x, x_u, x_v) over each element; more points until it stands.

        The first rule is exact for the volume of a polynomial patch.
        """
        first = max(max(g.degrees) for g in self.groups) * 3 // 2 + 2
        total = self._gauss(integrand, first)
        if not self.rational:
            return total
        for points in (16, 24, 36):
            finer = self._gauss(integrand, points)
            settled = np.abs(finer - total).max() <= 1e-13 * np.abs(finer).sum()
            total = finer
            if settled:
                break
        return total

    def _gauss(self, integrand: Callable, points: int) -> np.ndarray:
        x, weight = np.polynomial.legendre.leggauss(points)
        x, weight = 0.5 * (x + 1.0), 0.5 * weight
        samples = self.element_samples(x, x)
        values = integrand(*samples.surface(self.control_points))
        return values.reshape(-1, samples.count) @ np.multiply.outer(weight, weight).ravel()

    def volume(self) -> float:
        """Enclosed volume, mm³, by Gauss points on every knot span (divergence theorem)."""
        centre = self.control_points.mean(axis=0)

        def flux(x: np.ndarray, x_u: np.ndarray, x_v: np.ndarray) -> np.ndarray:
            return np.einsum("mi,mi->m", x - centre, np.cross(x_u, x_v)) / 3.0

        return float(self._integrate(flux).sum())

    def shell_volumes(self) -> np.ndarray:
        """Signed volume of each shell (cavities are negative), mm³."""
        centre = self.control_points.mean(axis=0)
        flux = self._integrate(
            lambda x, xu, xv: np.einsum("mi,mi->m", x - centre, np.cross(xu, xv)) / 3.0
        )
        return np.bincount(self.shell_of_patch[self.element_patch], flux, self.shells)

    def area(self) -> float:
        """Surface area, mm²."""
        return float(
            self._integrate(lambda x, xu, xv: np.linalg.norm(np.cross(xu, xv), axis=1)).sum()
        )

    def shared_grid(self, shapes: list[tuple[int, int]]) -> tuple[list[np.ndarray], int]:
        """Number grid points of all patches so that points on shared sides are one.

        Parameters
        ----------
        shapes : list of (mu, mv)
            Grid of each patch; shapes must agree along shared sides.

        Returns
        -------
        grids : list of (mu, mv) int arrays
        count : int
        """
        sizes = [a * b for a, b in shapes]
        ends = np.cumsum(sizes)
        ids, first = meetings(shapes, self.neighbour, self.reversed).welded(int(ends[-1]))
        grids = [
            ids[end - size : end].reshape(shape)
            for end, size, shape in zip(ends, sizes, shapes, strict=True)
        ]
        return grids, len(first)

    def grid_parameters(self, nodes: int | str) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Grid lines of each patch: ``"greville"``, ``"knots"``, or a number of cells a span."""

        def line(degree: int, knots: np.ndarray) -> np.ndarray:
            if nodes == "greville":
                return bspline.greville(degree, knots)
            values = bspline.breakpoints(knots)
            cells = 1 if nodes == "knots" else int(nodes)
            share = np.arange(cells) / cells
            inner = values[:-1, None] + np.diff(values)[:, None] * share
            return np.append(inner.ravel(), values[-1])

        u = [line(p.degrees[0], p.knots[0]) for p in self.patches]
        v = [line(p.degrees[1], p.knots[1]) for p in self.patches]
        return u, v

    def triangulation(self, nodes: int | str) -> SurfaceMesh:
        """Watertight triangles over shared grids, each quadrilateral cut along its shorter way.

        Parameters
        ----------
        nodes : int or {"greville", "knots"}
            Cells a knot span, or nodes at the Greville abscissae (then vertex l belongs to
            control point l), or at the knots.
        """
        u, v = self.grid_parameters(nodes)
        if nodes == "greville":
            # node l belongs to control point l
            grids = [patch.index for patch in self.patches]
            return self._triangulate(u, v, grids, len(self.control_points))
        return self.triangulation_at(u, v)

    def triangulation_at(self, u: list[np.ndarray], v: list[np.ndarray]) -> SurfaceMesh:
        """Watertight triangles over given grid lines, which must agree along shared sides."""
        grids, count = self.shared_grid([(len(a), len(b)) for a, b in zip(u, v, strict=True)])
        return self._triangulate(u, v, grids, count)

    def _triangulate(
        self, u: list[np.ndarray], v: list[np.ndarray], grids: list[np.ndarray], count: int
    ) -> SurfaceMesh:
        vertices = np.zeros((count, 3))
        owner = np.full(count, -1)
        uv = np.zeros((count, 2))
        for k in range(len(grids) - 1, -1, -1):
            flat = grids[k].ravel()
            uu, vv = np.meshgrid(u[k], v[k], indexing="ij")
            vertices[flat] = self.evaluate(k, uu.ravel(), vv.ravel())
            owner[flat] = k
            uv[flat] = np.column_stack([uu.ravel(), vv.ravel()])
        cells = [
            np.stack([g[:-1, :-1], g[1:, :-1], g[1:, 1:], g[:-1, 1:]], axis=-1).reshape(-1, 4)
            for g in grids
        ]
        patch = np.repeat(np.arange(len(grids)), [len(c) for c in cells])
        quads = np.concatenate(cells)
        x = vertices[quads]
        along = np.linalg.norm(x[:, 2] - x[:, 0], axis=1)
        across = np.linalg.norm(x[:, 3] - x[:, 1], axis=1)
        other = across < along * (1.0 - 1e-9)
        first = np.where(other[:, None], quads[:, [0, 1, 3]], quads[:, [0, 1, 2]])
        second = np.where(other[:, None], quads[:, [1, 2, 3]], quads[:, [0, 2, 3]])
        triangles = np.stack([first, second], axis=1).reshape(-1, 3)
        return SurfaceMesh(
            vertices, triangles, np.repeat(patch, 2), owner, uv, tuple(grids), tuple(u), tuple(v)
        )


def _element_groups(patches: tuple[Patch, ...]) -> tuple[ElementGroup, ...]:
    collected: dict[tuple[int, int], list] = {}
    extracted: dict[tuple, tuple] = {}

    def extraction(degree: int, knots: np.ndarray) -> tuple:
        key = (degree, knots.tobytes())
        if key not in extracted:
            extracted[key] = (*bspline.bezier_extraction(degree, knots), np.unique(knots))
        return extracted[key]

    start = 0
    for k, patch in enumerate(patches):
        p, q = patch.degrees
        fu, cu, bu = extraction(p, patch.knots[0])
        fv, cv, bv = extraction(q, patch.knots[1])
        eu, ev = (a.ravel() for a in np.indices((len(fu), len(fv))))
        rows = fu[eu][:, None, None] + np.arange(p + 1)[:, None]
        columns = fv[ev][:, None, None] + np.arange(q + 1)
        collected.setdefault(patch.degrees, []).append(
            (
                start + np.arange(len(eu)),
                np.full(len(eu), k),
                patch.index[rows, columns],
                patch.weights[rows, columns],
                cu[eu],
                cv[ev],
                np.column_stack([bu[eu], bv[ev]]),
                np.column_stack([bu[eu + 1], bv[ev + 1]]),
            )
        )
        start += len(eu)
    return tuple(
        ElementGroup(degrees, *(np.concatenate(parts) for parts in zip(*rows, strict=True)))
        for degrees, rows in collected.items()
    )


def _subset(group: ElementGroup, place_of: np.ndarray) -> ElementGroup:
    """The elements of a group that have a place, numbered by their places."""
    place = place_of[group.element]
    keep = place >= 0
    parts = (group.patch, group.index, group.weights, group.extraction_u, group.extraction_v)
    return ElementGroup(
        group.degrees, place[keep], *(a[keep] for a in parts), group.low[keep], group.high[keep]
    )


def _element_samples(
    surface: PatchSurface, u: np.ndarray, v: np.ndarray, elements: np.ndarray
) -> ElementSamples:
    ne, n = len(elements), len(surface.control_points)
    count = len(u) * len(v)
    place_of = np.full(surface.element_count, -1)
    place_of[elements] = np.arange(ne)
    groups = [_subset(group, place_of) for group in surface.groups]
    counts = np.zeros(ne, dtype=int)
    for group in groups:
        counts[group.element] = group.index[0].size if len(group.element) else 0
    row_start = np.concatenate([[0], np.cumsum(np.repeat(counts, count))])
    size = row_start[-1]
    columns = np.zeros(size, dtype=np.int64)
    data = {name: np.zeros(size) for name in ("n", "u", "v")}
    factor = np.zeros(size)
    for group in groups:
        if not len(group.element):
            continue
        p, q = group.degrees
        local = (p + 1) * (q + 1)
        lines = {}
        for name, degree, x, c in (
            ("u", p, u, group.extraction_u),
            ("v", q, v, group.extraction_v),
        ):
            lines[name] = np.einsum("mi,eij->emj", bernstein(degree, x), c)
            lines["d" + name] = np.einsum("mi,eij->emj", bernstein(degree, x, 1), c)
        rows = (group.element[:, None] * count + np.arange(count)).ravel()
        place = row_start[rows][:, None] + np.arange(local)
        for name, left, right in (("n", "u", "v"), ("u", "du", "v"), ("v", "u", "dv")):
            values = np.einsum("emi,ekj->emkij", lines[left], lines[right])
            data[name][place] = values.reshape(-1, local)
        shape = (len(group.element), count, local)
        columns[place] = np.broadcast_to(
            group.index.reshape(-1, 1, local), shape
        ).reshape(-1, local)  # fmt: skip
        factor[place] = np.broadcast_to(
            group.weights.reshape(-1, 1, local), shape
        ).reshape(-1, local)  # fmt: skip

    def matrix(values: np.ndarray) -> sparse.csr_matrix:
        return sparse.csr_matrix((values, columns, row_start), shape=(ne * count, n))

    plain = {name: matrix(values) for name, values in data.items()}
    weighted = {name: matrix(values * factor) for name, values in data.items()}
    ones = np.ones(n)
    return ElementSamples(
        count,
        plain["n"],
        plain["u"],
        plain["v"],
        weighted["n"],
        weighted["u"],
        weighted["v"],
        weighted["n"] @ ones,
        weighted["u"] @ ones,
        weighted["v"] @ ones,
    )
