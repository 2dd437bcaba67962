# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Shapes and edges of triangles of which more than two may meet at an edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..tetmesh.mesh import row_keys

SIDES = np.array([[0, 1], [1, 2], [2, 0]])


def shape(x: np.ndarray) -> np.ndarray:
    """1 for equilateral triangles, 0 for flat ones; (f,), from corners (f, 3, 3)."""
    sides = x[:, [1, 2, 0]] - x
    twice = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return twice * 2.0 * np.sqrt(3.0) / np.maximum((sides**2).sum(axis=(1, 2)), 1e-300)


def normals(x: np.ndarray) -> np.ndarray:
    """Unit normals, (f, 3), from corners (f, 3, 3); zero for triangles without area."""
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)


def smallest_angles(x: np.ndarray) -> np.ndarray:
    """Smallest angle of each triangle, (f,), degrees, from corners (f, 3, 3)."""
    sides = x[:, [1, 2, 0]] - x
    length = np.maximum(np.linalg.norm(sides, axis=2), 1e-300)
    cosine = -np.einsum("fki,fki->fk", sides, np.roll(sides, 1, axis=1))
    cosine /= length * np.roll(length, 1, axis=1)
    return np.degrees(np.arccos(np.clip(cosine.max(axis=1), -1.0, 1.0)))


def opening_sides(x: np.ndarray, triangles: np.ndarray, angle: float) -> np.ndarray:
    """Pairs of triangles that open by less than an angle (degrees) at a common side.

    Returns
    -------
    (k, 2) int array
        Sides 3 f + k: from corner k to corner k + 1 of triangle f.
    """
    corners = triangles[:, [[0, 1, 2], [1, 2, 0], [2, 0, 1]]].reshape(-1, 3)
    keys = row_keys(corners[:, :2], len(x))
    order = np.argsort(keys, kind="stable")
    corners = np.where((corners[:, :1] < corners[:, 1:2]), corners, corners[:, [1, 0, 2]])
    a, b, apex = (x[corners[:, k]] for k in range(3))
    along = b - a
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    away = apex - a
    away -= np.einsum("ki,ki->k", away, along)[:, None] * along
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for step in range(1, len(order)):
        i, j = order[:-step], order[step:]
        same = keys[i] == keys[j]
        if not same.any():
            break
        i, j = i[same], j[same]
        folded = np.einsum("ki,ki->k", away[i], away[j]) > np.cos(np.radians(angle))
        pairs.append(np.column_stack([i, j])[folded])
    return np.concatenate(pairs)


@dataclass
class Edges:
    """Edges of triangles.

    Attributes
    ----------
    keys : (e,) int array
        Sorted.
    ends : (e, 2) int array
        The lower number first.
    of_triangle : (f, 3) int array
        Edge of each side: from corner k to corner k + 1.
    count : (e,) int array
        Triangles at each edge.
    """

    keys: np.ndarray
    ends: np.ndarray
    of_triangle: np.ndarray
    count: np.ndarray

    @classmethod
    def of(cls, triangles: np.ndarray, n: int) -> Edges:
        keys = row_keys(triangles[:, SIDES].reshape(-1, 2), n)
        keys, inverse, count = np.unique(keys, return_inverse=True, return_counts=True)
        ends = np.column_stack([keys // n, keys % n])
        return cls(keys, ends, inverse.reshape(-1, 3), count)

    def two(self) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the edges with two triangles, (k,), and the sides 3 f + k there, (k, 2)."""
        flat = self.of_triangle.ravel()
        order = np.argsort(flat, kind="stable")
        first = np.concatenate([[0], np.cumsum(self.count)[:-1]])
        inner = np.flatnonzero(self.count == 2)
        return inner, np.column_stack([order[first[inner]], order[first[inner] + 1]])
