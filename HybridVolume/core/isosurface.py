# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Isosurfaces of a piecewise linear function, and their topology, by marching tetrahedra."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from .tetmesh.mesh import EDGES, FACES, TetMesh, row_keys


def isosurface(mesh: TetMesh, values: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the isosurface.

    Parameters
    ----------
    mesh : TetMesh
    values : (n,) array
        Of the piecewise linear function; values equal to the level count as above it.
    level : float

    Returns
    -------
    vertices : (k, 3) array
        One on every cut edge, mm.
    triangles : (m, 3) int array
        Their normals point to where the function is smaller.
    """
    ends, share, triangles = isosurface_cuts(mesh, values, level)
    one, two = mesh.vertices[ends.T]
    share = share[:, None]
    return (1.0 - share) * one + share * two, triangles


def isosurface_cuts(
    mesh: TetMesh, values: np.ndarray, level: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The isosurface as cuts of edges, so that other values can be taken there as well.

    Parameters
    ----------
    mesh, values, level
        As for :func:`isosurface`.

    Returns
    -------
    ends : (k, 2) int array
        Vertices of each cut edge.
    share : (k,) array
        Where it is cut: 0 at its first end, 1 at the second.
    triangles : (m, 3) int array
        Of cuts.
    """
    n = len(mesh.vertices)
    above = values >= level
    code = above[mesh.tets] @ np.array([1, 2, 4, 8])
    triangles = []
    for case, rows in _MARCHING.items():
        tets = mesh.tets[code == case]
        if len(tets):
            triangles.extend(tets[:, row] for row in rows)
    if not triangles:
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0), np.zeros((0, 3), dtype=np.int64)
    ends = np.concatenate(triangles)  # (m, 3, 2), the upper end of each cut edge first
    keys, number = np.unique(row_keys(ends.reshape(-1, 2), n), return_inverse=True)
    one, two = keys // n, keys % n
    # rounding must not take the point off the edge
    share = np.clip((level - values[one]) / (values[two] - values[one]), 0.0, 1.0)
    return np.column_stack([one, two]), share, number.reshape(-1, 3)


def _marching_cases() -> dict[int, list[np.ndarray]]:
    """Corners (upper, lower) of the cut edges of each triangle, for every set of upper corners."""
    # right-handed orders of the corners that start with each corner or pair
    single = {0: (1, 2, 3), 1: (0, 3, 2), 2: (0, 1, 3), 3: (0, 2, 1)}
    double = {
        (0, 1): (2, 3), (0, 2): (3, 1), (0, 3): (1, 2),
        (1, 2): (0, 3), (1, 3): (2, 0), (2, 3): (0, 1),
    }  # fmt: skip
    cases: dict[int, list[np.ndarray]] = {}
    for corner, (a, b, c) in single.items():
        up = np.array([[corner, a], [corner, b], [corner, c]])
        cases[1 << corner] = [up]
        cases[15 - (1 << corner)] = [up[[0, 2, 1]][:, ::-1]]
    for (i, j), (a, b) in double.items():
        ring = np.array([[i, a], [i, b], [j, b], [j, a]])
        cases[(1 << i) | (1 << j)] = [ring[[0, 1, 2]], ring[[0, 2, 3]]]
    return cases


_MARCHING = _marching_cases()


def isosurface_euler(mesh: TetMesh, values: np.ndarray, level: float) -> np.ndarray:
    """Euler characteristic of every closed component of the isosurface, largest last.

    Vertices of the isosurface lie on cut edges, its edges on cut faces, and its polygons in cut
    tetrahedra. Values equal to the level count as above it.

    Parameters
    ----------
    mesh : TetMesh
    values : (n,) array
        Of the piecewise linear function.
    level : float
        Away from the values on the boundary, so that the isosurface is closed.

    Returns
    -------
    (k,) int array
    """
    n = len(mesh.vertices)
    above = values >= level
    sides = above[mesh.tets].sum(axis=1)
    tets = mesh.tets[(sides > 0) & (sides < 4)]
    if not len(tets):
        return np.zeros(0, dtype=int)
    pairs = tets[:, EDGES]
    cut = above[pairs[..., 0]] != above[pairs[..., 1]]
    tet = np.nonzero(cut)[0]
    keys, vertex = np.unique(row_keys(pairs[cut], n), return_inverse=True)
    faces = tets[:, FACES]
    crossed = np.ptp(above[faces].astype(np.int8), axis=2) > 0
    face_tet = np.nonzero(crossed)[0]
    _, first = np.unique(row_keys(faces[crossed], n), return_index=True)
    # tetrahedra that share a cut edge belong to one component
    graph = coo_matrix(
        (np.ones(len(tet)), (tet, len(tets) + vertex)), shape=(len(tets) + len(keys),) * 2
    )
    count, label = connected_components(graph, directed=False)
    polygons = np.bincount(label[: len(tets)], minlength=count)
    vertices = np.bincount(label[len(tets) :], minlength=count)
    edges = np.bincount(label[face_tet[first]], minlength=count)
    euler = vertices - edges + polygons
    return euler[np.argsort(polygons, kind="stable")]


def critical_vertices(mesh: TetMesh, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parts of the higher and of the lower neighbourhood of every vertex.

    Both are 1 at an ordinary inner vertex. Two higher parts join there as the level falls; two
    lower parts are separated there: a hole closes.

    Parameters
    ----------
    mesh : TetMesh
    values : (n,) array

    Returns
    -------
    above, below : (n,) int arrays
    """
    n = len(values)
    rank = np.empty(n, dtype=np.int64)
    rank[np.argsort(values, kind="stable")] = np.arange(n)
    edges = mesh.edges
    swap = rank[edges[:, 0]] > rank[edges[:, 1]]
    lower, upper = np.where(swap[:, None], edges[:, ::-1], edges).T
    edge_keys = row_keys(edges, n)
    faces = mesh.faces
    faces = np.take_along_axis(faces, rank[faces].argsort(axis=1), axis=1)
    number = [
        np.searchsorted(edge_keys, row_keys(faces[:, pair], n)) for pair in ([0, 1], [0, 2], [1, 2])
    ]
    result = []
    for owner, one, two in ((lower, number[0], number[1]), (upper, number[1], number[2])):
        graph = coo_matrix((np.ones(len(one)), (one, two)), shape=(len(edges), len(edges)))
        _, label = connected_components(graph, directed=False)
        _, first = np.unique(label, return_index=True)
        result.append(np.bincount(owner[first], minlength=n))
    return result[0], result[1]


def largest_level(
    mesh: TetMesh, values: np.ndarray, genus_per_shell: Sequence[int], asked: float
) -> float:
    """The largest level up to ``asked`` whose isosurface has these genera, 0 when there is none.

    Between critical vertices the isosurface keeps its topology, so that one level is enough there.

    Parameters
    ----------
    mesh : TetMesh
    values : (n,) array
        0 on the boundary.
    genus_per_shell : sequence of int
        In any order.
    asked : float
    """
    wanted = tuple(sorted(int(g) for g in genus_per_shell))

    def fits(level: float) -> bool:
        return genus_from_euler(isosurface_euler(mesh, values, level)) == wanted

    if fits(asked):
        return float(asked)
    steps = _steps(mesh, values, asked)
    # the sum over all components costs nothing: only where it is right they are told apart
    total = total_euler(mesh, values, 0.5 * (steps[:-1] + steps[1:]))
    for k in np.flatnonzero(total == 2 * len(wanted) - 2 * sum(wanted))[::-1]:
        if fits(0.5 * (steps[k] + steps[k + 1])):
            return float(steps[k + 1] - 1e-3 * (steps[k + 1] - steps[k]))
    return 0.0


def steady_level(
    mesh: TetMesh,
    values: np.ndarray,
    genus_per_shell: Sequence[int],
    asked: float,
    persistence: float,
) -> float:
    """The level up to which isosurfaces have these genera together, at most ``asked``.

    A level at which a lost handle and one too many cancel does not count as right. What comes and
    goes within a small range of levels is no matter of the midstructure and counts as right, if
    the range ends below ``asked``.

    Parameters
    ----------
    mesh, values, genus_per_shell, asked
        As for :func:`largest_level`.
    persistence : float
        That range.
    """
    steps = _steps(mesh, values, asked)
    total = total_euler(mesh, values, 0.5 * (steps[:-1] + steps[1:]))
    wrong = total != 2 * len(genus_per_shell) - 2 * sum(genus_per_shell)
    edge = np.diff(np.concatenate([[False], wrong, [False]]).astype(int))
    for first, last in zip(np.flatnonzero(edge > 0), np.flatnonzero(edge < 0), strict=True):
        if steps[last] - steps[first] > persistence or last == len(wrong):
            return float(steps[first])
    return float(asked)


def _steps(mesh: TetMesh, values: np.ndarray, asked: float) -> np.ndarray:
    """Levels of critical vertices between 0 and a level, both ends included."""
    above, below = critical_vertices(mesh, values)
    turning = ~mesh.on_boundary & ((above != 1) | (below != 1)) & (values < asked)
    steps = np.concatenate([[0.0], np.unique(values[turning]), [asked]])
    return steps[np.append(True, np.diff(steps) > 1e-6)]


def total_euler(mesh: TetMesh, values: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Euler characteristic of the whole isosurface at many levels, (k,)."""
    result = np.zeros(len(levels), dtype=np.int64)
    for sign, cells in ((1, mesh.edges), (-1, mesh.faces), (1, mesh.tets)):
        ends = values[cells]
        lowest, highest = np.sort(ends.min(axis=1)), np.sort(ends.max(axis=1))
        cut = np.searchsorted(lowest, levels) - np.searchsorted(highest, levels)
        result += sign * cut
    return result


def genus_from_euler(euler: np.ndarray) -> tuple[int, ...]:
    """Genus of closed components, sorted."""
    return tuple(sorted(int(x) for x in (2 - euler) // 2))
