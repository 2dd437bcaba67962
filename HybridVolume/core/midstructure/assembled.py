# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Midstructures other than the medial axis: facets of which all are kept, in pieces."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..surface import PatchSurface
from .distances import SurfaceDistance
from .samples import probes
from .sheets import Midstructure, Sheet, face_places


def facet_dimensions(facets: np.ndarray) -> np.ndarray:
    """2 for triangles, 1 for lines (a, b, b), 0 for points (a, a, a), (f,)."""
    a, b, c = facets.T
    return (a != b).astype(int) + ((c != a) & (c != b))


def facet_measures(vertices: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Area of triangles, length of lines, 1 for points, (f,)."""
    x = vertices[facets]
    area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    length = np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
    dimension = facet_dimensions(facets)
    return np.where(dimension == 2, area, np.where(dimension == 1, length, 1.0))


def connected_facets(facets: np.ndarray, count: int) -> np.ndarray:
    """Number of the piece that each facet belongs to: equal dimension, joined by vertices, (f,)."""
    dimension = facet_dimensions(facets)
    # three copies of every vertex keep triangles, lines and points apart
    nodes = facets + count * dimension[:, None]
    graph = coo_matrix(
        (np.ones(2 * len(facets)), (np.repeat(nodes[:, 0], 2), nodes[:, 1:].ravel())),
        shape=(3 * count, 3 * count),
    )
    _, label = connected_components(graph, directed=False)
    return np.unique(label[nodes[:, 0]], return_inverse=True)[1].ravel()


def from_pieces(
    surface: PatchSurface,
    distance: SurfaceDistance,
    vertices: np.ndarray,
    facets: np.ndarray,
    piece: np.ndarray,
    method: str,
    reason: str,
) -> Midstructure:
    """A midstructure whose sheets are given pieces, all of them kept.

    Parameters
    ----------
    surface : PatchSurface
    distance : SurfaceDistance
    vertices : (m, 3) array
        mm.
    facets : (f, 3) int array
        Triangles, lines (a, b, b), points (a, a, a).
    piece : (f,) int array
    method, reason : str

    Returns
    -------
    Midstructure
        The sheets with the largest area come first, then the longest lines, then points.
    """
    dimension, measure = facet_dimensions(facets), facet_measures(vertices, facets)
    count = int(piece.max()) + 1
    of_piece = np.zeros(count, dtype=int)
    of_piece[piece] = dimension
    total = np.bincount(piece, measure, count)
    rank = np.empty(count, dtype=int)
    rank[np.lexsort([-total, -of_piece])] = np.arange(count)
    sheet = rank[piece]
    radius = distance(vertices)
    area = np.where(dimension == 2, measure, 0.0)
    middle = vertices[facets].mean(axis=1)
    line = dimension == 1
    middle[line] = vertices[facets[line, :2]].mean(axis=1)
    order = np.argsort(sheet, kind="stable")
    parts = np.split(order, np.searchsorted(sheet[order], np.arange(1, count)))
    seeds = np.empty((count, 3))
    for k, mine in enumerate(parts):
        centre = np.average(middle[mine], axis=0, weights=measure[mine] + 1e-300)
        seeds[k] = middle[mine[np.linalg.norm(middle[mine] - centre, axis=1).argmin()]]
    names = [patch.face for patch in surface.patches]
    feet = distance.nearest(seeds)
    places = face_places(names, feet.patch, feet.uv)
    opposite, angle = _opposite_sides(distance, seeds, feet.points)
    sheets = []
    for k, mine in enumerate(parts):
        around = radius[facets[mine]]
        u, v = places[k]
        sheets.append(
            Sheet(
                faces=(names[feet.patch[k]], names[opposite[k]]),
                area=float(area[mine].sum()),
                radius=(float(around.min()), float(around.max())),
                angle=(float(angle[k]), float(angle[k])),
                kept=True,
                reason=reason,
                seed=(float(seeds[k, 0]), float(seeds[k, 1]), float(seeds[k, 2])),
                foot=(float(u), float(v)),
            )
        )
    points, half, patch = probes(surface)
    return Midstructure(
        vertices=vertices,
        facets=facets,
        sheet=sheet,
        kept=np.ones(len(facets), dtype=bool),
        radius=radius,
        sheets=tuple(sheets),
        method=method,
        faces=tuple(names),
        probe_points=points,
        probe_radius=half,
        probe_patch=patch,
    )


def _opposite_sides(
    distance: SurfaceDistance, points: np.ndarray, feet: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Patch nearest on the other side of each point than its foot, and the angle of both ways.

    Returns
    -------
    patch : (n,) int array
    angle : (n,) array
        Degrees.
    """
    patch, angle = np.empty(len(points), dtype=int), np.empty(len(points))
    samples = distance.samples
    for k, (point, foot) in enumerate(zip(points, feet, strict=True)):
        way, there = samples - point, foot - point
        far = np.linalg.norm(way, axis=1)
        cosine = (way @ there) / np.maximum(far * np.linalg.norm(there), 1e-300)
        # as near as possible and as opposite as possible
        best = np.where(cosine < -0.3, far * (2.0 + cosine), far * 10.0).argmin()
        patch[k] = distance.sample_patch[best]
        angle[k] = np.degrees(np.arccos(np.clip(cosine[best], -1.0, 1.0)))
    return patch, angle
