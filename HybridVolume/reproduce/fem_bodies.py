# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies of the accuracy cases: untrimmed faces on which elastic fields are known.

Lengths are mm. Knots stand where a designer would put them for the field: closer near a hole. They
are the lines of the hybrid volume's coarsest mesh; other meshers see the same faces and need not
follow them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..core import bspline
from ..core.surface import SplineFace
from . import bodies

ALONG_U, ALONG_V = 0, 1


@dataclass(frozen=True)
class FemBody:
    """Faces, and what they are for.

    Attributes
    ----------
    name : str
    faces : tuple of SplineFace
        Named ``Face1``, ``Face2``, ... in their order.
    roles : mapping of str to tuple of str
        Names of the faces that are, say, the bore.
    volume : float
        mm³, exact.
    """

    name: str
    faces: tuple[SplineFace, ...]
    roles: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    volume: float = float("nan")

    def named(self, *roles: str) -> tuple[str, ...]:
        """Faces of several roles."""
        return tuple(name for role in roles for name in self.roles[role])


def even(parts: int) -> np.ndarray:
    """Inner knots that cut [0, 1] into equal parts."""
    return np.arange(1, parts) / parts


def graded(parts: int, ratio: float) -> np.ndarray:
    """Inner knots that cut [0, 1] into parts, each ``ratio`` times as long as the one before."""
    ends = np.cumsum(ratio ** np.arange(parts))
    return ends[:-1] / ends[-1]


def cut(face: SplineFace, along_u: Sequence[float], along_v: Sequence[float]) -> SplineFace:
    """The same face of one knot span with simple knots at the given parameters."""
    net = np.concatenate(
        [face.control_points * face.weights[..., None], face.weights[..., None]], 2
    )
    knots = []
    for axis, inner in enumerate((along_u, along_v)):
        degree, old = face.degrees[axis], face.knots[axis]
        new = np.sort(np.concatenate([old, np.asarray(inner, dtype=float)]))
        matrix = bspline.insertion_matrix(degree, old, new)
        net = np.moveaxis(np.tensordot(matrix, net, axes=(1, axis)), 0, axis)
        knots.append(new)
    weights = net[..., 3]
    if np.ptp(face.weights) == 0.0:
        weights = np.full(weights.shape, face.weights.flat[0])
    points = net[..., :3] / weights[..., None]
    return replace(face, knots=(knots[0], knots[1]), control_points=points, weights=weights)


def _body(name: str, faces: Sequence[tuple[str, SplineFace]], volume: float) -> FemBody:
    """Body of faces with their roles."""
    roles: dict[str, tuple[str, ...]] = {}
    named = []
    for number, (role, face) in enumerate(faces, 1):
        named.append(replace(face, name=f"Face{number}"))
        roles[role] = (*roles.get(role, ()), f"Face{number}")
    return FemBody(name, tuple(named), roles, volume)


def tube(
    inner: float,
    outer: float,
    height: float,
    around: Sequence[float],
    across: Sequence[float],
    along: Sequence[float],
) -> FemBody:
    """Whole tube about z between 0 and ``height``, of four quarters with four faces each.

    Parameters
    ----------
    inner, outer, height : float
    around, across, along : sequences of float
        Inner knots of each quarter's arc, of the annuli from the bore, and of the walls.
    """
    lines = {"bottom": across, "outside": along, "top": 1.0 - np.asarray(across), "bore": along}
    faces = [
        (role, cut(face, around, lines[role]))
        for role, face in zip(list(lines) * 4, bodies.ring(inner, outer, height), strict=True)
    ]
    return _body("tube", faces, np.pi * (outer**2 - inner**2) * height)


def hollow_sphere(inner: float, outer: float, lines: Sequence[float]) -> FemBody:
    """Ball with a concentric cavity: six faces each, with inner knots in both directions."""
    faces = [
        (role, cut(face, lines, lines))
        for role, radius in (("outside", outer), ("cavity", inner))
        for face in bodies.sphere(radius)
    ]
    return _body("hollow sphere", faces, 4.0 / 3.0 * np.pi * (outer**3 - inner**3))


def torus(major: float, minor: float, around: Sequence[float], section: Sequence[float]) -> FemBody:
    """Torus about z of sixteen faces, with inner knots around z and around the section."""
    faces = [("surface", cut(face, around, section)) for face in bodies.torus(major, minor)]
    return _body("torus", faces, 2.0 * np.pi**2 * major * minor**2)


def beam(length: float, width: float, lines: Sequence[Sequence[float]]) -> FemBody:
    """Bar 0 < x < length of a square section about the x axis, inner knots along x, y and z."""
    low = np.array([0.0, -0.5 * width, -0.5 * width])
    size = np.array([length, width, width])
    faces = []
    for axis, role in enumerate(("end", "side", "side")):
        a, b = (k for k in range(3) if k != axis)
        for at in (0, 1):
            corners = np.zeros((2, 2, 3))
            corners[..., axis] = at
            corners[1, :, a] = 1
            corners[:, 1, b] = 1
            name = ("root", "tip")[at] if role == "end" else role
            faces.append((name, cut(_plane(low + corners * size), lines[a], lines[b])))
    return _body("beam", faces, length * width**2)


def holed_quarter(
    radius: float,
    side: float,
    height: float,
    around: Sequence[float],
    across: Sequence[float],
    along: Sequence[float],
) -> FemBody:
    """Quarter x, y > 0 of a square plate 0 < z < height with a hole about z.

    Parameters
    ----------
    radius, side, height : float
        Of the hole, of the quarter, and the plate's thickness.
    around, across, along : sequences of float
        Inner knots of each half of the hole's quarter circle, from the hole to the sides, and
        through the plate.
    """
    faces = []
    ends = [np.array([side, 0.0]), np.array([side, side]), np.array([0.0, side])]
    middle = np.cos(np.pi / 8.0)
    weights = np.array([1.0, middle, 1.0])
    for half in range(2):
        a, b = half * np.pi / 4.0, (half + 1) * np.pi / 4.0
        rim = np.array([[np.cos(t), np.sin(t)] for t in (a, 0.5 * (a + b), b)])
        rim *= radius / np.array([1.0, middle, 1.0])[:, None]
        far = np.array([ends[half], 0.5 * (ends[half] + ends[half + 1]), ends[half + 1]])
        for role, z in (("bottom", 0.0), ("top", height)):
            rows = np.stack([_at(rim, z), _at(far, z)], axis=1)
            faces.append((role, cut(_rational(rows, weights), around, across)))
        for role, curve in (("hole", rim), ("far", far)):
            rows = np.stack([_at(curve, 0.0), _at(curve, height)], axis=1)
            faces.append((role, cut(_rational(rows, weights), around, along)))
    for role, way in (("symmetry y", np.array([1.0, 0.0])), ("symmetry x", np.array([0.0, 1.0]))):
        line = np.array([radius * way, side * way])
        rows = np.stack([_at(line, 0.0), _at(line, height)], axis=1)
        faces.append((role, cut(_plane(rows), across, along)))
    return _body("holed quarter", faces, (side**2 - 0.25 * np.pi * radius**2) * height)


def _at(points: np.ndarray, z: float) -> np.ndarray:
    """Points (m, 2) at a height, (m, 3)."""
    return np.column_stack([points, np.full(len(points), z)])


def _rational(points: np.ndarray, weights: np.ndarray) -> SplineFace:
    """Ruled face of (3, 2, 3) points whose two curves have the same weights."""
    knots = (np.repeat([0.0, 1.0], 3), np.repeat([0.0, 1.0], 2))
    return SplineFace("", (2, 1), knots, points, np.repeat(weights[:, None], 2, axis=1))


def _plane(corners: np.ndarray) -> SplineFace:
    """Bilinear face of (2, 2, 3) corners."""
    knots = (np.repeat([0.0, 1.0], 2), np.repeat([0.0, 1.0], 2))
    return SplineFace("", (1, 1), knots, np.asarray(corners, dtype=float), np.ones((2, 2)))
