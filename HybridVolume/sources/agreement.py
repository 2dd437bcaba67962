# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Whether patches lie on the CAD faces that they are of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .. import errors
from ..core.covering.kinds import TOLERANCE
from ..core.surface import PatchSurface
from .distances import surface_distances
from .faces import EXACT_TOLERANCE, distance_of_points, random_parameters

if TYPE_CHECKING:
    from .covering import Covered
    from .shapes import Body


def check_against_cad(body: Body, surface: PatchSurface) -> float:
    """Largest distance of 25 random points a patch between the patches and the CAD faces.

    Parameters
    ----------
    body : Body
    surface : PatchSurface
        Built from ``body.faces``, or read back; its patches are named like the faces of the body
        that they are on.

    Returns
    -------
    float
        mm. Where the welding moved a side by more than 1e-9 of the diagonal, that shows here.

    Raises
    ------
    FaultError
        When the deviation exceeds 1e-9 of the diagonal, or the tolerance of a cover, and no
        welding explains it; or a face has no patch.
    """
    # coordinates far from the origin are rounded more coarsely than a small body is exact
    rounding = 8.0 * np.finfo(float).eps * float(np.abs(surface.control_points).max())
    allowed = EXACT_TOLERANCE * surface.diagonal + rounding
    if body.cover is None:
        return _check_each(body, surface, allowed)
    return _check_cover(body.shape, body.cover, surface, allowed)


def _check_each(body: Body, surface: PatchSurface, allowed: float) -> float:
    """Patches each of which is a face, those of B-splines at equal parameters."""
    faces = body.shape.Faces
    worst = 0.0
    (points, turned), (u_all, v_all) = _random_points(surface)
    for k, (given, patch) in enumerate(zip(body.faces, surface.patches, strict=True)):
        face = faces[number_of(given.name)]
        u, v = u_all[k], v_all[k]
        deviation = distance_of_points(points[k], u, v, face, body.domains[k])
        if body.domains[k] is not None and deviation > allowed:
            other = distance_of_points(turned[k], u, v, face, body.domains[k])
            deviation = min(deviation, other)
        _refuse(patch.face, deviation, allowed + _moved(surface, k))
        worst = max(worst, deviation)
    return worst


def _check_cover(solid: Any, cover: Covered, surface: PatchSurface, allowed: float) -> float:
    """Patches of which there are many on a face."""
    number = np.array([number_of(patch.face) for patch in surface.patches])
    (points, _), _ = _random_points(surface)
    faces = solid.Faces
    # of patches that were stored it is not known which are exact
    kinds = cover.kinds or (TOLERANCE,) * len(faces)
    worst = 0.0
    for k, (face, kind) in enumerate(zip(faces, kinds, strict=True)):
        own = np.flatnonzero(number == k)
        if not len(own) and k in cover.inside:
            continue
        if not len(own):
            raise errors.FaultError("the face has no patch", faces=[f"Face{k + 1}"])
        found = points[own].reshape(-1, 3)
        moved = max(_moved(surface, patch) for patch in own.tolist())
        limit = allowed + moved + (cover.tolerance if kind == TOLERANCE else 0.0)
        deviation = float(surface_distances(face, found).max())
        _refuse(f"Face{k + 1}", deviation, limit)
        worst = max(worst, deviation)
    return worst


def number_of(name: str) -> int:
    """Number of a face, from 0, by its name ``Face3``."""
    return int(name.removeprefix("Face")) - 1


def _random_points(
    surface: PatchSurface,
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Points (n, 25, 3) of all patches, those at exchanged parameters, and the parameters."""
    count = len(surface.patches)
    places = np.array([random_parameters(k) for k in range(count)])  # (patches, 2, 25)
    on = np.repeat(np.arange(count), places.shape[2])
    u, v = places[:, 0].ravel(), places[:, 1].ravel()
    points = surface.evaluate_at(on, u, v).reshape(count, -1, 3)
    # turning a patch over exchanges its parameters
    turned = surface.evaluate_at(on, v, u).reshape(count, -1, 3)
    return (points, turned), (places[:, 0], places[:, 1])


def _moved(surface: PatchSurface, patch: int) -> float:
    return float(surface.moved[patch]) if len(surface.moved) else 0.0


def _refuse(name: str, deviation: float, allowed: float) -> None:
    if not deviation <= allowed:
        raise errors.FaultError(
            f"the patch is {deviation:.2g} mm away from its CAD face, allowed {allowed:.2g} mm",
            faces=[name],
            figure=deviation,
            remedy="please report this body",
        )
