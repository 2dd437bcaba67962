# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Solids of voxels bent by smooth maps, as untrimmed NURBS faces.

The map is interpolated by one trivariate spline over the whole grid, continuous across the planes
where patches meet. Its control points are a lattice, and faces are slices of it: neighbours share
the bits of their common sides. The body is the image of the spline, so its volume is the integral
of the spline's Jacobian determinant over the voxels, without any surface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.polynomial import legendre
from scipy import ndimage
from scipy.interpolate import BSpline

from HybridVolume.core.surface import SplineFace

# ---------------------------------------------------------------------------- cells and topology


@cache
def _corner_tables() -> tuple[np.ndarray, np.ndarray]:
    """For the 256 ways to fill the eight voxels at a vertex: manifold, and facing one way."""
    manifold, one_way = np.ones(256, dtype=bool), np.ones(256, dtype=bool)
    for code in range(256):
        around = (code >> np.arange(8) & 1).astype(bool).reshape(2, 2, 2)
        if around.any() and not around.all():
            manifold[code] = all(ndimage.label(part)[1] == 1 for part in (around, ~around))
        for axis in range(3):
            low, high = np.moveaxis(around, axis, 0)
            one_way[code] &= not ((low & ~high).any() and (high & ~low).any())
    return manifold, one_way


def _corner_codes(cells: np.ndarray) -> np.ndarray:
    """Which of its eight voxels are solid, for every vertex of the grid."""
    padded = np.pad(cells, 1).astype(int)
    a, b, c = (n - 1 for n in padded.shape)
    return sum(
        padded[i : i + a, j : j + b, k : k + c] << (4 * i + 2 * j + k)
        for i, j, k in np.ndindex(2, 2, 2)
    )


def is_manifold(cells: np.ndarray) -> bool:
    """Whether solid and outside are connected by faces, at every vertex as well."""
    if not _corner_tables()[0][_corner_codes(cells)].all():
        return False
    padded = np.pad(cells, 1)
    return all(ndimage.label(part)[1] == 1 for part in (padded, ~padded))


def faces_one_way(cells: np.ndarray) -> bool:
    """Whether at no vertex two faces look in opposite directions.

    Where they do, no direction is inward for both, bent or not, and no straight column can start
    there: such a body is refused by the check of the surface. A face's normal is turned by the
    map's derivative at the vertex, the same for all faces there, so opposite stays opposite.
    """
    return bool(_corner_tables()[1][_corner_codes(cells)].all())


def voxel_genus(cells: np.ndarray) -> int:
    """Genus of a solid of voxels without cavities, from the Euler number of its cells."""
    padded = np.pad(cells, 1)
    euler = 0
    for kind in np.ndindex(2, 2, 2):
        # kind: along which axes the cell of the complex extends
        present = padded
        for axis in range(3):
            if not kind[axis]:
                low = [slice(None)] * 3
                high = [slice(None)] * 3
                low[axis], high[axis] = slice(None, -1), slice(1, None)
                present = present[tuple(low)] | present[tuple(high)]
        euler += (-1) ** sum(kind) * int(present.sum())
    # a solid's boundary has twice its Euler number
    return 1 - euler


def random_voxels(
    seed: int | np.random.Generator, shape: Sequence[int] = (4, 3, 3), share: float = 0.6
) -> np.ndarray:
    """Random manifold solid of voxels: cells leave a full block as long as it stays manifold."""
    rng = np.random.default_rng(seed)
    cells = np.ones(shape, dtype=bool)
    target = int(share * cells.size)
    for flat in rng.permutation(cells.size):
        if cells.sum() <= target:
            break
        cell = np.unravel_index(flat, shape)
        cells[cell] = False
        if not is_manifold(cells):
            cells[cell] = True
    return cells


# ------------------------------------------------------------------------------ splines over it


def uniform_knots(degree: int, spans: int) -> np.ndarray:
    """Clamped uniform knots on [0, 1]."""
    return clamped(degree, np.arange(spans + 1) / spans)


def clamped(degree: int, breaks: np.ndarray) -> np.ndarray:
    """Clamped knots with simple inner knots at given places."""
    return np.concatenate([np.repeat(breaks[0], degree), breaks, np.repeat(breaks[-1], degree)])


def greville(degree: int, knots: np.ndarray) -> np.ndarray:
    """Means of ``degree`` consecutive knots."""
    count = len(knots) - degree - 1
    points = np.array([knots[i + 1 : i + degree + 1].sum() / degree for i in range(count)])
    points[[0, -1]] = knots[[0, -1]]
    return points


@dataclass(frozen=True)
class Line:
    """One direction of the grid: pieces between planes, each a clamped spline on [0, 1].

    Attributes
    ----------
    planes : (m + 1,) array
        Where patches meet.
    degree : int
    knots : tuple of arrays
        Of each piece, on [0, 1].
    """

    planes: np.ndarray
    degree: int
    knots: tuple[np.ndarray, ...]

    @cached_property
    def start(self) -> np.ndarray:
        """First control point of each piece, and the last one of all, (m + 1,)."""
        sizes = [len(knots) - self.degree - 2 for knots in self.knots]
        return np.concatenate([[0], np.cumsum(sizes)])

    @cached_property
    def nodes(self) -> np.ndarray:
        """Greville abscissae of all control points in the grid's coordinate."""
        low, high = self.planes[:-1], self.planes[1:]
        pieces = [
            a + greville(self.degree, t)[:-1] * (b - a)
            for a, b, t in zip(low, high, self.knots, strict=True)
        ]
        return np.concatenate([*pieces, self.planes[-1:]])

    @cached_property
    def interpolation(self) -> np.ndarray:
        """Matrix from values at the nodes to control points, (n, n); ends of pieces are kept."""
        matrix = np.zeros((self.start[-1] + 1,) * 2)
        for first, last, knots in zip(self.start, self.start[1:], self.knots, strict=False):
            at = greville(self.degree, knots)
            rows = np.linalg.inv(BSpline.design_matrix(at, knots, self.degree).toarray())
            rows[[0, -1]] = np.eye(len(at))[[0, -1]]
            matrix[first : last + 1, first : last + 1] = rows
        return matrix

    def sampled(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Basis at places of every knot span.

        Parameters
        ----------
        x : (k,) array
            Places in a span, in [0, 1].

        Returns
        -------
        values, derivatives : (spans * k, n) arrays
            Derivatives are by the grid's coordinate.
        length : (spans,) array
            Of each span.
        piece : (spans,) int array
        """
        inside = 1e-14 + np.asarray(x) * (1.0 - 2e-14)
        values, derivatives, length, piece = [], [], [], []
        for number, knots in enumerate(self.knots):
            breaks = np.unique(knots)
            scale = self.planes[number + 1] - self.planes[number]
            at = (breaks[:-1, None] + np.diff(breaks)[:, None] * inside).ravel()
            full = np.zeros((len(at), self.start[-1] + 1))
            slope = np.zeros_like(full)
            span = slice(self.start[number], self.start[number + 1] + 1)
            spline = BSpline(knots, np.eye(len(knots) - self.degree - 1), self.degree)
            full[:, span], slope[:, span] = spline(at), spline(at, 1) / scale
            values.append(full)
            derivatives.append(slope)
            length.append(np.diff(breaks) * scale)
            piece.append(np.full(len(breaks) - 1, number))
        return tuple(np.concatenate(part) for part in (values, derivatives, length, piece))


def grid_line(
    cells: np.ndarray, axis: int, planes: np.ndarray, degree: int, spans: int, merge: bool = True
) -> Line:
    """Pieces of one direction of a voxel grid.

    Parameters
    ----------
    cells : bool array
    axis : int
    planes : (n + 1,) array
        Coordinates of all planes of the grid.
    degree : int
    spans : int
        Knot spans of a voxel's edge.
    merge : bool
        Join neighbouring layers of voxels that are equal into one piece.
    """
    layers = np.moveaxis(cells, axis, 0)
    met = [0, *(k for k in range(1, len(layers)) if (layers[k] != layers[k - 1]).any())]
    met = np.array([*met, len(layers)]) if merge else np.arange(len(layers) + 1)
    share = np.arange(spans) / spans
    knots = []
    for low, high in zip(met, met[1:], strict=False):
        inner = planes[low:high, None] + np.diff(planes[low : high + 1])[:, None] * share
        breaks = (np.append(inner, planes[high]) - planes[low]) / (planes[high] - planes[low])
        knots.append(clamped(degree, breaks))
    return Line(planes[met], degree, tuple(knots))


@dataclass(frozen=True)
class BentGrid:
    """A solid of cells under a trivariate spline.

    Attributes
    ----------
    cells : bool array
        The pieces of the three lines that are solid.
    lines : (Line, Line, Line)
    lattice : (n0, n1, n2, 4) array
        Homogeneous control points (wx, wy, wz, w), mm.
    """

    cells: np.ndarray
    lines: tuple[Line, Line, Line]
    lattice: np.ndarray

    def faces(self) -> tuple[SplineFace, ...]:
        """A face for every side of a solid cell that meets no other."""
        padded = np.pad(self.cells, 1)
        weights = self.lattice[..., 3]
        points = self.lattice[..., :3] / weights[..., None]
        found: list[SplineFace] = []
        for cell in np.argwhere(self.cells):
            for axis in range(3):
                a, b = (k for k in range(3) if k != axis)
                for end in (0, 1):
                    other = cell + 1
                    other[axis] += 2 * end - 1
                    if padded[tuple(other)]:
                        continue
                    part: list[slice | int] = [
                        slice(line.start[c], line.start[c + 1] + 1)
                        for line, c in zip(self.lines, cell, strict=True)
                    ]
                    part[axis] = int(self.lines[axis].start[cell[axis] + end])
                    found.append(
                        SplineFace(
                            f"Face{len(found) + 1}",
                            (self.lines[a].degree, self.lines[b].degree),
                            (self.lines[a].knots[cell[a]], self.lines[b].knots[cell[b]]),
                            points[tuple(part)].copy(),
                            weights[tuple(part)].copy(),
                        )
                    )
        return tuple(found)

    def sampled(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Points and derivatives on a tensor grid in every knot span of the solid.

        Parameters
        ----------
        x : (k,) array
            Places in a span, in [0, 1].

        Returns
        -------
        points : (m, k³, 3) array
            mm.
        jacobian : (m, k³, 3, 3) array
            Columns are the derivatives by the grid's coordinates.
        size : (m,) array
            Volume of each span in the grid.
        cell : (m, 3) int array
            Solid cell of each span.
        """
        parts = [line.sampled(x) for line in self.lines]
        k = len(x)

        def evaluated(slope: int) -> np.ndarray:
            result = self.lattice
            for axis in range(3):
                matrix = parts[axis][1 if axis == slope else 0]
                result = np.moveaxis(np.tensordot(matrix, result, ([1], [axis])), 0, axis)
            shape = [len(part[2]) for part in parts]
            result = result.reshape(shape[0], k, shape[1], k, shape[2], k, 4)
            return result.transpose(0, 2, 4, 1, 3, 5, 6).reshape(-1, k**3, 4)

        pieces = np.stack(np.meshgrid(*(part[3] for part in parts), indexing="ij"), axis=-1)
        solid = self.cells[tuple(np.moveaxis(pieces, -1, 0))].ravel()
        value = evaluated(-1)[solid]
        points, weight = value[..., :3] / value[..., 3:], value[..., 3:]
        columns = []
        for axis in range(3):
            slope = evaluated(axis)[solid]
            columns.append((slope[..., :3] - points * slope[..., 3:]) / weight)
        sizes = np.multiply.outer(np.multiply.outer(parts[0][2], parts[1][2]), parts[2][2])
        return (
            points,
            np.stack(columns, axis=-1),
            sizes.ravel()[solid],
            pieces.reshape(-1, 3)[solid],
        )

    def volume(self) -> float:
        """Volume, mm³: the determinant integrated over the cells, exactly for polynomials."""
        degree = max(line.degree for line in self.lines)
        rational = np.ptp(self.lattice[..., 3]) > 0.0
        x, weight = legendre.leggauss(14 if rational else 3 * degree // 2 + 1)
        _, jacobian, size, _ = self.sampled(0.5 * (x + 1.0))
        weight = 0.5 * weight
        cube = np.multiply.outer(np.multiply.outer(weight, weight), weight).ravel()
        return float((np.linalg.det(jacobian) @ cube) @ size)

    def worst_shape(self) -> float:
        """Smallest det J over the lengths of its columns, 5³ places a span: 1 is a right angle."""
        _, jacobian, _, _ = self.sampled(np.linspace(0.0, 1.0, 5))
        lengths = np.linalg.norm(jacobian, axis=2).prod(axis=2)
        return float((np.linalg.det(jacobian) / lengths).min())


def bent_grid(
    cells: np.ndarray,
    bend: Callable[[np.ndarray], np.ndarray],
    *,
    planes: Sequence[np.ndarray] | None = None,
    degrees: Sequence[int] = (2, 2, 2),
    spans: Sequence[int] = (1, 1, 1),
    merge: bool = True,
) -> BentGrid:
    """A solid of voxels under the spline that interpolates a map.

    Parameters
    ----------
    cells : bool array
    bend : callable
        Takes (..., 3) points of the grid, returns (..., 3) points in mm or (..., 4) homogeneous
        ones. Exact where the map lies in the spline space.
    planes : three arrays, optional
        Coordinates of the grid's planes; 0, 1, 2, ... by default.
    degrees, spans : three int
        Degree, and knot spans of a voxel's edge, in each direction.
    merge : bool
        Join neighbouring layers of voxels that are equal; a patch then has spans of each.
    """
    cells = np.asarray(cells, dtype=bool)
    if planes is None:
        planes = [np.arange(n + 1.0) for n in cells.shape]
    planes = [np.asarray(p, dtype=float) for p in planes]
    lines = tuple(
        grid_line(cells, axis, planes[axis], degrees[axis], spans[axis], merge) for axis in range(3)
    )
    nodes = np.stack(np.meshgrid(*(line.nodes for line in lines), indexing="ij"), axis=-1)
    values = np.asarray(bend(nodes), dtype=float)
    if values.shape[-1] == 3:
        values = np.concatenate([values, np.ones((*values.shape[:-1], 1))], axis=-1)
    for axis, line in enumerate(lines):
        values = np.moveaxis(np.tensordot(line.interpolation, values, ([1], [axis])), 0, axis)
    if np.ptp(values[..., 3]) <= 1e-14:
        values[..., 3] = 1.0
    first = [
        np.searchsorted(p, line.planes[:-1], side="left")
        for p, line in zip(planes, lines, strict=True)
    ]
    return BentGrid(cells[np.ix_(*first)], lines, values)


class PolynomialMap:
    """x + g(x) with a random polynomial g of a given degree in each coordinate.

    The size of g's gradient stays below ``strength`` < 1 on the box, so that the map is one to one
    with a positive determinant.
    """

    def __init__(
        self,
        seed: int | np.random.Generator,
        degree: int,
        box: Sequence[float],
        strength: float,
    ) -> None:
        rng = np.random.default_rng(seed)
        self.box = np.asarray(box, dtype=float)
        self.degree = degree
        powers = np.add.outer(np.add.outer(*[np.arange(degree + 1)] * 2), np.arange(degree + 1))
        self.c = rng.normal(size=(3,) + (degree + 1,) * 3) / (1.0 + powers) ** 2
        line = np.linspace(0.0, 1.0, 15)
        grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
        gradient = self.jacobian(grid * self.box) - np.eye(3)
        self.c *= strength / np.linalg.norm(gradient, ord=2, axis=(1, 2)).max()

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Images of (..., 3) points."""
        t = 2.0 * np.asarray(x) / self.box - 1.0
        g = [legendre.legval3d(t[..., 0], t[..., 1], t[..., 2], c) for c in self.c]
        return x + np.stack(g, axis=-1)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Derivatives at (m, 3) points, (m, 3, 3)."""
        t = 2.0 * x / self.box - 1.0
        result = np.tile(np.eye(3), (len(x), 1, 1))
        for row in range(3):
            for axis in range(3):
                derivative = legendre.legder(self.c[row], axis=axis)
                result[:, row, axis] += (
                    legendre.legval3d(t[:, 0], t[:, 1], t[:, 2], derivative) * 2.0 / self.box[axis]
                )
        return result

    def volume(self, low: np.ndarray, high: np.ndarray) -> float:
        """Volume of the image of a box, mm³; the quadrature is exact for the polynomial."""
        x, w = legendre.leggauss(3 * self.degree // 2 + 1)
        x, w = 0.5 * (x + 1.0), 0.5 * w
        grid = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
        weight = np.multiply.outer(np.multiply.outer(w, w), w).ravel()
        det = np.linalg.det(self.jacobian(low + grid * (high - low)))
        return float(det @ weight * np.prod(high - low))
