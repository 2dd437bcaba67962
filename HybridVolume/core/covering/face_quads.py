# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Triangles and quads of a mesher become quads: all are cut at the middles of their sides.

What a mesher gave is looked at face by face: a face counts where its sides on the rim are exactly
the intervals of its edges, all on one side of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..surface import SplineFace
from .edge_points import EdgePoints
from .face_checks import grid_quads, worst_corners
from .face_grids import regular_grid
from .flat_corners import opened_corners
from .geometry import project
from .mesher import Answer
from .outline import CORNER, Outline


@dataclass(frozen=True)
class FaceQuads:
    """Quads of one face.

    Attributes
    ----------
    quads : (m, 4) int array
        Corners, counterclockwise seen from outside. Points of edges have their numbers there, new
        points those behind.
    points : (n, 3) array
        New points inside, mm.
    worst : float
        The smallest sine of their corners; negative where a quad is turned over. Flat corners on
        the rim do not count: they will be cured.
    """

    quads: np.ndarray
    points: np.ndarray
    worst: float


def faces_of_answer(
    answer: Answer,
    outline: Outline,
    rims: EdgePoints,
    surfaces: Sequence[SplineFace],
    planar: np.ndarray,
) -> dict[int, FaceQuads]:
    """Quads on all faces that a mesher meshed as it was asked to.

    Parameters
    ----------
    answer : Answer
    outline : Outline
    rims : EdgePoints
    surfaces : sequence of SplineFace
    planar : (nf,) bool array
    """
    base = len(rims.points)
    corner = base + np.arange(len(answer.points))
    position = rims.first[answer.rim[:, 1]] + 2 * answer.rim[:, 3]
    inside = position < rims.first[answer.rim[:, 1] + 1]
    corner[answer.rim[inside, 2]] = rims.numbers[position[inside]]
    found = {}
    everywhere = np.concatenate([rims.points, answer.points])
    for face in np.unique(answer.face).tolist():
        elements = answer.elements[answer.face == face]
        named = np.where(elements >= 0, corner[elements], -1)
        coarse = _coedges(outline, rims, face, 2)
        named = opened_corners(named, coarse[:, :2], _smooth(outline, rims, face), everywhere)
        cut = _cut(named, coarse, base + len(answer.points))
        if cut is None:
            continue
        quads, ends, weights = cut
        new = np.einsum("kc,kcd->kd", weights, everywhere[ends])
        if not planar[face] and len(new):
            new = project(surfaces[face], new)[1]
        found[face] = _numbered(quads, base, np.concatenate([answer.points, new]), rims, outline,
                                face)  # fmt: skip
    return found


def grid_of_face(
    face: int,
    sides: Sequence[np.ndarray],
    outline: Outline,
    rims: EdgePoints,
    surface: SplineFace,
    planar: bool,
) -> FaceQuads | None:
    """A regular grid on a four-sided face; None where opposite sides differ.

    Parameters
    ----------
    face : int
    sides : sequence of int arrays
        Edges of its four sides in their order.
    outline : Outline
    rims : EdgePoints
    surface : SplineFace
    planar : bool
    """
    own = outline.face == face
    forward = dict(zip(outline.edge[own].tolist(), outline.forward[own].tolist(), strict=True))
    chains = []
    for side in sides:
        parts = [rims.along(edge)[:: 1 if forward[edge] else -1] for edge in side.tolist()]
        if any(a[-1] != b[0] for a, b in zip(parts, parts[1:], strict=False)):
            return None
        chains.append(np.concatenate([parts[0], *(part[1:] for part in parts[1:])]))
    if any(chains[k - 1][-1] != chains[k][0] for k in range(4)):
        return None
    if any(len(chains[k]) != len(chains[k + 2]) for k in range(2)):
        return None
    grid = regular_grid([rims.points[chain] for chain in chains], surface, planar)
    base = len(rims.points)
    numbers = base + np.arange(grid[..., 0].size).reshape(grid.shape[:2])
    bottom, right, top, left = chains
    numbers[:, 0], numbers[-1], numbers[:, -1], numbers[0] = bottom, right, top[::-1], left[::-1]
    return _numbered(grid_quads(numbers), base, grid.reshape(-1, 3), rims, outline, face)


def _coedges(outline: Outline, rims: EdgePoints, face: int, step: int) -> np.ndarray:
    """Parts of the rim of a face as it runs: from, to, and the point between, (k, 3)."""
    own = np.flatnonzero(outline.face == face)
    rows = []
    for edge, forward in zip(outline.edge[own].tolist(), outline.forward[own].tolist(),
                             strict=True):  # fmt: skip
        along = rims.along(edge)[:: 1 if forward else -1]
        rows.append(np.column_stack([along[:-step:step], along[step::step], along[1::step]]))
    return np.concatenate(rows)


def _smooth(outline: Outline, rims: EdgePoints, face: int) -> np.ndarray:
    """Points of the rim of a face at which it goes on smoothly."""
    found, sharp = [], []
    for k in np.flatnonzero(outline.face == face).tolist():
        along = rims.along(int(outline.edge[k]))
        found.append(along)
        if abs(outline.corner[k]) > CORNER:
            sharp.append(along[-1 if outline.forward[k] else 0])
    return np.setdiff1d(np.concatenate(found), sharp)


def _cut(
    elements: np.ndarray, rim: np.ndarray, base: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Cut triangles and quads of a face at the middles of their sides.

    Parameters
    ----------
    elements : (m, 4) int array
        -1 at the end of triangles.
    rim : (k, 3) int array
        See :func:`_coedges`.
    base : int
        New points are numbered from here on.

    Returns
    -------
    quads : (n, 4) int array
    ends : (p, 4) int array
        Points that the new ones are made from,
    weights : (p, 4) array
        and their shares. None altogether where the sides on the rim are not the rim's.
    """
    three = elements[:, 3] < 0
    last = np.where(three, elements[:, 0], elements[:, 3])
    closed = np.column_stack([elements[:, :3], last])
    ahead = np.column_stack([closed[:, 1:], closed[:, 0]])
    there = np.ones(closed.shape, dtype=bool)
    there[three, 3] = False
    one, other = closed[there], ahead[there]
    size = int(max(one.max(), rim.max())) + 1
    if np.any(one == other):
        return None
    directed = one * size + other
    backward = other * size + one
    lone = ~np.isin(directed, backward)
    if len(np.unique(directed)) != len(directed):
        return None
    asked = rim[:, 0] * size + rim[:, 1]
    if len(np.unique(asked)) != len(asked) or np.isin(rim[:, 1] * size + rim[:, 0], asked).any():
        return None
    turned = False
    if not np.array_equal(np.sort(directed[lone]), np.sort(asked)):
        if not np.array_equal(np.sort(backward[lone]), np.sort(asked)):
            return None
        turned = True
    low, high = np.minimum(one, other), np.maximum(one, other)
    keys, first, side = np.unique(low * size + high, return_index=True, return_inverse=True)
    rim_keys = rim[:, :2].min(axis=1) * size + rim[:, :2].max(axis=1)
    place = np.searchsorted(keys, rim_keys)
    new = np.ones(len(keys), dtype=bool)
    new[place] = False
    middle = np.empty(len(keys), dtype=int)
    middle[new] = base + np.arange(new.sum())
    middle[place] = rim[:, 2]
    centre = base + int(new.sum()) + np.arange(len(elements))
    at = np.full(closed.shape, -1)
    at[there] = middle[side]
    behind = np.column_stack([np.where(three, at[:, 2], at[:, 3]), at[:, :3]])
    quads = np.stack([closed, at, np.broadcast_to(centre[:, None], closed.shape), behind], axis=2)
    quads = quads[there]
    ends = np.zeros((int(new.sum()) + len(elements), 4), dtype=int)
    weights = np.zeros(ends.shape)
    inner = first[new]
    ends[: len(inner), 0], ends[: len(inner), 1] = one[inner], other[inner]
    weights[: len(inner), :2] = 0.5
    ends[len(inner) :] = closed
    weights[len(inner) :] = np.where(there, 1.0 / there.sum(axis=1, keepdims=True), 0.0)
    return quads[:, ::-1] if turned else quads, ends, weights


def _numbered(
    quads: np.ndarray,
    base: int,
    points: np.ndarray,
    rims: EdgePoints,
    outline: Outline,
    face: int,
) -> FaceQuads:
    """Quads with new points numbered from the last point of an edge on, and their quality."""
    used, inverse = np.unique(quads, return_inverse=True)
    fixed = used < base
    number = np.where(fixed, used, base + np.cumsum(~fixed) - 1)
    own = points[used[~fixed] - base]
    quads = number[inverse].reshape(-1, 4)
    rim = _coedges(outline, rims, face, 1)[:, :2]
    worst = worst_corners(np.concatenate([rims.points, own]), quads, rim)
    return FaceQuads(quads, own, float(worst.min()))
