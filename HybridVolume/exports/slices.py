# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Triangles cut by a plane or by a level, for pictures."""

from __future__ import annotations

import numpy as np

from HybridVolume.core.section import cut_triangles


def clipped(
    points: np.ndarray, triangles: np.ndarray, height: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The part of a triangulation below a plane.

    Parameters
    ----------
    points : (n, 3) array
        mm.
    triangles : (m, 3) int array
    height : (n,) array
        Of the points above the plane.

    Returns
    -------
    points : (k, 3) array
    triangles : (l, 3) int array
        Turned as they were.
    """
    above = height[triangles] >= 0.0
    count = above.sum(axis=1)
    parts, extra, start = [triangles[count == 0]], [points], len(points)
    for number in (1, 2):
        rows = np.flatnonzero(count == number)
        if not len(rows):
            continue
        # the corner that is alone on its side comes first
        alone = np.argmax(above[rows] == (number == 1), axis=1)
        a, b, c = (
            np.take_along_axis(triangles[rows], (alone[:, None] + k) % 3, axis=1)[:, 0]
            for k in range(3)
        )
        ends = []
        for other in (b, c):
            share = (height[a] / (height[a] - height[other]))[:, None]
            ends.append((1.0 - share) * points[a] + share * points[other])
        extra += ends
        ab = start + np.arange(len(rows))
        ac = ab + len(rows)
        start += 2 * len(rows)
        if number == 1:
            parts += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
        else:
            parts.append(np.stack([a, ab, ac], axis=1))
    return np.concatenate(extra), np.concatenate(parts)


def isolines(
    points: np.ndarray, triangles: np.ndarray, values: np.ndarray, level: float
) -> np.ndarray:
    """Lines of a level over triangles, (m, 2, 3), mm."""
    cut = cut_triangles(points, triangles, values - level)
    return cut.points[cut.parts]
