# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Points of grids on patches, as they meet along sides; for all patches at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse


@dataclass(frozen=True)
class Meetings:
    """Grid points on sides that meet, numbered patch by patch, row by row.

    Attributes
    ----------
    pairs : (ns, 4) int array
        Patch, side, other patch, its side; every meeting once.
    start : (ns,) int array
        First row of each pair in ``left`` and ``right``.
    left, right : (m,) int arrays
        Points that are one.
    """

    pairs: np.ndarray
    start: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def welded(self, total: int) -> tuple[np.ndarray, np.ndarray]:
        """Number points so that those that meet are one, by their first appearance.

        Parameters
        ----------
        total : int
            Grid points of all patches.

        Returns
        -------
        number : (total,) int array
        first : (count,) int array
            The first grid point of each number: it is of the lowest patch that has it.
        """
        ones = np.ones(len(self.left))
        graph = sparse.coo_matrix((ones, (self.left, self.right)), shape=(total, total))
        _, label = sparse.csgraph.connected_components(graph, directed=False)
        _, first = np.unique(label, return_index=True)
        first = np.sort(first)
        order = np.empty(len(first), dtype=int)
        order[label[first]] = np.arange(len(first))
        return order[label], first


def meetings(
    shapes: Sequence[tuple[int, int]], partner: np.ndarray, reverse: np.ndarray
) -> Meetings:
    """Find the points of patch grids that meet along sides.

    Parameters
    ----------
    shapes : np pairs of int
        Grid of each patch; shapes must agree along sides that meet.
    partner : (np, 4, 2) int array
        Patch and side that meet each side.
    reverse : (np, 4) bool array
        Whether the partner runs the other way.
    """
    shapes = np.asarray(shapes, dtype=int).reshape(-1, 2)
    nu, nv = shapes.T
    offset = np.concatenate([[0], np.cumsum(nu * nv)[:-1]])
    # where a side starts, how far its points are apart, how many they are
    first = offset[:, None] + np.stack([0 * nu, (nu - 1) * nv, 0 * nu, nv - 1], axis=1)
    step = np.stack([0 * nu + 1, 0 * nu + 1, nv, nv], axis=1)
    count = np.stack([nv, nv, nu, nu], axis=1)
    mine = np.arange(4 * len(shapes))
    theirs = (4 * partner[..., 0] + partner[..., 1]).ravel()
    chosen = theirs > mine
    turned = reverse.ravel()[chosen]
    mine, theirs = mine[chosen], theirs[chosen]
    first, step, count = first.ravel(), step.ravel(), count.ravel()
    length = count[mine]
    start = np.concatenate([[0], np.cumsum(length)[:-1]]).astype(int)
    along = np.arange(length.sum()) - np.repeat(start, length)
    back = np.repeat(np.where(turned, length - 1, 0), length)
    way = np.repeat(np.where(turned, -1, 1), length) * along + back
    left = np.repeat(first[mine], length) + along * np.repeat(step[mine], length)
    right = np.repeat(first[theirs], length) + way * np.repeat(step[theirs], length)
    pairs = np.column_stack([mine // 4, mine % 4, theirs // 4, theirs % 4])
    return Meetings(pairs, start, left, right)
