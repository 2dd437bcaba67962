# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Elastic fields that are known exactly, on bodies of untrimmed faces.

Lengths are mm, stresses MPa. Stress has the components xx, yy, zz, xy, xz, yz.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np

from ..core.recovery import Material, tensor, von_mises
from . import fem_torus
from .fem_bodies import FemBody, beam, even, graded, holed_quarter, hollow_sphere, torus, tube

Field = Callable[[np.ndarray], np.ndarray]
"""Takes (m, 3) points, returns (m,), (m, 3) or (m, 6) values."""
Traction = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Takes (m, 3) points and (m, 3) unit normals out of the body, returns (m, 3) tractions, MPa."""

STEEL_LIKE = Material(1000.0, 0.3)
_SERIES = 400
"""Terms of the beam's shear: 1e-4 of the shear is left, 1e-5 of the bending stress."""


@dataclass(frozen=True)
class Problem:
    """A body with its loads and supports, and the exact answer.

    Attributes
    ----------
    name, words : str
    body : FemBody
    displacement, stress : callable
        Exact, (m, 3) mm and (m, 6) MPa.
    stressed : tuple of str
        Roles of the faces whose stress is judged: those that are neither planes of symmetry nor
        places where the body is thought to be cut.
    tractions : mapping of str to callable
        By role. Faces that are not named here or in ``held`` are free.
    held : mapping of str to tuple of int
        Components that are prescribed, with their exact values, on the faces of a role.
    supports : tuple of (point, tuple of int)
        Components that are prescribed at a vertex of the body. A body that is only held by these
        floats, and errors of displacement are told without its rigid motion.
    weight : (3,) tuple
        Force on each mm³, N.
    balance : str
        Role whose traction is scaled until it and the weight are in balance on the mesh itself.
    near : tuple of str
        Roles of the faces near which elements should be small; all faces, where none is named.
    slope : float
        Growth of the size of elements a mm away from them, as a share of the smallest size.
    level : float
        w0 of the hybrid volume's shell.
    densities : tuple of (int, int)
        Of the hybrid meshes: into how many parts each knot span is cut, and the layers of wedges.
    sizes : mapping of str to tuple of float
        Smallest size of the elements of other meshers, mm.
    """

    name: str
    words: str
    body: FemBody
    displacement: Field
    stress: Field
    stressed: tuple[str, ...]
    tractions: Mapping[str, Traction] = field(default_factory=dict)
    held: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    supports: tuple[tuple[tuple[float, float, float], tuple[int, ...]], ...] = ()
    weight: tuple[float, float, float] = (0.0, 0.0, 0.0)
    balance: str = ""
    near: tuple[str, ...] = ()
    slope: float = 2.0
    material: Material = STEEL_LIKE
    level: float = 0.6
    densities: tuple[tuple[int, int], ...] = ((1, 1), (1, 2), (2, 1), (2, 2))
    sizes: Mapping[str, tuple[float, ...]] = field(
        default_factory=lambda: {
            "tet10": (0.5, 0.35, 0.25, 0.18),
            "tet10-graded": (0.5, 0.35, 0.25, 0.18),
            "netgen-layers": (0.5, 0.35, 0.25, 0.18),
        }
    )
    peak_at: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def floats(self) -> bool:
        """Whether only single points hold the body."""
        return bool(self.supports)

    @cached_property
    def peak(self) -> float:
        """Largest von Mises stress on the judged faces, MPa."""
        return float(von_mises(self.stress(self.peak_at)).max())

    @cached_property
    def scale(self) -> float:
        """Norm of the stress tensor there, MPa: errors are shares of it."""
        return float(np.linalg.norm(tensor(self.stress(self.peak_at)), axis=(1, 2)).max())


def _pressure(value: float) -> Traction:
    return lambda x, normal: -value * normal


def _stress_of(field: Field) -> Traction:
    """Traction of a stress field on the faces where a body is thought to be cut."""
    return lambda x, normal: np.einsum("mij,mj->mi", tensor(field(x)), normal)


def _components(tensors: np.ndarray) -> np.ndarray:
    return tensors[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


# ------------------------------------------------------------------------------ thick walls


def thick_cylinder(inner: float = 1.0, outer: float = 2.0, height: float = 1.0) -> Problem:
    """Whole tube with free ends under pressure 1 in its bore (Lamé)."""
    material = STEEL_LIKE
    a = inner**2 / (outer**2 - inner**2)
    b = a * outer**2

    def displacement(x: np.ndarray) -> np.ndarray:
        r2 = x[:, 0] ** 2 + x[:, 1] ** 2
        nu, young = material.poisson, material.young
        radial = ((1.0 - nu) * a + (1.0 + nu) * b / r2) / young
        return np.column_stack([x[:, :2] * radial[:, None], -2.0 * nu * a / young * x[:, 2]])

    def stress(x: np.ndarray) -> np.ndarray:
        r2 = x[:, 0] ** 2 + x[:, 1] ** 2
        way = x[:, :2] / np.sqrt(r2)[:, None]
        result = np.zeros((len(x), 3, 3))
        outer_product = way[:, :, None] * way[:, None, :]
        along = a + b / r2
        result[:, :2, :2] = along[:, None, None] * np.eye(2)
        result[:, :2, :2] -= (2.0 * b / r2)[:, None, None] * outer_product
        return _components(result)

    return Problem(
        "cylinder",
        "thick tube, radii 1 and 2, height 1, pressure in the bore, free ends (Lamé)",
        tube(inner, outer, height, even(4), graded(3, 1.4), ()),
        displacement,
        stress,
        ("bore", "outside"),
        tractions={"bore": _pressure(1.0)},
        supports=(
            ((outer, 0.0, 0.0), (0, 1, 2)),
            ((-outer, 0.0, 0.0), (1, 2)),
            ((0.0, outer, 0.0), (2,)),
        ),
        near=("bore",),
        slope=1.0 / inner,
        peak_at=np.array([[inner, 0.0, 0.0]]),
    )


def thick_sphere(inner: float = 1.0, outer: float = 2.0) -> Problem:
    """Whole ball with a cavity under pressure 1 (Lamé)."""
    material = STEEL_LIKE
    a, b3 = inner**3 / (outer**3 - inner**3), outer**3

    def displacement(x: np.ndarray) -> np.ndarray:
        r3 = np.linalg.norm(x, axis=1) ** 3
        nu = material.poisson
        radial = a / material.young * (1.0 - 2.0 * nu + 0.5 * (1.0 + nu) * b3 / r3)
        return x * radial[:, None]

    def stress(x: np.ndarray) -> np.ndarray:
        r = np.linalg.norm(x, axis=1)
        way = x / r[:, None]
        hoop = a * (1.0 + 0.5 * b3 / r**3)
        less = hoop - a * (1.0 - b3 / r**3)
        result = hoop[:, None, None] * np.eye(3)
        return _components(result - less[:, None, None] * way[:, :, None] * way[:, None, :])

    corner = outer / np.sqrt(3.0)
    return Problem(
        "sphere",
        "hollow sphere, radii 1 and 2, pressure in the cavity (Lamé)",
        hollow_sphere(inner, outer, even(2)),
        displacement,
        stress,
        ("cavity", "outside"),
        tractions={"cavity": _pressure(1.0)},
        supports=(
            ((corner, corner, corner), (0, 1, 2)),
            ((-corner, corner, corner), (1, 2)),
            ((corner, -corner, corner), (2,)),
        ),
        near=("cavity",),
        level=0.8,
        densities=((1, 2), (2, 1), (2, 2), (3, 2)),
        sizes={
            "tet10": (0.7, 0.5, 0.35, 0.28),
            "tet10-graded": (0.5, 0.35, 0.25, 0.18),
            "netgen-layers": (0.7, 0.5, 0.35, 0.28),
        },
        slope=2.0 / inner,
        peak_at=np.array([[inner, 0.0, 0.0]]),
    )


# ------------------------------------------------------------------------- plate with a hole


def holed_plate(radius: float = 1.0, side: float = 4.0, height: float = 1.0) -> Problem:
    """Quarter of a plate with a hole in plane strain, pulled by 1 along x (Kirsch)."""
    material = STEEL_LIKE
    kappa = 3.0 - 4.0 * material.poisson
    shear = material.young / (2.0 * (1.0 + material.poisson))

    def polar(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.hypot(x[:, 0], x[:, 1]) / radius, np.arctan2(x[:, 1], x[:, 0])

    def displacement(x: np.ndarray) -> np.ndarray:
        r, t = polar(x)
        along = r * (kappa + 1.0) * np.cos(t)
        along += 2.0 / r * ((1.0 + kappa) * np.cos(t) + np.cos(3.0 * t))
        along -= 2.0 / r**3 * np.cos(3.0 * t)
        across = r * (kappa - 3.0) * np.sin(t)
        across += 2.0 / r * ((1.0 - kappa) * np.sin(t) + np.sin(3.0 * t))
        across -= 2.0 / r**3 * np.sin(3.0 * t)
        return radius / (8.0 * shear) * np.column_stack([along, across, np.zeros(len(x))])

    def stress(x: np.ndarray) -> np.ndarray:
        r, t = polar(x)
        near, far = 1.5 / r**4, 1.0 / r**2
        result = np.zeros((len(x), 6))
        result[:, 0] = 1.0 - far * (1.5 * np.cos(2 * t) + np.cos(4 * t)) + near * np.cos(4 * t)
        result[:, 1] = -far * (0.5 * np.cos(2 * t) - np.cos(4 * t)) - near * np.cos(4 * t)
        result[:, 3] = -far * (0.5 * np.sin(2 * t) + np.sin(4 * t)) + near * np.sin(4 * t)
        result[:, 2] = material.poisson * (result[:, 0] + result[:, 1])
        return result

    return Problem(
        "plate",
        "quarter of a plate with a hole, 4 x 4 x 1, radius 1, plane strain (Kirsch)",
        holed_quarter(radius, side, height, even(4), graded(5, 1.5), ()),
        displacement,
        stress,
        ("hole",),
        densities=((1, 1), (1, 2), (2, 2), (2, 3)),
        sizes={
            "tet10": (0.7, 0.5, 0.35, 0.25),
            "tet10-graded": (0.35, 0.25, 0.18, 0.12),
            "netgen-layers": (0.7, 0.5, 0.35, 0.25),
        },
        tractions={"far": _stress_of(stress)},
        held={"symmetry x": (0,), "symmetry y": (1,), "bottom": (2,), "top": (2,)},
        near=("hole",),
        slope=1.0 / radius,
        peak_at=np.array([[0.0, radius, 0.0]]),
    )


# -------------------------------------------------------------------------------- cantilever


def _power_series(coefficients: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Sum of coefficients times q, q², ... by Horner's scheme; shape of q."""
    total = np.zeros_like(q)
    for coefficient in coefficients[::-1]:
        total += coefficient
        total *= q
    return total


def cantilever(length: float = 10.0, width: float = 2.0, force: float = 1.0) -> Problem:
    """Bar of a square section, bent by a force at its end (Saint-Venant).

    The root has its exact displacement and the tip its exact traction, so that there is no
    singularity; the sides are free. The flexure function is Φ = A y + B (y³ - 3 y z²) + Ψ with
    ΔΨ = 0 (Timoshenko and Goodier, articles 102 and 105).
    """
    material = STEEL_LIKE
    half = 0.5 * width
    nu = material.poisson
    inertia = width**4 / 12.0
    factor = force / (material.young * inertia)
    linear = half**2 * (nu / 3.0 - 1.0 - nu)
    cubic = (2.0 + nu) / 6.0
    n = np.arange(1, _SERIES + 1)
    rate = n * np.pi / half
    amplitude = 4.0 * nu * half**3 * (-1.0) ** n / (n * np.pi) ** 3

    def flexure(y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Φ and its derivatives."""
        # sinh and cosh over cosh(rate * half) times cos and sin are real and imaginary parts of
        # powers of two complex numbers inside the unit circle: polynomials, without overflow
        step = np.pi / half
        up = np.exp(step * (y - half + 1j * z))
        down = np.exp(step * (-y - half + 1j * z))
        share = amplitude / (1.0 + np.exp(-2.0 * rate * half))
        psi = (_power_series(share, up) - _power_series(share, down)).real
        rising, falling = _power_series(share * rate, up), _power_series(share * rate, down)
        psi_y, psi_z = (rising + falling).real, (falling - rising).imag
        value = linear * y + cubic * (y**3 - 3.0 * y * z**2) + psi
        along_y = linear + 3.0 * cubic * (y**2 - z**2) + psi_y
        return value, along_y, -6.0 * cubic * y * z + psi_z

    def displacement(points: np.ndarray) -> np.ndarray:
        x, y, z = points.T
        left = length - x
        value = flexure(y, z)[0]
        along = -(y * (length * x - 0.5 * x**2) + value + y * z**2)
        down = 0.5 * nu * left * (y**2 - z**2) + 0.5 * length * x**2 - x**3 / 6.0
        return factor * np.column_stack([along, down, nu * left * y * z])

    def stress(points: np.ndarray) -> np.ndarray:
        x, y, z = points.T
        _, along_y, along_z = flexure(y, z)
        shear = -factor * material.young / (2.0 * (1.0 + nu))
        result = np.zeros((len(x), 6))
        result[:, 0] = -force / inertia * (length - x) * y
        result[:, 3] = shear * (along_y + 0.5 * nu * y**2 + (1.0 - 0.5 * nu) * z**2)
        result[:, 4] = shear * (along_z + (2.0 + nu) * y * z)
        return result

    return Problem(
        "cantilever",
        "bar 10 x 2 x 2, force at its tip (Saint-Venant)",
        beam(length, width, (even(10), even(2), even(2))),
        displacement,
        stress,
        ("side",),
        level=0.8,
        densities=((1, 1), (1, 2), (2, 2), (2, 3)),
        sizes={
            "tet10": (0.8, 0.6, 0.45, 0.35),
            "tet10-graded": (0.8, 0.6, 0.4, 0.3),
            "netgen-layers": (0.8, 0.6, 0.45, 0.35),
        },
        tractions={"tip": _stress_of(stress)},
        held={"root": (0, 1, 2)},
        peak_at=np.array([[0.0, half, 0.0]]),
    )


# ------------------------------------------------------------------------------------- torus


def heavy_torus(major: float = 3.0, minor: float = 1.0) -> Problem:
    """Torus under its own weight on two soft cushions; the reference is a spectral solution."""
    solution = fem_torus.solve(major, minor, STEEL_LIKE)
    return Problem(
        "torus",
        "torus, radii 3 and 1, under its own weight on two cushions (spectral reference)",
        torus(major, minor, even(2), even(2)),
        solution.displacement,
        solution.stress,
        ("surface",),
        densities=((1, 1), (2, 1), (2, 2), (3, 2)),
        sizes={
            "tet10": (0.8, 0.6, 0.45, 0.35),
            "tet10-graded": (0.75, 0.6, 0.45, 0.33),
            "netgen-layers": (0.8, 0.6, 0.45, 0.35),
        },
        tractions={"surface": solution.traction},
        supports=(
            ((major + minor, 0.0, 0.0), (0, 1, 2)),
            ((-major - minor, 0.0, 0.0), (1, 2)),
            ((0.0, major + minor, 0.0), (2,)),
        ),
        weight=(0.0, 0.0, -solution.weight),
        balance="surface",
        peak_at=solution.surface_places(400),
    )


MAKERS: dict[str, Callable[[], Problem]] = {
    "cylinder": thick_cylinder,
    "sphere": thick_sphere,
    "plate": holed_plate,
    "cantilever": cantilever,
    "torus": heavy_torus,
}


@cache
def problem(name: str) -> Problem:
    """One of `MAKERS`."""
    return MAKERS[name]()
