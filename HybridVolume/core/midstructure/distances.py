# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Distances to the NURBS surface itself, and on which side of it a point lies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ..bezier import bernstein
from ..intersection import points_inside
from ..surface import PatchSurface, SurfaceMesh

# Samples that start the search for feet.
SAMPLES = 50_000
# Triangles that tell inside from outside.
TRIANGLES = 16_000
# Points that are worked on at once.
_CHUNK = 20_000


@dataclass(frozen=True)
class Feet:
    """Nearest points of the surface.

    Attributes
    ----------
    distance : (n,) array
        mm, not signed.
    points : (n, 3) array
        mm.
    patch : (n,) int array
    uv : (n, 2) array
        Parameters of the patch, in [0, 1].
    sample : (n,) int array
        The nearest sample that the search started from.
    """

    distance: np.ndarray
    points: np.ndarray
    patch: np.ndarray
    uv: np.ndarray
    sample: np.ndarray


@dataclass(frozen=True)
class _Bezier:
    """Bézier elements of one degree pair: homogeneous control points (ne, p + 1, q + 1, 4)."""

    degrees: tuple[int, int]
    points: np.ndarray
    patch: np.ndarray
    low: np.ndarray
    size: np.ndarray

    def derivatives(self, element: np.ndarray, uv: np.ndarray) -> list[np.ndarray]:
        """x, x_u, x_v, x_uu, x_uv, x_vv at one parameter pair of each element, six (n, 3)."""
        points = self.points[element]
        u = [bernstein(self.degrees[0], uv[:, 0], k) for k in range(3)]
        v = [bernstein(self.degrees[1], uv[:, 1], k) for k in range(3)]
        along = [np.einsum("na,nabd->nbd", b, points) for b in u]

        def homogeneous(i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
            value = np.einsum("nb,nbd->nd", v[j], along[i])
            return value[:, :3], value[:, 3:]

        a, w = homogeneous(0, 0)
        x = a / w
        a_u, w_u = homogeneous(1, 0)
        a_v, w_v = homogeneous(0, 1)
        x_u, x_v = (a_u - w_u * x) / w, (a_v - w_v * x) / w
        a_uu, w_uu = homogeneous(2, 0)
        a_uv, w_uv = homogeneous(1, 1)
        a_vv, w_vv = homogeneous(0, 2)
        return [
            x,
            x_u,
            x_v,
            (a_uu - 2.0 * w_u * x_u - w_uu * x) / w,
            (a_uv - w_u * x_v - w_v * x_u - w_uv * x) / w,
            (a_vv - 2.0 * w_v * x_v - w_vv * x) / w,
        ]


class SurfaceDistance:
    """The distance to a surface: nearest samples first, then Newton steps on Bézier elements.

    Parameters
    ----------
    surface : PatchSurface
    samples : int
        About how many samples start the search.

    Attributes
    ----------
    samples : (s, 3) array
        Points of the surface, mm.
    normals : (s, 3) array
        Unit normals out of the material; zero where the surface is singular.
    area : (s,) array
        Share of the surface that each sample stands for, mm².
    spacing : float
        Largest distance of neighbouring samples, mm, about.
    """

    def __init__(self, surface: PatchSurface, samples: int = SAMPLES) -> None:
        self.surface = surface
        # far from the origin digits would be lost
        self.origin = 0.5 * (
            surface.control_points.min(axis=0) + surface.control_points.max(axis=0)
        )
        points = surface.control_points - self.origin
        self._groups = []
        for group in surface.groups:
            weights = group.weights
            values = np.concatenate(
                [points[group.index] * weights[..., None], weights[..., None]], axis=-1
            )
            self._groups.append(
                _Bezier(
                    group.degrees,
                    group.bezier(values),
                    group.patch,
                    group.low,
                    group.high - group.low,
                )
            )
        self._draw(samples)
        self._tree = cKDTree(self._points)

    def _draw(self, count: int) -> None:
        lengths = []
        for group in self._groups:
            x = group.points[..., :3] / group.points[..., 3:]
            lengths.append(
                np.column_stack(
                    [
                        np.linalg.norm(np.diff(x, axis=1), axis=-1).sum(axis=1).max(axis=1),
                        np.linalg.norm(np.diff(x, axis=2), axis=-1).sum(axis=2).max(axis=1),
                    ]
                )
            )
        total = sum(float(size.prod(axis=1).sum()) for size in lengths)
        step = self.spacing = (total / count) ** 0.5
        rows = []
        for number, (group, length) in enumerate(zip(self._groups, lengths, strict=True)):
            cells = np.clip(np.ceil(length / step), 3, 1000).astype(int)
            each = cells.prod(axis=1)
            element = np.repeat(np.arange(len(each)), each)
            place = np.arange(len(element)) - np.repeat(np.cumsum(each) - each, each)
            across = cells[element, 1]
            uv = (np.column_stack([place // across, place % across]) + 0.5) / cells[element]
            for part in np.array_split(np.arange(len(element)), -(-len(element) // _CHUNK)):
                x, x_u, x_v = group.derivatives(element[part], uv[part])[:3]
                normal = np.cross(x_u, x_v)
                length_n = np.linalg.norm(normal, axis=1)
                area = length_n / each[element[part]]
                normal /= np.maximum(length_n, np.finfo(float).tiny)[:, None]
                rows.append((x, normal, area, np.full(len(part), number), element[part], uv[part]))
        columns = [np.concatenate(column) for column in zip(*rows, strict=True)]
        self._points, self.normals, self.area, self._group, self._element, self._uv = columns
        start = np.cumsum([0] + [len(group.patch) for group in self._groups])
        self._number = self._element + start[self._group]

    @property
    def samples(self) -> np.ndarray:
        """Points of the surface, (s, 3), mm."""
        return self._points + self.origin

    @cached_property
    def sample_patch(self) -> np.ndarray:
        """Patch of each sample, (s,)."""
        return self._places(self._group, self._element, self._uv)[0]

    @cached_property
    def sample_uv(self) -> np.ndarray:
        """Parameters of each sample on its patch, (s, 2), in [0, 1]."""
        return self._places(self._group, self._element, self._uv)[1]

    def _places(
        self, of_group: np.ndarray, element: np.ndarray, uv: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Patch and its parameters, from parameters of elements."""
        patch, place = np.empty(len(element), dtype=int), uv.copy()
        for number, group in enumerate(self._groups):
            mine = np.flatnonzero(of_group == number)
            which = element[mine]
            patch[mine] = group.patch[which]
            place[mine] = group.low[which] + group.size[which] * uv[mine]
        return patch, np.clip(place, 0.0, 1.0)

    @cached_property
    def mesh(self) -> SurfaceMesh:
        """The triangles that tell inside from outside."""
        cells = np.sqrt(0.5 * TRIANGLES / self.surface.element_count)
        return self.surface.triangulation(int(np.clip(cells, 2, 40)))

    def rough(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance to the nearest sample, (n,), mm, and its number."""
        return self._tree.query(np.asarray(points, dtype=float) - self.origin)

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Which points lie inside the body, (n,) bool; next to the surface it may be either."""
        mesh = self.mesh
        return points_inside(
            mesh.vertices - self.origin,
            mesh.triangles,
            np.asarray(points, dtype=float) - self.origin,
        )

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Distance of (n, 3) points to the surface, (n,), mm, not signed."""
        return self.nearest(points).distance

    def nearest(self, points: np.ndarray, candidates: int = 3) -> Feet:
        """The feet of points on the surface.

        Parameters
        ----------
        points : (n, 3) array
            mm.
        candidates : int
            Elements that are searched for each point.

        Returns
        -------
        Feet
        """
        points = np.asarray(points, dtype=float).reshape(-1, 3) - self.origin
        if not len(points):
            none = np.zeros(0, dtype=int)
            return Feet(np.zeros(0), points, none, np.zeros((0, 2)), none)
        parts = [
            self._nearest(points[k : k + _CHUNK], candidates) for k in range(0, len(points), _CHUNK)
        ]
        distance, x, patch, uv, sample = (
            np.concatenate(column) for column in zip(*parts, strict=True)
        )
        return Feet(distance, x + self.origin, patch, uv, sample)

    def _nearest(self, points: np.ndarray, candidates: int) -> tuple[np.ndarray, ...]:
        n = len(points)
        near = min(3 * candidates, len(self._points))
        far, index = self._tree.query(points, k=near)
        far, index = far.reshape(n, -1), index.reshape(n, -1)
        element = self._number[index]
        first = np.ones(index.shape, dtype=bool)
        for column in range(1, index.shape[1]):
            first[:, column] = (element[:, :column] != element[:, column : column + 1]).all(axis=1)
        first &= np.cumsum(first, axis=1) <= candidates
        row, column = np.nonzero(first)
        start = index[row, column]
        square = np.empty(len(row))
        foot = np.empty((len(row), 3))
        uv = np.empty((len(row), 2))
        for number, group in enumerate(self._groups):
            mine = np.flatnonzero(self._group[start] == number)
            if len(mine):
                pick = start[mine]
                uv[mine], foot[mine], square[mine] = _project(
                    group, self._element[pick], self._uv[pick], points[row[mine]]
                )
        order = np.lexsort([square, row])
        best = order[np.unique(row[order], return_index=True)[1]]
        chosen = start[best]
        patch, place = self._places(self._group[chosen], self._element[chosen], uv[best])
        return np.sqrt(square[best]), foot[best], patch, place, index[:, 0]


def _project(
    group: _Bezier, element: np.ndarray, uv: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Newton's method for the nearest point of each element, kept in the unit square.

    Returns
    -------
    uv : (n, 2) array
    x : (n, 3) array
    square : (n,) array
        Squared distance.
    """
    uv = uv.copy()
    best_uv = uv.copy()
    square = np.full(len(uv), np.inf)
    foot = np.empty_like(points)
    step = np.zeros_like(uv)
    active = np.arange(len(uv))
    for _ in range(12):
        x, x_u, x_v, x_uu, x_uv, x_vv = group.derivatives(element[active], uv[active])
        apart = x - points[active]
        value = np.einsum("ni,ni->n", apart, apart)
        better = value < square[active]
        gain = np.where(better, square[active] - value, 0.0)
        # a step that leads up is halved and tried again from where it began
        failed = active[~better]
        step[failed] *= 0.3
        good = np.flatnonzero(better)
        moved = active[good]
        square[moved], foot[moved], best_uv[moved] = value[good], x[good], uv[moved]
        a, b, c = (
            np.einsum("ni,ni->n", p[good], q[good]) for p, q in ((x_u, x_u), (x_u, x_v), (x_v, x_v))
        )
        r = apart[good]
        full = [
            m + np.einsum("ni,ni->n", r, second[good])
            for m, second in ((a, x_uu), (b, x_uv), (c, x_vv))
        ]
        gradient = np.column_stack(
            [np.einsum("ni,ni->n", r, x_u[good]), np.einsum("ni,ni->n", r, x_v[good])]
        )
        step[moved] = _newton_step((a, b, c), full, gradient, uv[moved])
        uv[active] = np.clip(best_uv[active] + step[active], 0.0, 1.0)
        still = np.abs(uv[active] - best_uv[active]).max(axis=1) > 1e-9
        still &= ~(better & (gain < 1e-12 * square[active]))
        active = active[still]
        if not len(active):
            break
    return best_uv, foot, square


def _newton_step(
    plain: tuple[np.ndarray, ...],
    full: list[np.ndarray],
    gradient: np.ndarray,
    uv: np.ndarray,
) -> np.ndarray:
    """Newton's step, Gauss-Newton's where the Hessian is not positive; held sides stay held."""
    tiny = np.finfo(float).tiny
    a, b, c = full
    positive = (a > 1e-3 * plain[0]) & (c > 1e-3 * plain[2]) & (a * c - b * b > 1e-3 * a * c)
    a, b, c = (np.where(positive, f, p) for f, p in zip(full, plain, strict=True))
    held = ((uv <= 0.0) & (gradient > 0.0)) | ((uv >= 1.0) & (gradient < 0.0))
    det = np.maximum(a * c - b * b, 1e-6 * np.abs(a * c)) + tiny
    step = (
        np.column_stack(
            [b * gradient[:, 1] - c * gradient[:, 0], b * gradient[:, 0] - a * gradient[:, 1]]
        )
        / det[:, None]
    )
    alone = -gradient / np.maximum(np.column_stack([a, c]), tiny)
    # one parameter at its end: the other one moves alone
    trial = uv + step
    out = ((trial < 0.0) & (uv <= 0.0)) | ((trial > 1.0) & (uv >= 1.0)) | held
    step = np.where(out[:, ::-1], alone, step)
    return np.clip(np.where(out, 0.0, step), -1.0, 1.0)
