# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Crossings of the inner surface, and planes that keep its parts on their own sides.

Opposite fronts of a thin part or of a sharp wedge may run through each other while every element
stays valid. Where two triangles cross in a state that is wanted, they are apart in the last sound
one; a plane between them there is a fair border, and the optimisation is told to respect it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from .evaluation import grid_places, grid_quads
from .intersection import CrossingPairs, self_intersections
from .surface import PatchSurface

STIFFNESS = 100.0
"""Weight of what is beyond its plane, relative to the weight 1 of all elements together."""
ROOM = 0.05
"""Distance that is kept from a plane, as a share of the triangle's size."""


class TestGrid:
    """Triangles over the knot spans, by which crossings are found.

    Parameters
    ----------
    surface : PatchSurface
    cells : int
        Cells a knot span in each direction.
    spans : int array, optional
        Knot spans that are tested; all otherwise.

    Attributes
    ----------
    element : (nt,) int array
        Element under each triangle.
    matrix : (nv, n) sparse matrix
        Takes control points of a polynomial inner surface to the vertices.
    outer_embedded : bool
        Whether the outer surface's own triangles are free of crossings.
    """

    __test__ = False

    def __init__(self, surface: PatchSurface, cells: int, spans: np.ndarray | None = None) -> None:
        outer = surface.triangulation(cells)
        mu, mv = np.array([grid.shape for grid in outer.grids]).T - 1
        patch, row, column = grid_places(mu, mv)
        across = mv // cells
        first = np.cumsum(mu // cells * across) - mu // cells * across
        element = first[patch] + row // cells * across[patch] + column // cells
        self.quads = grid_quads(outer.grids)
        if spans is not None:
            chosen = np.isin(element, spans)
            element, self.quads = element[chosen], self.quads[chosen]
        self.element = np.repeat(element, 2)
        self.matrix = surface.basis_at(outer.vertex_patch, *outer.vertex_uv.T)
        triangles = outer.triangles if spans is None else self.triangles(outer.vertices)
        self.outer_embedded = not len(self_intersections(outer.vertices, triangles))
        self._pairs = CrossingPairs()

    def triangles(self, vertices: np.ndarray) -> np.ndarray:
        """Every cell cut along its shorter diagonal, (nt, 3)."""
        x = vertices[self.quads]
        along = np.linalg.norm(x[:, 2] - x[:, 0], axis=1)
        across = np.linalg.norm(x[:, 3] - x[:, 1], axis=1)
        other = (across < along * (1.0 - 1e-9))[:, None]
        first = np.where(other, self.quads[:, [0, 1, 3]], self.quads[:, [0, 1, 2]])
        second = np.where(other, self.quads[:, [1, 2, 3]], self.quads[:, [0, 2, 3]])
        return np.stack([first, second], axis=1).reshape(-1, 3)

    def crossing(self, inner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Triangles, and pairs of them that cross, for control points of the inner surface."""
        vertices = self.matrix @ inner
        triangles = self.triangles(vertices)
        return triangles, self._pairs.find(vertices, triangles)


@dataclass(frozen=True)
class Planes:
    """Planes with points of the inner surface that have to stay above them.

    Attributes
    ----------
    matrix : (m, n) sparse matrix
        Takes control points of the inner surface to the points.
    normal : (m, 3) array
        Unit normals.
    height : (m,) array
        Smallest normal . point that is wanted, mm.
    scale : (m,) array
        Size of what the point belongs to, mm.
    """

    matrix: sparse.csr_matrix
    normal: np.ndarray
    height: np.ndarray
    scale: np.ndarray

    def __len__(self) -> int:
        return len(self.height)

    def joined(self, other: Planes) -> Planes:
        """All planes of both."""
        return Planes(
            sparse.vstack([self.matrix, other.matrix], format="csr"),
            np.concatenate([self.normal, other.normal]),
            np.concatenate([self.height, other.height]),
            np.concatenate([self.scale, other.scale]),
        )

    def energy(self, inner: np.ndarray) -> tuple[float, np.ndarray]:
        """Penalty of what is below its plane and its gradient by the control points, (n, 3)."""
        points = self.matrix @ inner
        below = self.height - np.einsum("mi,mi->m", self.normal, points)
        below = np.maximum(below, 0.0) / self.scale
        share = STIFFNESS / len(inner)
        pull = (-2.0 * share * below / self.scale)[:, None] * self.normal
        return share * float(below @ below), self.matrix.T @ pull

    def stiffness(self) -> sparse.csr_matrix:
        """Convex part for one coordinate, (n, n)."""
        n = self.matrix.shape[1]
        weight = 2.0 * STIFFNESS / n / 3.0 / self.scale**2
        return (self.matrix.T @ sparse.diags(weight) @ self.matrix).tocsr()


def planes_between(
    grid: TestGrid, triangles: np.ndarray, pairs: np.ndarray, sound: np.ndarray
) -> Planes:
    """Planes that part pairs of triangles in a sound state.

    Parameters
    ----------
    grid : TestGrid
    triangles : (nt, 3) int array
        As they cross in the state that was wanted.
    pairs : (k, 2) int array
    sound : (n, 3) array
        Control points of the inner surface in the sound state, mm.
    """
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    vertices = grid.matrix @ sound
    corners = triangles[pairs]  # (k, 2, 3)
    x = vertices[corners]
    normal, low, high = _widest_gap(x[:, 0], x[:, 1])
    size = np.sqrt(
        np.linalg.norm(np.cross(x[:, :, 1] - x[:, :, 0], x[:, :, 2] - x[:, :, 0]), axis=2)
    )
    middle = 0.5 * (low + high)
    shared = (corners[:, :, :, None] == corners[:, ::-1, None, :]).any(axis=3)
    rows, normals, heights, scales = [], [], [], []
    for side, sign in ((0, 1.0), (1, -1.0)):
        for corner in range(3):
            # a corner that both have lies in the plane and is in nobody's way
            use = ~shared[:, side, corner] & np.isfinite(middle)
            rows.append(corners[use, side, corner])
            normals.append(sign * normal[use])
            heights.append(sign * middle[use] + ROOM * size[use, side])
            scales.append(size[use, side])
    rows = np.concatenate(rows)
    scale = np.concatenate(scales)
    floor = 1e-3 * np.median(scale) if len(scale) else 1.0
    return Planes(
        grid.matrix[rows],
        np.concatenate(normals),
        np.concatenate(heights),
        np.maximum(scale, floor),
    )


def _widest_gap(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Direction in which triangles a lie farthest above triangles b, top of b and bottom of a.

    Tried are the normals of both, the products of their sides and the line between the middles;
    the best is a separating direction wherever there is one.
    """
    sides = [np.roll(t, -1, axis=1) - t for t in (a, b)]
    tries = [np.cross(s[:, 0], s[:, 1]) for s in sides]
    tries += [np.cross(sides[0][:, i], sides[1][:, j]) for i in range(3) for j in range(3)]
    tries += [np.cross(t, s[:, i]) for t, s in zip(tries[:2], sides, strict=True) for i in range(3)]
    tries.append(a.mean(axis=1) - b.mean(axis=1))
    best = np.full(len(a), -np.inf)
    normal = np.zeros((len(a), 3))
    low, high = np.full(len(a), np.nan), np.full(len(a), np.nan)
    for direction in tries:
        length = np.linalg.norm(direction, axis=1)
        unit = direction / np.maximum(length, 1e-300)[:, None]
        for sign in (1.0, -1.0):
            over = np.einsum("kci,ki->kc", a, sign * unit).min(axis=1)
            under = np.einsum("kci,ki->kc", b, sign * unit).max(axis=1)
            better = (over - under > best) & (length > 0.0)
            best = np.where(better, over - under, best)
            normal[better] = sign * unit[better]
            low[better], high[better] = under[better], over[better]
    return normal, low, high
