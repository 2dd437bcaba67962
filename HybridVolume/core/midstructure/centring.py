# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Polylines made smooth and drawn to the middle of the body."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from ...errors import FaultError
from .branches import Branches
from .distances import SurfaceDistance

# Distance of vertices along the lines, in units of the distance to the surface.
SPACING = 0.3
# Smallest gain of distance for which a vertex moves, in units of the move: along a sheet the
# distance is flat, and nothing is to be gained there.
GAIN = 0.03
# The surface is ahead of an end where the cosine to its nearest point is larger.
AHEAD = 0.6
# Steps of a quarter of the radius that an end is led on at most: the fire took about as much.
FORWARD = 8
# Vertices of one branch at most.
MOST = 2000


def centred(
    distance: SurfaceDistance, branches: Branches
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smooth lines through the middle.

    Parameters
    ----------
    distance : SurfaceDistance
    branches : Branches

    Returns
    -------
    vertices : (m, 3) array
        mm.
    facets : (f, 3) int array
        Lines (a, b, b); one point (a, a, a) where there is no branch.
    branch : (f,) int array

    Raises
    ------
    FaultError
        A line leaves the body.
    """
    if not len(branches.ends):
        vertices = _drawn(distance, branches.nodes, np.zeros((1, 3)), distance(branches.nodes), 20)
        return vertices, np.zeros((1, 3), dtype=np.int64), np.zeros(1, dtype=np.int64)
    raw = _evenly(distance, branches)
    vertices, edges, branch = raw
    neighbours = _neighbours(len(vertices), edges)
    ends = np.asarray(neighbours.sum(axis=1)).ravel() == 1
    tips = _tips(neighbours, ends)
    for k in range(8):
        for _ in range(4 if k < 5 else 1):
            vertices = np.where(ends[:, None], vertices, _smoothed(vertices, neighbours))
        radius = distance(vertices)
        vertices = _drawn(distance, vertices, _tangents(vertices, edges), radius, 2, 0.3 * 0.6**k)
        vertices[tips[:, 0]] = _straight(vertices, tips)
    vertices = np.where(ends[:, None], vertices, _smoothed(vertices, neighbours))
    if _leaves(distance, vertices, edges):
        vertices = raw[0]
        if _leaves(distance, vertices, edges):
            raise FaultError("a branch of the curve skeleton leaves the body")
    return vertices, edges[:, [0, 1, 1]], branch


def _evenly(
    distance: SurfaceDistance, branches: Branches
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices along all branches at a distance in proportion to the radius."""
    nodes = branches.nodes.copy()
    vertices = [nodes]
    count = len(nodes)
    degree = np.bincount(branches.ends.ravel(), minlength=count)
    edges, owner = [], []
    for k, (path, ends) in enumerate(zip(branches.paths, branches.ends, strict=True)):
        free = degree[ends] == 1
        path = _trimmed(distance, _combed(path), free)
        if free[1]:
            path = _extended(distance, path)
        if free[0]:
            path = _extended(distance, path[::-1])[::-1]
        nodes[ends[0]], nodes[ends[1]] = path[0], path[-1]
        length = np.linalg.norm(np.diff(path, axis=0), axis=1)
        radius = distance(path)
        need = length / (SPACING * 0.5 * (radius[1:] + radius[:-1]))
        along = np.concatenate([[0.0], np.cumsum(need)])
        pieces = int(np.clip(np.ceil(along[-1]), 3 if ends[0] == ends[1] else 1, MOST))
        at = np.linspace(0.0, along[-1], pieces + 1)[1:-1]
        inner = np.column_stack([np.interp(at, along, path[:, i]) for i in range(3)])
        number = np.concatenate([[ends[0]], count + np.arange(len(inner)), [ends[1]]])
        count += len(inner)
        vertices.append(inner)
        edges.append(np.column_stack([number[:-1], number[1:]]))
        owner.append(np.full(pieces, k))
    return np.vstack(vertices), np.concatenate(edges), np.concatenate(owner)


def _trimmed(distance: SurfaceDistance, path: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Free ends taken back to where the surface is no nearer ahead than beside the line."""
    feet = distance.nearest(path)
    ahead = (feet.points - path) / np.maximum(feet.distance, np.finfo(float).tiny)[:, None]
    low, high = 0, len(path) - 1
    for side in np.flatnonzero(free):
        while high - low > 1:
            end, before = (low, low + 1) if side == 0 else (high, high - 1)
            way = path[end] - path[before]
            if way @ ahead[end] < AHEAD * np.linalg.norm(way):
                break
            low, high = (low + 1, high) if side == 0 else (low, high - 1)
    return path[low : high + 1]


def _extended(distance: SurfaceDistance, path: np.ndarray) -> np.ndarray:
    """The last end led on in the middle of the body until the surface is ahead."""
    end = path[-1]
    radius = float(distance(end[None])[0])
    behind = np.flatnonzero(np.linalg.norm(path - end, axis=1) > radius)
    way = end - path[behind[-1] if len(behind) else 0]
    way = way / max(float(np.linalg.norm(way)), np.finfo(float).tiny)
    added = [path]
    for _ in range(FORWARD):
        trial = (end + 0.25 * radius * way)[None]
        feet = distance.nearest(trial)
        if feet.distance[0] < 0.8 * radius:
            break
        trial = _drawn(distance, trial, way[None], feet.distance, 3, 0.1)
        feet = distance.nearest(trial)
        ahead = float(way @ (feet.points - trial)[0])
        if ahead > AHEAD * feet.distance[0] or feet.distance[0] < 0.95 * radius:
            break
        end, radius = trial[0], float(feet.distance[0])
        added.append(trial)
    return np.concatenate(added)


def _combed(path: np.ndarray) -> np.ndarray:
    """The same path with less of its zigzag."""
    for _ in range(3):
        inner = 0.25 * path[:-2] + 0.5 * path[1:-1] + 0.25 * path[2:]
        path = np.concatenate([path[:1], inner, path[-1:]])
    return path


def _tips(neighbours: csr_matrix, ends: np.ndarray) -> np.ndarray:
    """Each end with the two vertices before it, (k, 3); not where a fork is so near."""
    rows = []
    degree = np.diff(neighbours.indptr)
    for end in np.flatnonzero(ends):
        one = neighbours.indices[neighbours.indptr[end]]
        if degree[one] == 2:
            two = neighbours.indices[neighbours.indptr[one] : neighbours.indptr[one + 1]]
            rows.append((end, one, int(two[two != end][0])))
    return np.array(rows, dtype=np.int64).reshape(-1, 3)


def _straight(vertices: np.ndarray, tips: np.ndarray) -> np.ndarray:
    """Ends along the line before them: beside an end face nothing tells where the middle is."""
    end, one, two = (vertices[tips[:, k]] for k in range(3))
    way = one - two
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), np.finfo(float).tiny)
    return one + np.einsum("ki,ki->k", end - one, way)[:, None] * way


def _neighbours(count: int, edges: np.ndarray) -> csr_matrix:
    both = np.vstack([edges, edges[:, ::-1]])
    return coo_matrix((np.ones(len(both)), tuple(both.T)), shape=(count, count)).tocsr()


def _smoothed(vertices: np.ndarray, neighbours: csr_matrix) -> np.ndarray:
    """Half-way to the mean of the neighbours."""
    number = np.asarray(neighbours.sum(axis=1))
    return 0.5 * vertices + 0.5 * (neighbours @ vertices) / np.maximum(number, 1.0)


def _tangents(vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Unit direction of the line at each vertex; zero at forks, which may move anywhere."""
    n = len(vertices)
    # lines run from branch to branch: the sign must not cancel
    total = np.zeros((n, 3, 3))
    way = vertices[edges[:, 1]] - vertices[edges[:, 0]]
    square = np.einsum("ei,ej->eij", way, way)
    np.add.at(total, edges[:, 0], square)
    np.add.at(total, edges[:, 1], square)
    tangent = np.linalg.eigh(total)[1][:, :, 2]
    tangent[np.bincount(edges.ravel(), minlength=n) > 2] = 0.0
    return tangent


def _drawn(
    distance: SurfaceDistance,
    vertices: np.ndarray,
    tangent: np.ndarray,
    radius: np.ndarray,
    rounds: int,
    step: float = 0.3,
) -> np.ndarray:
    """Vertices moved across their line to where the surface is farther away.

    Parameters
    ----------
    distance : SurfaceDistance
    vertices, tangent : (n, 3) arrays
        Where the tangent is zero a vertex may move anywhere.
    radius : (n,) array
        Distance of the vertices, mm.
    rounds : int
    step : float
        Length of the first moves, in units of the radius.
    """
    ways = np.array([w for w in np.ndindex(3, 3, 3) if w != (1, 1, 1)]) - 1.0
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    vertices, radius = vertices.copy(), radius.copy()
    length = step * radius
    rows = np.arange(len(vertices))
    free = (tangent == 0.0).all(axis=1)
    across = _across(tangent)
    for _ in range(rounds):
        trial = vertices[:, None] + length[:, None, None] * across
        trial[free] = vertices[free, None] + length[free, None, None] * ways[: across.shape[1]]
        value = distance(trial.reshape(-1, 3)).reshape(len(vertices), -1)
        best = value.argmax(axis=1)
        gain = value[rows, best] - radius
        # beyond the surface the distance grows as well: no move is longer than the radius
        better = gain > GAIN * length
        vertices[better] = trial[rows, best][better]
        radius[better] = value[rows, best][better]
        length[~better] *= 0.5
        if (length < 1e-3 * radius).all():
            break
    return vertices


def _across(tangent: np.ndarray) -> np.ndarray:
    """Eight unit vectors across each direction, (n, 8, 3)."""
    helper = np.eye(3)[np.abs(tangent).argmin(axis=1)]
    first = np.cross(tangent, helper)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), np.finfo(float).tiny)
    second = np.cross(tangent, first)
    angle = np.arange(8) * np.pi / 4.0
    return (
        np.cos(angle)[None, :, None] * first[:, None]
        + np.sin(angle)[None, :, None] * second[:, None]
    )


def _leaves(distance: SurfaceDistance, vertices: np.ndarray, edges: np.ndarray) -> bool:
    """Whether any line leaves the body."""
    x = vertices[edges]
    radius = distance(vertices)
    long = np.linalg.norm(x[:, 1] - x[:, 0], axis=1) > radius[edges].sum(axis=1)
    middle = x[long].mean(axis=1)
    return not (distance.inside(vertices).all() and distance.inside(middle).all())
