# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Faces that are an iso-parameter rectangle of their surface: their quads follow its parameters.

Such a face keeps its geometry and parametrisation: its patches are pieces of the surface itself,
where the corners of quads on opposite sides stand at the same parameters and the edges' curves are
the surface's own sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..surface import SplineFace
from .geometry import SplineCurve, clamped_part, evaluate, project
from .outline import Outline
from .quad_mesh import QuadCover

SAME = 1e-9
"""Parameters that agree to this share of the range are the same, and points to this share of the
diagonal."""


def rectangle_faces(
    outline: Outline, sides: dict[int, list[np.ndarray]], surfaces: Sequence[SplineFace]
) -> np.ndarray:
    """Which faces with regular grids are the whole rectangle of their surface, (nf,) bool.

    Corners must be those of the surface, and the middles of all edges on its sides.
    """
    found = np.zeros(len(surfaces), dtype=bool)
    diagonal = float(np.linalg.norm(np.ptp(outline.vertices, axis=0)))
    for face, around in sides.items():
        edges = np.concatenate(around)
        points = np.concatenate([outline.vertices[outline.edges[edges].ravel()],
                                 outline.middle[edges]])  # fmt: skip
        uv, feet = project(surfaces[face], points)
        if np.linalg.norm(feet - points, axis=1).max() > SAME * diagonal:
            continue
        share = _shares(surfaces[face], uv)
        on_side = (np.minimum(share, 1.0 - share) <= 1e-7).any(axis=1)
        corners = (np.minimum(share, 1.0 - share) <= 1e-7).all(axis=1)
        # four corners, each an end of two edges
        found[face] = on_side.all() and len(np.unique(np.rint(share[corners]), axis=0)) == 4
    return found


def _shares(face: SplineFace, uv: np.ndarray) -> np.ndarray:
    low = np.array([knots[0] for knots in face.knots])
    high = np.array([knots[-1] for knots in face.knots])
    return (uv - low) / (high - low)


def grid_parameters(
    cover: QuadCover, face: int, surface: SplineFace
) -> tuple[np.ndarray, np.ndarray] | None:
    """Parameters of a face's corners if they can form a grid.

    Returns
    -------
    corners : (k,) int array
    uv : (k, 2) array
        Inner corners stand where the lines through the corners on the sides cross. None where
        opposite sides have different parameters.
    """
    quads = cover.quads[cover.face == face]
    corners, local = np.unique(quads, return_inverse=True)
    local = local.reshape(quads.shape)
    uv = project(surface, cover.points[corners])[0]
    rim = np.unique(cover.rim[np.isin(cover.rim, corners).all(axis=1)])
    on_rim = np.isin(corners, rim)
    share = _shares(surface, uv)
    lines = []
    for axis in (0, 1):
        across = 1 - axis
        low = on_rim & (share[:, across] <= 1e-7)
        high = on_rim & (share[:, across] >= 1.0 - 1e-7)
        a, b = np.sort(share[low, axis]), np.sort(share[high, axis])
        if len(a) != len(b) or np.abs(a - b).max() > SAME:
            return None
        lines.append(0.5 * (a + b))
    if len(corners) != len(lines[0]) * len(lines[1]):
        return None
    place = _grid_places(local, share, on_rim, lines)
    if place is None:
        return None
    exact = np.column_stack([lines[0][place[:, 0]], lines[1][place[:, 1]]])
    low = np.array([knots[0] for knots in surface.knots])
    high = np.array([knots[-1] for knots in surface.knots])
    return corners, low + exact * (high - low)


def _grid_places(
    quads: np.ndarray, share: np.ndarray, on_rim: np.ndarray, lines: list[np.ndarray]
) -> np.ndarray | None:
    """Row and column of every corner, found from quad to quad beginning at a corner of the face."""
    count = len(share)
    place = np.full((count, 2), -1)
    for axis in (0, 1):
        known = np.abs(share[:, axis, None] - lines[axis]).argmin(axis=1)
        place[on_rim, axis] = known[on_rim]
    # an inner corner is opposite a known one in a quad whose three other corners are known
    for _ in range(count):
        missing = place[quads].min(axis=2) < 0
        ready = np.flatnonzero(missing.sum(axis=1) == 1)
        if not len(ready):
            break
        k = missing[ready].argmax(axis=1)
        around = [place[quads[ready, (k + step) % 4]] for step in (1, 2, 3)]
        place[quads[ready, k]] = around[0] + around[2] - around[1]
    if place.min() < 0 or len(np.unique(place, axis=0)) != count:
        return None
    step = np.abs(place[quads] - place[np.roll(quads, -1, axis=1)]).sum(axis=2)
    return place if np.all(step == 1) else None


def on_grids(
    cover: QuadCover,
    grids: dict[int, tuple[np.ndarray, np.ndarray]],
    surfaces: Sequence[SplineFace],
) -> QuadCover:
    """Put inner corners of faces to the places where their parameter lines cross."""
    points = cover.points.copy()
    inside = np.ones(len(points), dtype=bool)
    inside[cover.rim] = False
    for face, (corners, uv) in grids.items():
        own = inside[corners]
        if own.any():
            points[corners[own]] = evaluate(surfaces[face], uv[own])[0]
    return replace(cover, points=points)


def segment(
    face: SplineFace, u: tuple[float, float], v: tuple[float, float]
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """A rectangle of a surface as a spline of its own.

    Returns
    -------
    knots : (array, array)
        On [0, 1].
    points : (nu, nv, 4) array
        (w x, w y, w z, w)
    """
    points = np.concatenate(
        [face.control_points * face.weights[..., None], face.weights[..., None]], axis=2
    )
    knots = []
    for axis, ends in enumerate((u, v)):
        own, matrix = clamped_part(face.degrees[axis], face.knots[axis], *ends)
        points = np.moveaxis(np.tensordot(matrix, points, (1, axis)), 0, axis)
        knots.append((own - own[0]) / (own[-1] - own[0]))
    return (knots[0], knots[1]), points


def curves_of_sides(
    outline: Outline,
    rectangles: np.ndarray,
    curves: Sequence[SplineCurve | None],
    surfaces: Sequence[SplineFace],
) -> tuple[list[SplineCurve | None], np.ndarray]:
    """Curves of edges with the parameters of the surfaces that they bound.

    OCC's conversions of an edge and of the face beside it agree as sets of points, not always as
    functions. The surface's own side is taken; where two such faces beside an edge disagree the
    second one is followed within the tolerance only.

    Returns
    -------
    curves : list of SplineCurve
    rectangles : (nf,) bool array
        Those faces that agree.
    """
    found, agreed = list(curves), rectangles.copy()
    taken = np.zeros(len(curves), dtype=bool)
    diagonal = float(np.linalg.norm(np.ptp(outline.vertices, axis=0)))
    for face in np.flatnonzero(rectangles).tolist():
        edges = np.unique(outline.edge[outline.face == face]).tolist()
        own = {edge: _side_curve(surfaces[face], outline, edge) for edge in edges}
        if all(
            curve is not None and (not taken[edge] or _alike(curve, found[edge], diagonal))
            for edge, curve in own.items()
        ):
            for edge, curve in own.items():
                if not taken[edge]:
                    found[edge], taken[edge] = curve, True
        else:
            agreed[face] = False
    return found, agreed


def _side_curve(surface: SplineFace, outline: Outline, edge: int) -> SplineCurve | None:
    """The part of a surface's side that an edge is."""
    ends = project(surface, outline.vertices[outline.edges[edge]])[0]
    middle = project(surface, outline.middle[edge][None])[0]
    share = _shares(surface, np.concatenate([ends, middle]))
    for axis in (0, 1):
        for side in (0.0, 1.0):
            if np.abs(share[:, axis] - side).max() <= 1e-7:
                along = 1 - axis
                t = np.sort(ends[:, along])
                lines = surface.knots[along]
                size = lines[-1] - lines[0]
                t = np.where(np.abs(t - lines[0]) <= 1e-9 * size, lines[0], t)
                t = np.where(np.abs(t - lines[-1]) <= 1e-9 * size, lines[-1], t)
                if t[1] - t[0] <= 1e-9 * size:
                    return None
                row = int(side) * (surface.control_points.shape[axis] - 1)
                points = np.take(surface.control_points, row, axis=axis)
                weights = np.take(surface.weights, row, axis=axis)
                whole = SplineCurve(surface.degrees[along], lines, points, weights)
                return whole.cut(*t.tolist())
    return None


def _alike(a: SplineCurve, b: SplineCurve, diagonal: float) -> bool:
    """Whether two curves are the same function of their parameters, either way."""
    share = np.linspace(0.0, 1.0, 17)
    x, y = (
        curve.evaluate(curve.knots[0] + share * (curve.knots[-1] - curve.knots[0]))
        for curve in (a, b)
    )
    return min(np.abs(x - y).max(), np.abs(x - y[::-1]).max()) <= SAME * diagonal
