# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What became of the faces of a covered body: kept bit for bit, exact, or within a tolerance."""

from __future__ import annotations

from collections.abc import Container, Sequence

import numpy as np

from ..surface import SplineFace
from .outline import Outline
from .rims import Rims

BIT, EXACT, TOLERANCE = KINDS = ("bit", "exact", "tolerance")
"""Own B-spline surface with its own parameters, as it is or cut along its parameter lines; the same
points but for rounding; anything else."""

ROUNDING = 1e-12
"""Largest distance of points that are the same, as a share of the diagonal."""


def kinds_of(
    outline: Outline,
    grids: Container[int],
    rims: Rims,
    rim_edge: np.ndarray,
    planar: np.ndarray,
    surfaces: Sequence[SplineFace],
    deviation: np.ndarray,
) -> tuple[str, ...]:
    """Kind of every face of an outline.

    Parameters
    ----------
    outline : Outline
    grids : container of int
        Faces whose patches are pieces of their surfaces.
    rims : Rims
    rim_edge : (k,) int array
        Edge of each rim.
    planar : (nf,) bool array
        Faces in a plane.
    surfaces : sequence of SplineFace
        ``exact`` says that a surface was converted and is not the file's own.
    deviation : (nf,) array
        Measured distances, mm; nothing that is farther away than rounding is called exact.

    Returns
    -------
    tuple of str
        ``bit``, ``exact`` or ``tolerance``.
    """
    followed = np.zeros(len(outline.edges), dtype=bool)
    followed[rim_edge[~rims.exact]] = True
    loose = np.zeros(len(surfaces), dtype=bool)
    np.logical_or.at(loose, outline.face, followed[outline.edge])
    reach = float(np.abs(outline.vertices).max())
    diagonal = float(np.linalg.norm(np.ptp(outline.vertices, axis=0)))
    # coordinates far from the origin are rounded more coarsely than a small body is exact
    allowed = ROUNDING * diagonal + 8.0 * np.finfo(float).eps * reach
    found = []
    for face, surface in enumerate(surfaces):
        if deviation[face] > allowed or not (face in grids or (planar[face] and not loose[face])):
            found.append(TOLERANCE)
        else:
            found.append(BIT if face in grids and not surface.exact else EXACT)
    return tuple(found)


def kinds_of_origins(kinds: Sequence[str], origin: np.ndarray) -> tuple[str, ...]:
    """Kinds of faces that were cut into pieces: those of their worst pieces.

    Parameters
    ----------
    kinds : sequence of str
        Of the pieces.
    origin : (n,) int array
        Face that each is a piece of.
    """
    worst = np.zeros(int(origin.max()) + 1, dtype=int)
    np.maximum.at(worst, origin, [KINDS.index(kind) for kind in kinds])
    return tuple(KINDS[k] for k in worst.tolist())
