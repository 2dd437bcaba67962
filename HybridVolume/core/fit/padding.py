# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A ring of quads along the features around a region, where its corners lie on smooth features.

A quad whose corner is 180 degrees wide has two instead: the irregular vertex moves off the feature
line into the region, and with it the line of the layout that ended there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..polygons import PolygonMesh
from .fading import evened
from .reference import Reference
from .snap import Snapped

ROUNDS = 20
"""Times that the quads of the region are evened out then."""
DEEP = 0.3
"""Width of the ring as a share of the way from its vertices to the middles of their quads."""


def padded(
    snap: Snapped, reference: Reference, flat: np.ndarray
) -> tuple[Snapped, tuple[int, ...]]:
    """Rings of quads in the regions of some quads.

    Parameters
    ----------
    snap : Snapped
    reference : Reference
    flat : (k,) int array
        Quads with straight corners on features.

    Returns
    -------
    Snapped
    quads : tuple of int
        Those of ``flat`` whose regions have a ring now. Regions in which a feature ends have none.
    """
    mesh = snap.mesh
    quads, x = mesh.quads, mesh.vertices
    ends, edge = mesh.edges
    following = snap.chain >= 0
    order = np.argsort(edge, kind="stable").reshape(-1, 2)
    open_pairs = order[~following] // 4
    n = len(quads)
    graph = coo_array((np.ones(len(open_pairs)), open_pairs.T), (n, n))
    _, region = connected_components(graph, directed=False)
    # an edge of features with one region on both sides ends in it
    pairs = order[following]
    inside = region[pairs[:, 0] // 4] == region[pairs[:, 1] // 4]
    ended = np.unique(region[pairs[inside, 0] // 4])
    taken = np.setdiff1d(np.unique(region[flat]), ended)
    chosen = np.isin(region, taken)
    half = np.flatnonzero(following[edge] & chosen[np.arange(4 * n) // 4])
    if not len(half):
        return snap, ()
    # corners of the region's quads around a vertex, as far as no feature parts them, are one
    corner = np.arange(4 * n)
    one, other = order[~following].T
    rows = np.concatenate([one, _after(one)])
    columns = np.concatenate([_after(other), other])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), (4 * n, 4 * n))
    _, fan = connected_components(graph, directed=False)
    touched = np.unique(np.concatenate([fan[half], fan[_after(half)]]))
    number = np.full(fan.max() + 1, -1)
    number[touched] = len(x) + np.arange(len(touched))
    flat_quads = quads.ravel()
    moved = np.isin(fan, touched)
    inner = np.where(moved, number[fan], flat_quads)
    rim = np.column_stack(
        [flat_quads[half], flat_quads[_after(half)], inner[_after(half)], inner[half]]
    )
    # the inner vertices are on the way to the middles of their quads
    middle = x[quads].mean(axis=1)[corner // 4]
    count = np.bincount(fan)[touched]
    toward = np.column_stack([np.bincount(fan, middle[:, c])[touched] for c in range(3)])
    vertex = np.zeros(fan.max() + 1, dtype=int)
    vertex[fan] = flat_quads
    start = x[vertex[touched]]
    places = start + DEEP * (toward / count[:, None] - start)
    area = np.repeat(mesh.area_vectors(), 4, axis=0)
    look = np.column_stack([np.bincount(fan, area[:, c])[touched] for c in range(3)])
    look /= np.maximum(np.linalg.norm(look, axis=1, keepdims=True), 1e-300)
    places, _ = reference.nearest(places, look)
    made = PolygonMesh.of(
        np.concatenate([x, places]), np.concatenate([inner.reshape(-1, 4), rim]).tolist()
    )
    chain, length = _kept(made.edges[0], ends[following], snap, following)
    free = np.zeros(len(made.vertices), dtype=bool)
    free[made.quads[np.append(chosen, np.ones(len(rim), dtype=bool))]] = True
    free[made.edges[0][chain >= 0]] = False
    x = made.vertices
    for _ in range(ROUNDS):
        x = evened(x, made.quads, free, reference)
    made = replace(made, vertices=x, notes=mesh.notes)
    return Snapped(made, chain, length), tuple(int(q) for q in flat[chosen[flat]])


def _after(corner: np.ndarray) -> np.ndarray:
    """The next corners, 4 f + k, of the same quads."""
    return corner - corner % 4 + (corner + 1) % 4


def _kept(
    ends: np.ndarray, features: np.ndarray, snap: Snapped, following: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Features that the edges of a new mesh follow: those between the same vertices as before."""
    size = int(ends.max()) + 1
    key = ends[:, 0] * size + ends[:, 1]
    known = features[:, 0] * size + features[:, 1]
    order = np.argsort(known)
    at = np.minimum(np.searchsorted(known, key, sorter=order), len(known) - 1)
    same = known[order[at]] == key
    rows = np.flatnonzero(following)[order[at]]
    chain = np.where(same, snap.chain[rows], -1)
    return chain, np.where(same[:, None], snap.length[rows], 0.0)
