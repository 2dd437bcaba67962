# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Kept facets as a coarse, even triangle complex that tetrahedra can have as inner faces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..intersection import points_inside, self_intersections
from ..tetmesh.mesh import row_keys
from .sheets import Midstructure

# Triangles that open by less than this at a common edge lie one upon the other, degrees.
FOLD = 25.0


@dataclass(frozen=True)
class Complex:
    """Even triangles in place of the kept facets, and what they do not reach.

    Attributes
    ----------
    vertices : (m, 3) array
        mm.
    triangles : (f, 3) int array
        They meet only in shared vertices and edges.
    rest : (k, 3) array
        Points of lines and specks of the midstructure, mm.
    rest_radius : (k,) array
        Distance to the surface there, mm.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    rest: np.ndarray
    rest_radius: np.ndarray


def spread(points: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    """Numbers of points at least ``spacing`` apart, such that every point is near one."""
    tree = cKDTree(points)
    free = np.ones(len(points), dtype=bool)
    chosen = []
    for i in np.random.default_rng(0).permutation(len(points)):
        if free[i]:
            chosen.append(i)
            free[tree.query_ball_point(points[i], spacing[i])] = False
    return np.array(chosen, dtype=np.int64)


def simplify(
    midstructure: Midstructure,
    size: Callable[[np.ndarray], np.ndarray],
    boundary: tuple[np.ndarray, np.ndarray],
) -> Complex:
    """Even triangles for the kept facets.

    Vertices are chosen among those of the facets; every facet vertex goes to the nearest of them,
    and facets whose corners go to three different ones become the triangles. Triangles that cross
    each other or the boundary are left out.

    Parameters
    ----------
    midstructure : Midstructure
    size : callable
        Wanted edge length, mm, where the surface is (k,) mm away.
    boundary : (vertices, triangles)
        The closed triangles that will surround it.
    """
    facets = midstructure.facets[midstructure.kept]
    used, local = np.unique(facets, return_inverse=True)
    local = local.reshape(-1, 3)
    points, radius = midstructure.vertices[used], midstructure.radius[used]
    wanted = size(radius)
    chosen = spread(points, wanted)
    vertices = points[chosen]
    label = cKDTree(vertices).query(points)[1]
    triangles = np.sort(label[local], axis=1)
    real = (np.diff(triangles, axis=1) > 0).all(axis=1)
    triangles = np.unique(triangles[real], axis=0)
    triangles = triangles[_shape(vertices, triangles) > 0.05]
    triangles = _without_folds(vertices, triangles)
    triangles = _inside(vertices, _embeddable(vertices, triangles, boundary), boundary)
    kept, triangles = np.unique(triangles, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    rest = np.arange(len(points))
    if len(kept):
        reached = np.vstack([vertices[kept], vertices[kept][triangles].mean(axis=1)])
        rest = np.flatnonzero(cKDTree(reached).query(points)[0] > wanted)
    rest = rest[spread(points[rest], 0.25 * radius[rest])] if len(rest) else rest
    return Complex(vertices[kept], triangles, points[rest], radius[rest])


def _shape(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """1 for equilateral triangles, 0 for flat ones."""
    x = vertices[triangles]
    sides = x[:, [1, 2, 0]] - x
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return area / np.sqrt(0.75) / np.maximum((sides**2).sum(axis=2).max(axis=1), 1e-300)


def _without_folds(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Triangles of which no two lie on the same side of a common edge, one upon the other."""
    n = len(vertices)
    sides = np.array([[0, 1, 2], [1, 2, 0], [2, 0, 1]])
    corners = triangles[:, sides].reshape(-1, 3)
    keys = row_keys(corners[:, :2], n)
    order = np.argsort(keys, kind="stable")
    along = vertices[corners[:, 1]] - vertices[corners[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    away = vertices[corners[:, 2]] - vertices[corners[:, 0]]
    away -= np.einsum("ij,ij->i", away, along)[:, None] * along
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    pairs = []
    for step in range(1, 8):
        a, b = order[:-step], order[step:]
        same = keys[a] == keys[b]
        if not same.any():
            break
        a, b = a[same], b[same]
        folded = np.einsum("ij,ij->i", away[a], away[b]) > np.cos(np.radians(FOLD))
        pairs.append(np.column_stack([a[folded], b[folded]]) // 3)
    return triangles[~_fewest(np.concatenate(pairs), len(triangles))] if pairs else triangles


def _fewest(pairs: np.ndarray, count: int) -> np.ndarray:
    """Whether each triangle has to go so that no pair is left; those in many pairs go first."""
    drop = np.zeros(count, dtype=bool)
    hits = np.bincount(pairs.ravel(), minlength=count)
    for a, b in pairs[np.argsort(-hits[pairs].max(axis=1), kind="stable")]:
        if not drop[a] and not drop[b]:
            drop[a if hits[a] >= hits[b] else b] = True
    return drop


def _embeddable(
    vertices: np.ndarray, triangles: np.ndarray, boundary: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Triangles that cross neither the boundary nor each other."""
    outer_vertices, outer = boundary
    count = len(outer_vertices)
    everything = np.vstack([outer_vertices, vertices])
    for _ in range(20):
        if not len(triangles):
            break
        pairs = self_intersections(everything, np.vstack([outer, triangles + count]))
        pairs = pairs[(pairs >= len(outer)).any(axis=1)] - len(outer)
        if not len(pairs):
            break
        drop = np.zeros(len(triangles), dtype=bool)
        with_outer = pairs.min(axis=1) < 0
        drop[pairs[with_outer].max(axis=1)] = True
        inner = pairs[~with_outer]
        inner = inner[~drop[inner].any(axis=1)]
        drop |= _fewest(inner, len(triangles))
        triangles = triangles[~drop]
    return triangles


def _inside(
    vertices: np.ndarray, triangles: np.ndarray, boundary: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Triangles within the boundary, which they do not cross: one point of each part decides."""
    if not len(triangles):
        return triangles
    n = len(vertices)
    a, b = triangles[:, [0, 1, 1, 2]].reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n))
    label = connected_components(graph, directed=False)[1][triangles[:, 0]]
    _, first, part = np.unique(label, return_index=True, return_inverse=True)
    inside = points_inside(*boundary, vertices[triangles[first]].mean(axis=1))
    return triangles[inside[part.ravel()]]
