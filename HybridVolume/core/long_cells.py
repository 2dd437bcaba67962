# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Cells that are too long for a thin core: their tets are needles, whoever meshes them.

A layer of the core that is t thick, under cells of length a and width b, has tets with a path of
three edges a, b, t at right angles. At the end of the longest one its scaled Jacobian is about
b t / a^2 (times the root of 2), whatever diagonals are taken: .007 for the 13 x 3 mm cells of a cup
whose core is .4 mm thick. Wedges do not mind. Cells cut across their longer sides are the cure.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np

from .diagonals import refine_at
from .interior import Interior
from .strips import GridLines
from .wedges import Wedges

if TYPE_CHECKING:
    from .finite_elements import FiniteElementMesh

logger = logging.getLogger(__name__)


class _HasMesh(Protocol):
    mesh: FiniteElementMesh


_Meshed = TypeVar("_Meshed", bound=_HasMesh)

NEEDLE = 0.01
"""Scaled Jacobian of tets below which cells are cut."""
LONG = 2.0
"""Ratio of a cell's sides from which on it is long."""
KEPT = 0.9
"""Share of the smallest scaled Jacobian that must be left where there are fewer needles."""
MORE, SPARE = 2, 500
"""Cells there may be then: so many times those that were wanted, and some more in small bodies."""


def shorter_cells(
    lines: GridLines,
    wanted: GridLines,
    wedges: Wedges,
    interior: Interior,
    mesh: FiniteElementMesh,
    finest: int,
) -> GridLines | None:
    """Grid lines that cut the long cells at needles of the core across.

    Parameters
    ----------
    lines, wanted : GridLines
        Those of the mesh, and those that were wanted.
    wedges : Wedges
    interior : Interior
    mesh : FiniteElementMesh
        With the tets of ``interior``, in their order.
    finest : int
        Parts into which an interval of ``wanted`` may be cut.

    Returns
    -------
    GridLines or None
        None where no needle is at a long cell, or cells would become too many.
    """
    tets = interior.mesh.tets[mesh.tet_quality < NEEDLE]
    # cells that share a side with a needle, or are its face
    at = np.isin(wedges.interface.triangles, tets).sum(axis=1) >= 2
    sides = wedges.cell_sides()
    long = sides.max(axis=1) >= LONG * sides.min(axis=1)
    cells = np.flatnonzero(at.reshape(-1, 2).any(axis=1) & long)
    if not len(cells):
        return None
    finer = refine_at(lines, wanted, 2 * cells, finest, sides)
    if finer is None or finer.cells > MORE * wanted.cells + SPARE:
        return None
    logger.info("%d needles at %d long cells; %d cells", len(tets), len(cells), finer.cells)
    return finer


def better_mesh(one: _Meshed, other: _Meshed) -> _Meshed:
    """The one whose worst element is better; or nearly as good, among fewer needles."""
    least = [found.mesh.min_scaled_jacobian for found in (one, other)]
    needles = [np.count_nonzero(found.mesh.tet_quality < NEEDLE) for found in (one, other)]
    fewer = needles[1] < needles[0] and least[1] > KEPT * least[0]
    return other if least[1] > least[0] or fewer else one
