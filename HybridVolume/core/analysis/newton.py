# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Newton's method with a line search, for minima of potentials and for balances of forces, and its
linear systems."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy import sparse

from .linear import factored

_STEPS = 60
"""Of Newton's method."""
_HALVINGS = 14
"""Of one step of Newton's method."""
_SHORTEST = 2.0**-8
"""Share of a step that is still tried where there is no potential."""
_FAST = 0.25
"""Share of the forces that may be left after a step for its tangent to be used again."""
_DECREASE = 1e-4
"""Share of the decrease along the slope that a step has to reach (Armijo)."""
_ROUNDING = 1e-13
"""Of sums over all elements, relative."""
_DIRECT = {2: 6000, 3: 600}
"""Unknowns up to which systems are factorised each time, by the dimension."""
_LINEAR, _ROUGH = 1e-4, 3e-3
"""Residual of a linear system that is left, relative; and where a tangent of earlier serves."""
_ROUNDS = 200
"""Of conjugate gradients."""


class Potential(Protocol):
    """What can be minimised over (n, d) arrays."""

    def value(self, u: np.ndarray) -> tuple[float, float]:
        """The potential, and the sum of the sizes of its terms."""

    def slope(self, u: np.ndarray) -> tuple[np.ndarray, float]:
        """Its derivative, and the largest norm of the derivative's terms."""

    def tangent(self, u: np.ndarray, projected: bool) -> sparse.csr_matrix:
        """Its second derivative, or a positive matrix that is near it."""


class Balance(Protocol):
    """Forces over (n, d) arrays that have to vanish, and are no potential's."""

    def slope(self, u: np.ndarray) -> tuple[np.ndarray, float]:
        """The forces, and the largest norm of their terms."""

    def tangent(self, u: np.ndarray, projected: bool) -> sparse.csr_matrix:
        """A symmetric matrix near their derivative, or a positive one."""


class Stalled(Exception):
    """No minimum was found.

    Attributes
    ----------
    residual : float
        Relative, what is left.
    """

    def __init__(self, residual: float) -> None:
        super().__init__(f"Newton's method stalls at a residual of {residual:.2g}")
        self.residual = residual


class Increments:
    """Linear systems of Newton's method: direct, or conjugate gradients for many unknowns.

    The preconditioner is the factorised matrix of a single component, used for each: it costs a
    small part of the whole one's, and it stays good where the body turns. A tangent may be kept for
    the next systems, also those of the next step in time.

    Parameters
    ----------
    near : (n, n) sparse matrix
        The scalar matrix.
    free : (k,) int array
        Unknowns that are not held.
    dimension : int
        Components of an unknown.
    """

    def __init__(self, near: sparse.csr_matrix, free: np.ndarray, dimension: int) -> None:
        self.dimension = dimension
        self.kept: sparse.csr_matrix | None = None
        count = near.shape[0]
        self.free = (free + count * np.arange(dimension)[:, None]).ravel()
        self.diagonal = near.diagonal()
        self._near = near[free][:, free].tocsc()
        self._factor = None

    def solve(
        self, matrix: sparse.csr_matrix, right: np.ndarray, left: float = _LINEAR
    ) -> tuple[np.ndarray, bool]:
        """A step (n, d) against a slope (n, d), and whether the matrix was found positive.

        Conjugate gradients leave a residual of ``left``, relative.
        """
        step = np.zeros(right.T.size)
        inside = matrix if len(self.free) == len(step) else matrix[self.free][:, self.free]
        wanted = right.T.ravel()[self.free]
        if len(self.free) <= _DIRECT[self.dimension]:
            try:
                found = factored(inside).solve(wanted)
            except RuntimeError:  # singular
                found = wanted
            positive = bool(np.isfinite(found).all() and found @ wanted > 0.0)
        else:
            found, positive = self._conjugate(inside, wanted, left)
        step[self.free] = found
        return step.reshape(right.T.shape).T, positive

    def _precondition(self, residual: np.ndarray) -> np.ndarray:
        if self._factor is None:
            self._factor = factored(self._near)
        parts = residual.reshape(self.dimension, -1).T
        return np.ascontiguousarray(self._factor.solve(np.ascontiguousarray(parts)).T).ravel()

    def _conjugate(
        self, matrix: sparse.csr_matrix, right: np.ndarray, left: float
    ) -> tuple[np.ndarray, bool]:
        """Conjugate gradients, which end where the matrix is not positive."""
        found = np.zeros_like(right)
        residual = right.copy()
        along = seen = self._precondition(residual)
        energy = residual @ seen
        enough = left * np.linalg.norm(right)
        for _ in range(_ROUNDS):
            pushed = matrix @ along
            bend = along @ pushed
            if not bend > 0.0:
                return (found if found.any() else seen), False
            step = energy / bend
            found = found + step * along
            residual = residual - step * pushed
            if np.linalg.norm(residual) <= enough:
                break
            seen = self._precondition(residual)
            energy, last = residual @ seen, energy
            along = seen + energy / last * along
        return found, True


def minimum(
    potential: Potential,
    start: np.ndarray,
    increments: Increments,
    free: np.ndarray,
    tolerance: float,
) -> tuple[np.ndarray, int]:
    """The minimum of a potential near a start, and the number of Newton's steps.

    Parameters
    ----------
    potential : Potential
    start : (n, d) array
        Also has the values that are held.
    increments : Increments
    free : (k,) int array
        Unknowns that are not held.
    tolerance : float
        Norm of the slope that is left, as a share of the largest of its terms.

    Raises
    ------
    Stalled
        There is none to be found from here.
    """
    u = start
    value, size = potential.value(u)
    projected = False
    residual = np.inf
    for iteration in range(_STEPS):
        slope, scale = potential.slope(u)
        held = np.zeros_like(slope)
        held[free] = slope[free]
        left = float(np.linalg.norm(held))
        if not np.isfinite(left):
            break
        residual = left / max(scale, 1e-300)
        if left <= tolerance * scale:
            return u, iteration
        step, positive = increments.solve(potential.tangent(u, projected), -held)
        if not positive and not projected:
            projected = True
            step, positive = increments.solve(potential.tangent(u, True), -held)
        decrease = -float((held * step).sum())
        # what is left is rounding of the sums: no step can be told from none
        if 0.0 < decrease <= _ROUNDING * size:
            after = u + step
            if np.linalg.norm(potential.slope(after)[0][free]) <= left:
                u = after
            return u, iteration + 1
        found = _line(potential, u, step, value, decrease, size) if decrease > 0.0 else None
        if found is None:
            if projected:
                break
            projected = True
            continue
        u, value, size, length = found
        # back to the tangent itself as soon as whole steps are taken
        projected = projected and length < 1.0
    raise Stalled(residual)


def balanced(
    forces: Balance,
    start: np.ndarray,
    increments: Increments,
    free: np.ndarray,
    tolerance: float,
) -> tuple[np.ndarray, int]:
    """Where forces vanish near a start; parameters, result and errors are those of `minimum`."""

    def at(u: np.ndarray) -> tuple[np.ndarray, float, float]:
        slope, scale = forces.slope(u)
        held = np.zeros_like(slope)
        held[free] = slope[free]
        return held, float(np.linalg.norm(held)), scale

    u = start
    held, left, scale = at(u)
    projected = fresh = False
    for iteration in range(_STEPS):
        if left <= tolerance * scale:
            return u, iteration
        if increments.kept is None:
            increments.kept = forces.tangent(u, projected)
            fresh = True
        step, positive = increments.solve(increments.kept, -held, _ROUGH)
        length = 1.0 if positive else 0.0
        # a tangent of earlier takes whole steps or none
        while length >= (_SHORTEST if fresh else 1.0):
            after = at(u + length * step)
            if after[1] <= (1.0 - _DECREASE * length) * left:
                break
            length *= 0.5
        good = length == 1.0 and after[1] <= _FAST * left
        if not good:
            increments.kept = None
        if length < (_SHORTEST if fresh else 1.0):
            if fresh and projected:
                break
            projected, fresh = fresh, False
            continue
        u, (held, left, scale) = u + length * step, after
        projected = projected and length < 1.0
        fresh = False
    increments.kept = None
    raise Stalled(left / max(scale, 1e-300))


def _line(
    potential: Potential,
    u: np.ndarray,
    step: np.ndarray,
    value: float,
    decrease: float,
    size: float,
) -> tuple[np.ndarray, float, float, float] | None:
    """The first of ever shorter steps that lowers the potential enough."""
    length = 1.0
    for _ in range(_HALVINGS):
        after = u + length * step
        lower, scale = potential.value(after)
        if lower <= value - _DECREASE * length * decrease + _ROUNDING * max(size, scale):
            return after, lower, scale, length
        length *= 0.5
    return None
