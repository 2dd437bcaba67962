# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Whole spheres as six exact patches."""

from __future__ import annotations

import numpy as np

from ..bezier import bernstein
from ..surface import SplineFace


def sphere_faces(centre: np.ndarray, radius: float, name: str) -> tuple[SplineFace, ...]:
    """Six rational patches of degree (4, 4) over the sides of a cube (Cobb's tiling).

    In the plane of the stereographic projection the sides of the top patch are arcs of radius √2
    about (-1, 0) and its like; a rational biquadratic patch fills them, and lifting it to the
    sphere squares its degree.

    Parameters
    ----------
    centre : (3,) array
        mm.
    radius : float
        mm.
    name : str
        Of the face that all six are of.
    """
    arc, weights = _arc()
    right = arc * np.sqrt(2.0) + np.array([-1.0, 0.0])
    top = np.column_stack([-right[:, 1], right[:, 0]])[::-1]
    plane, w = np.zeros((3, 3, 2)), np.ones((3, 3))
    plane[2], plane[0] = right, right * (-1.0, 1.0)
    plane[:, 2], plane[:, 0] = top, top * (1.0, -1.0)
    w[1, [0, 2]] = w[[0, 2], 1] = weights[1]
    w[1, 1] = weights[1] ** 2
    homogeneous = np.concatenate([plane * w[..., None], w[..., None]], axis=2)
    at = np.linspace(0.0, 1.0, 5)
    low, high = bernstein(2, at), np.linalg.inv(bernstein(4, at))
    x, y, z = np.einsum("ma,nb,abc->cmn", low, low, homogeneous)
    lifted = np.array([2.0 * x * z, 2.0 * y * z, z**2 - x**2 - y**2, z**2 + x**2 + y**2])
    net = np.einsum("am,bn,cmn->abc", high, high, lifted)
    points = radius * net[..., :3] / net[..., 3:]
    line = np.repeat([0.0, 1.0], 5)
    return tuple(
        SplineFace(
            name,
            (4, 4),
            (line, line.copy()),
            np.asarray(centre, dtype=float) + sign * points @ turn.T,
            net[..., 3].copy(),
            True,
        )
        for sign in (1.0, -1.0)
        for turn in (np.roll(np.eye(3), k, axis=1) for k in range(3))
    )


def _arc() -> tuple[np.ndarray, np.ndarray]:
    """Quadratic control points (3, 2) and weights (3,) of 30 degrees of the unit circle."""
    angles = np.array([-1.0, 0.0, 1.0]) * np.pi / 12.0
    cosine = np.cos(np.pi / 12.0)
    radii = np.array([1.0, 1.0 / cosine, 1.0])
    points = radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return points, np.array([1.0, cosine, 1.0])
