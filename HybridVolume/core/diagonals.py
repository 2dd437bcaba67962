# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Repairs of the interface's grid: cells cut along their other diagonal, and finer columns."""

from __future__ import annotations

import numpy as np

from ..errors import MesherError
from .density import Density
from .element_jacobians import scaled_jacobian
from .interior import Interface, Interior, build_interface
from .shell import Shell
from .strips import GridLines
from .wedges import Wedges

_POOR = 0.05
"""Scaled Jacobian of a cell's wedges below which its other diagonal is tried."""
_LONG = 2.0
"""Ratio of a cell's sides from which on only the longer one is halved."""
_STEP, _SHORTEST = 0.1, 0.5
"""Share of a column that it loses at a time, and what must be left of it."""
_FLAT = 0.02
"""Scaled Jacobian of tets that are worth another diagonal."""
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
    wedges = _wedges(shell, lines, density, order, flipped, reach)
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
        return _wedges(shell, lines, density, order, chosen, reach), chosen
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


def flat_tets(interface: Interface, interior: Interior) -> np.ndarray:
    """Triangles of cells between whose two triangles there is a flat tet.

    Along the other diagonal such a cell is bent the other way, and the tet is not in the core.
    """
    tets, n = interior.mesh.tets, len(interface.vertices)
    on = tets[(tets < n).all(axis=1)]
    on = on[scaled_jacobian("tet4", interior.mesh.vertices[on]) < _FLAT]
    four = np.sort(on, axis=1)
    pairs = interface.triangles.reshape(-1, 6)
    both = np.sort(pairs, axis=1)
    # the two triangles of a cell have four different corners, two of them twice
    once = both[np.arange(len(both))[:, None], _distinct(both)]
    rows = np.concatenate([once, four])
    _, label = np.unique(rows, axis=0, return_inverse=True)
    label = label.reshape(-1)
    return 2 * np.flatnonzero(np.isin(label[: len(once)], label[len(once) :]))


def _distinct(rows: np.ndarray) -> np.ndarray:
    """Positions of the four different numbers in sorted rows of six, (m, 4)."""
    fresh = np.ones(rows.shape, dtype=bool)
    fresh[:, 1:] = rows[:, 1:] != rows[:, :-1]
    return np.argsort(~fresh, axis=1, kind="stable")[:, :4]


def withdraw_at(interface: Interface, triangles: np.ndarray) -> np.ndarray | None:
    """Shorten the columns under triangles that cut others, and half as much those around.

    Where the inner surface cuts itself by little, or comes nearer to itself than its facets do, no
    finer grid helps; a core that reaches a little into the shell does.

    Returns
    -------
    (n,) array or None
        Parameter w of each vertex; None where columns would lose more than half.
    """
    w = interface.vertex_w if len(interface.vertex_w) else np.ones(len(interface.vertices))
    at = np.zeros(len(w), dtype=bool)
    at[interface.triangles[triangles]] = True
    near = np.zeros(len(w), dtype=bool)
    near[interface.edges[at[interface.edges].any(axis=1)]] = True
    found = w * np.where(at, 1.0 - _STEP, np.where(near, 1.0 - 0.5 * _STEP, 1.0))
    return found if found.min() >= _SHORTEST else None


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


def _wedges(
    shell: Shell,
    lines: GridLines,
    density: Density,
    order: int,
    flipped: np.ndarray | None,
    reach: np.ndarray | None = None,
) -> Wedges:
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
        wedges = _wedges(shell, lines, density, order, _with(flipped, cells), reach)
    except MesherError:
        # other diagonals that join the same vertices
        return np.full(len(cells), -1.0)
    return wedges.quality(cells)


def _with(flags: np.ndarray, cells: np.ndarray) -> np.ndarray:
    found = flags.copy()
    found[cells] = True
    return found
