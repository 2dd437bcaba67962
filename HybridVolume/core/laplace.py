# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Laplace's equation with linear elements on tetrahedra; the maximum principle is kept."""

from __future__ import annotations

import inspect
import logging

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from ..errors import FaultError
from .tetmesh import TetMesh
from .tetmesh.mesh import EDGES, row_keys

log = logging.getLogger(__name__)

# What w may leave [0, 1] by before it is called wrong.
ROUNDING = 1e-8
# Volume of a flat tetrahedron in cubes of its edges.
FLAT = 1e-9


def hat_gradients(mesh: TetMesh) -> np.ndarray:
    """Gradients of the four linear functions of every tetrahedron, (m, 4, 3), 1/mm."""
    x = mesh.vertices[mesh.tets]
    a, b, c = (x[:, i] - x[:, 0] for i in (1, 2, 3))
    # flat tetrahedra count as a little thicker than they are: nothing is gained from their slopes
    longest = np.max([(v * v).sum(axis=1) for v in (a, b, c)], axis=0) ** 1.5
    six = 6.0 * np.maximum(mesh.volumes, FLAT * longest)[:, None]
    gradients = np.empty((len(mesh), 4, 3))
    gradients[:, 1] = np.cross(b, c) / six
    gradients[:, 2] = np.cross(c, a) / six
    gradients[:, 3] = np.cross(a, b) / six
    gradients[:, 0] = -gradients[:, 1:].sum(axis=1)
    return gradients


class Laplace:
    """Laplace's equation on one mesh, for any set of vertices with w = 1.

    Flat tetrahedra can give positive entries beside the diagonal, and then values beyond the
    boundary values. Edges around such values lose these entries until the principle holds; with
    none of them left it holds for certain.

    Parameters
    ----------
    mesh : TetMesh
    """

    def __init__(self, mesh: TetMesh) -> None:
        self.mesh = mesh
        n = len(mesh.vertices)
        hats = hat_gradients(mesh)
        volume = np.abs(mesh.volumes)[:, None]
        pairs = np.einsum("mei,mei->me", hats[:, EDGES[:, 0]], hats[:, EDGES[:, 1]]) * volume
        keys = row_keys(mesh.tets[:, EDGES].reshape(-1, 2), n)
        of_tet = np.searchsorted(row_keys(mesh.edges, n), keys)
        self._conductance = np.bincount(of_tet, -pairs.ravel(), len(mesh.edges))

    def solve(self, fixed: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
        """Solve with w = 1 at fixed vertices and w = 0 on the boundary, such that 0 <= w <= 1.

        Parameters
        ----------
        fixed : (n,) bool array
            None of them on the boundary.
        start : (n,) array, optional
            A solution for similar fixed vertices.

        Returns
        -------
        (n,) array

        Raises
        ------
        FaultError
            The linear system cannot be solved.
        """
        mesh, edges, n = self.mesh, self.mesh.edges, len(self.mesh.vertices)
        free = np.flatnonzero(~fixed & ~mesh.on_boundary)
        w = fixed.astype(float)
        if not len(free):
            return w
        guess = None if start is None else start[free]
        for attempt in range(20):
            rows = _graph_laplacian(edges, self._conductance, n)[free]
            guess = _solve(rows[:, free], -(rows[:, fixed] @ w[fixed]), guess)
            w[free] = guess
            wrong = (w < -ROUNDING) | (w > 1.0 + ROUNDING)
            if not wrong.any():
                return np.clip(w, 0.0, 1.0)
            log.info(
                "w leaves [0, 1] by %.2g at %d vertices beside flat tetrahedra",
                max(-w.min(), w.max() - 1.0),
                int(wrong.sum()),
            )
            around = wrong[edges].any(axis=1)
            for _ in range(attempt):
                near = np.zeros(n, dtype=bool)
                near[edges[around]] = True
                around = near[edges].any(axis=1)
            self._conductance[around] = np.maximum(self._conductance[around], 0.0)
        raise FaultError("the harmonic function leaves [0, 1]", remedy="refine the surface")


def _graph_laplacian(edges: np.ndarray, conductance: np.ndarray, n: int) -> sparse.csr_matrix:
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    values = np.tile(conductance, 2)
    off = sparse.coo_matrix((-values, (rows, columns)), shape=(n, n)).tocsr()
    return off + sparse.diags(np.bincount(rows, values, n))


def _solve(matrix: sparse.csr_matrix, right: np.ndarray, start: np.ndarray | None) -> np.ndarray:
    """Conjugate gradients, preconditioned by pyamg where it is installed."""
    try:
        import pyamg
    except ImportError:
        diagonal = matrix.diagonal()
        step = LinearOperator(matrix.shape, matvec=lambda x: x / diagonal)
    else:
        # it starts a power iteration with numpy's shared random numbers: the same ones every time,
        # so that the same body gives the same shell, and nobody else's are used up
        state = np.random.get_state()  # noqa: NPY002
        np.random.seed(0)  # noqa: NPY002
        try:
            step = pyamg.smoothed_aggregation_solver(matrix).aspreconditioner()
        finally:
            np.random.set_state(state)  # noqa: NPY002
    scale = float(np.linalg.norm(right))
    # the relative tolerance is called tol up to scipy 1.11 and rtol later
    relative = "rtol" if "rtol" in inspect.signature(cg).parameters else "tol"
    options = {relative: 1e-10, "atol": 0.0, "M": step, "maxiter": 5000, "x0": start}
    solution, failed = cg(matrix, right, **options)
    residual = float(np.linalg.norm(matrix @ solution - right))
    if failed or not residual <= 1e-6 * scale:
        raise FaultError(
            f"the harmonic system did not converge (residual {residual:.2g})", figure=residual
        )
    return solution
