# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Curves along the middle of a body, with a loop for every handle."""

from __future__ import annotations

import logging

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ...errors import FaultError, InputError
from ..surface import PatchSurface
from ..tetmesh.mesh import EDGES, FACES, row_keys
from .assembled import from_pieces
from .branches import Branches, branches_of
from .centring import centred
from .collapse import Graph, collapse
from .distances import SurfaceDistance
from .lattice import Lattice, build_lattice
from .sheets import Midstructure
from .thickness import Thickness, local_thickness

log = logging.getLogger(__name__)

# Sizes of the cells that are tried, in units of half the local thickness, and the share of the
# surface around which the body is taken for thicker than it is.
SIZES = ((0.42, 0.0), (0.5, 0.0), (0.6, 0.0), (0.72, 0.0), (0.6, 0.05), (0.6, 0.15), (0.6, 0.3))
# Depths that are left out, in the same units: acute edges are too thin for the cells.
PEELS = (0.0, 0.1, 0.25)
# Cells at most; three times as many are allowed where the loops come out wrong.
CELLS = 25_000
# Length of branches that the fire leaves, in units of the radius.
LASTING = 1.0

REASON = "along the middle"


def curve_skeleton(surface: PatchSurface, samples: int = 0) -> Midstructure:
    """A connected graph of lines in the middle of the body (a curve skeleton).

    Tetrahedra inside the body are burnt down from the surface by collapses that keep every loop,
    so that the graph has one for each handle; it is then smoothed and centred.

    Parameters
    ----------
    surface : PatchSurface
        Without cavities.
    samples : int
        Cells that the body is cut into; 0 chooses by the body.

    Returns
    -------
    Midstructure
        Lines, one sheet for every branch; a single point where the body is as round as a ball.

    Raises
    ------
    InputError
        The body has cavities: no curve surrounds them. Or it is too thin for its size.
    FaultError
        The graph has not the loops of the body.
    """
    if surface.shells > 1:
        inner = surface.shells - 1
        faces = [
            patch.face
            for patch, shell in zip(surface.patches, surface.shell_of_patch, strict=True)
            if shell > 0
        ]
        raise InputError(
            f"the body has {inner} {'cavity' if inner == 1 else 'cavities'}, which no curve can "
            "surround",
            faces=list(dict.fromkeys(faces)),
            figure=float(inner),
            remedy="use the medial axis or a distance surface",
        )
    distance = SurfaceDistance(surface)
    thickness = local_thickness(distance)
    branches = _branches(distance, thickness, surface.genus[0], samples or CELLS)
    vertices, facets, piece = centred(distance, branches)
    return from_pieces(surface, distance, vertices, facets, piece, "skeleton", REASON)


def _branches(distance: SurfaceDistance, thickness: Thickness, genus: int, cells: int) -> Branches:
    """Branches with as many loops as the body has handles; smaller cells where they are wrong."""
    found = ""
    for limit in (cells, 3 * cells):
        for size, thin in SIZES if limit == cells else ((0.3, 0.0), *SIZES):
            half = np.maximum(thickness.half, _quantile(thickness, thin))
            lattice = _lattice(distance, half[thickness.of_sample], size, limit)
            if lattice is None:
                continue
            near = distance.rough(lattice.points + lattice.origin)[1]
            scale = np.maximum(lattice.depth, half[thickness.of_sample[near]])
            for peel in PEELS:
                inside = _inside(distance, lattice, peel * scale)
                if inside is None:
                    found = "nothing inside"
                    continue
                handles = 1 - _euler(inside)
                if handles != genus:
                    found = f"{handles} handles in place of {genus}"
                    log.info("cells of %g of the thickness: %s", size, found)
                    continue
                graph = collapse(
                    lattice.points, lattice.depth, lattice.inward, scale, inside, LASTING
                )
                if not graph.solid and _loops(graph) == genus:
                    points = lattice.points + lattice.origin
                    return branches_of(graph, points, lattice.depth, scale)
                found = "a cavity"
            break
    if not found:
        raise InputError(
            f"the body is too thin for its size: {3 * cells} cells are not enough for its skeleton",
            figure=float(3 * cells),
            remedy="give more samples, or use the medial axis",
        )
    raise FaultError(
        f"the curve skeleton is wrong: {found}",
        remedy="give more samples, or use the medial axis",
    )


def _quantile(thickness: Thickness, share: float) -> float:
    """Half the thickness that so much of the surface stays below."""
    if share == 0.0:
        return 0.0
    order = np.argsort(thickness.half)
    area = np.cumsum(thickness.area[order])
    return float(thickness.half[order[np.searchsorted(area, share * area[-1])]])


def _lattice(
    distance: SurfaceDistance, half: np.ndarray, size: float, limit: int
) -> Lattice | None:
    """Points inside at a distance in proportion to half the thickness, given at the samples."""

    def wanted(sample: np.ndarray, depth: np.ndarray) -> np.ndarray:
        return size * np.maximum(half[sample], depth)

    def needed(depth: np.ndarray, half: float) -> np.ndarray:
        return depth > -half

    return build_lattice(distance, wanted, needed, np.inf, limit=limit)


def _inside(distance: SurfaceDistance, lattice: Lattice, least: np.ndarray) -> np.ndarray | None:
    """Tetrahedra of the largest part that is as deep, of which no edge leaves the body."""
    tets = lattice.tets[(lattice.depth > least)[lattice.tets].all(axis=1)]
    if not len(tets):
        return None
    n = len(lattice.points)
    _, first, inverse = np.unique(
        row_keys(tets[:, EDGES].reshape(-1, 2), n), return_index=True, return_inverse=True
    )
    pairs = tets[:, EDGES].reshape(-1, 2)[first]
    leaves = _leaving(distance, lattice, pairs)
    tets = tets[~leaves[inverse.reshape(-1, 6)].any(axis=1)]
    if not len(tets):
        return None
    graph = coo_matrix(
        (np.ones(3 * len(tets)), (np.repeat(tets[:, 0], 3), tets[:, 1:].ravel())), shape=(n, n)
    )
    _, label = connected_components(graph, directed=False)
    size = np.bincount(label[tets[:, 0]])
    return tets[label[tets[:, 0]] == size.argmax()]


def _leaving(distance: SurfaceDistance, lattice: Lattice, pairs: np.ndarray) -> np.ndarray:
    """Which edges leave the body between their ends."""
    result = np.zeros(len(pairs), dtype=bool)
    a, b = (lattice.points[pairs[:, k]] for k in (0, 1))
    deep_a, deep_b = (lattice.depth[pairs[:, k]] for k in (0, 1))
    owner = np.arange(len(pairs))
    for _ in range(3):
        # where the balls around both ends meet, the edge lies in them
        open_ = np.linalg.norm(a - b, axis=1) > deep_a + deep_b
        a, b, deep_a, deep_b, owner = (x[open_] for x in (a, b, deep_a, deep_b, owner))
        if not len(owner):
            break
        middle = 0.5 * (a + b)
        deep = distance(middle + lattice.origin)
        out = ~distance.inside(middle + lattice.origin)
        result[owner[out]] = True
        a, b = np.vstack([a[~out], middle[~out]]), np.vstack([middle[~out], b[~out]])
        deep_a = np.concatenate([deep_a[~out], deep[~out]])
        deep_b = np.concatenate([deep[~out], deep_b[~out]])
        owner = np.tile(owner[~out], 2)
    return result


def _euler(tets: np.ndarray) -> int:
    """Euler characteristic of tetrahedra."""
    n = int(tets.max()) + 1
    faces = np.unique(row_keys(tets[:, FACES].reshape(-1, 3), n))
    edges = np.unique(row_keys(tets[:, EDGES].reshape(-1, 2), n))
    return len(np.unique(tets)) - len(edges) + len(faces) - len(tets)


def _loops(graph: Graph) -> int:
    """Number of independent loops."""
    if not len(graph.edges):
        return 0
    used, edges = np.unique(graph.edges, return_inverse=True)
    edges = edges.reshape(-1, 2)
    n = len(used)
    parts, _ = connected_components(
        coo_matrix((np.ones(len(edges)), tuple(edges.T)), shape=(n, n)), directed=False
    )
    return len(edges) - n + parts
