# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Patches of quads whose sides are pieces of CAD edges exactly: Coons' in homogeneous coordinates.

In a plane such a patch stays in the plane, so that planar faces keep their geometry. On other faces
it is corrected inside, so that it goes through the same points of the face as the bicubic one.
"""

from __future__ import annotations

import numpy as np

from ..bezier import bernstein
from ..bspline import bezier_elevation
from .quad_mesh import QuadCover
from .rims import Rims

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


def homogeneous_nets(
    cover: QuadCover, nets: np.ndarray, rims: Rims, planar: np.ndarray
) -> dict[tuple[int, int], tuple[np.ndarray, np.ndarray]]:
    """Bézier points (w x, w y, w z, w) of all quads, by their two degrees.

    Parameters
    ----------
    cover : QuadCover
    nets : (m, 4, 4, 3) array
        Bicubic patches.
    rims : Rims
    planar : (nf,) bool array
        Faces in a plane.

    Returns
    -------
    dict
        Quads (k,) and their points (k, du + 1, dv + 1, 4).
    """
    number, back = side_numbers(cover)
    weights = rims.weight[cover.quads]
    exact = (number >= 0) & rims.exact[number]
    plain = ~exact.any(axis=1) & (weights == 1.0).all(axis=1)
    found: dict[tuple[int, int], list[tuple[np.ndarray, np.ndarray]]] = {}
    rows = np.flatnonzero(plain)
    if len(rows):
        found[3, 3] = [(rows, np.concatenate([nets[rows], np.ones((len(rows), 4, 4, 1))], axis=3))]
    rest = np.flatnonzero(~plain)
    if len(rest):
        sides = [
            [_side(k, side, nets, rims, number, back, exact, weights) for side in range(4)]
            for k in rest.tolist()
        ]
        degrees = np.array([[len(side) - 1 for side in four] for four in sides])
        for kind in np.unique(degrees, axis=0):
            own = np.flatnonzero((degrees == kind).all(axis=1))
            four = [np.stack([sides[k][side] for k in own]) for side in range(4)]
            net = _coons(four)
            quads = rest[own]
            curved = ~planar[cover.face[quads]]
            net[curved] = _corrected(net[curved], nets[quads[curved]])
            key = (net.shape[1] - 1, net.shape[2] - 1)
            found.setdefault(key, []).append((quads, net))
    return {
        key: tuple(np.concatenate(part) for part in zip(*parts, strict=True))
        for key, parts in found.items()
    }


def _side(
    quad: int,
    side: int,
    nets: np.ndarray,
    rims: Rims,
    number: np.ndarray,
    back: np.ndarray,
    exact: np.ndarray,
    weights: np.ndarray,
) -> np.ndarray:
    """Homogeneous Bézier points of a side along the patch's parameters, (p + 1, 4)."""
    turned = side in (2, 3)  # corners run around, parameters do not
    if exact[quad, side]:
        piece = rims.piece[int(number[quad, side])]
        return piece[::-1] if back[quad, side] != turned else piece
    net = nets[quad]
    cubic = (net[:, 0], net[3], net[:, 3], net[0])[side]
    ends = weights[quad, [side, (side + 1) % 4]]
    if turned:
        ends = ends[::-1]
    points = np.hstack([cubic, np.ones((4, 1))])
    if ends[0] == ends[1]:
        return ends[0] * points
    # a cubic times a linear weight
    share = np.arange(5)[:, None] / 4.0
    first = np.vstack([points, points[-1:]])
    last = np.vstack([points[:1], points])
    return (1.0 - share) * ends[0] * first + share * ends[1] * last


def _coons(four: list[np.ndarray]) -> np.ndarray:
    """Points (k, du + 1, dv + 1, 4) of patches between their sides along the parameters."""
    bottom, right, top, left = four
    du = max(3, bottom.shape[1] - 1, top.shape[1] - 1)
    dv = max(3, left.shape[1] - 1, right.shape[1] - 1)
    bottom, top = (_raised(side, du) for side in (bottom, top))
    left, right = (_raised(side, dv) for side in (left, right))
    s = (np.arange(du + 1) / du)[:, None, None]
    t = (np.arange(dv + 1) / dv)[None, :, None]
    return (
        (1 - t) * bottom[:, :, None]
        + t * top[:, :, None]
        + (1 - s) * left[:, None]
        + s * right[:, None]
        - (1 - s) * (1 - t) * bottom[:, None, None, 0]
        - s * (1 - t) * bottom[:, None, None, -1]
        - (1 - s) * t * top[:, None, None, 0]
        - s * t * top[:, None, None, -1]
    )


def _raised(points: np.ndarray, degree: int) -> np.ndarray:
    own = points.shape[1] - 1
    if own == degree:
        return points
    return np.einsum("ab,kbd->kad", bezier_elevation(own, degree - own), points)


def _corrected(net: np.ndarray, cubic: np.ndarray) -> np.ndarray:
    """Patches moved inside, so that they take the values of others at the inner thirds."""
    du, dv = net.shape[1] - 1, net.shape[2] - 1
    at_u, at_v, at = (bernstein(p, _THIRDS) for p in (du, dv, 3))
    here = np.einsum("ai,bj,kijd->kabd", at_u, at_v, net)
    wanted = np.einsum("ai,bj,kijd->kabd", at, at, cubic)
    off = here[..., 3:] * wanted - here[..., :3]
    inside = np.linalg.inv(at[:, 1:3])
    bubble = np.zeros((len(net), 4, 4, 3))
    bubble[:, 1:3, 1:3] = np.einsum("ia,jb,kabd->kijd", inside, inside, off)
    up_u = bezier_elevation(3, du - 3) if du > 3 else np.eye(4)
    up_v = bezier_elevation(3, dv - 3) if dv > 3 else np.eye(4)
    moved = net.copy()
    moved[..., :3] += np.einsum("ai,bj,kijd->kabd", up_u, up_v, bubble)
    return moved
