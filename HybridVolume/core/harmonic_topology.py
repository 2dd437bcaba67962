# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Repair of a midstructure that lies in pieces, has holes, or misses a handle of the body.

A superlevel set {w > c} should look like the body: one part, a handle for each of the body's. Where
it changes as c rises, w has a critical vertex; joining that vertex to the midstructure along the
steepest way up undoes the change.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from .isosurface import critical_vertices, genus_from_euler, isosurface_euler, steady_level
from .laplace import Laplace
from .tetmesh import TetMesh

log = logging.getLogger(__name__)

# The highest level up to which all isosurfaces have to look like the body.
TARGET = 0.9
ROUNDS = 8
# Wrong topology over a smaller range of levels is left alone: small tetrahedra at the boundary
# make such pairs of critical vertices, and there is no midstructure to be mended beside a face.
PERSISTENCE = 0.1


def mend(
    laplace: Laplace, w: np.ndarray, fixed: np.ndarray, genus_per_shell: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Add vertices to the midstructure until the isosurfaces up to 0.9 look like the body.

    Parameters
    ----------
    laplace : Laplace
    w : (n,) array
        Its solution.
    fixed : (n,) bool array
        Vertices of the midstructure.
    genus_per_shell : sequence of int

    Returns
    -------
    w : (n,) array
        Solved anew where anything was added. The field whose isosurfaces look right up to the
        highest level, should the repair not come to an end.
    fixed : (n,) bool array
    """
    mesh, wanted = laplace.mesh, sum(genus_per_shell)
    tied = tie_parts(mesh, w, fixed)
    if len(tied):
        log.info("the midstructure lay in pieces: tied together by %d vertices", len(tied))
        fixed = fixed.copy()
        fixed[tied] = True
        w = laplace.solve(fixed, w)
    best = None
    for _ in range(ROUNDS):
        level = steady_level(mesh, w, genus_per_shell, TARGET, PERSISTENCE)
        if best is None or level > best[0]:
            best = (level, w, fixed)
        if level >= TARGET:
            break
        above, below = critical_vertices(mesh, w)
        free = ~fixed & ~mesh.on_boundary & (w > level - 1e-9)
        # a hole of the midstructure closes there as the level falls
        start = np.flatnonzero(free & (below >= 2) & (w < 0.5 * (1.0 + TARGET)))
        saddles = np.flatnonzero(free & (above >= 2))
        if len(saddles):
            first = saddles[w[saddles].argmin()]
            found = genus_from_euler(isosurface_euler(mesh, w, np.nextafter(w[first], 1.0)))
            if sum(found) < wanted or not len(start):
                start = np.append(start, first)
        added = steepest_ascent(mesh, w, fixed, start)
        if not len(added):
            break
        log.info("%d vertices added to the midstructure at critical points", len(added))
        fixed = fixed.copy()
        fixed[added] = True
        w = laplace.solve(fixed, w)
    return best[1], best[2]


def steepest_ascent(
    mesh: TetMesh, w: np.ndarray, fixed: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """Vertices on the steepest ways from all higher neighbours of the start up to the midstructure.

    Parameters
    ----------
    mesh : TetMesh
    w : (n,) array
    fixed : (n,) bool array
    start : (k,) int array

    Returns
    -------
    (m,) int array
        The start among them.
    """
    n = len(w)
    a, b = np.vstack([mesh.edges, mesh.edges[:, ::-1]]).T
    length = np.linalg.norm(mesh.vertices[b] - mesh.vertices[a], axis=1)
    slope = (w[b] - w[a]) / np.maximum(length, np.finfo(float).tiny)
    rising = slope > 0.0
    a, b, slope = a[rising], b[rising], slope[rising]
    order = np.lexsort([slope, a])
    # the last entry of each vertex is its steepest edge
    best = np.arange(n)
    best[a[order]] = b[order]
    way = np.zeros(n, dtype=bool)
    way[start] = True
    now = np.unique(b[np.isin(a, start)])
    while len(now):
        now = now[~way[now] & ~fixed[now]]
        way[now] = True
        now = np.unique(best[now])
    return np.flatnonzero(way & ~fixed & ~mesh.on_boundary)


def tie_parts(mesh: TetMesh, w: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Vertices that tie the parts of the midstructure together where they meet at the highest w.

    Where the midstructure lies in pieces, the isosurfaces near 1 do, too. Ties over the highest
    saddles join what would join at some lower level anyway, and add no handles.

    Parameters
    ----------
    mesh : TetMesh
    w : (n,) array
        The field without ties.
    fixed : (n,) bool array
        Vertices of the midstructure.
    """
    n = len(w)
    a, b = mesh.edges[~mesh.on_boundary[mesh.edges].any(axis=1)].T
    inside = fixed[a] & fixed[b]
    shape = (n, n)
    part = sparse.coo_matrix((np.ones(int(inside.sum())), (a[inside], b[inside])), shape=shape)
    if len(np.unique(connected_components(part, directed=False)[1][fixed])) <= 1:
        return np.zeros(0, dtype=np.int64)
    low = np.where(inside, 1.0, np.minimum(w[a], w[b]))
    # ties between equal values (flat tetrahedra) are broken by the length
    length = np.linalg.norm(mesh.vertices[a] - mesh.vertices[b], axis=1)
    cost = (1.0 - low) + 1e-6 * (length / length.max()) + 1e-9
    tree = minimum_spanning_tree(sparse.coo_matrix((cost, (a, b)), shape=shape)).tocoo()
    ends = np.column_stack([tree.row, tree.col])
    keep = fixed.copy()
    keep[ends] = True
    while True:
        # what hangs off the tree without a vertex of the midstructure is not needed
        degree = np.bincount(ends.ravel(), minlength=n)
        leaf = keep & ~fixed & (degree <= 1)
        if not leaf.any():
            break
        keep &= ~leaf
        ends = ends[keep[ends].all(axis=1)]
    return np.flatnonzero(keep & ~fixed)
