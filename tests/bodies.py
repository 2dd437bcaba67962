# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies of four-sided NURBS patches whose volume and genus are known without our own code.

Lengths are mm. Faces point anywhere: finding the outside is the work of the code under test.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np
from patches import Body, bezier_face, bilinear_face, make_body, represent, uniform_knots
from voxels import bent_voxels, random_voxels, voxel_genus

from HybridVolume.core.surface import SplineFace

__all__ = [
    "Body",
    "bent_voxels",
    "box",
    "cylinder",
    "hollow_sphere",
    "l_bracket",
    "plate",
    "prism",
    "random_voxels",
    "ring",
    "sphere",
    "torus",
    "voxel_genus",
    "wedge",
]


# --------------------------------------------------------------------- boxes, plates, prisms


def box(
    size: Sequence[float] = (3.0, 2.0, 1.0),
    spans: Sequence[int] = (12, 8, 4),
    degree: int = 2,
    corner: Sequence[float] = (0.0, 0.0, 0.0),
) -> Body:
    """Box of six patches."""
    size, corner = np.asarray(size, dtype=float), np.asarray(corner, dtype=float)
    knots = [uniform_knots(degree, n) for n in spans]
    faces = []
    for axis in range(3):
        a, b = (k for k in range(3) if k != axis)
        for end in (0, 1):
            corners = np.zeros((2, 2, 3))
            corners[..., axis] = end
            corners[1, :, a] = 1
            corners[:, 1, b] = 1
            faces.append(
                bilinear_face(corner + corners * size, (degree, degree), (knots[a], knots[b]))
            )
    return make_body(f"box {'x'.join(map(str, spans))} p{degree}", faces, size.prod())


def plate(side: float = 20.0, spans: int = 10, degree: int = 2) -> Body:
    """Square plate, 1 mm thick."""
    return box((side, side, 1.0), (spans, spans, 2), degree)


def prism(
    quads: Sequence[Sequence[Sequence[float]]],
    height: float,
    volume: float,
    *,
    name: str,
    degree: int = 2,
    spans: int = 2,
    genus: int = 0,
) -> Body:
    """Prism over a conforming quadrilateral mesh of a plane figure (counter-clockwise corners)."""
    knots = uniform_knots(degree, spans)
    degrees = (degree, degree)
    quads = [np.asarray(quad, dtype=float) for quad in quads]
    faces = []
    for quad in quads:
        for z in (0.0, height):
            x = np.column_stack([quad, np.full(4, z)])
            corners = [[x[0], x[3]], [x[1], x[2]]]
            faces.append(bilinear_face(corners, degrees, (knots, knots)))
    sides: dict[frozenset, tuple] = {}
    for quad in quads:
        for k in range(4):
            a, b = quad[k], quad[(k + 1) % 4]
            key = frozenset((tuple(np.round(a, 9)), tuple(np.round(b, 9))))
            if sides.pop(key, None) is None:
                sides[key] = (a, b)
    for a, b in sides.values():
        corners = [[[*a, 0.0], [*a, height]], [[*b, 0.0], [*b, height]]]
        faces.append(bilinear_face(corners, degrees, (knots, knots)))
    return make_body(name, faces, volume, (genus,))


def l_bracket(degree: int = 2, spans: int = 4) -> Body:
    """L of three unit cubes, with one re-entrant edge."""
    squares = [
        [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)] for x, y in ((0, 0), (1, 0), (0, 1))
    ]
    return prism(squares, 1.0, 3.0, name="L", degree=degree, spans=spans)


def wedge(angle: float = 20.0, degree: int = 2, spans: int = 4) -> Body:
    """Triangular prism with a sharp edge of ``angle`` degrees, each triangle cut in three quads."""
    length, width = 3.0, 2.0
    rise = length * np.tan(np.radians(angle))
    a, b, c = np.array([0.0, 0.0]), np.array([length, 0.0]), np.array([length, rise])
    centre = (a + b + c) / 3
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quads = [[a, ab, centre, ca], [b, bc, centre, ab], [c, ca, centre, bc]]
    volume = 0.5 * length * rise * width
    return prism(quads, width, volume, name=f"wedge {angle:g}", degree=degree, spans=spans)


# ---------------------------------------------------------------------------- exact rational


def _arc(start: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Quadratic control points (3, 2) and weights (3,) of an arc of the unit circle."""
    half = 0.5 * (end - start)
    angles = np.array([start, 0.5 * (start + end), end])
    radii = np.array([1.0, 1.0 / np.cos(half), 1.0])
    points = radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return points, np.array([1.0, np.cos(half), 1.0])


def _revolved(
    curve: np.ndarray, weights: np.ndarray, start: float, end: float
) -> tuple[np.ndarray, np.ndarray]:
    """Revolve a rational curve of (radius, z) about z: control points (3, n, 3), weights (3, n)."""
    arc, arc_weights = _arc(start, end)
    points = np.empty((3, len(curve), 3))
    points[..., :2] = arc[:, None, :] * curve[None, :, :1]
    points[..., 2] = curve[:, 1]
    return points, arc_weights[:, None] * weights


_QUARTERS = [(k * np.pi / 2, (k + 1) * np.pi / 2) for k in range(4)]


def _spanned(faces: list[SplineFace], spans: int) -> list[SplineFace]:
    if spans == 1:
        return faces
    return [represent(face, face.degrees, (spans, spans)) for face in faces]


def torus(major: float = 3.0, minor: float = 1.0, spans: int = 1) -> Body:
    """Torus of 16 rational (2, 2) patches."""
    faces = []
    for a, b in _QUARTERS:
        for c, d in _QUARTERS:
            section, weights = _arc(c, d)
            curve = section * minor + np.array([major, 0.0])
            faces.append(bezier_face(*_revolved(curve, weights, a, b)))
    return make_body("torus", _spanned(faces, spans), 2 * np.pi**2 * major * minor**2, (1,))


def ring(inner: float = 2.0, outer: float = 3.0, height: float = 1.0, spans: int = 1) -> Body:
    """Rectangle revolved about z: 16 rational (2, 1) patches, genus 1."""
    section = np.array([(inner, 0.0), (outer, 0.0), (outer, height), (inner, height)])
    faces = []
    for a, b in _QUARTERS:
        for k in range(4):
            curve = section[[k, (k + 1) % 4]]
            faces.append(bezier_face(*_revolved(curve, np.ones(2), a, b)))
    volume = np.pi * (outer**2 - inner**2) * height
    return make_body("ring", _spanned(faces, spans), volume, (1,))


def cylinder(radius: float = 1.0, height: float = 2.0, spans: int = 1) -> Body:
    """Cylinder: four rational sides, each cap a square in the middle and four patches around it."""
    side = 0.5 * radius
    faces = []
    for k in range(4):
        a, b = np.pi / 4 + k * np.pi / 2, 3 * np.pi / 4 + k * np.pi / 2
        wall = np.array([(radius, 0.0), (radius, height)])
        faces.append(bezier_face(*_revolved(wall, np.ones(2), a, b)))
        arc, weights = _arc(a, b)
        ends = side * np.array([[np.cos(a), np.sin(a)], [np.cos(b), np.sin(b)]])
        inner = np.array([ends[0], ends.mean(axis=0), ends[1]])
        for z in (0.0, height):
            rows = np.stack([inner, arc * radius], axis=1)
            points = np.concatenate([rows, np.full((3, 2, 1), z)], axis=2)
            faces.append(bezier_face(points, np.stack([np.ones(3), weights], axis=1)))
    corners = side * np.array([_arc(np.pi / 4 + k * np.pi / 2, 9.0)[0][0] for k in range(4)])
    for z in (0.0, height):
        x = np.column_stack([corners, np.full(4, z)])
        faces.append(bezier_face([[x[0], x[3]], [x[1], x[2]]]))
    return make_body("cylinder", _spanned(faces, spans), np.pi * radius**2 * height)


def _bernstein_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Bernstein coefficients of the product of two tensor-product polynomials."""

    def scaled(c: np.ndarray, sign: int) -> np.ndarray:
        for axis, size in enumerate(c.shape):
            factor = np.array([float(comb(size - 1, k)) for k in range(size)])
            shape = [1, 1]
            shape[axis] = size
            c = c * factor.reshape(shape) ** sign
        return c

    left, right = scaled(a, 1), scaled(b, 1)
    result = np.zeros((a.shape[0] + b.shape[0] - 1, a.shape[1] + b.shape[1] - 1))
    for (i, j), value in np.ndenumerate(left):
        result[i : i + b.shape[0], j : j + b.shape[1]] += value * right
    return scaled(result, -1)


_CUBE_SIDES = [
    np.array(rows, dtype=float)
    for rows in (
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    )
]
"""Rotations of the cube that take its top to each side."""


def _sphere_patch() -> tuple[np.ndarray, np.ndarray]:
    """Top patch of the unit sphere: control points (5, 5, 3) and weights (5, 5).

    Cobb's tiling: the sides lie on the planes of the cube's edges. In the plane of the
    stereographic projection they are arcs of radius sqrt(2) about (-1, 0) and its like, so that a
    biquadratic patch fills them; lifting squares its degree.
    """
    arc, weights = _arc(-np.pi / 12, np.pi / 12)
    right = arc * np.sqrt(2.0) + np.array([-1.0, 0.0])
    top = np.column_stack([-right[:, 1], right[:, 0]])[::-1]
    plane = np.zeros((3, 3, 2))
    plane[2], plane[0] = right, right * (-1.0, 1.0)
    plane[:, 2], plane[:, 0] = top, top * (1.0, -1.0)
    w = np.ones((3, 3))
    w[1, [0, 2]] = w[[0, 2], 1] = weights[1]
    w[1, 1] = weights[1] ** 2
    x, y = plane[..., 0] * w, plane[..., 1] * w
    squares = _bernstein_product(x, x) + _bernstein_product(y, y)
    ww = _bernstein_product(w, w)
    weight = ww + squares
    points = np.stack(
        [2 * _bernstein_product(x, w), 2 * _bernstein_product(y, w), ww - squares], axis=-1
    )
    return points / weight[..., None], weight


def _sphere_faces(radius: float, centre: Sequence[float]) -> list[SplineFace]:
    points, weights = _sphere_patch()
    centre = np.asarray(centre, dtype=float)
    return [bezier_face(radius * points @ turn.T + centre, weights) for turn in _CUBE_SIDES]


def sphere(radius: float = 1.0, spans: int = 1) -> Body:
    """Ball of six rational (4, 4) patches."""
    faces = _spanned(_sphere_faces(radius, (0, 0, 0)), spans)
    return make_body("sphere", faces, 4 / 3 * np.pi * radius**3)


def hollow_sphere(outer: float = 2.0, inner: float = 1.0, spans: int = 1) -> Body:
    """Ball with a concentric cavity: two shells. The cavity's faces come first."""
    faces = _sphere_faces(inner, (0, 0, 0)) + _sphere_faces(outer, (0, 0, 0))
    volume = 4 / 3 * np.pi * (outer**3 - inner**3)
    return make_body("hollow sphere", _spanned(faces, spans), volume, (0, 0))
