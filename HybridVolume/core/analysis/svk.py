# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""St. Venant-Kirchhoff's material on one space: sums over all its elements by batched products.

W = lambda / 2 (tr E)² + mu E : E with Green's strain E = (F'F - 1) / 2, its derivative P = F S with
S = lambda tr E + 2 mu E, and dP_iJ / dF_kL = d_ik S_JL + lambda F_iJ F_kL + mu (F_iL F_kJ
+ d_JL (FF')_ik).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ...errors import FaultError
from ..recovery import Material
from .assembly import Space
from .layout import pairs


@dataclass(frozen=True)
class Viscous:
    """A step in time over which the strain changes, for the viscous part of the stress.

    Attributes
    ----------
    before : (size, d) array
        Displacement at the start of the step, mm.
    step : float
        Its length, s.
    """

    before: np.ndarray
    step: float


@dataclass(frozen=True)
class _Block:
    """Functions of some elements: unknowns, gradients as (ne, nq d, nl), measure, and the places of
    products of two functions among the entries of the side's matrix."""

    unknowns: np.ndarray
    gradients: np.ndarray
    measure: np.ndarray
    slots: np.ndarray


class SvkSide:
    """St. Venant-Kirchhoff on one space, whose unknowns follow the coupled ones."""

    def __init__(
        self, space: Space, embedding: sparse.csr_matrix, material: Material, viscosity: float
    ) -> None:
        self.embedding = embedding
        self.back = embedding.T.tocsr()
        self._begin: tuple[np.ndarray, list] | None = None
        self.lame, self.shear, self.viscosity = material.lame, material.shear, viscosity
        self.size, self.dimension = space.size, space.dimension
        # slopes of straight linear simplices are the same everywhere
        points = 1 if _is_linear(space) else None
        sampled = [(s.unknowns, s.gradients, s.measure) for s in space.samples(points)]
        self.pattern = _pattern([unknowns for unknowns, _, _ in sampled], self.size)
        keys = self.size * np.repeat(np.arange(self.size), np.diff(self.pattern.indptr))
        keys += self.pattern.indices
        self.blocks = []
        for unknowns, gradients, measure in sampled:
            if not (np.isfinite(gradients).all() and (measure > 0.0).all()):
                raise FaultError(
                    "an element of the body is turned inside out or flat",
                    figure=float(measure.min()),
                    remedy="make the hybrid volume again",
                )
            ne, nq, d, nl = gradients.shape
            pair = self.size * unknowns[:, :, None].astype(np.int64) + unknowns[:, None, :]
            slots = np.searchsorted(keys, pair.ravel()).astype(np.int32)
            self.blocks.append(
                _Block(
                    unknowns,
                    np.ascontiguousarray(gradients.reshape(ne, nq * d, nl)),
                    measure,
                    slots,
                )
            )

    def _strains(self, block: _Block, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """F and Green's strain at the quadrature points, (ne, nq, d, d) each."""
        ne, nq = block.measure.shape
        d = local.shape[1]
        gradient = block.gradients @ local[block.unknowns]
        deformation = np.swapaxes(gradient.reshape(ne, nq, d, d), 2, 3) + np.eye(d)
        return deformation, _green(deformation)

    def _hooke(self, strain: np.ndarray) -> np.ndarray:
        """Stress without its viscous part."""
        stress = 2.0 * self.shear * strain
        trace = np.trace(strain, axis1=2, axis2=3)
        stress[..., range(self.dimension), range(self.dimension)] += self.lame * trace[..., None]
        return stress

    def _stress(
        self, number: int, viscous: Viscous | None, strain: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Second Piola-Kirchhoff stress, and the shear modulus that its derivative has."""
        stress = self._hooke(strain)
        if viscous is None or not self.viscosity:
            return stress, self.shear
        change = strain - self._starts(viscous.before)[number][1]
        stress += self.viscosity / viscous.step * change
        return stress, self.shear + 0.5 * self.viscosity / viscous.step

    def energy(self, displacement: np.ndarray, viscous: Viscous | None) -> float:
        """See `Hyperelastic.energy`."""
        local = self.embedding @ displacement
        total = 0.0
        for number, block in enumerate(self.blocks):
            _, strain = self._strains(block, local)
            trace = np.trace(strain, axis1=2, axis2=3)
            density = 0.5 * self.lame * trace**2 + self.shear * (strain**2).sum(axis=(2, 3))
            if viscous is not None and self.viscosity:
                change = strain - self._starts(viscous.before)[number][1]
                density += 0.5 * self.viscosity / viscous.step * (change**2).sum(axis=(2, 3))
            total += float((density * block.measure).sum())
        return total

    def forces(self, displacement: np.ndarray, viscous: Viscous | None) -> np.ndarray:
        """See `Hyperelastic.forces`."""
        local = self.embedding @ displacement
        total = np.zeros_like(local)
        for number, block in enumerate(self.blocks):
            deformation, strain = self._strains(block, local)
            stress, _ = self._stress(number, viscous, strain)
            self._add(total, block, deformation @ stress)
        return self.back @ total

    def _add(self, total: np.ndarray, block: _Block, first: np.ndarray) -> None:
        """Add the forces of first Piola-Kirchhoff stresses (ne, nq, d, d)."""
        ne, nq, d, _ = first.shape
        weighted = np.swapaxes(first * block.measure[..., None, None], 2, 3)
        part = np.swapaxes(block.gradients, 1, 2) @ weighted.reshape(ne, nq * d, d)
        rows = block.unknowns.ravel()
        for c in range(d):
            total[:, c] += np.bincount(rows, part[..., c].ravel(), self.size)

    def tangent(
        self, displacement: np.ndarray, viscous: Viscous | None, projected: bool
    ) -> np.ndarray:
        """Blocks (i, k), i <= k, of the derivative of the forces: entries as in `pattern`."""
        local = self.embedding @ displacement

        def state(number: int) -> tuple[np.ndarray, np.ndarray, float]:
            deformation, strain = self._strains(self.blocks[number], local)
            return (deformation, *self._stress(number, viscous, strain))

        return self._assembled(state, projected)

    def _starts(self, before: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """F and strain of all blocks at the start of a step; kept, since a step asks often."""
        if self._begin is None or self._begin[0] is not before:
            local = self.embedding @ before
            self._begin = before, [self._strains(block, local) for block in self.blocks]
        return self._begin[1]

    def _between(
        self, number: int, before: np.ndarray, local: np.ndarray, step: float
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Mean F, the stress that does the work of the change of energy, and its shear modulus."""
        first, strain = self._starts(before)[number]
        last, end = self._strains(self.blocks[number], local)
        stress = self._hooke(0.5 * (strain + end))
        if self.viscosity:
            stress += self.viscosity / step * (end - strain)
        return 0.5 * (first + last), stress, self.shear + self.viscosity / step

    def forces_between(self, before: np.ndarray, after: np.ndarray, step: float) -> np.ndarray:
        """Forces whose work from one displacement to the other is the change of the energy."""
        local = self.embedding @ after
        total = np.zeros_like(local)
        for number, block in enumerate(self.blocks):
            deformation, stress, _ = self._between(number, before, local, step)
            self._add(total, block, deformation @ stress)
        return self.back @ total

    def tangent_between(
        self, before: np.ndarray, after: np.ndarray, step: float, projected: bool
    ) -> np.ndarray:
        """Near the derivative of :meth:`forces_between` by the later displacement; symmetric."""
        local = self.embedding @ after
        return 0.5 * self._assembled(lambda n: self._between(n, before, local, step), projected)

    def dissipated(self, before: np.ndarray, after: np.ndarray, step: float) -> float:
        """Energy that viscosity takes over a step, mJ."""
        if not self.viscosity:
            return 0.0
        local = self.embedding @ after
        total = 0.0
        for block, (_, strain) in zip(self.blocks, self._starts(before), strict=True):
            change = self._strains(block, local)[1] - strain
            total += float(((change**2).sum(axis=(2, 3)) * block.measure).sum())
        return self.viscosity / step * total

    def _assembled(self, state: Callable, projected: bool) -> np.ndarray:
        """Entries of F, S and a shear modulus that ``state`` gives for each block's number."""
        d = self.dimension
        data = np.zeros((len(pairs(d)), self.pattern.nnz))
        for number, block in enumerate(self.blocks):
            deformation, stress, shear = state(number)
            if projected:
                stress = _positive(stress)
            ne, nq = block.measure.shape
            slopes = block.gradients.reshape(ne, nq, d, -1)
            turned = np.swapaxes(block.gradients, 1, 2)
            part = np.empty_like(slopes)
            for row, (i, k) in enumerate(pairs(d)):
                moduli = _moduli(deformation, stress, self.lame, shear, i, k)
                moduli *= block.measure[..., None, None]
                for a in range(d):
                    np.multiply(moduli[:, :, a, 0, None], slopes[:, :, 0], out=part[:, :, a])
                    for b in range(1, d):
                        part[:, :, a] += moduli[:, :, a, b, None] * slopes[:, :, b]
                values = turned @ part.reshape(block.gradients.shape)
                data[row] += np.bincount(block.slots, values.ravel(), self.pattern.nnz)
        return data


def _moduli(
    deformation: np.ndarray, stress: np.ndarray, lame: float, shear: float, i: int, k: int
) -> np.ndarray:
    """Derivative of P_iJ = (F S)_iJ by F_kL, (ne, nq, J, L)."""
    a, b = deformation[:, :, i], deformation[:, :, k]
    found = lame * a[..., :, None] * b[..., None, :] + shear * b[..., :, None] * a[..., None, :]
    d = deformation.shape[-1]
    found[..., range(d), range(d)] += shear * (a * b).sum(axis=-1, keepdims=True)
    if i == k:
        found += stress
    return found


def _positive(stress: np.ndarray) -> np.ndarray:
    """Symmetric tensors without their negative principal parts."""
    values, vectors = np.linalg.eigh(stress)
    return (vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def deformation_gradient(gradients: np.ndarray, values: np.ndarray) -> np.ndarray:
    """F of samples' gradients (ne, nq, d, nl) and displacements (ne, nl, d), (ne, nq, d, d)."""
    ne, nq, d, nl = gradients.shape
    found = (gradients.reshape(ne, nq * d, nl) @ values).reshape(ne, nq, d, d)
    return np.swapaxes(found, 2, 3) + np.eye(d)


def _green(deformation: np.ndarray) -> np.ndarray:
    """Green's strain of F."""
    d = deformation.shape[-1]
    return 0.5 * (np.swapaxes(deformation, -1, -2) @ deformation - np.eye(d))


def _is_linear(space: object) -> bool:
    return getattr(space, "degree", None) == 1 and hasattr(space, "nodes")


def _pattern(unknowns: Sequence[np.ndarray], size: int) -> sparse.csr_matrix:
    """Where products of two functions of one element stand, with sorted columns."""
    rows = [np.repeat(np.arange(len(part)), part.shape[1]) for part in unknowns]
    found = sparse.csr_matrix((size, size))
    for row, part in zip(rows, unknowns, strict=True):
        ones = np.ones(row.size)
        incidence = sparse.csr_matrix((ones, (row, part.ravel())), shape=(len(part), size))
        found = found + incidence.T @ incidence
    found = found.tocsr()
    found.sort_indices()
    return found
