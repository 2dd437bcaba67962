# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Interior Voronoi facets of surface samples: the raw medial axis with its feet on the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay

from ..tetmesh.mesh import EDGES, FACES, row_keys
from .samples import Samples

# Off-plane noise, relative to the diagonal: without it qhull is quadratic on coplanar points.
JITTER = 1e-6


@dataclass(frozen=True)
class VoronoiFacets:
    """Convex polygons, each half-way between two samples.

    Attributes
    ----------
    vertices : (m, 3) array
        Centres of the largest empty balls, mm.
    radius : (m,) array
        Their radii, mm.
    start : (f + 1,) int array
        Polygon i has the corners ``corners[start[i]:start[i + 1]]``, in order around it.
    corners : (s,) int array
    feet : (f, 2) int array
        The two samples.
    edges : (e, 2) int array
        Pairs of facets that share a Voronoi edge.
    edge : (e,) int array
        Number of that Voronoi edge; three facets meet where it occurs three times.
    balls : (b, 3) array
        Centres of all largest empty balls inside, those of noise as well, mm.
    ball_radius : (b,) array
        Their radii, mm.
    """

    vertices: np.ndarray
    radius: np.ndarray
    start: np.ndarray
    corners: np.ndarray
    feet: np.ndarray
    edges: np.ndarray
    edge: np.ndarray
    balls: np.ndarray
    ball_radius: np.ndarray


def circumcentres(points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Centres of the balls through the corners of tetrahedra, (m, 3); not finite for flat ones."""
    x = points[tets]
    a, b, c = (x[:, i] - x[:, 0] for i in (1, 2, 3))
    bc, ca, ab = np.cross(b, c), np.cross(c, a), np.cross(a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = (
            np.einsum("mi,mi->m", a, a)[:, None] * bc
            + np.einsum("mi,mi->m", b, b)[:, None] * ca
            + np.einsum("mi,mi->m", c, c)[:, None] * ab
        ) / (2.0 * np.einsum("mi,mi->m", a, bc))[:, None]
    return x[:, 0] + offset


def interior_facets(samples: Samples, min_angle: float, seed: int = 0) -> VoronoiFacets:
    """Voronoi facets that lie inside the body and whose feet face away from each other.

    Parameters
    ----------
    samples : Samples
    min_angle : float
        Smallest angle between the normals at the feet, degrees: neighbours on one smooth face
        have none, and what Voronoi facets they share is noise.
    seed : int
        Of the jitter that goes into the triangulation, not into the result.
    """
    # qhull loses digits far from the origin
    origin = samples.points.mean(axis=0)
    points, normals = samples.points - origin, samples.normals
    diagonal = np.linalg.norm(np.ptp(points, axis=0))
    noise = np.random.default_rng(seed).uniform(-1.0, 1.0, points.shape) * (JITTER * diagonal)
    moved = points + noise
    tets = Delaunay(moved).simplices.astype(np.int64)
    centres = circumcentres(moved, tets)
    out = np.einsum("mki,mki->mk", centres[:, None] - points[tets], normals[tets])
    inside = (out < 0.0).sum(axis=1) >= 3
    # circumcentres of flat tetrahedra lie anywhere
    inside &= np.linalg.norm(centres - points[tets[:, 0]], axis=1) < 0.5 * diagonal

    n = len(points)
    pairs = tets[:, EDGES].reshape(-1, 2)
    cosine = np.einsum("ki,ki->k", normals[pairs[:, 0]], normals[pairs[:, 1]])
    facing = np.flatnonzero(cosine < np.cos(np.radians(min_angle)))
    keys, edge = np.unique(row_keys(pairs[facing], n), return_inverse=True)
    tet = facing // 6
    whole = np.bincount(edge, ~inside[tet], len(keys)) == 0
    use = whole[edge]
    edge, tet = edge[use], tet[use]
    number = np.cumsum(whole) - 1
    edge = number[edge]
    feet = np.column_stack([keys[whole] // n, keys[whole] % n])

    edge, tet, start = _rings(points, feet, centres, edge, tet)
    vertices, corners = np.unique(tet, return_inverse=True)
    touching = points[tets[vertices]]
    radius = np.linalg.norm(centres[vertices][:, None] - touching, axis=2).mean(axis=1)
    shared, which = _shared_edges(tets, feet, tet, edge, n)
    return VoronoiFacets(
        centres[vertices] + origin,
        radius,
        start,
        corners,
        feet,
        shared,
        which,
        centres[inside] + origin,
        np.linalg.norm(centres[inside] - points[tets[inside, 0]], axis=1),
    )


def _rings(
    points: np.ndarray, feet: np.ndarray, centres: np.ndarray, edge: np.ndarray, tet: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Put the ball centres of every facet in order around the line of its feet."""
    axis = points[feet[:, 1]] - points[feet[:, 0]]
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = axis / np.maximum(length, np.finfo(float).tiny)
    helper = np.zeros_like(axis)
    helper[np.arange(len(axis)), np.abs(axis).argmin(axis=1)] = 1.0
    first = np.cross(axis, helper)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), np.finfo(float).tiny)
    second = np.cross(axis, first)
    count = np.bincount(edge, minlength=len(feet))
    middle = np.column_stack(
        [np.bincount(edge, centres[tet, i], len(feet)) for i in range(3)]
    ) / np.maximum(count, 1)[:, None]  # fmt: skip
    offset = centres[tet] - middle[edge]
    angle = np.arctan2(
        np.einsum("ki,ki->k", offset, second[edge]), np.einsum("ki,ki->k", offset, first[edge])
    )
    order = np.lexsort([angle, edge])
    return edge[order], tet[order], np.concatenate([[0], np.cumsum(count)])


def _shared_edges(
    tets: np.ndarray, feet: np.ndarray, tet: np.ndarray, facet: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of facets whose Delaunay edges lie in one Delaunay triangle (= one Voronoi edge)."""
    # a facet and each face of its tetrahedra that contains its two feet
    faces = tets[tet][:, FACES]
    p, q = feet[facet, 0], feet[facet, 1]
    holds = (faces == p[:, None, None]).any(axis=2) & (faces == q[:, None, None]).any(axis=2)
    row, which = np.nonzero(holds)
    _, label = np.unique(row_keys(faces[row, which], n), return_inverse=True)
    # one number for the pair: rows are slow to make unique
    total = len(feet)
    entries = np.unique(label.ravel() * total + facet[row])
    label, members = entries // total, entries % total
    count = np.bincount(label, minlength=1)
    first = np.concatenate([[0], np.cumsum(count)])[:-1]
    pairs, edge = [], []
    for a, b in ((0, 1), (0, 2), (1, 2)):
        has = np.flatnonzero(count > b)
        pairs.append(np.column_stack([members[first[has] + a], members[first[has] + b]]))
        edge.append(has)
    return np.concatenate(pairs), np.concatenate(edge)
