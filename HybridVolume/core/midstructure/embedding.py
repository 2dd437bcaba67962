# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What tetrahedra can have as inner faces: triangles that meet in shared corners and sides only."""

from __future__ import annotations

import logging

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..intersection import points_inside, self_intersections
from .closest import Carrier
from .given import Given
from .remesh import Remesher
from .shapes import SIDES, opening_sides

log = logging.getLogger(__name__)

# Triangles that open by less than this at a common edge lie one upon the other, degrees.
FOLD = 25.0
# Vertices keep this share of their distance to the surface from the triangles around.
CLEARANCE = 0.5
# Vertices leave the planes they lie in by so much, in units of the wanted length: four points in a
# plane are tetrahedra without volume where a sheet has a gap.
JITTER = 3e-4


def make_embeddable(mesh: Remesher, given: Given, boundary: tuple[np.ndarray, np.ndarray]) -> int:
    """Make triangles meet in shared corners and sides only, inside of a boundary.

    Vertices of triangles that cross are smoothed, then put together; what still crosses is left
    out.

    Parameters
    ----------
    mesh : Remesher
        Changed in place.
    given : Given
        The facets that it stands for.
    boundary : (vertices, triangles)
        Closed triangles around.

    Returns
    -------
    int
        Triangles that had to be left out.
    """
    noise = np.random.default_rng(0).uniform(-1.0, 1.0, mesh.x.shape)
    mesh.x = mesh.x + JITTER * mesh.h[:, None] * noise
    for attempt in range(4):
        pairs = self_intersections(mesh.x, mesh.t)
        if not len(pairs):
            break
        log.debug("%d pairs of %d triangles cross", len(pairs), len(mesh.t))
        crossing = np.unique(pairs)
        if attempt < 2:
            mesh.relax(given.back, 1, np.unique(mesh.t[crossing]))
        else:
            mesh.merge(_shortest_sides(mesh, crossing))
        mesh.unfold(FOLD)
    before = len(mesh.t)
    _keep(mesh, _without_folds(mesh.x, mesh.t))
    outer, count = boundary[1], len(boundary[0])
    everything = np.vstack([boundary[0], mesh.x])
    for _ in range(20):
        pairs = self_intersections(everything, np.vstack([outer, mesh.t + count]))
        pairs = pairs[(pairs >= len(outer)).any(axis=1)] - len(outer)
        if not len(pairs):
            break
        drop = np.zeros(len(mesh.t), dtype=bool)
        with_outer = pairs.min(axis=1) < 0
        drop[pairs[with_outer].max(axis=1)] = True
        inner = pairs[~with_outer]
        drop |= _fewest(inner[~drop[inner].any(axis=1)], len(mesh.t))
        _keep(mesh, ~drop)
    _keep(mesh, _inside(mesh, boundary))
    around = Carrier(boundary[0][outer], np.full(len(outer), np.inf))
    distance = np.linalg.norm(around.closest(mesh.x)[0] - mesh.x, axis=1)
    _keep(mesh, (distance > CLEARANCE * given.radius_at(mesh.x))[mesh.t].all(axis=1))
    mesh.compact()
    return before - len(mesh.t)


def _keep(mesh: Remesher, which: np.ndarray) -> None:
    mesh.t, mesh.sheet = mesh.t[which], mesh.sheet[which]


def _shortest_sides(mesh: Remesher, which: np.ndarray) -> np.ndarray:
    """Where vertices go when the shortest sides of some triangles are given up, (n,)."""
    to = np.arange(len(mesh.x))
    sides = mesh.t[which][:, SIDES]
    length = np.linalg.norm(mesh.x[sides[..., 0]] - mesh.x[sides[..., 1]], axis=2)
    ends = sides[np.arange(len(which)), length.argmin(axis=1)]
    free = np.ones(len(mesh.x), dtype=bool)
    for a, b in ends[np.argsort(length.min(axis=1), kind="stable")].tolist():
        if free[a] and free[b]:
            free[[a, b]] = False
            to[a] = b
    return to


def _without_folds(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Whether each triangle stays so that no two lie one upon the other at a common side."""
    sides = opening_sides(vertices, triangles, FOLD)
    return ~_fewest(sides // 3, len(triangles))


def _fewest(pairs: np.ndarray, count: int) -> np.ndarray:
    """Whether each triangle has to go so that no pair is left; those in many pairs go first."""
    drop = np.zeros(count, dtype=bool)
    if not len(pairs):
        return drop
    hits = np.bincount(pairs.ravel(), minlength=count)
    for a, b in pairs[np.argsort(-hits[pairs].max(axis=1), kind="stable")].tolist():
        if not drop[a] and not drop[b]:
            drop[a if hits[a] >= hits[b] else b] = True
    return drop


def _inside(mesh: Remesher, boundary: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Triangles within the boundary, which they do not cross: one point of each part decides."""
    if not len(mesh.t):
        return np.zeros(0, dtype=bool)
    n = len(mesh.x)
    a, b = mesh.t[:, [0, 1, 1, 2]].reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n))
    label = connected_components(graph, directed=False)[1][mesh.t[:, 0]]
    _, first, part = np.unique(label, return_index=True, return_inverse=True)
    inside = points_inside(*boundary, mesh.x[mesh.t[first]].mean(axis=1))
    return inside[part.ravel()]
