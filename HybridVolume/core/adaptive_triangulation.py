# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Watertight triangles on the surface that are small where a size function asks for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .evaluation import grid_places, grid_quads
from .surface import PatchSurface, SurfaceMesh
from .tetmesh.mesh import row_keys

SIDES = np.array([[0, 1], [1, 2], [2, 0]])


@dataclass(frozen=True)
class AdaptiveTriangles:
    """Closed triangles, oriented outward, every vertex on the surface.

    Attributes
    ----------
    vertices : (n, 3) array
        mm.
    triangles : (t, 3) int array
    patch : (t,) int array
    uv : (t, 3, 2) array
        Parameters of every corner on its triangle's patch.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    patch: np.ndarray
    uv: np.ndarray


def adaptive_triangulation(
    surface: PatchSurface,
    size: Callable[[np.ndarray], np.ndarray],
    *,
    deflection: float = 0.06,
    max_triangles: int = 40_000,
    rounds: int = 14,
) -> AdaptiveTriangles:
    """Split the triangles over the knot spans along their longest edges.

    Parameters
    ----------
    surface : PatchSurface
    size : callable
        Wanted edge length, mm, at (k, 3) points.
    deflection : float
        Largest distance of the surface from the middle of an edge, in units of the wanted size.
    max_triangles : int
        Stop there.
    rounds : int
    """
    current = from_grid(_base(surface, max_triangles // 4))
    for _ in range(rounds):
        if len(current.triangles) >= max_triangles:
            break
        edges = _Edges(surface, current)
        wanted = size(0.5 * (edges.ends[0] + edges.ends[1]))
        sag = np.linalg.norm(edges.middle - 0.5 * (edges.ends[0] + edges.ends[1]), axis=1)
        bad = (edges.length > 1.4 * wanted) | (sag > deflection * wanted)
        # shapes stay bounded when only edges among the longest of a triangle are split
        lengths = edges.length[edges.of_triangle]
        long = lengths >= 0.9 * lengths.max(axis=1, keepdims=True)
        chosen = np.unique(edges.of_triangle[bad[edges.of_triangle] & long])
        sagging = bad[edges.of_triangle].any(axis=1) & ~(bad[edges.of_triangle] & long).any(axis=1)
        longest = edges.of_triangle[np.flatnonzero(sagging), lengths[sagging].argmax(axis=1)]
        chosen = np.union1d(chosen, longest)
        if not len(chosen):
            break
        current = _split(current, edges, chosen)
    return current


def split_triangles(
    surface: PatchSurface, mesh: AdaptiveTriangles, which: np.ndarray
) -> AdaptiveTriangles:
    """Split the longest edges of some triangles, with the triangles on their other sides.

    Parameters
    ----------
    surface : PatchSurface
    mesh : AdaptiveTriangles
    which : (k,) int array
    """
    edges = _Edges(surface, mesh)
    sides = edges.of_triangle[which]
    longest = sides[np.arange(len(which)), edges.length[sides].argmax(axis=1)]
    return _split(mesh, edges, np.unique(longest))


def from_grid(mesh: SurfaceMesh) -> AdaptiveTriangles:
    """A triangulation over parameter grids in this form."""
    return AdaptiveTriangles(
        mesh.vertices, mesh.triangles, mesh.triangle_patch, _corner_parameters(mesh)
    )


def _base(surface: PatchSurface, most: int) -> SurfaceMesh:
    """Triangles over the knots, with three cells a side of a patch at least.

    With fewer, different edges could have the same two ends (two patches that together form a
    tube). Where three cells would be more than ``most`` triangles, one will do if that is not so.
    """
    u, v = _base_lines(surface)
    if 2 * sum((len(a) - 1) * (len(b) - 1) for a, b in zip(u, v, strict=True)) > most:
        mesh = surface.triangulation("knots")
        keys = row_keys(mesh.triangles[:, SIDES].reshape(-1, 2), len(mesh.vertices))
        if (np.unique(keys, return_counts=True)[1] == 2).all():
            return mesh
    return surface.triangulation_at(u, v)


def _base_lines(surface: PatchSurface) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Knots of each patch, cut where they make fewer than three cells a side."""
    lines = []
    for parameters in surface.grid_parameters("knots"):
        cut = [max(1, -(-3 // (len(line) - 1))) for line in parameters]
        lines.append(
            [
                np.append(
                    (line[:-1, None] + np.diff(line)[:, None] * np.arange(c) / c).ravel(), line[-1]
                )
                for line, c in zip(parameters, cut, strict=True)
            ]
        )
    return lines[0], lines[1]


def _corner_parameters(mesh: SurfaceMesh) -> np.ndarray:
    mu, mv = np.array([grid.shape for grid in mesh.grids]).T
    patch, row, column = grid_places(mu - 1, mv - 1)
    # two triangles a cell, one after the other
    corners = np.repeat(grid_quads(mesh.grids), 2, axis=0)
    which = (mesh.triangles[:, :, None] == corners[:, None]).argmax(axis=2)
    i = np.repeat(row, 2)[:, None] + np.array([0, 1, 1, 0])[which]
    j = np.repeat(column, 2)[:, None] + np.array([0, 0, 1, 1])[which]
    first_u, first_v = (np.repeat((np.cumsum(m) - m)[patch], 2)[:, None] for m in (mu, mv))
    u, v = np.concatenate(mesh.grid_u), np.concatenate(mesh.grid_v)
    return np.stack([u[first_u + i], v[first_v + j]], axis=-1)


class _Edges:
    """Edges of the triangles, with the surface point at the middle of each."""

    def __init__(self, surface: PatchSurface, mesh: AdaptiveTriangles) -> None:
        n = len(mesh.vertices)
        keys = row_keys(mesh.triangles[:, SIDES].reshape(-1, 2), n)
        self.keys, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
        self.of_triangle = inverse.reshape(-1, 3)
        pair = np.column_stack([self.keys // n, self.keys % n])
        self.ends = mesh.vertices[pair[:, 0]], mesh.vertices[pair[:, 1]]
        self.length = np.linalg.norm(self.ends[1] - self.ends[0], axis=1)
        triangle, side = np.divmod(first, 3)
        uv = mesh.uv[triangle[:, None], SIDES[side]].mean(axis=1)
        patch = mesh.patch[triangle]
        self.middle = surface.evaluate_at(patch, *uv.T)


def _split(mesh: AdaptiveTriangles, edges: _Edges, chosen: np.ndarray) -> AdaptiveTriangles:
    """Split the chosen edges; of several in one triangle the longest first."""
    n = len(mesh.vertices)
    rank = np.full(len(edges.keys), -1)
    rank[chosen[np.argsort(edges.length[chosen], kind="stable")]] = np.arange(len(chosen))
    new = np.full(len(edges.keys), -1)
    new[chosen] = n + np.arange(len(chosen))
    vertices = np.vstack([mesh.vertices, edges.middle[chosen]])
    triangles, patch, uv, side_of = mesh.triangles, mesh.patch, mesh.uv, edges.of_triangle
    for _ in range(3):
        marks = np.where(side_of >= 0, rank[np.maximum(side_of, 0)], -1)
        cut = np.flatnonzero(marks.max(axis=1) >= 0)
        if not len(cut):
            break
        # turn each triangle so that the edge to split is its first
        turn = (marks[cut].argmax(axis=1)[:, None] + np.arange(3)) % 3
        rows = np.arange(len(cut))[:, None]
        t, p, s = triangles[cut][rows, turn], uv[cut][rows, turn], side_of[cut][rows, turn]
        middle, half = new[s[:, 0]], p[:, :2].mean(axis=1)
        none = np.full(len(cut), -1)
        one = np.column_stack([t[:, 0], middle, t[:, 2]])
        two = np.column_stack([middle, t[:, 1], t[:, 2]])
        keep = np.ones(len(triangles), dtype=bool)
        keep[cut] = False
        triangles = np.vstack([triangles[keep], one, two])
        patch = np.concatenate([patch[keep], patch[cut], patch[cut]])
        uv = np.concatenate(
            [
                uv[keep],
                np.stack([p[:, 0], half, p[:, 2]], axis=1),
                np.stack([half, p[:, 1], p[:, 2]], axis=1),
            ]
        )
        side_of = np.vstack(
            [
                side_of[keep],
                np.column_stack([none, none, s[:, 2]]),
                np.column_stack([none, s[:, 1], none]),
            ]
        )
    return AdaptiveTriangles(vertices, triangles, patch, uv)
