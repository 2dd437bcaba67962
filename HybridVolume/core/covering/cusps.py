# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Corners of faces whose two edges begin in one direction, as the chamfer of a hexagonal nut has.

A patch in such a corner has no normal there, which a shell can follow where it is the only place.
Files and cubics give the two edges directions that differ in some digit, and then the edges cross
each other: patches fold. So both get the direction of the simpler one.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .geometry import SplineCurve
from .outline import Outline
from .quad_mesh import QuadCover
from .rims import Piece, Rims

SHARP = np.radians(3.0)
"""Corners that close more than to this angle are cusps."""
TOUCHING = np.radians(0.05)
"""Edges whose directions differ by less have the same."""
ROUNDING = 1e-13
"""Directions that differ by less, rad, are left as they are."""


@dataclass(frozen=True)
class Cusp:
    """A corner of a face in which two edges touch.

    Attributes
    ----------
    edges : tuple of int
        The two edges.
    point : (3,) array
        mm
    direction : (3,) array
        Unit vector along both edges, away from the corner.
    """

    edges: tuple[int, int]
    point: np.ndarray
    direction: np.ndarray


def cusps_of(outline: Outline, curves: Sequence[SplineCurve | None]) -> list[Cusp]:
    """Corners in which edges of a face touch.

    Parameters
    ----------
    outline : Outline
    curves : sequence of SplineCurve
    """
    found = []
    following = outline.following
    for row in np.flatnonzero(np.abs(outline.corner) > np.pi - SHARP).tolist():
        after = int(following[row])
        # the first one ends here, the second one begins
        ends = [
            (int(outline.edge[row]), bool(outline.forward[row])),
            (int(outline.edge[after]), not outline.forward[after]),
        ]
        if any(curves[edge] is None for edge, _ in ends):
            continue
        away = [_end(curves[edge], last) for edge, last in ends]
        if np.arccos(np.clip(away[0][1] @ away[1][1], -1.0, 1.0)) > TOUCHING:
            continue
        simpler = min((0, 1), key=lambda k: len(curves[ends[k][0]].control_points))
        found.append(Cusp((ends[0][0], ends[1][0]), *away[simpler]))
    return found


def with_directions(
    rims: Rims, cover: QuadCover, cusps: Sequence[Cusp], fixed: Collection[int]
) -> Rims:
    """Pieces of edges that begin in the directions of the cusps.

    Two exact pieces may differ there in the eighth digit, and have neither a normal nor none then.

    Parameters
    ----------
    rims : Rims
    cover : QuadCover
    cusps : sequence of Cusp
    fixed : collection of int
        Edges whose pieces stay as they are.
    """
    pieces = dict(rims.piece)
    for edge, cusp in ((edge, corner) for corner in cusps for edge in corner.edges):
        rows = np.flatnonzero(cover.rim_edge == edge)
        away = np.linalg.norm(cover.points[cover.rim[rows]] - cusp.point, axis=2)
        row, last = np.unravel_index(int(away.argmin()), away.shape)
        number = int(rows[row])
        if edge in fixed or number not in pieces:
            continue
        piece = pieces[number].turned() if last else pieces[number]
        points = piece.points.copy()
        begin = points[0, :3] / points[0, 3]
        step = points[1, :3] / points[1, 3] - begin
        along = cusp.direction * max(float(step @ cusp.direction), 0.0)
        if np.linalg.norm(step - along) > ROUNDING * np.linalg.norm(step):
            points[1, :3] = points[1, 3] * (begin + along)
            turned = Piece(piece.knots, points)
            pieces[number] = turned.turned() if last else turned
    return replace(rims, piece=pieces)


def _end(curve: SplineCurve, last: bool) -> tuple[np.ndarray, np.ndarray]:
    """An end of a curve and the direction away from it."""
    net = curve.control_points[::-1] if last else curve.control_points
    step = net[1] - net[0]
    return net[0], step / max(float(np.linalg.norm(step)), 1e-300)
