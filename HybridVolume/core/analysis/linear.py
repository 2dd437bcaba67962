# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Sparse linear systems with given values, solved directly and checked."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from ...errors import FaultError

RESIDUAL = 1e-8
"""Relative residual from which on a solution is refused."""


def solve_fixed(
    matrix: sparse.csr_matrix, right: np.ndarray, fixed: np.ndarray, given: np.ndarray
) -> np.ndarray:
    """Solve for the unknowns that are not given.

    Parameters
    ----------
    matrix : (n, n) sparse matrix
    right : (n,) array
    fixed : (k,) int array
        Unknowns with given values.
    given : (k,) array

    Returns
    -------
    (n,) array

    Raises
    ------
    FaultError
        The system was not solved: nothing holds the body, or its elements are degenerate.
    """
    values = np.zeros(len(right))
    values[fixed] = given
    free = np.setdiff1d(np.arange(len(right)), fixed)
    rest = (right - matrix @ values)[free]
    inside = matrix[free][:, free].tocsc()
    values[free] = spsolve(inside, rest)
    missed = float(np.linalg.norm(inside @ values[free] - rest))
    scale = max(float(np.linalg.norm(rest)), 1e-300)
    if not missed <= RESIDUAL * scale:
        raise FaultError(
            f"the linear system of {len(free)} unknowns was not solved (residual"
            f" {missed / scale:.2g})",
            figure=missed / scale,
            remedy="give values at enough faces that the body cannot move freely",
        )
    return values
