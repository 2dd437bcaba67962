# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Closest points on triangles and segments."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

_NEAREST = 6


def on_triangles(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Closest points on triangles, one each.

    Parameters
    ----------
    points : (k, 3) array
    corners : (k, 3, 3) array
        Corner, coordinate. Triangles without area are segments or points.

    Returns
    -------
    (k, 3) array
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    u, v, d = b - a, c - a, points - a
    uu, uv, vv = _dot(u, u), _dot(u, v), _dot(v, v)
    du, dv = _dot(d, u), _dot(d, v)
    area = uu * vv - uv * uv
    solid = area > 1e-12 * uu * vv
    area = np.where(solid, area, 1.0)
    s, t = (vv * du - uv * dv) / area, (uu * dv - uv * du) / area
    result = a + s[:, None] * u + t[:, None] * v
    outside = np.flatnonzero(~(solid & (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)))
    if len(outside):
        p = points[outside]
        sides = corners[outside]
        near = np.stack([on_segments(p, sides[:, k], sides[:, (k + 1) % 3]) for k in range(3)], 1)
        best = np.linalg.norm(near - p[:, None], axis=2).argmin(axis=1)
        result[outside] = near[np.arange(len(outside)), best]
    return result


def on_segments(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Closest points on segments, one each, (k, 3)."""
    along = end - start
    length2 = np.maximum(_dot(along, along), np.finfo(float).tiny)
    share = np.clip(_dot(points - start, along) / length2, 0.0, 1.0)
    return start + share[:, None] * along


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ki,ki->k", a, b)


class Carrier:
    """Facets (triangles, or segments as triangles with two equal corners) to come back to.

    Parameters
    ----------
    corners : (f, 3, 3) array
        mm.
    size : (f,) array
        Facets that are larger are found by several of their points.
    """

    def __init__(self, corners: np.ndarray, size: np.ndarray) -> None:
        self.corners = corners
        longest = np.linalg.norm(corners[:, [1, 2, 0]] - corners, axis=2).max(axis=1)
        parts = np.clip(np.ceil(longest / size), 1, 64).astype(int)
        points, facet = [], []
        for number in np.unique(parts):
            mine = np.flatnonzero(parts == number)
            share = _shares(number)
            points.append(np.einsum("sk,fki->fsi", share, corners[mine]).reshape(-1, 3))
            facet.append(np.repeat(mine, len(share)))
        self.facet = np.concatenate(facet) if facet else np.zeros(0, dtype=np.int64)
        self.tree = cKDTree(np.concatenate(points) if points else np.zeros((0, 3)))

    def __len__(self) -> int:
        return len(self.corners)

    def closest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Closest points (k, 3), and the facets that they lie on, (k,)."""
        if not len(points):
            return np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
        number = min(_NEAREST, len(self.facet))
        found = self.facet[self.tree.query(points, k=number)[1].reshape(len(points), number)]
        near = on_triangles(np.repeat(points, number, axis=0), self.corners[found.ravel()])
        near = near.reshape(len(points), number, 3)
        best = np.linalg.norm(near - points[:, None], axis=2).argmin(axis=1)
        rows = np.arange(len(points))
        return near[rows, best], found[rows, best]


def _shares(number: int) -> np.ndarray:
    """Barycentric coordinates of the middles of a triangle cut into number² equal ones."""
    rows = []
    for i in range(number):
        for j in range(number - i):
            rows.append((i + 1 / 3, j + 1 / 3))
            if i + j < number - 1:
                rows.append((i + 2 / 3, j + 2 / 3))
    ij = np.array(rows) / number
    return np.column_stack([1.0 - ij.sum(axis=1), ij])
