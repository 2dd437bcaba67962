# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A torus under its own weight, solved to rounding: the reference of an accuracy case.

The torus lies on two soft cushions, a pressure on its surface that is largest at the bottom:
p = p0 ((1 - z / r) / 2)^4 (1 + cos 2 phi), with p0 so that it carries the weight. In cylindrical
coordinates the solution has the harmonics 0 and 2 around z only; in the section each is sought
among polynomials over the disk, so that the error falls exponentially with their degree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from ..core.elements import gauss_line
from ..core.recovery import Material

DEGREE = 16
"""Of the polynomials in the section; the stress stands to about 1e-8 of its maximum."""
WEIGHT = 1.0
"""N on each mm³."""
_POWER = 4
_HARMONICS = (0, 2)


@dataclass(frozen=True)
class HeavyTorus:
    """The solution.

    Attributes
    ----------
    major, minor : float
        Radii, mm.
    material : Material
    weight : float
        N on each mm³, in the direction of -z.
    pressure : float
        p0, MPa.
    coefficients : tuple of (3, nb) arrays
        Of u_R, u_phi and u_z over the section's polynomials, for each harmonic.
    """

    major: float
    minor: float
    material: Material
    weight: float
    pressure: float
    coefficients: tuple[np.ndarray, ...]

    def displacement(self, x: np.ndarray) -> np.ndarray:
        """Displacement of (m, 3) points, mm."""
        return self._fields(x)[0]

    def stress(self, x: np.ndarray) -> np.ndarray:
        """Stress at (m, 3) points, (m, 6), MPa."""
        return self.material.stress(self._fields(x)[1])

    def traction(self, x: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """What the cushions do, MPa."""
        phi = np.arctan2(x[:, 1], x[:, 0])
        return -self.pressure * _cushion(x[:, 2] / self.minor, phi)[:, None] * normal

    def surface_places(self, count: int) -> np.ndarray:
        """Points of the surface over one eighth of the torus, (count * count, 3)."""
        phi, psi = np.meshgrid(
            np.linspace(0, 0.5 * np.pi, count), np.linspace(-np.pi, np.pi, count)
        )
        phi, psi = phi.ravel(), psi.ravel()
        across = self.major + self.minor * np.cos(psi)
        return np.column_stack(
            [across * np.cos(phi), across * np.sin(phi), self.minor * np.sin(psi)]
        )

    def _fields(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement (m, 3) and strain (m, 6) in x, y, z."""
        across = np.hypot(x[:, 0], x[:, 1])
        phi = np.arctan2(x[:, 1], x[:, 0])
        place = np.column_stack([across - self.major, x[:, 2]]) / self.minor
        value, slope = _basis(place)
        slope = slope / self.minor
        u = np.zeros((len(x), 3))
        strain = np.zeros((len(x), 3, 3))
        for n, c in zip(_HARMONICS, self.coefficients, strict=True):
            wave = np.column_stack([np.cos(n * phi), np.sin(n * phi), np.cos(n * phi)])
            u += (value @ c.T) * wave
            strain += _strain(n, phi, across, value @ c.T, np.einsum("mbd,kb->mkd", slope, c))
        turn = np.zeros((len(x), 3, 3))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(phi)
        turn[:, 1, 0], turn[:, 0, 1] = np.sin(phi), -np.sin(phi)
        turn[:, 2, 2] = 1.0
        strain = np.einsum("mia,mab,mjb->mij", turn, strain, turn, optimize=True)
        return (
            np.einsum("mia,ma->mi", turn, u),
            strain[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]],
        )


def _strain(
    n: int, phi: np.ndarray, across: np.ndarray, u: np.ndarray, slope: np.ndarray
) -> np.ndarray:
    """Strain in R, phi, z of u_R cos n phi, u_phi sin n phi, u_z cos n phi, (m, 3, 3)."""
    cosine, sine = np.cos(n * phi), np.sin(n * phi)
    result = np.zeros((len(phi), 3, 3))
    result[:, 0, 0] = slope[:, 0, 0] * cosine
    result[:, 1, 1] = (u[:, 0] + n * u[:, 1]) / across * cosine
    result[:, 2, 2] = slope[:, 2, 1] * cosine
    result[:, 0, 1] = 0.5 * (slope[:, 1, 0] - (u[:, 1] + n * u[:, 0]) / across) * sine
    result[:, 0, 2] = 0.5 * (slope[:, 0, 1] + slope[:, 2, 0]) * cosine
    result[:, 1, 2] = 0.5 * (slope[:, 1, 1] - n * u[:, 2] / across) * sine
    for i, j in ((0, 1), (0, 2), (1, 2)):
        result[:, j, i] = result[:, i, j]
    return result


def _cushion(height: np.ndarray, phi: np.ndarray) -> np.ndarray:
    return (0.5 * (1.0 - height)) ** _POWER * (1.0 + np.cos(2.0 * phi))


def _basis(place: np.ndarray, degree: int = DEGREE) -> tuple[np.ndarray, np.ndarray]:
    """Products of Chebyshev polynomials up to a total degree, (m, nb), and slopes (m, nb, 2)."""
    one = [chebyshev.chebvander(c, degree) for c in place.T]
    lower = chebyshev.chebder(np.eye(degree + 1))
    two = [chebyshev.chebvander(c, degree - 1) @ lower for c in place.T]
    i, j = np.nonzero(np.add.outer(np.arange(degree + 1), np.arange(degree + 1)) <= degree)
    value = one[0][:, i] * one[1][:, j]
    slope = np.stack([two[0][:, i] * one[1][:, j], one[0][:, i] * two[1][:, j]], axis=2)
    return value, slope


def solve(major: float, minor: float, material: Material, degree: int = DEGREE) -> HeavyTorus:
    """Ritz's method in the section, for each harmonic."""
    # the disk and its rim, in units of the minor radius
    count = 2 * degree
    radius, weight = gauss_line(count)
    angle = 2.0 * np.pi * np.arange(2 * count) / (2 * count)
    turn = np.column_stack([np.cos(angle), np.sin(angle)])
    disk = (radius[:, None, None] * turn).reshape(-1, 2)
    area = np.repeat(weight * radius, 2 * count) * 2.0 * np.pi / (2 * count) * minor**2
    value, slope = _basis(disk, degree)
    slope = slope / minor
    across = major + minor * disk[:, 0]
    rim, _ = _basis(turn, degree)
    rim_across = major + minor * turn[:, 0]
    line = 2.0 * np.pi / (2 * count) * minor * rim_across
    press = (0.5 * (1.0 - turn[:, 1])) ** _POWER
    # upward force of the pressure 1, over 2 pi as the weight
    up = -(line * press * turn[:, 1]).sum()
    pressure = WEIGHT * (area * across).sum() / up
    lame = material.young * material.poisson
    lame /= (1.0 + material.poisson) * (1.0 - 2.0 * material.poisson)
    shear = material.young / (2.0 * (1.0 + material.poisson))
    found = []
    nb = value.shape[1]
    for n in _HARMONICS:
        u_over, none = value / across[:, None], np.zeros_like(value)
        # rows of strain for unknowns (u_R, u_phi, u_z); shear strains are those of the tensor
        rows = {
            "rr": (slope[..., 0], none, none),
            "tt": (u_over, n * u_over, none),
            "zz": (none, none, slope[..., 1]),
            "rt": (-0.5 * n * u_over, 0.5 * (slope[..., 0] - u_over), none),
            "rz": (0.5 * slope[..., 1], none, 0.5 * slope[..., 0]),
            "tz": (none, 0.5 * slope[..., 1], -0.5 * n * u_over),
        }
        rows = {key: np.concatenate(parts, axis=1) for key, parts in rows.items()}
        volume = (area * across)[:, None]
        trace = rows["rr"] + rows["tt"] + rows["zz"]
        stiffness = lame * trace.T @ (volume * trace)
        for key, row in rows.items():
            times = 2.0 * shear * (1.0 if key[0] == key[1] else 2.0)
            stiffness += times * row.T @ (volume * row)
        force = np.zeros(3 * nb)
        push = -pressure * line * press
        force[:nb] = (push * turn[:, 0]) @ rim
        force[2 * nb :] = (push * turn[:, 1]) @ rim
        if n == 0:
            force[2 * nb :] -= WEIGHT * volume[:, 0] @ value
            # nothing turns about z
            stiffness[nb : 2 * nb] = stiffness[:, nb : 2 * nb] = 0.0
            stiffness[nb : 2 * nb, nb : 2 * nb] = np.eye(nb) * np.trace(stiffness) / (2 * nb)
        # a displacement along z has no stiffness
        diagonal = np.diag(stiffness)
        size = 1.0 / np.sqrt(np.where(diagonal > 1e-12 * diagonal.max(), diagonal, diagonal.max()))
        scaled = stiffness * size[:, None] * size
        solution, *_ = np.linalg.lstsq(scaled, size * force, rcond=1e-13)
        found.append((size * solution).reshape(3, nb))
    return HeavyTorus(major, minor, material, WEIGHT, pressure, tuple(found))
