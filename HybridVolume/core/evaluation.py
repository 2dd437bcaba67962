# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Points of many patches at once: patches over the same knots are evaluated together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from . import bspline
from .spans import alike

if TYPE_CHECKING:
    from .surface import Patch


def grid_line(degree: int, knots: np.ndarray, nodes: int | str) -> np.ndarray:
    """Grid lines over a knot vector, see `PatchSurface.grid_parameters`."""
    if nodes == "greville":
        return bspline.greville(degree, knots)
    values = bspline.breakpoints(knots)
    cells = 1 if nodes == "knots" else int(nodes)
    share = np.arange(cells) / cells
    inner = values[:-1, None] + np.diff(values)[:, None] * share
    return np.append(inner.ravel(), values[-1])


def grid_places(mu: np.ndarray, mv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patch, row and column of all grid points, patch by patch and row by row."""
    size = mu * mv
    patch = np.repeat(np.arange(len(size)), size)
    local = np.arange(len(patch)) - np.repeat(np.cumsum(size) - size, size)
    return patch, local // mv[patch], local % mv[patch]


def grid_quads(grids: Sequence[np.ndarray]) -> np.ndarray:
    """Corners of all grid cells, patch by patch, round the cell, (nc, 4)."""
    ids = np.concatenate([grid.ravel() for grid in grids])
    mu, mv = np.array([grid.shape for grid in grids]).T
    patch, row, column = grid_places(mu - 1, mv - 1)
    corner = (np.cumsum(mu * mv) - mu * mv)[patch] + row * mv[patch] + column
    across = mv[patch]
    return ids[np.stack([corner, corner + across, corner + across + 1, corner + 1], axis=1)]


def grid_points(
    grids: Sequence[np.ndarray], u: Sequence[np.ndarray], v: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """The points of shared grids, each on the lowest-numbered patch that has it.

    Parameters
    ----------
    grids : np (mu, mv) int arrays
        Number of each grid point, from 0 without gaps.
    u, v : np (mu,), (mv,) arrays
        Grid lines of each patch.

    Returns
    -------
    owner : (n,) int array
    uv : (n, 2) array
        Parameters on the owner.
    """
    ids = np.concatenate([grid.ravel() for grid in grids])
    mu, mv = np.array([grid.shape for grid in grids]).T
    patch, row, column = grid_places(mu, mv)
    _, first = np.unique(ids, return_index=True)
    owner = patch[first]
    places_u = (np.cumsum(mu) - mu)[owner] + row[first]
    places_v = (np.cumsum(mv) - mv)[owner] + column[first]
    return owner, np.column_stack([np.concatenate(u)[places_u], np.concatenate(v)[places_v]])


@dataclass(frozen=True)
class Stack:
    """Patches over the same knots, to be evaluated together.

    Attributes
    ----------
    members : (m,) int array
        Their numbers.
    degrees : (int, int)
    knots : (array, array)
    index : (m, nu, nv) int array
    weights : (m, nu, nv) array or None
        None for polynomial patches.
    """

    members: np.ndarray
    degrees: tuple[int, int]
    knots: tuple[np.ndarray, np.ndarray]
    index: np.ndarray
    weights: np.ndarray | None

    def basis(
        self, chosen: np.ndarray, u: np.ndarray, v: np.ndarray, derivative: int = 0
    ) -> tuple[tuple[np.ndarray, ...], list[tuple[np.ndarray, np.ndarray]]]:
        """Which entries of the nets act at places of members, and how much.

        Parameters
        ----------
        chosen, u, v, derivative
            As for :meth:`evaluate`.

        Returns
        -------
        pick : tuple of arrays
            ``index[pick]`` is (k, p + 1, q + 1).
        pairs : list of ((k, p + 1) array, (k, q + 1) array)
            Functions in u and v; with ``derivative=1`` then those of x_u and of x_v.
        """
        (p, q), (knots_u, knots_v) = self.degrees, self.knots
        first_u, bu = bspline.basis_functions(p, knots_u, u)
        first_v, bv = bspline.basis_functions(q, knots_v, v)
        rows = (first_u[:, None] + np.arange(p + 1))[:, :, None]
        columns = (first_v[:, None] + np.arange(q + 1))[:, None, :]
        pairs = [(bu, bv)]
        if derivative:
            _, du = bspline.basis_functions(p, knots_u, u, 1)
            _, dv = bspline.basis_functions(q, knots_v, v, 1)
            pairs += [(du, bv), (bu, dv)]
        return (chosen[:, None, None], rows, columns), pairs

    def evaluate(
        self, points: np.ndarray, chosen: np.ndarray, u: np.ndarray, v: np.ndarray, derivative: int
    ) -> list[np.ndarray]:
        """Points, and derivatives if wanted, at places of members.

        Parameters
        ----------
        points : (n, 3) array
            Control points, mm.
        chosen : (k,) int array
            Position of the patch in the stack.
        u, v : (k,) arrays
        derivative : {0, 1}

        Returns
        -------
        list of (k, 3) arrays
            x, and with ``derivative=1`` also x_u and x_v.
        """
        pick, pairs = self.basis(chosen, u, v, derivative)
        values = points[self.index[pick]]
        if self.weights is not None:
            weights = self.weights[pick][..., None]
            values = np.concatenate([values * weights, weights], axis=-1)
        found = [np.einsum("ma,mb,mabd->md", *pair, values) for pair in pairs]
        if self.weights is None:
            return found
        w = found[0][:, 3:]
        x = found[0][:, :3] / w
        return [x, *((d[:, :3] - x * d[:, 3:]) / w for d in found[1:])]


def stacks(patches: tuple[Patch, ...]) -> list[Stack]:
    """Stacks of patches; polynomial and rational ones apart."""
    found = []
    rational = np.array([patch.rational for patch in patches])
    for alike_ones in alike(patches):
        for kind in (False, True):
            members = alike_ones[rational[alike_ones] == kind]
            if not len(members):
                continue
            patch = patches[members[0]]
            # equal weights cancel: dividing by them would cost the last bits
            weights = np.stack([patches[k].weights for k in members]) if kind else None
            index = np.stack([patches[k].index for k in members])
            found.append(Stack(members, patch.degrees, patch.knots, index, weights))
    return found
