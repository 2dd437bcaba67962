# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Adapter of gmsh (GPL, optional): HXT, then Delaunay, on a discrete surface that is kept."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .mesh import tet_volumes

log = logging.getLogger(__name__)
HXT, DELAUNAY = 10, 1


def fill(
    vertices: np.ndarray,
    triangles: np.ndarray,
    facets: np.ndarray,
    max_size: float | None = None,
    grading: float | None = None,
    optimise: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Fill a closed surface; ``facets`` become faces inside.

    ``grading`` is how many mm the edges grow by a mm away from the surface; without it they are
    interpolated between its edges. gmsh always optimises, otherwise it leaves tetrahedra without
    volume; with ``optimise=False`` only the very flat ones.

    Returns
    -------
    vertices : (n, 3) array
    tets : (m, 4) int array
    """
    solids, size = _solids(vertices, triangles)
    threshold = _reachable_quality(vertices, triangles) if optimise else 0.03
    if grading is not None:
        threshold *= 0.7  # tets that grow are less regular, and gmsh tries for long
    wanted = (max_size, None if grading is None else _growing(vertices, triangles, grading))
    try:
        points, tets = _fill(vertices, solids, facets, wanted, threshold, HXT)
        # HXT leaves out what lies inside closed inner facets
        if abs(np.abs(tet_volumes(points, tets)).sum() - size) <= 1e-9 * size:
            return points, tets
    except Exception as error:  # gmsh raises plain Exception; its other algorithm is worth a try
        log.debug("HXT: %s", error)
    return _fill(vertices, solids, facets, wanted, threshold, DELAUNAY)


def _growing(
    vertices: np.ndarray, triangles: np.ndarray, grading: float
) -> Callable[[int, int, float, float, float, float], float]:
    """Size at a place, as gmsh asks for it: that of the nearest vertex' edges, and more inside.

    The size at a vertex is the harmonic mean of its edges: of stretched triangles the shorter ones
    count, or a thin core gets no vertices inside and tets as flat as its facets.
    """
    ends = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    total = np.bincount(ends.ravel(), np.repeat(1.0 / length, 2), len(vertices))
    edge = np.bincount(ends.ravel(), minlength=len(vertices)) / np.maximum(total, 1e-300)
    used = np.unique(triangles)
    tree = cKDTree(vertices[used])

    def size(dimension: int, tag: int, x: float, y: float, z: float, given: float) -> float:
        distance, place = tree.query((x, y, z))
        return float(edge[used[place]] + grading * distance)

    return size


def _reachable_quality(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Quality up to which gmsh shall optimise tetrahedra.

    They cannot be better than the triangles that they stand on; on stretched triangles 0.3 cost
    9 s for 1600 tetrahedra, 0.1 gave nearly the same ones in 2 s.
    """
    x = vertices[triangles]
    a, b, c = (np.linalg.norm(x[:, i] - x[:, j], axis=1) for i, j in ((1, 2), (2, 0), (0, 1)))
    quality = (b + c - a) * (c + a - b) * (a + b - c) / (a * b * c)
    return float(np.clip(0.6 * np.quantile(quality, 0.1), 0.05, 0.3))


def _solids(vertices: np.ndarray, triangles: np.ndarray) -> tuple[list[list[np.ndarray]], float]:
    """Closed surfaces of each solid, the outer one first, and the volume of all solids."""
    n = len(vertices)
    pairs = triangles[:, [[0, 1], [1, 2]]].reshape(-1, 2)
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    _, part = np.unique(label[triangles[:, 0]], return_inverse=True)
    x = vertices[triangles] - vertices[triangles].mean(axis=(0, 1))
    volume = np.bincount(part, np.einsum("ti,ti->t", x[:, 0], np.cross(x[:, 1], x[:, 2])) / 6.0)
    shells = [triangles[part == k] for k in range(len(volume))]
    outer = [k for k in range(len(shells)) if volume[k] > 0.0]
    outer.sort(key=lambda k: volume[k])
    solids = {k: [shells[k]] for k in outer}
    for k in set(range(len(shells))) - set(outer):
        point = vertices[shells[k][0, 0]]
        around = [j for j in outer if abs(_winding(vertices[shells[j]], point)) > 0.5]
        solids[(around or outer)[0]].append(shells[k])
    return list(solids.values()), float(volume.sum())


def _winding(corners: np.ndarray, point: np.ndarray) -> float:
    """Winding number of triangles (t, 3, 3) around a point."""
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    above = np.einsum("ti,ti->t", a, np.cross(b, c))
    below = la * lb * lc + sum(
        np.einsum("ti,ti->t", p, q) * r for p, q, r in ((a, b, lc), (b, c, la), (c, a, lb))
    )
    return float(np.arctan2(above, below).sum() / (2.0 * np.pi))


def _fill(
    vertices: np.ndarray,
    solids: list[list[np.ndarray]],
    facets: np.ndarray,
    wanted: tuple[float | None, Callable | None],
    threshold: float,
    algorithm: int,
) -> tuple[np.ndarray, np.ndarray]:
    import gmsh

    max_size, size = wanted
    gmsh.initialize(["-v", "1"], readConfigFiles=False, interruptible=False)
    try:
        for name, value in {
            "General.NumThreads": 1,
            "Mesh.Algorithm3D": algorithm,
            "Mesh.OptimizeThreshold": threshold,
            "Mesh.MeshSizeExtendFromBoundary": 1 if size is None else 0,
            "Mesh.MeshSizeFromPoints": 0,
            "Mesh.MeshSizeMax": 1e22 if max_size is None else max_size,
        }.items():
            gmsh.option.setNumber(name, value)
        gmsh.model.add("body")
        if size is not None:
            # it belongs to the current model
            gmsh.model.mesh.setSizeCallback(size)
        shells = [shell for solid in solids for shell in solid]
        surfaces = [gmsh.model.addDiscreteEntity(2) for _ in shells]
        tags = np.arange(1, len(vertices) + 1)
        gmsh.model.mesh.addNodes(2, surfaces[0], tags, np.ravel(vertices))
        for surface, shell in zip(surfaces, shells, strict=True):
            gmsh.model.mesh.addElementsByType(surface, 2, [], np.ravel(shell) + 1)
        inner = []
        if len(facets):
            inner = [gmsh.model.addDiscreteEntity(2)]
            gmsh.model.mesh.addElementsByType(inner[0], 2, [], np.ravel(facets) + 1)
        gmsh.model.mesh.reclassifyNodes()
        loops = iter([gmsh.model.geo.addSurfaceLoop([surface]) for surface in surfaces])
        volumes = [gmsh.model.geo.addVolume([next(loops) for _ in solid]) for solid in solids]
        gmsh.model.geo.synchronize()
        for volume in volumes:
            if inner:
                gmsh.model.mesh.embed(2, inner, 3, volume)
        gmsh.model.mesh.generate(3)
        tags, points, _ = gmsh.model.mesh.getNodes()
        _, nodes = gmsh.model.mesh.getElementsByType(4)
    finally:
        gmsh.finalize()
    order = np.argsort(tags)
    number = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    number[tags[order]] = np.arange(len(tags))
    return points.reshape(-1, 3)[order], number[nodes.astype(np.int64)].reshape(-1, 4)
