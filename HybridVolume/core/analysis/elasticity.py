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
from .boundary import boundary_load, given_on_faces
from .coupling import CollocationSpace, NitscheSpace
from .linear import Solved, solved
from .rigid import coefficient_points, free_motions, holding, rigid_motions, without_motion

_BALANCED = 1e-4
"""Share of the largest load that may act on what holds a body whose loads balance."""


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
    reactions : (size, d) array
        Forces on the unknowns beyond the loads, N: what the given displacements need.
    figures : Solved or None
        How the linear system was solved.
    """

    space: CollocationSpace | NitscheSpace
    values: np.ndarray
    energy: float
    reactions: np.ndarray
    figures: Solved | None = None

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
    body_force: Callable | tuple[Callable, Callable] | None = None,
    balanced: bool = False,
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
    body_force : callable or (callable, callable), optional
        Takes (m, d) points and returns (m, d) forces, N/mm³; one for both or for shell and core.
    balanced : bool
        Nothing is fixed, the loads balance: the displacement has no rigid part (in L2).

    Raises
    ------
    InputError
        There is no such face, nothing is fixed or not enough that the body cannot move freely, or
        the loads of a free body do not balance.
    FaultError
        The linear system was not solved.
    """
    if not fixed and not balanced:
        raise InputError("nothing is fixed", remedy="give displacements on a face")
    if fixed and balanced:
        raise InputError("faces are fixed", remedy="leave out `balanced`")
    shell, core = (materials, materials) if isinstance(materials, Material) else materials
    spline, tets = space.spline, space.tets
    matrix = space.elasticity(shell, core)
    outside = np.zeros((spline.size, space.dimension))
    for face, traction in (tractions or {}).items():
        outside += boundary_load(spline, traction, [face])
    inside = np.zeros((tets.size, space.dimension))
    if body_force is not None:
        weights = (body_force, body_force) if callable(body_force) else body_force
        more = spline.degree + 2
        for c in range(space.dimension):
            around, within = (lambda x, c=c, weight=weight: weight(x)[:, c] for weight in weights)
            outside[:, c] += load(spline, around, more)
            inside[:, c] = load(tets, within, tets.degree + 3)
    right = space.loaded(outside, inside).T.ravel()
    if balanced:
        unknown, component = holding(space)
        values = np.zeros(len(unknown))
    else:
        unknown, component, values = given_on_faces(spline, fixed, space.dimension)
        _require_held(space, unknown, component)
    motions = np.swapaxes(rigid_motions(coefficient_points(space)), 1, 2)
    found, figures = solved(
        matrix,
        right,
        unknown + component * space.size,
        values,
        motions.reshape(len(motions), -1),
    )
    forces = matrix @ found
    reactions = (forces - right).reshape(space.dimension, -1).T
    field = found.reshape(space.dimension, -1).T
    if balanced:
        held = np.abs(reactions[unknown, component]).max()
        if not held <= _BALANCED * np.abs(right).sum():
            raise InputError(
                f"the loads do not balance: {held:.3g} N act on what would hold the body",
                figure=float(held),
                remedy="fix a face",
            )
        field = without_motion(space, field)
    return Displacement(space, field, 0.5 * float(found @ forces), reactions, figures)


def _require_held(
    space: CollocationSpace | NitscheSpace, unknown: np.ndarray, component: np.ndarray
) -> None:
    """Refuse supports that let the body move: loads may not act that way, and hide it."""
    count = free_motions(space, unknown, component)
    if count:
        raise InputError(
            f"the supports leave the body {count} rigid motion{'s' * (count > 1)}",
            figure=float(count),
            remedy="give values at enough faces that the body cannot move freely",
        )
