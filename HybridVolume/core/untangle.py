# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Foldover-free optimisation of the columns of a shell.

Energy of Garanzha, Kaporin, Kudryavtseva, Protais, Ray and Sokolov, "Foldover-free maps in 50 lines
of code" (ACM TOG 2021), with a term that holds the inner surface at the level w = w0. The outer
layer is fixed and columns are straight, so the unknowns are the displacements D of the control
points; every derivative of the shell is affine in D, also for rational patches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.optimize import minimize

from .bezier import bernstein
from .harmonic import HarmonicField
from .surface import PatchSurface

LOBATTO_5 = 0.5 + 0.5 * np.array([-1.0, -np.sqrt(3.0 / 7.0), 0.0, np.sqrt(3.0 / 7.0), 1.0])
LOBATTO_4 = 0.5 + 0.5 * np.array([-1.0, -np.sqrt(0.2), np.sqrt(0.2), 1.0])
AREA_SHARE = 0.05
"""Weight of the volume term; without it cells shrink to nothing."""


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
    return _SampleSet(
        samples.values,
        samples.du,
        samples.dv,
        samples.values.T.tocsr(),
        samples.du.T.tocsr(),
        samples.dv.T.tocsr(),
        np.ascontiguousarray(np.einsum("rlci,rck->lkir", constant, inverse)),
        np.ascontiguousarray((w / weight).T),
        np.ascontiguousarray(np.einsum("rlc,rck->lkr", on_value, inverse)),
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
    """Quality of all elements of a shell with straight columns, and its distance from w = w0.

    Parameters
    ----------
    surface : PatchSurface
    field : HarmonicField
    w0 : float
        Level that the inner surface should lie on.
    reference : (n,) array
        Thickness expected at each control point, mm.
    degree_w : int
        Degree in w; one Bézier layer.
    nodal : (n, n) sparse matrix
        Polynomial B-splines at the Greville abscissae.
    """

    def __init__(
        self,
        surface: PatchSurface,
        field: HarmonicField,
        w0: float,
        reference: np.ndarray,
        degree_w: int,
        nodal: sparse.csr_matrix,
    ) -> None:
        self.surface = surface
        self.field = field
        self.w0 = w0
        self.reference = reference
        self.degree_w = degree_w
        self.nodal = nodal
        self.nodal_t = nodal.T.tocsr()
        everything = np.arange(surface.element_count)
        self.sets = [_sample_set(surface, reference, degree_w, LOBATTO_5, LOBATTO_4, everything)]
        self.fidelity = 0.0
        self.eps = 1e-9

    def add_samples(self, elements: np.ndarray, count: int) -> None:
        """Watch some elements at a finer Chebyshev grid as well."""
        line = 0.5 - 0.5 * np.cos(np.pi * np.arange(count) / (count - 1))
        self.sets.append(
            _sample_set(self.surface, self.reference, self.degree_w, line, line, elements)
        )

    def level(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Field and gradient at the inner surface's Greville points, (n,) and (n, 3)."""
        w, gradient, _ = self.field.evaluate(self.nodal @ (self.surface.control_points + d))
        return w, gradient

    def least_determinant(self, d: np.ndarray) -> float:
        """Smallest det J relative to the reference over all samples."""
        return min(float(_determinants(s, d).min()) for s in self.sets)

    def __call__(self, flat: np.ndarray) -> tuple[float, np.ndarray]:
        """Energy and gradient for a flat displacement vector."""
        d = flat.reshape(-1, 3)
        energy, gradient = 0.0, np.zeros_like(d)
        for samples in self.sets:
            part, pull = self._distortion(samples, d)
            energy += part
            gradient += pull
        if self.fidelity > 0.0:
            w, slope = self.level(d)
            off = (w - self.w0) / self.w0
            share = self.fidelity / len(off)
            energy += share * float(off @ off)
            gradient += self.nodal_t @ ((2.0 * share / self.w0) * off[:, None] * slope)
        return energy, gradient.ravel()

    def _distortion(self, samples: _SampleSet, d: np.ndarray) -> tuple[float, np.ndarray]:
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
        share = 1.0 / det.size
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


def optimise(
    energy: ColumnEnergy, d: np.ndarray, fidelity: float, *, rounds: int = 8, steps: int = 100
) -> np.ndarray:
    """Untangle and improve: lower the regularisation until no sample is inverted, then polish.

    Parameters
    ----------
    energy : ColumnEnergy
    d : (n, 3) array
        Start, mm.
    fidelity : float
        Weight of the term that holds the inner surface at w0.
    rounds, steps : int
        Most rounds of the regularisation, most iterations in a round.

    Returns
    -------
    (n, 3) array
    """
    energy.fidelity = fidelity
    least = energy.least_determinant(d)
    energy.eps = 1e-9 if least > 0 else 1.0
    for _ in range(rounds):
        if least <= 0:
            energy.eps = min(max(0.5 * abs(least), 1e-6), 0.7 * energy.eps)
        found = minimize(
            energy,
            d.ravel(),
            jac=True,
            method="L-BFGS-B",
            options={"maxcor": 12, "maxiter": steps, "ftol": 1e-6},
        )
        d = found.x.reshape(-1, 3)
        barrier = energy.eps <= 1e-9
        least = energy.least_determinant(d)
        if least > 0:
            if barrier:
                break
            energy.eps = 1e-9
    return d
