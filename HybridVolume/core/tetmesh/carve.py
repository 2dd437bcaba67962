# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A mesher that cannot fail: the Delaunay tetrahedra of the surface's vertices that lie inside."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay

from ...errors import MesherError
from ..intersection import points_inside
from .mesh import FACES, TetMesh, row_keys, tet_volumes

# Noise in units of the diagonal, for the triangulation only: qhull is slow on points in a plane.
JITTER = 1e-7


def carve(
    vertices: np.ndarray, triangles: np.ndarray, inner: np.ndarray | None = None
) -> tuple[TetMesh, np.ndarray]:
    """Tetrahedra of which the centre is inside the surface.

    Their boundary is the surface where all of its triangles are Delaunay, and near it elsewhere.

    Parameters
    ----------
    vertices : (n, 3) array
    triangles : (t, 3) int array
        Closed, oriented outward; they may cut each other.
    inner : (k, 3) array, optional
        More points inside.

    Returns
    -------
    mesh : TetMesh
        Of the largest connected part; not exact.
    missing : (m,) int array
        Triangles that are no faces of it.

    Raises
    ------
    MesherError
        Nothing is inside.
    """
    points = vertices if inner is None else np.vstack([vertices, inner])
    origin, span = points.mean(axis=0), float(np.linalg.norm(np.ptp(points, axis=0)))
    noise = np.random.default_rng(0).uniform(-JITTER, JITTER, points.shape)
    tets = Delaunay((points - origin) / span + noise).simplices.astype(np.int64)
    volumes = tet_volumes(points, tets)
    tets = np.where((volumes < 0.0)[:, None], tets[:, [0, 1, 3, 2]], tets)
    tets = tets[np.abs(volumes) > 1e-15 * span**3]
    tets = tets[points_inside(vertices, triangles, points[tets].mean(axis=1))]
    if not len(tets):
        raise MesherError("no tetrahedron lies inside the surface")
    tets = _largest_part(tets, points)
    used = np.unique(tets)
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    mesh = TetMesh(points[used], number[tets], "delaunay", False)
    keys = row_keys(tets[:, FACES].reshape(-1, 3), len(points))
    missing = np.flatnonzero(~np.isin(row_keys(triangles, len(points)), keys))
    return mesh, missing


def _largest_part(tets: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Tetrahedra of the largest part that hangs together through faces."""
    keys = row_keys(tets[:, FACES].reshape(-1, 3), len(points))
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order[1:]] == keys[order[:-1]])
    pairs = order[same] // 4, order[same + 1] // 4
    shape = (len(tets), len(tets))
    _, part = connected_components(coo_matrix((np.ones(len(same)), pairs), shape), directed=False)
    size = np.bincount(part, np.abs(tet_volumes(points, tets)))
    return tets[part == size.argmax()]
