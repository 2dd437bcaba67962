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

from ..recovery import Material
from .spline_space import SplineSpace
from .tet_space import TetSpace


def stacked(shell: sparse.spmatrix, core: sparse.spmatrix) -> sparse.csr_matrix:
    """Matrices of three components of two spaces as one, the components of both together.

    Parameters
    ----------
    shell : (3 n, 3 n) sparse matrix
    core : (3 m, 3 m) sparse matrix

    Returns
    -------
    (3 (n + m), 3 (n + m)) sparse matrix
    """
    n, m = shell.shape[0] // 3, core.shape[0] // 3
    shell, core = shell.tocsr(), core.tocsr()
    return sparse.bmat(
        [
            [
                sparse.block_diag(
                    [
                        shell[a * n : (a + 1) * n, b * n : (b + 1) * n],
                        core[a * m : (a + 1) * m, b * m : (b + 1) * m],
                    ]
                )
                for b in range(3)
            ]
            for a in range(3)
        ],
        format="csr",
    )


@dataclass(frozen=True)
class CollocationSpace:
    """The shell's splines and the core's polynomials, coupled by collocation.

    Unknowns are those of the shell, and after them the core's nodes off the interface.

    Attributes
    ----------
    spline : SplineSpace
    tets : TetSpace
    """

    spline: SplineSpace
    tets: TetSpace

    @cached_property
    def free_nodes(self) -> np.ndarray:
        """Nodes of the core that are unknowns themselves."""
        free = np.ones(self.tets.size, dtype=bool)
        free[self.tets.interface] = False
        return np.flatnonzero(free)

    @property
    def size(self) -> int:
        """Number of unknowns (of one component)."""
        return self.spline.size + len(self.free_nodes)

    @cached_property
    def trace(self) -> sparse.csr_matrix:
        """Values R_j(t_i) of the shell's functions at the interface's nodes, (k, n_spline)."""
        core = self.tets
        return self.spline.basis_at(core.interface_patch, core.interface_uv, core.interface_w)

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

    def together(
        self, shell: sparse.spmatrix, core: sparse.spmatrix, conductivity: float = 1.0
    ) -> sparse.csr_matrix:
        """A matrix of both spaces over the coupled unknowns, C' diag(shell, core) C.

        Parameters
        ----------
        shell, core : sparse matrices
        conductivity : float
            Not needed here: nothing is integrated over the interface.
        """
        both = sparse.block_diag([shell, core], format="csr")
        return (self.constraint.T @ both @ self.constraint).tocsr()

    def loaded(self, shell: np.ndarray, core: np.ndarray) -> np.ndarray:
        """A vector of both spaces over the coupled unknowns, C' (shell, core)."""
        return self.constraint.T @ np.concatenate([shell, core])

    def elastic_together(
        self, shell: sparse.spmatrix, core: sparse.spmatrix, material: Material
    ) -> sparse.csr_matrix:
        """A matrix of three components, as :func:`.assembly.elastic` orders them.

        Parameters
        ----------
        shell, core : sparse matrices
        material : Material
            Not needed here: nothing is integrated over the interface.
        """
        both = stacked(shell, core)
        constraint = sparse.kron(sparse.identity(3), self.constraint, format="csr")
        return (constraint.T @ both @ constraint).tocsr()

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
    tets : TetSpace
    """

    spline: SplineSpace
    tets: TetSpace

    @property
    def size(self) -> int:
        """Number of unknowns (of one component)."""
        return self.spline.size + self.tets.size

    def together(
        self, shell: sparse.spmatrix, core: sparse.spmatrix, conductivity: float = 1.0
    ) -> sparse.csr_matrix:
        """Stiffness of both with the terms of the interface.

        Parameters
        ----------
        shell, core : sparse matrices
        conductivity : float
            Of the core.
        """
        faces = self.tets.face_samples()
        beside = self.spline.basis_at(faces.patch, faces.uv, faces.w)
        jump = sparse.hstack([-beside, faces.values], format="csr")
        nothing = sparse.csr_matrix((len(faces.measure), self.spline.size))
        slope = sparse.hstack([nothing, faces.slopes], format="csr")
        weight = sparse.diags(conductivity * faces.measure)
        consistent = slope.T @ weight @ jump
        penalty = jump.T @ sparse.diags(2.0 * conductivity * faces.measure * faces.bound) @ jump
        both = sparse.block_diag([shell, core], format="csr")
        return (both - consistent - consistent.T + penalty).tocsr()

    def elastic_together(
        self, shell: sparse.spmatrix, core: sparse.spmatrix, material: Material
    ) -> sparse.csr_matrix:
        """Stiffness of three components with the terms of the interface.

        Parameters
        ----------
        shell, core : sparse matrices
            As :func:`.assembly.elastic` orders them.
        material : Material
            Of the core.
        """
        faces = self.tets.face_samples()
        beside = self.spline.basis_at(faces.patch, faces.uv, faces.w)
        jump = sparse.hstack([-beside, faces.values], format="csr")
        nothing = sparse.csr_matrix((len(faces.measure), self.spline.size))
        gradients = [sparse.hstack([nothing, g], format="csr") for g in faces.gradients]
        normal = [sparse.diags(n) for n in faces.normal.T]
        slope = sum(n @ g for n, g in zip(normal, gradients, strict=True))
        lame, shear = material.lame, material.shear
        weight = sparse.diags(faces.measure)
        stiff = 2.0 * (lame + 2.0 * shear)
        penalty = jump.T @ sparse.diags(stiff * faces.measure * faces.bound) @ jump
        blocks = [[None] * 3 for _ in range(3)]
        for a in range(3):
            for b in range(3):
                # the traction's component a of the displacement's component b
                traction = lame * normal[a] @ gradients[b] + shear * normal[b] @ gradients[a]
                if a == b:
                    traction = traction + shear * slope
                blocks[a][b] = jump.T @ weight @ traction
        consistent = sparse.bmat(blocks, format="csr")
        return (
            stacked(shell, core)
            - consistent
            - consistent.T
            + sparse.kron(sparse.identity(3), penalty)
        ).tocsr()

    def loaded(self, shell: np.ndarray, core: np.ndarray) -> np.ndarray:
        """A vector of both spaces."""
        return np.concatenate([shell, core])

    def parts(self, solution: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of the shell and values at all nodes of the core."""
        return solution[: self.spline.size], solution[self.spline.size :]
