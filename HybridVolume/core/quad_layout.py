# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Quad meshes cut into rectangular patches along the lines that leave their irregular vertices.

Lines of edges go straight on at vertices with four edges. Those that reach an irregular vertex, or
hold an edge that must be a side of patches, are the sides; where a part between them closes on
itself, as a tube does, further lines are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..errors import FaultError

_ROUNDS = 200


@dataclass(frozen=True)
class QuadLayout:
    """Patches of a quad mesh.

    Attributes
    ----------
    grids : tuple of (m + 1, n + 1) int arrays
        Vertices of each patch; the first index runs along u, and u x v looks outward.
    patch : (nf,) int array
        Patch of each quad.
    cell : (nf, 2) int array
        Which cell of the patch it is.
    first : (nf,) int array
        Which of its corners is that with the smallest u and v.
    """

    grids: tuple[np.ndarray, ...]
    patch: np.ndarray
    cell: np.ndarray
    first: np.ndarray

    def __len__(self) -> int:
        return len(self.grids)


def quad_layout(quads: np.ndarray, sides: np.ndarray | None = None) -> QuadLayout:
    """Patches of a closed, oriented quad mesh.

    Parameters
    ----------
    quads : (nf, 4) int array
        Every edge belongs to two of them.
    sides : (e, 2) int array, optional
        Edges that must be on sides of patches, such as sharp ones.

    Returns
    -------
    QuadLayout
        No patch meets itself.
    """
    half = _HalfEdges(np.asarray(quads))
    marked = half.irregular.copy()
    if sides is not None and len(sides):
        marked |= half.among(np.asarray(sides))
    line = half.lines()
    for _ in range(_ROUNDS):
        on = np.zeros(line.max() + 1, dtype=bool)
        on[line[marked]] = True
        marked = on[line]
        patch, cell, first, torn = half.placed(marked)
        if len(torn):
            marked[torn] = True
            continue
        cut = half.self_contacts(marked, patch, cell, first)
        if not len(cut):
            return _layout(half.quads, patch, cell, first)
        marked[cut] = True
    raise FaultError("the quads cannot be cut into patches")


def _layout(
    quads: np.ndarray, patch: np.ndarray, cell: np.ndarray, first: np.ndarray
) -> QuadLayout:
    count = int(patch.max()) + 1
    low = np.full((count, 2), np.iinfo(np.int64).max)
    np.minimum.at(low, patch, cell)
    cell = cell - low[patch]
    size = np.zeros((count, 2), dtype=np.int64)
    np.maximum.at(size, patch, cell + 1)
    if not np.array_equal(size.prod(axis=1), np.bincount(patch)):
        raise FaultError("a patch of quads is no rectangle")
    rows = size + 1
    start = np.concatenate([[0], np.cumsum(rows.prod(axis=1))])
    table = np.full(start[-1], -1)
    for corner, (du, dv) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
        at = start[patch] + (cell[:, 0] + du) * rows[patch, 1] + cell[:, 1] + dv
        vertex = quads[np.arange(len(quads)), (first + corner) % 4]
        if ((table[at] >= 0) & (table[at] != vertex)).any():
            raise FaultError("two vertices are at one place of a patch")
        table[at] = vertex
    grids = tuple(table[start[k] : start[k + 1]].reshape(rows[k]) for k in range(count))
    return QuadLayout(grids, patch, cell, first)


class _HalfEdges:
    """Sides of quads, 4 f + k from corner k of quad f to the next one."""

    def __init__(self, quads: np.ndarray) -> None:
        self.quads = quads
        tail, head = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
        ends = np.column_stack([np.minimum(tail, head), np.maximum(tail, head)])
        self.ends, self.edge = np.unique(ends, axis=0, return_inverse=True)
        self.edge = self.edge.reshape(-1)
        order = np.argsort(self.edge, kind="stable").reshape(-1, 2)
        self.twin = np.empty(len(tail), dtype=np.int64)
        self.twin[order[:, 0]], self.twin[order[:, 1]] = order[:, 1], order[:, 0]
        self.head = head
        valence = np.bincount(self.ends.ravel(), minlength=int(quads.max()) + 1)
        self.regular = valence == 4
        self.irregular = ~self.regular[self.ends].all(axis=1)

    def following(self, half: np.ndarray) -> np.ndarray:
        """The next side of the same quad."""
        return half - half % 4 + (half + 1) % 4

    def among(self, ends: np.ndarray) -> np.ndarray:
        """Which edges are among the given ones, (e,) bool."""
        n = int(self.ends.max()) + 1
        ends = np.sort(ends, axis=1)
        return np.isin(self.ends[:, 0] * n + self.ends[:, 1], ends[:, 0] * n + ends[:, 1])

    def lines(self) -> np.ndarray:
        """Line of each edge: edges that go straight on at regular vertices are one."""
        half = np.flatnonzero(self.regular[self.head])
        on = self.following(self.twin[self.following(half)])
        n = len(self.ends)
        graph = coo_array((np.ones(len(half)), (self.edge[half], self.edge[on])), (n, n))
        return connected_components(graph, directed=False)[1]

    def placed(self, marked: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Patch, cell and first corner of each quad; edges to mark where a patch closes on itself.

        All patches grow at once from their first quads, over edges that are not marked.
        """
        n = len(self.quads)
        half = np.flatnonzero(~marked[self.edge])
        graph = coo_array((np.ones(len(half)), (half // 4, self.twin[half] // 4)), (n, n))
        count, patch = connected_components(graph, directed=False)
        patch = patch.astype(np.int64)
        cell, first = np.zeros((n, 2), dtype=np.int64), np.zeros(n, dtype=np.int64)
        done = np.zeros(n, dtype=bool)
        done[np.unique(patch, return_index=True)[1]] = True
        fresh = done.copy()
        while fresh.any():
            going = half[fresh[half // 4] & ~done[self.twin[half] // 4]]
            there, at, turned = self._across(going, cell, first)
            fresh = np.zeros(n, dtype=bool)
            cell[there], first[there] = at, turned
            fresh[there] = done[there] = True
        there, at, turned = self._across(half, cell, first)
        torn = half[(at != cell[there]).any(axis=1) | (turned != first[there])]
        # two quads at one place of a patch: it winds around a regular part
        keys = np.column_stack([patch, cell])
        _, inverse, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        twice = (counts > 1)[inverse.reshape(-1)]
        if len(torn):
            _, one = np.unique(patch[torn // 4], return_index=True)
            return patch, cell, first, self.edge[torn[one]]
        if twice.any():
            one = half[twice[half // 4]]
            _, some = np.unique(patch[one // 4], return_index=True)
            return patch, cell, first, self.edge[one[some]]
        return patch, cell, first, np.zeros(0, dtype=np.int64)

    def _across(
        self, half: np.ndarray, cell: np.ndarray, first: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Quads beyond sides, and what their cells and first corners are, seen from here."""
        here, side = half // 4, half % 4
        there, other = self.twin[half] // 4, self.twin[half] % 4
        way = (side - first[here]) % 4
        step = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])[way]
        return there, cell[here] + step, (other - way - 2) % 4

    def self_contacts(
        self, marked: np.ndarray, patch: np.ndarray, cell: np.ndarray, first: np.ndarray
    ) -> np.ndarray:
        """Edges to mark so that no patch meets itself: in the middle of those that do."""
        half = np.flatnonzero(marked[self.edge])
        half = half[patch[half // 4] == patch[self.twin[half] // 4]]
        if not len(half):
            return np.zeros(0, dtype=np.int64)
        way = (half % 4 - first[half // 4]) % 4
        # a side across u (ways 1 and 3) is parted by cutting u, and the other way round
        along = np.where(way % 2 == 1, 0, 1)
        found = []
        for axis in (0, 1):
            for one in np.unique(patch[half[along == axis] // 4]):
                members = np.flatnonzero(patch == one)
                place = cell[members, axis]
                middle = (place.min() + place.max() + 1) // 2
                if middle == place.min():
                    raise FaultError("a quad meets itself: the mesh is too coarse to be cut")
                quad = members[place == middle][0]
                side = (first[quad] + (3 if axis == 0 else 0)) % 4
                found.append(self.edge[4 * quad + side])
        return np.array(found)
