# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Test bodies as FreeCAD solids and STEP files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from patches import Body

from HybridVolume.core.surface import SplineFace


def to_part_face(face: SplineFace) -> Any:
    """Face on the natural bounds of its surface, a Part.Face."""
    import FreeCAD
    import Part

    surface = Part.BSplineSurface()
    knots, counts = [], []
    for t in face.knots:
        values, multiplicities = np.unique(t, return_counts=True)
        knots.append(values.tolist())
        counts.append(multiplicities.tolist())
    poles = [[FreeCAD.Vector(*p) for p in row] for row in face.control_points.tolist()]
    weights = face.weights.tolist()
    surface.buildFromPolesMultsKnots(poles, *counts, *knots, False, False, *face.degrees, weights)
    return surface.toShape()


def to_part_solid(body: Body, tolerance: float = 1e-6) -> Any:
    """Solid whose faces are the patches, bit for bit; a Part.Solid.

    Parameters
    ----------
    body : Body
    tolerance : float
        For sewing, mm.
    """
    import Part

    sewn = Part.makeShell([to_part_face(face) for face in body.faces])
    sewn.sewShape(tolerance)
    shells = sewn.Shells
    if len(shells) == 1:
        solid = Part.Solid(shells[0])
    else:
        # the largest shell is the outer one; cavities are turned inside out
        outer, *cavities = sorted(shells, key=lambda shell: -abs(Part.Solid(shell).Volume))
        cavities = [s.reversed() if Part.Solid(s).Volume > 0 else s for s in cavities]
        solid = Part.makeSolid(Part.makeCompound([outer, *cavities]))
    if not (solid.isClosed() and len(solid.Faces) == len(body.faces)):
        raise ValueError(f"{body.name}: sewing gave no closed solid of {len(body.faces)} faces")
    return solid


def write_step(body: Body, path: Path) -> Path:
    """Write a body as a STEP file."""
    to_part_solid(body).exportStep(str(path))
    return path
