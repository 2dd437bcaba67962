# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Plane sections of tetrahedra and triangles: what a cut lays open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_TET_EDGES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])


@dataclass(frozen=True)
class Section:
    """Where a plane meets simplices.

    Every corner lies on an edge of the given points, so that whatever is known at those can be
    taken along: ``(1 - share) * values[ends[:, 0]] + share * values[ends[:, 1]]``.

    Attributes
    ----------
    points : (k, 3) array
        Corners, mm.
    ends : (k, 2) int array
        The two given points of the edge that each corner lies on.
    share : (k,) array
        Where on it, in [0, 1].
    parts : (m, 3) or (m, 2) int array
        Triangles of cut tetrahedra, or lines of cut triangles.
    owner : (m,) int array
        Which of the given simplices each part lies in.
    """

    points: np.ndarray
    ends: np.ndarray
    share: np.ndarray
    parts: np.ndarray
    owner: np.ndarray

    def values(self, given: np.ndarray) -> np.ndarray:
        """Values at the corners, (k, ...), from those at the given points, (n, ...)."""
        share = self.share.reshape(-1, *[1] * (given.ndim - 1))
        return (1.0 - share) * given[self.ends[:, 0]] + share * given[self.ends[:, 1]]

    def facing(self, direction: np.ndarray) -> np.ndarray:
        """The triangles, each turned so that its normal points along a direction, (m, 3)."""
        a, b, c = np.moveaxis(self.points[self.parts], 1, 0)
        away = np.cross(b - a, c - a) @ direction < 0.0
        return np.where(away[:, None], self.parts[:, ::-1], self.parts)


def heights(points: np.ndarray, normal: np.ndarray, distance: float) -> np.ndarray:
    """How far points are above the plane ``normal . x = distance``, in lengths of the normal."""
    return points @ np.asarray(normal, dtype=float) - distance


def cut_tets(points: np.ndarray, tets: np.ndarray, height: np.ndarray) -> Section:
    """Section of tetrahedra by the plane of height zero.

    Parameters
    ----------
    points : (n, 3) array
        mm.
    tets : (m, 4) int array
    height : (n,) array
        Of the points above the plane; points in the plane count as above it.

    Returns
    -------
    Section
        Triangles in no common sense of rotation; where two tetrahedra stand on the plane from both
        sides, only the one below gives its face.
    """
    above = height[tets] >= 0.0
    count = above.sum(axis=1)
    crossed = np.flatnonzero((count > 0) & (count < 4))
    corners, flags, count = tets[crossed], above[crossed], count[crossed]
    edges, owner = [], []
    # one corner apart from three: the three edges at it
    single = np.flatnonzero(count != 2)
    apart = np.where(count[single] == 1, 1, 0)[:, None] == flags[single]
    alone = np.argmax(apart, axis=1)
    others = (alone[:, None] + np.arange(1, 4)) % 4
    rows = corners[single]
    first = np.take_along_axis(rows, alone[:, None], axis=1)
    second = np.take_along_axis(rows, others, axis=1)
    edges.append(np.stack([np.broadcast_to(first, second.shape), second], axis=-1))
    owner.append(crossed[single])
    # two and two: a quadrilateral, as two triangles
    double = np.flatnonzero(count == 2)
    order = np.argsort(~flags[double], axis=1, kind="stable")
    a, b, c, d = np.take_along_axis(corners[double], order, axis=1).T
    ring = np.stack([np.stack(pair, axis=-1) for pair in ((a, c), (a, d), (b, d), (b, c))], axis=1)
    edges += [ring[:, [0, 1, 2]], ring[:, [0, 2, 3]]]
    owner += [crossed[double]] * 2
    return _section(points, height, np.concatenate(edges), np.concatenate(owner))


def cut_triangles(points: np.ndarray, triangles: np.ndarray, height: np.ndarray) -> Section:
    """Section of triangles by the plane of height zero; see :func:`cut_tets`.

    Returns
    -------
    Section
        Its parts are lines, (m, 2).
    """
    above = height[triangles] >= 0.0
    count = above.sum(axis=1)
    crossed = np.flatnonzero((count > 0) & (count < 3))
    rows, flags = triangles[crossed], above[crossed]
    alone = np.argmax((count[crossed] == 1)[:, None] == flags, axis=1)
    others = (alone[:, None] + np.arange(1, 3)) % 3
    first = np.take_along_axis(rows, alone[:, None], axis=1)
    second = np.take_along_axis(rows, others, axis=1)
    edges = np.stack([np.broadcast_to(first, second.shape), second], axis=-1)
    return _section(points, height, edges, crossed)


def _section(
    points: np.ndarray, height: np.ndarray, edges: np.ndarray, owner: np.ndarray
) -> Section:
    size = edges.shape[1]
    ends = edges.reshape(-1, 2)
    h = height[ends]
    share = h[:, 0] / np.where(h[:, 0] == h[:, 1], 1.0, h[:, 0] - h[:, 1])
    x = (1.0 - share[:, None]) * points[ends[:, 0]] + share[:, None] * points[ends[:, 1]]
    parts = np.arange(len(ends)).reshape(-1, size)
    return Section(x, ends, share, parts, owner)
