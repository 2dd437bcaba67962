# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Samples of det J and of the distortion of a shell with straight columns, and their gradients.

With A = J S⁻¹ and S the reference frame of a sample, the energy of a sample is

    tr(AᵀA) / (3 χ^(2/3)) + AREA_SHARE (1 + det² A) / χ,   χ = (det A + √(ε² + det² A)) / 2

(Garanzha, Kaporin, Kudryavtseva, Protais, Ray and Sokolov, "Foldover-free maps in 50 lines of
code", ACM TOG 2021). Samples of one kind of element (degrees, rational or not) are kept together,
with the basis functions as dense blocks an element, so that their work is a few matrix products.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .bezier import bernstein
from .singular import beside_singular, vanishing_normals
from .surface import ElementGroup, ElementSamples, PatchSurface

AREA_SHARE = 0.05
"""Weight of the volume term; without it cells shrink to nothing."""


class ColumnSamples(Protocol):
    """What the energy asks of the samples of one kind of element.

    Attributes
    ----------
    index : (ne, m) int array
        Control points that act on each element.
    element : (ne,) int array
        Number of each element.
    """

    index: np.ndarray
    element: np.ndarray

    def evaluate(
        self, d: np.ndarray, eps: float, share: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Energy of each element times its share, (ne,), and the gradient by d, (n, 3)."""

    def least(self, d: np.ndarray) -> np.ndarray:
        """Smallest det A over the samples of each element, (ne,)."""

    def stiffness(self, d: np.ndarray, eps: float, share: np.ndarray) -> np.ndarray:
        """Curvature of the energy at d, the same for each coordinate, (ne, m, m).

        Positive semidefinite: that of tr(AᵀA) and of det A, without what couples the coordinates.
        """


def column_samples(
    surface: PatchSurface,
    base: np.ndarray,
    reference: np.ndarray,
    degree_w: int,
    uv: np.ndarray,
    w: np.ndarray,
    elements: np.ndarray,
) -> list[ColumnSamples]:
    """Samples at a tensor grid of elements, one object for each kind of element.

    Parameters
    ----------
    surface : PatchSurface
    base : (n, 3) array
        Feet of the columns: control points of all layers but the outermost at no displacement, mm.
    reference : (n,) array
        Thickness expected at each control point, mm.
    degree_w : int
        Degree in w; one Bézier layer.
    uv, w : arrays
        Places of the samples in both directions of the surface, and across.
    elements : (ne,) int array
        Surface elements.
    """
    found: list[ColumnSamples] = []
    for group in surface.groups:
        members = group.element[np.isin(group.element, elements)]
        if not len(members):
            continue
        samples = surface.element_samples(uv, uv, members)
        _, s_u, s_v = samples.surface(surface.control_points)
        vanishing = vanishing_normals(s_u, s_v, samples.count).reshape(len(members), -1)
        plain = (np.isin(members, group.element[~_weighted(group)])) & ~vanishing.any(axis=1)
        for chosen, kind in ((plain, PolynomialSamples), (~plain, RationalSamples)):
            if chosen.any():
                if not chosen.all():
                    samples = surface.element_samples(uv, uv, members[chosen])
                still = vanishing[chosen].ravel()
                given = _Given(surface, samples, base, reference, degree_w, uv, w, still)
                found.append(kind(given, members[chosen]))
    return found


def _weighted(group: ElementGroup) -> np.ndarray:
    """Elements with any weight that is not 1."""
    return np.any(group.weights.reshape(len(group.element), -1) != 1.0, axis=1)


@dataclass(frozen=True)
class _Given:
    """What samples are made from; ``still`` marks rows where the given surface is singular."""

    surface: PatchSurface
    samples: ElementSamples
    base: np.ndarray
    reference: np.ndarray
    degree_w: int
    uv: np.ndarray
    w: np.ndarray
    still: np.ndarray

    def frames(self, elements: np.ndarray, s_u: np.ndarray, s_v: np.ndarray) -> np.ndarray:
        """Reference frames of the rows, (rows, 3, 3)."""
        if self.still.any():
            s_u, s_v = beside_singular(self.surface, self.uv, elements, s_u, s_v, self.still)
        return reference_frames(s_u, s_v, np.maximum(self.samples.values @ self.reference, 1e-300))


class _Blocks:
    """Basis functions of one kind of element as dense arrays."""

    def __init__(self, samples: ElementSamples, elements: np.ndarray) -> None:
        ne, count = len(elements), samples.count
        self.element = elements
        size = samples.values.nnz // (ne * count)
        self.index = samples.values.indices.reshape(ne, count, size)[:, 0].copy()
        # (ne, m, 3, samples): functions, derivatives by v and by u
        self.basis = np.stack(
            [
                matrix.data.reshape(ne, count, size).transpose(0, 2, 1)
                for matrix in (samples.values, samples.dv, samples.du)
            ],
            axis=2,
        )

    def gather(self, d: np.ndarray) -> np.ndarray:
        """Displacements of the control points of each element, (ne, 3, m)."""
        return d[self.index].transpose(0, 2, 1)

    def scatter(self, local: np.ndarray, n: int) -> np.ndarray:
        """Sum (ne, 3, m) arrays into control points, (n, 3)."""
        flat = self.index.ravel()
        return np.stack([np.bincount(flat, local[:, i].ravel(), n) for i in range(3)], axis=1)


class PolynomialSamples(_Blocks):
    """Samples of polynomial elements.

    With straight columns J(w) = [s_v + w D_v, s_u + w D_u, D], so that tr(AᵀA) and det A are
    quadratic polynomials in w: the three levels cost little more than one.
    """

    def __init__(self, given: _Given, elements: np.ndarray) -> None:
        samples, w = given.samples, given.w
        super().__init__(samples, elements)
        ne, count = len(elements), samples.count
        self.shape = (ne, count)
        self.basis = np.ascontiguousarray(self.basis.reshape(ne, -1, 3 * count))
        self.basis_t = np.ascontiguousarray(self.basis.transpose(0, 2, 1))
        _, s_u, s_v = samples.surface(given.surface.control_points)
        frame = given.frames(elements, s_u, s_v)
        self.s_v, self.s_u = np.ascontiguousarray(s_v.T), np.ascontiguousarray(s_u.T)
        # the third column of S is at right angles to the others, so SᵀS has a block of 2 x 2
        metric = np.einsum("rik,ril->klr", frame, frame)
        block = metric[0, 0] * metric[1, 1] - metric[0, 1] ** 2
        self.g_vv, self.g_uu = metric[1, 1] / block, metric[0, 0] / block
        self.g_vu, self.g_ww = -metric[0, 1] / block, 1.0 / metric[2, 2]
        self.density = 1.0 / np.linalg.det(frame)
        self.normal = cross(self.s_v, self.s_u)
        self.on_v = self.g_vv * self.s_v + self.g_vu * self.s_u
        self.on_u = self.g_uu * self.s_u + self.g_vu * self.s_v
        self.still = dot(self.on_v, self.s_v) + dot(self.on_u, self.s_u)
        self.powers = np.vander(w, 3, increasing=True)

    def _parts(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """D, D_v and D_u at the samples, (3, rows) each."""
        ne, count = self.shape
        found = (self.gather(d) @ self.basis).reshape(ne, 3, 3, count)
        found = np.ascontiguousarray(found.transpose(2, 1, 0, 3)).reshape(3, 3, -1)
        return found[0], found[1], found[2]

    def _determinants(self, x: np.ndarray, x_v: np.ndarray, x_u: np.ndarray) -> tuple:
        middle = cross(x_v, self.s_u) + cross(self.s_v, x_u)
        last = cross(x_v, x_u)
        parts = np.stack([dot(c, x) for c in (self.normal, middle, last)])
        return middle, last, self.powers @ (parts * self.density)

    def least(self, d: np.ndarray) -> np.ndarray:
        det = self._determinants(*self._parts(d))[2]
        return det.min(axis=0).reshape(self.shape).min(axis=1)

    def evaluate(
        self, d: np.ndarray, eps: float, share: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        ne, count = self.shape
        x, x_v, x_u = self._parts(d)
        middle, last, det = self._determinants(x, x_v, x_u)
        pull_v = self.g_vv * x_v + self.g_vu * x_u
        pull_u = self.g_uu * x_u + self.g_vu * x_v
        t0 = self.still + self.g_ww * dot(x, x)
        t1 = 2.0 * (dot(self.on_v, x_v) + dot(self.on_u, x_u))
        t2 = dot(pull_v, x_v) + dot(pull_u, x_u)
        energy, by_trace, by_det = _energy(self.powers @ np.stack([t0, t1, t2]), det, eps)
        factor = np.repeat(share / (count * len(self.powers)), count)
        by_trace *= 2.0 * factor
        by_det *= factor * self.density
        a0, a1, a2 = self.powers.T @ by_trace
        b0, b1, b2 = self.powers.T @ by_det
        gradient = np.empty((3, 3, ne * count))
        gradient[0] = a0 * self.g_ww * x + b0 * self.normal + b1 * middle + b2 * last
        gradient[1] = a1 * self.on_v + a2 * pull_v + cross(b1 * self.s_u + b2 * x_u, x)
        gradient[2] = a1 * self.on_u + a2 * pull_u + cross(x, b1 * self.s_v + b2 * x_v)
        local = gradient.reshape(3, 3, ne, count).transpose(2, 1, 0, 3).reshape(ne, 3, 3 * count)
        total = energy.sum(axis=0).reshape(self.shape).sum(axis=1)
        return total * factor[::count], self.scatter(local @ self.basis_t, len(d))

    def stiffness(self, d: np.ndarray, eps: float, share: np.ndarray) -> np.ndarray:
        ne, count = self.shape
        x, x_v, x_u = self._parts(d)
        factor = np.repeat(share / (count * len(self.powers)), count)
        metric = np.zeros((6, ne * count))
        for w in self.powers[:, 1]:
            j_v, j_u = self.s_v + w * x_v, self.s_u + w * x_u
            c_v, c_u, c_w = cross(j_u, x), cross(x, j_v), cross(j_v, j_u)
            trace = self.g_vv * dot(j_v, j_v) + self.g_uu * dot(j_u, j_u)
            trace += 2.0 * self.g_vu * dot(j_v, j_u) + self.g_ww * dot(x, x)
            by_trace, by_det = _curvatures(trace, dot(c_w, x) * self.density, eps)
            by_trace *= factor
            by_det *= factor * self.density**2
            metric += [
                by_trace * self.g_ww + by_det * dot(c_w, c_w),
                w * w * (by_trace * self.g_vv + by_det * dot(c_v, c_v)),
                w * w * (by_trace * self.g_uu + by_det * dot(c_u, c_u)),
                w * w * (by_trace * self.g_vu + by_det * dot(c_v, c_u)),
                w * by_det * dot(c_v, c_w),
                w * by_det * dot(c_u, c_w),
            ]
        ww, vv, uu, vu, vw, uw = metric.reshape(6, ne, 1, count)
        value, by_v, by_u = (self.basis[:, :, k * count : (k + 1) * count] for k in range(3))
        matrix = (ww * value + vw * by_v + uw * by_u) @ value.transpose(0, 2, 1)
        matrix += (vw * value + vv * by_v + vu * by_u) @ by_v.transpose(0, 2, 1)
        matrix += (uw * value + vu * by_v + uu * by_u) @ by_u.transpose(0, 2, 1)
        return matrix


class RationalSamples(_Blocks):
    """Samples of other elements: every level has derivatives of its own, affine in D.

    They are rational, or their surface is singular at some samples.
    """

    def __init__(self, given: _Given, elements: np.ndarray) -> None:
        samples, w = given.samples, given.w
        super().__init__(samples, elements)
        ne, count, size = len(elements), samples.count, self.index.shape[1]
        points = given.surface.control_points
        a, a_u, a_v = (m @ given.base for m in (samples.values, samples.du, samples.dv))
        h, h_u, h_v = (
            m @ points for m in (samples.weighted, samples.weighted_du, samples.weighted_dv)
        )
        # blending of the outer layer, M_0(w) = (1 - w)^r, and its derivative
        m, dm = (bernstein(given.degree_w, w, k)[:, 0] for k in (0, 1))
        weight = 1.0 + m * (samples.weight[:, None] - 1.0)
        weight_v, weight_u = m * samples.weight_dv[:, None], m * samples.weight_du[:, None]
        weight_w = dm * (samples.weight[:, None] - 1.0)

        def mixed(plain: np.ndarray, weighted: np.ndarray) -> np.ndarray:
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
        on_value = np.stack(
            [
                -w * weight_v / weight**2,
                -w * weight_u / weight**2,
                1.0 / weight - w * weight_w / weight**2,
            ],
            axis=2,
        )
        _, s_u, s_v = samples.surface(points)
        inverse = np.linalg.inv(given.frames(elements, s_u, s_v))
        self.levels = len(w)
        self.shape = (ne, 3, 3, self.levels * count)
        constant = np.einsum("rlci,rck->ikrl", constant, inverse)
        factor = np.einsum("rlc,rck->krl", on_value, inverse)
        along = w / weight
        # where the given surface is singular det J is zero whatever the columns do: no sample there
        first = np.flatnonzero(w == 0.0)
        still = np.ix_(np.flatnonzero(given.still), first)
        for k in range(3):
            for i in range(3):
                constant[i, k][still] = float(i == k)
            factor[k][still] = 0.0
        along[still] = 0.0
        constant = constant.reshape(3, 3, ne, count * self.levels)
        self.constant = np.ascontiguousarray(constant.transpose(2, 0, 1, 3))
        # column k of A is the constant plus, for each control point, a factor times D
        factor = factor.reshape(3, ne, 1, count, -1)
        along = along.reshape(ne, 1, count, -1)
        turn = np.moveaxis(inverse, 0, 2).reshape(3, 3, ne, 1, count, 1)
        value, by_v, by_u = (self.basis[:, :, k, :, None] for k in range(3))
        block = [
            (factor[k] * value + along * (turn[0, k] * by_v + turn[1, k] * by_u)) for k in range(3)
        ]
        self.basis = np.stack(block, axis=2).reshape(ne, size, 3 * count * self.levels)

    def _columns(self, d: np.ndarray) -> np.ndarray:
        """A at the samples, (3 coordinates, 3 columns, rows)."""
        a = (self.gather(d) @ self.basis).reshape(self.shape) + self.constant
        return np.ascontiguousarray(a.transpose(1, 2, 0, 3)).reshape(3, 3, -1)

    def least(self, d: np.ndarray) -> np.ndarray:
        a = self._columns(d)
        det = dot(cross(a[:, 0], a[:, 1]), a[:, 2])
        return det.reshape(self.shape[0], -1).min(axis=1)

    def evaluate(
        self, d: np.ndarray, eps: float, share: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        ne, count = self.shape[0], self.shape[3]
        a = self._columns(d)
        cofactors = _cofactors(a)
        det = dot(a[:, 0], cofactors[:, 0])
        energy, by_trace, by_det = _energy((a * a).sum(axis=(0, 1)), det, eps)
        factor = np.repeat(share / count, count)
        gradient = 2.0 * factor * by_trace * a + factor * by_det * cofactors
        local = gradient.reshape(3, 3, ne, count).transpose(2, 0, 1, 3).reshape(ne, 3, -1)
        total = energy.reshape(ne, count).sum(axis=1) * (share / count)
        return total, self.scatter(local @ self.basis.transpose(0, 2, 1), len(d))

    def stiffness(self, d: np.ndarray, eps: float, share: np.ndarray) -> np.ndarray:
        ne, count = self.shape[0], self.shape[3]
        a = self._columns(d)
        cofactors = _cofactors(a)
        by_trace, by_det = _curvatures((a * a).sum(axis=(0, 1)), dot(a[:, 0], cofactors[:, 0]), eps)
        factor = np.repeat(share / count, count)
        metric = np.einsum("ikr,ilr->klr", cofactors, cofactors) * (by_det * factor)
        for k in range(3):
            metric[k, k] += by_trace * factor
        metric = metric.reshape(3, 3, ne, 1, count)
        basis = self.basis.reshape(ne, -1, 3, count)
        matrix = np.zeros((ne, basis.shape[1], basis.shape[1]))
        for k in range(3):
            row = sum(metric[k, m] * basis[:, :, m] for m in range(3))
            matrix += row @ basis[:, :, k].transpose(0, 2, 1)
        return matrix


def _cofactors(a: np.ndarray) -> np.ndarray:
    """Derivatives of det A by A, for (3, 3, rows) arrays of which the second axis is the column."""
    return np.stack([cross(a[:, (k + 1) % 3], a[:, (k + 2) % 3]) for k in range(3)], 1)


def _energy(
    trace: np.ndarray, det: np.ndarray, eps: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy of samples from tr(AᵀA) and det A, and its derivatives by them."""
    root, chi, by_trace, shape, volume = _parts_of_energy(trace, det, eps)
    by_det = 2.0 * AREA_SHARE * det / chi - (2.0 / 3.0 * shape + volume) / root
    return shape + volume, by_trace, by_det


def _curvatures(trace: np.ndarray, det: np.ndarray, eps: float) -> tuple[np.ndarray, np.ndarray]:
    """Weights of (dA)² and of (d det A)² in the energy's second derivative, never negative.

    The second is a third of the derivative: cofactors have three rows, and the matrix of one
    coordinate stands for all of them.
    """
    root, chi, by_trace, shape, volume = _parts_of_energy(trace, det, eps)
    second = 2.0 * AREA_SHARE / chi * (1.0 - 2.0 * det / root)
    second += (4.0 / 9.0 * shape + volume) / root**2
    second += (2.0 / 3.0 * shape + volume) * det / root**3
    return 2.0 * by_trace, np.maximum(second, 0.0) / 3.0


def _parts_of_energy(trace: np.ndarray, det: np.ndarray, eps: float) -> tuple[np.ndarray, ...]:
    """√(ε² + det² A), χ, χ^(-2/3) / 3, and the terms of shape and of volume."""
    root = np.sqrt(eps**2 + det * det)
    # the second form does not cancel where det < 0
    chi = np.where(det > 0, 0.5 * (det + root), 0.5 * eps**2 / (root + np.abs(det)))
    chi = np.maximum(chi, 1e-150)
    by_trace = np.cbrt(chi) ** -2 / 3.0
    return root, chi, by_trace, trace * by_trace, AREA_SHARE * (1.0 + det * det) / chi


def dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Scalar products of (3, rows) arrays."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def cross(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Vector products of (3, rows) arrays."""
    out = np.empty_like(x)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.multiply(x[j], y[k], out=out[i])
        out[i] -= x[k] * y[j]
    return out


def reference_frames(s_u: np.ndarray, s_v: np.ndarray, thickness: np.ndarray) -> np.ndarray:
    """Right-handed frames (s_v, s_u, T n), squared off where s_u and s_v nearly agree.

    The third column is at right angles to the two others.

    Parameters
    ----------
    s_u, s_v : (rows, 3) arrays
    thickness : (rows,) array
        T, mm.

    Returns
    -------
    (rows, 3, 3) array, columns last
    """
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
