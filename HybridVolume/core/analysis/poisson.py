# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Poisson's equation, steady heat: -div(k grad u) = f with u given on the outer boundary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from ...errors import FaultError
from ..elements import gauss_line
from .assembly import errors, load, stiffness
from .coupling import CollocationSpace, NitscheSpace
from .spline_space import SplineSpace

_BLOCK = 100_000
_RESIDUAL = 1e-8
"""Relative residual from which on a solution is refused."""


@dataclass(frozen=True)
class Solution:
    """A scalar field on the hybrid volume.

    Attributes
    ----------
    space : CollocationSpace or NitscheSpace
    values : (size,) array
        Coefficients of the coupled unknowns.
    """

    space: CollocationSpace | NitscheSpace
    values: np.ndarray

    def errors(self, exact: Callable, slope: Callable) -> tuple[float, float]:
        """Errors in L2 and in the H1 seminorm over shell and core, see `assembly.errors`."""
        shell, core = self.space.parts(self.values)
        spline, tets = self.space.spline, self.space.tets
        more = max(max(g.degrees) for g in spline.shell.surface.groups) + 3
        found = np.array(errors(spline, shell, exact, slope, more))
        found += errors(tets, core, exact, slope, tets.degree + 4)
        return float(np.sqrt(found[0])), float(np.sqrt(found[1]))


def solve_poisson(
    space: CollocationSpace | NitscheSpace,
    source: Callable,
    boundary: Callable,
    conductivity: tuple[float, float] = (1.0, 1.0),
) -> Solution:
    """Solve -div(k grad u) = f in the body, u = g on its surface.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
    source, boundary : callables
        f and g: take (m, 3) points, mm, and return (m,) values.
    conductivity : (float, float)
        k of the shell and of the core.

    Raises
    ------
    FaultError
        The linear system was not solved.
    """
    spline, tets = space.spline, space.tets
    outer, inner = conductivity
    matrix = space.together(outer * stiffness(spline), inner * stiffness(tets), inner)
    more = max(max(g.degrees) for g in spline.shell.surface.groups) + 2
    right = space.loaded(load(spline, source, more), load(tets, source, tets.degree + 3))
    values = np.zeros(space.size)
    values[spline.outer] = boundary_projection(spline, boundary)
    free = np.setdiff1d(np.arange(space.size), spline.outer)
    right = (right - matrix @ values)[free]
    inside = matrix[free][:, free].tocsc()
    values[free] = spsolve(inside, right)
    residual = np.linalg.norm(inside @ values[free] - right)
    scale = max(np.linalg.norm(right), 1e-300)
    if not residual <= _RESIDUAL * scale:
        raise FaultError(
            f"the linear system of {len(free)} unknowns was not solved (residual"
            f" {residual / scale:.2g})",
            figure=float(residual / scale),
        )
    return Solution(space, values)


def boundary_projection(spline: SplineSpace, function: Callable) -> np.ndarray:
    """Coefficients of the outer boundary's functions that are nearest to a function in L2.

    Parameters
    ----------
    spline : SplineSpace
    function : callable
        Takes (m, 3) points, mm, and returns (m,) or (m, c) values.

    Returns
    -------
    (columns,) or (columns, c) array
    """
    surface = spline.shell.surface
    x, weight = gauss_line(max(max(g.degrees) for g in surface.groups) + 3)
    weights = np.outer(weight, weight).ravel()
    matrix = sparse.csr_matrix((spline.columns, spline.columns))
    right: np.ndarray | float = 0.0
    count = surface.element_count
    for block in np.array_split(np.arange(count), 1 + count * len(weights) // _BLOCK):
        samples = surface.element_samples(x, x, block)
        points, along_u, along_v = samples.surface(surface.control_points)
        values = sparse.diags(1.0 / samples.weight) @ samples.weighted
        area = np.linalg.norm(np.cross(along_u, along_v), axis=1) * np.tile(weights, len(block))
        scaled = sparse.diags(area) @ values
        matrix = matrix + values.T @ scaled
        right = right + scaled.T @ function(points)
    return spsolve(matrix.tocsc(), right)
