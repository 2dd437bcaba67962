# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The same bodies written in another way, and bodies that are broken on purpose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from bodies import box
from patches import Body, bezier_face, interpolating_face, make_body, represent, uniform_knots

from HybridVolume.core.surface import SplineFace

# ------------------------------------------------------------------ the same body, otherwise


def turned(face: SplineFace, flip_u: bool, flip_v: bool, transpose: bool) -> SplineFace:
    """The same face with its parameters reversed or exchanged."""
    points, weights, knots = face.control_points, face.weights, list(face.knots)
    for axis, flip in enumerate((flip_u, flip_v)):
        if flip:
            points, weights = np.flip(points, axis), np.flip(weights, axis)
            knots[axis] = (knots[axis][0] + knots[axis][-1] - knots[axis])[::-1]
    degrees = face.degrees
    if transpose:
        points, weights = points.swapaxes(0, 1), weights.T
        degrees, knots = degrees[::-1], knots[::-1]
    return replace(
        face, degrees=degrees, knots=tuple(knots), control_points=points, weights=weights
    )


def turned_faces(body: Body, seed: int = 0) -> Body:
    """Every face with randomly reversed and exchanged parameters."""
    rng = np.random.default_rng(seed)
    faces = [turned(face, *(rng.random(3) < 0.5)) for face in body.faces]
    return replace(body, name=body.name + " turned", faces=tuple(faces))


def scaled_weights(body: Body, seed: int = 0) -> Body:
    """Every face's weights times a factor of its own."""
    factors = np.exp(np.random.default_rng(seed).uniform(-1.0, 1.0, len(body.faces)))
    faces = [replace(f, weights=f.weights * c) for f, c in zip(body.faces, factors, strict=True)]
    return replace(body, name=body.name + " scaled weights", faces=tuple(faces))


def shifted_knots(body: Body, seed: int = 0) -> Body:
    """Every face's knots on a range of its own."""
    rng = np.random.default_rng(seed)
    faces = []
    for face in body.faces:
        low, size = rng.uniform(-5, 5, 2), rng.uniform(0.1, 10, 2)
        knots = tuple(a + s * t for a, s, t in zip(low, size, face.knots, strict=True))
        # rounding must not tear the clamped ends apart
        knots = tuple(_clamped(t, p) for t, p in zip(knots, face.degrees, strict=True))
        faces.append(replace(face, knots=knots))
    return replace(body, name=body.name + " shifted knots", faces=tuple(faces))


def _clamped(knots: np.ndarray, degree: int) -> np.ndarray:
    return np.concatenate(
        [
            np.full(degree + 1, knots[0]),
            knots[degree + 1 : -degree - 1],
            np.full(degree + 1, knots[-1]),
        ]
    )


def mixed_splines(body: Body, seed: int = 0, raise_by: int = 2, spans: int = 3) -> Body:
    """One-span faces, each with random degrees and uniform spans of its own."""
    rng = np.random.default_rng(seed)
    faces = []
    for face in body.faces:
        degrees = tuple(int(p + rng.integers(0, raise_by + 1)) for p in face.degrees)
        faces.append(represent(face, degrees, tuple(rng.integers(1, spans + 1, 2))))
    return replace(body, name=body.name + " mixed splines", faces=tuple(faces))


# ------------------------------------------------------------------------- broken on purpose


def missing_face() -> Body:
    """Box without its third face."""
    whole = box(spans=(2, 2, 2))
    faces = whole.faces[:2] + whole.faces[3:]
    return replace(whole, name="missing face", faces=faces)


def gap(size: float) -> Body:
    """Box 3 x 2 x 1 whose sixth face (the top) floats ``size`` mm above its sides."""
    whole = box(spans=(2, 2, 2))
    top = whole.faces[5]
    lifted = replace(top, control_points=top.control_points + np.array([0.0, 0.0, size]))
    return replace(whole, name="gap", faces=whole.faces[:5] + (lifted,))


def t_junction() -> Body:
    """Box whose top is two faces, while the faces beside it are not split."""
    whole = box(spans=(1, 1, 1), degree=1)
    top = whole.faces[5].control_points
    middle = top.mean(axis=0, keepdims=True)
    halves = [
        np.concatenate([top[:1], middle]),
        np.concatenate([middle, top[1:]]),
    ]
    parts = [replace(whole.faces[5], control_points=points) for points in halves]
    return make_body("T-junction", [*whole.faces[:5], *parts], whole.volume)


def joined_boxes(dimension: int) -> Body:
    """Two boxes joined in a vertex (0) or an edge (1), or standing apart (-1)."""
    corner = {0: (3.0, 2.0, 1.0), 1: (3.0, 2.0, 0.0), -1: (4.0, 0.0, 0.0)}[dimension]
    first, second = box(spans=(2, 2, 2)), box(spans=(2, 2, 2), corner=corner)
    return make_body(
        "joined boxes", first.faces + second.faces, first.volume + second.volume, (0, 0)
    )


def other_speed() -> Body:
    """Box whose top runs along its sides at a speed that no refinement matches."""
    whole = box(spans=(1, 1, 1), degree=2)

    def quick(u, v):
        u, v = np.broadcast_arrays(u, v)
        s = u * (0.5 + 0.5 * u)
        return np.stack([3.0 * s, 2.0 * v, np.ones_like(s)], axis=-1)

    knots = uniform_knots(2, 1)
    top = replace(interpolating_face(quick, (2, 2), (knots, knots)), name=whole.faces[5].name)
    return replace(whole, name="other speed", faces=whole.faces[:5] + (top,))


def pinched() -> Body:
    """Box whose top has a side without length."""
    whole = box(spans=(1, 1, 1), degree=1)
    faces = []
    for face in whole.faces:
        points = face.control_points.copy()
        points[np.all(points == (3.0, 2.0, 1.0), axis=-1)] = (3.0, 0.0, 1.0)
        faces.append(replace(face, control_points=points))
    return replace(whole, name="pinched", faces=tuple(faces))


def klein_bottle() -> Body:
    """Closed surface of bilinear patches without inside and outside (figure-8 immersion)."""
    rows, columns = 4, 8

    def point(i: int, j: int) -> np.ndarray:
        u, v = 2 * np.pi * i / columns, 2 * np.pi * (j + 0.5) / rows
        r = 2.0 + np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v)
        z = np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v)
        return np.array([r * np.cos(u), r * np.sin(u), z])

    faces = []
    for i, j in np.ndindex(columns, rows):
        corners = [[point(i, j), point(i, j + 1)], [point(i + 1, j), point(i + 1, j + 1)]]
        faces.append(bezier_face(np.array(corners)))
    return make_body("Klein bottle", faces, 0.0)
