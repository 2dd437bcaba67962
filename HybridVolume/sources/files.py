# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies of any file that can be read: STEP and BREP, and meshes of polygons."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ..errors import InputError
from . import step
from .meshes import Surfacing, read_mesh
from .polygon_files import SUFFIXES as MESH_SUFFIXES
from .shapes import Body

__all__ = ["MESH_SUFFIXES", "Surfacing", "read_file"]


def read_file(
    path: str | os.PathLike, surfacing: Surfacing | None = None, **keywords: Any
) -> list[Body]:
    """Bodies of a file.

    Parameters
    ----------
    path : path
        STEP or BREP, or a mesh of polygons as OBJ, OFF or PLY.
    surfacing : Surfacing, optional
        How a mesh becomes patches.
    **keywords
        How solids with other faces than patches are covered, as for :func:`.shapes.read_shape`:
        ``cover``, ``tolerance``, ``free_only``, ``python``, ``progress``. Meshes need no cover.

    Returns
    -------
    list of Body
        One a solid, or one an outer skin of a mesh, named after the file. Refused bodies carry
        their error; at least one is not refused.

    Raises
    ------
    InputError
        One of its kinds: the file cannot be read, holds no body, or every body is refused.
    """
    if Path(path).suffix.lower() in MESH_SUFFIXES:
        if keywords.get("tolerance") is not None:
            raise InputError(
                f"{Path(path).name} is a mesh: it needs no cover",
                remedy="leave the cover's tolerance out",
            )
        return read_mesh(path, surfacing)
    if surfacing not in (None, Surfacing()):
        raise InputError(
            f"{Path(path).name} is no mesh: it has no scheme, subdivisions or sharp angle",
            remedy=f"leave these out, or give a file of the kinds {', '.join(MESH_SUFFIXES)}",
        )
    return step.read_file(path, **keywords)
