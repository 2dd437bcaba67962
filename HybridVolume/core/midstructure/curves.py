# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Rims, seams and creases of a triangle complex: their corners, and their smoothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from .closest import Carrier
from .remesh import Remesher

# A curve that turns by more than this within a few edges has a corner there, degrees.
SHARP = 50.0
# How far along the curve the turning is looked for, in wanted lengths.
REACH = 1.5
# Edges along the curve that are looked at for it.
MOST = 60
# Steps of smoothing along curves, forward and back, which keep length and area (Taubin 1995).
STEPS = 8
FORWARD, BACK = 0.5, -0.53


def corners(mesh: Remesher) -> np.ndarray:
    """Vertices where a curve turns sharply, (n,) bool; ends and branches are not among them."""
    n = len(mesh.x)
    result = np.zeros(n, dtype=bool)
    neighbours, line = _neighbours(mesh)
    if not len(line):
        return result
    aim = []
    start, reach = mesh.x[line], REACH * mesh.h[line]
    for side in (0, 1):
        before, here = line.copy(), neighbours[line, side]
        for _ in range(MOST):
            go = (np.linalg.norm(mesh.x[here] - start, axis=1) < reach) & (neighbours[here, 0] >= 0)
            if not go.any():
                break
            pair = neighbours[here]
            following = np.where(pair[:, 0] == before, pair[:, 1], pair[:, 0])
            before, here = np.where(go, here, before), np.where(go, following, here)
        aim.append(mesh.x[here] - start)
    one, two = aim
    cosine = -np.einsum("ki,ki->k", one, two)
    cosine /= np.maximum(np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1), 1e-300)
    turning = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    sharp = np.flatnonzero(turning > SHARP)
    places, reach = mesh.x[line[sharp]], 1.2 * mesh.h[line[sharp]]
    near = cKDTree(places).query_ball_point(places, reach) if len(sharp) else ()
    free = np.ones(len(sharp), dtype=bool)
    for i in np.argsort(-turning[sharp], kind="stable"):
        if free[i]:
            free[near[i]] = False
            result[line[sharp[i]]] = True
    return result


def _neighbours(mesh: Remesher) -> tuple[np.ndarray, np.ndarray]:
    """The two neighbours along the curve, (n, 2), -1 for other vertices; and who has them."""
    n = len(mesh.x)
    edges, curve, degree = mesh.edges()
    ends = np.vstack([edges.ends[curve], edges.ends[curve][:, ::-1]])
    ends = ends[degree[ends[:, 0]] == 2]
    ends = ends[np.argsort(ends[:, 0], kind="stable")]
    result = np.full((n, 2), -1)
    line = ends[::2, 0]
    result[line] = ends[:, 1].reshape(-1, 2)
    return result, line


def smooth_curves(mesh: Remesher, back: Callable[[np.ndarray], np.ndarray]) -> Carrier:
    """Smooth all curves, corners fixed, and return them as something to come back to."""
    neighbours, line = _neighbours(mesh)
    line = line[~mesh.fixed[line]]
    if len(line):
        x = mesh.x.copy()
        for _ in range(STEPS):
            for share in (FORWARD, BACK):
                mean = x[neighbours[line]].mean(axis=1)
                x[line] += share * (mean - x[line])
        x[line] = back(x[line])
        mesh.move(x)
    edges, curve, _ = mesh.edges()
    ends = edges.ends[curve]
    return Carrier(mesh.x[ends[:, [0, 1, 1]]], 0.5 * mesh.h[ends].mean(axis=1))
