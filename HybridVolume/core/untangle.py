# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Foldover-free optimisation of the columns of a shell.

Energy of Garanzha, Kaporin, Kudryavtseva, Protais, Ray and Sokolov, "Foldover-free maps in 50 lines
of code" (ACM TOG 2021), with a term that holds the inner surface at the level w = w0. The outer
layer is fixed and columns are straight, so the unknowns are the displacements D of the control
points; every derivative of the shell is affine in D, also for rational patches.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from .bezier import bernstein
from .harmonic import HarmonicField
from .quadrature import lobatto
from .singular import beside_singular, vanishing_normals
from .surface import PatchSurface

logger = logging.getLogger(__name__)

ACROSS = np.array([0.0, 0.5, 1.0])
"""Places of the samples in w: on straight columns det J is quadratic in w."""
AREA_SHARE = 0.05
"""Weight of the volume term; without it cells shrink to nothing."""
BARRIER = 1e-9
"""Regularisation at which an inverted sample costs so much that no step takes it."""


@dataclass(frozen=True)
class _SampleSet:
    """A = J S^-1 at samples (rows r) times w levels l, as affine functions of D.

    Arrays run over the rows last, so that every operation is one long loop in numpy. Column k of
    A is ``constant[l, k] + scale[l] P_k + cross[l, k] N D`` with
    ``P_k = inverse[v, k] N_v D + inverse[u, k] N_u D``.
    """

    values: sparse.csr_matrix
    du: sparse.csr_matrix
    dv: sparse.csr_matrix
    values_t: sparse.csr_matrix
    du_t: sparse.csr_matrix
    dv_t: sparse.csr_matrix
    constant: np.ndarray  # (levels, 3, 3, rows): column k, coordinate i
    scale: np.ndarray  # (levels, rows)
    cross: np.ndarray  # (levels, 3, rows)
    inverse: np.ndarray  # (3, 3, rows): inverse of the reference frame (v, u, w)

    def columns(self, d: np.ndarray) -> np.ndarray:
        """A at all samples, (levels, 3 columns, 3, rows)."""
        value = np.ascontiguousarray((self.values @ d).T)
        value_u = np.ascontiguousarray((self.du @ d).T)
        value_v = np.ascontiguousarray((self.dv @ d).T)
        plane = self.inverse[0][:, None] * value_v + self.inverse[1][:, None] * value_u
        out = self.scale[:, None, None] * plane
        out += self.constant
        out += self.cross[:, :, None] * value
        return out

    def pull_back(self, gradient: np.ndarray) -> np.ndarray:
        """Transpose of :meth:`columns`, (n, 3)."""
        plane = (self.scale[:, None, None] * gradient).sum(axis=0)
        on = (self.cross[:, :, None] * gradient).sum(axis=(0, 1))
        on_v = (self.inverse[0][:, None] * plane).sum(axis=0)
        on_u = (self.inverse[1][:, None] * plane).sum(axis=0)
        return self.values_t @ on.T + self.du_t @ on_u.T + self.dv_t @ on_v.T


def _sample_set(
    surface: PatchSurface,
    reference: np.ndarray,
    degree_w: int,
    uv: np.ndarray,
    w: np.ndarray,
    elements: np.ndarray,
) -> _SampleSet:
    samples = surface.element_samples(uv, uv, elements)
    points = surface.control_points
    a = samples.values @ points
    a_u, a_v = samples.du @ points, samples.dv @ points
    h = samples.weighted @ points
    h_u, h_v = samples.weighted_du @ points, samples.weighted_dv @ points
    # blending of the outer layer, M_0(w) = (1 - w)^r, and its derivative
    m = bernstein(degree_w, w)[:, 0]
    dm = bernstein(degree_w, w, 1)[:, 0]
    weight = 1.0 + m * (samples.weight[:, None] - 1.0)
    weight_u = m * samples.weight_du[:, None]
    weight_v = m * samples.weight_dv[:, None]
    weight_w = dm * (samples.weight[:, None] - 1.0)

    def mixed(plain: np.ndarray, weighted: np.ndarray) -> np.ndarray:
        # written as plain + m (weighted - plain): exact where the weights are 1
        return plain[:, None] + m[:, None] * (weighted - plain)[:, None]

    x = mixed(a, h) / weight[..., None]
    constant = np.stack(
        [
            (mixed(a_v, h_v) - x * weight_v[..., None]) / weight[..., None],
            (mixed(a_u, h_u) - x * weight_u[..., None]) / weight[..., None],
            (dm[:, None] * (h - a)[:, None] - x * weight_w[..., None]) / weight[..., None],
        ],
        axis=2,
    )  # (rows, levels, column of J, coordinate)
    _, s_u, s_v = samples.surface(points)
    vanishing = vanishing_normals(s_u, s_v, samples.count)
    if vanishing.any():
        s_u, s_v = beside_singular(surface, uv, elements, s_u, s_v, vanishing)
    frame = _reference_frames(s_u, s_v, np.maximum(samples.values @ reference, 1e-300))
    inverse = np.linalg.inv(frame)
    on_value = np.stack(
        [
            -w * weight_v / weight**2,
            -w * weight_u / weight**2,
            1.0 / weight - w * weight_w / weight**2,
        ],
        axis=2,
    )
    constant = np.ascontiguousarray(np.einsum("rlci,rck->lkir", constant, inverse))
    scale = np.ascontiguousarray((w / weight).T)
    cross = np.ascontiguousarray(np.einsum("rlc,rck->lkr", on_value, inverse))
    # where the given surface is singular det J is zero whatever the columns do: no sample there
    still = np.flatnonzero(vanishing)
    for level in np.flatnonzero(w == 0.0):
        constant[level][:, :, still] = np.eye(3)[:, :, None]
        scale[level, still] = 0.0
        cross[level][:, still] = 0.0
    return _SampleSet(
        samples.values,
        samples.du,
        samples.dv,
        samples.values.T.tocsr(),
        samples.du.T.tocsr(),
        samples.dv.T.tocsr(),
        constant,
        scale,
        cross,
        np.ascontiguousarray(np.moveaxis(inverse, 0, 2)),
    )


def _reference_frames(s_u: np.ndarray, s_v: np.ndarray, thickness: np.ndarray) -> np.ndarray:
    """Right-handed frames (s_v, s_u, T n), squared off where s_u and s_v nearly agree."""
    normal = -np.cross(s_u, s_v)
    size = np.linalg.norm(normal, axis=1)
    length_u, length_v = np.linalg.norm(s_u, axis=1), np.linalg.norm(s_v, axis=1)
    flat = size < 0.05 * length_u * length_v
    unit = normal / np.maximum(size, 1e-300)[:, None]
    frames = np.stack([s_v, s_u, unit * thickness[:, None]], axis=2)
    if flat.any():
        typical = np.sqrt(np.median(size))
        first = s_v[flat] / np.maximum(length_v[flat], 1e-300)[:, None]
        usable = length_v[flat] > 1e-9 * typical
        first[~usable] = s_u[flat][~usable] / np.maximum(length_u[flat][~usable], 1e-300)[:, None]
        n = unit[flat]
        bare = np.linalg.norm(n, axis=1) < 0.5
        helper = np.eye(3)[np.abs(first).argmin(axis=1)]
        n[bare] = np.cross(first, helper)[bare]
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        second = np.cross(n, first)
        long_v = np.maximum(length_v[flat], 0.05 * typical)[:, None]
        long_u = np.maximum(length_u[flat], 0.05 * typical)[:, None]
        frames[flat] = np.stack(
            [first * long_v, second * long_u, n * thickness[flat][:, None]], axis=2
        )
    return frames


class ColumnEnergy:
    """Quality of the elements of a shell with straight columns, and its distance from w = w0.

    The unknowns are the displacements of the free control points; elements that none of them
    touches are left out, so that a repair costs what its region costs.

    Parameters
    ----------
    surface : PatchSurface
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
    """

    def __init__(
        self,
        surface: PatchSurface,
        field: HarmonicField,
        target: np.ndarray,
        reference: np.ndarray,
        degree_w: int,
        nodal: sparse.csr_matrix,
        d: np.ndarray,
        *,
        free: np.ndarray | None = None,
        fidelity: float = 0.0,
    ) -> None:
        self.surface = surface
        self.field = field
        self.degree_w = degree_w
        self.reference = reference
        self.fidelity = fidelity
        self.eps = BARRIER
        self.d = d.copy()
        self.free = np.arange(len(d)) if free is None else np.flatnonzero(free)
        self.elements = elements_with(surface, self.free)
        touched = np.zeros(len(d))
        touched[self.free] = 1.0
        self.nodes = np.flatnonzero(nodal @ touched > 0)
        self.nodal = nodal[self.nodes]
        self.nodal_t = self.nodal.T.tocsr()
        self.target = target[self.nodes]
        self.sets: list[_SampleSet] = []
        self.shares: list[float] = []
        # as many samples as coefficients: what folds between them is found by the proof
        degree = max(max(patch.degrees) for patch in surface.patches)
        self._watch(self.elements, lobatto(min(max(degree + 1, 4), 8))[0], ACROSS)

    def _watch(self, elements: np.ndarray, uv: np.ndarray, w: np.ndarray) -> None:
        samples = _sample_set(self.surface, self.reference, self.degree_w, uv, w, elements)
        self.sets.append(samples)
        # every element counts the same, however many samples it has
        per_element = len(uv) ** 2 * len(w)
        self.shares.append(1.0 / per_element / self.surface.element_count)

    def add_samples(self, elements: np.ndarray, count: int) -> None:
        """Watch some elements at a finer Chebyshev grid as well."""
        line = 0.5 - 0.5 * np.cos(np.pi * np.arange(count) / (count - 1))
        self._watch(elements, line, line)

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
        w, gradient, _ = self.field.evaluate(self.nodal @ (self.surface.control_points + d))
        return w, gradient

    def preconditioner(self) -> Callable[[np.ndarray], np.ndarray]:
        """Solver of the energy's convex part: the Dirichlet energy of A and the pull to w = w0.

        Both act alike on the three coordinates, so one factorisation serves all of them.
        """
        n = len(self.d)
        matrix = sparse.csr_matrix((n, n))
        for samples, share in zip(self.sets, self.shares, strict=True):
            blocks = []
            for level in range(len(samples.scale)):
                for k in range(3):
                    blocks.append(
                        sparse.diags(samples.scale[level] * samples.inverse[0, k]) @ samples.dv
                        + sparse.diags(samples.scale[level] * samples.inverse[1, k]) @ samples.du
                        + sparse.diags(samples.cross[level, k]) @ samples.values
                    )
            part = sparse.vstack(blocks, format="csr")
            matrix = matrix + 2.0 / 3.0 * share * (part.T @ part)
        if self.fidelity > 0.0:
            _, slope = self.level(self.d)
            steep = np.einsum("li,li->l", slope, slope) / self.target**2
            steep *= 2.0 * self.fidelity / n / 3.0
            matrix = matrix + self.nodal_t @ sparse.diags(steep) @ self.nodal
        matrix = matrix[self.free][:, self.free]
        matrix = matrix + 1e-12 * matrix.diagonal().mean() * sparse.eye(len(self.free))
        solve = splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        return lambda flat: solve.solve(flat.reshape(-1, 3)).ravel()

    def least_determinant(self, flat: np.ndarray) -> float:
        """Smallest det J relative to the reference over all samples."""
        d = self.displacements(flat)
        return min(float(_determinants(s, d).min()) for s in self.sets)

    def __call__(self, flat: np.ndarray) -> tuple[float, np.ndarray]:
        """Energy and gradient for a flat vector of free displacements."""
        d = self.displacements(flat)
        energy, gradient = 0.0, np.zeros_like(d)
        for samples, share in zip(self.sets, self.shares, strict=True):
            part, pull = self._distortion(samples, share, d)
            energy += part
            gradient += pull
        if self.fidelity > 0.0:
            w, slope = self.level(d)
            off = (w - self.target) / self.target
            share = self.fidelity / len(d)
            energy += share * float(off @ off)
            gradient += self.nodal_t @ ((2.0 * share * off / self.target)[:, None] * slope)
        return energy, gradient[self.free].ravel()

    def _distortion(
        self, samples: _SampleSet, share: float, d: np.ndarray
    ) -> tuple[float, np.ndarray]:
        a = samples.columns(d)
        cofactors = _cofactors(a)
        det = _dot(a[:, 0], cofactors[:, 0])
        root = np.sqrt(self.eps**2 + det**2)
        # the second form does not cancel where det < 0
        chi = np.where(det > 0, 0.5 * (det + root), 0.5 * self.eps**2 / (root + np.abs(det)))
        chi = np.maximum(chi, 1e-150)
        dchi = chi / root
        third = np.cbrt(chi) ** -2
        shape = (a * a).sum(axis=(1, 2)) * third / 3.0
        volume = AREA_SHARE * (1.0 + det**2) / chi
        energy = share * float((shape + volume).sum())
        by_det = -(2.0 / 3.0 * shape + volume) / chi * dchi + 2.0 * AREA_SHARE * det / chi
        by_det *= share
        cofactors *= by_det[:, None, None]
        a *= (share * 2.0 / 3.0 * third)[:, None, None]
        a += cofactors
        return energy, samples.pull_back(a)


def _dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return x[:, 0] * y[:, 0] + x[:, 1] * y[:, 1] + x[:, 2] * y[:, 2]


def _cofactors(a: np.ndarray) -> np.ndarray:
    """Derivative of det A by A: column k is the cross product of the two columns after it."""
    out = np.empty_like(a)
    for k in range(3):
        x, y = a[:, (k + 1) % 3], a[:, (k + 2) % 3]
        for i in range(3):
            m, n = (i + 1) % 3, (i + 2) % 3
            np.multiply(x[:, m], y[:, n], out=out[:, k, i])
            out[:, k, i] -= x[:, n] * y[:, m]
    return out


def _determinants(samples: _SampleSet, d: np.ndarray) -> np.ndarray:
    a = samples.columns(d)
    x, y = a[:, 1], a[:, 2]
    det = a[:, 0, 0] * (x[:, 1] * y[:, 2] - x[:, 2] * y[:, 1])
    det += a[:, 0, 1] * (x[:, 2] * y[:, 0] - x[:, 0] * y[:, 2])
    det += a[:, 0, 2] * (x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0])
    return det


def minimise(
    energy: ColumnEnergy,
    start: np.ndarray,
    precondition: Callable[[np.ndarray], np.ndarray],
    reach: np.ndarray,
    steps: int,
    tolerance: float = 1e-4,
) -> np.ndarray:
    """Preconditioned L-BFGS whose steps stay shorter than a given reach of every control point.

    Parameters
    ----------
    energy : ColumnEnergy
    start : (3 n,) array
    precondition : callable
        Approximate inverse of the Hessian.
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
    for _ in range(steps):
        direction = -_two_loop(gradient, pairs, precondition)
        slope = float(gradient @ direction)
        if slope >= 0.0:
            pairs.clear()
            direction = -precondition(gradient)
            slope = float(gradient @ direction)
            if slope >= 0.0:
                break
        moves = np.linalg.norm(direction.reshape(-1, 3), axis=1)
        length = min(1.0, float((reach / np.maximum(moves, 1e-300)).min()))
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
        if float(s @ y) > 1e-12 * np.linalg.norm(s) * np.linalg.norm(y):
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
    precondition = energy.preconditioner()
    for _ in range(rounds):
        if least <= 0:
            energy.eps = min(max(0.5 * abs(least), 1e-6), 0.7 * energy.eps)
        flat = minimise(energy, flat, precondition, reach[energy.free], steps)
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
