# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The set W: where the layers of control points stand on straight columns (section 3.2)."""

from __future__ import annotations

import numpy as np

from . import bspline
from .surface import PatchSurface


def uniform_layers(
    points: np.ndarray,
    displacement: np.ndarray,
    degree: int,
    knots: np.ndarray,
) -> np.ndarray:
    """Layers at the Greville abscissae: the map is linear in w.

    Parameters
    ----------
    points, displacement : (n, 3) arrays
        Control points of the surface and how far their columns reach, mm.
    degree : int
    knots : array
        Clamped, on [0, 1].

    Returns
    -------
    (nw, n, 3) array; layer 0 is ``points`` itself
    """
    shares = bspline.greville(degree, knots)
    layers = points + shares[:, None, None] * displacement
    layers[0] = points
    layers[-1] = points + displacement
    return layers


def equal_volume_layers(
    points: np.ndarray,
    displacement: np.ndarray,
    degree: int,
    knots: np.ndarray,
    surface: PatchSurface,
) -> np.ndarray:
    """Layers that cut every column into knot spans of equal volume.

    The volume of a column up to the share t is V(t), the integral of (area vector at t) . D; the
    area vector is quadratic in t, so three levels give it exactly. The layers interpolate
    V^-1 at the Greville abscissae; since all columns stay straight, det J only changes by the
    factor of the re-spacing.

    Parameters and result as for :func:`uniform_layers`, and the surface whose net gives the area
    vectors.
    """
    shares = bspline.greville(degree, knots)
    uniform = uniform_layers(points, displacement, degree, knots)
    rate = np.array(
        [
            np.einsum("li,li->l", _area_vectors(surface, points + t * displacement), displacement)
            for t in (0.0, 0.5, 1.0)
        ]
    )
    # quadratic through t = 0, 1/2, 1; its integral is the cumulated volume
    a = rate[0]
    b = -3.0 * rate[0] + 4.0 * rate[1] - rate[2]
    c = 2.0 * rate[0] - 4.0 * rate[1] + 2.0 * rate[2]
    t = np.linspace(0.0, 1.0, 129)[:, None]
    volume = t * (a + t * (b / 2.0 + t * c / 3.0))
    usable = np.all(np.diff(volume, axis=0) > 1e-6 * np.abs(volume[-1]) / 128, axis=0)
    share_at = np.tile(shares[:, None], (1, len(points)))
    for column in np.flatnonzero(usable):
        share_at[:, column] = np.interp(shares, volume[:, column] / volume[-1, column], t[:, 0])
    collocation = bspline.basis_matrix(degree, knots, shares).toarray()
    spread = np.linalg.solve(collocation, share_at)
    # a column whose spline would not rise everywhere keeps the even spacing
    rising = np.all(np.diff(spread, axis=0) > 0.02 * np.diff(shares)[:, None], axis=0)
    spread = np.where(rising, spread, shares[:, None])
    layers = points + spread[..., None] * displacement
    layers[0], layers[-1] = uniform[0], uniform[-1]
    return layers


def _area_vectors(surface: PatchSurface, points: np.ndarray) -> np.ndarray:
    """Inward dual area vector of every control point on the net, (n, 3), mm²."""
    area = np.zeros_like(points)
    for patch in surface.patches:
        grid = patch.index
        x = points[grid]
        cell = -0.5 * np.cross(x[1:, 1:] - x[:-1, :-1], x[:-1, 1:] - x[1:, :-1]) / 4.0
        for corner in (grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]):
            np.add.at(area, corner, cell)
    return area
