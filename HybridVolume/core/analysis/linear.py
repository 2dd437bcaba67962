# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Sparse symmetric systems with given values: direct, or by conjugate gradients; always checked.

Small systems are factored, columns ordered by minimum degree on A + A' with pivots on the diagonal:
on large bodies a small part of the time and the memory that SuperLU needs where it is not told that
the matrix is symmetric. Larger ones are solved by conjugate gradients, preconditioned by smoothed
aggregation (pyamg) that knows the rigid motions. Where pyamg is not installed all are factored.
"""

from __future__ import annotations

import inspect
import logging
import time
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from ...errors import FaultError, InputError

logger = logging.getLogger(__name__)

RESIDUAL = 1e-8
"""Relative residual up to which a solution is taken."""
CORRECTION = 1e-6
"""Otherwise, of factored systems: what a step of refinement may still change, in the energy's norm.
Residuals of thin plates stay at 1e-7, since rounding of stiff terms alone makes them."""
DIRECT = 100_000
"""Unknowns up to which a system is factored."""
METHODS = ("auto", "direct", "cg")

_CONVERGED = 1e-11
_STEPS = 1000
_COARSE = 1000
"""Unknowns of the coarsest level, which is factored."""


@dataclass(frozen=True)
class Solved:
    """How a linear system was solved.

    Attributes
    ----------
    method : {"direct", "cg"}
    unknowns : int
        Those that are not given, of all components.
    entries : int
        Of the matrix.
    seconds : float
        Time of the processor.
    memory : float
        Of matrix and factors or levels, MB.
    iterations : int
        Of conjugate gradients; 0 for a direct solution.
    residual : float
        Relative to the right side, 2-norm.
    note : str
        What else is to be known, e.g. that pyamg is not installed; may be empty.
    """

    method: str
    unknowns: int
    entries: int
    seconds: float
    memory: float
    iterations: int
    residual: float
    note: str = ""


def factored(matrix: sparse.spmatrix) -> linalg.SuperLU:
    """Factors of a symmetric matrix, such as a stiffness, with few fill-ins.

    Parameters
    ----------
    matrix : (n, n) sparse matrix

    Raises
    ------
    RuntimeError
        It is singular.
    """
    return linalg.splu(
        sparse.csc_matrix(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def solve_fixed(
    matrix: sparse.csr_matrix,
    right: np.ndarray,
    fixed: np.ndarray,
    given: np.ndarray,
    motions: np.ndarray | None = None,
    method: str = "auto",
) -> np.ndarray:
    """Solve for the unknowns that are not given; see :func:`solved`."""
    return solved(matrix, right, fixed, given, motions, method)[0]


def solved(
    matrix: sparse.csr_matrix,
    right: np.ndarray,
    fixed: np.ndarray,
    given: np.ndarray,
    motions: np.ndarray | None = None,
    method: str = "auto",
) -> tuple[np.ndarray, Solved]:
    """Solve for the unknowns that are not given.

    Parameters
    ----------
    matrix : (n, n) sparse matrix
        Symmetric and positive where nothing is given twice.
    right : (n,) array
    fixed : (k,) int array
        Unknowns with given values.
    given : (k,) array
    motions : (m, n) array, optional
        What the matrix makes nothing of: rigid motions, by default constants. Conjugate gradients
        converge in fewer steps when they know it.
    method : {"auto", "direct", "cg"}
        "auto" factors up to `DIRECT` unknowns, and more where pyamg is missing or conjugate
        gradients do not converge.

    Returns
    -------
    values : (n,) array
    figures : Solved

    Raises
    ------
    InputError
        The method is unknown.
    FaultError
        The system was not solved: nothing holds the body, or its elements are degenerate.
    """
    if method not in METHODS:
        raise InputError(f"method {method!r}", remedy=f"choose one of {', '.join(METHODS)}")
    started = time.process_time()
    values = np.zeros(len(right))
    values[fixed] = given
    free = np.setdiff1d(np.arange(len(right)), fixed)
    rest = (right - matrix @ values)[free]
    inside = matrix[free][:, free].tocsr()
    iterations, memory, note, found, changed = 0, 0.0, "", None, np.inf
    if method == "cg" or (method == "auto" and len(free) > DIRECT):
        null = np.ones((1, len(free))) if motions is None else motions[:, free]
        found, iterations, memory, note = _iterated(inside, rest, null)
    way = "direct" if found is None else "cg"
    if found is None:
        found, memory, changed = _factored_solution(inside, rest)
    values[free] = found
    missed = float(np.linalg.norm(inside @ found - rest))
    scale = max(float(np.linalg.norm(rest)), 1e-300)
    if not (missed <= RESIDUAL * scale or changed <= CORRECTION):
        raise FaultError(
            f"the linear system of {len(free)} unknowns was not solved (residual"
            f" {missed / scale:.2g})",
            figure=missed / scale,
            remedy="give values at enough faces that the body cannot move freely",
        )
    figures = Solved(
        way,
        len(free),
        inside.nnz,
        time.process_time() - started,
        memory + _megabytes(inside),
        iterations,
        missed / scale,
        note,
    )
    logger.info("%s", figures)
    return values, figures


def _factored_solution(
    inside: sparse.csr_matrix, rest: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Solution by factors, refined once (nan: there is none), their size in MB, and the change by
    the refinement as a share of the solution, in the energy's norm."""
    if not len(rest):
        return np.zeros(0), 0.0, 0.0
    try:
        factors = factored(inside)
    except RuntimeError:
        return np.full(len(rest), np.nan), 0.0, np.inf
    found = factors.solve(rest)
    # pivots stay on the diagonal, which costs digits that one step of refinement gives back
    change = factors.solve(rest - inside @ found)
    found += change
    energy = float(found @ (inside @ found))
    # of a singular system the refinement changes as much as there is, or has no energy at all
    share = float(change @ (inside @ change)) / energy if energy > 0.0 else np.inf
    changed = float(np.sqrt(share)) if share >= 0.0 else np.inf
    # values, and numbers of rows that supernodes share
    return found, 10.0 * factors.nnz / 1e6, changed


def _iterated(
    inside: sparse.csr_matrix, rest: np.ndarray, null: np.ndarray
) -> tuple[np.ndarray | None, int, float, str]:
    """Solution by conjugate gradients (None: there is none), steps, MB, and what is to be told."""
    try:
        import pyamg
    except ImportError:
        note = "pyamg is not installed, so that the system was factored"
        logger.warning("%s", note)
        return None, 0, 0.0, note
    diagonal = inside.diagonal()
    if not (diagonal > 0.0).all():
        return None, 0, 0.0, "the diagonal is not positive, so that the system was factored"
    # all unknowns get the same weight: functions of thin layers have small ones
    scale = 1.0 / np.sqrt(diagonal)
    scaled = (sparse.diags(scale) @ inside @ sparse.diags(scale)).tocsr()
    # pyamg draws numpy's shared random numbers: the same ones every time, and nobody else's
    state = np.random.get_state()  # noqa: NPY002
    np.random.seed(0)  # noqa: NPY002
    try:
        levels = pyamg.smoothed_aggregation_solver(
            scaled,
            B=(null / scale).T,
            symmetry="symmetric",
            max_coarse=_COARSE,
            coarse_solver="splu",
        )
    finally:
        np.random.set_state(state)  # noqa: NPY002
    steps = 0

    def count(_: np.ndarray) -> None:
        nonlocal steps
        steps += 1

    # the relative tolerance is called tol up to scipy 1.11 and rtol later
    relative = "rtol" if "rtol" in inspect.signature(linalg.cg).parameters else "tol"
    options = {relative: _CONVERGED, "atol": 0.0, "maxiter": _STEPS, "callback": count}
    found, _ = linalg.cg(scaled, scale * rest, M=levels.aspreconditioner(), **options)
    found *= scale
    memory = sum(_megabytes(part) for level in levels.levels for part in _matrices(level))
    reached = np.linalg.norm(inside @ found - rest) <= 0.1 * RESIDUAL * np.linalg.norm(rest)
    if not reached:
        note = f"conjugate gradients did not converge in {steps} steps; the system was factored"
        logger.warning("%s", note)
        return None, steps, memory, note
    return found, steps, memory, ""


def _matrices(level: object) -> list[sparse.spmatrix]:
    """Matrices of a level of pyamg's."""
    return [one for one in (getattr(level, name, None) for name in "APR") if one is not None]


def _megabytes(matrix: sparse.spmatrix) -> float:
    arrays = matrix.data, matrix.indices, matrix.indptr
    return sum(part.nbytes for part in arrays) / 1e6
