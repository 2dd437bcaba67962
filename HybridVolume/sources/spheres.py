# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Closed shells of a solid that are one sphere each: balls, and cavities like balls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.covering.spheres import sphere_faces
from ..core.surface import SplineFace

_WHOLE = 1e-9
"""A face is a whole sphere if it lacks less of the sphere's area, as a share of it."""


@dataclass(frozen=True)
class Parted:
    """A solid without its whole spheres.

    Attributes
    ----------
    patches : tuple of SplineFace
        Of the spheres, named after their faces.
    origin : (n,) int array
        Faces of the solid that they are of, from 0.
    rest : Part.Solid or None
        What is left; None where nothing is.
    numbers : (m,) int array
        Face of the solid that each face of the rest is.
    """

    patches: tuple[SplineFace, ...]
    origin: np.ndarray
    rest: Any
    numbers: np.ndarray


def without_spheres(solid: Any) -> Parted:
    """Take the shells that are whole spheres out of a solid.

    Parameters
    ----------
    solid : Part.Solid

    Returns
    -------
    Parted
        Without spheres, and with the solid itself as the rest, also where the shells that are
        left would be several cavities without a body around them.
    """
    import Part

    faces = solid.Faces
    everything = Parted((), np.zeros(0, dtype=int), solid, np.arange(len(faces)))
    shells = solid.Shells
    whole = [len(shell.Faces) == 1 and is_whole_sphere(shell.Faces[0]) for shell in shells]
    others = [shell for shell, taken in zip(shells, whole, strict=True) if not taken]
    if not any(whole):
        return everything
    outer = solid.OuterShell
    if len(others) > 1 and not any(shell.isSame(outer) for shell in others):
        return everything
    patches: list[SplineFace] = []
    origin: list[int] = []
    for shell, taken in zip(shells, whole, strict=True):
        if taken:
            number = _number(shell.Faces[0], faces)
            surface = shell.Faces[0].Surface
            found = sphere_faces(
                np.array(tuple(surface.Center)), surface.Radius, f"Face{number + 1}"
            )
            patches += found
            origin += [number] * len(found)
    if not others:
        return Parted(tuple(patches), np.array(origin), None, np.zeros(0, dtype=int))
    rest = Part.Solid(others[0] if len(others) == 1 else Part.makeCompound(others))
    if rest.Volume < 0.0:
        # a cavity's faces look into it
        rest.reverse()
    numbers = np.array([_number(face, faces) for face in rest.Faces])
    return Parted(tuple(patches), np.array(origin), rest, numbers)


def is_whole_sphere(face: Any) -> bool:
    """Whether a face is all of a sphere."""
    if face.Surface.TypeId != "Part::GeomSphere":
        return False
    edges = [edge for edge in face.Edges if not edge.Degenerated]
    # nothing but its own seam bounds it
    if len({edge.hashCode() for edge in edges}) != 1:
        return False
    return abs(face.Area / (4.0 * np.pi * face.Surface.Radius**2) - 1.0) < _WHOLE


def _number(face: Any, faces: list) -> int:
    return next(k for k, other in enumerate(faces) if other.isSame(face))
