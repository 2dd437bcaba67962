# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""NAME_shell.xml: the shell as a multipatch of G+Smo with its interfaces.

The boundary has one element for each CAD face, with its name, and one for the interface to the
core; G+Smo takes them together. Parameters of a patch are (v, u, w) of the CAD face's patch, w = 0
on the CAD face.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

import numpy as np

from HybridVolume.core.atomic import replacing

from .blocks import INTERFACE

if TYPE_CHECKING:
    from HybridVolume.core.solver_patches import SolverPatch, SolverPatches

_OUTER, _INNER = 5, 6
"""Sides w = 0 and w = 1; 1 to 4 are those of the first two parameters."""


def write_gismo(path: str | os.PathLike, shell: SolverPatches) -> None:
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
    yield '<?xml version="1.0" encoding="UTF-8"?>'
    yield "<xml>"
    for number, patch in enumerate(shell.patches):
        yield from _patch_lines(number, patch)
    count = len(shell.patches)
    yield f'<MultiPatch parDim="3" id="{count}">'
    yield f'<patches type="id_range">0 {count - 1}</patches>'
    yield "<interfaces>"
    for row in _interfaces(shell).tolist():
        yield " ".join(map(str, row))
    yield "</interfaces>"
    for position, name in enumerate(shell.face_names):
        yield f"<boundary name={quoteattr(name)}>"
        for patch in np.flatnonzero(shell.face == position).tolist():
            yield f"{patch} {_OUTER}"
        yield "</boundary>"
    yield f"<boundary name={quoteattr(INTERFACE)}>"
    for patch in range(count):
        yield f"{patch} {_INNER}"
    yield "</boundary>"
    yield "</MultiPatch>"
    yield "</xml>"


def _interfaces(shell: SolverPatches) -> np.ndarray:
    """Rows of the interfaces, (m, 10): patch and side twice, directions, orientations."""
    patch, side, other, its, back = shell.meetings.T
    # direction that a side cuts, and the one that it runs along
    cut, along = side // 2, 1 - side // 2
    its_cut, its_along = its // 2, 1 - its // 2
    rows = np.arange(len(side))
    direction = np.full((len(side), 3), 2)
    direction[rows, cut], direction[rows, along] = its_cut, its_along
    forward = np.ones((len(side), 3), dtype=int)
    # going out at one end and in at the other end keeps the direction
    forward[rows, cut] = side % 2 != its % 2
    forward[rows, along] = 1 - back
    return np.column_stack([patch, side + 1, other, its + 1, direction, forward])


def _patch_lines(number: int, patch: SolverPatch) -> Iterator[str]:
    rational = patch.rational
    kind = "Nurbs" if rational else "BSpline"
    yield f'<Geometry type="Tensor{kind}3" id="{number}">'
    if rational:
        yield '<Basis type="TensorNurbsBasis3">'
    yield '<Basis type="TensorBSplineBasis3">'
    for index, (degree, knots) in enumerate(zip(patch.degrees, patch.knots, strict=True)):
        values = " ".join(map(repr, knots.tolist()))
        yield f'<Basis type="BSplineBasis" index="{index}">'
        yield f'<KnotVector degree="{degree}">{values}</KnotVector>'
        yield "</Basis>"
    yield "</Basis>"
    # the first parameter runs fastest
    if rational:
        yield "<weights>"
        yield from map(repr, patch.weights.transpose(2, 1, 0).ravel().tolist())
        yield "</weights>"
        yield "</Basis>"
    yield '<coefs geoDim="3">'
    for row in patch.points.transpose(2, 1, 0, 3).reshape(-1, 3).tolist():
        yield " ".join(map(repr, row))
    yield "</coefs>"
    yield "</Geometry>"
