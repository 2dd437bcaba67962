# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How far many points are beside the surface of a CAD face; OCC is asked for doubtful ones only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..core.covering.geometry import project
from ..core.covering.iso_faces import segment
from ..core.surface import SplineFace
from .exact_geometry import surfaces_of

_BLOCK = 20_000
"""Points that are projected at once, which bounds the memory."""

_FAR = 1e-3
"""Points farther from a surface than this share of the face's diagonal are measured by OCC too."""

_MOST = 200
"""But so many of them at most, the farthest: each costs some ms."""


def surface_distances(face: Any, points: np.ndarray) -> np.ndarray:
    """Distances of points from the surface of a face, as if it were not trimmed.

    Parameters
    ----------
    face : Part.Face
    points : (m, 3) array
        mm; near the face where its surface is none of plane, cylinder, cone, sphere and torus.

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
    import Part

    formula = _FORMULAS.get(face.Surface.TypeId)
    if formula is not None:
        return np.abs(formula(face.Surface, points))
    (patch,) = surfaces_of(face)
    found = np.full(len(points), np.inf)
    for piece in _open_pieces(patch):
        for part in np.array_split(np.arange(len(points)), 1 + len(points) // _BLOCK):
            if len(part):
                off = np.linalg.norm(project(piece, points[part])[1] - points[part], axis=1)
                found[part] = np.minimum(found[part], off)
    # beside poles the way to the foot may go round the pole and end elsewhere
    far = np.flatnonzero(found > _FAR * face.BoundBox.DiagonalLength)
    for k in far[np.argsort(-found[far], kind="stable")][:_MOST].tolist():
        found[k] = min(found[k], Part.Vertex(*points[k].tolist()).distToShape(face)[0])
    return found


def _open_pieces(patch: SplineFace) -> list[SplineFace]:
    """A surface, halved in each direction in which it closes upon itself.

    The way to the foot of a point near a seam may begin on its other side, where it ends at once.
    """
    x = patch.control_points
    near = 1e-9 * float(np.ptp(x.reshape(-1, 3), axis=0).max())
    ends = []
    for axis in range(2):
        first, last = np.take(x, [0, -1], axis=axis).swapaxes(0, axis)
        knots = patch.knots[axis]
        closed = float(np.abs(first - last).max()) <= near
        parts = np.linspace(knots[0], knots[-1], 3 if closed else 2)
        ends.append(list(zip(parts[:-1], parts[1:], strict=True)))
    if len(ends[0]) * len(ends[1]) == 1:
        return [patch]
    pieces = []
    for u in ends[0]:
        for v in ends[1]:
            knots, points = segment(patch, u, v)
            weights = points[..., 3]
            pieces.append(
                SplineFace(
                    patch.name, patch.degrees, knots, points[..., :3] / weights[..., None], weights
                )
            )
    return pieces


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
