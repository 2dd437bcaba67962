# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Where a cover needs more quads, and which edges get them.

A quad is refined by refining the strip of quads that it is in; a strip ends at edges of its face.
So the edges at the ends of the strips of bad quads get more intervals, and only in the direction in
which the face bends.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .outline import Outline
from .quad_mesh import QuadCover

STRAIGHT = 4.0
"""A quad that bends so many times less one way than the other is not refined that way."""
ORDER = 4
"""The distance of bicubic patches falls with this power of their size."""
MOST = 3.0
"""Intervals grow by no more than this factor in a round."""
LEAST = 1.25


class Strips:
    """Strips of quads of the faces of a cover, and the edges at their ends.

    Attributes
    ----------
    number : (m, 2) int array
        The strips of a quad that cross its sides 0 and 2, and its sides 1 and 3.
    """

    def __init__(self, cover: QuadCover) -> None:
        quads, count = cover.quads, len(cover.points)
        pairs = np.stack([quads, np.roll(quads, -1, axis=1)], axis=2)
        keys = pairs.min(axis=2) * count + pairs.max(axis=2)
        own = cover.face[:, None] * count**2 + keys  # a rim has one on either side of it
        self.sides, place = np.unique(own, return_inverse=True)
        place = place.reshape(keys.shape)
        links = np.concatenate([place[:, [0, 2]], place[:, [1, 3]]])
        size = len(self.sides)
        matrix = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(size, size))
        _, label = connected_components(matrix, directed=False)
        self.number = label[place[:, :2]]
        rim = cover.rim[:, 0] * count + cover.rim[:, 1]
        order = np.argsort(rim)
        at = np.minimum(np.searchsorted(rim[order], keys), len(rim) - 1)
        row = order[at]
        on_rim = rim[row] == keys
        self._label = label[place[on_rim]]
        self._edge = cover.rim_edge[row[on_rim]]

    def edges(self, strips: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows of ``strips`` and edges at whose ends these are, a pair each end, (k,) and (k,)."""
        order = np.argsort(self._label, kind="stable")
        first = np.searchsorted(self._label[order], strips)
        last = np.searchsorted(self._label[order], strips, side="right")
        row = np.repeat(np.arange(len(strips)), last - first)
        inside = np.arange(len(row)) - np.repeat(np.cumsum(last - first) - (last - first),
                                                 last - first)  # fmt: skip
        return row, self._edge[order][np.repeat(first, last - first) + inside]


def bending(nets: np.ndarray) -> np.ndarray:
    """How far quads bend along their sides 0 and 2, and 1 and 3: (m, 2), mm.

    Parameters
    ----------
    nets : (m, 4, 4, 3) array
        Their bicubic patches.
    """
    found = [
        np.linalg.norm(np.diff(nets, 2, axis=axis), axis=-1).max(axis=(1, 2)) for axis in (1, 2)
    ]
    return np.stack(found, axis=1)


def growth(distance: np.ndarray, tolerance: float) -> np.ndarray:
    """By how much smaller quads must be that are too far away."""
    return np.clip((1.5 * distance / tolerance) ** (1.0 / ORDER), LEAST, MOST)


def more_intervals(
    cover: QuadCover,
    outline: Outline,
    intervals: np.ndarray,
    factor: np.ndarray,
    bent: np.ndarray,
) -> np.ndarray:
    """Fewest intervals of edges, such that some quads become smaller.

    Parameters
    ----------
    cover : QuadCover
    outline : Outline
    intervals : (ne,) int array
        As they are.
    factor : (m,) array
        So many times smaller; 1 for quads that are good.
    bent : (m, 2) array
        Of :func:`bending`.

    Returns
    -------
    (ne,) int array
        1 where an edge needs no more.
    """
    bad = np.flatnonzero(factor > 1.0)
    strips = Strips(cover)
    rows, ways = np.nonzero(bent[bad] >= bent[bad].max(axis=1, keepdims=True) / STRAIGHT)
    quads = bad[rows]
    row, edge = strips.edges(strips.number[quads, ways])
    wanted = np.ones(len(intervals))
    np.maximum.at(wanted, edge, factor[quads[row]])
    # strips without an end run around inside a face
    closed = np.setdiff1d(np.arange(len(quads)), row)
    for face in np.unique(cover.face[quads[closed]]).tolist():
        own = closed[cover.face[quads[closed]] == face]
        around = np.unique(outline.edge[outline.face == face])
        wanted[around] = np.maximum(wanted[around], factor[quads[own]].max())
    return np.where(wanted > 1.0, np.ceil(wanted * intervals - 1e-6), 1).astype(int)
