# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The user's own points, lines and faces as the midstructure."""

from __future__ import annotations

import logging

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ...errors import InputError
from ..intersection import surfaces_intersect
from ..surface import PatchSurface
from .assembled import connected_facets, facet_dimensions, facet_measures, from_pieces
from .distances import SurfaceDistance
from .sheets import Midstructure

log = logging.getLogger(__name__)

# Smallest distance to the surface, and largest distance of vertices that are one; both in units of
# the body's diagonal.
CLEARANCE = 1e-4
SAME = 1e-7

REASON = "given by the user"


def own_midstructure(
    surface: PatchSurface, vertices: np.ndarray, facets: np.ndarray
) -> Midstructure:
    """Take geometry that the user made as the midstructure.

    Parameters
    ----------
    surface : PatchSurface
    vertices : (m, 3) array
        mm.
    facets : (f, 3) int array
        Triangles; (a, b, b) is a line, (a, a, a) a point.

    Returns
    -------
    Midstructure
        One sheet for every connected piece; vertices at one place are one.

    Raises
    ------
    InputError
        The arrays are no geometry, or it does not lie inside the body: the message tells how much
        of it, the figure how far, mm.
    """
    vertices, facets = _checked(vertices, facets)
    vertices, facets = _welded(vertices, facets, SAME * surface.diagonal)
    distance = SurfaceDistance(surface)
    _check_inside(distance, vertices, CLEARANCE * surface.diagonal)
    _check_uncut(distance, vertices, facets)
    piece = connected_facets(facets, len(vertices))
    return from_pieces(surface, distance, vertices, facets, piece, "own", REASON)


def _checked(vertices: np.ndarray, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.asarray(vertices, dtype=float)
    facets = np.asarray(facets)
    remedy = "give vertices (m, 3) in mm and facets (f, 3) of vertex numbers"
    if vertices.ndim != 2 or vertices.shape[1] != 3 or facets.ndim != 2 or facets.shape[1] != 3:
        raise InputError(
            f"arrays of the shapes {vertices.shape} and {facets.shape} are no midstructure",
            remedy=remedy,
        )
    if not len(facets):
        raise InputError(
            "the midstructure has no facets",
            remedy="choose points, wires or faces inside the body",
        )
    if not np.issubdtype(facets.dtype, np.integer):
        raise InputError("facets are not whole numbers", remedy=remedy)
    bad = int((~np.isfinite(vertices)).any(axis=1).sum())
    if bad:
        raise InputError(
            f"{bad} of {len(vertices)} vertices of the midstructure are not finite", remedy=remedy
        )
    facets = facets.astype(np.int64)
    wrong = int(((facets < 0) | (facets >= len(vertices))).any(axis=1).sum())
    if wrong:
        raise InputError(
            f"{wrong} of {len(facets)} facets refer to vertices that do not exist", remedy=remedy
        )
    return vertices, facets


def _welded(
    vertices: np.ndarray, facets: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Unite vertices at one place; facets that lose an area, and repeated ones, fall out."""
    given = facet_dimensions(facets)
    used = np.unique(facets)
    # far from the origin digits would be lost
    pairs = cKDTree(vertices[used] - vertices[used[0]]).query_pairs(
        tolerance, output_type="ndarray"
    )
    graph = coo_matrix((np.ones(len(pairs)), tuple(pairs.T)), shape=(len(used), len(used)))
    _, label = connected_components(graph, directed=False)
    first = np.unique(label, return_index=True)[1]
    number = np.full(len(vertices), -1)
    number[used] = label
    facets, vertices = number[facets], vertices[used[first]]

    a, b, c = facets.T
    line = (a == b) | (b == c) | (c == a)
    facets[line] = np.column_stack([a, np.where(a == b, c, b), np.where(a == b, c, b)])[line]
    dimension, measure = facet_dimensions(facets), facet_measures(vertices, facets)
    thin = (dimension == 2) & (measure <= tolerance**2)
    lost = (dimension < given) | thin
    if lost.any():
        log.info("%d of %d facets of the midstructure have no extent", lost.sum(), len(facets))
    facets = facets[~lost]
    if not len(facets):
        raise InputError(
            "no facet of the midstructure has an extent",
            remedy="choose larger geometry, or a single point",
        )
    _, first = np.unique(np.sort(facets, axis=1), axis=0, return_index=True)
    facets = facets[np.sort(first)]
    used, facets = np.unique(facets, return_inverse=True)
    return vertices[used], facets.reshape(-1, 3)


def _check_inside(distance: SurfaceDistance, vertices: np.ndarray, clearance: float) -> None:
    feet = distance.nearest(vertices)
    signed = np.where(distance.inside(vertices), feet.distance, -feet.distance)
    # the triangles that tell inside from outside do not follow the surface exactly
    near = np.flatnonzero(feet.distance < 50.0 * clearance)
    if len(near):
        outward = np.einsum(
            "ni,ni->n", vertices[near] - feet.points[near], distance.normals[feet.sample[near]]
        )
        signed[near] = np.where(outward < 0.0, feet.distance[near], -feet.distance[near])
    bad = signed < clearance
    if not bad.any():
        return
    worst = float(signed.min())
    names = [distance.surface.patches[k].face for k in feet.patch[bad]]
    outside = int((signed < -clearance).sum())
    if outside:
        where = f"{outside} of {len(vertices)} vertices of the midstructure lie outside the body"
        text = f"{where}, up to {-worst:.3g} mm"
    else:
        where = f"{bad.sum()} of {len(vertices)} vertices of the midstructure touch the surface"
        text = f"{where}: at least {clearance:.3g} mm from it are needed"
    raise InputError(
        text,
        faces=list(dict.fromkeys(names)),
        figure=worst,
        remedy="move or shrink the geometry so that all of it lies inside the body",
    )


def _check_uncut(distance: SurfaceDistance, vertices: np.ndarray, facets: np.ndarray) -> None:
    """No line or triangle may leave the body between its corners."""
    dimension = facet_dimensions(facets)
    number = np.flatnonzero(dimension > 0)
    if not len(number):
        return
    some = facets[number]
    origin = distance.origin
    corners = vertices[some] - origin
    lines = dimension[number] == 1
    # a line becomes a triangle of next to no width
    along = corners[lines, 1] - corners[lines, 0]
    across = np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)])
    across *= SAME * distance.surface.diagonal / np.linalg.norm(across, axis=1, keepdims=True)
    corners[lines, 2] = corners[lines, :2].mean(axis=1) + across
    mesh = distance.mesh
    pairs = surfaces_intersect(
        corners.reshape(-1, 3),
        np.arange(3 * len(corners)).reshape(-1, 3),
        mesh.vertices - origin,
        mesh.triangles,
    )
    if not len(pairs):
        return
    crossing = np.unique(pairs[:, 0])
    patches = mesh.triangle_patch[pairs[:, 1]]
    names = [distance.surface.patches[k].face for k in patches]
    # how far it goes out: places spread over what crosses
    share = np.array([(i, j, 12 - i - j) for i in range(13) for j in range(13 - i)]) / 12.0
    places = np.einsum("sk,fki->fsi", share, vertices[some[crossing]]).reshape(-1, 3)
    places = places[~distance.inside(places)]
    worst = -float(distance(places).max()) if len(places) else 0.0
    raise InputError(
        f"{len(crossing)} of {len(facets)} facets of the midstructure cut the surface, "
        f"by up to {-worst:.3g} mm",
        faces=list(dict.fromkeys(names)),
        figure=worst,
        remedy="move or shrink the geometry so that all of it lies inside the body",
    )
