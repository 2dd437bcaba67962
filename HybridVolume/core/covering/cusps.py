# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Corners of faces whose two edges begin in one direction, as the chamfer of a hexagonal nut has.

A patch in such a corner has no normal there, which a shell can follow where it is the only place.
Files and cubics give the two edges directions that differ in some digit, and then the edges cross
each other: patches fold. So both get the direction of the simpler one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .geometry import SplineCurve
from .outline import Outline

SHARP = np.radians(3.0)
"""Corners that close more than to this angle are cusps."""
TOUCHING = np.radians(0.05)
"""Edges whose directions differ by less have the same."""


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


def _end(curve: SplineCurve, last: bool) -> tuple[np.ndarray, np.ndarray]:
    """An end of a curve and the direction away from it."""
    net = curve.control_points[::-1] if last else curve.control_points
    step = net[1] - net[0]
    return net[0], step / max(float(np.linalg.norm(step)), 1e-300)
