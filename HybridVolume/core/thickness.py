# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How thick a shell will be, in mm: distances between the surface and a level of the field."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..errors import FaultError
from .harmonic import HarmonicField
from .isosurface import isosurface
from .quadrature import lobatto
from .surface import PatchSurface

HIGHEST = 0.99
"""The highest level that is asked for."""

# Places on the surface at which the distance is taken, about.
_PLACES = 20_000
# Nearest samples of the isosurface whose triangles are looked at.
_CANDIDATES = 16


def shell_thickness(field: HarmonicField, surface: PatchSurface, w0: float) -> dict[str, Any]:
    """Thickness of the shell between the surface and the level w = w0.

    Each place of the surface has the distance to the nearest point of the isosurface; means are
    weighted by the surface's area. Where the isosurface at ``w0`` has not the body's genus, no
    shell reaches it: the figures are then those of the largest level that has.

    Parameters
    ----------
    field : HarmonicField
    surface : PatchSurface
        The body that the field lives in.
    w0 : float
        In (0, 1).

    Returns
    -------
    dict
        ``min``, ``mean``, ``max`` (mm); ``faces``, a list of ``{face, min, mean, max}`` in the
        order of the patches; ``w0``, the level that they belong to; ``largest_w0``, the largest
        level, up to 0.99, whose isosurface has the body's genus.

    Raises
    ------
    FaultError
        No level of the field looks like the body.
    """
    largest = field.largest_level(surface.genus, HIGHEST)
    level = w0 if w0 <= largest else field.largest_level(surface.genus, w0)
    if level <= 0.0:
        raise FaultError(
            "no level of the harmonic field has the body's genus",
            remedy="keep other sheets of the midstructure",
        )
    vertices, triangles = isosurface(field.mesh, field.w, level)
    points, area, patch = surface_places(surface, _PLACES)
    distance = distance_to_triangles(points, vertices, triangles)
    names = [p.face for p in surface.patches]
    number = {face: k for k, face in enumerate(dict.fromkeys(names))}
    of_place = np.array([number[name] for name in names])[patch]
    order = np.argsort(of_place, kind="stable")
    parts = np.split(order, np.searchsorted(of_place[order], np.arange(1, len(number))))
    return {
        **_figures(distance, area),
        "faces": [
            {"face": face, **_figures(distance[part], area[part])}
            for face, part in zip(number, parts, strict=True)
        ],
        "w0": float(level),
        "largest_w0": float(largest),
    }


def _figures(distance: np.ndarray, area: np.ndarray) -> dict[str, float]:
    # the sum of the areas of a face that has shrunk to a line is zero
    mean = np.average(distance, weights=area) if area.sum() > 0.0 else distance.mean()
    return {"min": float(distance.min()), "mean": float(mean), "max": float(distance.max())}


def surface_places(surface: PatchSurface, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of all knot spans, their corners among them, with the area that each stands for.

    Parameters
    ----------
    surface : PatchSurface
    count : int
        Aimed at; at least nine a knot span are taken.

    Returns
    -------
    points : (m, 3) array
        mm.
    area : (m,) array
        mm²; the sum is the surface's area.
    patch : (m,) int array
    """
    number = int(np.clip(np.sqrt(count / surface.element_count), 3, 40))
    at, weight = lobatto(number)
    samples = surface.element_samples(at, at)
    points, along_u, along_v = samples.surface(surface.control_points)
    area = np.linalg.norm(np.cross(along_u, along_v), axis=1)
    area *= np.tile(np.multiply.outer(weight, weight).ravel(), surface.element_count)
    return points, area, np.repeat(surface.element_patch, samples.count)


def distance_to_triangles(
    points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray
) -> np.ndarray:
    """Distance of each point to a surface of many triangles of about even size.

    Parameters
    ----------
    points : (k, 3) array
    vertices : (n, 3) array
    triangles : (m, 3) int array

    Returns
    -------
    (k,) array
        To the nearest of the triangles around the nearest samples of the surface: an upper bound,
        exact where no triangle is much larger than its neighbours.
    """
    corner = vertices[triangles]
    middle = corner.mean(axis=1, keepdims=True)
    places = np.concatenate([middle, 0.75 * corner + 0.25 * middle], axis=1).reshape(-1, 3)
    number = min(_CANDIDATES, len(places))
    _, near = cKDTree(places).query(points, k=number)
    near = near.reshape(len(points), number) // 4
    best = np.full(len(points), np.inf)
    for column in near.T:
        best = np.minimum(best, _to_triangle(points, corner[column]))
    return best


def _to_triangle(points: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Distance of (k, 3) points, each to its own triangle of (k, 3, 3) corners."""
    side = np.roll(corner, -1, axis=1) - corner
    apart = points[:, None] - corner
    length2 = np.einsum("kci,kci->kc", side, side)
    along = np.einsum("kci,kci->kc", apart, side) / np.maximum(length2, np.finfo(float).tiny)
    off = apart - np.clip(along, 0.0, 1.0)[..., None] * side
    rim = np.linalg.norm(off, axis=2).min(axis=1)
    normal = np.cross(side[:, 0], side[:, 1])
    size = np.linalg.norm(normal, axis=1)
    inward = np.einsum("kci,kci->kc", np.cross(normal[:, None], side), apart)
    above = (inward >= 0.0).all(axis=1) & (size > 0.0)
    height = np.abs(np.einsum("ki,ki->k", apart[:, 0], normal))
    return np.where(above, height / np.maximum(size, np.finfo(float).tiny), rim)
