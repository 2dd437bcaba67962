# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Elements with a flat corner on the rim are shared out: none is left, the area stays."""

import numpy as np
import pytest

from HybridVolume.core.covering.flat_corners import opened_corners

# the left side x = 0 is smooth at points 1 and 2
POINTS = np.array(
    [[0, 0, 0], [0, 1, 0], [0, 2, 0], [1, 1, 0], [2, 0, 0], [2, 2, 0], [0, 3, 0]], dtype=float
)


def area(elements):
    """By the shoelace formula."""
    total = 0.0
    for row in elements:
        x, y = POINTS[row[row >= 0], :2].T
        total += 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    return total


def around(elements, point):
    return int((elements == point).any(axis=1).sum())


def test_a_quad_is_halved():
    elements = np.array([[2, 1, 0, 3]])
    rim = np.array([[0, 1], [1, 2], [0, 3], [3, 2]])
    found = opened_corners(elements, rim, np.array([1]), POINTS)
    assert sorted(sorted(row[row >= 0].tolist()) for row in found) == [[0, 1, 3], [1, 2, 3]]
    assert area(found) == pytest.approx(area(elements), abs=1e-15)
    # where the outline has a corner there it stays
    assert opened_corners(elements, rim, np.zeros(0, dtype=int), POINTS) is elements


def test_a_triangle_takes_from_the_element_behind_it():
    # a bulge at point 1 makes its corner less than flat as chords go, and yet it is smooth
    points = POINTS.copy()
    points[1, 0] = -0.5
    elements = np.array([[0, 2, 1, -1], [2, 0, 4, 5]])
    rim = np.array([[0, 1], [1, 2], [0, 4], [4, 5], [5, 2]])
    found = opened_corners(elements, rim, np.array([1]), points)
    assert around(elements, 1) == 1 and around(found, 1) == 3
    assert len(found) == 3 and np.all(found[:, 3] < 0)


def test_what_cannot_be_helped_is_left():
    # nothing is behind the triangle: a third of it would be a flat element again
    elements = np.array([[0, 2, 1, -1]])
    rim = np.array([[0, 1], [1, 2], [0, 2]])
    assert opened_corners(elements, rim, np.array([1]), POINTS) is elements
