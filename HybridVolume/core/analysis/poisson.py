# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Poisson's equation, steady heat: -div(k grad u) = f with u or the flux given on CAD faces."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from .assembly import errors, load
from .boundary import boundary_flux, boundary_projection, given_on_faces
from .coupling import CollocationSpace, NitscheSpace
from .linear import Solved, solved


@dataclass(frozen=True)
class Solution:
    """A scalar field on the hybrid volume.

    Attributes
    ----------
    space : CollocationSpace or NitscheSpace
    values : (size,) array
        Coefficients of the coupled unknowns.
    figures : Solved or None
        How the linear system was solved.
    """

    space: CollocationSpace | NitscheSpace
    values: np.ndarray
    figures: Solved | None = None

    def errors(self, exact: Callable, slope: Callable) -> tuple[float, float]:
        """Errors in L2 and in the H1 seminorm over shell and core, see `assembly.errors`."""
        shell, core = self.space.parts(self.values)
        spline, tets = self.space.spline, self.space.tets
        more = spline.degree + 3
        found = np.array(errors(spline, shell, exact, slope, more))
        found += errors(tets, core, exact, slope, tets.degree + 4)
        return float(np.sqrt(found[0])), float(np.sqrt(found[1]))


def solve_poisson(
    space: CollocationSpace | NitscheSpace,
    source: Callable,
    boundary: Callable | Mapping[str, Callable],
    conductivity: tuple[float, float] = (1.0, 1.0),
    flux: Mapping[str, Callable] | None = None,
) -> Solution:
    """Solve -div(k grad u) = f in the body, u = g on its surface or on some faces.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
    source, boundary : callables
        f and g: take (m, d) points, mm, and return (m,) values. g may be given by CAD face; no
        flux goes through the others.
    conductivity : (float, float)
        k of the shell and of the core.
    flux : mapping of str to callable, optional
        By CAD face: take (m, d) points and return (m,) values of k du/dn, what flows in.

    Raises
    ------
    InputError
        There is no such face, or nothing is given on any.
    FaultError
        The linear system was not solved.
    """
    spline, tets = space.spline, space.tets
    matrix = space.conduction(*conductivity)
    more = spline.degree + 2
    right = space.loaded(load(spline, source, more), load(tets, source, tets.degree + 3))
    for face, function in (flux or {}).items():
        right += space.loaded(boundary_flux(spline, function, [face]), np.zeros(tets.size))
    if isinstance(boundary, Mapping):
        if not boundary:
            raise InputError("u is given on no face", remedy="give it on one face at least")
        fixed, _, given = given_on_faces(spline, boundary)
    else:
        fixed, given = boundary_projection(spline, boundary)
    return Solution(space, *solved(matrix, right, fixed, given))
