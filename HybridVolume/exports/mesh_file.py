# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A conforming mesh into a file of any format that there is, by the name's ending."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from HybridVolume.errors import InputError

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh

FORMATS = {
    ".inp": ("inp", "write_inp"),
    ".unv": ("unv", "write_unv"),
    ".med": ("med", "write_med"),
    ".msh": ("msh", "write_msh"),
    ".vtu": ("fem_vtu", "write_fem_vtu"),
}
"""Module and function of each ending."""

NEED_FREECAD = (".med",)
"""Endings whose writer needs FreeCAD's process; the others need numpy only."""


def check_format(path: str | os.PathLike) -> str:
    """Ending of a path, in small letters.

    Raises
    ------
    InputError
        No format has it.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        raise InputError(
            f"meshes are not written as {suffix or 'a name without an ending'}",
            remedy=f"choose one of {', '.join(FORMATS)}",
        )
    return suffix


def write_mesh(path: str | os.PathLike, mesh: FiniteElementMesh) -> None:
    """Write a mesh; an existing file is replaced in one step, or stays as it was.

    Parameters
    ----------
    path : path
        Ends with one of :data:`FORMATS`.
    mesh : FiniteElementMesh

    Raises
    ------
    InputError
        No format has the ending.
    OSError
        The place cannot be written.
    """
    module, function = FORMATS[check_format(path)]
    getattr(import_module(f"{__package__}.{module}"), function)(path, mesh)
