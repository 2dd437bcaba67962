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
from functools import cached_property

import numpy as np
from scipy import sparse

from ...errors import InputError
from ..recovery import Material
from .assembly import Space, elastic, mass, stiffness
from .coupling import CollocationSpace, NitscheSpace
from .layout import Layout
from .nitsche_svk import NitscheTerms
from .rigid import coefficient_points
from .svk import SvkSide, Viscous, deformation_gradient

LAWS = ("linear", "svk")


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
        The law, a density or a viscosity is none.
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
        self._sides = _sides(space)

    @property
    def size(self) -> int:
        """Number of unknowns of one component."""
        return self.space.size

    @cached_property
    def reference(self) -> np.ndarray:
        """Coefficients of the body's own points, (size, d), mm."""
        space = self.space
        if isinstance(space, CollocationSpace | NitscheSpace):
            return coefficient_points(space)
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
        total = float(sum(side.energy(u, viscous) for side in self._blocks))
        return total + (self._interface.energy(u) if self._interface else 0.0)

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
        total = sum(side.forces(u, viscous) for side in self._blocks)
        return total + self._interface.forces(u) if self._interface else total

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
        found = self._layout.matrix(
            [side.tangent(displacement, viscous, projected) for side in self._blocks]
        )
        if self._interface:
            found = (found + self._interface.tangent(displacement)).tocsr()
        return found

    def forces_between(self, before: np.ndarray, after: np.ndarray, step: float) -> np.ndarray:
        """Forces whose work from one displacement to another is the change of the energy, N.

        F S with the mean of F and the mean of S at both ends (Simo and Tarnow 1992), which also
        turn nothing: they keep angular momentum. With them goes the viscous part.

        Parameters
        ----------
        before, after : (size, d) arrays
            mm
        step : float
            Time between them, s.

        Returns
        -------
        (size, d) array

        Raises
        ------
        InputError
            The law is svk and the spaces are coupled after Nitsche, whose part is no such mean.
        """
        if self._interface:
            raise InputError(
                "no rule keeps the energy of St. Venant-Kirchhoff coupled after Nitsche",
                remedy="choose collocation, or the rules newmark or midpoint",
            )
        if self.law == "linear":
            flat = 0.5 * self._linear @ (before + after).T.ravel()
            if any(self.viscosity):
                flat = flat + self._damping @ (after - before).T.ravel() / step
            return flat.reshape(self.dimension, -1).T
        return sum(side.forces_between(before, after, step) for side in self._blocks)

    def tangent_between(
        self, before: np.ndarray, after: np.ndarray, step: float, *, projected: bool = False
    ) -> sparse.csr_matrix:
        """Near the derivative of :meth:`forces_between` by ``after``, symmetric, N/mm."""
        if self.law == "linear":
            if any(self.viscosity):
                return (0.5 * self._linear + self._damping / step).tocsr()
            return 0.5 * self._linear
        return self._layout.matrix(
            [side.tangent_between(before, after, step, projected) for side in self._blocks]
        )

    def dissipated(self, before: np.ndarray, after: np.ndarray, step: float) -> float:
        """Energy that viscosity takes between two displacements, mJ: twice its potential."""
        if self.law == "linear":
            change = (after - before).T.ravel()
            return float(change @ (self._damping @ change)) / step
        return sum(side.dissipated(before, after, step) for side in self._blocks)

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
                least.append(
                    np.linalg.det(deformation_gradient(s.gradients, local[s.unknowns])).min(axis=1)
                )
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
    def _interface(self) -> NitscheTerms | None:
        """The interface's part of the energy where the spaces are coupled after Nitsche."""
        if self.law == "linear" or not isinstance(self.space, NitscheSpace):
            return None
        return NitscheTerms(self.space, self.materials[1])

    @cached_property
    def _layout(self) -> Layout:
        """Where the entries of the tangent stand."""
        patterns = [side.pattern for side in self._blocks]
        return Layout(patterns, [side.embedding for side in self._blocks], self.dimension)

    @cached_property
    def _blocks(self) -> list[SvkSide]:
        """Gradients of all functions at all quadrature points, which are kept."""
        return [
            SvkSide(*side, material, viscosity)
            for side, material, viscosity in zip(
                self._sides, self.materials, self.viscosity, strict=False
            )
        ]


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
