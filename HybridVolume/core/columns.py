# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Points of the shell over shared parameter grids: the columns that wedges are made of.

A grid line stands at every line of the interface and half-way between two, so that corners, mid
nodes of sides and the middle of a cell (the mid node of either diagonal) are grid points. Points
on sides that patches share are one point by topology; the lowest-numbered patch owns them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import bspline
from .evaluation import grid_places, grid_points
from .shell import Shell
from .surface import PatchSurface

_BLOCK = 20_000
"""Places whose columns are evaluated at once, which bounds the memory."""


@dataclass(frozen=True)
class DoubledGrid:
    """Grid lines of all patches with the half-way lines between.

    Attributes
    ----------
    u, v : tuples of arrays
        Parameters of the lines of each patch, (2 m - 1,).
    ids : tuple of (2 mu - 1, 2 mv - 1) int arrays
        Number of each grid point; shared sides have the same numbers.
    owner : (n,) int array
        Lowest-numbered patch that has the point.
    uv : (n, 2) array
        Its parameters there.
    """

    u: tuple[np.ndarray, ...]
    v: tuple[np.ndarray, ...]
    ids: tuple[np.ndarray, ...]
    owner: np.ndarray
    uv: np.ndarray

    def __len__(self) -> int:
        return len(self.owner)


def interface_lines(
    surface: PatchSurface, nodes: str, subdivide: int
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Grid lines of the interface: knots or Greville abscissae, every cell cut into n."""
    if nodes not in ("knots", "greville"):
        raise ValueError(f"nodes stand at 'knots' or 'greville', not at {nodes!r}")
    if subdivide < 1:
        raise ValueError("a cell is cut into one part at least")
    u, v = surface.grid_parameters(nodes)
    return _cut_all(u, subdivide), _cut_all(v, subdivide)


def _cut_all(lines: list[np.ndarray], parts: int) -> list[np.ndarray]:
    """Lines of all patches, cut; lines that are one object stay one."""
    done: dict[int, np.ndarray] = {}
    for line in lines:
        if id(line) not in done:
            done[id(line)] = _cut(line, parts)
    return [done[id(line)] for line in lines]


def _cut(lines: np.ndarray, parts: int) -> np.ndarray:
    share = np.arange(parts) / parts
    inner = lines[:-1, None] + np.diff(lines)[:, None] * share
    return np.append(inner.ravel(), lines[-1])


def doubled_grid(surface: PatchSurface, u: list[np.ndarray], v: list[np.ndarray]) -> DoubledGrid:
    """The grid over given lines of each patch, which must agree along shared sides."""
    u, v = _cut_all(u, 2), _cut_all(v, 2)
    ids, _ = surface.shared_grid([(len(a), len(b)) for a, b in zip(u, v, strict=True)])
    owner, uv = grid_points(ids, u, v)
    return DoubledGrid(tuple(u), tuple(v), tuple(ids), owner, uv)


def grid_cells(grid: DoubledGrid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells between the given lines, patch by patch, u then v.

    Returns
    -------
    points : (nc, 3, 3) int array
        Grid points of each cell: corners, middles of the sides, and the middle.
    patch : (nc,) int array
    uv : (nc, 3, 3, 2) array
        Parameters on that patch.
    """
    ids = np.concatenate([g.ravel() for g in grid.ids])
    mu, mv = np.array([g.shape for g in grid.ids]).T
    patch, row, column = grid_places(mu // 2, mv // 2)
    i = 2 * row[:, None, None] + np.arange(3)[:, None]
    j = 2 * column[:, None, None] + np.arange(3)
    start = (np.cumsum(mu * mv) - mu * mv)[patch]
    points = ids[start[:, None, None] + i * mv[patch][:, None, None] + j]
    u = np.concatenate(grid.u)[(np.cumsum(mu) - mu)[patch][:, None, None] + i]
    v = np.concatenate(grid.v)[(np.cumsum(mv) - mv)[patch][:, None, None] + j]
    return points, patch, np.stack(np.broadcast_arrays(u, v), axis=-1)


def layer_parameters(shell: Shell, between: bool) -> np.ndarray:
    """w of the layers' boundaries from outside (0) to inside (1), and half-way if wanted."""
    lines = bspline.breakpoints(shell.knots_w)
    return _cut(lines, 2) if between else lines


def evaluate_columns(shell: Shell, patch: np.ndarray, uv: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Points of the shell at parameter pairs and the given w.

    Parameters
    ----------
    shell : Shell
    patch : (m,) int array
    uv : (m, 2) array
        Parameters on the surface patch.
    w : (nw,) or (nw, m) array
        The same for all pairs, or those of each. At w = 0 the points are those of
        `PatchSurface.evaluate`, bit for bit.

    Returns
    -------
    (nw, m, 3) array, mm
    """
    surface = shell.surface
    u, v = uv.T
    basis_w = bspline.basis_matrix(shell.degree_w, shell.knots_w, w.ravel()).toarray()
    basis_w = basis_w.reshape(*w.shape, -1)
    result = np.empty((len(w), len(patch), 3))
    number, place = surface.stack_of
    for k, stack in enumerate(surface.stacks):
        members = np.flatnonzero(number[patch] == k)
        weights = np.stack([surface.patches[i].weights for i in stack.members])
        plain = not (weights != 1.0).any()
        for part in np.array_split(members, 1 + len(members) // _BLOCK):
            pick, [(left, right)] = stack.basis(place[patch[part]], u[part], v[part])
            act = left[:, :, None] * right[:, None, :]
            nets = shell.layers[:, stack.index[pick]]
            levels = np.einsum("mab,lmabd->lmd", act, nets)
            across = basis_w if w.ndim == 1 else basis_w[:, part]
            if plain:
                result[:, part] = _combined(across, levels)
                continue
            # only the outer layer has weights
            first = act * weights[pick]
            heavy = first.sum(axis=(1, 2))
            levels[0] = np.einsum("mab,mabd->md", first, nets[0])
            first = across[:, :1] if w.ndim == 1 else across[..., 0]
            weight = first * heavy + (1.0 - first)
            result[:, part] = _combined(across, levels) / weight[..., None]
    outer = np.flatnonzero((w == 0.0) if w.ndim == 1 else (w == 0.0).all(axis=1))
    if len(outer):
        result[outer] = surface.evaluate_at(patch, u, v)
    return result


def _combined(basis: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Sums of control levels (l, m, 3) with a basis (nw, l) or (nw, m, l), (nw, m, 3)."""
    if basis.ndim == 2:
        return np.tensordot(basis, levels, 1)
    return np.einsum("kml,lmd->kmd", basis, levels, optimize=True)
