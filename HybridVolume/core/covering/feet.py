# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Nearest points on untrimmed surfaces: of all of them, not of those near a start.

A search by Newton's method ends at the nearest point of the neighbourhood. That no other place of
the surface is nearer is shown by the pieces that it is cut into: the control points of each are a
hull, and planes in front of hulls bound distances from below. Where neither these nor curvatures
tell, pieces are halved until they do.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from ..surface import SplineFace
from .pieces import Pieces
from .surface_values import evaluate

SETTLED = 1e-8
"""Steps by less, as a share of half a piece, are the last: the next would be its square."""

STILL = 1e-13
"""The same where the next step is not."""

STEPS = 25
"""Longest search for a foot; nearly all end after five."""

SAME = 1e-12
"""Feet whose distances differ by less than this share of the surface's size are equally near."""

HALVINGS = 60
"""So often a piece is halved at most, on average thirty times in a direction."""

CROWD = 512
"""More parts than this to be looked at for one point at the same time are too many: it is, but for
the gap that is told, equally far from all of them."""

_BLOCK = 2_000
"""Points that are treated at once, which bounds the memory and keeps it near."""

_FEW = 1
"""For fewer points than this, a piece, distances between pieces are not worth their price."""

_KNOWN_BYTES = 200_000_000
"""Memory for the pieces of surfaces that were looked at last."""


@dataclass(frozen=True)
class Feet:
    """Nearest points of a surface.

    Attributes
    ----------
    uv : (m, 2) array
        Parameters.
    points : (m, 3) array
        mm
    distance : (m,) array
        mm
    gap : (m,) array
        By how much, at most, another place may be nearer, mm; 0 but where very many places are
        equally near, as from the centre of a sphere.
    """

    uv: np.ndarray
    points: np.ndarray
    distance: np.ndarray
    gap: np.ndarray


def project(face: SplineFace, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Feet of points on the untrimmed surface of a face: nearest of all its points.

    Parameters
    ----------
    face : SplineFace
    points : (m, 3) array
        mm

    Returns
    -------
    uv : (m, 2) array
    feet : (m, 3) array
        mm
    """
    found = nearest(face, points)
    return found.uv, found.points


def nearest(face: SplineFace, points: np.ndarray) -> Feet:
    """Nearest points of the untrimmed surface of a face, and how sure that is.

    Parameters
    ----------
    face : SplineFace
    points : (m, 3) array
        mm
    """
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    pieces = _pieces(face)
    uv, gap = np.empty((len(points), 2)), np.empty(len(points))
    for first in range(0, len(points), _BLOCK):
        part = slice(first, first + _BLOCK)
        uv[part], gap[part] = _feet(pieces, points[part] - pieces.centre)
    feet = evaluate(face, uv)[0]
    return Feet(uv, feet, np.linalg.norm(feet - points, axis=1), gap)


_KNOWN: OrderedDict[bytes, Pieces] = OrderedDict()
"""Pieces of the surfaces that were looked at last."""


def _pieces(face: SplineFace) -> Pieces:
    arrays = (*face.knots, face.control_points, face.weights)
    text = b"".join(np.ascontiguousarray(array, dtype=float).tobytes() for array in arrays)
    key = hashlib.blake2b(text + repr(face.degrees).encode()).digest()
    found = _KNOWN.get(key)
    if found is None:
        found = _KNOWN[key] = Pieces.of(face)
        # the newest stays, however large
        while len(_KNOWN) > 1 and sum(known.nbytes for known in _KNOWN.values()) > _KNOWN_BYTES:
            _KNOWN.popitem(last=False)
    _KNOWN.move_to_end(key)
    return found


class _Best:
    """The nearest places found so far for points.

    Attributes
    ----------
    points : (m, 3) array
    leaf : (m,) int array
        Piece of each place.
    place : (2, m) array
        Place in it.
    distance : (m,) array
    feet : (m, 3) array
        The places themselves.
    """

    def __init__(self, points: np.ndarray) -> None:
        self.points = points
        self.leaf = np.zeros(len(points), dtype=int)
        self.place = np.zeros((2, len(points)))
        self.distance = np.full(len(points), np.inf)
        self.feet = np.zeros((len(points), 3))

    def take(
        self,
        pieces: Pieces,
        rows: np.ndarray,
        leaf: np.ndarray,
        place: np.ndarray,
        distance: np.ndarray,
    ) -> None:
        """Places for the points of some rows, which may stand several times, where nearer."""
        order = np.lexsort((distance, rows))
        first = np.ones(len(order), dtype=bool)
        first[1:] = np.diff(rows[order]) > 0
        order = order[first]
        order = order[distance[order] < self.distance[rows[order]]]
        rows = rows[order]
        self.leaf[rows], self.place[:, rows] = leaf[order], place[:, order]
        self.distance[rows] = distance[order]
        self.feet[rows] = pieces.values(leaf[order], place[:, order])[0].T


def _feet(pieces: Pieces, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parameters (m, 2) of the feet of points, and gaps (m,)."""
    same = SAME * pieces.size
    leaf, place = pieces.start(points)
    leaf, place, distance, settled = descend(pieces, points, leaf, place)
    # one foot in the piece, or in it and those around it: that is the one that was found
    alone = settled & (distance < pieces.room[leaf])
    among = settled & (distance < pieces.room_around[leaf])
    doubtful = distance > same
    if len(points) > _FEW * len(pieces.room) or "clearance" in vars(pieces):
        doubtful &= ~among | (2.0 * distance >= pieces.clearance[leaf])
    unsure = np.flatnonzero(doubtful)
    gap = np.zeros(len(points))
    if not len(unsure):
        return pieces.parameters(leaf, place).T, gap
    best = _Best(points)
    best.take(pieces, np.arange(len(points)), leaf, place, distance)
    row, other = pieces.within(points[unsure], distance[unsure])
    row = unsure[row]
    done = pieces.beside(leaf[row], other) & among[row]
    done |= (leaf[row] == other) & alone[row]
    row, other = row[~done], other[~done]
    if len(row):
        near = _bounds(pieces.hulls[other], best, row) < distance[row] - same
        row, other = row[near], other[near]
    if len(row):
        start = pieces.nearest_seed(points[row], other)
        square = np.array([[-1.0, 1.0]] * 2)[..., None] * np.ones(len(row))
        _, place, distance, settled = descend(pieces, points[row], other, start, square)
        best.take(pieces, row, other, place, distance)
        # nearer than now there may be something in pieces that are bent too much
        open_ = ~(settled & (best.distance[row] < pieces.room[other]))
        if open_.any():
            _search(pieces, best, row[open_], other[open_], gap)
    return pieces.parameters(best.leaf, best.place).T, gap


def _search(
    pieces: Pieces, best: _Best, row: np.ndarray, leaf: np.ndarray, gap: np.ndarray
) -> None:
    """Halve pieces until nothing in them can be nearer than what is known."""
    nets = pieces.nets[leaf]
    square = np.array([[-1.0, 1.0]] * 2)[..., None] * np.ones(len(row))
    same = SAME * pieces.size
    for level in range(HALVINGS + 1):
        lower = _bounds(_hulls(nets), best, row)
        kept = lower < best.distance[row] - same
        crowded = np.bincount(row[kept], minlength=len(gap)) > CROWD
        left = kept & (crowded[row] if level < HALVINGS else True)
        np.maximum.at(gap, row[left], best.distance[row[left]] - lower[left])
        kept &= ~left
        row, leaf, nets, square = row[kept], leaf[kept], nets[kept], square[..., kept]
        if not len(row):
            break
        convex, place, distance = _looked_at(pieces, best.points[row], leaf, square)
        tried = np.flatnonzero(convex | (distance < best.distance[row]))
        if len(tried):
            _, place, distance, settled = descend(
                pieces, best.points[row[tried]], leaf[tried], place[:, tried], square[..., tried]
            )
            best.take(pieces, row[tried], leaf[tried], place, distance)
            convex[tried] &= settled
        rest = ~convex
        if not rest.any():
            break
        row, leaf, nets, square = _halved(row[rest], leaf[rest], nets[rest], square[..., rest])


def _looked_at(
    pieces: Pieces, points: np.ndarray, leaf: np.ndarray, square: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether distances from points are convex in parts, their nearest of nine places there."""
    share = np.stack(np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.5, 1.0], indexing="ij")).reshape(2, 9, 1)
    low, high = square[:, 0], square[:, 1]
    place = low[:, None] + share * (high - low)[:, None]  # (2, 9, k)
    count = len(points)
    x, slopes = pieces.values(np.tile(leaf, 9), place.reshape(2, -1))
    off = x - np.tile(points.T, 9)
    (a, b, c), (p, r, q) = _forms(off, slopes)[:2]
    convex = (p > 0.1 * a) & (q > 0.1 * c) & (p * q - r**2 > 0.3 * (a * c - b**2))
    convex &= a * c - b**2 > 1e-8 * a * c
    distance = np.linalg.norm(off, axis=0).reshape(9, count)
    least, rows = distance.argmin(axis=0), np.arange(count)
    return (convex.reshape(9, count).all(axis=0), place[:, least, rows], distance[least, rows])


def _halved(
    row: np.ndarray, leaf: np.ndarray, nets: np.ndarray, square: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Both halves of parts, cut across their longer direction."""
    hulls = _hulls(nets)
    lengths = [
        np.linalg.norm(np.diff(hulls, axis=axis), axis=3).sum(axis=axis).max(axis=1)
        for axis in (1, 2)
    ]
    along = lengths[0] >= lengths[1]
    found = [[], [], [], []]
    for axis, own in enumerate((np.flatnonzero(along), np.flatnonzero(~along))):
        net = np.moveaxis(nets[own], 1 + axis, 1)
        for half, matrix in enumerate(_halving(net.shape[1] - 1)):
            part = (matrix @ net.reshape(*net.shape[:2], net.shape[2] * 4)).reshape(net.shape)
            corner = square[..., own].copy()
            corner[axis, 1 - half] = corner[axis].mean(axis=0)
            for got, new in zip(
                found, (row[own], leaf[own], np.moveaxis(part, 1, 1 + axis), corner), strict=True
            ):
                got.append(new)
    rows, leaves, parts, corners = found
    return (
        np.concatenate(rows),
        np.concatenate(leaves),
        np.concatenate(parts),
        np.concatenate(corners, axis=-1),
    )


def _halving(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrices from the control points of a Bézier segment to those of its halves (Casteljau)."""
    first = np.zeros((degree + 1, degree + 1))
    first[0, 0] = 1.0
    for i in range(1, degree + 1):
        first[i] = 0.5 * first[i - 1]
        first[i, 1:] += 0.5 * first[i - 1, :-1]
    return first, first[::-1, ::-1]


def _hulls(nets: np.ndarray) -> np.ndarray:
    return nets[..., :3] / nets[..., 3:]


def _bounds(hulls: np.ndarray, best: _Best, row: np.ndarray) -> np.ndarray:
    """Lower bounds of the distances of points from the hulls of control points, (k,).

    Planes in front of a hull: one across the way to the nearest place known, one across that to
    the middle of the hull, one across that to its nearest point.
    """
    off = hulls.reshape(len(hulls), -1, 3) - best.points[row, None]
    square = np.einsum("kid,kid->ki", off, off)
    ways = [
        best.feet[row] - best.points[row],
        off.mean(axis=1),
        off[np.arange(len(off)), square.argmin(axis=1)],
    ]
    found = np.zeros(len(off))
    for way in ways:
        length = np.maximum(np.linalg.norm(way, axis=1), 1e-300)
        reach = np.matmul(off, way[:, :, None])[..., 0].min(axis=1)
        found = np.maximum(found, reach / length)
    return found


def descend(
    pieces: Pieces,
    points: np.ndarray,
    leaf: np.ndarray,
    place: np.ndarray,
    square: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Go down from places to feet by Newton's method, with steps that are shortened if need be.

    Parameters
    ----------
    pieces : Pieces
    points : (m, 3) array
        From the pieces' centre.
    leaf : (m,) int array
    place : (2, m) array
        Where to begin.
    square : (2, 2, m) array, optional
        Least and largest places in each direction; without it all of the surface is open.

    Returns
    -------
    leaf : (m,) int array
    place : (2, m) array
    distance : (m,) array
    settled : (m,) bool array
        Whether the last step was as good as none.
    """
    goal = np.ascontiguousarray(points.T)
    leaf, place = leaf.copy(), place.copy()
    new_leaf, new = leaf.copy(), place.copy()
    step, share = np.zeros_like(place), np.ones(len(points))
    newton = np.zeros(len(points), dtype=bool)
    best = np.full(len(points), np.inf)
    settled = np.zeros(len(points), dtype=bool)
    slack = 4.0 * np.finfo(float).eps * pieces.size
    active = np.arange(len(points))
    for _ in range(STEPS):
        x, slopes = pieces.values(new_leaf[active], new[:, active])
        off = x - goal[:, active]
        distance = np.sqrt(np.einsum("dm,dm->m", off, off))
        # near a foot distances differ by rounding only, the place does not
        better = distance <= best[active] * (1.0 + 1e-14) + slack
        own = active[better]
        leaf[own], place[:, own], best[own] = (new_leaf[own], new[:, own], distance[better])
        low, high = (
            pieces.ends(leaf[own]) if square is None else np.moveaxis(square[..., own], 1, 0)
        )
        step[:, own], newton[own] = _step(
            off[:, better], slopes[..., better], place[:, own], low, high
        )
        share[own] = 1.0
        share[active[~better]] *= 0.25
        way = share[active] * step[:, active]
        size = np.abs(way).max(axis=0)
        new[:, active] = place[:, active] - way
        # the last step stays in the piece
        inside = np.abs(new[:, active]).max(axis=0) <= 1.0
        last = (size <= SETTLED) & better & newton[active] & inside
        own = active[last]
        place[:, own] = new[:, own]
        last |= size <= STILL
        settled[active[last]] = True
        active = active[~last]
        if not len(active):
            break
        if square is None:
            new_leaf[active], new[:, active] = pieces.moved(leaf[active], new[:, active])
        else:
            new[:, active] = np.clip(new[:, active], square[:, 0, active], square[:, 1, active])
    return leaf, place, best, settled


def _forms(off: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First fundamental form, and derivatives of half the squared distance.

    Second ones, (3, m) as the form, and first ones, (2, m).
    """
    u, v = slopes[:2]
    first = np.stack([_dot(u, u), _dot(u, v), _dot(v, v)])
    along = np.einsum("kdm,dm->km", slopes, off)
    return first, first + along[2:], along[:2]


def _step(
    off: np.ndarray, slopes: np.ndarray, place: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Steps (2, m) towards feet, subtracted from places, and whether they are Newton's."""
    first, bent, slope = _forms(off, slopes)
    a, b, c = first
    # second derivatives count where they leave the function convex
    convex = (bent[0] * bent[2] - bent[1] ** 2 > 1e-3 * (a * c - b**2)) & (bent[0] > 0.0)
    floor = 1e-14 * np.maximum(a + c, 1e-300)
    p, r, q = np.where(convex, bent, first)
    p, q = p + floor, q + floor
    determinant = p * q - r**2
    determinant = np.where(np.abs(determinant) > 1e-300, determinant, 1e-300)
    step = np.stack([q * slope[0] - r * slope[1], p * slope[1] - r * slope[0]]) / determinant
    # at a border only the other one moves
    out = ((place <= low + 1e-12) & (slope > 0.0)) | ((place >= high - 1e-12) & (slope < 0.0))
    bowl = np.stack([bent[0] > 0.1 * a, bent[2] > 0.1 * c])
    diagonal = np.where(bowl, bent[::2], first[::2])
    alone = slope / np.maximum(diagonal, 1e-300)
    step = np.where(out, 0.0, np.where(out[::-1], alone, step))
    # farther than three pieces nothing is known of the surface
    step *= np.minimum(1.0, 6.0 / np.maximum(np.abs(step).max(axis=0), 1e-300))
    return step, np.where(out.any(axis=0), (out | bowl).all(axis=0), convex)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("dm,dm->m", a, b)
