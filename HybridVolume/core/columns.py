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
from scipy import sparse

from . import bspline
from .shell import Shell
from .surface import PatchSurface


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
    return [_cut(x, subdivide) for x in u], [_cut(x, subdivide) for x in v]


def _cut(lines: np.ndarray, parts: int) -> np.ndarray:
    share = np.arange(parts) / parts
    inner = lines[:-1, None] + np.diff(lines)[:, None] * share
    return np.append(inner.ravel(), lines[-1])


def doubled_grid(surface: PatchSurface, u: list[np.ndarray], v: list[np.ndarray]) -> DoubledGrid:
    """The grid over given lines of each patch, which must agree along shared sides."""
    u, v = [_cut(x, 2) for x in u], [_cut(x, 2) for x in v]
    ids, count = surface.shared_grid([(len(a), len(b)) for a, b in zip(u, v, strict=True)])
    owner = np.empty(count, dtype=np.int64)
    uv = np.empty((count, 2))
    for k in range(len(ids) - 1, -1, -1):
        uu, vv = np.meshgrid(u[k], v[k], indexing="ij")
        owner[ids[k]] = k
        uv[ids[k], 0], uv[ids[k], 1] = uu, vv
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
    points, patch, uv = [], [], []
    for k, ids in enumerate(grid.ids):
        i = np.arange(0, len(ids) - 1, 2)[:, None, None, None] + np.arange(3)[:, None]
        j = np.arange(0, ids.shape[1] - 1, 2)[None, :, None, None] + np.arange(3)
        points.append(ids[i, j].reshape(-1, 3, 3))
        i, j = np.broadcast_arrays(i, j)
        uv.append(np.stack([grid.u[k][i], grid.v[k][j]], axis=-1).reshape(-1, 3, 3, 2))
        patch.append(np.full(len(points[-1]), k))
    return np.concatenate(points), np.concatenate(patch), np.concatenate(uv)


def layer_parameters(shell: Shell, between: bool) -> np.ndarray:
    """w of the layers' boundaries from outside (0) to inside (1), and half-way if wanted."""
    lines = bspline.breakpoints(shell.knots_w)
    return _cut(lines, 2) if between else lines


def evaluate_columns(shell: Shell, patch: np.ndarray, uv: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Points of the shell at parameter pairs and all of the given w.

    Parameters
    ----------
    shell : Shell
    patch : (m,) int array
    uv : (m, 2) array
        Parameters on the surface patch.
    w : (nw,) array
        At w = 0 the points are those of `PatchSurface.evaluate`, bit for bit.

    Returns
    -------
    (nw, m, 3) array, mm
    """
    basis_w = bspline.basis_matrix(shell.degree_w, shell.knots_w, w)
    result = np.empty((len(w), len(patch), 3))
    order = np.argsort(patch, kind="stable")
    bounds = np.searchsorted(patch[order], np.arange(len(shell.surface.patches) + 1))
    for k, p in enumerate(shell.surface.patches):
        members = order[bounds[k] : bounds[k + 1]]
        if not len(members):
            continue
        u, v = uv[members].T
        net = shell.layers[:, p.index.ravel()]
        weights = np.ones(net.shape[:2])
        weights[0] = p.weights.ravel()
        homogeneous = np.concatenate([net * weights[..., None], weights[..., None]], axis=2)
        levels = (basis_w @ homogeneous.reshape(len(net), -1)).reshape(len(w), -1, 4)
        levels = np.moveaxis(levels, 1, 0).reshape(p.index.size, -1)
        value = (pair_basis(p.degrees, p.knots, u, v) @ levels).reshape(-1, len(w), 4)
        points = value[..., :3]
        if p.weighted:
            points = points / value[..., 3:]
        result[:, members] = np.moveaxis(points, 1, 0)
        for level in np.flatnonzero(w == 0.0):
            result[level, members] = shell.surface.evaluate(k, u, v)
    return result


def pair_basis(
    degrees: tuple[int, int],
    knots: tuple[np.ndarray, np.ndarray],
    u: np.ndarray,
    v: np.ndarray,
    derivative: tuple[int, int] = (0, 0),
) -> sparse.csr_matrix:
    """Bivariate B-spline functions (or derivatives) at m parameter pairs, (m, nu * nv)."""
    fu, bu = bspline.basis_functions(degrees[0], knots[0], u, derivative[0])
    fv, bv = bspline.basis_functions(degrees[1], knots[1], v, derivative[1])
    nu, nv = (len(k) - d - 1 for k, d in zip(knots, degrees, strict=True))
    iu = fu[:, None] + np.arange(degrees[0] + 1)
    iv = fv[:, None] + np.arange(degrees[1] + 1)
    columns = (iu[:, :, None] * nv + iv[:, None, :]).ravel()
    values = (bu[:, :, None] * bv[:, None, :]).ravel()
    local = (degrees[0] + 1) * (degrees[1] + 1)
    rows = np.arange(0, len(u) * local + 1, local)
    return sparse.csr_matrix((values, columns, rows), shape=(len(u), nu * nv))
