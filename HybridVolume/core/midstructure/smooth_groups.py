# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Groups of patches that join smoothly, and the sharp edges between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..surface import PatchSurface
from .points import evaluate_points

POINTS = 17


@dataclass(frozen=True)
class SmoothGroups:
    """Smooth groups of patches.

    Attributes
    ----------
    of_patch : (np,) int array
        Group of each patch.
    edge_pair : (e, 2) int array
        Groups on both sides of each sharp side, the lower number first; twice the same for a
        sharp line inside a patch.
    edge_points : (e, k, 3) array
        Points along it, mm.
    edge_convex : (e, k) bool array
        Whether the body is convex there.
    """

    of_patch: np.ndarray
    edge_pair: np.ndarray
    edge_points: np.ndarray
    edge_convex: np.ndarray


def _side_parameters(side: int, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    fixed = np.full(len(t), float(side % 2))
    return (fixed, t) if side < 2 else (t, fixed)


def smooth_groups(surface: PatchSurface, angle: float = 15.0) -> SmoothGroups:
    """Unite patches whose normals jump by less than ``angle`` degrees along their whole side."""
    t = np.linspace(0.0, 1.0, POINTS)
    count = len(surface.patches)
    sides = np.concatenate([np.column_stack(_side_parameters(side, t)) for side in range(4)])
    x, x_u, x_v = evaluate_points(
        surface, np.repeat(np.arange(count), len(sides)), np.tile(sides, (count, 1))
    )
    shape = (count, 4, POINTS, 3)
    points = x.reshape(shape)
    normals = np.cross(x_u, x_v).reshape(shape)
    inward = np.empty(shape)
    for side, across in enumerate((x_u, x_u, x_v, x_v)):
        inward[:, side] = across.reshape(shape)[:, side] * (1.0 if side % 2 == 0 else -1.0)
    for field in (normals, inward):
        field /= np.maximum(np.linalg.norm(field, axis=-1, keepdims=True), np.finfo(float).tiny)

    patch, side = (a.ravel() for a in np.indices((count, 4)))
    other, other_side = surface.neighbour[patch, side].T
    once = (other > patch) | ((other == patch) & (other_side > side))
    patch, side, other, other_side = (a[once] for a in (patch, side, other, other_side))
    turned = surface.reversed[patch, side][:, None, None]
    mine = normals[patch, side]
    theirs = normals[other, other_side]
    theirs = np.where(turned, theirs[:, ::-1], theirs)
    away = inward[other, other_side]
    away = np.where(turned, away[:, ::-1], away)
    cosine = np.einsum("eki,eki->ek", mine, theirs)
    convex = np.einsum("eki,eki->ek", mine, away) < 0.0
    # a corner may be singular on its own: the inner points decide
    smooth = np.median(cosine[:, 1:-1], axis=1) > np.cos(np.radians(angle))
    smooth &= (cosine[:, 1:-1] > np.cos(np.radians(2.0 * angle))).all(axis=1)
    graph = coo_matrix(
        (np.ones(int(smooth.sum())), (patch[smooth], other[smooth])), shape=(count, count)
    )
    _, group = connected_components(graph, directed=False)
    sharp = ~smooth
    pair = np.sort(np.column_stack([group[patch[sharp]], group[other[sharp]]]), axis=1)
    crease_patch, crease_points, crease_convex = _creases(surface, t, angle)
    return SmoothGroups(
        group,
        np.vstack([pair, np.repeat(group[crease_patch][:, None], 2, axis=1)]),
        np.concatenate([points[patch[sharp], side[sharp]], crease_points]),
        np.concatenate([convex[sharp], crease_convex]),
    )


def _creases(
    surface: PatchSurface, t: np.ndarray, angle: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sharp lines inside patches, where a knot is as often as the degree: patch, points, convex."""
    patches, lines, convex = [], [], []
    for stack in surface.stacks:
        places = []
        for direction in (0, 1):
            values, count = np.unique(stack.knots[direction], return_counts=True)
            sharp = values[1:-1][count[1:-1] >= stack.degrees[direction]]
            places += [(direction, value) for value in sharp]
        for k in stack.members if places else ():
            for direction, value in places:
                jump = []
                for at in (value - 1e-9, value + 1e-9):
                    uv = (np.full(len(t), at), t) if direction == 0 else (t, np.full(len(t), at))
                    x, x_u, x_v = surface.evaluate(k, *uv, derivative=1)
                    normal = np.cross(x_u, x_v)
                    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
                    jump.append((normal, (x_u, x_v)[direction], x))
                cosine = np.einsum("ki,ki->k", jump[0][0], jump[1][0])
                if np.median(cosine) < np.cos(np.radians(angle)):
                    patches.append(k)
                    lines.append(jump[1][2])
                    convex.append(np.einsum("ki,ki->k", jump[0][0], jump[1][1]) < 0.0)
    return (
        np.array(patches, dtype=np.int64),
        np.array(lines).reshape(-1, len(t), 3),
        np.array(convex, dtype=bool).reshape(-1, len(t)),
    )
