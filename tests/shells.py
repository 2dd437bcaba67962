# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Shells made without midstructure and field: straight columns towards given points."""

from __future__ import annotations

from functools import cache

import bodies
import numpy as np

from HybridVolume.core import bspline
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.finite_elements import build_finite_elements
from HybridVolume.core.gap import gap_volume
from HybridVolume.core.hybrid import HybridVolume
from HybridVolume.core.midstructure import Midstructure, Sheet
from HybridVolume.core.shell import Shell
from HybridVolume.core.validity import certify


def shell_towards(surface, target, layers=2, degree=3) -> Shell:
    """Shell whose inner control points are ``target(control_points)``."""
    knots = bspline.clamped_knots(degree, layers)
    points = surface.control_points
    step = bspline.greville(degree, knots)[:, None, None] * (target(points) - points)
    columns = points + step
    columns[0] = points
    return Shell(surface, columns, degree, knots)


def _to_circle(points, radius=3.0, share=0.4):
    around = np.linalg.norm(points[:, :2], axis=1, keepdims=True)
    centre = np.hstack([points[:, :2] / around * radius, np.zeros((len(points), 1))])
    return points + share * (centre - points)


def _to_radius(points, radius=1.5, share=0.4):
    length = np.linalg.norm(points, axis=1, keepdims=True)
    return points + share * (points / length * radius - points)


BODIES = {
    "box": (
        lambda: bodies.box((3.0, 2.0, 1.0), (4, 3, 2)),
        lambda x: x + 0.5 * ([1.5, 1.0, 0.5] - x),
    ),
    "sphere": (lambda: bodies.sphere(1.0, spans=2), lambda x: 0.6 * x),
    "torus": (lambda: bodies.torus(spans=2), _to_circle),
    "hollow sphere": (lambda: bodies.hollow_sphere(2.0, 1.0, spans=2), _to_radius),
}
"""Body and where its inner control points go."""


@cache
def make_shell(name: str) -> Shell:
    """Shell of one of `BODIES`."""
    body, target = BODIES[name]
    return shell_towards(build_surface(list(body().faces)), target)


@cache
def exact_volume(name: str) -> float:
    """Volume of one of `BODIES`, mm³."""
    return BODIES[name][0]().volume


@cache
def make_volume(name: str, order: int = 2) -> HybridVolume:
    """Hybrid volume of one of `BODIES`, with a midstructure that is only a stand-in."""
    shell = make_shell(name)
    interface, interior, fem = build_finite_elements(shell, order=order)
    sheet = Sheet(("Face1", "Face2"), 0.5, (0.1, 0.2), (120.0, 180.0), True, "large", (0, 0.5, 1))
    midstructure = Midstructure(
        np.array([[0.1, 0.2, 0.3], [1.0, 0.0, 0.0], [0.0, 1.0, 1.0 / 3.0]]),
        np.array([[0, 1, 2]]),
        np.zeros(1, dtype=int),
        np.ones(1, dtype=bool),
        np.array([0.1, 0.2, 0.3]),
        (sheet,),
    )
    return HybridVolume(
        shell.surface,
        midstructure,
        {"tets": 7, "mesher": "none"},
        shell,
        certify(shell.bezier_elements()),
        interior,
        interface,
        fem,
        gap_volume(interface, shell),
        {"seconds": {"shell": 0.1}, "deviation": float("nan"), "notes": ["a", ("b", None)]},
    )
