# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How the middle of two six-node triangles follows the eight-node side of a hexahedron beside them.

A constant stress exerts on node i of a side the force (stress) q_i, where q_i is the integral of
N_i n over the side: its vector area. Over the two triangles it is t_i, and t_c at the node c in the
middle of their diagonal, which the hexahedron does not have. If u_c = sum_i s_i u_i, the triangles
hand s_i t_c on to node i. Both parts balance where q_i = t_i + s_i t_c, hence

    s_i = (q_i - t_i) . t_c / |t_c|^2.

The shares add up to 1 because both surfaces have the same rim. By the divergence theorem
sum_i s_i x_i - x_c is the volume between the surfaces over |t_c|, in the direction of t_c: c is
moved by it, which is Newton's step towards no volume between them, until a linear displacement
follows the equation exactly.

On flat sides a constant stress is then exact, whatever their shape. On a parallelogram the shares
are -1/4 (corners) and 1/2 (mid nodes), the shape functions at the middle; on other quadrilaterals
these miss a constant stress by some per cent of it.
"""

from __future__ import annotations

import numpy as np

from .elements import quadrature, shape_functions, shape_gradients

TRIANGLES = ((0, 1, 2, 4, 5, 8), (2, 3, 0, 6, 7, 8))
"""The two triangles' nodes among those of the side (corners, mid nodes) and the middle, 8."""

_STEPS = 12
_CLOSE = 1e-13
_POINTS = 5


def consistent_middles(sides: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shares and places of the nodes in the middle.

    Parameters
    ----------
    sides : (n, 8, 3) array
        Nodes of eight-node sides, mm; the diagonal is that of corners 0 and 2.

    Returns
    -------
    shares : (n, 8) array
        The displacement in the middle is their sum over the side's nodes.
    middles : (n, 3) array
        mm; in the middle of the diagonal where the side is flat, so that triangles are straight.
    found : (n,) bool array
        Whether such a place was found. Where not, the rest is of no use.
    """
    origin = sides[:, :1]
    x = sides - origin
    size = np.linalg.norm(np.ptp(x, axis=1), axis=1)
    middles = 0.5 * (x[:, 0] + x[:, 2])
    given = vector_areas("quad8", x)
    off = np.full(len(x), np.inf)
    shares = np.zeros((len(x), 8))
    # where a share is no number the place is none either
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(_STEPS):
            nodes = np.concatenate([x, middles[:, None]], axis=1)
            taken = np.zeros((len(x), 9, 3))
            for triangle in TRIANGLES:
                taken[:, triangle] += vector_areas("tri6", nodes[:, triangle])
            middle = taken[:, 8]
            shares = np.einsum("enc,ec->en", given - taken[:, :8], middle)
            shares /= np.einsum("ec,ec->e", middle, middle)[:, None]
            places = np.einsum("en,enc->ec", shares, x)
            off = np.linalg.norm(places - middles, axis=1)
            middles = places
            if not (off > _CLOSE * size).any():
                break
    return shares, middles + origin[:, 0], off <= _CLOSE * size


def vector_areas(kind: str, coordinates: np.ndarray) -> np.ndarray:
    """Integral of each shape function times the normal over each face, (n, nodes, 3), mm²."""
    points, weights = quadrature(kind.rstrip("0123456789"), _POINTS)
    j = np.einsum("qnd,enc->eqcd", shape_gradients(kind, points), coordinates)
    normal = np.cross(j[..., 0], j[..., 1])
    return np.einsum("eqc,q,qn->enc", normal, weights, shape_functions(kind, points))
