# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""NAME_shell.mesh: the shell as an MFEM NURBS mesh v1.0, one NURBS patch an element.

Attributes of the boundary: 1, 2, ... for the CAD faces in the order of the comments at the top,
and one more for the interface to the core. Parameters of a patch are (v, u, w) of the CAD face's
patch, w = 0 on the CAD face.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from HybridVolume.core.atomic import replacing

from .blocks import INTERFACE

if TYPE_CHECKING:
    from HybridVolume.core.solver_patches import SolverPatch, SolverPatches

_CUBE, _SQUARE = 5, 3
"""MFEM's numbers of the shapes."""


def write_mfem(path: str | os.PathLike, shell: SolverPatches) -> None:
    """Write a shell; an existing file is replaced in one step, or stays as it was.

    Parameters
    ----------
    path : path
    shell : SolverPatches

    Raises
    ------
    OSError
        The place cannot be written.
    """
    with replacing(path) as file:
        for line in _lines(shell):
            file.write(line.encode("utf-8") + b"\n")


def _lines(shell: SolverPatches) -> Iterator[str]:
    yield "MFEM NURBS mesh v1.0"
    yield ""
    yield "# lengths in mm; attribute of the boundary and name:"
    for number, name in enumerate((*shell.face_names, INTERFACE), 1):
        yield f"# {number} {' '.join(name.split())}"
    yield from ("", "dimension", "3", "", "elements", str(len(shell.patches)))
    corners = shell.corners
    for row in corners.tolist():
        yield f"1 {_CUBE} {' '.join(map(str, row))}"
    # seen from outside of the shell
    outer = np.column_stack([shell.face + 1, corners[:, [3, 2, 1, 0]]])
    last = np.full(len(corners), len(shell.face_names) + 1)
    inner = np.column_stack([last, corners[:, 4:]])
    yield from ("", "boundary", str(2 * len(corners)))
    for attribute, *row in np.concatenate([outer, inner]).tolist():
        yield f"{attribute} {_SQUARE} {' '.join(map(str, row))}"
    # MFEM finds which edges have the same knots by itself
    yield from ("", "edges", "0", "", "vertices", str(int(corners.max()) + 1), "", "patches")
    for patch in shell.patches:
        yield from _patch_lines(patch)


def _patch_lines(patch: SolverPatch) -> Iterator[str]:
    yield from ("", "knotvectors", "3")
    for degree, knots in zip(patch.degrees, patch.knots, strict=True):
        yield f"{degree} {len(knots) - degree - 1} {' '.join(map(repr, knots.tolist()))}"
    yield from ("dimension", "3", "controlpoints_cartesian")
    rows = np.concatenate([patch.points, patch.weights[..., None]], axis=-1)
    # the first parameter runs fastest
    for row in rows.transpose(2, 1, 0, 3).reshape(-1, 4).tolist():
        yield " ".join(map(repr, row))
