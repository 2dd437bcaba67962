# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The Bézier elements of a shell as small lattices of points, to be drawn and to be cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .bezier import BezierElements, bernstein
from .elements import FACES
from .reached import cells_along
from .section import Section, cut_tets, cut_triangles, heights
from .shell import Shell
from .surface import PatchSurface


@dataclass(frozen=True)
class ShellCells:
    """Points of every Bézier element over a lattice of its own parameters.

    The elements are numbered as in the shell: surface element * layers + layer. The lattice of an
    element runs over (x_1, x_2, w), i.e. v, u of its patch and inward.

    Attributes
    ----------
    points : (ne, s + 1, s + 1, r + 1, 3) array
        mm.
    normals : (ne, s + 1, s + 1, r + 1, 3) array
        Unit normals of the surfaces w = constant, outward; zero where they degenerate.
    vertex : (ns, s + 1, s + 1) int array
        Number of each point over the surface in ``surface.triangulation(s)``, where points on
        sides that patches share are one.
    rim : (ns, 4) bool array
        Whether the sides x_1 = 0, x_1 = 1, x_2 = 0, x_2 = 1 of each surface element lie on the
        boundary of its patch.
    layers : int
    """

    points: np.ndarray
    normals: np.ndarray
    vertex: np.ndarray
    rim: np.ndarray
    layers: int

    @property
    def steps(self) -> tuple[int, int]:
        """Cells of a lattice along the surface and across it, (s, r)."""
        return self.points.shape[1] - 1, self.points.shape[3] - 1

    @property
    def size(self) -> int:
        """Points of one lattice."""
        return int(np.prod(self.points.shape[1:4]))

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def flat(self) -> np.ndarray:
        """All points one after the other, (ne * size, 3)."""
        return self.points.reshape(-1, 3)

    def of_layers(self, first: int, last: int) -> np.ndarray:
        """Numbers of the elements in layers first, ..., last (0 is the outermost)."""
        number = np.arange(len(self))
        layer = number % self.layers
        return number[(layer >= first) & (layer <= last)]

    def _index(self) -> np.ndarray:
        return np.arange(self.size).reshape(self.points.shape[1:4])

    def triangles(self, sides: Sequence[int]) -> np.ndarray:
        """Triangles of sides of one lattice, outward, as indices of its points, (m, 3).

        Parameters
        ----------
        sides : sequence of int
            0, 1: the ends of x_1; 2, 3: of x_2; 4, 5: of w, 4 is the outer one.
        """
        index = self._index()
        found = []
        for side in sides:
            axis, end = divmod(side, 2)
            plane = np.take(index, -end, axis=axis)
            # first x second axis of the plane shall point out: (1, 2), (2, 0), (0, 1) at far ends
            found.append(_quads(plane if (axis == 1) != bool(end) else plane.T))
        return np.concatenate(found)

    def rims(self, sides: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Rims of sides of one lattice, as indices of its points.

        Returns
        -------
        along : (m, s + 1) int array
        across : (k, r + 1) int array
            Those that run inward.
        """
        index = self._index()
        along, across = [], []
        for side in sides:
            axis, end = divmod(side, 2)
            plane = np.take(index, -end, axis=axis)
            along += [plane[:, 0], plane[:, -1]]
            (along if axis == 2 else across).extend([plane[0], plane[-1]])
        short = np.unique(across, axis=0) if across else np.zeros((0, index.shape[2]), dtype=int)
        return np.unique(along, axis=0), short

    @cached_property
    def _tets(self) -> np.ndarray:
        """Six tetrahedra to a cell of a lattice, all around its main diagonal."""
        index = self._index()
        n = index.shape
        corner = {
            (i, j, k): index[i : n[0] - 1 + i, j : n[1] - 1 + j, k : n[2] - 1 + k].ravel()
            for i in (0, 1)
            for j in (0, 1)
            for k in (0, 1)
        }
        found = []
        for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
            place = np.zeros(3, dtype=int)
            path = [corner[0, 0, 0]]
            for axis in order:
                place[axis] = 1
                path.append(corner[tuple(place)])
            found.append(np.stack(path, axis=-1))
        return np.concatenate(found)

    @cached_property
    def _extent(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner of the box around each lattice."""
        points = self.points.reshape(len(self), -1, 3)
        return points.min(axis=1), points.max(axis=1)

    def section(
        self, elements: np.ndarray, normal: np.ndarray, distance: float
    ) -> tuple[Section, Section]:
        """Where a plane cuts elements.

        Parameters
        ----------
        elements : (k,) int array
        normal : (3,) array
        distance : float
            The plane is ``normal . x = distance``.

        Returns
        -------
        cut, rims : Section
            Triangles of the section, and lines along the boundaries of the elements; ``owner`` is
            the element's number, ``ends`` are places in :attr:`flat`.
        """
        normal = np.asarray(normal, dtype=float)
        low, high = (box[elements] for box in self._extent)
        lowest = np.where(normal > 0.0, low, high) @ normal
        highest = np.where(normal > 0.0, high, low) @ normal
        met = elements[(lowest <= distance) & (highest >= distance)]
        points = self.points[met].reshape(-1, 3)
        height = heights(points, normal, distance)
        place = (met[:, None] * self.size + np.arange(self.size)).ravel()
        cut = self._cut(cut_tets, points, self._tets, height, met, place)
        faces = self.triangles(range(6))
        return cut, self._cut(cut_triangles, points, faces, height, met, place)

    def _cut(self, cut, points, template, height, met, place) -> Section:
        parts = (np.arange(len(met))[:, None, None] * self.size + template).reshape(
            -1, template.shape[1]
        )
        found = cut(points, parts, height)
        return replace(found, ends=place[found.ends], owner=met[found.owner // len(template)])


def shell_cells(shell: Shell, batches: Sequence[BezierElements] | None = None) -> ShellCells:
    """Lattices of all Bézier elements of a shell.

    Parameters
    ----------
    shell : Shell
    batches : sequence of BezierElements, optional
        The shell's elements, where they are at hand.
    """
    batches = shell.bezier_elements() if batches is None else batches
    along, across = cells_along(shell.surface), 2 if shell.degree_w > 1 else 1
    t, w = np.linspace(0.0, 1.0, along + 1), np.linspace(0.0, 1.0, across + 1)
    shape = (shell.element_count, along + 1, along + 1, across + 1, 3)
    found, normals = np.empty(shape), np.empty(shape)
    for batch in batches:
        found[batch.element], normals[batch.element] = _evaluate(batch, t, w)
    rim = np.empty((shell.surface.element_count, 4), dtype=bool)
    for group in shell.surface.groups:
        (low_u, low_v), (high_u, high_v) = group.low.T, group.high.T
        ends = (low_v <= 0.0, high_v >= 1.0, low_u <= 0.0, high_u >= 1.0)
        rim[group.element] = np.stack(ends, axis=1)
    return ShellCells(found, normals, _vertices(shell.surface, along), rim, shell.layer_count)


def _vertices(surface: PatchSurface, along: int) -> np.ndarray:
    """Numbers of lattice points in a triangulation of the surface, (ns, along + 1, along + 1)."""
    u, v = surface.grid_parameters(along)
    grids, _ = surface.shared_grid([(len(a), len(b)) for a, b in zip(u, v, strict=True)])
    step = np.arange(along + 1)
    found = []
    for grid in grids:
        i = np.arange(0, len(grid) - 1, along)[:, None, None, None] + step
        j = np.arange(0, grid.shape[1] - 1, along)[None, :, None, None] + step[:, None]
        # elements run over u then v, their lattices over v then u
        found.append(grid[i, j].reshape(-1, along + 1, along + 1))
    return np.concatenate(found)


def _evaluate(batch: BezierElements, t: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    values = [bernstein(d, x) for d, x in zip(batch.degrees, (t, t, w), strict=True)]
    slopes = [bernstein(d, x, 1) for d, x in zip(batch.degrees, (t, t, w), strict=True)]
    points = batch.control_points
    if batch.weights is not None:
        weight = batch.weights[..., None]
        points = np.concatenate([points * weight, weight], axis=-1)

    def at(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        half = np.einsum("ai,eijkd->eajkd", first, points)
        half = np.einsum("bj,eajkd->eabkd", second, half)
        return np.einsum("ck,eabkd->eabcd", values[2], half)

    x, x_1, x_2 = at(values[0], values[1]), at(slopes[0], values[1]), at(values[0], slopes[1])
    if batch.weights is not None:
        x, weight = x[..., :3] / x[..., 3:], x[..., 3:]
        x_1, x_2 = ((d[..., :3] - x * d[..., 3:]) / weight for d in (x_1, x_2))
    # right-handed with w inward: x_1 x x_2 points inward
    normal = np.cross(x_2, x_1)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return x, normal / np.where(length > 0.0, length, 1.0)


def _quads(plane: np.ndarray) -> np.ndarray:
    """Triangles over a grid of indices; their normals are first axis x second axis."""
    a, b, c, d = plane[:-1, :-1], plane[1:, :-1], plane[1:, 1:], plane[:-1, 1:]
    return np.concatenate(
        [np.stack([p.ravel() for p in t], axis=-1) for t in ((a, b, c), (a, c, d))]
    )


# a tetrahedron of ten nodes as eight of four: the corners, and the octahedron around 4-9
_SMALL_TETS = np.array(
    [(0, 4, 6, 7), (1, 5, 4, 8), (2, 6, 5, 9), (3, 7, 9, 8)]
    + [(4, 9, 5, 6), (4, 9, 6, 7), (4, 9, 7, 8), (4, 9, 8, 5)]
)
_SMALL_TRIANGLES = np.array([(0, 3, 5), (1, 4, 3), (2, 5, 4), (3, 4, 5)])


class CoreCells:
    """The tetrahedra of the core, to be drawn and to be cut.

    Parameters
    ----------
    nodes : (n, 3) array
        mm.
    tets : (m, 4 or 10) int array
        In the order of :mod:`.elements`; quadratic ones are taken as eight linear ones each.
    interface : (k, 3 or 6) int array
        Triangles of the boundary.

    Attributes
    ----------
    nodes : (n, 3) array
    tets : (m, 4 or 10) int array
    triangles : (t, 3) int array
        Of the boundary.
    edges : (e, 2 or 3) int array
        Sides of the boundary's triangles, with their mid nodes.
    """

    def __init__(self, nodes: np.ndarray, tets: np.ndarray, interface: np.ndarray) -> None:
        self.nodes, self.tets = nodes, tets
        quadratic = tets.shape[1] == 10
        self._small = _SMALL_TETS if quadratic else np.arange(4)[None]
        faces = np.array(FACES["tet10" if quadratic else "tet4"])
        self._faces = self._split(faces)
        self.triangles = self._split(interface)
        sides = [(0, 3, 1), (1, 4, 2), (2, 5, 0)] if quadratic else [(0, 1), (1, 2), (2, 0)]
        edges = interface[:, sides].reshape(-1, len(sides[0]))
        ends = np.sort(edges[:, [0, -1]], axis=1)
        self.edges = edges[np.unique(ends, axis=0, return_index=True)[1]]

    @staticmethod
    def _split(triangles: np.ndarray) -> np.ndarray:
        small = _SMALL_TRIANGLES if triangles.shape[1] == 6 else np.arange(3)[None]
        return triangles[:, small].reshape(-1, 3)

    def section(self, normal: np.ndarray, distance: float) -> tuple[Section, Section]:
        """Where a plane cuts the tetrahedra.

        Returns
        -------
        cut, rims : Section
            Triangles of the section, and lines along the sides of the tetrahedra; ``owner`` is the
            tetrahedron's number.
        """
        height = heights(self.nodes, normal, distance)
        above = height[self.tets] >= 0.0
        met = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
        found = []
        for cut, template in ((cut_tets, self._small), (cut_triangles, self._faces)):
            parts = self.tets[met][:, template].reshape(-1, template.shape[1])
            one = cut(self.nodes, parts, height)
            found.append(replace(one, owner=met[one.owner // len(template)]))
        return found[0], found[1]
