# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Walls inside the material, where parts of a solid touch in faces that were never united.

Such a solid has edges that lie on each other, and between them faces that do, with opposite
normals. The material is on both sides of them: they are no boundary, and are left out.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from .. import errors
from .distances import surface_distances
from .untrimmed import names_of

logger = logging.getLogger(__name__)

TOUCH = 1e-7
"""Faces closer than this share of the diagonal lie on each other."""

VOLUME_TOLERANCE = 1e-6
"""Largest change of the volume by leaving walls out, as a share of it."""

_SHARES = ((0.11, 0.3, 0.52, 0.71, 0.93), (0.13, 0.31, 0.47, 0.73, 0.91))
_OPPOSITE = -0.9
_BORDER = 10.0
"""Points nearer to a face's edges than so many times the distance of touching are not judged."""


@dataclass(frozen=True)
class United:
    """A solid without walls inside.

    Attributes
    ----------
    solid : Part.Solid
    numbers : (n,) int array
        Face of the solid as it was given that each of its faces is a piece of, from 0.
    inside : tuple of int
        Faces of which nothing is left.
    """

    solid: Any
    numbers: np.ndarray
    inside: tuple[int, ...] = ()


def without_inner_walls(solid: Any) -> United:
    """Leave out what lies inside the material of a solid.

    Parameters
    ----------
    solid : Part.Solid

    Returns
    -------
    United
        The solid itself where no edges lie on each other, or no faces between them.

    Raises
    ------
    NonManifoldError
        The walls cannot be left out; their faces are named.
    """
    faces = solid.Faces
    unchanged = United(solid, np.arange(len(faces)))
    touch = TOUCH * solid.BoundBox.DiagonalLength
    if not has_double_edges(solid, touch):
        return unchanged
    walls = _faces_on_each_other(faces, touch)
    if not walls:
        return unchanged
    united = _united(solid, faces, walls, touch)
    logger.info("%d walls inside the material are left out", len(united.inside))
    return united


def has_double_edges(solid: Any, touch: float) -> bool:
    """Whether edges lie on each other: their ends and middles do.

    Parameters
    ----------
    solid : Part.Solid
    touch : float
        mm.
    """
    rows = []
    for edge in solid.Edges:
        if edge.Degenerated:
            continue
        first, last = edge.ParameterRange
        ends = np.array([tuple(edge.valueAt(first)), tuple(edge.valueAt(last))])
        middle = tuple(edge.valueAt(0.5 * (first + last)))
        # the same for either direction
        rows.append([*middle, *ends.mean(axis=0), *np.abs(ends[1] - ends[0])])
    return len(rows) > 1 and bool(len(cKDTree(np.array(rows)).query_pairs(touch)))


def _faces_on_each_other(faces: list, touch: float) -> list[int]:
    """Faces that lie on others with the opposite normal, by points inside them."""
    import FreeCAD
    import Part

    rows, owners = [], []
    for k, face in enumerate(faces):
        limits = face.ParameterRange
        for s in _SHARES[0]:
            for t in _SHARES[1]:
                u = limits[0] + s * (limits[1] - limits[0])
                v = limits[2] + t * (limits[3] - limits[2])
                if face.isPartOfDomain(u, v):
                    rows.append([*face.valueAt(u, v), *face.normalAt(u, v)])
                    owners.append(k)
    table, owner = np.array(rows), np.array(owners)
    points, normals = table[:, :3], table[:, 3:]
    found: set[int] = set()
    for k, face in enumerate(faces):
        box = face.BoundBox
        low = np.array([box.XMin, box.YMin, box.ZMin]) - touch
        high = np.array([box.XMax, box.YMax, box.ZMax]) + touch
        near = np.flatnonzero((owner != k) & np.all((points >= low) & (points <= high), axis=1))
        if not len(near):
            continue
        border = Part.Compound(face.Edges)
        for i in near[surface_distances(face, points[near]) <= touch].tolist():
            point = FreeCAD.Vector(*points[i])
            uv = face.Surface.parameter(point)
            if (
                face.isPartOfDomain(*uv)
                and np.dot(tuple(face.normalAt(*uv)), normals[i]) < _OPPOSITE
                and Part.Vertex(point).distToShape(border)[0] > _BORDER * touch
            ):
                found |= {k, int(owner[i])}
    return sorted(found)


def _united(solid: Any, faces: list, walls: list[int], touch: float) -> United:
    """Cut the walls where they begin to lie on each other; leave out what two of them share."""
    import Part

    try:
        _, images = faces[walls[0]].generalFuse([faces[k] for k in walls[1:]], touch)
    except Part.OCCError as error:
        raise _failed(f"OCC cannot cut them ({error})", walls) from error
    pieces: list[tuple[Any, set[int]]] = []
    for k, found in zip(walls, images, strict=True):
        for piece in found:
            owners = next((own for other, own in pieces if other.isSame(piece)), None)
            if owners is None:
                pieces.append((piece, {k}))
            else:
                owners.add(k)
    outer = [(piece, min(owners)) for piece, owners in pieces if len(owners) == 1]
    kept = [(face, k) for k, face in enumerate(faces) if k not in set(walls)] + outer
    kept.sort(key=lambda row: row[1])
    shape = Part.makeCompound([face for face, _ in kept]).copy()
    shape.sewShape(touch)
    shells = shape.Shells
    if len(shape.Faces) != len(kept) or len(shells) > len(solid.Shells):
        raise _failed(f"what is left has {len(shells)} shells", walls)
    made = Part.Solid(shells[0] if len(shells) == 1 else Part.makeCompound(shells))
    if not (made.isValid() and made.isClosed()):
        raise _failed("what is left is not closed and valid", walls)
    change = abs(made.Volume / solid.Volume - 1.0)
    if not change <= VOLUME_TOLERANCE:
        raise _failed(f"the volume changes by {change:.1e}", walls, change)
    if has_double_edges(made, touch):
        raise _failed("edges of what is left still lie on each other", walls)
    numbers = _numbers(made, kept, touch)
    if numbers is None:
        raise _failed("what is left cannot be told apart", walls)
    inside = set(range(len(faces))) - set(numbers.tolist())
    return United(made, numbers, tuple(sorted(inside)))


def _numbers(made: Any, kept: list[tuple[Any, int]], touch: float) -> np.ndarray | None:
    """Faces of the given solid that those of the new one are, by their middles; None if unclear."""
    old = np.array([_signature(face) for face, _ in kept])
    new = np.array([_signature(face) for face in made.Faces])
    distance, nearest = cKDTree(old).query(new)
    if distance.max() > 1e3 * touch or len(np.unique(nearest)) != len(nearest):
        return None
    return np.array([kept[k][1] for k in nearest.tolist()])


def _signature(face: Any) -> list[float]:
    """Lengths by which a face is known again, mm."""
    return [*face.CenterOfMass, float(np.sqrt(face.Area)), sum(edge.Length for edge in face.Edges)]


def _failed(why: str, walls: list[int], figure: float | None = None) -> errors.NonManifoldError:
    return errors.NonManifoldError(
        f"these faces lie on each other inside the material, and cannot be left out: {why}",
        faces=names_of(walls),
        figure=figure,
        remedy="unite the parts of the body in the CAD program",
    )
