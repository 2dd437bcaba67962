# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies in the plane and problems on them whose solutions are known.

The disk has the paper's (section 4): g = J4(j r) sin 4 theta with the second zero j of the Bessel
function J4. The paper solves -laplace g~ = f and sets f = laplace g, which has the wrong sign: g
is an eigenfunction, -laplace g = j² g, and f is that. Other bodies have waves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import jn_zeros, jv, jvp

from ..core.analysis.plane_curve import PlaneCurve, closed_spline, ellipse, joined
from ..core.bspline import clamped_knots
from ..core.recovery import Material

Field = Callable[[np.ndarray], np.ndarray]
"""Takes (m, 2) points, mm."""
ORDER = 4
"""Of the Bessel function, and of the waves around the disk."""
ZERO = float(jn_zeros(ORDER, 2)[-1])
RUBBER = Material(1.0, 0.3)
_WAVES = np.array([[1.1, 0.6], [-0.5, 1.0]])
"""Wave vectors over the body's size."""


@dataclass(frozen=True)
class Problem:
    """A solution and what it takes.

    Attributes
    ----------
    components : {1, 2}
        1 for Poisson's equation, 2 for elasticity in plane strain.
    exact, source : callables
        Return (m,) or (m, 2) values; the source is f of -laplace u = f, or the body force.
    slope : callable
        Returns (m, 2) or (m, 2, 2) derivatives.
    """

    components: int
    exact: Field
    slope: Field
    source: Field


def drum() -> Problem:
    """The paper's function on the unit disk; it vanishes on the boundary."""

    def polar(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.hypot(x[:, 0], x[:, 1]), np.arctan2(x[:, 1], x[:, 0])

    def exact(x: np.ndarray) -> np.ndarray:
        r, angle = polar(x)
        return jv(ORDER, ZERO * r) * np.sin(ORDER * angle)

    def slope(x: np.ndarray) -> np.ndarray:
        r, angle = polar(x)
        r = np.maximum(r, 1e-14)
        out = ZERO * jvp(ORDER, ZERO * r) * np.sin(ORDER * angle)
        around = jv(ORDER, ZERO * r) / r * ORDER * np.cos(ORDER * angle)
        cos, sin = x.T / r
        return np.column_stack([out * cos - around * sin, out * sin + around * cos])

    return Problem(1, exact, slope, lambda x: ZERO**2 * exact(x))


def wave(curve: PlaneCurve) -> Problem:
    """A sine whose length is about that of the body."""
    k, middle = _wave_vectors(curve)

    def phase(x: np.ndarray) -> np.ndarray:
        return (x - middle) @ k[0] + 0.4

    return Problem(
        1,
        lambda x: np.sin(phase(x)),
        lambda x: np.cos(phase(x))[:, None] * k[0],
        lambda x: k[0] @ k[0] * np.sin(phase(x)),
    )


def shear_waves(curve: PlaneCurve) -> Problem:
    """Displacements of two sines in different directions, in plane strain."""
    k, middle = _wave_vectors(curve)
    lame, shear = RUBBER.lame, RUBBER.shear

    def phases(x: np.ndarray) -> np.ndarray:
        return (x - middle) @ k.T + [0.4, 0.9]

    def exact(x: np.ndarray) -> np.ndarray:
        return np.sin(phases(x))

    def slope(x: np.ndarray) -> np.ndarray:
        return np.cos(phases(x))[..., None] * k

    def source(x: np.ndarray) -> np.ndarray:
        # -(lame + shear) grad div u - shear laplace u, with u_c = sin(k_c x)
        waves = np.sin(phases(x))
        dilation = (waves * np.diag(k)) @ k
        return (lame + shear) * dilation + shear * (k**2).sum(axis=1) * waves

    return Problem(2, exact, slope, source)


def _wave_vectors(curve: PlaneCurve) -> tuple[np.ndarray, np.ndarray]:
    points = curve.points[:, :2] / curve.points[:, 2:]
    low, high = points.min(axis=0), points.max(axis=0)
    return 2.0 * np.pi / np.linalg.norm(high - low) * _WAVES, 0.5 * (low + high)


def clover() -> PlaneCurve:
    """A smooth closed cubic spline with three leaves: C² everywhere, no arc ends."""
    turn = np.arange(12) * np.pi / 6
    reach = 1.0 + 0.35 * np.cos(3 * turn)
    return closed_spline(reach[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]), 3)


def heart() -> PlaneCurve:
    """Rational arcs of degrees 3 and 2, with a notch and a tip."""
    right = np.array([[0.0, -1.2], [1.6, 0.2], [0.7, 1.6], [0.0, 0.7]])
    left = np.array([[0.0, 0.7], [-1.9, 1.5], [0.0, -1.2]])
    return joined(
        [
            (right, np.array([1.0, 0.6, 1.3, 1.0]), clamped_knots(3, 1)),
            (left, np.array([2.0, 1.4, 2.0]), clamped_knots(2, 1)),
        ]
    )


def hook() -> PlaneCurve:
    """A strip bent to a C, a smooth closed cubic spline; it has no middle to scale it to."""
    turn = np.linspace(0.0, 1.6 * np.pi, 9)
    arc = np.column_stack([np.cos(turn), np.sin(turn)])
    return closed_spline(np.concatenate([2.0 * arc, arc[::-1]]), 3)


BODIES: dict[str, tuple[Callable[[], PlaneCurve], str]] = {
    "disk": (ellipse, "unit disk, 4 rational quadratic arcs"),
    "ellipse": (lambda: ellipse((2.0, 1.0), (3.0, -1.0)), "ellipse 2 by 1, rational"),
    "clover": (clover, "smooth closed cubic spline, three leaves"),
    "hook": (hook, "smooth closed cubic spline, a strip bent to a C"),
    "heart": (heart, "rational arcs of degrees 3 and 2, with a notch and a tip"),
}
"""Bodies, and what they are."""
