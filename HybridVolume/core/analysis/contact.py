# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Contact with a rigid plane by penalty, without friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from ...errors import InputError
from .assembly import Space
from .coupling import CollocationSpace, NitscheSpace


@dataclass(frozen=True)
class PlaneContact:
    """A rigid plane that presses back where a body's boundary is behind it.

    The plane is n . x = offset; bodies stand where n . x is larger. A depth g behind it costs
    stiffness / 2 g² for each mm² of the undeformed boundary.

    Attributes
    ----------
    normal : (d,) array
        Towards the side that is free; of any length but 0.
    offset : float
        Distance of the plane from the origin along the normal, mm.
    stiffness : float
        Pressure for each mm of depth, MPa/mm. About ten times Young's modulus over the size of the
        elements on the boundary keeps the depth small and the systems well conditioned.
    faces : sequence of str, optional
        CAD faces that may touch; all by default.

    Raises
    ------
    InputError
        The normal has no length or the stiffness is none.
    """

    normal: np.ndarray
    offset: float
    stiffness: float
    faces: Sequence[str] | None = field(default=None)

    def __post_init__(self) -> None:
        normal = np.asarray(self.normal, dtype=float)
        length = float(np.linalg.norm(normal))
        if not (np.isfinite(length) and length > 0.0 and normal.ndim == 1):
            raise InputError(f"plane with the normal {self.normal}", remedy="give it a direction")
        if not 0.0 < self.stiffness < np.inf:
            raise InputError(
                f"contact stiffness {self.stiffness} MPa/mm", remedy="give one above 0"
            )
        object.__setattr__(self, "normal", normal / length)

    def of(self, space: CollocationSpace | NitscheSpace | Space) -> BoundContact:
        """The plane with the boundary of a body.

        Parameters
        ----------
        space : CollocationSpace, NitscheSpace or a single space with samples on the boundary

        Raises
        ------
        InputError
            There is no such face, or plane and body differ in dimension.
        """
        side = getattr(space, "spline", space)
        if side.dimension != len(self.normal):
            raise InputError(
                f"a plane with {len(self.normal)} coordinates for a body with {side.dimension}",
                remedy="give the normal as many",
            )
        parts = list(side.boundary_samples(self.faces))
        values = sparse.vstack([s.values for s in parts], format="coo")
        # the shell's unknowns come first in all spaces
        columns = np.asarray(side.outer)[values.col]
        shape = (values.shape[0], space.size)
        return BoundContact(
            self,
            np.concatenate([s.points @ self.normal for s in parts]) - self.offset,
            sparse.csr_matrix((values.data, (values.row, columns)), shape=shape),
            np.concatenate([s.measure for s in parts]),
        )


@dataclass(frozen=True)
class BoundContact:
    """A plane and the quadrature points on the boundary of a body.

    Attributes
    ----------
    plane : PlaneContact
    gap : (m,) array
        Distance of the undeformed points from the plane, mm, negative behind it.
    values : (m, size) sparse matrix
        Functions of the space there.
    measure : (m,) array
        Area (in the plane: length) times the weight of the quadrature.
    """

    plane: PlaneContact
    gap: np.ndarray
    values: sparse.csr_matrix
    measure: np.ndarray

    def depth(self, displacement: np.ndarray) -> np.ndarray:
        """How far points are behind the plane, (m,), mm; 0 in front of it."""
        return np.maximum(-(self.gap + self.values @ (displacement @ self.plane.normal)), 0.0)

    def energy(self, displacement: np.ndarray) -> float:
        """Energy of the penalty, mJ."""
        depth = self.depth(displacement)
        return 0.5 * self.plane.stiffness * float(self.measure @ depth**2)

    def pressures(self, displacement: np.ndarray) -> np.ndarray:
        """Pressure at the points, (m,), MPa."""
        return self.plane.stiffness * self.depth(displacement)

    def forces(self, displacement: np.ndarray) -> np.ndarray:
        """Derivative of the energy by the displacement, (size, d), N."""
        push = self.values.T @ (self.measure * self.pressures(displacement))
        return -push[:, None] * self.plane.normal

    def tangent(self, displacement: np.ndarray) -> sparse.csr_matrix:
        """Derivative of the forces, (d size, d size), N/mm."""
        return self._stiffness((self.depth(displacement) > 0.0).astype(float))

    def forces_between(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Forces whose work between two displacements is the change of the energy, (size, d), N."""
        pressure, _ = self._between(before, after)
        push = self.values.T @ (self.measure * self.plane.stiffness * pressure)
        return -push[:, None] * self.plane.normal

    def tangent_between(self, before: np.ndarray, after: np.ndarray) -> sparse.csr_matrix:
        """Derivative of :meth:`forces_between` by the later displacement, (d size, d size)."""
        return self._stiffness(self._between(before, after)[1])

    def _between(self, before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Difference quotients of depth² / 2 by the way into the plane, and their derivatives."""
        first, last = (-(self.gap + self.values @ (u @ self.plane.normal)) for u in (before, after))
        inside, end = np.maximum(first, 0.0), np.maximum(last, 0.0)
        # where a point comes or goes the way is longer than the depth; elsewhere it cancels out
        crossing = (first > 0.0) != (last > 0.0)
        way = np.where(crossing, last - first, 1.0)
        quotient = np.where(crossing, 0.5 * (end**2 - inside**2) / way, 0.5 * (inside + end))
        both = np.where((first > 0.0) & (last > 0.0), 0.5, 0.0)
        return quotient, np.where(crossing, (end - quotient) / way, both)

    def _stiffness(self, share: np.ndarray) -> sparse.csr_matrix:
        """Stiffness of points of which each has a share of the penalty's."""
        touching = np.flatnonzero(share > 0.0)
        part = self.values[touching]
        weight = sparse.diags(self.plane.stiffness * (share * self.measure)[touching])
        normal = self.plane.normal
        return sparse.kron(np.outer(normal, normal), part.T @ weight @ part, format="csr")
