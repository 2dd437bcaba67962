# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A closed surface of patches as a solid of untrimmed B-spline faces. In FreeCAD's Python."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from HybridVolume.core.atomic import replacing
from HybridVolume.errors import FaultError, InputError
from HybridVolume.solids import solid_of

if TYPE_CHECKING:
    from HybridVolume.core.surface import PatchSurface

SUFFIXES = (".step", ".stp", ".brep", ".brp")
"""Files that can be written."""


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
