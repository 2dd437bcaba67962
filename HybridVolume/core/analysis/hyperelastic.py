# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Elastic bodies in motion: energy, forces and tangent of a displacement, linear or with Green's
strain, and the mass.

*St. Venant-Kirchhoff* ("svk"): W = lambda / 2 (tr E)² + mu E : E with Green's strain
E = (F'F - 1) / 2 and F = 1 + du/dX, the "Hookean material with Cauchy-Green strain" of the paper's
Fig. 2. Turned bodies have no energy, however far they turn. *Linear*: the same with the strain's
linear part. In the plane (d = 2) the strain is plane, and a body is a slice of 1 mm.

Displacements and forces are (size, d) arrays over the coupled unknowns of a space; tangents are
over the x components of all unknowns, then the y (and the z) components.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from ...errors import FaultError, InputError
from ..recovery import Material
from .assembly import Space, elastic, mass, stiffness
from .coupling import CollocationSpace, NitscheSpace

LAWS = ("linear", "svk")


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


class Hyperelastic:
    """Energy, forces, tangent and mass of an elastic body.

    Parameters
    ----------
    space : CollocationSpace, NitscheSpace or a single space
        What can be sampled, in space or in the plane.
    materials : Material or (Material, Material)
        Of the whole body, or of shell and core.
    density : float or (float, float)
        t/mm³, of the whole body, or of shell and core.
    law : {"svk", "linear"}
    viscosity : float or (float, float)
        MPa s: the stress has a further part, viscosity times the rate of the strain (Kelvin and
        Voigt), which does nothing to rigid motions and brings a body to rest.

    Raises
    ------
    InputError
        The law, a density or a viscosity is none; or a law with large turns is asked of a space
        that is coupled after Nitsche.
    """

    def __init__(
        self,
        space: CollocationSpace | NitscheSpace | Space,
        materials: Material | Sequence[Material],
        density: float | Sequence[float],
        *,
        law: str = "svk",
        viscosity: float | Sequence[float] = 0.0,
    ) -> None:
        if law not in LAWS:
            raise InputError(f"law {law!r}", remedy=f"choose {' or '.join(LAWS)}")
        self.space = space
        self.law = law
        self.materials = _pair(materials)
        self.density = _pair(density)
        self.viscosity = _pair(viscosity)
        if not all(0.0 < rho < np.inf for rho in self.density):
            raise InputError(f"density {density} t/mm³", remedy="give one above 0")
        if not all(0.0 <= eta < np.inf for eta in self.viscosity):
            raise InputError(f"viscosity {viscosity} MPa s", remedy="give 0 or more")
        if law == "svk" and isinstance(space, NitscheSpace):
            raise InputError(
                "large turns are not coupled after Nitsche", remedy="choose collocation"
            )
        self._sides = _sides(space)

    @property
    def size(self) -> int:
        """Number of unknowns of one component."""
        return self.space.size

    @cached_property
    def reference(self) -> np.ndarray:
        """Coefficients of the body's own points, (size, d), mm."""
        space = self.space
        if isinstance(space, CollocationSpace):
            nodes = space.tets.nodes[space.free_nodes]
            return np.concatenate([space.spline.control_points, nodes])
        if isinstance(space, NitscheSpace):
            return np.concatenate([space.spline.control_points, space.tets.nodes])
        points = getattr(space, "control_points", None)
        return space.nodes if points is None else points

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return self.reference.shape[1]

    @cached_property
    def mass(self) -> sparse.csr_matrix:
        """Mass matrix of one component, (size, size), t."""
        return sum(
            density * (embedding.T @ mass(side) @ embedding)
            for density, (side, embedding) in zip(self.density, self._sides, strict=False)
        ).tocsr()

    @cached_property
    def weights(self) -> np.ndarray:
        """Mass of each unknown's function, (size,), t: the mass matrix times a unit translation."""
        return self.mass @ np.ones(self.size)

    def conduction_like(self) -> sparse.csr_matrix:
        """A stiffness of single components, (size, size), N/mm, that is near the elastic one.

        It lies between mu and lambda + 2 mu times the Laplacian's, and turning the body does not
        change it.
        """
        near = [float(np.sqrt(m.shear * (m.lame + 2.0 * m.shear))) for m in self.materials]
        if isinstance(self.space, CollocationSpace | NitscheSpace):
            return self.space.conduction(*near)
        return near[0] * stiffness(self.space)

    def energy(self, displacement: np.ndarray, viscous: Viscous | None = None) -> float:
        """Elastic energy, mJ; with the viscous part's potential where a step is given.

        That potential is viscosity / (2 step) times the squared change of the strain. Twice of it
        is what the step turns into heat.

        Parameters
        ----------
        displacement : (size, d) array
            mm
        viscous : Viscous, optional
        """
        u = displacement
        if self.law == "linear":
            flat = u.T.ravel()
            total = 0.5 * float(flat @ (self._linear @ flat))
            if viscous is not None and any(self.viscosity):
                change = flat - viscous.before.T.ravel()
                total += 0.5 / viscous.step * float(change @ (self._damping @ change))
            return total
        return float(sum(side.energy(u, viscous) for side in self._blocks))

    def forces(self, displacement: np.ndarray, viscous: Viscous | None = None) -> np.ndarray:
        """Derivative of the energy by the displacement, (size, d), N.

        Parameters
        ----------
        displacement : (size, d) array
            mm
        viscous : Viscous, optional
        """
        u = displacement
        if self.law == "linear":
            found = self._linear @ u.T.ravel()
            if viscous is not None and any(self.viscosity):
                change = (u - viscous.before).T.ravel()
                found = found + self._damping @ change / viscous.step
            return found.reshape(self.dimension, -1).T
        return sum(side.forces(u, viscous) for side in self._blocks)

    def tangent(
        self,
        displacement: np.ndarray,
        viscous: Viscous | None = None,
        *,
        projected: bool = False,
    ) -> sparse.csr_matrix:
        """Derivative of the forces, (d size, d size), N/mm.

        Parameters
        ----------
        displacement : (size, d) array
            mm
        viscous : Viscous, optional
        projected : bool
            Leave out what pressure takes away from the stiffness, so that the matrix is positive:
            what Newton's method needs far from the solution.
        """
        if self.law == "linear":
            if viscous is not None and any(self.viscosity):
                return (self._linear + self._damping / viscous.step).tocsr()
            return self._linear
        d = self.dimension
        parts = [side.tangent(displacement, viscous, projected) for side in self._blocks]
        found = [sum(of[1:], of[0]) for of in zip(*parts, strict=True)]
        blocks = dict(zip(_pairs(d), found, strict=True))
        return sparse.bmat(
            [[blocks[i, k] if i <= k else blocks[k, i].T for k in range(d)] for i in range(d)],
            format="csr",
        )

    def least_volumes(self, displacement: np.ndarray) -> list[np.ndarray]:
        """Smallest sampled det F of each element, negative where it is flipped.

        Parameters
        ----------
        displacement : (size, d) array
            mm

        Returns
        -------
        list of (ne,) arrays
            Of shell and core, or of the single space.
        """
        found = []
        for side, embedding in self._sides:
            local = embedding @ displacement
            least = [np.zeros(0)]
            number = [np.zeros(0, dtype=np.int64)]
            for s in side.samples():
                least.append(np.linalg.det(_gradient(s.gradients, local[s.unknowns])).min(axis=1))
                number.append(np.asarray(s.element))
            order = np.argsort(np.concatenate(number), kind="stable")
            found.append(np.concatenate(least)[order])
        return found

    @cached_property
    def _linear(self) -> sparse.csr_matrix:
        """Stiffness of the linear law."""
        if isinstance(self.space, CollocationSpace | NitscheSpace):
            return self.space.elasticity(*self.materials)
        return elastic(self.space, self.materials[0].lame, self.materials[0].shear)

    @cached_property
    def _damping(self) -> sparse.csr_matrix:
        """Forces of the linear law's viscous part by the rate of the displacement."""
        total = 0.0
        for eta, (side, embedding) in zip(self.viscosity, self._sides, strict=False):
            each = sparse.kron(sparse.identity(self.dimension), embedding, format="csr")
            total = total + each.T @ elastic(side, 0.0, 0.5 * eta) @ each
        return sparse.csr_matrix(total)

    @cached_property
    def _blocks(self) -> list[_Side]:
        """Gradients of all functions at all quadrature points, which are kept."""
        return [
            _Side(*side, material, viscosity)
            for side, material, viscosity in zip(
                self._sides, self.materials, self.viscosity, strict=False
            )
        ]


@dataclass(frozen=True)
class _Block:
    """Functions of some elements: unknowns, gradients as (ne, nq d, nl), measure, and the places of
    products of two functions among the entries of the side's matrix."""

    unknowns: np.ndarray
    gradients: np.ndarray
    measure: np.ndarray
    slots: np.ndarray


class _Side:
    """St. Venant-Kirchhoff on one space, whose unknowns follow the coupled ones."""

    def __init__(
        self, space: Space, embedding: sparse.csr_matrix, material: Material, viscosity: float
    ) -> None:
        self.embedding = embedding
        self.back = embedding.T.tocsr()
        self.lame, self.shear, self.viscosity = material.lame, material.shear, viscosity
        self.size = space.size
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

    def _change(self, block: _Block, viscous: Viscous | None, strain: np.ndarray) -> np.ndarray:
        """Change of the strain over the step."""
        return strain - self._strains(block, self.embedding @ viscous.before)[1]

    def _stress(
        self, block: _Block, viscous: Viscous | None, strain: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Second Piola-Kirchhoff stress, and the shear modulus that its derivative has."""
        d = strain.shape[-1]
        trace = np.trace(strain, axis1=2, axis2=3)
        stress = 2.0 * self.shear * strain
        stress[..., range(d), range(d)] += self.lame * trace[..., None]
        if viscous is None or not self.viscosity:
            return stress, self.shear
        stress += self.viscosity / viscous.step * self._change(block, viscous, strain)
        return stress, self.shear + 0.5 * self.viscosity / viscous.step

    def energy(self, displacement: np.ndarray, viscous: Viscous | None) -> float:
        local = self.embedding @ displacement
        total = 0.0
        for block in self.blocks:
            _, strain = self._strains(block, local)
            trace = np.trace(strain, axis1=2, axis2=3)
            density = 0.5 * self.lame * trace**2 + self.shear * (strain**2).sum(axis=(2, 3))
            if viscous is not None and self.viscosity:
                change = self._change(block, viscous, strain)
                density += 0.5 * self.viscosity / viscous.step * (change**2).sum(axis=(2, 3))
            total += float((density * block.measure).sum())
        return total

    def forces(self, displacement: np.ndarray, viscous: Viscous | None) -> np.ndarray:
        local = self.embedding @ displacement
        total = np.zeros_like(local)
        for block in self.blocks:
            deformation, strain = self._strains(block, local)
            stress, _ = self._stress(block, viscous, strain)
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
    ) -> list[sparse.csr_matrix]:
        """Blocks (i, k), i <= k, over the coupled unknowns."""
        local = self.embedding @ displacement
        d = local.shape[1]
        data = np.zeros((len(_pairs(d)), self.pattern.nnz))
        for block in self.blocks:
            deformation, strain = self._strains(block, local)
            stress, shear = self._stress(block, viscous, strain)
            if projected:
                stress = _positive(stress)
            ne, nq = block.measure.shape
            slopes = block.gradients.reshape(ne, nq, d, -1)
            turned = np.swapaxes(block.gradients, 1, 2)
            for row, (i, k) in enumerate(_pairs(d)):
                moduli = _moduli(deformation, stress, self.lame, shear, i, k)
                moduli *= block.measure[..., None, None]
                part = np.empty_like(slopes)
                for a in range(d):
                    part[:, :, a] = sum(
                        moduli[:, :, a, b, None] * slopes[:, :, b] for b in range(d)
                    )
                values = turned @ part.reshape(block.gradients.shape)
                data[row] += np.bincount(block.slots, values.ravel(), self.pattern.nnz)
        shape, indices, indptr = self.pattern.shape, self.pattern.indices, self.pattern.indptr
        return [
            self.back @ sparse.csr_matrix((values, indices, indptr), shape) @ self.embedding
            for values in data
        ]


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


def _gradient(gradients: np.ndarray, values: np.ndarray) -> np.ndarray:
    """F of samples' gradients (ne, nq, d, nl) and displacements (ne, nl, d), (ne, nq, d, d)."""
    ne, nq, d, nl = gradients.shape
    found = (gradients.reshape(ne, nq * d, nl) @ values).reshape(ne, nq, d, d)
    return np.swapaxes(found, 2, 3) + np.eye(d)


def _green(deformation: np.ndarray) -> np.ndarray:
    """Green's strain of F."""
    d = deformation.shape[-1]
    return 0.5 * (np.swapaxes(deformation, -1, -2) @ deformation - np.eye(d))


def _pairs(d: int) -> list[tuple[int, int]]:
    return [(i, k) for i in range(d) for k in range(i, d)]


def _pair(given: object) -> tuple:
    """One value for both shell and core, or one of each."""
    if isinstance(given, Sequence | np.ndarray):
        if len(given) != 2:
            raise InputError(
                f"{len(given)} values for shell and core", remedy="give one, or one of each"
            )
        return tuple(given)
    return (given, given)


def _sides(space: object) -> list[tuple[Space, sparse.csr_matrix]]:
    """Spaces that are sampled, and the matrices from the coupled unknowns to theirs."""
    if isinstance(space, CollocationSpace):
        whole = space.constraint
    elif isinstance(space, NitscheSpace):
        whole = sparse.identity(space.size, format="csr")
    else:
        return [(space, sparse.identity(space.size, format="csr"))]
    count = space.spline.size
    return [(space.spline, whole[:count]), (space.tets, whole[count:])]


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
