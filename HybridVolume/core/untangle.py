# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Foldover-free optimisation of the columns of a shell.

The energy of the samples (see :mod:`.column_samples`) with a term that holds the inner surface at
its levels. The outer layer is fixed and columns are straight, so the unknowns are the displacements
D of the control points; every derivative of the shell is affine in D, also for rational patches.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from .column_samples import ColumnSamples, column_samples
from .contacts import Planes
from .harmonic import HarmonicField
from .quadrature import lobatto
from .surface import PatchSurface

logger = logging.getLogger(__name__)

ACROSS = np.array([0.0, 0.5, 1.0])
"""Places of the samples in w: on straight columns det J is quadratic in w."""
FLOOR = 0.1
"""Share of the target below which the level counts no longer in the logarithm but as it is."""
STEEP = 3.0
"""What is added to that share where the level rises as usual."""
FINE = np.linspace(0.0, 1.0, 5)
"""Such places in elements that are watched more closely; rational ones are not quadratic."""
REFRESHED = 5
"""Steps after which the preconditioner is made anew."""
SHORT = 0.5
"""Share of its length to which a step is cut from which on the steps before it are forgotten."""
BARRIER = 1e-9
"""Regularisation at which an inverted sample costs so much that no step takes it."""


class ColumnEnergy:
    """Quality of the elements of a shell with straight columns, and its distance from w = w0.

    The unknowns are the displacements of the free control points; elements that none of them
    touches are left out, so that a repair costs what its region costs.

    Parameters
    ----------
    surface : PatchSurface
    base : (n, 3) array
        Feet of the columns, mm.
    field : HarmonicField
    target : (n,) array
        Level that the inner surface should lie on at each Greville point.
    reference : (n,) array
        Thickness expected at each control point, mm.
    degree_w : int
        Degree in w; one Bézier layer.
    nodal : (n, n) sparse matrix
        Polynomial B-splines at the Greville abscissae.
    d : (n, 3) array
        Displacements, mm; those that are not free stay as they are.
    free : (n,) bool array, optional
        Control points that may move; all by default.
    fidelity : float
        Weight of the distance from the target.
    emphasis : (elements,) array, optional
        Weight of each surface element; all are equal otherwise.
    planes : Planes, optional
        Planes that points of the inner surface should stay above.
    """

    def __init__(
        self,
        surface: PatchSurface,
        base: np.ndarray,
        field: HarmonicField,
        target: np.ndarray,
        reference: np.ndarray,
        degree_w: int,
        nodal: sparse.csr_matrix,
        d: np.ndarray,
        *,
        free: np.ndarray | None = None,
        fidelity: float = 0.0,
        emphasis: np.ndarray | None = None,
        planes: Planes | None = None,
    ) -> None:
        self.surface = surface
        self.base = base
        self.field = field
        self.degree_w = degree_w
        self.reference = reference
        self.fidelity = fidelity
        self.planes = planes
        self.eps = BARRIER
        self.d = d.copy()
        self.free = np.arange(len(d)) if free is None else np.flatnonzero(free)
        self.elements = elements_with(surface, self.free)
        touched = np.zeros(len(d))
        touched[self.free] = 1.0
        self.nodes = np.flatnonzero(nodal @ touched > 0)
        # in the logarithm only where the level hardly rises: elsewhere it would draw too much
        slope = np.linalg.norm(field.evaluate(nodal @ (base + d))[1], axis=1)
        usual = max(float(np.median(slope)), 1e-300)
        self.floor = FLOOR + STEEP * (slope[self.nodes] / usual) ** 2
        self.nodal = nodal[self.nodes]
        self.nodal_t = self.nodal.T.tocsr()
        self.target = target[self.nodes]
        self.emphasis = np.ones(surface.element_count) if emphasis is None else emphasis
        self.sets: list[ColumnSamples] = []
        self.shares: list[np.ndarray] = []
        self.near: np.ndarray | None = None
        # as many samples as coefficients: what folds between them is found by the proof
        degree = max(max(patch.degrees) for patch in surface.patches)
        self._watch(self.elements, lobatto(min(max(degree + 1, 4), 8))[0], ACROSS)

    def _watch(self, elements: np.ndarray, uv: np.ndarray, w: np.ndarray) -> None:
        found = column_samples(
            self.surface, self.base, self.reference, self.degree_w, uv, w, elements
        )
        self.sets += found
        # every element counts the same, however many samples it has
        self.shares += [self.emphasis[s.element] / self.surface.element_count for s in found]

    def add_samples(self, elements: np.ndarray, count: int) -> None:
        """Watch some elements at a finer Chebyshev grid as well."""
        if len(elements):
            line = 0.5 - 0.5 * np.cos(np.pi * np.arange(count) / (count - 1))
            self._watch(elements, line, FINE)

    def start(self) -> np.ndarray:
        """The free displacements as the flat vector that the other methods take."""
        return self.d[self.free].ravel()

    def displacements(self, flat: np.ndarray) -> np.ndarray:
        """All displacements for a flat vector of the free ones, (n, 3)."""
        d = self.d.copy()
        d[self.free] = flat.reshape(-1, 3)
        return d

    def level(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Field and gradient at the inner surface's Greville points that can move."""
        points = self.nodal @ (self.base + d)
        # columns move little from one step to the next: look where they were found last
        w, gradient, _, self.near = self.field.evaluate_near(points, self.near)
        return w, gradient

    def _off(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance from the target as a share of it, and its derivative by w.

        Below the target it is logarithmic where the level hardly rises: in an edge of angle a the
        level falls like the distance to the power of pi / a, so that (w - target) would hardly draw
        a point out of a sharp edge.
        """
        low = np.clip(w, 0.0, self.target) + self.floor * self.target
        rate = (1.0 + self.floor) / low
        off = (1.0 + self.floor) * np.log(low / ((1.0 + self.floor) * self.target))
        off += np.minimum(w, 0.0) * rate + np.maximum(w - self.target, 0.0) / self.target
        return off, rate

    def preconditioner(self, flat: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Solver of the energy's curvature at free displacements, and of the pull to w = w0.

        What couples the three coordinates is left out, and both parts act alike on them, so one
        factorisation serves all of them. Samples that are nearly flat are stiff: without that
        their gradients would move everything around.
        """
        n, d = len(self.d), self.displacements(flat)
        rows, columns, values = [], [], []
        for samples, share in zip(self.sets, self.shares, strict=True):
            size = samples.index.shape[1]
            rows.append(np.repeat(samples.index, size, axis=1).ravel())
            columns.append(np.tile(samples.index, (1, size)).ravel())
            values.append(samples.stiffness(d, self.eps, share).ravel())
        matrix = sparse.csr_matrix(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n)
        )
        if self.fidelity > 0.0:
            w, slope = self.level(d)
            steep = np.einsum("li,li->l", slope, slope) * self._off(w)[1] ** 2
            steep *= 2.0 * self.fidelity / n / 3.0
            matrix = matrix + self.nodal_t @ sparse.diags(steep) @ self.nodal
        if self.planes is not None:
            matrix = matrix + self.planes.stiffness()
        matrix = matrix[self.free][:, self.free]
        matrix = matrix + 1e-12 * sparse.diags(matrix.diagonal())
        # positive definite: exchanging rows would only spoil the order and fill the factors
        solve = splu(
            matrix.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        return lambda flat: solve.solve(flat.reshape(-1, 3)).ravel()

    def least_determinant(self, flat: np.ndarray) -> float:
        """Smallest det J relative to the reference over all samples."""
        d = self.displacements(flat)
        return min(float(s.least(d).min()) for s in self.sets)

    def __call__(self, flat: np.ndarray) -> tuple[float, np.ndarray]:
        """Energy and gradient for a flat vector of free displacements."""
        d = self.displacements(flat)
        energy, gradient = 0.0, np.zeros_like(d)
        for samples, share in zip(self.sets, self.shares, strict=True):
            part, pull = samples.evaluate(d, self.eps, share)
            energy += float(part.sum())
            gradient += pull
        if self.fidelity > 0.0:
            w, slope = self.level(d)
            off, rate = self._off(w)
            share = self.fidelity / len(d)
            energy += share * float(off @ off)
            gradient += self.nodal_t @ ((2.0 * share * off * rate)[:, None] * slope)
        if self.planes is not None:
            part, pull = self.planes.energy(self.base + d)
            energy += part
            gradient += pull
        return energy, gradient[self.free].ravel()


def minimise(
    energy: ColumnEnergy,
    start: np.ndarray,
    reach: np.ndarray,
    steps: int,
    tolerance: float = 1e-4,
) -> np.ndarray:
    """Preconditioned L-BFGS whose steps stay shorter than a given reach of every control point.

    Parameters
    ----------
    energy : ColumnEnergy
    start : (3 n,) array
    reach : (n,) array
        Longest way of each control point in one step, mm: a long step could jump over inverted
        states between two samples.
    steps : int
        Most iterations.
    tolerance : float
        Relative decrease over five steps at which to stop.

    Returns
    -------
    (3 n,) array
    """
    x = start.copy()
    value, gradient = energy(x)
    pairs: list[tuple[np.ndarray, np.ndarray, float]] = []
    values = [value]
    for number in range(steps):
        if number % REFRESHED == 0:
            precondition = energy.preconditioner(x)
        direction = -_two_loop(gradient, pairs, precondition)
        slope = float(gradient @ direction)
        if slope >= 0.0:
            pairs.clear()
            direction = -precondition(gradient)
            slope = float(gradient @ direction)
            if slope >= 0.0:
                break
        moves = np.linalg.norm(direction.reshape(-1, 3), axis=1)
        longest = min(1.0, float((reach / np.maximum(moves, 1e-300)).min()))
        length = longest
        for _ in range(25):
            trial = x + length * direction
            new_value, new_gradient = energy(trial)
            if new_value <= value + 1e-4 * length * slope:
                break
            curve = 2.0 * (new_value - value - length * slope)
            best = -slope * length**2 / curve if np.isfinite(curve) and curve > 0 else 0.0
            length = float(np.clip(best, 0.1 * length, 0.5 * length))
        else:
            break
        s, y = trial - x, new_gradient - gradient
        if longest < SHORT:
            # such a step tells little about the curvature along the whole of it
            pairs.clear()
        elif float(s @ y) > 1e-12 * np.linalg.norm(s) * np.linalg.norm(y):
            pairs = [*pairs[-11:], (s, y, 1.0 / float(s @ y))]
        x, value, gradient = trial, new_value, new_gradient
        values.append(value)
        if len(values) > 5 and values[-6] - value <= tolerance * abs(value):
            break
    return x


def _two_loop(
    gradient: np.ndarray,
    pairs: list[tuple[np.ndarray, np.ndarray, float]],
    precondition: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    q = gradient.copy()
    shares = []
    for s, y, rho in reversed(pairs):
        share = rho * float(s @ q)
        shares.append(share)
        q -= share * y
    q = precondition(q)
    for (s, y, rho), share in zip(pairs, reversed(shares), strict=True):
        q += (share - rho * float(y @ q)) * s
    return q


def optimise(
    energy: ColumnEnergy, reach: np.ndarray, *, rounds: int = 10, steps: int = 60
) -> np.ndarray:
    """Untangle and improve: lower the regularisation until no sample is inverted, then polish.

    Parameters
    ----------
    energy : ColumnEnergy
        Its displacements are the start.
    reach : (n,) array
        Longest way of each control point in one step, mm.
    rounds, steps : int
        Most rounds of the regularisation, most iterations in a round.

    Returns
    -------
    (n, 3) array
    """
    flat = energy.start()
    least = energy.least_determinant(flat)
    energy.eps = BARRIER if least > 0 else 1.0
    for _ in range(rounds):
        if least <= 0:
            energy.eps = min(max(0.5 * abs(least), 1e-6), 0.7 * energy.eps)
        flat = minimise(energy, flat, reach[energy.free], steps)
        polished = energy.eps == BARRIER
        least = energy.least_determinant(flat)
        logger.debug("eps %.2g, least determinant %.3g", energy.eps, least)
        if least > 0:
            if polished:
                break
            energy.eps = BARRIER
    return energy.displacements(flat)


def elements_with(surface: PatchSurface, points: np.ndarray) -> np.ndarray:
    """Elements on which any of the given control points acts."""
    chosen = np.zeros(len(surface.control_points), dtype=bool)
    chosen[points] = True
    found = [g.element[chosen[g.index].any(axis=(1, 2))] for g in surface.groups]
    return np.sort(np.concatenate(found))


def points_of(surface: PatchSurface, elements: np.ndarray) -> np.ndarray:
    """Control points that act on any of the given elements."""
    found = [np.unique(g.index[np.isin(g.element, elements)]) for g in surface.groups]
    return np.unique(np.concatenate(found))
