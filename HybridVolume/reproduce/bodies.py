# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies that are made here, and what is known about their midstructures without any computation.

Lengths are mm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss

from HybridVolume.core.covering.spheres import sphere_faces
from HybridVolume.core.surface import SplineFace


@dataclass(frozen=True)
class ExactBody:
    """A body whose midstructure is known.

    Attributes
    ----------
    name : str
    faces : tuple of SplineFace
    off : callable
        Distance, mm, of (k, 3) points from the plane, surface, line or point on which the
        midstructure lies.
    place : str
        Its name.
    area : float
        Of what is kept automatically, mm²; not a number where it is a matter of judgement.
    length : float
        Of a line, mm; not a number for sheets.
    along : callable, optional
        Length along the line, mm, of the points on it that are nearest to (k, 3) points.
    size : float
        Half of the thickness, mm: deviations are told in units of it.
    options : dict
        Of :class:`HybridVolume.core.pipeline.Options`.
    """

    name: str
    faces: tuple[SplineFace, ...]
    off: Callable[[np.ndarray], np.ndarray]
    place: str
    area: float = float("nan")
    length: float = float("nan")
    along: Callable[[np.ndarray], np.ndarray] | None = None
    size: float = 1.0
    options: dict[str, Any] = field(default_factory=dict)


def exact_bodies() -> list[ExactBody]:
    """All of them, the automatic midstructure first."""
    block = box((4.0, 2.0, 1.0), (8, 4, 2))
    middle = ExactBody("box", block, lambda x: np.abs(x[:, 2] - 0.5), "mid plane", 3.0, size=0.5)
    turn = _rotation((1.0, 2.0, 3.0), 0.7)
    plate = box((50.0, 50.0, 1.0), (12, 12, 1))
    bracketed = bracket_area(1.0, 5.0, 4.0)
    return [
        middle,
        _moved(middle, "box-small", 1e-3 * np.eye(3)),
        _moved(middle, "box-large", 1e3 * np.eye(3)),
        _moved(middle, "box-turned", turn),
        _moved(middle, "box-far", np.eye(3), np.array([3e3, -2e3, 1e3])),
        ExactBody(
            "plate", plate, lambda x: np.abs(x[:, 2] - 0.5), "mid plane", 49.0**2, size=0.5
        ),
        ExactBody(
            "bracket", bracket(1.0, 5.0, 4.0), _off_bracket, "mid planes", bracketed, size=0.5
        ),
        ExactBody("wedge", wedge(20.0), _off_bisector, "bisector", size=0.45),
        ExactBody(
            "ring", ring(2.0, 3.0, 3.0), lambda x: np.abs(_across(x) - 2.5), "mid cylinder",
            2.0 * np.pi * 2.5 * 2.0, size=0.5,
        ),
        ExactBody("cylinder", cylinder(1.0, 6.0), _across, "axis", length=4.0, along=_height),
        ExactBody(
            "torus", torus(3.0, 1.0), _off_circle, "centre circle",
            length=6.0 * np.pi, along=_around,
        ),
        ExactBody("sphere", sphere(1.0), lambda x: np.linalg.norm(x, axis=1), "centre", 0.0),
        ExactBody(
            "torus-skeleton", torus(3.0, 1.0), _off_circle, "centre circle",
            length=6.0 * np.pi, along=_around, options={"midstructure": "skeleton"},
        ),
        ExactBody(
            "cylinder-skeleton", cylinder(1.0, 6.0), _across, "axis",
            length=4.0, along=_height, options={"midstructure": "skeleton"},
        ),
        ExactBody(
            "box-distance", block, lambda x: np.abs(_depth(x, (4.0, 2.0, 1.0)) - 0.25),
            "depth .25", 15.5, size=0.5, options={"midstructure": "distance", "depth": "50%"},
        ),
    ]  # fmt: skip


def bracket_area(thickness: float, leg: float, width: float) -> float:
    """Area of the kept sheets of an L: two mid planes, and where they turn round the inner edge.

    There the sheet is a parabolic cylinder, of equal distance to the inner edge and the outer
    face; at the ends it stays its own distance from the faces.

    Parameters
    ----------
    thickness, leg, width : float
        mm; legs are measured outside.
    """
    flat = (leg - 1.5 * thickness) * (width - thickness)
    # with s = 1 - x / t, the distance to both is t (1 + s²) / 2, from s = 0 to the diagonal
    at, weight = leggauss(20)
    s = 0.5 * (at + 1.0) * (np.sqrt(2.0) - 1.0)
    weight = 0.5 * weight * (np.sqrt(2.0) - 1.0)
    strip = thickness * np.sqrt(1.0 + s**2) * (width - thickness * (1.0 + s**2))
    return float(2.0 * (flat + weight @ strip))


# ------------------------------------------------------------------ where the midstructures lie


def _across(x: np.ndarray) -> np.ndarray:
    """Distance from the z axis."""
    return np.hypot(x[:, 0], x[:, 1])


def _height(x: np.ndarray) -> np.ndarray:
    return x[:, 2]


def _around(x: np.ndarray) -> np.ndarray:
    return 3.0 * np.arctan2(x[:, 1], x[:, 0])


def _off_circle(x: np.ndarray) -> np.ndarray:
    return np.hypot(_across(x) - 3.0, x[:, 2])


def _off_bisector(x: np.ndarray) -> np.ndarray:
    half = np.radians(10.0)
    return np.abs(x[:, 1] * np.cos(half) - x[:, 0] * np.sin(half))


def _off_bracket(x: np.ndarray) -> np.ndarray:
    """Difference of the distances to the two sides of the wall, halved."""
    inner = np.where(
        (x[:, 0] < 1.0) & (x[:, 1] < 1.0),
        np.hypot(1.0 - x[:, 0], 1.0 - x[:, 1]),
        np.where(x[:, 0] >= 1.0, 1.0 - x[:, 1], 1.0 - x[:, 0]),
    )
    outer = np.where(
        (x[:, 0] < 1.0) & (x[:, 1] < 1.0),
        np.minimum(x[:, 0], x[:, 1]),
        np.where(x[:, 0] >= 1.0, x[:, 1], x[:, 0]),
    )
    return 0.5 * np.abs(inner - outer)


def _depth(x: np.ndarray, size: Sequence[float]) -> np.ndarray:
    """Distance of points in a box to its surface."""
    return np.minimum(x, np.asarray(size) - x).min(axis=1)


def _rotation(axis: Sequence[float], angle: float) -> np.ndarray:
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def _moved(body: ExactBody, name: str, matrix: np.ndarray, shift: Any = 0.0) -> ExactBody:
    """The body under a similarity."""
    scale = abs(np.linalg.det(matrix)) ** (1.0 / 3.0)
    back = np.linalg.inv(matrix)
    return replace(
        body,
        name=name,
        faces=tuple(
            replace(f, control_points=f.control_points @ matrix.T + shift) for f in body.faces
        ),
        off=lambda x: scale * body.off((x - shift) @ back.T),
        area=body.area * scale**2,
        length=body.length * scale,
        size=body.size * scale,
    )


# ------------------------------------------------------------------------------------- faces


def _named(faces: Sequence[SplineFace]) -> tuple[SplineFace, ...]:
    return tuple(replace(face, name=f"Face{k + 1}") for k, face in enumerate(faces))


def _bilinear(corners: Any, spans: tuple[int, int] = (2, 2)) -> SplineFace:
    """Biquadratic B-spline of a bilinear face; corners are indexed by u, then v."""
    corners = np.asarray(corners, dtype=float)
    knots, lines = [], []
    for n in spans:
        inner = np.arange(1, n) / n
        knot = np.concatenate([np.zeros(3), inner, np.ones(3)])
        knots.append(knot)
        lines.append(0.5 * (knot[1:-2] + knot[2:-1]))
    u, v = lines[0][:, None, None], lines[1][None, :, None]
    low, high = ((1.0 - v) * row[0] + v * row[1] for row in corners)
    points = (1.0 - u) * low + u * high
    return SplineFace("", (2, 2), (knots[0], knots[1]), points, np.ones(points.shape[:2]))


def _bezier(points: Any, weights: np.ndarray) -> SplineFace:
    points = np.asarray(points, dtype=float)
    degrees = (points.shape[0] - 1, points.shape[1] - 1)
    knots = tuple(np.repeat([0.0, 1.0], p + 1) for p in degrees)
    return SplineFace("", degrees, knots, points, np.asarray(weights, dtype=float))


def box(size: Sequence[float], spans: Sequence[int]) -> tuple[SplineFace, ...]:
    """Six biquadratic faces; spans along x, y and z."""
    faces = []
    for axis in range(3):
        a, b = (k for k in range(3) if k != axis)
        for end in (0, 1):
            corners = np.zeros((2, 2, 3))
            corners[..., axis] = end
            corners[1, :, a] = 1
            corners[:, 1, b] = 1
            faces.append(_bilinear(corners * np.asarray(size), (spans[a], spans[b])))
    return _named(faces)


def prism(quads: Sequence[Any], height: float, spans: int = 2) -> tuple[SplineFace, ...]:
    """Prism over quadrilaterals, corners counter-clockwise; every face has spans x spans."""
    faces, sides = [], {}
    cells = (spans, spans)
    for quad in (np.asarray(q, dtype=float) for q in quads):
        for z in (0.0, height):
            x = np.column_stack([quad, np.full(4, z)])
            faces.append(_bilinear([[x[0], x[3]], [x[1], x[2]]], cells))
        for k in range(4):
            a, b = quad[k], quad[(k + 1) % 4]
            key = frozenset((tuple(np.round(a, 9)), tuple(np.round(b, 9))))
            if sides.pop(key, None) is None:
                sides[key] = (a, b)
    for a, b in sides.values():
        faces.append(_bilinear([[[*a, 0.0], [*a, height]], [[*b, 0.0], [*b, height]]], cells))
    return _named(faces)


def bracket(thickness: float, leg: float, width: float) -> tuple[SplineFace, ...]:
    """L of two plates."""
    t, a = thickness, leg
    corner = [(0, 0), (t, 0), (t, t), (0, t)]
    return prism(
        [corner, [(t, 0), (a, 0), (a, t), (t, t)], [(0, t), (t, t), (t, a), (0, a)]], width
    )


def wedge(angle: float, spans: int = 2) -> tuple[SplineFace, ...]:
    """Prism over a right triangle with an edge of ``angle`` degrees."""
    a, b = np.zeros(2), np.array([3.0, 0.0])
    c = np.array([3.0, 3.0 * np.tan(np.radians(angle))])
    middle, ab, bc, ca = (a + b + c) / 3, (a + b) / 2, (b + c) / 2, (c + a) / 2
    return prism([[a, ab, middle, ca], [b, bc, middle, ab], [c, ca, middle, bc]], 2.0, spans)


def _arc(start: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Quadratic control points (3, 2) and weights (3,) of an arc of the unit circle."""
    angles = np.array([start, 0.5 * (start + end), end])
    cosine = np.cos(0.5 * (end - start))
    radii = np.array([1.0, 1.0 / cosine, 1.0])
    points = radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return points, np.array([1.0, cosine, 1.0])


def _revolved(curve: np.ndarray, weights: np.ndarray, start: float, end: float) -> SplineFace:
    """A curve of (radius, z) turned about z."""
    arc, arc_weights = _arc(start, end)
    points = np.empty((3, len(curve), 3))
    points[..., :2] = arc[:, None, :] * curve[None, :, :1]
    points[..., 2] = curve[:, 1]
    return _bezier(points, arc_weights[:, None] * weights)


_QUARTERS = [(k * np.pi / 2, (k + 1) * np.pi / 2) for k in range(4)]


def torus(major: float, minor: float) -> tuple[SplineFace, ...]:
    """Sixteen rational biquadratic faces about z."""
    faces = []
    for a, b in _QUARTERS:
        for c, d in _QUARTERS:
            section, weights = _arc(c, d)
            faces.append(_revolved(section * minor + np.array([major, 0.0]), weights, a, b))
    return _named(faces)


def ring(inner: float, outer: float, height: float) -> tuple[SplineFace, ...]:
    """A tube with walls, four quarters of four faces."""
    section = np.array([(inner, 0.0), (outer, 0.0), (outer, height), (inner, height)])
    return _named(
        [
            _revolved(section[[k, (k + 1) % 4]], np.ones(2), a, b)
            for a, b in _QUARTERS
            for k in range(4)
        ]
    )


def cylinder(radius: float, height: float) -> tuple[SplineFace, ...]:
    """Four rational sides; each cap is a square with four patches around it."""
    faces, corners = [], []
    for k in range(4):
        a, b = np.pi / 4 + k * np.pi / 2, 3 * np.pi / 4 + k * np.pi / 2
        faces.append(_revolved(np.array([(radius, 0.0), (radius, height)]), np.ones(2), a, b))
        arc, weights = _arc(a, b)
        ends = 0.5 * radius * np.array([[np.cos(a), np.sin(a)], [np.cos(b), np.sin(b)]])
        corners.append(ends[0])
        inner = np.array([ends[0], ends.mean(axis=0), ends[1]])
        for z in (0.0, height):
            rows = np.stack([inner, arc * radius], axis=1)
            points = np.concatenate([rows, np.full((3, 2, 1), z)], axis=2)
            faces.append(_bezier(points, np.stack([np.ones(3), weights], axis=1)))
    for z in (0.0, height):
        x = np.column_stack([corners, np.full(4, z)])
        faces.append(_bezier([[x[0], x[3]], [x[1], x[2]]], np.ones((2, 2))))
    return _named(faces)


def sphere(radius: float) -> tuple[SplineFace, ...]:
    """Six rational (4, 4) patches, see :func:`.sphere_faces`."""
    return _named([replace(face, exact=False) for face in sphere_faces(np.zeros(3), radius, "")])
