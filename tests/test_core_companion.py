# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Companions of low degree: bodies that cubics can be are met exactly, whatever their degree."""

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.companion import carried, companion, needs_companion


@pytest.mark.parametrize(
    ("body", "volume"),
    [(bodies.box((3.0, 2.0, 1.0), (2, 2, 1), degree=8), 6.0), (bodies.l_bracket(degree=7), None)],
    ids=["box", "bracket"],
)
def test_a_companion_has_low_degree_and_the_same_shape(body, volume):
    surface = build_surface(list(body.faces))
    assert needs_companion(surface)
    low = companion(surface)
    assert not needs_companion(low)
    assert {p.degrees for p in low.patches} == {(3, 3)}
    assert len(low.control_points) <= len(surface.control_points)
    assert low.volume() == pytest.approx(volume or body.volume, rel=1e-12)
    # the same points at the same parameters, not only the same shape
    x = np.linspace(0.0, 1.0, 7)
    for k in range(len(surface.patches)):
        at = np.full(len(x), k), x, x**2
        assert low.evaluate_at(*at) == pytest.approx(surface.evaluate_at(*at), abs=1e-9)


def test_quadrics_need_none():
    for body in (bodies.sphere(), bodies.cylinder(spans=2), bodies.torus()):
        assert not needs_companion(build_surface(list(body.faces)))


def test_displacements_are_carried_over_as_they_are():
    surface = build_surface(list(bodies.box((3.0, 2.0, 1.0), (2, 2, 1), degree=8).faces))
    low = companion(surface)
    # x -> A x + b is a spline of both, as the coordinates are
    a, b = np.array([[0.1, 0.7, 0.0], [-0.3, 0.2, 0.5], [0.0, 0.4, -0.6]]), np.array([1.0, 2, 3])
    found = carried(low.control_points @ a + b, low, surface)
    assert found == pytest.approx(surface.control_points @ a + b, abs=1e-9)
