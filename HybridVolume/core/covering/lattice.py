# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bicubic Bézier patches of quads through sixteen points of the CAD faces.

Sides that lie on CAD edges go through points of the edge's curve, all others through points of the
face. A side has its points once, so that neighbours share them and the surface is closed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..surface import SplineFace
from .cusps import Cusp
from .geometry import SplineCurve, project
from .quad_mesh import QuadCover

_THIRDS = np.arange(4) / 3.0
_BERNSTEIN = np.stack(
    [
        (1 - _THIRDS) ** 3,
        3 * _THIRDS * (1 - _THIRDS) ** 2,
        3 * _THIRDS**2 * (1 - _THIRDS),
        _THIRDS**3,
    ],
    axis=1,
)
_INVERSE = np.linalg.inv(_BERNSTEIN)
"""Bézier points of a cubic from its points at thirds."""


def bicubic_nets(
    cover: QuadCover,
    curves: Sequence[SplineCurve | None],
    surfaces: Sequence[SplineFace],
    cusps: Sequence[Cusp] = (),
) -> np.ndarray:
    """Bézier points of all quads.

    Parameters
    ----------
    cover : QuadCover
    curves : sequence of SplineCurve
        Of the outline's edges.
    surfaces : sequence of SplineFace
        Of its faces.
    cusps : sequence of Cusp
        Corners in which edges have one direction.

    Returns
    -------
    (m, 4, 4, 3) array
        mm; the first direction from the quad's first corner to its second.
    """
    points = _on_faces(cover, surfaces)
    quads = cover.quads
    count = len(points)
    pairs = np.stack([quads, np.roll(quads, -1, axis=1)], axis=2)
    low, high = pairs.min(axis=2), pairs.max(axis=2)
    keys, number = np.unique(low * count + high, return_inverse=True)
    number = number.reshape(low.shape)
    first, last = np.divmod(keys, count)
    # the two inner points of every side, from its smaller corner on
    sides = points[first][:, None] + _THIRDS[1:3, None] * (points[last] - points[first])[:, None]
    face_of = np.empty(len(keys), dtype=int)
    face_of[number.ravel()] = np.repeat(cover.face, 4)
    rim = np.searchsorted(keys, cover.rim[:, 0] * count + cover.rim[:, 1])
    free = np.setdiff1d(np.arange(len(keys)), rim)
    for face in np.unique(face_of[free]).tolist():
        own = free[face_of[free] == face]
        sides[own] = project(surfaces[face], sides[own].reshape(-1, 3))[1].reshape(-1, 2, 3)
    for edge in np.unique(cover.rim_edge).tolist():
        own = rim[cover.rim_edge == edge]
        sides[own] = _along(curves[edge], points[first[own]], points[last[own]])
    for edge, cusp in ((edge, corner) for corner in cusps for edge in corner.edges):
        own = rim[cover.rim_edge == edge]
        ends = np.stack([points[first[own]], points[last[own]]])
        away = np.linalg.norm(ends - cusp.point, axis=2)
        row = int(away.min(axis=0).argmin())
        turn = int(away[:, row].argmin())
        inner = sides[own[row]][::-1] if turn else sides[own[row]]
        inner = _with_tangent(ends[turn, row], inner, ends[1 - turn, row], cusp.direction)
        sides[own[row]] = inner[::-1] if turn else inner

    grid = np.empty((len(quads), 4, 4, 3))
    corner = ((0, 0), (3, 0), (3, 3), (0, 3))
    for k in range(4):
        grid[:, corner[k][0], corner[k][1]] = points[quads[:, k]]
        step = np.subtract(corner[(k + 1) % 4], corner[k]) // 3
        turned = (low[:, k] != quads[:, k])[:, None, None]
        inner = np.where(turned, sides[number[:, k]][:, ::-1], sides[number[:, k]])
        for j in (1, 2):
            a, b = np.add(corner[k], j * step)
            grid[:, a, b] = inner[:, j - 1]
    _fill_inside(grid)
    inside = grid[:, 1:3, 1:3].copy()
    for face in np.unique(cover.face).tolist():
        own = cover.face == face
        feet = project(surfaces[face], inside[own].reshape(-1, 3))[1]
        inside[own] = feet.reshape(-1, 2, 2, 3)
    grid[:, 1:3, 1:3] = inside
    return np.einsum("ia,jb,nabd->nijd", _INVERSE, _INVERSE, grid)


def _with_tangent(
    begin: np.ndarray, inner: np.ndarray, end: np.ndarray, direction: np.ndarray
) -> np.ndarray:
    """Points at thirds of a cubic, (2, 3), that is turned a little to begin in a direction."""
    net = _INVERSE @ np.vstack([begin, inner, end])
    net[1] = begin + direction * max(float((net[1] - begin) @ direction), 0.0)
    return (_BERNSTEIN @ net)[1:3]


def _on_faces(cover: QuadCover, surfaces: Sequence[SplineFace]) -> np.ndarray:
    """Corners of quads, those inside faces moved onto these."""
    points = cover.points.copy()
    inside = np.ones(len(points), dtype=bool)
    inside[cover.rim] = False
    face = np.empty(len(points), dtype=int)
    face[cover.quads.ravel()] = np.repeat(cover.face, 4)
    for number in np.unique(face[inside]).tolist():
        own = np.flatnonzero(inside & (face == number))
        points[own] = project(surfaces[number], points[own])[1]
    return points


def _along(curve: SplineCurve, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Points of a curve at thirds between others on it, (k, 2, 3)."""
    a, b = curve.project(begin), curve.project(end)
    low, high = curve.knots[0], curve.knots[-1]
    closed = np.linalg.norm(np.subtract(*curve.evaluate(np.array([low, high])))) <= 1e-9 * (
        np.ptp(curve.control_points, axis=0).max()
    )
    if closed:
        # the point where it closes has two parameters: take the one beside the other end
        far = np.abs(b - a) > 0.5 * (high - low)
        at_a, at_b = (np.minimum(t - low, high - t) < 1e-9 * (high - low) for t in (a, b))
        a = np.where(far & at_a, np.where(b > 0.5 * (low + high), high, low), a)
        b = np.where(far & at_b & ~at_a, np.where(a > 0.5 * (low + high), high, low), b)
    t = a[:, None] + _THIRDS[1:3] * (b - a)[:, None]
    return curve.evaluate(t.ravel()).reshape(-1, 2, 3)


def _fill_inside(grid: np.ndarray) -> None:
    """Inner points of the grids from those of the sides, after Coons; in place."""
    s, t = _THIRDS[1:3, None, None], _THIRDS[None, 1:3, None]
    across = (1 - s) * grid[:, None, 0, 1:3] + s * grid[:, None, 3, 1:3]
    along = (1 - t) * grid[:, 1:3, None, 0] + t * grid[:, 1:3, None, 3]
    corners = (
        (1 - s) * (1 - t) * grid[:, None, None, 0, 0]
        + s * (1 - t) * grid[:, None, None, 3, 0]
        + (1 - s) * t * grid[:, None, None, 0, 3]
        + s * t * grid[:, None, None, 3, 3]
    )
    grid[:, 1:3, 1:3] = across + along - corners
