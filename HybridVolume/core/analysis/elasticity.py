# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Linear elasticity on the hybrid volume: given displacements, tractions and body forces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ..recovery import Material
from .assembly import errors, load
from .boundary import boundary_load, boundary_projection
from .coupling import CollocationSpace, NitscheSpace
from .linear import solve_fixed


@dataclass(frozen=True)
class Displacement:
    """A displacement field on the hybrid volume.

    Attributes
    ----------
    space : CollocationSpace or NitscheSpace
    values : (size, d) array
        Coefficients of the coupled unknowns, mm.
    energy : float
        Strain energy, with the terms of the interface, mJ.
    """

    space: CollocationSpace | NitscheSpace
    values: np.ndarray
    energy: float

    def errors(self, exact: Callable, slope: Callable) -> tuple[float, float]:
        """Errors of all components in L2 and in the H1 seminorm over shell and core.

        Parameters
        ----------
        exact, slope : callables
            Take (m, d) points, mm; return (m, d) displacements and (m, d, d) gradients, of which
            ``[:, c, d]`` is the derivative of component c along d.
        """
        shell, core = self.space.parts(self.values)
        spline, tets = self.space.spline, self.space.tets
        more = spline.degree + 3
        found = np.zeros(2)
        for c in range(self.space.dimension):
            field = (lambda x, c=c: exact(x)[:, c]), (lambda x, c=c: slope(x)[:, c])
            found += errors(spline, shell[:, c], *field, more)
            found += errors(tets, core[:, c], *field, tets.degree + 4)
        return float(np.sqrt(found[0])), float(np.sqrt(found[1]))


def solve_elasticity(
    space: CollocationSpace | NitscheSpace,
    materials: Material | Sequence[Material],
    *,
    fixed: Mapping[str, Callable],
    tractions: Mapping[str, Callable] | None = None,
    body_force: Callable | None = None,
) -> Displacement:
    """Solve the static problem.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
    materials : Material or (Material, Material)
        Of the whole body, or of shell and core.
    fixed : mapping of str to callable
        CAD faces with given displacements: take (m, d) points, mm, and return (m, d), mm; a
        component that is nan stays free.
    tractions : mapping of str to callable, optional
        CAD faces with tractions, as for :func:`.boundary.boundary_load`, MPa.
    body_force : callable, optional
        Takes (m, d) points and returns (m, d) forces, N/mm³.

    Raises
    ------
    InputError
        There is no such face, or nothing is fixed.
    FaultError
        The linear system was not solved: the body can still move freely.
    """
    if not fixed:
        raise InputError("nothing is fixed", remedy="give displacements on a face")
    shell, core = (materials, materials) if isinstance(materials, Material) else materials
    spline, tets = space.spline, space.tets
    matrix = space.elasticity(shell, core)
    outside = np.zeros((spline.size, space.dimension))
    for face, traction in (tractions or {}).items():
        outside += boundary_load(spline, traction, [face])
    inside = np.zeros((tets.size, space.dimension))
    if body_force is not None:
        more = spline.degree + 2
        for c in range(space.dimension):
            component = lambda x, c=c: body_force(x)[:, c]  # noqa: E731
            outside[:, c] += load(spline, component, more)
            inside[:, c] = load(tets, component, tets.degree + 3)
    right = space.loaded(outside, inside).T.ravel()
    numbers, values = _given(space, fixed)
    found = solve_fixed(matrix, right, numbers, values)
    energy = 0.5 * float(found @ (matrix @ found))
    return Displacement(space, found.reshape(space.dimension, -1).T, energy)


def _given(
    space: CollocationSpace | NitscheSpace, fixed: Mapping[str, Callable]
) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns with given values; faces that are fixed alike are projected together."""
    alike: dict[Callable, list[str]] = {}
    for face, function in fixed.items():
        alike.setdefault(function, []).append(face)
    known: dict[int, float] = {}
    for function, faces in alike.items():
        unknowns, found = boundary_projection(space.spline, function, faces)
        for c in range(space.dimension):
            held = ~np.isnan(found[:, c])
            known |= dict(
                zip((unknowns[held] + c * space.size).tolist(), found[held, c], strict=True)
            )
    numbers = np.fromiter(known, dtype=np.int64, count=len(known))
    return numbers, np.fromiter(known.values(), dtype=float, count=len(known))
