# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Whether patches lie on the CAD faces that they are of."""

from __future__ import annotations

import numpy as np

from .. import errors
from ..core.surface import PatchSurface
from .faces import EXACT_TOLERANCE, distance_of_points, random_parameters
from .shapes import Body


def check_against_cad(body: Body, surface: PatchSurface) -> float:
    """Largest distance of 25 random points a face between the patches and the CAD faces.

    Parameters
    ----------
    body : Body
    surface : PatchSurface
        Built from ``body.faces``, one patch a face in their order.

    Returns
    -------
    float
        mm. Where the welding moved a side by more than 1e-9 of the diagonal, that shows here.

    Raises
    ------
    FaultError
        When the deviation exceeds 1e-9 of the diagonal and no welding explains it.
    """
    faces = body.shape.Faces
    worst = 0.0
    count = len(surface.patches)
    places = np.array([random_parameters(k) for k in range(count)])  # (patches, 2, 25)
    on = np.repeat(np.arange(count), places.shape[2])
    # coordinates far from the origin are rounded more coarsely than a small body is exact
    rounding = 8.0 * np.finfo(float).eps * float(np.abs(surface.control_points).max())
    allowed = EXACT_TOLERANCE * surface.diagonal + rounding
    u_all, v_all = places[:, 0].ravel(), places[:, 1].ravel()
    points = surface.evaluate_at(on, u_all, v_all).reshape(count, -1, 3)
    # turning a patch over exchanges its parameters
    turned = surface.evaluate_at(on, v_all, u_all).reshape(count, -1, 3)
    for k, (given, patch) in enumerate(zip(body.faces, surface.patches, strict=True)):
        number = int(given.name.removeprefix("Face")) - 1
        face = faces[number]
        u, v = places[k]
        deviation = distance_of_points(points[k], u, v, face, body.domains[k])
        if body.domains[k] is not None and deviation > allowed:
            other = distance_of_points(turned[k], u, v, face, body.domains[k])
            deviation = min(deviation, other)
        moved = float(surface.moved[k]) if len(surface.moved) else 0.0
        if body.cover is not None and body.cover.kinds[number] == "tolerance":
            moved += body.cover.tolerance
        if deviation > allowed + moved:
            raise errors.FaultError(
                f"the patch is {deviation:.2g} mm away from its CAD face, allowed {allowed:.2g} mm",
                faces=[patch.face],
                figure=deviation,
                remedy="please report this body",
            )
        worst = max(worst, deviation)
    return worst
