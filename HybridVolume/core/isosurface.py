# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Topology of the isosurfaces of a piecewise linear function, by marching tetrahedra."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from .tetmesh.mesh import EDGES, FACES, TetMesh, row_keys


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


def genus_from_euler(euler: np.ndarray) -> tuple[int, ...]:
    """Genus of closed components, sorted."""
    return tuple(sorted(int(x) for x in (2 - euler) // 2))
