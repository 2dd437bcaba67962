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

from .evaluation import Stack, grid_line, grid_points, grid_quads, stacks
from .sides import meetings
from .singular import surface_flags
from .spans import ElementGroup, ElementSamples, element_groups, element_samples

_BLOCK = 50_000
"""Places that are evaluated at once, which bounds the memory."""

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
    turned : (np,) bool array
        True where u and v of the CAD face are exchanged, so that the normal points outward; empty
        where that is not known.
    """

    control_points: np.ndarray
    patches: tuple[Patch, ...]
    neighbour: np.ndarray
    reversed: np.ndarray
    shell_of_patch: np.ndarray
    moved: np.ndarray = field(default_factory=lambda: np.zeros(0))
    exact: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    turned: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))

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

    @cached_property
    def rational(self) -> bool:
        """Whether any patch is rational."""
        return any(patch.rational for patch in self.patches)

    @cached_property
    def groups(self) -> tuple[ElementGroup, ...]:
        """The knot spans, one group a degree pair."""
        return element_groups(self.patches)

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

    def face_parameters(self, patch: int, uv: np.ndarray) -> np.ndarray:
        """Parameters (m, 2) of a patch as those of its CAD face, shares of its ranges in [0, 1]."""
        return uv[:, ::-1] if len(self.turned) and self.turned[patch] else uv

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
        fresh = PatchSurface(
            control_points,
            self._plain_patches if polynomial else self.patches,
            self.neighbour,
            self.reversed,
            self.shell_of_patch,
            self.moved,
            self.exact,
            self.turned,
        )
        if not polynomial or not any(patch.weighted for patch in self.patches):
            # knot spans do not depend on the points
            fresh.__dict__["groups"] = self.groups
        return fresh

    @cached_property
    def _plain_patches(self) -> tuple[Patch, ...]:
        """The patches with weights 1; those that have them are the same objects."""
        return tuple(
            Patch(p.face, p.degrees, p.knots, p.index, np.ones(p.weights.shape))
            if p.weighted
            else p
            for p in self.patches
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
        u, v = np.asarray(u, dtype=float), np.asarray(v, dtype=float)
        return self.evaluate_at(np.full(u.shape, patch), u, v, derivative)

    def evaluate_at(
        self, patch: np.ndarray, u: np.ndarray, v: np.ndarray, derivative: int = 0
    ) -> np.ndarray | tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points of m places on any patches; patches with the same knots are done together.

        Parameters
        ----------
        patch : (m,) int array
        u, v : (m,) arrays
        derivative : {0, 1}

        Returns
        -------
        (m, 3) array, or with ``derivative=1`` the three arrays x, x_u, x_v
        """
        patch = np.asarray(patch, dtype=int)
        stack_of, place = self.stack_of
        found = np.empty((3 if derivative else 1, len(patch), 3))
        numbers = stack_of[patch]
        for number in np.unique(numbers):
            rows = np.flatnonzero(numbers == number)
            for part in np.array_split(rows, 1 + len(rows) // _BLOCK):
                chosen = place[patch[part]]
                found[:, part] = self.stacks[number].evaluate(
                    self.control_points, chosen, u[part], v[part], derivative
                )
        return tuple(found) if derivative else found[0]

    def basis_at(self, patch: np.ndarray, u: np.ndarray, v: np.ndarray) -> sparse.csr_matrix:
        """Polynomial B-splines (weights 1) of all control points at m places, (m, n).

        Parameters
        ----------
        patch : (m,) int array
        u, v : (m,) arrays
        """
        return self.basis_with_slopes(patch, u, v, 0)[0]

    def basis_with_slopes(
        self, patch: np.ndarray, u: np.ndarray, v: np.ndarray, derivative: int = 1
    ) -> list[sparse.csr_matrix]:
        """The same, and with ``derivative=1`` the derivatives along u and along v.

        The matrices store the same entries in the same order, also where they are zero.
        """
        number, place = self.stack_of
        rows, columns, values = [], [], []
        for k, stack in enumerate(self.stacks):
            chosen = np.flatnonzero(number[patch] == k)
            at = place[patch[chosen]], u[chosen], v[chosen]
            pick, pairs = stack.basis(*at, derivative)
            size = pairs[0][0].shape[1] * pairs[0][1].shape[1]
            rows.append(np.repeat(chosen, size))
            columns.append(stack.index[pick].ravel())
            values.append([(a[:, :, None] * b[:, None, :]).ravel() for a, b in pairs])
        shape = (len(patch), len(self.control_points))
        where = np.concatenate(rows), np.concatenate(columns)
        return [
            sparse.csr_matrix((np.concatenate(part), where), shape=shape)
            for part in zip(*values, strict=True)
        ]

    @cached_property
    def stacks(self) -> list[Stack]:
        """Patches with the same degrees and knots, polynomial and rational ones apart."""
        return stacks(self.patches)

    @cached_property
    def stack_of(self) -> tuple[np.ndarray, np.ndarray]:
        """Stack of each patch, and its place in it."""
        number, place = np.zeros((2, len(self.patches)), dtype=int)
        for k, stack in enumerate(self.stacks):
            number[stack.members] = k
            place[stack.members] = np.arange(len(stack.members))
        return number, place

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
        u, v = np.asarray(u, dtype=float), np.asarray(v, dtype=float)
        return element_samples(self.groups, len(self.control_points), u, v, elements)

    def _integrate(self, integrand: Callable, *, settle: bool = True) -> np.ndarray:
        """Integral of a function of (x, x_u, x_v) over each element; more points until it stands.

        The first rule is exact for the volume of a polynomial patch.
        """
        first = max(max(g.degrees) for g in self.groups) * 3 // 2 + 2
        total = self._gauss(integrand, first, np.arange(self.element_count))
        if not (self.rational and settle):
            return total
        waiting = np.arange(self.element_count)
        for points in (16, 24, 36):
            finer = self._gauss(integrand, points, waiting)
            moved = np.abs(finer - total[waiting]) > 1e-14 * np.abs(total).sum()
            total[waiting] = finer
            waiting = waiting[moved]
            if not len(waiting):
                break
        return total

    def _gauss(self, integrand: Callable, points: int, elements: np.ndarray) -> np.ndarray:
        x, weight = np.polynomial.legendre.leggauss(points)
        x, weight = 0.5 * (x + 1.0), 0.5 * weight
        weights = np.multiply.outer(weight, weight).ravel()
        found = []
        # blocks bound the memory, whatever the number of elements
        for block in np.array_split(elements, 1 + len(elements) * points**2 // 400_000):
            samples = self.element_samples(x, x, block)
            values = integrand(*samples.surface(self.control_points))
            found.append(values.reshape(-1, samples.count) @ weights)
        return np.concatenate(found)

    def volume(self) -> float:
        """Enclosed volume, mm³, by Gauss points on every knot span (divergence theorem)."""
        return self._volume

    @cached_property
    def _volume(self) -> float:
        centre = self.control_points.mean(axis=0)

        def flux(x: np.ndarray, x_u: np.ndarray, x_v: np.ndarray) -> np.ndarray:
            return np.einsum("mi,mi->m", x - centre, np.cross(x_u, x_v)) / 3.0

        return float(self._integrate(flux).sum())

    def shell_volumes(self, *, settle: bool = True) -> np.ndarray:
        """Signed volume of each shell (cavities are negative), mm³.

        Parameters
        ----------
        settle : bool
            Rational patches as exactly as others; without it to some digits.
        """
        centre = self.control_points.mean(axis=0)
        flux = self._integrate(
            lambda x, xu, xv: np.einsum("mi,mi->m", x - centre, np.cross(xu, xv)) / 3.0,
            settle=settle,
        )
        return np.bincount(self.shell_of_patch[self.element_patch], flux, self.shells)

    def area(self) -> float:
        """Surface area, mm²."""
        return self._area

    @cached_property
    def _area(self) -> float:
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

        lines: dict[tuple[int, bytes], np.ndarray] = {}

        def line(degree: int, knots: np.ndarray) -> np.ndarray:
            key = (degree, knots.tobytes())
            if key not in lines:
                lines[key] = grid_line(degree, knots, nodes)
            return lines[key]

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
        owner, uv = grid_points(grids, u, v)
        vertices = self.evaluate_at(owner, *uv.T)
        quads = grid_quads(grids)
        x = vertices[quads]
        along = np.linalg.norm(x[:, 2] - x[:, 0], axis=1)
        across = np.linalg.norm(x[:, 3] - x[:, 1], axis=1)
        other = across < along * (1.0 - 1e-9)
        cells = [(grid.shape[0] - 1) * (grid.shape[1] - 1) for grid in grids]
        patch = np.repeat(np.arange(len(grids)), cells)
        first = np.where(other[:, None], quads[:, [0, 1, 3]], quads[:, [0, 1, 2]])
        second = np.where(other[:, None], quads[:, [1, 2, 3]], quads[:, [0, 2, 3]])
        triangles = np.stack([first, second], axis=1).reshape(-1, 3)
        return SurfaceMesh(
            vertices, triangles, np.repeat(patch, 2), owner, uv, tuple(grids), tuple(u), tuple(v)
        )
