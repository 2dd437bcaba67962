# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Shell and core together: by collocation as in the paper's section 3.4, or after Nitsche.

*Collocation*: u_T(x_i) = sum_j R_j(t_i) alpha_j at every node x_i of the core on the interface.
With C the matrix from the unknowns that are left to those of both spaces, K = C' diag(K_N, K_T) C
is symmetric and positive whenever both are, and needs no parameter.

*Nitsche*, with the flux from the core alone: both keep all unknowns, and

    - int k du_T/dn [v] - int k dv_T/dn [u] + int 2 k C_F [u] [v],   [u] = u_T - u_N

over the interface is added. Linear fields pass exactly where the core fits the shell without gaps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from ..bspline import KNOT_TOLERANCE
from ..recovery import Material
from .assembly import elastic, stiffness
from .samples import FaceSamples
from .simplex_space import SimplexSpace
from .spline_space import SplineSpace

_OFF = 1e-9
"""Distance of a node from the inner surface, over the core's size, that is more than rounding."""


@dataclass(frozen=True)
class CollocationSpace:
    """The shell's splines and the core's polynomials, coupled by collocation.

    Unknowns are those of the shell, and after them the core's nodes off the interface.

    Attributes
    ----------
    spline : SplineSpace
    tets : SimplexSpace
        Of the same dimension d: tets in space, triangles in the plane.
    notes : tuple of str
        What the user should know about how the spaces were made.
    """

    spline: SplineSpace
    tets: SimplexSpace
    notes: tuple[str, ...] = ()

    @cached_property
    def free_nodes(self) -> np.ndarray:
        """Nodes of the core that are unknowns themselves."""
        free = np.ones(self.tets.size, dtype=bool)
        free[self.tets.interface] = False
        return np.flatnonzero(free)

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return self.tets.dimension

    @property
    def size(self) -> int:
        """Number of unknowns (of one component)."""
        return self.spline.size + len(self.free_nodes)

    @cached_property
    def trace(self) -> sparse.csr_matrix:
        """Values R_j(t_i) of the shell's functions at the interface's nodes, (k, n_spline).

        Where a node stands off the inner surface, since tets would be folded, the shell's value
        there is taken by a step along its gradient, so that linear fields pass exactly.
        """
        core = self.tets
        place = core.interface_patch, core.interface_uv, core.interface_w
        beside = self.spline.basis_at(*place)
        step = core.nodes[core.interface] - beside @ self.spline.control_points
        far = np.linalg.norm(step, axis=1) > _OFF * np.ptp(core.nodes, axis=0).max()
        if not far.any():
            return beside
        step[~far] = 0.0
        for way, slope in zip(step.T, self.spline.gradients_at(*place), strict=True):
            beside = beside + sparse.diags(way) @ slope
        return beside.tocsr()

    @cached_property
    def constraint(self) -> sparse.csr_matrix:
        """The matrix C, (n_spline + n_tets, size)."""
        core, count = self.tets, len(self.free_nodes)
        k = len(core.interface)
        follow = sparse.csr_matrix((np.ones(k), (core.interface, np.arange(k))), (core.size, k))
        own = sparse.csr_matrix(
            (np.ones(count), (self.free_nodes, np.arange(count))), (core.size, count)
        )
        identity = sparse.identity(self.spline.size, format="csr")
        return sparse.bmat([[identity, None], [follow @ self.trace, own]], format="csr")

    def conduction(self, outer: float, inner: float) -> sparse.csr_matrix:
        """Stiffness of heat conduction, (size, size).

        Parameters
        ----------
        outer, inner : float
            Conductivity of shell and core.
        """
        both = _apart(outer * stiffness(self.spline), inner * stiffness(self.tets))
        return (self.constraint.T @ both @ self.constraint).tocsr()

    def elasticity(self, outer: Material, inner: Material) -> sparse.csr_matrix:
        """Stiffness of all components, (d size, d size), as :func:`.assembly.elastic` has them.

        Parameters
        ----------
        outer, inner : Material
            Of shell and core.
        """
        constraint = sparse.kron(sparse.identity(self.dimension), self.constraint, format="csr")
        both = _elastic_apart(self.spline, self.tets, outer, inner)
        return (constraint.T @ both @ constraint).tocsr()

    def loaded(self, shell: np.ndarray, core: np.ndarray) -> np.ndarray:
        """A vector of both spaces over the coupled unknowns, C' (shell, core)."""
        return self.constraint.T @ np.concatenate([shell, core])

    def parts(self, solution: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of the shell and values at all nodes of the core, of (size, ...) arrays."""
        both = self.constraint @ solution
        return both[: self.spline.size], both[self.spline.size :]


@dataclass(frozen=True)
class NitscheSpace:
    """The shell's splines and the core's polynomials, each with all their unknowns.

    Unknowns are those of the shell, and after them the nodes of the core.

    Attributes
    ----------
    spline : SplineSpace
    tets : SimplexSpace
        Of the same dimension d: tets in space, triangles in the plane.
    notes : tuple of str
        What the user should know about how the spaces were made.
    """

    spline: SplineSpace
    tets: SimplexSpace
    notes: tuple[str, ...] = ()

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return self.tets.dimension

    @property
    def size(self) -> int:
        """Number of unknowns (of one component)."""
        return self.spline.size + self.tets.size

    @cached_property
    def faces(self) -> FaceSamples:
        """Functions of the core at the interface's quadrature points."""
        return self.tets.face_samples(parts=_spans_across(self.spline, self.tets))

    @cached_property
    def jump(self) -> sparse.csr_matrix:
        """The jump [u] at the interface's quadrature points, (m, size).

        Of a curved interface core and shell have not quite the same points. The shell's value at
        the core's is taken by a step along its gradient, so that no linear field jumps and rigid
        motions have no energy.
        """
        faces = self.faces
        place = faces.patch, faces.uv, faces.w
        beside = self.spline.basis_at(*place)
        step = faces.points - beside @ self.spline.control_points
        for way, slope in zip(step.T, self.spline.gradients_at(*place), strict=True):
            beside = beside + sparse.diags(way) @ slope
        return sparse.hstack([-beside, faces.values], format="csr")

    def of_core(self, matrix: sparse.spmatrix) -> sparse.csr_matrix:
        """A matrix on the core's nodes as one on all unknowns."""
        nothing = sparse.csr_matrix((matrix.shape[0], self.spline.size))
        return sparse.hstack([nothing, matrix], format="csr")

    def _penalty(self, stiff: float) -> sparse.csr_matrix:
        """Integrals of 2 k C_F [u] [v]."""
        weight = sparse.diags(2.0 * stiff * self.faces.measure * self.faces.bound)
        return self.jump.T @ weight @ self.jump

    def conduction(self, outer: float, inner: float) -> sparse.csr_matrix:
        """Stiffness of heat conduction with the terms of the interface, (size, size).

        Parameters
        ----------
        outer, inner : float
            Conductivity of shell and core.
        """
        weight = sparse.diags(inner * self.faces.measure)
        flux = self.jump.T @ weight @ self.of_core(self.faces.slopes)
        both = _apart(outer * stiffness(self.spline), inner * stiffness(self.tets))
        return (both - flux - flux.T + self._penalty(inner)).tocsr()

    def elasticity(self, outer: Material, inner: Material) -> sparse.csr_matrix:
        """Stiffness of all components with the terms of the interface, (d size, d size).

        Parameters
        ----------
        outer, inner : Material
            Of shell and core.
        """
        faces = self.faces
        gradients = [self.of_core(gradient) for gradient in faces.gradients]
        slope = self.of_core(faces.slopes)
        normal = [sparse.diags(n) for n in faces.normal.T]
        tested = self.jump.T @ sparse.diags(faces.measure)
        dims = range(self.dimension)
        blocks = [
            [
                # the traction's component a of the displacement's component b
                tested
                @ (
                    inner.lame * normal[a] @ gradients[b]
                    + inner.shear * normal[b] @ gradients[a]
                    + inner.shear * (a == b) * slope
                )
                for b in dims
            ]
            for a in dims
        ]
        flux = sparse.bmat(blocks, format="csr")
        stiff = self._penalty(inner.lame + 2.0 * inner.shear)
        penalty = sparse.kron(sparse.identity(self.dimension), stiff)
        both = _elastic_apart(self.spline, self.tets, outer, inner)
        return (both - flux - flux.T + penalty).tocsr()

    def loaded(self, shell: np.ndarray, core: np.ndarray) -> np.ndarray:
        """A vector of both spaces."""
        return np.concatenate([shell, core])

    def parts(self, solution: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of the shell and values at all nodes of the core, of (size, ...) arrays."""
        return solution[: self.spline.size], solution[self.spline.size :]


def _spans_across(spline: SplineSpace, tets: SimplexSpace) -> int:
    """Most knot spans that a face of the core reaches over, along one parameter.

    Quadrature over whole faces would miss the knots, where the shell's functions are not smooth: an
    error that hardly falls with h.
    """
    low, high = tets.face_uv.min(axis=1), tets.face_uv.max(axis=1)
    most = 1
    for way in range(low.shape[1]):
        # knots of all patches on one line, each patch apart from the next
        lines = np.concatenate([3.0 * k + breaks[way] for k, breaks in enumerate(spline.breaks)])
        start = 3.0 * tets.face_patch
        first = np.searchsorted(lines, start + low[:, way] + KNOT_TOLERANCE, side="right")
        behind = np.searchsorted(lines, start + high[:, way] - KNOT_TOLERANCE, side="left")
        most = max(most, int((behind - first).max()) + 1)
    return most


def _apart(shell: sparse.spmatrix, core: sparse.spmatrix) -> sparse.csr_matrix:
    """Matrices of both spaces side by side."""
    return sparse.block_diag([shell, core], format="csr")


def _elastic_apart(
    spline: SplineSpace, tets: SimplexSpace, outer: Material, inner: Material
) -> sparse.csr_matrix:
    """Elastic stiffness of both spaces, components first: x of shell and core, then y (then z)."""
    n, m = spline.size, tets.size
    shell = elastic(spline, outer.lame, outer.shear)
    core = elastic(tets, inner.lame, inner.shear)
    return sparse.bmat(
        [
            [
                _apart(
                    shell[a * n : (a + 1) * n, b * n : (b + 1) * n],
                    core[a * m : (a + 1) * m, b * m : (b + 1) * m],
                )
                for b in range(tets.dimension)
            ]
            for a in range(tets.dimension)
        ],
        format="csr",
    )
