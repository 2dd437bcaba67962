# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Closed shells of a solid that are one face each: spheres, and surfaces closed in both directions.

Balls and cavities like balls become six patches; rings whose one face meets itself along two seams
are cut at quarters of both directions, B-spline faces by knot insertion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..core.covering.kinds import BIT, EXACT
from ..core.covering.spheres import sphere_faces
from ..core.surface import SplineFace
from .faces import seam_edges, spline_face

_WHOLE = 1e-9
"""A face is a whole sphere if it lacks less of the sphere's area, as a share of it."""


@dataclass(frozen=True)
class Parted:
    """A solid without its shells that are one face each.

    Attributes
    ----------
    patches : tuple of SplineFace
        Of these shells, named after their faces.
    origin : (n,) int array
        Faces of the solid that they are of, from 0.
    kinds : tuple of str
        Whether each patch is the face bit for bit, see :mod:`..core.covering.kinds`.
    rest : Part.Solid or None
        What is left; None where nothing is.
    numbers : (m,) int array
        Face of the solid that each face of the rest is.
    """

    patches: tuple[SplineFace, ...]
    origin: np.ndarray
    kinds: tuple[str, ...]
    rest: Any
    numbers: np.ndarray


def without_whole_faces(solid: Any) -> Parted:
    """Take the shells that are one closed face each out of a solid.

    Parameters
    ----------
    solid : Part.Solid

    Returns
    -------
    Parted
        Without such shells, and with the solid itself as the rest, also where the shells that are
        left would be several cavities without a body around them.
    """
    import Part

    faces = solid.Faces
    shells = solid.Shells
    whole, others = [], []
    for shell in shells:
        own = shell.Faces
        number = _number(own[0], faces)
        found = _whole_patches(own[0], f"Face{number + 1}") if len(own) == 1 else ()
        if found:
            whole.append((number, found, _is_spline(own[0].Surface)))
        else:
            others.append(shell)
    outer = solid.OuterShell
    if not whole or (len(others) > 1 and not any(shell.isSame(outer) for shell in others)):
        return Parted((), np.zeros(0, dtype=int), (), solid, np.arange(len(faces)))
    whole.sort(key=lambda row: row[0])
    patches = tuple(patch for _, found, _ in whole for patch in found)
    origin = np.repeat([row[0] for row in whole], [len(row[1]) for row in whole])
    kinds = tuple(BIT if own else EXACT for _, found, own in whole for _ in found)
    if not others:
        return Parted(patches, origin, kinds, None, np.zeros(0, dtype=int))
    rest = Part.Solid(others[0] if len(others) == 1 else Part.makeCompound(others))
    if rest.Volume < 0.0:
        # a cavity's faces look into it
        rest.reverse()
    numbers = np.array([_number(face, faces) for face in rest.Faces])
    return Parted(patches, origin, kinds, rest, numbers)


def _whole_patches(face: Any, name: str) -> tuple[SplineFace, ...]:
    """Patches of a face without any border; none of another face."""
    if is_whole_sphere(face):
        surface = face.Surface
        return sphere_faces(np.array(tuple(surface.Center)), surface.Radius, name)
    return _ring_patches(face, name) if _is_whole_ring(face) else ()


def is_whole_sphere(face: Any) -> bool:
    """Whether a face is all of a sphere."""
    if face.Surface.TypeId != "Part::GeomSphere":
        return False
    edges = [edge for edge in face.Edges if not edge.Degenerated]
    # nothing but its own seam bounds it
    if len({edge.hashCode() for edge in edges}) != 1:
        return False
    return abs(face.Area / (4.0 * np.pi * face.Surface.Radius**2) - 1.0) < _WHOLE


def _is_whole_ring(face: Any) -> bool:
    """Whether a face is all of a surface that is closed in both directions."""
    edges = {edge.hashCode() for edge in face.Edges}
    # nothing but its own two seams bounds it
    if len(face.Wires) != 1 or len(edges) != 2 or len(seam_edges(face)) != 2:
        return False
    return not any(edge.Degenerated for edge in face.Edges) and all(
        is_closed(face, across) for across in (0, 1)
    )


def _ring_patches(face: Any, name: str) -> tuple[SplineFace, ...]:
    """Such a face cut at quarters of both directions; nothing where OCC does not cut it."""
    surface, rectangle = face.Surface, face.ParameterRange
    own = _is_spline(surface)
    if not own:
        converted = face.toNurbs().Faces
        if len(converted) != 1:
            return ()
        surface, rectangle = converted[0].Surface, converted[0].ParameterRange
    u, v = (np.linspace(*rectangle[2 * k : 2 * k + 2], 5).tolist() for k in (0, 1))
    found = []
    for i in range(4):
        for j in range(4):
            patch = spline_face(surface, name, (u[i], u[i + 1], v[j], v[j + 1]))
            if patch is None:
                return ()
            found.append(replace(patch, exact=not own))
    return tuple(found)


def is_closed(face: Any, across: int) -> bool:
    """Whether a face ends where it begins, in u (0) or v (1).

    Surfaces of files miss that by their rounding, and OCC calls them open then; their face is
    sewn to itself all the same.
    """
    limits = face.ParameterRange
    low, high = limits[2 * across : 2 * across + 2]
    reach = 2.0 * max(edge.Tolerance for edge in face.Edges)
    for t in np.linspace(*limits[2 - 2 * across : 4 - 2 * across], 9).tolist():
        ends = [(t, end) if across else (end, t) for end in (low, high)]
        begin, end = (face.Surface.value(*place) for place in ends)
        if begin.distanceToPoint(end) > reach:
            return False
    return True


def _is_spline(surface: Any) -> bool:
    return surface.TypeId in ("Part::GeomBSplineSurface", "Part::GeomBezierSurface")


def _number(face: Any, faces: list) -> int:
    return next(k for k, other in enumerate(faces) if other.isSame(face))
