# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The body that a stored surface belongs to, without covering its faces again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.errors import InputError
from HybridVolume.sources import Body, Covered, read_shape, solids_of_object
from HybridVolume.sources.covering import allowed_deviation
from HybridVolume.sources.untrimmed import COVERED

from . import face_geometry

if TYPE_CHECKING:
    from HybridVolume.core.surface import PatchSurface


def body_of_volume(obj: Any, surface: PatchSurface) -> Body:
    """The body of a hybrid volume of a document.

    Parameters
    ----------
    obj : App.DocumentObject
        A hybrid volume with a result whose body did not change since.
    surface : PatchSurface
        Of that result.

    Raises
    ------
    InputError
        The body has not this solid any more, or it is refused.
    """
    name, solid = _solid(obj.Source, obj.Solid)
    tolerance = face_geometry.stored_tolerance(obj.ComputedFrom)
    if tolerance is None:
        return _as_it_is(solid, name)
    return _covered(name, solid, surface, tolerance)


def body_to_search(
    source: Any, surface: PatchSurface | None, tolerance: float | None = None
) -> Body:
    """The first solid of an object, for nodes of a mesh to be looked for on it.

    Parameters
    ----------
    source : App.DocumentObject
    surface : PatchSurface or None
        To whose patches the mesh's nodes belong.
    tolerance : float, optional
        Of the cover, mm; 1e-4 of the diagonal by default.

    Raises
    ------
    InputError
        There is no solid, or it is refused.
    """
    name, solid = _solid(source, 1)
    if surface is None:
        # nothing but the solid itself is looked at
        return Body(name, (), solid)
    try:
        return _as_it_is(solid, name)
    except COVERED:
        return _covered(name, solid, surface, tolerance or 0.0)


def _solid(source: Any, number: int) -> tuple[str, Any]:
    solids = solids_of_object(source)
    if number > len(solids):
        raise InputError(f"{source.Label} has no solid {number}", remedy="choose another body")
    return solids[number - 1]


def _as_it_is(solid: Any, name: str) -> Body:
    """A solid each of whose faces is a patch."""
    (body,) = read_shape(solid, name, cover=False)
    return body


def _covered(name: str, solid: Any, surface: PatchSurface, tolerance: float) -> Body:
    """A solid that was covered with the patches of a surface."""
    known = {f"Face{number}": number - 1 for number in range(1, len(solid.Faces) + 1)}
    foreign = sorted({patch.face for patch in surface.patches} - set(known))
    if foreign:
        raise InputError(
            f"{name} has no {', '.join(foreign[:5])}, which the stored shell lies on",
            faces=foreign,
            remedy="complete the hybrid volume again",
        )
    origin = np.array([known[patch.face] for patch in surface.patches])
    cover = Covered(
        faces=(),
        origin=origin,
        deviation=np.full(len(known), np.nan),
        quads=0,
        kinds=(),
        tolerance=allowed_deviation(solid, tolerance),
        inside=tuple(np.setdiff1d(np.arange(len(known)), origin).tolist()),
    )
    return Body(name, (), solid, cover=cover)
