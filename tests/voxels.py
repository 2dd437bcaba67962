# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Random solids of voxels bent by polynomial maps: exact patches, volume and genus of the cells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre
from patches import Body, interpolating_face, make_body, uniform_knots


def _pieces(cells: np.ndarray) -> int:
    """Number of face-connected pieces of a boolean array."""
    todo, count = set(map(tuple, np.argwhere(cells))), 0
    while todo:
        count += 1
        stack = [todo.pop()]
        while stack:
            cell = np.array(stack.pop())
            for axis in range(3):
                for step in (-1, 1):
                    other = cell.copy()
                    other[axis] += step
                    if tuple(other) in todo:
                        todo.remove(tuple(other))
                        stack.append(tuple(other))
    return count


def _is_manifold(cells: np.ndarray) -> bool:
    """Whether solid and outside are connected, and no vertex or edge joins pieces on its own."""
    padded = np.pad(cells, 1)
    if _pieces(padded) != 1 or _pieces(~padded) != 1:
        return False
    for corner in np.ndindex(*(n - 1 for n in padded.shape)):
        around = padded[tuple(slice(c, c + 2) for c in corner)]
        if around.any() and not around.all() and (_pieces(around) > 1 or _pieces(~around) > 1):
            return False
    return True


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


def random_voxels(seed: int, shape: Sequence[int] = (4, 3, 3), share: float = 0.6) -> np.ndarray:
    """Random manifold solid of voxels: cells leave a full block as long as it stays manifold."""
    rng = np.random.default_rng(seed)
    cells = np.ones(shape, dtype=bool)
    target = int(share * cells.size)
    for flat in rng.permutation(cells.size):
        if cells.sum() <= target:
            break
        cell = np.unravel_index(flat, shape)
        cells[cell] = False
        if not _is_manifold(cells):
            cells[cell] = True
    return cells


class PolynomialMap:
    """x + g(x) with a random polynomial g of a given degree in each coordinate.

    The size of g's gradient stays below ``strength`` < 1 on the box, so that the map is one to one
    with a positive determinant.
    """

    def __init__(self, seed: int, degree: int, box: Sequence[float], strength: float) -> None:
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
        """Volume of the image of a box; the quadrature is exact for the polynomial."""
        x, w = legendre.leggauss(3 * self.degree // 2 + 1)
        x, w = 0.5 * (x + 1.0), 0.5 * w
        grid = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
        weight = np.multiply.outer(np.multiply.outer(w, w), w).ravel()
        det = np.linalg.det(self.jacobian(low + grid * (high - low)))
        return float(det @ weight * np.prod(high - low))


def _merged_planes(cells: np.ndarray, axis: int) -> np.ndarray:
    """Grid planes across which the cells differ, the first and last one included."""
    layers = np.moveaxis(cells, axis, 0)
    inner = [k for k in range(1, len(layers)) if np.any(layers[k] != layers[k - 1])]
    return np.array([0, *inner, len(layers)])


def bent_voxels(
    seed: int,
    degree: int = 2,
    *,
    cells: np.ndarray | None = None,
    merge: bool = True,
    spans: int = 1,
    strength: float = 0.4,
    name: str = "",
) -> Body:
    """Voxel solid bent by a random polynomial map; every boundary square is an exact patch.

    Parameters
    ----------
    seed : int
        Of the voxels and of the map.
    degree : int
        Of the map and the patches.
    cells : bool array, optional
        The voxels; random ones by default.
    merge : bool
        Join neighbouring layers of voxels that are equal; a patch then has a span a voxel.
    spans : int
        Spans of a voxel's edge.
    strength : float
        How much the map bends, below 1.
    """
    cells = random_voxels(seed) if cells is None else np.asarray(cells, dtype=bool)
    bend = PolynomialMap(seed, degree, cells.shape, strength)
    planes = [
        _merged_planes(cells, axis) if merge else np.arange(cells.shape[axis] + 1)
        for axis in range(3)
    ]
    coarse = cells[np.ix_(*(p[:-1] for p in planes))]
    padded = np.pad(coarse, 1)
    faces, volume = [], 0.0
    for cell in np.argwhere(coarse):
        low = np.array([planes[k][cell[k]] for k in range(3)], dtype=float)
        high = np.array([planes[k][cell[k] + 1] for k in range(3)], dtype=float)
        volume += bend.volume(low, high)
        for axis in range(3):
            a, b = (k for k in range(3) if k != axis)
            knots = tuple(uniform_knots(degree, int(high[k] - low[k]) * spans) for k in (a, b))
            for end in (0, 1):
                other = cell + 1
                other[axis] += 2 * end - 1
                if padded[tuple(other)]:
                    continue

                def square(u, v, axis=axis, a=a, b=b, end=end, low=low, high=high):
                    x = np.empty(np.broadcast(u, v).shape + (3,))
                    x[..., axis] = high[axis] if end else low[axis]
                    x[..., a] = low[a] + u * (high[a] - low[a])
                    x[..., b] = low[b] + v * (high[b] - low[b])
                    return bend(x)

                faces.append(interpolating_face(square, (degree, degree), knots))
    title = name or f"bent voxels {seed} p{degree}"
    return make_body(title, faces, volume, (voxel_genus(cells),))
