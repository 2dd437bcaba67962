# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Cut triangles where they cross each other, so that they share the vertices there."""

from __future__ import annotations

import logging

import numpy as np
from scipy.spatial import cKDTree

from ..intersection import self_intersections
from .closest import on_segments

log = logging.getLogger(__name__)

# Points nearer than this share of the extent are one.
SAME = 1e-7
# Crossing pairs beyond which nothing is cut: then it is a matter of noise, not of geometry.
MOST = 20_000


def conform(
    vertices: np.ndarray, triangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut triangles that cross or touch others, along the lines where they do.

    Each is cut by the planes of the triangles that it crosses; of triangles in one plane, what
    they have in common counts once. Then points on the sides of others become corners there.

    Parameters
    ----------
    vertices : (n, 3) array
        mm.
    triangles : (f, 3) int array

    Returns
    -------
    vertices : (n', 3) array
        The given ones first.
    triangles : (f', 3) int array
    parent : (f',) int array
        The triangle that each is a part of.
    """
    same = np.arange(len(triangles))
    pairs = self_intersections(vertices, triangles)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    if not len(pairs) or len(pairs) > MOST:
        return vertices, triangles, same
    extent = float(np.ptp(vertices[triangles], axis=(0, 1)).max())
    gap = SAME * extent
    cut = np.unique(pairs)
    others: dict[int, list[int]] = {int(f): [] for f in cut}
    for f, g in pairs.tolist():
        others[f].append(g)
        others[g].append(f)
    polygons, parent = [], []
    for f in cut.tolist():
        pieces = [vertices[triangles[f]]]
        for g in others[f]:
            x = vertices[triangles[g]]
            normal = np.cross(x[1] - x[0], x[2] - x[0])
            length = np.linalg.norm(normal)
            if length > 0.0:
                pieces = [
                    part for piece in pieces for part in _pieces(piece, x, normal / length, gap)
                ]
        polygons += pieces
        parent += [f] * len(pieces)
    points, number = _numbered(vertices, polygons, gap)
    # sides of untouched triangles may carry new points, too
    touched = np.zeros(len(triangles), dtype=bool)
    touched[cut] = True
    new = points[len(vertices) :]
    if len(new):
        beside = _beside(vertices, triangles, np.flatnonzero(~touched), new, gap)
        touched[beside] = True
        for f in beside.tolist():
            number.append(triangles[f].tolist())
            parent.append(f)
    rest = np.flatnonzero(~touched)
    tree = cKDTree(points)
    result, owner, centres = [], [], []
    seen = set()
    for polygon, f in zip(number, parent, strict=True):
        full = _with_points_on_sides(polygon, points, tree, gap)
        if frozenset(full) in seen:
            continue
        seen.add(frozenset(full))
        if len(full) == 3:
            result.append(full)
            owner.append(f)
        elif len(full) > 3:
            centre = len(points) + len(centres)
            centres.append(points[full].mean(axis=0))
            for a, b in zip(full, full[1:] + full[:1], strict=True):
                result.append([a, b, centre])
                owner.append(f)
    points = np.vstack([points, np.array(centres).reshape(-1, 3)])
    made = np.array(result, dtype=np.int64).reshape(-1, 3)
    log.info("%d facets of the midstructure cross: cut into %d", len(cut), len(made))
    return (
        points,
        np.vstack([triangles[rest], made]),
        np.append(rest, np.array(owner, dtype=np.int64)),
    )


def _pieces(
    piece: np.ndarray, other: np.ndarray, normal: np.ndarray, gap: float
) -> list[np.ndarray]:
    """Parts of a convex polygon, cut by a triangle: along its plane, or what lies in it."""
    if np.abs((piece - other[0]) @ normal).max() >= gap:
        above, below, line = _halves(piece, other[0], normal, gap)
        if len(above) and len(below) and _reaches(line, other, normal, gap):
            return [above, below]
        return [piece]
    parts, inside = [], piece
    for k in range(3):
        inward = np.cross(normal, other[(k + 1) % 3] - other[k])
        inside, outside, _ = _halves(inside, other[k], inward / np.linalg.norm(inward), gap)
        if not len(inside):
            return [piece]
        if len(outside):
            parts.append(outside)
    return [*parts, inside]


def _halves(
    piece: np.ndarray, origin: np.ndarray, normal: np.ndarray, gap: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts of a convex polygon before and behind a plane, and the points on it.

    A part without area is empty.
    """
    side = (piece - origin) @ normal
    side[np.abs(side) < gap] = 0.0
    nothing = np.zeros((0, 3))
    if side.min() >= 0.0:
        return piece, nothing, piece[side == 0.0]
    if side.max() <= 0.0:
        return nothing, piece, piece[side == 0.0]
    above, below, line = [], [], []
    after = zip(np.roll(piece, -1, axis=0), np.roll(side, -1), strict=True)
    for p, s, (q, t) in zip(piece, side, after, strict=True):
        if s >= 0.0:
            above.append(p)
        if s <= 0.0:
            below.append(p)
        if s == 0.0:
            line.append(p)
        if s * t < 0.0:
            middle = p + s / (s - t) * (q - p)
            above.append(middle)
            below.append(middle)
            line.append(middle)
    return np.array(above), np.array(below), np.array(line)


def _reaches(line: np.ndarray, other: np.ndarray, normal: np.ndarray, gap: float) -> bool:
    """Whether a segment in the plane of a triangle has a part in it."""
    for k in range(3):
        inward = np.cross(normal, other[(k + 1) % 3] - other[k])
        length = np.linalg.norm(inward)
        if length > 0.0 and ((line - other[k]) @ inward / length).max() < -gap:
            return False
    return True


def _numbered(
    vertices: np.ndarray, polygons: list[np.ndarray], gap: float
) -> tuple[np.ndarray, list[list[int]]]:
    """Points, the given vertices first, and the polygons by their numbers."""
    flat = np.concatenate(polygons)
    distance, near = cKDTree(vertices).query(flat)
    number = np.where(distance <= 10.0 * gap, near, -1)
    new = np.flatnonzero(number < 0)
    points = vertices
    if len(new):
        first = np.arange(len(new))
        for i, j in sorted(cKDTree(flat[new]).query_pairs(10.0 * gap)):
            first[j] = min(first[j], first[i])
        unique, label = np.unique(first, return_inverse=True)
        points = np.vstack([vertices, flat[new[unique]]])
        number[new] = len(vertices) + label.ravel()
    result, place = [], 0
    for polygon in polygons:
        mine = number[place : place + len(polygon)].tolist()
        place += len(polygon)
        result.append([i for k, i in enumerate(mine) if i != mine[k - 1]])
    return points, result


def _beside(
    vertices: np.ndarray, triangles: np.ndarray, which: np.ndarray, new: np.ndarray, gap: float
) -> np.ndarray:
    """Triangles among some on whose sides a new point lies."""
    if not len(which):
        return which
    tree = cKDTree(new)
    found = np.zeros(len(which), dtype=bool)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        p, q = vertices[triangles[which, a]], vertices[triangles[which, b]]
        reach = 0.5 * np.linalg.norm(q - p, axis=1) + 10.0 * gap
        near = tree.query_ball_point(0.5 * (p + q), reach)
        size = np.array([len(points) for points in near])
        if not size.any():
            continue
        row = np.repeat(np.arange(len(which)), size)
        point = new[np.concatenate([np.asarray(points, dtype=int) for points in near])]
        foot = on_segments(point, p[row], q[row])
        found[row[np.linalg.norm(foot - point, axis=1) <= 10.0 * gap]] = True
    return which[found]


def _with_points_on_sides(
    polygon: list[int], points: np.ndarray, tree: cKDTree, gap: float
) -> list[int]:
    """The polygon with all points that lie on its sides as corners."""
    result = []
    for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        p, q = points[a], points[b]
        length = float(np.linalg.norm(q - p))
        near = np.array(tree.query_ball_point(0.5 * (p + q), 0.5 * length + gap), dtype=int)
        near = near[(near != a) & (near != b)]
        along = (points[near] - p) @ (q - p) / max(length, 1e-300)
        off = np.linalg.norm(points[near] - p - along[:, None] * (q - p) / length, axis=1)
        on = (off <= 10.0 * gap) & (along > 10.0 * gap) & (along < length - 10.0 * gap)
        order = np.argsort(along[on], kind="stable")
        result += [a, *near[on][order].tolist()]
    return result
