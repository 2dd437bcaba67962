# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Surfaces cut into pieces that turn little, to look for nearest points on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np
from scipy.spatial import cKDTree

from .. import bspline
from ..surface import SplineFace

TURN = 0.5
"""Pieces turn by about so much along a parameter, radians."""

MOST_PARTS = 16
"""A knot span is cut into so many parts at most in a direction, ..."""

MOST_PIECES = 4_000
"""... and into fewer where there are more pieces than this."""

LONG = 3.0
"""Pieces are about so many times longer than wide at most."""

CONE, WIDE_CONE = np.radians([45.0, 60.0])
"""Normals of a piece with one foot are nearer than this to their mean; of one and all around it."""

TOWARDS_POLES = 4
"""So often pieces are halved towards a side without length, where all are bent too much."""

STRAIGHT = 0.3
"""Distances below this share of a piece's radius of curvature have one foot there."""

_BLOCK = 5_000
"""Pieces that are looked at at once, which bounds the memory."""

_AT = np.linspace(-1.0, 1.0, 5)
"""Places in each direction at which pieces are looked at."""

_SEEDS = np.array([-2.0, 0.0, 2.0]) / 3.0


@dataclass(frozen=True)
class Pieces:
    """A surface in pieces: Bézier patches, each with places in [-1, 1] x [-1, 1].

    Attributes
    ----------
    centre : (3,) array
        What all points count from, mm.
    size : float
        Diagonal of the box of the control points, mm.
    lines : (array, array)
        Parameters where the surface is cut.
    closed : (bool, bool)
        Whether the surface's ends are the same curve.
    nets : (n, p + 1, q + 1, 4) array
        Homogeneous control points.
    hulls : (n, (p + 1) (q + 1), 3) array
        The same as points.
    coefficients : (p + 1, q + 1, 4, n) array
        Of the powers of places. The weights are left out where they are equal.
    middle, radius : (n, 3), (n,) array
        Balls around the pieces.
    room : (n,) array
        Points that are nearer to a piece than this have one foot there at most, mm: a share of
        the least radius of curvature of the piece and its borders; 0 where that cannot be told, or
        where the piece turns too much.
    room_around : (n,) array
        The same of a piece and those around it.
    seeds : (n, 9, 3) array
    tree : cKDTree
        Of the seeds.
    groups : tuple
        Pieces in the order of groups of neighbours, where each group begins there, and balls
        around the groups.
    """

    centre: np.ndarray
    size: float
    lines: tuple[np.ndarray, np.ndarray]
    closed: tuple[bool, bool]
    nets: np.ndarray
    hulls: np.ndarray
    coefficients: np.ndarray
    middle: np.ndarray
    radius: np.ndarray
    room: np.ndarray
    room_around: np.ndarray
    seeds: np.ndarray
    tree: cKDTree
    groups: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]

    @classmethod
    def of(cls, face: SplineFace) -> Pieces:
        """Cut the surface of a face."""
        x = face.control_points.reshape(-1, 3)
        low, high = x.min(axis=0), x.max(axis=0)
        centre, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
        weights = face.weights / face.weights.mean()
        rows = (face.control_points - centre) * weights[..., None]
        rows = np.concatenate([rows, weights[..., None]], axis=2)
        lines = _lines(face.degrees, face.knots, rows)
        nets = _nets(face.degrees, face.knots, rows, lines)
        shape = nets.shape[0], nets.shape[2]
        closed = tuple(
            bool(np.abs(np.diff(np.take(face.control_points, [0, -1], axis=axis), axis=axis)).max()
                 <= 1e-9 * size)
            for axis in range(2)
        )  # fmt: skip
        nets = nets.transpose(0, 2, 1, 3, 4).reshape(-1, *nets.shape[1::2], 4)
        hulls = (nets[..., :3] / nets[..., 3:]).reshape(len(nets), -1, 3)
        rational = np.ptp(weights) > 0.0
        powers = [_powers(degree) for degree in face.degrees]
        coefficients = np.einsum(
            "ai,bj,nijd->abdn", *powers, nets[..., : 4 if rational else 3], optimize=True
        )
        low, high = hulls.min(axis=1), hulls.max(axis=1)
        middle = 0.5 * (low + high)
        radius = np.linalg.norm(hulls - middle[:, None], axis=2).max(axis=1)
        at = np.stack(np.meshgrid(_SEEDS, _SEEDS, indexing="ij")).reshape(2, -1)
        seeds = np.concatenate(
            [
                _grid(coefficients[..., first : first + _BLOCK], at)[0]
                for first in range(0, len(nets), _BLOCK)
            ],
            axis=-1,
        ).transpose(2, 1, 0)
        room, around = (STRAIGHT / bend for bend in _bends(coefficients, shape, closed, size))
        return cls(
            centre, size, lines, closed, nets, hulls, np.ascontiguousarray(coefficients),
            middle, radius, room, around, np.ascontiguousarray(seeds),
            cKDTree(seeds.reshape(-1, 3)), _groups(shape, middle, radius)
        )  # fmt: skip

    @property
    def nbytes(self) -> int:
        """Memory of the arrays."""
        arrays = (self.nets, self.hulls, self.coefficients, self.seeds)
        return sum(array.nbytes for array in arrays)

    @property
    def shape(self) -> tuple[int, int]:
        """Pieces in each direction."""
        return len(self.lines[0]) - 1, len(self.lines[1]) - 1

    def values(self, leaf: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (3, m), and derivatives along u, v, uu, uv, vv by places, (5, 3, m)."""
        return _values(np.take(self.coefficients, leaf, axis=-1), place)

    def start(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Piece and place of the seed that is nearest to each point, (m,) and (2, m)."""
        leaf, seed = np.divmod(self.tree.query(points)[1], 9)
        return leaf, np.stack([_SEEDS[seed // 3], _SEEDS[seed % 3]])

    def nearest_seed(self, points: np.ndarray, leaf: np.ndarray) -> np.ndarray:
        """Places of the nearest seeds in given pieces, (2, m)."""
        off = self.seeds[leaf] - points[:, None]
        seed = np.einsum("msd,msd->ms", off, off).argmin(axis=1)
        return np.stack([_SEEDS[seed // 3], _SEEDS[seed % 3]])

    def within(self, points: np.ndarray, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of points and pieces whose balls are nearer than given distances."""
        order, starts, middle, radius = self.groups
        row, group = _balls(points, distance, middle, radius, self.size)
        count = np.diff(starts)[group]
        row = np.repeat(row, count)
        first = np.cumsum(count) - count
        leaf = order[np.arange(len(row)) + np.repeat(starts[group] - first, count)]
        if len(order) > len(middle):
            off = points[row] - self.middle[leaf]
            reach = distance[row] + self.radius[leaf] + 1e-9 * self.size
            near = np.einsum("kd,kd->k", off, off) < reach**2
            row, leaf = row[near], leaf[near]
        return row, leaf

    @cached_property
    def clearance(self) -> np.ndarray:
        """Distances of pieces from all but their neighbours, at least, up to their radii, mm."""
        row, other = self.within(self.middle, 2.0 * self.radius)
        far = ~self.beside(row, other)
        row, other = row[far], other[far]
        way = self.middle[other] - self.middle[row]
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-300)
        apart = np.matmul(self.hulls[other], way[..., None])[..., 0].min(axis=1)
        apart -= np.matmul(self.hulls[row], way[..., None])[..., 0].max(axis=1)
        found = self.radius.copy()
        np.minimum.at(found, row, apart)
        return found

    def beside(self, leaf: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Whether pieces are the same or neighbours by their parameters."""
        found = np.ones(len(leaf), dtype=bool)
        for one, two, count, closed in zip(
            np.divmod(leaf, self.shape[1]), np.divmod(other, self.shape[1]), self.shape,
            self.closed, strict=True
        ):  # fmt: skip
            apart = np.abs(one - two)
            if closed:
                apart = np.minimum(apart, count - apart)
            found &= apart <= 1
        return found

    def ends(self, leaf: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest places, (2, m), that pieces have to the ends of the surface."""
        low, high = np.full((2, len(leaf)), -np.inf), np.full((2, len(leaf)), np.inf)
        for axis, number in enumerate(np.divmod(leaf, self.shape[1])):
            if not self.closed[axis]:
                low[axis, number == 0] = -1.0
                high[axis, number == self.shape[axis] - 1] = 1.0
        return low, high

    def parameters(self, leaf: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Parameters of places, (2, m), within those of the surface."""
        found = np.empty_like(place)
        for axis, number in enumerate(np.divmod(leaf, self.shape[1])):
            line = self.lines[axis]
            begin, end = line[number], line[number + 1]
            along = 0.5 * ((1.0 - place[axis]) * begin + (1.0 + place[axis]) * end)
            found[axis] = np.clip(along, line[0], line[-1])
        return found

    def moved(self, leaf: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pieces and places where places beyond a piece's borders belong."""
        outside = np.flatnonzero((np.abs(place) > 1.0).any(axis=0))
        if not len(outside):
            return leaf, place
        leaf, place = leaf.copy(), place.copy()
        numbers = []
        for axis, number in enumerate(np.divmod(leaf[outside], self.shape[1])):
            line = self.lines[axis]
            begin, end = line[number], line[number + 1]
            at = place[axis, outside]
            along = 0.5 * ((1.0 - at) * begin + (1.0 + at) * end)
            if self.closed[axis]:
                along = line[0] + np.mod(along - line[0], line[-1] - line[0])
            along = np.clip(along, line[0], line[-1])
            inside = np.abs(at) <= 1.0
            new = np.searchsorted(line, along, side="right") - 1
            new = np.where(inside, number, np.clip(new, 0, len(line) - 2))
            begin, end = line[new], line[new + 1]
            local = np.clip((2.0 * along - begin - end) / (end - begin), -1.0, 1.0)
            place[axis, outside] = np.where(inside, at, local)
            numbers.append(new)
        leaf[outside] = numbers[0] * self.shape[1] + numbers[1]
        return leaf, place


def _lines(
    degrees: tuple[int, int], knots: tuple[np.ndarray, np.ndarray], rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters at which a surface is cut: its knots, and more where it turns or is long."""
    spans = tuple(bspline.breakpoints(line) for line in knots)
    nets = _nets(degrees, knots, rows, spans)
    hulls = nets[..., :3] / nets[..., 3:]
    parts, lengths = [], []
    for axis in (0, 1):
        chords = np.diff(hulls, axis=1 + 2 * axis)
        length = np.linalg.norm(chords, axis=-1, keepdims=True)
        way = np.moveaxis(chords / np.maximum(length, 1e-300), 1 + 2 * axis, 0)
        cosine = np.einsum("k...d,k...d->k...", way[:-1], way[1:])
        # a chord without length turns nowhere
        cosine[(np.abs(way[:-1]).max(axis=-1) == 0) | (np.abs(way[1:]).max(axis=-1) == 0)] = 1.0
        turn = np.arccos(np.clip(cosine, -1.0, 1.0)).sum(axis=0)
        turn = turn.max(axis=((1, 2), (0, 1))[axis])
        parts.append(np.clip(np.ceil(turn / TURN), 1, MOST_PARTS).astype(int))
        total = length[..., 0].sum(axis=1 + 2 * axis)
        lengths.append(total.mean(axis=((1, 2), (0, 1))[axis]))
    # pieces that are about as long as they are wide
    sizes = [float((length / part).mean()) for length, part in zip(lengths, parts, strict=True)]
    for axis in (0, 1):
        longest = LONG * max(sizes[1 - axis], 1e-300)
        more = np.clip(np.ceil(lengths[axis] / longest), 1, MOST_PARTS).astype(int)
        parts[axis] = np.maximum(parts[axis], more)
    while parts[0].sum() * parts[1].sum() > MOST_PIECES and max(parts[0].max(), parts[1].max()) > 1:
        parts = [np.maximum(1, (0.7 * part).astype(int)) for part in parts]
    found = []
    for axis, (line, part) in enumerate(zip(spans, parts, strict=True)):
        line = _refined(line, part)
        sides = np.take(hulls, 0, axis=2 * axis), np.take(hulls, -1, axis=2 * axis)
        ends = np.take(sides[0], 0, axis=2 * axis), np.take(sides[1], -1, axis=2 * axis)
        more = 0.5 ** np.arange(1, TOWARDS_POLES + 1)
        size = 1e-9 * np.linalg.norm(np.ptp(hulls.reshape(-1, 3), axis=0))
        for end, begin, beside in zip(ends, (line[0], line[-1]), (line[1], line[-2]), strict=True):
            if np.ptp(end.reshape(-1, 3), axis=0).max() <= size:
                line = np.concatenate([line, begin + (beside - begin) * more])
        found.append(np.sort(line))
    return tuple(found)


def _refined(lines: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Lines with each interval cut into a number of parts."""
    number = np.repeat(np.arange(len(parts)), parts)
    step = np.arange(len(number)) - np.repeat(np.cumsum(parts) - parts, parts)
    inside = lines[number] + np.diff(lines)[number] * step / parts[number]
    return np.append(inside, lines[-1])


def _nets(
    degrees: tuple[int, int],
    knots: tuple[np.ndarray, np.ndarray],
    rows: np.ndarray,
    lines: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Control points of the pieces between lines, (nu, p + 1, nv, q + 1, 4)."""
    for axis, (degree, line, cuts) in enumerate(zip(degrees, knots, lines, strict=True)):
        values, counts = bspline.multiplicities(line)
        known = np.searchsorted(cuts, values)
        counts_of = np.full(len(cuts), degree)
        # ends, and knots where the surface is torn, stand oftener
        counts_of[known] = np.maximum(counts, degree)
        full = np.repeat(cuts, counts_of)
        matrix = bspline.insertion_matrix(degree, line, full)
        begin = np.concatenate([[0], np.cumsum(counts_of[1:-1])])
        found = matrix @ np.moveaxis(rows, 2 * axis, 0).reshape(rows.shape[2 * axis], -1)
        found = found[begin[:, None] + np.arange(degree + 1)]
        rest = np.delete(np.array(rows.shape), 2 * axis)
        found = found.reshape(len(begin), degree + 1, *rest)
        rows = np.moveaxis(found, (0, 1), (2 * axis, 2 * axis + 1))
    return rows


def _powers(degree: int) -> np.ndarray:
    """Matrix from Bézier points over [-1, 1] to coefficients of powers."""
    found = np.zeros((degree + 1, degree + 1))
    one = np.polynomial.Polynomial([0.5, 0.5])
    other = np.polynomial.Polynomial([0.5, -0.5])
    for i in range(degree + 1):
        function = comb(degree, i) * one**i * other ** (degree - i)
        found[: len(function.coef), i] = function.coef
    return found


def _horner(coefficients: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Values, first and second derivatives, (3, ..., m), of polynomials (n, ..., m) at x (m,)."""
    found = np.zeros((3, *coefficients.shape[1:]))
    value, first, second = found
    value += coefficients[-1]
    for k, row in enumerate(coefficients[-2::-1]):
        if k > 1:
            second *= x
        if k > 0:
            second += first
            first *= x
        first += value
        value *= x
        value += row
    second *= 2.0
    return found


def _values(coefficients: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (3, m), and derivatives along u, v, uu, uv, vv, (5, 3, m)."""
    along = _horner(coefficients, place[0])  # (3, q + 1, 3 or 4, m)
    across = _horner(along.swapaxes(0, 1), place[1])
    found = across.reshape(9, *across.shape[2:])[[0, 1, 3, 2, 4, 6]]
    x, slopes = found[0, :3], found[1:, :3]
    if found.shape[1] == 3:
        return x, slopes
    w = found[:, 3:]
    x = x / w[0]
    slopes -= w[1:] * x
    slopes /= w[0]
    first, (wu, wv) = slopes[:2], w[1:3] / w[0]
    slopes[2] -= 2.0 * wu * first[0]
    slopes[3] -= wu * first[1] + wv * first[0]
    slopes[4] -= 2.0 * wv * first[1]
    return x, slopes


def _grid(coefficients: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (3, k, n) and derivatives (5, 3, k, n) of all pieces at k places (2, k)."""
    count, places = coefficients.shape[-1], at.shape[1]
    wide = np.broadcast_to(coefficients[..., None, :], (*coefficients.shape[:-1], places, count))
    wide = wide.reshape(*coefficients.shape[:-1], -1)
    x, slopes = _values(wide, np.repeat(at, count, axis=1))
    return x.reshape(3, places, count), slopes.reshape(5, 3, places, count)


def _bends(
    coefficients: np.ndarray, shape: tuple[int, int], closed: tuple[bool, bool], size: float
) -> tuple[np.ndarray, np.ndarray]:
    """Largest curvatures of pieces, and of these with those around them, 1/mm.

    Infinite where normals turn by too much or nowhere are, or sides of neighbours meet in a kink.
    """
    parts = [
        _turns(coefficients[..., first : first + _BLOCK], size)
        for first in range(0, coefficients.shape[-1], _BLOCK)
    ]
    bend, middle, cone, normal = (
        np.concatenate(values, axis=-1) for values in zip(*parts, strict=True)
    )
    around = bend.reshape(shape).copy()
    sides = normal.reshape(3, 5, 5, *shape)
    for axis, (first, last) in enumerate(
        ((sides[:, 0], sides[:, -1]), (sides[:, :, 0], sides[:, :, -1]))
    ):
        cosine = np.einsum("dk...,dk...->k...", last, np.roll(first, -1, axis=2 + axis))
        smooth = cosine.min(axis=0) > np.cos(1e-3)
        if not closed[axis]:
            smooth[(-1,) if axis == 0 else (slice(None), -1)] = True
        around[~smooth | ~np.roll(smooth, 1, axis=axis)] = np.inf
    middle, cone = middle.reshape(3, *shape), cone.reshape(shape)
    most, wide = around.copy(), cone.copy()
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            there = _there(shape, closed, i, j)
            most = np.where(there, np.maximum(most, np.roll(around, (i, j), (0, 1))), most)
            turned = np.einsum("dij,dij->ij", middle, np.roll(middle, (i, j), (1, 2)))
            turned = np.arccos(np.clip(turned, -1.0, 1.0)) + np.roll(cone, (i, j), (0, 1))
            wide = np.where(there, np.maximum(wide, turned), wide)
    most[wide > WIDE_CONE] = np.inf
    return bend, most.ravel()


def _turns(
    coefficients: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Curvatures (n,), mean normals (3, n), their cones (n,) and normals (3, 25, n) of pieces."""
    at = np.stack(np.meshgrid(_AT, _AT, indexing="ij")).reshape(2, -1)
    u, v, uu, uv, vv = _grid(coefficients, at)[1]
    a, b, c = _dot(u, u), _dot(u, v), _dot(v, v)
    area = np.maximum(a * c - b**2, 0.0)
    regular = (area > 1e-6 * a * c) & (np.minimum(a, c) > 1e-16 * size**2)
    normal = np.cross(u, v, axis=0) / np.maximum(np.sqrt(area), 1e-300)
    with np.errstate(divide="ignore", invalid="ignore"):
        d, e, f = _dot(normal, uu), _dot(normal, uv), _dot(normal, vv)
        mean = 0.5 * (d * c - 2.0 * e * b + f * a) / area
        product = (d * f - e**2) / area
        most = np.abs(mean) + np.sqrt(np.maximum(mean**2 - product, 0.0))
        lines = [
            np.linalg.norm(np.cross(one, two, axis=0), axis=0) / length**1.5
            for one, two, length in ((u, uu, a), (v, vv, c))
        ]
        bend = np.maximum(most, np.maximum(*lines))
    bend = np.where(regular & np.isfinite(bend), bend, np.inf).max(axis=0)
    # places between the samples may be bent more
    bend = 1.5 * bend + 0.1 / size
    middle = normal.sum(axis=1)
    middle /= np.maximum(np.linalg.norm(middle, axis=0), 1e-300)
    cone = np.arccos(np.clip(np.einsum("dkn,dn->kn", normal, middle), -1.0, 1.0)).max(axis=0)
    bend[cone > CONE] = np.inf
    return bend, middle, cone, normal


def _there(shape: tuple[int, int], closed: tuple[bool, bool], i: int, j: int) -> np.ndarray:
    """Whether a neighbour is on the surface."""
    found = np.ones(shape, dtype=bool)
    for axis, step in enumerate((i, j)):
        if step and not closed[axis]:
            found[
                (0 if step > 0 else -1,) if axis == 0 else (slice(None), 0 if step > 0 else -1)
            ] = False
    return found


def _groups(
    shape: tuple[int, int], middle: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pieces in groups of neighbours, about as many groups as pieces in each."""
    count = len(middle)
    if count <= 300:
        return np.arange(count), np.arange(count + 1), middle, radius
    wide = int(np.ceil(count**0.25))
    i, j = np.divmod(np.arange(count), shape[1])
    number = (i // wide) * (shape[1] // wide + 1) + j // wide
    order = np.argsort(number, kind="stable")
    _, first = np.unique(number[order], return_index=True)
    starts = np.append(first, count)
    low = np.minimum.reduceat(middle[order] - radius[order, None], first)
    high = np.maximum.reduceat(middle[order] + radius[order, None], first)
    centre = 0.5 * (low + high)
    group = np.repeat(np.arange(len(first)), np.diff(starts))
    reach = np.linalg.norm(middle[order] - centre[group], axis=1) + radius[order]
    return order, starts, centre, np.maximum.reduceat(reach, first)


def _balls(
    points: np.ndarray, distance: np.ndarray, middle: np.ndarray, radius: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of points and balls that are nearer than distances."""
    off = np.einsum("md,md->m", points, points)[:, None] - 2.0 * (points @ middle.T)
    off += np.einsum("nd,nd->n", middle, middle)
    # a little more than the balls, for the rounding
    reach = distance[:, None] + (radius + 1e-6 * size)
    return np.nonzero(off < reach**2)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("d...,d...->...", a, b)
