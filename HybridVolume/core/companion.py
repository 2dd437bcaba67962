# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A surface of low degree beside one of high degree, on which columns are found more easily.

CAD files have splines of degree 8 and 14. Their nets have many points a span, whose columns are
hardly held by the body's shape: fronts fold, and short net edges allow only small steps. A shell
needs no such freedom. So columns are grown on cubic splines through the surface, with the same
patches and parameters, and the displacements that are found there are interpolated by those of the
surface itself. Only the start of the optimisation rests on that: what counts is proved on the
surface itself, as always.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import splu

from . import bspline
from .surface import Patch, PatchSurface

HIGHEST = 5
"""Degree up to which columns are found on the surface itself."""
LOW = 3
"""Degree instead of higher ones."""


def needs_companion(surface: PatchSurface) -> bool:
    """Whether a patch has a degree above `HIGHEST`."""
    return max(max(patch.degrees) for patch in surface.patches) > HIGHEST


def companion(surface: PatchSurface) -> PatchSurface:
    """Polynomial splines of low degree through the points of a surface at their Greville points.

    Parameters
    ----------
    surface : PatchSurface

    Returns
    -------
    PatchSurface
        With the same patches, sides and parameters; spans of a high degree are cut into some.
    """
    lines = [tuple(map(_lowered, p.degrees, p.knots)) for p in surface.patches]
    shapes = [tuple(len(knots) - degree - 1 for degree, knots in line) for line in lines]
    grids, count = surface.shared_grid(shapes)
    patches = tuple(
        Patch(patch.face, (u[0], v[0]), (u[1], v[1]), grid, np.ones(grid.shape))
        for patch, (u, v), grid in zip(surface.patches, lines, grids, strict=True)
    )
    blank = PatchSurface(
        np.zeros((count, 3)),
        patches,
        surface.neighbour,
        surface.reversed,
        surface.shell_of_patch,
        surface.moved,
        surface.exact,
        surface.turned,
    )
    patch, uv = _places(blank)
    nodal = blank.basis_at(patch, *uv.T)
    points = splu(nodal.tocsc()).solve(surface.evaluate_at(patch, *uv.T))
    return blank.with_points(points)


def carried(values: np.ndarray, low: PatchSurface, high: PatchSurface) -> np.ndarray:
    """Coefficients on a surface that interpolate those on its companion.

    Parameters
    ----------
    values : (nl, 3) array
        Coefficients of the companion's splines.
    low, high : PatchSurface

    Returns
    -------
    (n, 3) array
        Of the polynomial splines of ``high``; equal values stay equal.
    """
    patch, uv = _places(high)
    there = low.basis_at(patch, *uv.T) @ values
    return splu(high.basis_at(patch, *uv.T).tocsc()).solve(there)


def _lowered(degree: int, knots: np.ndarray) -> tuple[int, np.ndarray]:
    """A lower degree and its knots; no less smooth than before where that can be."""
    if degree <= HIGHEST:
        return degree, knots
    values, times = bspline.multiplicities(knots)
    parts = -(-degree // HIGHEST)
    inner = np.concatenate(
        [np.linspace(a, b, parts + 1)[1:-1] for a, b in zip(values[:-1], values[1:], strict=True)]
    )
    again = np.clip(LOW - degree + times[1:-1], 1, LOW)
    ends = np.repeat(values[[0, -1]], LOW + 1)
    return LOW, np.sort(np.concatenate([ends, inner, np.repeat(values[1:-1], again)]))


def _places(surface: PatchSurface) -> tuple[np.ndarray, np.ndarray]:
    """Patch and parameters of the Greville point of each control point, (n,) and (n, 2)."""
    mesh = surface.triangulation("greville")
    return mesh.vertex_patch, mesh.vertex_uv
