# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How far points are beside the surface of a CAD face."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numpy as np

from ..core.covering.feet import nearest
from .exact_geometry import surfaces_of

logger = logging.getLogger(__name__)


def surface_distances(face: Any, points: np.ndarray) -> np.ndarray:
    """Distances of points from the surface of a face, as if it were not trimmed.

    Parameters
    ----------
    face : Part.Face
    points : (m, 3) array
        mm

    Returns
    -------
    (m,) array
        mm. Never more than the distance from the face itself.

    Raises
    ------
    InputError
        The face has no B-spline form.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    formula = _FORMULAS.get(face.Surface.TypeId)
    if formula is not None:
        return np.abs(formula(face.Surface, points))
    (patch,) = surfaces_of(face)
    found = nearest(patch, points)
    if found.gap.any():
        logger.info("%d points are about equally far from many places", np.count_nonzero(found.gap))
    return found.distance


def _along_and_across(axis: Any, origin: Any, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places of points along an axis, and their distances from it."""
    direction = np.array(tuple(axis))
    direction /= np.linalg.norm(direction)
    away = points - np.array(tuple(origin))
    along = away @ direction
    return along, np.linalg.norm(away - along[:, None] * direction, axis=1)


def _plane(surface: Any, points: np.ndarray) -> np.ndarray:
    return _along_and_across(surface.Axis, surface.Position, points)[0]


def _cylinder(surface: Any, points: np.ndarray) -> np.ndarray:
    return _along_and_across(surface.Axis, surface.Center, points)[1] - surface.Radius


def _cone(surface: Any, points: np.ndarray) -> np.ndarray:
    along, across = _along_and_across(surface.Axis, surface.Apex, points)
    # both halves of the cone count: the one beyond the apex is far from any face
    angle = abs(surface.SemiAngle)
    return across * np.cos(angle) - np.abs(along) * np.sin(angle)


def _sphere(surface: Any, points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points - np.array(tuple(surface.Center)), axis=1) - surface.Radius


def _torus(surface: Any, points: np.ndarray) -> np.ndarray:
    along, across = _along_and_across(surface.Axis, surface.Center, points)
    # a torus that cuts itself goes on beyond its axis
    ways = [np.hypot(along, across + sign * surface.MajorRadius) for sign in (-1.0, 1.0)]
    return np.min(np.abs(np.array(ways) - surface.MinorRadius), axis=0)


_FORMULAS: dict[str, Callable[[Any, np.ndarray], np.ndarray]] = {
    "Part::GeomPlane": _plane,
    "Part::GeomCylinder": _cylinder,
    "Part::GeomCone": _cone,
    "Part::GeomSphere": _sphere,
    "Part::GeomToroid": _torus,
}
