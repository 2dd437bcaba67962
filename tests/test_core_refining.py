# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Covers are refined where they are bad; feet on surfaces; normals of spans of high degree."""

import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.covering.geometry import evaluate, project
from HybridVolume.core.covering.refining import Strips, growth, more_intervals
from HybridVolume.core.singular import normal_nets
from HybridVolume.core.surface import SplineFace


def quarter_cylinder(radius: float = 3.0, height: float = 5.0) -> SplineFace:
    """A quarter of a cylinder about z, exact."""
    arc = np.array([[radius, 0.0], [radius, radius], [0.0, radius]])
    points = np.zeros((3, 2, 3))
    points[:, :, :2], points[:, 1, 2] = arc[:, None], height
    weights = np.array([1.0, np.sqrt(0.5), 1.0])[:, None] * np.ones(2)
    knots = np.array([0.0, 0, 0, 1, 1, 1]), np.array([0.0, 0, 1, 1])
    return SplineFace("Face1", (2, 1), knots, points, weights)


def test_feet_on_a_cylinder_are_those_of_the_formula():
    face = quarter_cylinder()
    rng = np.random.default_rng(2)
    angle, z = rng.uniform(0.0, np.pi / 2, 500), rng.uniform(0.0, 5.0, 500)
    r = 3.0 + rng.uniform(-1.5, 4.0, 500)
    points = np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
    uv, feet = project(face, points)
    exact = np.column_stack([3.0 * np.cos(angle), 3.0 * np.sin(angle), z])
    assert np.abs(feet - exact).max() < 1e-10
    assert np.abs(evaluate(face, uv)[0] - feet).max() == 0.0
    # beyond a side the foot is on that side, at the right place along it
    outside = np.array([[4.0, -2.0, 1.25], [-1.0, 5.0, 4.0], [2.0, 2.0, 9.0]])
    corner = 3.0 * np.sqrt(0.5)
    on_side = np.array([[3.0, 0.0, 1.25], [0.0, 3.0, 4.0], [corner, corner, 5.0]])
    assert np.abs(project(face, outside)[1] - on_side).max() < 1e-9


class _Cover:
    """Two faces of 3 x 2 quads side by side, the first with edges 0, 1, 2, 3."""

    def __init__(self) -> None:
        i, j = np.meshgrid(np.arange(6), np.arange(2), indexing="ij")
        number = i * 3 + j
        self.quads = np.stack([number, number + 3, number + 4, number + 1], -1).reshape(-1, 4)
        self.points = np.zeros((21, 3))
        self.face = np.repeat([0, 1], 6)
        rim = []
        for k in range(6):
            rim += [
                (3 * k, 3 * k + 3, 0 if k < 3 else 4),
                (3 * k + 2, 3 * k + 5, 2 if k < 3 else 5),
            ]
        for k in range(2):
            rim += [(k, k + 1, 3), (9 + k, 10 + k, 1), (18 + k, 19 + k, 6)]
        rim = np.array(rim)
        rim = rim[np.lexsort((rim[:, 1], rim[:, 0]))]
        self.rim, self.rim_edge = rim[:, :2], rim[:, 2]


def test_only_the_edges_at_the_ends_of_a_strip_get_more_intervals():
    cover = _Cover()
    strips = Strips(cover)
    assert len(np.unique(strips.number[:6])) == 5  # 3 + 2 strips of the first face
    factor = np.ones(12)
    factor[3] = 1.5  # the middle quad of the first face, in its second column
    straight_across = np.tile([1.0, 0.1], (12, 1))
    intervals = np.array([3, 2, 3, 2, 3, 3, 2])
    more = more_intervals(cover, None, intervals, factor, straight_across)
    assert more.tolist() == [5, 1, 5, 1, 1, 1, 1]
    both = more_intervals(cover, None, intervals, factor, np.ones((12, 2)))
    assert both.tolist() == [5, 3, 5, 3, 1, 1, 1]


def test_quads_shrink_as_their_order_asks():
    # fourth order: a sixteenth of the distance by halving
    assert growth(np.array([16.0 / 1.5]), 1.0)[0] == pytest.approx(2.0)
    assert growth(np.array([1e9]), 1.0)[0] == 3.0


def test_normals_of_high_rational_degree_are_proved():
    """A box one side of which is rational of degree (7, 4): interpolation proves nothing there."""
    faces = []
    axes = [(1, 2, 0, 0), (2, 1, 0, 1), (2, 0, 1, 0), (0, 2, 1, 1), (0, 1, 2, 0), (1, 0, 2, 1)]
    for k, (a, b, c, side) in enumerate(axes):
        u, v = np.meshgrid(np.arange(8) / 7.0, np.arange(5) / 4.0, indexing="ij")
        points = np.zeros((8, 5, 3))
        points[..., a], points[..., b], points[..., c] = u, v, side
        weights = 1.0 + 0.2 * np.outer(u[:, 0] * (1 - u[:, 0]), v[0] * (1 - v[0]))
        knots = np.repeat([0.0, 1.0], 8), np.repeat([0.0, 1.0], 5)
        faces.append(SplineFace(f"Face{k + 1}", (7, 4), knots, points, weights))
    surface = build_surface(faces)
    for nets in normal_nets(surface):
        size = np.linalg.norm(nets.coefficients, axis=3).max(axis=(1, 2))
        assert np.all(nets.error < 1e-9 * size)
        # the sides of the box are flat: every coefficient of a normal points the same way
        flat = nets.coefficients.reshape(len(size), -1, 3)
        along = np.einsum("eki,ei->ek", flat, flat.sum(axis=1))
        assert np.all(along.min(axis=1) > 0.0)
