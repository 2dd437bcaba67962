# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Problems of ``./run.sh reproduce rates3d`` whose solutions are known.

Solutions are waves, smooth and no polynomials, whose length is that of the body: they are made from
its bounding box alone. The hollow sphere has Lamé's solution. Lengths are mm, stresses MPa.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..core.recovery import Material
from ..core.surface import PatchSurface

Field = Callable[[np.ndarray], np.ndarray]
"""Takes (m, 3) points, mm."""

STEEL_LIKE = Material(1000.0, 0.3)
DIRECTION = np.array([1.0, 0.7, 0.5]) / np.linalg.norm([1.0, 0.7, 0.5])
"""Of the scalar wave."""
DIRECTIONS = np.array([[1.0, 0.4, -0.3], [-0.2, 1.0, 0.5], [0.6, -0.3, 1.0]])
"""Of the waves of the three components."""
PHASE = 0.4
PRESSURE = 1.0
"""In the cavity of the hollow sphere, MPa."""


@dataclass(frozen=True)
class Problem:
    """A solution and what it takes.

    Attributes
    ----------
    words : str
    components : int
        1 for Poisson's equation, 3 for elasticity.
    exact : callable
        (m, components) values.
    slope : callable
        (m, components, 3) derivatives.
    source : callable or None
        (m, components): what -div of the flux or of the stress is; None: nothing.
    pressed : float
        Pressure on cavities, MPa; displacements are given on all other faces.
    material : Material
        Of elasticity.
    """

    words: str
    components: int
    exact: Field
    slope: Field
    source: Field | None
    pressed: float = 0.0
    material: Material = STEEL_LIKE

    def stress(self, slope: np.ndarray) -> np.ndarray:
        """Stress of displacement gradients (..., 3, 3), MPa."""
        strain = 0.5 * (slope + np.swapaxes(slope, -1, -2))
        trace = np.trace(strain, axis1=-2, axis2=-1)[..., None, None]
        return self.material.lame * trace * np.eye(3) + 2.0 * self.material.shear * strain

    def energy(self, slope: np.ndarray) -> np.ndarray:
        """Twice the energy of derivatives (..., components, 3) in each mm³."""
        if self.components == 1:
            return (slope**2).sum(axis=(-2, -1))
        return (self.stress(slope) * slope).sum(axis=(-2, -1))


def wave(surface: PatchSurface) -> Problem:
    """Poisson's equation -div grad u = f, u a sine of one period over the body's diagonal."""
    k = 2.0 * np.pi / surface.diagonal * DIRECTION
    middle = surface.control_points.mean(axis=0)

    def phase(x: np.ndarray) -> np.ndarray:
        return (x - middle) @ k + PHASE

    return Problem(
        "u = sin(k x + 0.4), one period over the diagonal of the body",
        1,
        lambda x: np.sin(phase(x))[:, None],
        lambda x: np.cos(phase(x))[:, None, None] * k,
        lambda x: (k @ k) * np.sin(phase(x))[:, None],
    )


def waves(surface: PatchSurface) -> Problem:
    """Elasticity: each component a sine of its own, body forces to fit."""
    k = 2.0 * np.pi / surface.diagonal * DIRECTIONS
    middle = surface.control_points.mean(axis=0)
    size = 1e-3 * surface.diagonal
    lame, shear = STEEL_LIKE.lame, STEEL_LIKE.shear

    def phase(x: np.ndarray) -> np.ndarray:
        return (x - middle) @ k.T + PHASE

    def source(x: np.ndarray) -> np.ndarray:
        # div sigma = (lame + shear) grad div u + shear laplace u
        sine = size * np.sin(phase(x))
        return (lame + shear) * (sine * np.diag(k)) @ k + shear * sine * (k**2).sum(axis=1)

    return Problem(
        "a sine in each component, one period or less over the diagonal, with body forces",
        3,
        lambda x: size * np.sin(phase(x)),
        lambda x: size * np.cos(phase(x))[:, :, None] * k,
        source,
    )


def lame(surface: PatchSurface) -> Problem:
    """A hollow sphere about the origin with a pressure in its cavity (Lamé)."""
    distance = [
        np.linalg.norm(surface.control_points[patch.index[0, 0]]) for patch in surface.patches
    ]
    inner, outer = min(distance), max(distance)
    share = PRESSURE * inner**3 / (outer**3 - inner**3)
    young, nu = STEEL_LIKE.young, STEEL_LIKE.poisson
    even = share / young * (1.0 - 2.0 * nu)
    falling = 0.5 * share / young * (1.0 + nu) * outer**3

    def slope(x: np.ndarray) -> np.ndarray:
        r = np.linalg.norm(x, axis=1)
        radial = even + falling / r**3
        turned = x[:, :, None] * x[:, None, :] * (3.0 * falling / r**5)[:, None, None]
        return radial[:, None, None] * np.eye(3) - turned

    return Problem(
        "pressure 1 in the cavity, displacements given outside (Lamé)",
        3,
        lambda x: x * (even + falling / np.linalg.norm(x, axis=1) ** 3)[:, None],
        slope,
        None,
        pressed=PRESSURE,
    )


PROBLEMS: dict[str, Callable[[PatchSurface], Problem]] = {
    "poisson": wave,
    "elasticity": waves,
    "lame": lame,
}
