# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Pairs of axis-aligned boxes that meet, by a balanced binary tree in arrays."""

from __future__ import annotations

import numpy as np

# Pairs of nodes that are worked on at once.
_CHUNK = 1_000_000


class BoxTree:
    """A complete binary tree over boxes, split at the median of the longest direction.

    Parameters
    ----------
    low, high : (n, 3) arrays
        Corners of the boxes, finite, low <= high.

    Attributes
    ----------
    size : int
        Number of boxes.
    depth : int
        Level of the leaves; a leaf is one box, or empty.
    order : (2^depth,) int array
        Box of each leaf; n for empty leaves.
    low, high : lists of (3, 2^level) arrays
        Boxes of the nodes of each level; an empty one has low = inf, high = -inf.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        self.size = len(low)
        self.depth = max(self.size - 1, 0).bit_length()
        order = np.full(1 << self.depth, self.size)
        order[: self.size] = np.arange(self.size)
        # Not-a-number sorts to the end: empty leaves gather at the end of their segment.
        centre = np.concatenate([0.5 * low + 0.5 * high, np.full((1, 3), np.nan)])
        lines = np.ascontiguousarray(centre.T)
        for level in range(self.depth):
            segments = order.reshape(1 << level, -1)
            points = [line[segments] for line in lines]
            with np.errstate(invalid="ignore"):
                extent = [np.fmax.reduce(x, axis=1) - np.fmin.reduce(x, axis=1) for x in points]
            axis = np.argmax(extent, axis=0)[:, None]
            key = np.where(axis == 0, points[0], np.where(axis == 1, points[1], points[2]))
            half = segments.shape[1] // 2
            position = np.argpartition(key, half - 1, axis=1)
            order = np.take_along_axis(segments, position, axis=1).ravel()
        self.order = order
        empty = np.full((1, 3), np.inf)
        lows = [np.ascontiguousarray(np.concatenate([low, empty])[order].T)]
        highs = [np.ascontiguousarray(np.concatenate([high, -empty])[order].T)]
        for _ in range(self.depth):
            lows.append(np.minimum(lows[-1][:, ::2], lows[-1][:, 1::2]))
            highs.append(np.maximum(highs[-1][:, ::2], highs[-1][:, 1::2]))
        self.low, self.high = lows[::-1], highs[::-1]

    def self_pairs(self) -> np.ndarray:
        """Pairs of boxes that meet (closed boxes).

        Returns
        -------
        (k, 2) int array
            i < j in each row; no order of the rows is promised.
        """
        pairs = self._descend(self)
        pairs.sort(axis=1)
        return pairs

    def pairs(self, other: BoxTree) -> np.ndarray:
        """Pairs (own box, box of the other tree) that meet (closed boxes).

        Returns
        -------
        (k, 2) int array
        """
        return self._descend(other)

    def _descend(self, other: BoxTree) -> np.ndarray:
        same = other is self
        found = []
        if self.size and other.size:
            stack = [(0, 0, np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64))]
        else:
            stack = []
        while stack:
            level_i, level_j, i, j = stack.pop()
            for k in range(3):
                meet = (self.low[level_i][k][i] <= other.high[level_j][k][j]) & (
                    other.low[level_j][k][j] <= self.high[level_i][k][i]
                )
                i, j = i[meet], j[meet]
            if level_i == self.depth and level_j == other.depth:
                if same:
                    apart = i != j
                    i, j = i[apart], j[apart]
                found.append(np.stack([self.order[i], other.order[j]], axis=1))
                continue
            if len(i) > _CHUNK:
                for part in np.array_split(np.arange(len(i)), -(-2 * len(i) // _CHUNK)):
                    stack.append(self._children(other, level_i, level_j, i[part], j[part], same))
            elif len(i):
                stack.append(self._children(other, level_i, level_j, i, j, same))
        return np.concatenate(found) if found else np.zeros((0, 2), dtype=np.int64)

    def _children(
        self, other: BoxTree, level_i: int, level_j: int, i: np.ndarray, j: np.ndarray, same: bool
    ) -> tuple[int, int, np.ndarray, np.ndarray]:
        """All pairs of children; of a node with itself each pair once."""
        first = i[:0]
        if same:
            twin = i == j
            first = 2 * i[twin]
            i, j = i[~twin], j[~twin]
        if level_i < self.depth:
            i, j, level_i = np.concatenate([2 * i, 2 * i + 1]), np.concatenate([j, j]), level_i + 1
        if level_j < other.depth:
            i, j, level_j = np.concatenate([i, i]), np.concatenate([2 * j, 2 * j + 1]), level_j + 1
        i = np.concatenate([i, first, first, first + 1])
        j = np.concatenate([j, first, first + 1, first + 1])
        return level_i, level_j, i, j
