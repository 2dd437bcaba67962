# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Quads with a shrunken side are opened, and nothing else moves."""

import numpy as np
from bodies import bezier_face

from HybridVolume.core.covering.quad_mesh import QuadCover
from HybridVolume.core.covering.relaxing import relaxed


def grid(place) -> tuple[QuadCover, list]:
    """3 x 3 quads of a square of side 3, whose two middle vertices of a row are put elsewhere."""
    x, y = np.meshgrid(np.arange(4.0), np.arange(4.0), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(16)])
    points[[5, 9], :2] = place
    corner = (4 * np.arange(3)[:, None] + np.arange(3)).ravel()
    quads = corner[:, None] + np.array([0, 4, 5, 1])
    sides = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    sides, count = np.unique(sides, axis=0, return_counts=True)
    rim = sides[count == 1]
    cover = QuadCover(points, quads, np.zeros(9, dtype=int), rim, np.zeros(len(rim), dtype=int))
    square = np.array([[[0.0, 0, 0], [0, 3, 0]], [[3, 0, 0], [3, 3, 0]]])
    return cover, [bezier_face(square)]


def figures(cover: QuadCover) -> tuple[float, float]:
    """Smallest ratio of opposite sides, and the sum of the areas."""
    x = cover.points[cover.quads]
    side = np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2)
    ratio = np.minimum(side[:, :2], side[:, 2:]) / np.maximum(side[:, :2], side[:, 2:])
    area = 0.5 * np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])[:, 2].sum()
    return float(ratio.min()), float(area)


def test_a_shrunken_side_is_opened():
    cover, surfaces = grid([[1.49, 1.0], [1.51, 1.0]])
    assert figures(cover)[0] < 0.021  # .02 beside 1; no corner's sine is below .5
    opened = relaxed(cover, surfaces)
    ratio, area = figures(opened)
    assert ratio > 0.19
    assert abs(area - 9.0) < 1e-12
    moved = (opened.points != cover.points).any(axis=1)
    assert set(np.flatnonzero(moved)) <= {5, 6, 9, 10}


def test_good_quads_stay():
    cover, surfaces = grid([[1.1, 1.0], [1.9, 1.1]])
    assert np.array_equal(relaxed(cover, surfaces).points, cover.points)
