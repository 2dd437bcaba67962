# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies whose own surface is singular or folded somewhere, at places that are known."""

from __future__ import annotations

from dataclasses import replace

import bodies
import numpy as np
from patches import Body, bezier_face, make_body

from HybridVolume.core.bezier import bernstein
from HybridVolume.core.surface import SplineFace


def disc(z: float):
    """Unit disc as one rational patch: its four corners have 180 degrees."""
    s = np.sqrt(0.5)
    x = np.array([[(-s, -s), (-2 * s, 0), (-s, s)], [(0, -2 * s), (0, 0), (0, 2 * s)],
                  [(s, -s), (2 * s, 0), (s, s)]])  # fmt: skip
    w = np.array([[1, s, 1], [s, 1, s], [1, s, 1]])
    return np.concatenate([x, np.full((3, 3, 1), z)], axis=2), w


def pole(height: float = 2.0) -> Body:
    """Cylinder of six patches, caps of one patch each."""
    low, weights = disc(0.0)
    high, _ = disc(height)
    faces = [bezier_face(low, weights), bezier_face(high, weights)]
    for rim in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        walls = np.stack([low[rim], high[rim]], axis=1)
        faces.append(bezier_face(walls, np.repeat(weights[rim][:, None], 2, axis=1)))
    return make_body("pole", faces, np.pi * height)


KNOTS = np.array([0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0])
LINE = np.array([0.0, 0.0, 1.0, 1.0])


def doubled() -> Body:
    """Prism with one wall around a sharp corner: control points a, b, b, c on knots 0, 1/2, 1."""
    bent = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (1.0, 1.0)])
    straight = np.array([0.0, 0.5]) + np.array([[0.0], [0.25], [0.75], [1.0]]) * [0.5, 0.5]

    def ruled(first, second):
        return SplineFace("", (1, 2), (LINE, KNOTS), np.array([first, second]), np.ones((2, 4)))

    def lifted(curve, z):
        return np.column_stack([curve, np.full(len(curve), z)])

    faces = [ruled(lifted(curve, 0.0), lifted(curve, 1.0)) for curve in (bent, straight)]
    faces += [ruled(lifted(bent, z), lifted(straight, z)) for z in (0.0, 1.0)]
    for k in (0, -1):
        ends = np.array([bent[k], straight[k]])
        faces.append(bezier_face([lifted(ends, 0.0), lifted(ends, 1.0)]))
    return make_body("corner", faces, 0.625)


def folded(at: float, width: float) -> Body:
    """Cube whose top turns over in a strip of a width about u = at, v = 1/2, and nowhere else.

    There x_u is a multiple of (u - at)² - width²/4 for v = 1/2, and 1 on the sides.
    """
    body = bodies.box((1.0, 1.0, 1.0), (1, 1, 1), 3)
    u = np.linspace(0.0, 1.0, 4)

    def rise(x):
        return (x - at) ** 3 / 3.0 - 0.25 * width**2 * x

    profile = (rise(u) - rise(0.0)) / (rise(1.0) - rise(0.0))
    bump = 4.0 * u * (1.0 - u)
    x = u[:, None] + bump * (profile - u)[:, None]
    inverse = np.linalg.inv(bernstein(3, u))
    faces = list(body.faces)
    k = next(i for i, f in enumerate(faces) if np.all(f.control_points[..., 2] == 1.0))
    points = faces[k].control_points.copy()
    points[..., 0] = inverse @ x @ inverse.T
    faces[k] = replace(faces[k], control_points=points)
    return Body("folded", tuple(faces), 1.0, (0,))
