# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Patches of quads whose sides are pieces of CAD edges exactly: Coons' in homogeneous coordinates.

In a plane such a patch stays in the plane, so that planar faces keep their geometry. On other faces
it is corrected inside, so that it goes through the same points of the face as the bicubic one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .. import bspline
from ..bezier import bernstein
from .quad_mesh import QuadCover
from .rims import Piece, Rims

_THIRDS = np.array([1.0, 2.0]) / 3.0


def side_numbers(cover: QuadCover) -> tuple[np.ndarray, np.ndarray]:
    """Number in ``cover.rim`` of each side of each quad, (m, 4), -1 inside faces; and whether it
    runs from the larger corner to the smaller one."""
    quads = cover.quads
    pairs = np.stack([quads, np.roll(quads, -1, axis=1)], axis=2)
    count = len(cover.points)
    keys = pairs.min(axis=2) * count + pairs.max(axis=2)
    table = cover.rim[:, 0] * count + cover.rim[:, 1]
    place = np.minimum(np.searchsorted(table, keys), len(table) - 1)
    return np.where(table[place] == keys, place, -1), pairs[..., 0] > pairs[..., 1]


@dataclass(frozen=True)
class Nets:
    """Quads of one pair of degrees and knot vectors.

    Attributes
    ----------
    quads : (k,) int array
    knots : (array, array)
        Clamped, on [0, 1]; inner ones where a side has knots.
    points : (k, nu, nv, 4) array
        (w x, w y, w z, w)
    """

    quads: np.ndarray
    knots: tuple[np.ndarray, np.ndarray]
    points: np.ndarray

    @property
    def degrees(self) -> tuple[int, int]:
        """Polynomial degrees."""
        u, v = (
            len(knots) - count - 1
            for knots, count in zip(self.knots, self.points.shape[1:3], strict=True)
        )
        return u, v

    def at(self, x: np.ndarray) -> np.ndarray:
        """Points (k, m, m, 3) at the tensor grid of m parameters."""
        u, v = (
            bspline.basis_matrix(degree, knots, x).toarray()
            for degree, knots in zip(self.degrees, self.knots, strict=True)
        )
        found = np.einsum("ai,bj,kijd->kabd", u, v, self.points, optimize=True)
        return found[..., :3] / found[..., 3:]


def homogeneous_nets(
    cover: QuadCover, nets: np.ndarray, rims: Rims, planar: np.ndarray
) -> list[Nets]:
    """Patches of all quads, together where degrees and knots are the same.

    Parameters
    ----------
    cover : QuadCover
    nets : (m, 4, 4, 3) array
        Bicubic patches.
    rims : Rims
    planar : (nf,) bool array
        Faces in a plane.
    """
    number, back = side_numbers(cover)
    weights = rims.weight[cover.quads]
    exact = (number >= 0) & rims.exact[number]
    plain = ~exact.any(axis=1) & (weights == 1.0).all(axis=1)
    found = []
    rows = np.flatnonzero(plain)
    if len(rows):
        points = np.concatenate([nets[rows], np.ones((len(rows), 4, 4, 1))], axis=3)
        found.append(Nets(rows, (_bezier_knots(3), _bezier_knots(3)), points))
    alike: dict[tuple, list[tuple[int, list[Piece]]]] = {}
    for quad in np.flatnonzero(~plain).tolist():
        sides = [_side(quad, side, nets, rims, number, back, exact, weights) for side in range(4)]
        key = tuple((len(side.points), side.knots.tobytes()) for side in sides)
        alike.setdefault(key, []).append((quad, sides))
    for same in alike.values():
        quads = np.array([quad for quad, _ in same])
        four = [np.stack([sides[k].points for _, sides in same]) for k in range(4)]
        made = _coons(quads, [side.knots for side in same[0][1]], four)
        curved = ~planar[cover.face[quads]]
        if curved.any():
            made.points[curved] = _corrected(made, made.points[curved], nets[quads[curved]])
        found.append(made)
    return list(_together(found))


def _together(found: list[Nets]) -> Iterator[Nets]:
    alike: dict[tuple, list[Nets]] = {}
    for nets in found:
        key = (nets.points.shape[1:], nets.knots[0].tobytes(), nets.knots[1].tobytes())
        alike.setdefault(key, []).append(nets)
    for same in alike.values():
        quads, points = (
            np.concatenate([getattr(nets, name) for nets in same]) for name in ("quads", "points")
        )
        yield Nets(quads, same[0].knots, points)


def _bezier_knots(degree: int) -> np.ndarray:
    return np.repeat([0.0, 1.0], degree + 1)


def _side(
    quad: int,
    side: int,
    nets: np.ndarray,
    rims: Rims,
    number: np.ndarray,
    back: np.ndarray,
    exact: np.ndarray,
    weights: np.ndarray,
) -> Piece:
    """A side along the patch's parameters."""
    turned = side in (2, 3)  # corners run around, parameters do not
    if exact[quad, side]:
        piece = rims.piece[int(number[quad, side])]
        return piece.turned() if back[quad, side] != turned else piece
    net = nets[quad]
    cubic = (net[:, 0], net[3], net[:, 3], net[0])[side]
    ends = weights[quad, [side, (side + 1) % 4]]
    if turned:
        ends = ends[::-1]
    points = np.hstack([cubic, np.ones((4, 1))])
    if ends[0] == ends[1]:
        return Piece(_bezier_knots(3), ends[0] * points)
    # a cubic times a linear weight
    share = np.arange(5)[:, None] / 4.0
    first = np.vstack([points, points[-1:]])
    last = np.vstack([points[:1], points])
    return Piece(_bezier_knots(4), (1.0 - share) * ends[0] * first + share * ends[1] * last)


def _coons(quads: np.ndarray, lines: list[np.ndarray], four: list[np.ndarray]) -> Nets:
    """Patches between their sides along the parameters, whose points are (k, n, 4)."""
    knots_u, (bottom, top) = _conformed([lines[0], lines[2]], [four[0], four[2]])
    knots_v, (left, right) = _conformed([lines[3], lines[1]], [four[3], four[1]])
    # linear functions have the Greville abscissae as coefficients
    s = bspline.greville(len(knots_u) - bottom.shape[1] - 1, knots_u)[:, None, None]
    t = bspline.greville(len(knots_v) - left.shape[1] - 1, knots_v)[None, :, None]
    points = (
        (1 - t) * bottom[:, :, None]
        + t * top[:, :, None]
        + (1 - s) * left[:, None]
        + s * right[:, None]
        - (1 - s) * (1 - t) * bottom[:, None, None, 0]
        - s * (1 - t) * bottom[:, None, None, -1]
        - (1 - s) * t * top[:, None, None, 0]
        - s * t * top[:, None, None, -1]
    )
    return Nets(quads, (knots_u, knots_v), points)


def _conformed(
    lines: list[np.ndarray], sides: list[np.ndarray]
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Opposite sides with one degree, at least 3, and one knot vector."""
    degrees = [len(knots) - side.shape[1] - 1 for knots, side in zip(lines, sides, strict=True)]
    degree = max(3, *degrees)
    raised = []
    for own, knots, side in zip(degrees, lines, sides, strict=True):
        if own < degree:
            matrix, knots = bspline.elevation_matrix(own, knots, degree - own)
            side = _applied(matrix, side)
        raised.append((knots, side))
    if np.array_equal(raised[0][0], raised[1][0]):
        return raised[0][0], [side for _, side in raised]
    common = bspline.merge_knots(degree, [knots for knots, _ in raised])
    return common, [
        _applied(bspline.insertion_matrix(degree, bspline.snap_knots(knots, common), common), side)
        for knots, side in raised
    ]


def _applied(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.moveaxis(np.tensordot(matrix, points, (1, 1)), 0, 1)


def _corrected(made: Nets, net: np.ndarray, cubic: np.ndarray) -> np.ndarray:
    """Patches moved inside, so that they take the values of others at the inner thirds."""
    at = bernstein(3, _THIRDS)
    at_u, at_v = (
        bspline.basis_matrix(degree, knots, _THIRDS).toarray()
        for degree, knots in zip(made.degrees, made.knots, strict=True)
    )
    here = np.einsum("ai,bj,kijd->kabd", at_u, at_v, net)
    wanted = np.einsum("ai,bj,kijd->kabd", at, at, cubic)
    off = here[..., 3:] * wanted - here[..., :3]
    inside = np.linalg.inv(at[:, 1:3])
    bubble = np.zeros((len(net), 4, 4, 3))
    bubble[:, 1:3, 1:3] = np.einsum("ia,jb,kabd->kijd", inside, inside, off)
    up_u, up_v = (
        _from_cubic(degree, knots) for degree, knots in zip(made.degrees, made.knots, strict=True)
    )
    moved = net.copy()
    moved[..., :3] += np.einsum("ai,bj,kijd->kabd", up_u, up_v, bubble)
    return moved


def _from_cubic(degree: int, knots: np.ndarray) -> np.ndarray:
    """Matrix from the Bézier points of a cubic to those over finer knots of a higher degree."""
    up, own = np.eye(4), _bezier_knots(3)
    if degree > 3:
        up, own = bspline.elevation_matrix(3, own, degree - 3)
    return bspline.insertion_matrix(degree, own, knots) @ up
