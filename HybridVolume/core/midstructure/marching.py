# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Closed triangles where a function on tetrahedra has the value 0."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..tetmesh.mesh import row_keys

# Corners of a tetrahedron in an even permutation that puts those above first, by the number whose
# bits tell which corners are above.
_EVEN = [
    p
    for p in np.ndindex(4, 4, 4, 4)
    if sorted(p) == [0, 1, 2, 3]
    and sum(p[i] > p[j] for i in range(4) for j in range(i + 1, 4)) % 2 == 0
]
_ORDER = np.array(
    [
        next(
            (p for p in _EVEN if all(code >> p[k] & 1 for k in range(bin(code).count("1")))),
            (0, 1, 2, 3),
        )
        for code in range(16)
    ]
)
# Edges (above, below) of the triangles for one, two and three corners above, in that order;
# triangles are oriented towards the corners below.
_TRIANGLES = {
    1: [[(0, 1), (0, 2), (0, 3)]],
    2: [[(0, 2), (0, 3), (1, 3)], [(0, 2), (1, 3), (1, 2)]],
    3: [[(0, 3), (1, 3), (2, 3)]],
}


def marching_tetrahedra(
    tets: np.ndarray, values: np.ndarray, zero: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the isosurface {value = 0}.

    Parameters
    ----------
    tets : (m, 4) int array
        Positive.
    values : (n,) array
    zero : (n,) bool array
        Vertices that are taken as lying on the isosurface.

    Returns
    -------
    edges : (v, 2) int array
        What each vertex of the surface lies on: an edge from above to below, or twice one vertex.
    triangles : (t, 3) int array
        Oriented towards the lower values.
    """
    n = len(values)
    above = (values > 0.0) & ~zero
    code = (above[tets] * np.array([1, 2, 4, 8])).sum(axis=1)
    rows = []
    for count, patterns in _TRIANGLES.items():
        mine = np.flatnonzero(above[tets].sum(axis=1) == count)
        corner = tets[mine[:, None], _ORDER[code[mine]]]
        for pattern in patterns:
            rows.append(np.stack([corner[:, list(edge)] for edge in pattern], axis=1))
    ends = np.concatenate(rows)
    high, low = ends[..., 0], ends[..., 1]
    high = np.where(zero[low], low, high)
    keys, triangles = np.unique(high * n + low, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    # two layers that were drawn onto the same vertices cancel
    keys_t = row_keys(triangles, len(keys))
    _, inverse, repeated = np.unique(keys_t, return_inverse=True, return_counts=True)
    triangles = triangles[repeated[inverse] == 1]
    used, triangles = np.unique(triangles, return_inverse=True)
    edges = np.column_stack([keys[used] // n, keys[used] % n])
    return edges, triangles.reshape(-1, 3)


def bad_vertices(triangles: np.ndarray, count: int) -> np.ndarray:
    """Vertices around which the triangles are no closed disc, numbers."""
    sides = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, inverse, number = np.unique(row_keys(sides, count), return_inverse=True, return_counts=True)
    bad = [sides[(number != 2)[inverse]].ravel()]
    # the triangles at a vertex must hang together through sides that have it
    corner = np.arange(3 * len(triangles)).reshape(-1, 3)
    order = np.argsort(inverse, kind="stable")
    pairs = order[np.flatnonzero(inverse[order[1:]] == inverse[order[:-1]])[:, None] + [0, 1]]
    triangle, side = np.divmod(pairs, 3)
    joined = []
    for k in (0, 1):
        # corner of the first triangle's k-th end of the side, and of the same vertex in the second
        one = corner[triangle[:, 0], (side[:, 0] + k) % 3]
        vertex = triangles.ravel()[one]
        match = triangles[triangle[:, 1]] == vertex[:, None]
        two = corner[triangle[:, 1], match.argmax(axis=1)]
        joined.append(np.column_stack([one, two]))
    joined = np.concatenate(joined)
    size = corner.size
    graph = coo_matrix((np.ones(len(joined)), (joined[:, 0], joined[:, 1])), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    fans = np.unique(np.column_stack([triangles.ravel(), label]), axis=0)
    bad.append(np.flatnonzero(np.bincount(fans[:, 0], minlength=count) > 1))
    return np.unique(np.concatenate(bad))
