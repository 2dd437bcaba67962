# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Closed surfaces of patches as FreeCAD solids, for what comes in and for what goes out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.errors import FaultError

if TYPE_CHECKING:
    from HybridVolume.core.surface import PatchSurface

MISSED = 3e-2
"""Share of the volume that OCC may miss; it integrates roughly, up to 2 % on real bodies."""


def solid_of(surface: PatchSurface) -> Any:
    """A ``Part.Solid`` whose faces are the patches in their order, each the whole of its surface.

    Parameters
    ----------
    surface : PatchSurface

    Raises
    ------
    FaultError
        The faces do not close a solid of the body's volume.
    """
    import Part

    shells = []
    # the skin comes first, then its cavities
    rank = np.argsort(-surface.shell_volumes(settle=False), kind="stable")
    for number in rank:
        members = np.flatnonzero(surface.shell_of_patch == number)
        shells.append(_shell([_face(surface, int(k)) for k in members], surface.diagonal))
    solid = Part.Solid(shells[0])
    if len(shells) > 1:
        solid = Part.makeSolid(Part.makeCompound(shells))
    missed = abs(solid.Volume / surface.volume() - 1.0)
    if not solid.isClosed() or len(solid.Faces) != len(surface.patches) or missed > MISSED:
        raise FaultError(
            f"sewing {len(surface.patches)} faces gave {len(solid.Faces)} and a solid that misses"
            f" {missed:.2g} of their volume"
        )
    return solid


def _shell(faces: list[Any], diagonal: float) -> Any:
    import Part

    sewn = Part.makeShell(faces)
    # sides that meet have the same control points: any tolerance finds them
    sewn.sewShape(1e-7 * diagonal)
    if len(sewn.Shells) != 1:
        raise FaultError(f"sewing {len(faces)} faces gave {len(sewn.Shells)} shells")
    return sewn.Shells[0]


def _face(surface: PatchSurface, number: int) -> Any:
    import FreeCAD
    import Part

    patch = surface.patches[number]
    knots, counts = [], []
    for line in patch.knots:
        values, multiplicities = np.unique(line, return_counts=True)
        knots.append(values.tolist())
        counts.append(multiplicities.tolist())
    points = surface.control_points[patch.index].tolist()
    poles = [[FreeCAD.Vector(*p) for p in row] for row in points]
    face = Part.BSplineSurface()
    weights = patch.weights.tolist()
    face.buildFromPolesMultsKnots(poles, *counts, *knots, False, False, *patch.degrees, weights)
    return face.toShape()
