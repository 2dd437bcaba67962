# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Nitsche's coupling of bodies that are turned and strained far, as an energy.

    - int [u] . P(F) n + int (lambda + 2 mu) C_F |[u]|²,   [u] = u_T - u_N

over the undeformed interface, with the first Piola-Kirchhoff stress P of the core alone and n out
of the core. Its forces are its derivatives, so what is free stays free of forces; turning the body
turns [u] and P n alike and changes nothing; and for small strains it is the form of
:class:`.coupling.NitscheSpace`.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import sparse

from ..recovery import Material
from .coupling import NitscheSpace


class NitscheTerms:
    """The interface's part of the energy.

    Parameters
    ----------
    space : NitscheSpace
    material : Material
        Of the core.
    """

    def __init__(self, space: NitscheSpace, material: Material) -> None:
        self.space = space
        self.lame, self.shear = material.lame, material.shear
        faces = space.faces
        self._weight = faces.measure
        self._penalty = 2.0 * (self.lame + 2.0 * self.shear) * faces.bound * faces.measure

    @cached_property
    def _gradients(self) -> list[sparse.csr_matrix]:
        return [self.space.of_core(gradient) for gradient in self.space.faces.gradients]

    def _state(self, displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The jump (m, d) and F (m, d, d)."""
        slopes = [gradient @ displacement for gradient in self._gradients]
        deformation = np.stack(slopes, axis=2) + np.eye(displacement.shape[1])
        return self.space.jump @ displacement, deformation

    def energy(self, displacement: np.ndarray) -> float:
        """Energy, mJ."""
        jump, deformation = self._state(displacement)
        push = self._push(deformation)
        work = (jump * push).sum(axis=1)
        return float(0.5 * self._penalty @ (jump**2).sum(axis=1) - self._weight @ work)

    def _hooke(self, strain: np.ndarray) -> np.ndarray:
        """Second Piola-Kirchhoff stress of a strain."""
        trace = np.trace(strain, axis1=1, axis2=2)[:, None, None]
        return 2.0 * self.shear * strain + self.lame * trace * np.eye(strain.shape[1])

    def _stress(self, deformation: np.ndarray) -> np.ndarray:
        """Second Piola-Kirchhoff stress of F, (m, d, d)."""
        return self._hooke(
            0.5 * (np.swapaxes(deformation, 1, 2) @ deformation - np.eye(deformation.shape[1]))
        )

    def _along(self, deformation: np.ndarray, way: np.ndarray) -> np.ndarray:
        """Change of P = F S along a change of F, both (m, d, d)."""
        stress = self._stress(deformation)
        across = np.swapaxes(deformation, 1, 2) @ way
        return way @ stress + deformation @ self._hooke(0.5 * (across + np.swapaxes(across, 1, 2)))

    def _push(self, deformation: np.ndarray) -> np.ndarray:
        """P n."""
        stress = deformation @ self._stress(deformation)
        return (stress @ self.space.faces.normal[:, :, None])[..., 0]

    def forces(self, displacement: np.ndarray) -> np.ndarray:
        """Derivative by the displacement, (size, d), N."""
        jump, deformation = self._state(displacement)
        pressed = self._penalty[:, None] * jump - self._weight[:, None] * self._push(deformation)
        total = self.space.jump.T @ pressed
        way = jump[:, :, None] * self.space.faces.normal[:, None, :]
        change = self._along(deformation, way)
        for axis, gradient in enumerate(self._gradients):
            total -= gradient.T @ (self._weight[:, None] * change[:, :, axis])
        return total

    def tangent(self, displacement: np.ndarray) -> sparse.csr_matrix:
        """Near the derivative of the forces, (d size, d size), N/mm.

        What the jump times the stress' second derivative adds is left out: it is as small as the
        jump.
        """
        _, deformation = self._state(displacement)
        d = deformation.shape[1]
        normal = self.space.faces.normal
        turned = self.space.jump.T
        blocks = [[None] * d for _ in range(d)]
        for i in range(d):
            # P n's component i by F_kL is the change of P's (k, L) along e_i n'
            way = np.zeros_like(deformation)
            way[:, i] = normal
            change = self._along(deformation, way)
            for k in range(d):
                blocks[i][k] = turned @ sum(
                    sparse.diags(self._weight * change[:, k, axis]) @ gradient
                    for axis, gradient in enumerate(self._gradients)
                )
        flux = sparse.bmat(blocks, format="csr")
        penalty = turned @ sparse.diags(self._penalty) @ self.space.jump
        return (sparse.kron(sparse.identity(d), penalty) - flux - flux.T).tocsr()
