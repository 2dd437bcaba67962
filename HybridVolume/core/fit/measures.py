# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How far a fitted surface is from its reference, how much it turns, and how its corners are."""

from __future__ import annotations

import numpy as np

from ..cones import most_inward
from ..midstructure.distances import SurfaceDistance
from ..surface import PatchSurface
from .patches import Sampled
from .reference import Reference

_LINE = (np.arange(12) + 0.5) / 12
"""Where patches are compared with the reference, a quad."""
_SPAN = np.linspace(0.0, 1.0, 7)
"""Where normals are looked at, a knot span."""


def distances(
    surface: PatchSurface, made: Sampled, goal: Reference
) -> tuple[list[np.ndarray], float]:
    """Largest distance at each quad of each patch, either way, (m, n), mm, and the mean."""
    places = [
        tuple((a[:-1, None] + np.diff(a)[:, None] * _LINE).ravel() / a[-1] for a in lines)
        for lines in made.lines
    ]
    patch, u, v = _grids(places)
    points = surface.evaluate_at(patch, u, v)
    away = np.linalg.norm(points - goal.nearest(points)[0], axis=1)
    # the other way: nothing of the reference may be left out
    feet = SurfaceDistance(surface).nearest(goal.vertices)
    off, start = [], 0
    for k, lines in enumerate(made.lines):
        shape = (len(lines[0]) - 1, len(_LINE), len(lines[1]) - 1, len(_LINE))
        count = int(np.prod(shape))
        largest = away[start : start + count].reshape(shape).max(axis=(1, 3))
        start += count
        rows = np.flatnonzero(feet.patch == k)
        cell = [
            np.clip(np.searchsorted(a / a[-1], feet.uv[rows, axis], "right") - 1, 0, len(a) - 2)
            for axis, a in enumerate(lines)
        ]
        np.maximum.at(largest, tuple(cell), feet.distance[rows])
        off.append(largest)
    return off, float(away.mean())


def widest_cone(surface: PatchSurface) -> float:
    """Half the opening of the widest cone of normals of a knot span, degrees."""
    samples = surface.element_samples(_SPAN, _SPAN)
    _, along_u, along_v = samples.surface(surface.control_points)
    normal = np.cross(along_u, along_v)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    flat = normal.reshape(-1, len(_SPAN) ** 2, 3)
    middle = most_inward(flat, np.ones(flat.shape[:2], dtype=bool))
    least = np.einsum("eki,ei->ek", flat, middle).min()
    return float(np.degrees(np.arccos(np.clip(least, -1.0, 1.0))))


def corner_angles(surface: PatchSurface) -> np.ndarray:
    """Angles between the sides at the four corners of each patch, (patches, 4), degrees."""
    places = [tuple(knots[[0, -1]] for knots in patch.knots) for patch in surface.patches]
    _, u, v = surface.evaluate_at(*_grids(places), 1)
    u = u.reshape(-1, 4, 3) * np.array([1.0, 1.0, -1.0, -1.0])[:, None]
    v = v.reshape(-1, 4, 3) * np.array([1.0, -1.0, 1.0, -1.0])[:, None]
    sine = np.linalg.norm(np.cross(u, v), axis=2)
    return np.degrees(np.arctan2(sine, (u * v).sum(axis=2)))


def _grids(
    places: list[tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patch, u and v of the grids over some parameters of each patch."""
    count = [len(u) * len(v) for u, v in places]
    at_u = np.concatenate([np.repeat(u, len(v)) for u, v in places])
    at_v = np.concatenate([np.tile(v, len(u)) for u, v in places])
    return np.repeat(np.arange(len(places)), count), at_u, at_v
