# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bad quads are opened by moving inner vertices: nearly flat or closed corners, shrunken sides.

Vertices on edges stay. A vertex takes the best of some places around it, judged by the worst
corner or side of the quads that have it; vertices of one quad never move at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..surface import SplineFace
from .geometry import project
from .quad_mesh import QuadCover

GOOD = 0.5
"""Vertices of quads with a corner whose sine is below this are moved (30 or 150 degrees)."""
TAPER = 2.5
"""Worth of the ratio of two opposite sides, as if it were a sine: below .2 vertices are moved."""
ROUNDS = 25
_DIRECTIONS = 8
_STEPS = (0.3, 0.1, 0.03)
"""Lengths of moves, as shares of the mean side beside the vertex."""


def relaxed(
    cover: QuadCover, surfaces: Sequence[SplineFace], kept: np.ndarray | None = None
) -> QuadCover:
    """Move inner vertices of quads with bad corners.

    Parameters
    ----------
    cover : QuadCover
    surfaces : sequence of SplineFace
        Of the outline's faces; vertices stay on these.
    kept : (m,) bool array, optional
        Quads whose corners stay where they are.
    """
    table = _Neighbours(cover)
    if kept is not None:
        table.free[cover.quads[kept]] = False
    points = cover.points.copy()
    normals = _normals(points[cover.quads])
    for _ in range(ROUNDS):
        worst = _worst(points[cover.quads], normals)
        vertices = np.unique(cover.quads[worst < GOOD])
        vertices = vertices[table.free[vertices]]
        if not len(vertices):
            break
        places, gain = table.best_places(points, normals, vertices)
        chosen = table.apart(vertices, gain)
        if not len(chosen):
            break
        moved = vertices[chosen]
        points[moved] = places[chosen]
        face = table.face[moved]
        for number in np.unique(face).tolist():
            own = moved[face == number]
            points[own] = project(surfaces[number], points[own])[1]
    return replace(cover, points=points)


def sines(corners: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Sines of the angles at corners of quads, (..., 4): negative where they are turned over.

    Parameters
    ----------
    corners : (..., 4, 3) array
    normals : (..., 3) array
        Of unit length.
    """
    ahead = np.roll(corners, -1, axis=-2) - corners
    behind = np.roll(corners, 1, axis=-2) - corners
    area = np.einsum("...cd,...d->...c", np.cross(ahead, behind), normals)
    length = np.linalg.norm(ahead, axis=-1) * np.linalg.norm(behind, axis=-1)
    return area / np.maximum(length, 1e-300)


def _worst(corners: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Worst corner of quads, or what their tapers are worth where that is less, (...)."""
    side = np.linalg.norm(np.roll(corners, -1, axis=-2) - corners, axis=-1)
    one, other = side[..., :2], side[..., 2:]
    taper = np.minimum(one, other) / np.maximum(np.maximum(one, other), 1e-300)
    return np.minimum(sines(corners, normals).min(axis=-1), TAPER * taper.min(axis=-1))


def _normals(corners: np.ndarray) -> np.ndarray:
    """Mean unit normals of quads."""
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)


class _Neighbours:
    """Quads around each vertex, as a table filled up with -1."""

    def __init__(self, cover: QuadCover) -> None:
        self.quads = cover.quads
        count = len(cover.points)
        corner = self.quads.ravel()
        order = np.argsort(corner, kind="stable")
        valence = np.bincount(corner, minlength=count)
        start = np.concatenate([[0], np.cumsum(valence)])
        self.around = np.full((count, valence.max()), -1)
        row = corner[order]
        self.around[row, np.arange(len(row)) - start[row]] = order // 4
        self.free = np.ones(count, dtype=bool)
        self.free[cover.rim] = False
        self.face = np.empty(count, dtype=int)
        self.face[corner] = np.repeat(cover.face, 4)

    def best_places(
        self, points: np.ndarray, normals: np.ndarray, vertices: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Best places of vertices, (m, 3), and how much the worst corner gains there, (m,)."""
        around = self.around[vertices]
        there = around >= 0
        quads = self.quads[around]  # (m, k, 4); rows that are not there count as the last quad
        corners = points[quads]
        own = quads == vertices[:, None, None]
        sides = np.linalg.norm(np.roll(corners, -1, axis=2) - corners, axis=3)
        size = np.where(there[..., None], sides, 0.0).sum(axis=(1, 2)) / (4 * there.sum(axis=1))
        normal = np.where(there[..., None], normals[around], 0.0).sum(axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        first = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
        # a vertex whose quads are folded has no normal, and gains nothing
        first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
        second = np.cross(normal, first)
        angle = np.arange(_DIRECTIONS) * (2.0 * np.pi / _DIRECTIONS)
        steps = np.concatenate(
            [[[0.0, 0.0]]]
            + [step * np.column_stack([np.cos(angle), np.sin(angle)]) for step in _STEPS]
        )
        moves = size[:, None, None] * (
            steps[None, :, :1] * first[:, None] + steps[None, :, 1:] * second[:, None]
        )
        trial = np.where(
            own[:, None, :, :, None], (points[vertices][:, None] + moves)[:, :, None, None],
            corners[:, None],
        )  # fmt: skip
        found = _worst(trial, normals[around][:, None])
        worst = np.where(there[:, None, :], found, np.inf).min(axis=2)
        best = worst.argmax(axis=1)
        rows = np.arange(len(vertices))
        return points[vertices] + moves[rows, best], worst[rows, best] - worst[:, 0]

    def apart(self, vertices: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """Rows of vertices that gain, and more than all others of their quads."""
        rank = np.zeros(len(self.face))
        order = np.argsort(gain, kind="stable")
        rank[vertices[order]] = np.arange(1, len(order) + 1)
        rank[vertices[gain <= 1e-9]] = 0.0
        highest = rank[self.quads].max(axis=1)
        around = self.around[vertices]
        best = np.where(around >= 0, highest[around], 0.0).max(axis=1)
        return np.flatnonzero((rank[vertices] > 0.0) & (rank[vertices] >= best))
