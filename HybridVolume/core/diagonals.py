# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Repairs of the interface's grid: cells cut along their other diagonal, and finer columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import MesherError
from .density import Density
from .element_jacobians import tet_quality
from .interior import Interface, Interior, build_interface, checked_interior
from .shell import Shell
from .strips import GridLines
from .tetmesh import improve
from .wedges import Wedges

_POOR = 0.05
"""Scaled Jacobian of a cell's wedges below which its other diagonal is tried."""
_LONG = 2.0
"""Ratio of a cell's sides from which on only the longer one is halved."""
_FLAT = 0.05
"""Scaled Jacobian of tets that are worth another diagonal."""
_FLIPS = 3
"""Rounds in which cells over flat tets are flipped."""
_GAIN = 1.5
"""Factor by which the other diagonal must be better."""


def wedges_over(
    shell: Shell,
    lines: GridLines,
    density: Density,
    order: int,
    flipped: np.ndarray | None = None,
    reach: np.ndarray | None = None,
) -> tuple[Wedges, np.ndarray]:
    """Wedges over a grid; cells whose wedges are poor take the other diagonal if that is better.

    Parameters
    ----------
    shell : Shell
    lines : GridLines
    density : Density
    order : {1, 2}
    flipped : (nc,) bool array, optional
        Cells that are to be flipped; by default those that gain by it.
    reach : (n,) array, optional
        As for `build_interface`.

    Returns
    -------
    wedges : Wedges
    flipped : (nc,) bool array

    Raises
    ------
    MesherError
        The grid is too coarse.
    """
    wedges = make_wedges(shell, lines, density, order, flipped, reach)
    if flipped is not None:
        return wedges, flipped
    none = np.zeros(lines.cells, dtype=bool)
    quality = wedges.quality()
    poor = np.flatnonzero(quality < _POOR)
    better = poor[_others(shell, lines, density, order, none, poor, reach) > _GAIN * quality[poor]]
    if not len(better):
        return wedges, none
    chosen = _with(none, better)
    try:
        return make_wedges(shell, lines, density, order, chosen, reach), chosen
    except MesherError:
        return wedges, none


def flip_at(
    shell: Shell,
    lines: GridLines,
    density: Density,
    wedges: Wedges,
    flipped: np.ndarray,
    triangles: np.ndarray,
    reach: np.ndarray | None = None,
) -> np.ndarray | None:
    """Flip the cells of triangles at fault that were not flipped yet and whose wedges stay valid.

    Returns
    -------
    (nc,) bool array or None
        None where no cell can be flipped.
    """
    cells = np.unique(np.asarray(triangles, dtype=np.int64) // 2)
    cells = cells[~flipped[cells]]
    other = _others(shell, lines, density, wedges.order, flipped, cells, reach)
    quality = wedges.quality(cells)
    chosen = cells[(other > 0.0) & (other > 0.5 * np.minimum(quality, _POOR))]
    return _with(flipped, chosen) if len(chosen) else None


def flip_flat(
    shell: Shell,
    lines: GridLines,
    density: Density,
    wedges: Wedges,
    flipped: np.ndarray,
    reach: np.ndarray | None,
    interior: Interior,
) -> tuple[Wedges, np.ndarray, Interior]:
    """Flip cells between whose two triangles there is a flat tet, which then is not in the core.

    The tet is taken out of the core and its volume is the wedges' then; no mesher is asked. Cells
    whose wedges would not stay valid are left alone.

    Returns
    -------
    wedges : Wedges
    flipped : (nc,) bool array
    interior : Interior
    """
    for _ in range(_FLIPS):
        cells, tets = _flat_cells(wedges.interface, interior)
        if not len(cells):
            break
        more = flip_at(shell, lines, density, wedges, flipped, 2 * cells, reach)
        if more is None:
            break
        try:
            fresh = make_wedges(shell, lines, density, wedges.order, more, reach)
        except MesherError:
            break
        gone = tets[more[cells] & ~flipped[cells]]
        mesh = interior.mesh
        left = replace(mesh, tets=np.delete(mesh.tets, gone, axis=0))
        interior = checked_interior(improve(left), fresh.interface)
        wedges, flipped = fresh, more
    return wedges, flipped, interior


def _flat_cells(interface: Interface, interior: Interior) -> tuple[np.ndarray, np.ndarray]:
    """Cells between whose two triangles there is a flat tet, and that tet of each."""
    tets, n = interior.mesh.tets, len(interface.vertices)
    on = np.flatnonzero((tets < n).all(axis=1))
    on = on[tet_quality(interior.mesh.vertices[tets[on]]) < _FLAT]
    both = np.sort(interface.triangles.reshape(-1, 6), axis=1)
    # the two triangles of a cell have four different corners, two of them twice
    once = both[np.arange(len(both))[:, None], _distinct(both)]
    rows = np.concatenate([once, np.sort(tets[on], axis=1)])
    _, label = np.unique(rows, axis=0, return_inverse=True)
    label = label.reshape(-1)
    of_cells, of_tets = label[: len(once)], label[len(once) :]
    order = np.argsort(of_tets)
    place = np.minimum(np.searchsorted(of_tets[order], of_cells), max(len(on) - 1, 0))
    cells = np.flatnonzero(np.isin(of_cells, of_tets))
    return cells, on[order[place[cells]]]


def _distinct(rows: np.ndarray) -> np.ndarray:
    """Positions of the four different numbers in sorted rows of six, (m, 4)."""
    fresh = np.ones(rows.shape, dtype=bool)
    fresh[:, 1:] = rows[:, 1:] != rows[:, :-1]
    return np.argsort(~fresh, axis=1, kind="stable")[:, :4]


def refine_at(
    lines: GridLines,
    wanted: GridLines,
    triangles: np.ndarray,
    finest: int,
    sides: np.ndarray | None = None,
) -> GridLines | None:
    """Halve the intervals of the strips through the cells of triangles at fault.

    Of long cells only the long sides are halved.

    Parameters
    ----------
    lines, wanted : GridLines
        As they are, and as they were at first.
    triangles : (m,) int array
        Without any all intervals are halved.
    finest : int
        Parts into which an interval of ``wanted`` may be cut.
    sides : (nc, 2) array, optional
        Lengths of the cells' sides along u and along v.

    Returns
    -------
    GridLines or None
        None where nothing can be halved any more.
    """
    cells = np.full((lines.cells, 2), not len(triangles))
    cells[np.asarray(triangles, dtype=np.int64) // 2] = True
    if sides is not None:
        cells &= sides * _LONG >= sides[:, ::-1]
    parts = []
    for marked, places, first in zip(lines.marked(cells), lines.places, wanted.places, strict=True):
        home = np.searchsorted(first, 0.5 * (places[1:] + places[:-1])) - 1
        room = 2 * np.bincount(home)[home] <= finest
        parts.append(np.where(marked & room, 2, 1))
    if all((p == 1).all() for p in parts):
        return None
    return lines.cut(parts)


def make_wedges(
    shell: Shell,
    lines: GridLines,
    density: Density,
    order: int,
    flipped: np.ndarray | None,
    reach: np.ndarray | None = None,
) -> Wedges:
    """Wedges over a grid as they come; parameters as for `wedges_over`."""
    interface = build_interface(
        shell, density.nodes, density.subdivide, lines=lines, flipped=flipped, reach=reach
    )
    return Wedges(shell, interface, density, order)


def _others(
    shell: Shell,
    lines: GridLines,
    density: Density,
    order: int,
    flipped: np.ndarray,
    cells: np.ndarray,
    reach: np.ndarray | None = None,
) -> np.ndarray:
    """Quality of cells' wedges along their other diagonals, -1 where they are not proved."""
    if not len(cells):
        return np.zeros(0)
    try:
        wedges = make_wedges(shell, lines, density, order, _with(flipped, cells), reach)
    except MesherError:
        # other diagonals that join the same vertices
        return np.full(len(cells), -1.0)
    return wedges.quality(cells)


def _with(flags: np.ndarray, cells: np.ndarray) -> np.ndarray:
    found = flags.copy()
    found[cells] = True
    return found
