# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A closed surface of patches as a solid of untrimmed B-spline faces. In FreeCAD's Python."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.core.atomic import replacing
from HybridVolume.errors import FaultError, InputError

if TYPE_CHECKING:
    from HybridVolume.core.surface import PatchSurface

SUFFIXES = (".step", ".stp", ".brep", ".brp")
"""Files that can be written."""
MISSED = 1e-3
"""Share of the volume that OCC may miss; it integrates roughly."""


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


def write_solid(path: str | os.PathLike, surface: PatchSurface) -> None:
    """Write a surface as a STEP or BREP file of one solid, so that FreeCAD and others can open it.

    Parameters
    ----------
    path : path
        Ends with .step, .stp, .brep or .brp; millimetres.
    surface : PatchSurface

    Raises
    ------
    InputError
        It is no such file.
    FaultError
        The faces do not close, or OCC did not write the file.
    OSError
        The place cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"{path.name} is no STEP or BREP file", remedy=f"end it with {', '.join(SUFFIXES)}"
        )
    solid = solid_of(surface)
    # OCC tells nothing when it cannot write, and leaves what it has
    with tempfile.TemporaryDirectory(prefix="hybridvolume-") as folder:
        made = Path(folder) / path.name
        is_step = path.suffix.lower() in (".step", ".stp")
        (solid.exportStep if is_step else solid.exportBrep)(str(made))
        if not made.is_file() or not made.stat().st_size:
            raise FaultError(f"OCC did not write {path.name}")
        with replacing(path) as file:
            file.write(made.read_bytes())
