# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Surfaces looked at from outside: polynomial pieces, their normals at shared sides, distances.

Nothing here uses the evaluation, the subdivision or the topology of ``core``: splines are evaluated
by the recursion of Cox and de Boor one knot span at a time, so that both sides of a knot line are
seen, and sides are found by their places in space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from HybridVolume.core.surface import SplineFace

PLACES = 50
"""Places along a side where normals are compared."""
MEETS = 1e-9
"""Share of the diagonal within which sides are the same."""
_SIDES = ((0, 0), (1, 0), (0, 1), (1, 1))
"""Fixed direction and end of the sides: u = 0, u = 1, v = 0, v = 1."""


@dataclass(frozen=True)
class Pieces:
    """Polynomial pieces of spline faces of one degree.

    Attributes
    ----------
    nets : (n, p + 1, q + 1, 3) array
        Bézier points.
    face : (n,) int array
        Face of each.
    """

    nets: np.ndarray
    face: np.ndarray

    @property
    def diagonal(self) -> float:
        """Of the box around all points, mm."""
        return float(np.linalg.norm(np.ptp(self.nets.reshape(-1, 3), axis=0)))

    def at(
        self, piece: np.ndarray, u: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points and both tangents (m, 3) at parameters (m,) of pieces (m,)."""
        return _on_nets(self.nets[piece], u, v)


def _on_nets(
    nets: np.ndarray, u: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points and both tangents (m, 3) of nets (m, p + 1, q + 1, 3)."""
    m, p, q, _ = nets.shape
    left, du = bernstein(p - 1, u)
    right, dv = bernstein(q - 1, v)
    along = (np.stack([left, du], axis=1) @ nets.reshape(m, p, 3 * q)).reshape(m, 2, q, 3)
    x, x_u = ((right[:, None] @ along[:, k])[:, 0] for k in (0, 1))
    return x, x_u, (dv[:, None] @ along[:, 0])[:, 0]


def bernstein(degree: int, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bernstein polynomials and their derivatives, (m, degree + 1) each."""
    values = np.ones((len(t), 1))
    for k in range(1, degree + 1):
        grown = np.zeros((len(t), k + 1))
        grown[:, :-1] += (1.0 - t)[:, None] * values
        grown[:, 1:] += t[:, None] * values
        lower, values = values, grown
    slopes = np.zeros_like(values)
    if degree:
        slopes[:, 1:] += degree * lower
        slopes[:, :-1] -= degree * lower
    return values, slopes


def pieces_of(faces: Sequence[SplineFace]) -> Pieces:
    """Pieces of polynomial faces of one degree, between neighbouring knots.

    Raises
    ------
    ValueError
        A face is rational or of another degree.
    """
    nets, owner = [], []
    for number, face in enumerate(faces):
        if np.ptp(face.weights) or face.degrees != faces[0].degrees:
            raise ValueError("faces must be polynomial and of one degree")
        u, v = (_extraction(d, k) for d, k in zip(face.degrees, face.knots, strict=True))
        made = np.einsum("sai,tbj,ijd->stabd", u, v, face.control_points, optimize=True)
        made = made.reshape(-1, *made.shape[2:])
        nets.append(made)
        owner.append(np.full(len(made), number))
    return Pieces(np.concatenate(nets), np.concatenate(owner))


def _extraction(degree: int, knots: np.ndarray) -> np.ndarray:
    """Bézier points of each span from control points, (spans, degree + 1, n).

    By the blossom: Bézier point a of a span is the spline's polar form there at degree - a times
    its beginning and a times its end.
    """
    knots = np.asarray(knots, dtype=float)
    count = len(knots) - degree - 1
    spans = [k for k in range(degree, count) if knots[k + 1] > knots[k]]
    result = np.zeros((len(spans), degree + 1, count))
    for row, k in enumerate(spans):
        for a in range(degree + 1):
            at = [knots[k]] * (degree - a) + [knots[k + 1]] * a
            points = np.eye(count)[k - degree : k + 1]
            for level in range(1, degree + 1):
                low = knots[k - degree + level : k + 1]
                high = knots[k + 1 : k + degree - level + 2]
                share = ((at[level - 1] - low) / (high - low))[:, None]
                points = (1.0 - share) * points[:-1] + share * points[1:]
            result[row, a] = points[0]
    return result


@dataclass(frozen=True)
class SharedSides:
    """Sides at which two pieces meet.

    Attributes
    ----------
    angle : (m, 50) array
        Between the normals of both pieces, rad.
    ends : (m, 2, 3) array
        Where they begin and end, mm.
    valence : (m, 2) int array
        Sides that meet at both ends.
    open : int
        Sides that meet no other one, or more than one.
    """

    angle: np.ndarray
    ends: np.ndarray
    valence: np.ndarray
    open: int


def shared_sides(pieces: Pieces) -> SharedSides:
    """Normals on both sides of every side of every piece."""
    t = np.linspace(0.0, 1.0, PLACES)
    n = len(pieces.nets)
    x = np.empty((4, n, PLACES, 3))
    normal = np.empty_like(x)
    piece = np.repeat(np.arange(n), PLACES)
    along = np.tile(t, n)
    for side, (direction, end) in enumerate(_SIDES):
        uv = [along, along]
        uv[direction] = np.full(len(along), float(end))
        place, du, dv = pieces.at(piece, *uv)
        x[side] = place.reshape(n, PLACES, 3)
        normal[side] = np.cross(du, dv).reshape(n, PLACES, 3)
    x, normal = x.reshape(-1, PLACES, 3), normal.reshape(-1, PLACES, 3)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    reach = MEETS * pieces.diagonal
    pairs, unmatched = _pairs(x, reach)
    one, other = pairs.T
    back = np.linalg.norm(x[one, 0] - x[other, 0], axis=1) > reach
    there = np.where(back[:, None, None], normal[other, ::-1], normal[other])
    here = normal[one]
    angle = np.arctan2(
        np.linalg.norm(np.cross(here, there), axis=-1), np.einsum("mqd,mqd->mq", here, there)
    )
    ends = x[one][:, [0, -1]]
    # each side is a side of two pieces: the tree has every end of it once
    tree = cKDTree(ends.reshape(-1, 3))
    at = tree.query_ball_point(ends.reshape(-1, 3), 10.0 * reach, return_length=True)
    return SharedSides(angle, ends, np.asarray(at).reshape(-1, 2), unmatched)


def _pairs(x: np.ndarray, reach: float) -> tuple[np.ndarray, int]:
    """Rows of ``x`` (n, places, 3) that are the same curve, (m, 2), and how many have no other."""
    middle = 0.5 * (x[:, PLACES // 2 - 1] + x[:, PLACES // 2])
    near = cKDTree(middle).query_pairs(reach, output_type="ndarray")
    first, last = x[:, 0], x[:, -1]

    def apart(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return np.linalg.norm(p - q, axis=1)

    a, b = near.T
    same = np.minimum(
        np.maximum(apart(first[a], first[b]), apart(last[a], last[b])),
        np.maximum(apart(first[a], last[b]), apart(last[a], first[b])),
    )
    near = near[same <= reach]
    count = np.bincount(near.ravel(), minlength=len(x))
    return near, int(np.count_nonzero(count != 1))


def distances(
    pieces: Pieces, points: np.ndarray, samples: int = 7, tries: int = 6, rounds: int = 12
) -> np.ndarray:
    """Distances of points from the nearest places of the pieces, (m,), mm.

    From the nearest of samples on several pieces Gauss and Newton's method leads to the foot, which
    stays in its piece; the sample itself counts as well.

    Parameters
    ----------
    pieces : Pieces
    points : (m, 3) array
    samples : int
        Along each direction of a piece.
    tries : int
        Nearest samples of each point that are looked at; a foot is sought once for each piece.
    rounds : int
        Steps of the method.
    """
    t = np.linspace(0.0, 1.0, samples)
    u, v = (np.tile(a.ravel(), len(pieces.nets)) for a in np.meshgrid(t, t, indexing="ij"))
    piece = np.repeat(np.arange(len(pieces.nets)), samples**2)
    tree = cKDTree(pieces.at(piece, u, v)[0])
    best, near = tree.query(points, tries)
    best = best[:, 0].copy()
    for k in range(tries):
        here = piece[near[:, k]]
        new = np.flatnonzero((here[:, None] != piece[near[:, :k]]).all(axis=1))
        off = _feet(pieces.nets[here[new]], u[near[new, k]], v[near[new, k]], points[new], rounds)
        best[new] = np.minimum(best[new], off)
    return best


def _feet(
    nets: np.ndarray, u: np.ndarray, v: np.ndarray, points: np.ndarray, rounds: int
) -> np.ndarray:
    """Distances of points (m, 3) from the feet that are found on one net each, (m,)."""
    active = np.arange(len(points))
    for _ in range(rounds):
        x, x_u, x_v = _on_nets(nets[active], u[active], v[active])
        a, b = _step(u[active], v[active], x_u, x_v, points[active] - x)
        moved = np.maximum(np.abs(a - u[active]), np.abs(b - v[active]))
        u[active], v[active] = a, b
        active = active[moved > 1e-9]
        if not len(active):
            break
    return np.linalg.norm(points - _on_nets(nets, u, v)[0], axis=1)


def _step(
    a: np.ndarray, b: np.ndarray, x_u: np.ndarray, x_v: np.ndarray, missing: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A step towards the foot; where it would leave the piece, along the side that it meets."""
    uu, uv, vv = ((p * q).sum(axis=1) for p, q in ((x_u, x_u), (x_u, x_v), (x_v, x_v)))
    gu, gv = (missing * x_u).sum(axis=1), (missing * x_v).sum(axis=1)
    det = np.maximum(uu * vv - uv * uv, 1e-12 * uu * vv + 1e-300)
    new_a = np.clip(a + (vv * gu - uv * gv) / det, 0.0, 1.0)
    new_b = np.clip(b + (uu * gv - uv * gu) / det, 0.0, 1.0)
    held_a, held_b = (new_a == 0.0) | (new_a == 1.0), (new_b == 0.0) | (new_b == 1.0)
    along_b = b + (gv - uv * (new_a - a)) / np.maximum(vv, 1e-300)
    along_a = a + (gu - uv * (new_b - b)) / np.maximum(uu, 1e-300)
    return (
        np.where(held_b & ~held_a, np.clip(along_a, 0.0, 1.0), new_a),
        np.where(held_a & ~held_b, np.clip(along_b, 0.0, 1.0), new_b),
    )
