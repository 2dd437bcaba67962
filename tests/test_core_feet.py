# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Feet of points are the nearest of all points of a surface: formulas and brute force."""

import numpy as np
import pytest

from HybridVolume.core.covering.feet import nearest
from HybridVolume.core.covering.geometry import SplineCurve
from HybridVolume.core.covering.surface_values import evaluate
from HybridVolume.core.surface import SplineFace

ROUND = np.array([(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0)])
WEIGHTS = np.array([*4 * (1.0, np.sqrt(0.5)), 1.0])
KNOTS = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4]) / 4.0


def turned(r, z, degree: int, knots, weights=None) -> SplineFace:
    """A profile turned about z, exact, with a seam."""
    points = np.zeros((9, len(r), 3))
    points[..., :2], points[..., 2] = ROUND[:, None] * np.asarray(r)[:, None], z
    weights = WEIGHTS[:, None] * (np.ones(len(r)) if weights is None else weights)
    return SplineFace("Face1", (2, degree), (KNOTS, np.asarray(knots, float)), points, weights)


def wavy(p: int, q: int, spans: tuple[int, int], seed: int, size=(10.0, 7.0)) -> SplineFace:
    """A rational surface with random bumps."""
    rng = np.random.default_rng(seed)
    shape = p + spans[0], q + spans[1]
    u, v = np.meshgrid(
        *(np.linspace(0, a, n) for a, n in zip(size, shape, strict=True)), indexing="ij"
    )
    points = np.stack([u, v, 0.3 * rng.normal(size=shape)], axis=-1)
    knots = [
        np.concatenate([np.zeros(d), np.linspace(0, 1, n + 1), np.ones(d)])
        for d, n in zip((p, q), spans, strict=True)
    ]
    return SplineFace("Face1", (p, q), tuple(knots), points, rng.uniform(0.7, 1.4, shape))


def distance_of_ellipsoid(points: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Distances from x²/a² + y²/b² + z²/c² = 1, by bisection for the multiplier of the foot."""
    inside = np.sum((points / axes) ** 2, axis=1) < 1.0
    low = np.where(inside, -(axes.min() ** 2), 0.0)
    high = np.where(inside, 0.0, axes.max() * np.linalg.norm(points, axis=1))
    for _ in range(200):
        t = 0.5 * (low + high)
        value = np.sum((points * axes / (axes**2 + t[:, None])) ** 2, axis=1) - 1.0
        low, high = np.where(value > 0.0, t, low), np.where(value > 0.0, high, t)
    feet = points * axes**2 / (axes**2 + t[:, None])
    return np.linalg.norm(feet - points, axis=1)


@pytest.mark.parametrize("axes", [(30.0, 20.0, 12.0), (50.0, 3.0, 2.0), (30.0, 20.0, 0.5)])
def test_feet_on_ellipsoids(axes):
    half = np.sqrt(0.5)
    ball = turned(
        [0, 1, 1, 1, 0], [-1, -1, 0, 1, 1], 2, [0, 0, 0, 1, 1, 2, 2, 2], [1, half, 1, half, 1]
    )
    shift = np.array([400.0, -30.0, 7.0])
    face = SplineFace(
        "Face1", ball.degrees, ball.knots, ball.control_points * axes + shift, ball.weights
    )
    rng = np.random.default_rng(1)
    normal = rng.normal(size=(700, 3))
    normal[:200, :2] *= 1e-3  # beside the poles
    normal[200:350, 1] = 0.0  # on the seam
    x = normal / np.linalg.norm(normal, axis=1, keepdims=True) * axes
    gradient = x / np.square(axes)
    size = 0.4 * min(axes) ** 2 / max(axes)
    x += (
        gradient
        / np.linalg.norm(gradient, axis=1, keepdims=True)
        * rng.uniform(-size, 3.0 * size, (700, 1))
    )
    found = nearest(face, x + shift)
    assert np.abs(found.distance - distance_of_ellipsoid(x, np.array(axes))).max() < 2e-12 * 400.0
    assert found.gap.max() == 0.0
    assert np.abs(evaluate(face, found.uv)[0] - found.points).max() == 0.0


def test_feet_on_a_cone_with_its_tip():
    face = turned([0.0, 5.0], [9.0, 0.0], 1, [0, 0, 1, 1])
    rng = np.random.default_rng(2)
    points = rng.uniform([-4, -4, 3], [4, 4, 12], (700, 3))
    points[:200] = [0.0, 0.0, 9.0] + rng.uniform(0, 1, (200, 1)) ** 4 * rng.normal(size=(200, 3))
    # on the side or, beyond it, at the tip
    r = np.linalg.norm(points[:, :2], axis=1)
    share = np.clip((r * 5.0 + (9.0 - points[:, 2]) * 9.0) / (25.0 + 81.0), 0.0, 1.0)
    exact = np.hypot(r - 5.0 * share, points[:, 2] - 9.0 + 9.0 * share)
    found = nearest(face, points)
    assert np.abs(found.distance - exact).max() < 1e-11
    assert found.gap.max() == 0.0


def test_feet_on_a_torus_closed_both_ways():
    face = turned(7 + 2 * ROUND[:, 0], 2.0 * ROUND[:, 1], 2, KNOTS, WEIGHTS)
    rng = np.random.default_rng(3)
    points = rng.uniform([-10, -10, -3], [10, 10, 3], (700, 3))
    r = np.linalg.norm(points[:, :2], axis=1)
    tube = np.hypot(r - 7.0, points[:, 2])
    found = nearest(face, points)
    exact = np.abs(tube - 2.0)
    assert (found.distance - exact).min() > -1e-12
    # from the axis all of the tube's inside is almost equally near, and that is told
    assert (found.distance - exact - found.gap).max() < 1e-11
    assert (found.gap > 1e-9).mean() < 0.02


@pytest.mark.parametrize(
    "face",
    [wavy(6, 10, (2, 1), 1), wavy(14, 2, (1, 3), 2), wavy(3, 3, (6, 2), 4, (100.0, 0.8))],
    ids=["(6, 10)", "(14, 2)", "long"],
)
def test_no_place_of_a_surface_is_nearer(face):
    rng = np.random.default_rng(5)
    points = evaluate(face, rng.uniform(0, 1, (100, 2)))[0] + rng.normal(0, 0.4, (100, 3))
    found = nearest(face, points)
    grid = np.stack(np.meshgrid(*2 * [np.linspace(0, 1, 100)], indexing="ij"), -1).reshape(-1, 2)
    places = evaluate(face, grid)[0]
    away = np.linalg.norm(points[:, None] - places, axis=2)
    assert (found.distance <= away.min(axis=1)).all()
    assert found.gap.max() == 0.0
    # and feet they are: nothing close by is nearer
    close = np.clip(found.uv[:, None] + rng.normal(0, 1e-4, (100, 200, 2)), 0, 1)
    beside = evaluate(face, close.reshape(-1, 2))[0].reshape(100, 200, 3)
    away = np.linalg.norm(points[:, None] - beside, axis=2)
    assert (found.distance <= away.min(axis=1) + 1e-13).all()


def test_both_sides_of_a_kink_are_looked_at():
    # two planes that meet at a right angle; points beside the plane that halves it
    profile = np.array([[-8.0, 8.0], [0.0, 0.0], [8.0, 8.0]])
    points = np.zeros((3, 2, 3))
    points[:, :, [0, 2]], points[:, 1, 1] = profile[:, None], 10.0
    knots = np.array([0.0, 0, 0.5, 1, 1]), np.array([0.0, 0, 1, 1])
    face = SplineFace("Face1", (1, 1), knots, points, np.ones((3, 2)))
    rng = np.random.default_rng(6)
    x = rng.uniform([-3, 0, 3.5], [3, 10, 5], (400, 3))
    x[:100, 0] *= 1e-6
    exact = (x[:, 2] - np.abs(x[:, 0])) / np.sqrt(2.0)
    assert np.abs(nearest(face, x).distance - exact).max() < 1e-13


def test_what_is_equally_near_everywhere_is_told():
    half = np.sqrt(0.5)
    face = turned(
        [0, 3, 3, 3, 0], [-3, -3, 0, 3, 3], 2, [0, 0, 0, 1, 1, 2, 2, 2], [1, half, 1, half, 1]
    )
    found = nearest(face, np.zeros((1, 3)))
    assert found.distance[0] == pytest.approx(3.0, abs=1e-12)
    assert 0.0 < found.gap[0] < 0.3


def test_feet_on_a_flat_ellipse_are_the_nearest():
    x, y = ROUND.T * np.array([[50.0], [2.0]])
    curve = SplineCurve(2, KNOTS, np.column_stack([x, y, 0.0 * x]), WEIGHTS)
    rng = np.random.default_rng(7)
    points = rng.uniform([-52, -3, -1], [52, 3, 1], (800, 3))
    # a place at every .0016 radians
    angle = np.linspace(0.0, 2.0 * np.pi, 4001)
    places = np.column_stack([50.0 * np.cos(angle), 2.0 * np.sin(angle), 0.0 * angle])
    least = np.linalg.norm(points[:, None] - places, axis=2).min(axis=1)
    t = curve.project(points)
    found = np.linalg.norm(curve.evaluate(t) - points, axis=1)
    assert (found <= least + 1e-12).all()
    slope = np.einsum("md,md->m", curve.evaluate(t) - points, curve.evaluate(t, 1))
    inside = (t > 0.0) & (t < 1.0)
    assert np.abs(slope[inside]).max() < 1e-8


def test_many_bent_spans_come_to_an_end():
    # two parts a span would be more pieces than are made
    face = wavy(3, 2, (40, 40), 8, (20.0, 20.0))
    rng = np.random.default_rng(9)
    on = evaluate(face, rng.uniform(0, 1, (300, 2)))[0]
    points = on + rng.normal(0, 1e-3, on.shape)
    found = nearest(face, points)
    assert (found.distance <= np.linalg.norm(points - on, axis=1) + 1e-13).all()
    assert found.gap.max() == 0.0
