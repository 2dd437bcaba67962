# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Closed surfaces of patches as FreeCAD solids, for what comes in and for what goes out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.errors import FaultError

if TYPE_CHECKING:
    from HybridVolume.core.surface import PatchSurface


def solid_of(surface: PatchSurface) -> Any:
    """A ``Part.Solid`` whose faces are the patches, each the whole of its surface.

    Parameters
    ----------
    surface : PatchSurface

    Returns
    -------
    Part.Solid
        Its faces come in the order of the patches, the outer skin first and then each cavity.

    Raises
    ------
    FaultError
        The faces do not close a solid, or are not the patches bit for bit.
    """
    import Part

    # the skin comes first, then its cavities
    rank = np.argsort(-surface.shell_volumes(settle=False), kind="stable")
    members = [np.flatnonzero(surface.shell_of_patch == number) for number in rank]
    shells = [_shell(surface, patches) for patches in members]
    solid = Part.Solid(shells[0])
    if len(shells) > 1:
        solid = Part.makeSolid(Part.makeCompound(shells))
    # OCC's volume is no check: it integrates roughly, up to 2 % off
    kept = [_net(face) for face in solid.Faces] == [
        _patch_net(surface, int(k)) for k in np.concatenate(members)
    ]
    turned = sum(face.Orientation != "Forward" for face in solid.Faces)
    if not kept or turned or not solid.isClosed():
        raise FaultError(
            f"sewing {len(surface.patches)} faces gave {len(solid.Faces)}, {turned} of them turned,"
            f" {'closed' if solid.isClosed() else 'not closed'}"
            f"{'' if kept else ', with other control points'}"
        )
    return solid


def _shell(surface: PatchSurface, patches: np.ndarray) -> Any:
    import Part

    sewn = Part.makeShell([_face(surface, int(k)) for k in patches])
    # sides that meet have the same control points: any tolerance finds them
    sewn.sewShape(1e-7 * surface.diagonal)
    if len(sewn.Shells) != 1:
        raise FaultError(f"sewing {len(patches)} faces gave {len(sewn.Shells)} shells")
    # sewing gives them another order
    places: dict[bytes, list[int]] = {}
    for place, number in enumerate(patches):
        places.setdefault(_patch_net(surface, int(number)), []).append(place)
    faces: dict[int, Any] = {}
    for face in sewn.Shells[0].Faces:
        left = places.get(_net(face))
        if not left:
            raise FaultError("sewing changed the control points of a face")
        faces[left.pop(0)] = face
    return Part.makeShell([faces[place] for place in sorted(faces)])


def _net(face: Any) -> bytes:
    """Control points of a face, bit for bit but for the sign of zero."""
    poles = face.Surface.getPoles()
    return (np.array([[tuple(p) for p in row] for row in poles]) + 0.0).tobytes()


def _patch_net(surface: PatchSurface, number: int) -> bytes:
    return (surface.control_points[surface.patches[number].index] + 0.0).tobytes()


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
