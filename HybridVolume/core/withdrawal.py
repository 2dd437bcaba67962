# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Repair of columns that are too long for their finite elements: the core reaches into the shell.

Straight edges between the shell's points follow its columns only roughly. What is left of a column
is the better followed the shorter it is, since its outer end lies on the surface itself; and a thin
core gets thicker by it.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from ..errors import MesherError
from .columns import evaluate_columns
from .density import Density
from .diagonals import make_wedges
from .interior import Interface, Interior, checked_interior, crossing_triangles
from .shell import Shell
from .strips import GridLines
from .tetmesh import TetMesh, improve
from .tetmesh.mesh import EDGES, FACES
from .wedges import Wedges

logger = logging.getLogger(__name__)

_STEP = 0.1
"""Share of a column that it loses at a time where facets cut each other."""
_SHORTEST = 0.1
"""What must be left of a column."""
_SHORTER = 0.2
"""Share of a column that it loses at a time where wedges are poor."""
_POOR = 0.001
"""Scaled Jacobian of wedges with straight edges inside below which columns are shortened."""
_FLAT = 0.05
"""Height of a tet over its shortest edge below which it is worth shorter columns."""
_FLATTEST = 0.005
"""The same, below which no tet shall come where columns are shortened for other reasons."""
_ROUNDS = 12


def withdraw_at(interface: Interface, triangles: np.ndarray) -> np.ndarray | None:
    """Shorten the columns under triangles that cut others, and half as much those around.

    Where the inner surface cuts itself by little, or comes nearer to itself than its facets do, no
    finer grid helps; a core that reaches a little into the shell does.

    Returns
    -------
    (n,) array or None
        Parameter w of each vertex; None where a column would get shorter than a tenth.
    """
    found = _shorter(interface, triangles, _reach(interface), _STEP)
    return found if found.min() >= _SHORTEST else None


def withdraw_poor(
    shell: Shell,
    lines: GridLines,
    density: Density,
    wedges: Wedges,
    flipped: np.ndarray,
) -> tuple[Wedges, np.ndarray | None]:
    """Shorten columns until their wedges are valid, at least with straight edges inside.

    Columns that need nothing are left alone; one that is down to a tenth stays there.

    Parameters
    ----------
    shell : Shell
    lines : GridLines
    density : Density
    wedges : Wedges
    flipped : (nc,) bool array

    Returns
    -------
    wedges : Wedges
    reach : (n,) array or None
        Parameter w of each vertex; None where all is well as it is.
    """
    reach = None
    for _ in range(_ROUNDS):
        poor = wedges.poor_cells(_POOR)
        if not len(poor):
            break
        w = _reach(wedges.interface)
        triangles = (2 * poor[:, None] + np.arange(2)).ravel()
        shorter = np.maximum(_shorter(wedges.interface, triangles, w, _SHORTER), _SHORTEST)
        shorter = np.minimum(shorter, w)
        if np.array_equal(shorter, w):
            break
        try:
            wedges = make_wedges(shell, lines, density, wedges.order, flipped, shorter)
        except MesherError:
            break
        reach = shorter
    return wedges, reach


def thicken(
    shell: Shell,
    lines: GridLines,
    density: Density,
    wedges: Wedges,
    flipped: np.ndarray,
    interior: Interior,
) -> tuple[Wedges, Interior]:
    """Shorten the columns at tets that are flat because the core has next to no thickness there.

    The tets move along with the interface and are improved again; no mesher is asked. Columns whose
    tets would get flatter stay, and all of them where a wedge would get poor or the interface would
    cut itself.

    Parameters
    ----------
    shell : Shell
    lines : GridLines
    density : Density
    wedges : Wedges
    flipped : (nc,) bool array
    interior : Interior

    Returns
    -------
    wedges : Wedges
    interior : Interior
    """
    interface, mesh = wedges.interface, interior.mesh
    reach = _reach(interface)
    for _ in range(_ROUNDS):
        flatness = _flatness(mesh.vertices, mesh.tets)
        flat = flatness < _FLAT
        at = np.unique(mesh.tets[flat])
        shorter = _shortened(interface, at[at < len(reach)], reach, _STEP)
        moved, shorter = _moved(shell, interface, mesh, reach, shorter, _FLAT)
        if np.array_equal(reach, shorter):
            break
        moved = improve(moved)
        after = _flatness(moved.vertices, moved.tets)
        if np.count_nonzero(after < _FLAT) >= flat.sum() and after.min() <= flatness.min():
            break
        mesh, reach = moved, shorter
    found = _with_reach(shell, lines, density, wedges, flipped, mesh, reach)
    if found is None or len(np.setdiff1d(found[0].poor_cells(_POOR), wedges.poor_cells(_POOR))):
        return wedges, interior
    return found


def withdraw_under(
    shell: Shell,
    lines: GridLines,
    density: Density,
    wedges: Wedges,
    flipped: np.ndarray,
    interior: Interior,
    triangles: np.ndarray,
) -> tuple[Wedges, Interior] | None:
    """Shorten the columns under triangles; the tets of the core move along.

    Parameters
    ----------
    shell, lines, density, wedges, flipped, interior
        As for `thicken`.
    triangles : (k,) int array
        Of the interface.

    Returns
    -------
    wedges : Wedges
    interior : Interior
        None instead of both where no column can be shortened.
    """
    interface = wedges.interface
    reach = _reach(interface)
    for step in (_SHORTER, 0.5 * _SHORTER, 0.25 * _SHORTER):
        shorter = _shorter(interface, triangles, reach, step)
        mesh, shorter = _moved(shell, interface, interior.mesh, reach, shorter, _FLATTEST)
        found = _with_reach(shell, lines, density, wedges, flipped, mesh, shorter)
        if found is not None:
            wedges, interior = found
            return wedges, checked_interior(improve(interior.mesh), wedges.interface)
    return None


def _moved(
    shell: Shell,
    interface: Interface,
    mesh: TetMesh,
    reach: np.ndarray,
    shorter: np.ndarray,
    least: float,
) -> tuple[TetMesh, np.ndarray]:
    """Tets on an interface of shorter columns; columns stay that would make flat tets flatter.

    Returns
    -------
    mesh : TetMesh
    reach : (n,) array
        As the columns are then.
    """
    shorter = np.maximum(shorter, np.minimum(reach, _SHORTEST))
    moved = np.flatnonzero(shorter < reach)
    flatness = _flatness(mesh.vertices, mesh.tets)
    vertices = mesh.vertices.copy()
    for _ in range(_ROUNDS):
        if not len(moved):
            break
        place = interface.vertex_patch[moved], interface.vertex_uv[moved]
        vertices[moved] = evaluate_columns(shell, *place, shorter[None, moved])[0]
        after = _flatness(vertices, mesh.tets)
        back = np.intersect1d(mesh.tets[(after < flatness) & (after < least)], moved)
        if not len(back):
            return replace(mesh, vertices=vertices), shorter
        vertices[back], shorter[back] = mesh.vertices[back], reach[back]
        moved = np.setdiff1d(moved, back)
    return mesh, reach


def _with_reach(
    shell: Shell,
    lines: GridLines,
    density: Density,
    wedges: Wedges,
    flipped: np.ndarray,
    mesh: TetMesh,
    reach: np.ndarray,
) -> tuple[Wedges, Interior] | None:
    """Wedges and core of shorter columns, None where the interface is as it was, or cuts itself."""
    if np.array_equal(reach, _reach(wedges.interface)):
        return None
    try:
        fresh = make_wedges(shell, lines, density, wedges.order, flipped, reach)
    except MesherError:
        return None
    if len(crossing_triangles(fresh.interface)):
        return None
    logger.info("%d columns are shortened", np.count_nonzero(reach < 1.0))
    vertices = np.concatenate([fresh.interface.vertices, mesh.vertices[len(reach) :]])
    return fresh, checked_interior(replace(mesh, vertices=vertices), fresh.interface)


def _flatness(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Smallest height of tets over their shortest edge, (m,): small for flat, not for long ones."""
    x = vertices[tets]
    corners = x[:, FACES]
    normal = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    area = np.linalg.norm(normal, axis=2).max(axis=1)
    edge = np.linalg.norm(x[:, EDGES[:, 0]] - x[:, EDGES[:, 1]], axis=2).min(axis=1)
    volume = np.einsum("mi,mi->m", normal[:, 0], x[:, 1] - x[:, 0])
    return volume / np.maximum(area * edge, np.finfo(float).tiny)


def _reach(interface: Interface) -> np.ndarray:
    """Parameter w of each vertex on its column, (n,)."""
    return interface.vertex_w if len(interface.vertex_w) else np.ones(len(interface.vertices))


def _shorter(interface: Interface, triangles: np.ndarray, w: np.ndarray, step: float) -> np.ndarray:
    """Columns under triangles less a share of them, and half as much those around, (n,)."""
    return _shortened(interface, interface.triangles[triangles].ravel(), w, step)


def _shortened(
    interface: Interface, vertices: np.ndarray, w: np.ndarray, step: float
) -> np.ndarray:
    """Columns of vertices less a share of them, and half as much those around, (n,)."""
    at = np.zeros(len(w), dtype=bool)
    at[vertices] = True
    near = np.zeros(len(w), dtype=bool)
    near[interface.edges[at[interface.edges].any(axis=1)]] = True
    return w * np.where(at, 1.0 - step, np.where(near, 1.0 - 0.5 * step, 1.0))
