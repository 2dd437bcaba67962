# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Natural frequencies and modes of elastic bodies: K u = omega² M u."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from ...errors import FaultError, InputError
from ..recovery import Material
from .assembly import Space
from .boundary import boundary_projection
from .coupling import CollocationSpace, NitscheSpace
from .hyperelastic import Hyperelastic
from .linear import factored
from .rigid import rigid_motions

RESIDUAL = 1e-6
"""Relative residual from which on a mode is refused."""

_SHIFT = 1e-3
"""Shift that makes a free body's stiffness positive, as a share of the square of the least angular
frequency that its size, stiffness and density let expect."""


@dataclass(frozen=True)
class Modes:
    """Natural modes, the slowest first.

    Attributes
    ----------
    space : CollocationSpace, NitscheSpace or a single space
    frequencies : (n,) array
        Hz; 0 but for rounding for the rigid motions of a body that nothing holds.
    shapes : (n, size, d) array
        Coefficients of the displacements, of unit mass: their squares times the mass matrix are 1,
        so their unit is t^(-1/2).
    """

    space: CollocationSpace | NitscheSpace | Space
    frequencies: np.ndarray
    shapes: np.ndarray

    @property
    def angular(self) -> np.ndarray:
        """Angular frequencies, rad/s, (n,)."""
        return 2.0 * np.pi * self.frequencies


def modal(
    space: CollocationSpace | NitscheSpace | Space,
    materials: Material | Sequence[Material],
    density: float | Sequence[float],
    count: int = 12,
    *,
    fixed: Sequence[str] = (),
) -> Modes:
    """The slowest natural modes.

    Parameters
    ----------
    space : CollocationSpace, NitscheSpace or a single space
    materials : Material or (Material, Material)
        Of the whole body, or of shell and core.
    density : float or (float, float)
        t/mm³
    count : int
        Number of modes, the rigid motions among them: 6 (in the plane 3) of a body that nothing
        holds.
    fixed : sequence of str
        CAD faces that are held.

    Raises
    ------
    InputError
        The count is out of its range, or there is no such face.
    FaultError
        The modes were not found.
    """
    body = Hyperelastic(space, materials, density, law="linear")
    d = body.dimension
    free = np.arange(space.size)
    if len(fixed):
        held, _ = boundary_projection(space.spline, np.zeros_like, fixed)
        free = np.setdiff1d(free, held)
    unknowns = (free + space.size * np.arange(d)[:, None]).ravel()
    if not 1 <= count < len(unknowns) // 2:
        raise InputError(
            f"{count} modes of {len(unknowns)} unknowns",
            remedy=f"ask for 1 to {len(unknowns) // 2 - 1}",
        )
    stiff = body.tangent(np.zeros((space.size, d)))[unknowns][:, unknowns]
    inertia = sparse.kron(sparse.identity(d), body.mass[free][:, free], format="csr")
    shift = _SHIFT * _slowest(body) ** 2
    try:
        factor = factored(stiff + shift * inertia)
    except RuntimeError as fault:
        raise FaultError(
            "the stiffness is singular", remedy="check the hybrid volume's elements"
        ) from fault
    # Lanczos' method may miss some of six equal frequencies: rigid motions are known, and left out
    rigid = np.zeros((len(unknowns), 0))
    if not len(fixed):
        rigid = _rigid(body, inertia, factor.solve)
    weighted = (inertia @ rigid).T

    def elastic(x: np.ndarray) -> np.ndarray:
        return x - rigid @ (weighted @ x)

    inverse = LinearOperator(stiff.shape, matvec=lambda x: elastic(factor.solve(x)), dtype=float)
    # a fixed start, so that the same body has the same modes each time
    start = elastic(np.random.default_rng(1).standard_normal(len(unknowns)))
    rest = max(count - rigid.shape[1], 1)
    try:
        squares, found = eigsh(
            stiff, rest, inertia, sigma=-shift, OPinv=inverse, v0=start, tol=1e-11
        )
    except ArpackNoConvergence as missing:
        raise FaultError(
            f"only {len(missing.eigenvalues)} of {count} modes were found",
            figure=float(len(missing.eigenvalues)),
            remedy="ask for fewer modes",
        ) from missing
    squares = np.concatenate([(rigid * (stiff @ rigid)).sum(axis=0), squares])
    found = np.column_stack([rigid, found])
    order = np.argsort(squares)[:count]
    squares, found = squares[order], found[:, order]
    _check(stiff, inertia, squares, found, shift)
    shapes = np.zeros((count, d, space.size))
    shapes[:, :, free] = found.T.reshape(count, d, -1)
    frequencies = np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi)
    return Modes(space, frequencies, np.ascontiguousarray(np.swapaxes(shapes, 1, 2)))


def _rigid(body: Hyperelastic, inertia: sparse.csr_matrix, solve: Callable) -> np.ndarray:
    """Rigid motions of unit mass, orthogonal by mass, (n, d (d + 1) / 2).

    Those of the matrix, which far off the origin differ by rounding: hence two steps of
    inverse iteration with the shifted stiffness, which ``solve`` inverts.
    """
    motions = rigid_motions(body.reference)
    turns = motions[body.dimension :]
    # as long as translations are, whatever the body's size
    turns /= np.linalg.norm(np.ptp(body.reference, axis=0))
    columns = np.swapaxes(motions, 1, 2).reshape(len(motions), -1).T
    for _ in range(2):
        lower = np.linalg.cholesky(columns.T @ (inertia @ columns))
        columns = solve(inertia @ np.linalg.solve(lower, columns.T).T)
    lower = np.linalg.cholesky(columns.T @ (inertia @ columns))
    return np.linalg.solve(lower, columns.T).T


def _slowest(body: Hyperelastic) -> float:
    """Angular frequency of a shear wave over the body's largest extent, rad/s."""
    size = float(np.linalg.norm(np.ptp(body.reference, axis=0)))
    speed = min(np.sqrt(m.shear / rho) for m, rho in zip(body.materials, body.density, strict=True))
    return 2.0 * np.pi * float(speed) / size


def _check(
    stiff: sparse.csr_matrix,
    inertia: sparse.csr_matrix,
    squares: np.ndarray,
    found: np.ndarray,
    shift: float,
) -> None:
    """Refuse what is no mode, or of a stiffness that is not positive."""
    weighted = inertia @ found
    missed = np.linalg.norm(stiff @ found - weighted * squares, axis=0)
    scale = np.linalg.norm(stiff @ found, axis=0) + shift * np.linalg.norm(weighted, axis=0)
    worst = float((missed / scale).max())
    if not (np.isfinite(squares).all() and worst <= RESIDUAL):
        raise FaultError(
            f"the modes were not found (residual {worst:.2g})",
            figure=worst,
            remedy="check the hybrid volume's elements",
        )
    if squares.min() < -1e-3 * shift:
        raise FaultError(
            f"the stiffness is not positive (square of a frequency {squares.min():.2g} rad²/s²)",
            figure=float(squares.min()),
            remedy="check the hybrid volume's elements",
        )
