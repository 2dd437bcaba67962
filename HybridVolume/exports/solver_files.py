# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A hybrid volume for solvers that know splines: the shell, the core beside it, the interface.

No such program has a format for both, so that there are four files: NAME.mesh (MFEM) or NAME.xml
(G+Smo) with the shell, NAME_core.msh, NAME_interface.csv and NAME_interface_triangles.csv.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from HybridVolume.core.analysis.hybrid_space import hybrid_space
from HybridVolume.core.analysis.tet_space import tet_space
from HybridVolume.core.solver_patches import solver_patches
from HybridVolume.errors import HybridVolumeError, InputError
from HybridVolume.protocol import exported_files

from .core_mesh import write_core, write_interface, write_interface_triangles
from .gismo_xml import write_gismo
from .mfem_mesh import write_mfem

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume

logger = logging.getLogger(__name__)

SHELL_FORMATS = {".mesh": write_mfem, ".xml": write_gismo}
"""Writer of the shell by the ending."""

DEGREES = (1, 2, 3)


def check_shell_format(path: str | os.PathLike, degree: int = 2) -> str:
    """Ending of a path, in small letters.

    Raises
    ------
    InputError
        No format has it, or there are no tetrahedra of this degree.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SHELL_FORMATS:
        raise InputError(
            f"shells are not written as {suffix or 'a name without an ending'}",
            remedy="choose .mesh (MFEM) or .xml (G+Smo)",
        )
    if degree not in DEGREES:
        raise InputError(f"degree {degree} in the core", remedy="choose 1, 2 or 3")
    return suffix


def write_shell(path: str | os.PathLike, volume: HybridVolume) -> None:
    """Write the shell alone; see :func:`write_solver_files`."""
    SHELL_FORMATS[check_shell_format(path)](path, solver_patches(volume.shell))


def write_core_files(
    folder: str | os.PathLike,
    stem: str,
    volume: HybridVolume,
    degree: int = 2,
    *,
    straight: bool = False,
) -> tuple[list[Path], dict[str, Any]]:
    """Write core and interface alone; see :func:`write_solver_files`.

    Parameters
    ----------
    folder : path
    stem : str
    volume : HybridVolume
    degree : {1, 2, 3}
    straight : bool
        Write straight tetrahedra where no valid curved ones are found, instead of raising.

    Returns
    -------
    files : list of Path
        The three files of :func:`HybridVolume.protocol.exported_files`.
    figures : dict
        ``degree``, ``tets`` and ``nodes`` of the core in the file, ``notes`` on what was done.
    """
    shell = solver_patches(volume.shell)
    parts = volume.shell, volume.interface, volume.interior
    try:
        space = hybrid_space(*parts, degree=degree)
        core, notes = space.tets, list(space.notes)
    except HybridVolumeError as error:
        if not straight:
            raise
        core = tet_space(*parts, degree=1)
        notes = [f"the core's tetrahedra are straight: {error.line}"]
        reach = int((volume.interface.vertex_w < 1.0).sum())
        if reach:
            notes.append(f"{reach} nodes of the interface stand inside of the shell (t3 < 1)")
        logger.warning("%s", "; ".join(notes))
    files = [Path(folder) / name for name in exported_files(stem, "core")]
    write_core(files[0], core)
    write_interface(files[1], core, shell)
    write_interface_triangles(files[2], core, shell)
    return files, {
        "degree": core.degree,
        "tets": len(core.elements),
        "nodes": len(core.nodes),
        "notes": notes,
    }


def write_solver_files(
    path: str | os.PathLike, volume: HybridVolume, degree: int = 2
) -> list[Path]:
    """Write the shell to a path, and core and interface beside it.

    Parameters
    ----------
    path : path
        ``.mesh`` (MFEM NURBS mesh v1.0) or ``.xml`` (G+Smo multipatch).
    volume : HybridVolume
    degree : {1, 2, 3}
        Of the core's tetrahedra.

    Returns
    -------
    list of Path
        The four files.

    Raises
    ------
    InputError
        No format has the ending, the degree is another, or no valid curved tetrahedra are found.
    MesherError
        The core could not be filled anew where those need it.
    OSError
        The place cannot be written.
    """
    path = Path(path)
    check_shell_format(path, degree)
    beside, _ = write_core_files(path.parent, path.stem, volume, degree)
    write_shell(path, volume)
    return [path, *beside]
