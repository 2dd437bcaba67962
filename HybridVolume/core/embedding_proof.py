# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A proof that a curved surface of patches does not touch or cut itself, by control points alone.

Every Bézier piece s of the surface has s_u in the convex cone C_u of its control vectors in u, and
s_v in C_v. Over a rectangle of parameters s(y) - s(x) is an integral along the segment from x to y,
so it lies in (y_u - x_u) C_u + (y_v - x_v) C_v. Hence:

1. *a piece* is one-to-one where C_u meets neither C_v nor -C_v (but in 0);
2. *two pieces with a common side* are together a map of a rectangle, so that they are one-to-one,
   and have only the side in common, where the united cones C_u and C_v are apart in this sense;
3. *two pieces with a common corner* have only that point in common where their cones from the
   corner, spanned by C_u and C_v, are apart;
4. *all other pairs* of pieces have no point in common where a plane separates their control points.

Two cones are apart where a plane through 0 has them on different sides. Pieces or pairs that do not
pass are halved, which gives pieces and pairs of the same four kinds, with narrower cones and
tighter hulls. Where all pass, the surface is embedded: curved as it is, not its triangles. Cones
and hulls are compared with margins far above the rounding errors of the control points.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from itertools import combinations
from math import comb

import numpy as np

from .bound import place_numbers
from .boxtree import BoxTree
from .bspline import bezier_elevation
from .cones import in_half_space
from .jacobian import halving_matrix
from .surface import PatchSurface

logger = logging.getLogger(__name__)

MARGIN = 1e-7
"""Least cosine to a separating plane's normal."""
GAP = 1e-12
"""Least distance of hulls, as a share of the surface's size."""
MOST_PAIRS = 20_000
"""Pairs without a common point on one level at which to give up."""
_CHUNK = 4096

# How a net is turned: 1 exchanges u and v, then 2 reverses the first, 4 the second direction.
_TO_END = np.array([2, 0, 3, 1])
_TO_START = np.array([0, 2, 1, 3])


@dataclass(frozen=True)
class EmbeddingProof:
    """What was proved about a surface.

    Attributes
    ----------
    proved : bool
        Whether it neither touches nor cuts itself.
    open : (k,) int array
        Knot spans with pieces for which that was not proved (it may still be so).
    pieces : int
        Pieces and pairs that were looked at.
    depth : int
        Halvings of knot spans.
    """

    proved: bool
    open: np.ndarray
    pieces: int
    depth: int


@dataclass(frozen=True)
class _Pairs:
    """Pieces (second is None) or pairs of pieces: homogeneous nets (m, n, n, c), knot spans."""

    first: np.ndarray
    owner: np.ndarray
    second: np.ndarray | None = None
    other: np.ndarray | None = field(default=None)

    def __len__(self) -> int:
        return len(self.first)

    def only(self, rows: np.ndarray) -> _Pairs:
        if self.second is None:
            return _Pairs(self.first[rows], self.owner[rows])
        return _Pairs(self.first[rows], self.owner[rows], self.second[rows], self.other[rows])

    def spans(self) -> np.ndarray:
        return self.owner if self.other is None else np.concatenate([self.owner, self.other])


def prove_embedded(surface: PatchSurface, depth: int = 6) -> EmbeddingProof:
    """Prove that a closed surface neither touches nor cuts itself.

    Parameters
    ----------
    surface : PatchSurface
    depth : int
        Most halvings of pieces and pairs, after the first that all knot spans get.

    Returns
    -------
    EmbeddingProof
    """
    nets, corners, sides, owner = _pieces(surface)
    found = _neighbours(nets, corners, sides, owner)
    if found is None:
        return EmbeddingProof(False, np.unique(owner), len(nets), 1)
    edges, tips, known = found
    gap = GAP * surface.diagonal
    work = [_Pairs(nets, owner), edges, tips, _far_pairs(nets, owner, known)]
    pieces, near = 0, []
    for level in range(depth + 1):
        pieces += sum(map(len, work))
        for k, test in enumerate(_TESTS):
            work[k] = work[k].only(_open_rows(test, work[k], gap))
        still = np.unique(np.concatenate([pairs.spans() for pairs in work]))
        logger.debug("embedding, level %d: %s open", level, [len(pairs) for pairs in work])
        near.append(sum(map(len, work[:3])))
        # at singular places and edges without an angle halving never helps
        stuck = level >= 2 and 0 < near[-3] <= min(near[-2:])
        if not len(still) or level == depth or stuck:
            break
        work = _halve_all(*work)
        if len(work[3]) > MOST_PAIRS:
            break
    logger.info(
        "embedded surface %s: %d pieces and pairs, %d halvings, %d knot spans open",
        "not proved" if len(still) else "proved",
        pieces,
        level + 1,
        len(still),
    )
    return EmbeddingProof(not len(still), still, pieces, level + 1)


def _pieces(surface: PatchSurface) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """All knot spans cut in four: nets of one degree, corner and side numbers, knot spans."""
    degree = max(max(group.degrees) for group in surface.groups)
    count = surface.element_count
    rational = any(np.ptp(group.weights) > 0.0 for group in surface.groups)
    nets = np.zeros((count, degree + 1, degree + 1, 4 if rational else 3))
    low, high = surface.control_points.min(axis=0), surface.control_points.max(axis=0)
    for group in surface.groups:
        points = surface.control_points[group.index] - 0.5 * (low + high)
        if rational:
            weights = group.weights[..., None]
            points = np.concatenate([points * weights, weights], axis=-1)
        raised = [bezier_elevation(p, degree - p) for p in group.degrees]
        nets[group.element] = np.einsum("ai,bj,eijc->eabc", *raised, group.bezier(points))
    place, _ = place_numbers(surface, 5)
    place = np.stack(
        [place[:, i : i + 3, j : j + 3] for i in (0, 2) for j in (0, 2)], axis=1
    ).reshape(-1, 3, 3)
    sides = np.stack([place[:, 0, 1], place[:, 2, 1], place[:, 1, 0], place[:, 1, 2]], axis=1)
    nets = _halved(nets).reshape(-1, *nets.shape[1:])
    return nets, place[:, ::2, ::2], sides, np.repeat(np.arange(count), 4)


def _halved(nets: np.ndarray) -> np.ndarray:
    """The four quarters of nets, (m, 2, 2, n, n, c)."""
    n = nets.shape[1]
    halves = halving_matrix(n - 1).reshape(2, n, n)
    return np.einsum("xai,ybj,mijc->mxyabc", halves, halves, nets, optimize=True)


def _turned(nets: np.ndarray, how: np.ndarray) -> np.ndarray:
    """Nets (m, n, n, ...) turned so that what they share stands at a given place."""
    out = np.empty_like(nets)
    for code in np.unique(how):
        rows = how == code
        part = nets[rows]
        if code & 1:
            part = np.swapaxes(part, 1, 2)
        if code & 2:
            part = part[:, ::-1]
        if code & 4:
            part = part[:, :, ::-1]
        out[rows] = part
    return out


def _neighbours(
    nets: np.ndarray, corners: np.ndarray, sides: np.ndarray, owner: np.ndarray
) -> tuple[_Pairs, _Pairs, np.ndarray] | None:
    """Pairs with a common side and with a common corner, and the numbers of both, (k, 2).

    None where two pieces share more than a side: then the cutting is too coarse for this.
    """
    order = np.argsort(sides.ravel(), kind="stable")
    number = sides.ravel()[order]
    if len(number) % 2 or np.any(number[::2] != number[1::2]):
        return None
    (a, side_a), (b, side_b) = np.divmod(order[::2], 4), np.divmod(order[1::2], 4)
    how_a, how_b = _TO_END[side_a], _TO_START[side_b]
    end, start = _turned(corners[a], how_a)[:, 1], _turned(corners[b], how_b)[:, 0]
    back = (end != start).any(axis=1)
    if np.any(back & (end != start[:, ::-1]).any(axis=1)):
        return None
    edges = _Pairs(_turned(nets[a], how_a), owner[a], _turned(nets[b], how_b + 4 * back), owner[b])
    one, two = _corner_pairs(corners.reshape(-1, 4))
    c, d = one // 4, two // 4
    side_keys = np.sort(np.stack([a, b], axis=1), axis=1) @ [len(nets), 1]
    keys = np.minimum(c, d) * len(nets) + np.maximum(c, d)
    alone = ~np.isin(keys, side_keys)
    if (
        len(np.unique(side_keys)) < len(side_keys)
        or len(np.unique(keys[alone])) < np.count_nonzero(alone)
        or np.bincount(np.searchsorted(np.sort(side_keys), keys[~alone])).max(initial=0) > 2
        or np.any(c == d)
    ):
        return None
    one, two, c, d = one[alone] % 4, two[alone] % 4, c[alone], d[alone]
    tips = _Pairs(
        _turned(nets[c], 2 * (one // 2) + 4 * (one % 2)),
        owner[c],
        _turned(nets[d], 2 * (two // 2) + 4 * (two % 2)),
        owner[d],
    )
    near = np.concatenate([np.stack([a, b], axis=1), np.stack([c, d], axis=1)])
    return edges, tips, near


def _corner_pairs(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All pairs of entries of (m, 4) corner numbers that are equal, as flat positions."""
    order = np.argsort(corners.ravel(), kind="stable")
    number = corners.ravel()[order]
    start = np.flatnonzero(np.diff(number, prepend=number[0] - 1))
    size = np.diff(start, append=len(number))
    one, two = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
    for k in np.unique(size):
        first = start[size == k]
        for i, j in combinations(range(k), 2):
            one.append(order[first + i])
            two.append(order[first + j])
    return np.concatenate(one), np.concatenate(two)


def _points(nets: np.ndarray) -> np.ndarray:
    """Control points in space, (m, n * n, 3)."""
    points = nets[..., :3] if nets.shape[-1] == 3 else nets[..., :3] / nets[..., 3:]
    return points.reshape(len(nets), -1, 3)


def _far_pairs(nets: np.ndarray, owner: np.ndarray, near: np.ndarray) -> _Pairs:
    """Pairs of pieces without a common corner whose boxes meet."""
    points = _points(nets)
    pairs = np.sort(BoxTree(points.min(axis=1), points.max(axis=1)).self_pairs(), axis=1)
    keys = np.sort(near, axis=1) @ [len(nets), 1]
    a, b = pairs[~np.isin(pairs @ [len(nets), 1], keys)].T
    return _Pairs(nets[a], owner[a], nets[b], owner[b])


def _open_rows(test, pairs: _Pairs, gap: float) -> np.ndarray:
    """Rows that do not pass a test."""
    passed = np.zeros(len(pairs), dtype=bool)
    for start in range(0, len(pairs), _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, len(pairs)))
        passed[rows] = test(pairs.only(rows), gap)
    return np.flatnonzero(~passed)


def _slopes(nets: np.ndarray) -> list[np.ndarray]:
    """Unit vectors that span the cones of s_u and of s_v, each (m, k, 3); 0 where there is none."""
    found = []
    for axis in (1, 2):
        steps = np.diff(nets, axis=axis)
        if nets.shape[-1] == 4:
            # (A / w)' = (A' w - A w') / w^2; products in Bernstein form, up to positive factors
            steps = _product(steps[..., :3], nets[..., 3:]) - _product(
                steps[..., 3:], nets[..., :3]
            )
        steps = steps.reshape(len(nets), -1, 3)
        length = np.linalg.norm(steps, axis=2, keepdims=True)
        found.append(steps / np.maximum(length, 1e-300))
    return found


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of Bernstein nets, each coefficient times its own positive binomials."""

    def scaled(net: np.ndarray) -> np.ndarray:
        rows, columns = ([comb(n - 1, k) for k in range(n)] for n in net.shape[1:3])
        return net * np.multiply.outer(rows, columns)[..., None].astype(float)

    a, b = scaled(a), scaled(b)
    (p, q), (r, s) = a.shape[1:3], b.shape[1:3]
    out = np.zeros((len(a), p + r - 1, q + s - 1, 3))
    for i, j in np.ndindex(p, q):
        out[:, i : i + r, j : j + s] += a[:, i, j][:, None, None] * b
    return out


def _half_space(vectors: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Whether unit vectors (m, k, 3) all lie strictly on one side of a plane, (m,) bool."""
    guess = guess / np.maximum(np.linalg.norm(guess, axis=1, keepdims=True), 1e-300)
    found = np.einsum("mki,mi->mk", vectors, guess).min(axis=1) > MARGIN
    rows = np.flatnonzero(~found)
    if len(rows):
        found[rows] = in_half_space(vectors[rows], MARGIN)
    return found


def _cones_apart(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Whether the cone of u meets neither that of v nor that of -v (but in 0)."""
    a, b = u.mean(axis=1), v.mean(axis=1)
    apart = _half_space(np.concatenate([u, v], axis=1), a + b)
    rows = np.flatnonzero(apart)
    apart[rows] = _half_space(np.concatenate([u[rows], -v[rows]], axis=1), a[rows] - b[rows])
    return apart


def _single_passes(pairs: _Pairs, _gap: float) -> np.ndarray:
    return _cones_apart(*_slopes(pairs.first))


def _edge_passes(pairs: _Pairs, _gap: float) -> np.ndarray:
    (u, v), (u2, v2) = _slopes(pairs.first), _slopes(pairs.second)
    return _cones_apart(np.concatenate([u, u2], axis=1), np.concatenate([v, v2], axis=1))


def _tip_passes(pairs: _Pairs, _gap: float) -> np.ndarray:
    one = np.concatenate(_slopes(pairs.first), axis=1)
    two = np.concatenate(_slopes(pairs.second), axis=1)
    both = np.concatenate([one, -two], axis=1)
    return _half_space(both, one.mean(axis=1) - two.mean(axis=1))


def _far_passes(pairs: _Pairs, gap: float) -> np.ndarray:
    a, b = _points(pairs.first), _points(pairs.second)
    low = np.maximum(a.min(axis=1), b.min(axis=1))
    apart = (low - np.minimum(a.max(axis=1), b.max(axis=1)) > gap).any(axis=1)
    rows = np.flatnonzero(~apart)
    if not len(rows):
        return apart
    a, b = a[rows], b[rows]
    n = pairs.first.shape[1]
    axes = [b.mean(axis=1) - a.mean(axis=1)]
    for x in (a, b):
        across, along = x[:, n * n - 1] - x[:, 0], x[:, n * (n - 1)] - x[:, n - 1]
        axes.append(np.cross(across, along))
    axes.append(np.cross(axes[0], np.cross(axes[1], axes[0])))
    for axis in axes:
        axis = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-300)
        x, y = (np.einsum("mki,mi->mk", p, axis) for p in (a, b))
        gaps = np.maximum(x.min(axis=1) - y.max(axis=1), y.min(axis=1) - x.max(axis=1))
        apart[rows] |= gaps > gap
    return apart


_TESTS = (_single_passes, _edge_passes, _tip_passes, _far_passes)


def _halve_all(singles: _Pairs, edges: _Pairs, tips: _Pairs, far: _Pairs) -> list[_Pairs]:
    """Quarters of all pieces, and the pairs of quarters by what they have in common."""
    new: list[list[_Pairs]] = [[], [], [], []]
    if len(singles):
        q, o = _halved(singles.first), singles.owner
        for i, j in np.ndindex(2, 2):
            new[0].append(_Pairs(q[:, i, j], o))
        for i in range(2):
            new[1].append(_Pairs(q[:, 0, i], o, q[:, 1, i], o))
            one, two = (np.swapaxes(q[:, i, k], 1, 2) for k in (0, 1))
            new[1].append(_Pairs(one, o, two, o))
        new[2].append(_Pairs(q[:, 0, 0, ::-1, ::-1], o, q[:, 1, 1], o))
        new[2].append(_Pairs(q[:, 0, 1, ::-1], o, q[:, 1, 0][:, :, ::-1], o))
    if len(edges):
        a, b = _halved(edges.first), _halved(edges.second)
        who = edges.owner, edges.other
        for i in range(2):
            new[1].append(_Pairs(a[:, 1, i], who[0], b[:, 0, i], who[1]))
        new[2].append(_Pairs(a[:, 1, 0, ::-1, ::-1], who[0], b[:, 0, 1], who[1]))
        new[2].append(_Pairs(a[:, 1, 1, ::-1], who[0], b[:, 0, 0][:, :, ::-1], who[1]))
        touching = np.zeros((2, 2, 2, 2), dtype=bool)
        touching[1, :, 0, :] = True
        new[3] += _quarters_apart(a, b, *who, ~touching)
    if len(tips):
        a, b = _halved(tips.first), _halved(tips.second)
        who = tips.owner, tips.other
        new[2].append(_Pairs(a[:, 0, 0], who[0], b[:, 0, 0], who[1]))
        touching = np.zeros((2, 2, 2, 2), dtype=bool)
        touching[0, 0, 0, 0] = True
        new[3] += _quarters_apart(a, b, *who, ~touching)
    if len(far):
        everything = np.ones((2, 2, 2, 2), dtype=bool)
        new[3] += _quarters_apart(
            _halved(far.first), _halved(far.second), far.owner, far.other, everything
        )
    empty = _Pairs(singles.first[:0], singles.owner[:0])
    pair = _Pairs(singles.first[:0], singles.owner[:0], singles.first[:0], singles.owner[:0])
    return [_joined([pair if k else empty, *parts]) for k, parts in enumerate(new)]


def _quarters_apart(
    a: np.ndarray, b: np.ndarray, owner: np.ndarray, other: np.ndarray, wanted: np.ndarray
) -> list[_Pairs]:
    """Pairs of quarters (as the mask wants them) whose boxes meet."""
    boxes = []
    for q in (a, b):
        points = _points(q.reshape(-1, *q.shape[3:])).reshape(len(q), 2, 2, -1, 3)
        boxes.append((points.min(axis=3), points.max(axis=3)))
    low = np.maximum(boxes[0][0][:, :, :, None, None], boxes[1][0][:, None, None])
    high = np.minimum(boxes[0][1][:, :, :, None, None], boxes[1][1][:, None, None])
    m, i, j, k, n = np.nonzero((low <= high).all(axis=-1) & wanted)
    return [_Pairs(a[m, i, j], owner[m], b[m, k, n], other[m])]


def _joined(parts: list[_Pairs]) -> _Pairs:
    names = ("first", "owner") if parts[0].second is None else ("first", "owner", "second", "other")
    return _Pairs(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
