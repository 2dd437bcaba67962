# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How good a shell can be at best: figures by hand, and no shell beats them."""

from __future__ import annotations

import bodies
import numpy as np
import pytest
from patches import make_body
from scipy.optimize import linprog
from shells import shell_towards

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.bound import scaled_jacobian_bound
from HybridVolume.core.cones import widest_direction
from HybridVolume.core.surface import SplineFace
from HybridVolume.core.validity import scaled_jacobian


def surface_of(body):
    return build_surface(list(body.faces))


def moved(body, matrix, shift=(0.0, 0.0, 0.0)):
    faces = [
        SplineFace(f.name, f.degrees, f.knots, f.control_points @ np.transpose(matrix) + shift,
                   f.weights)
        for f in body.faces
    ]  # fmt: skip
    return make_body(body.name, faces, body.volume * abs(np.linalg.det(matrix)), body.genus)


def test_corner_of_a_cube_leaves_one_over_the_root_of_three():
    bound = scaled_jacobian_bound(surface_of(bodies.box()))
    assert bound.min() == pytest.approx(3**-0.5, abs=1e-13)
    # eight corners of three elements; the others are limited by edges (root of 1/2) or not at all
    assert np.sum(bound < 3**-0.5 + 1e-9) == 24
    assert np.sum(np.abs(bound - 2**-0.5) < 1e-12) > 0
    assert bound.max() == pytest.approx(1.0, abs=1e-13)


@pytest.mark.parametrize("angle", [10.0, 30.0])
def test_tip_of_a_wedge(angle):
    """At the tip: two walls that leave sin(angle / 2), and caps whose corner has that angle."""
    walls, cap = np.sin(np.radians(angle / 2)), np.sin(np.radians(angle))
    expected = walls * cap / np.hypot(walls, cap)
    bound = scaled_jacobian_bound(surface_of(bodies.wedge(angle)))
    assert bound.min() == pytest.approx(expected, rel=1e-12)


def test_sphere_is_limited_by_its_corners_of_120_degrees():
    bound = scaled_jacobian_bound(surface_of(bodies.sphere(spans=2)))
    assert bound.min() == pytest.approx(np.sin(np.radians(120.0)), rel=1e-12)


def test_torus_of_lines_of_curvature_is_not_limited():
    assert scaled_jacobian_bound(surface_of(bodies.torus())).min() == pytest.approx(1.0, abs=1e-12)


def test_sheared_box_moved_far_away_agrees_with_a_linear_programme():
    """max min v . d over unit d: the programme bounds the components of d by a polygon instead."""
    rng = np.random.default_rng(3)
    shear = np.array([[1.0, 0.7, -0.4], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    plain = scaled_jacobian_bound(surface_of(moved(bodies.box(spans=(2, 2, 2)), shear)))
    far = scaled_jacobian_bound(
        surface_of(moved(bodies.box(spans=(2, 2, 2)), 1e-3 * turn @ shear, (1.0, -2.0, 3.0)))
    )
    assert np.allclose(np.sort(plain), np.sort(far), atol=1e-9)
    a, b, c = shear.T / np.linalg.norm(shear, axis=0)[:, None]
    least = np.inf
    for signs in np.ndindex(2, 2, 2):
        sides = [s * v for s, v in zip(1 - 2 * np.array(signs), (a, b, c), strict=True)]
        inward = np.sign(np.linalg.det(sides))
        normals = [inward * np.cross(sides[k - 2], sides[k - 1]) for k in range(3)]
        # tangent planes of many directions stand for the ball |d| <= 1
        ball = rng.normal(size=(4000, 3))
        ball /= np.linalg.norm(ball, axis=1, keepdims=True)
        matrix = np.block([[-np.array(normals), np.ones((3, 1))], [ball, np.zeros((4000, 1))]])
        answer = linprog(
            [0, 0, 0, -1], matrix, np.r_[np.zeros(3), np.ones(4000)], bounds=[(None, None)] * 4
        )
        least = min(least, answer.x[3])
    assert plain.min() == pytest.approx(least, rel=3e-3)


@pytest.mark.parametrize("body", [bodies.sphere(), bodies.wedge(25.0), bodies.torus()])
def test_no_shell_beats_its_bound(body):
    """Random straight columns: an element's scaled Jacobian is at most that of its surface."""
    surface = surface_of(body)
    rng = np.random.default_rng(8)
    bound = scaled_jacobian_bound(surface)
    points = surface.control_points
    for _ in range(3):
        target = points.mean(axis=0) + 0.2 * rng.normal(size=points.shape)
        shell = shell_towards(surface, lambda _, target=target: target)
        found = scaled_jacobian(shell.bezier_elements()).reshape(-1, shell.layer_count)
        assert np.all(found.min(axis=1) <= bound + 1e-12)


@pytest.mark.parametrize("count", [1, 2, 3, 5, 7])
def test_widest_direction_beats_every_other_one(count):
    rng = np.random.default_rng(count)
    vectors = rng.normal(size=(40, count, 3)) + [1.5, 0.0, 0.0]
    direction, margin = widest_direction(vectors)
    assert np.allclose(np.linalg.norm(direction, axis=1), 1.0)
    assert np.allclose(np.einsum("mki,mi->mk", vectors, direction).min(axis=1), margin)
    other = rng.normal(size=(3000, 3))
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    near = direction[:, None] + 0.05 * other
    near /= np.linalg.norm(near, axis=2, keepdims=True)
    for tries in (np.broadcast_to(other, near.shape), near):
        best = np.einsum("mki,mti->mtk", vectors, tries).min(axis=2).max(axis=1)
        assert np.all(best <= margin + 1e-12)
