# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Corners of quads on smooth feature lines: they are 180 degrees wide, and no patch can have them.

Where a line of the layout reaches a smooth feature line, one quad lies on one side of it, with a
straight corner: the derivatives of a patch are parallel there. Within the tolerance the corner is
opened: it moves away from the quad, over the tangents of a rounding, or the line bends there.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

logger = logging.getLogger(__name__)

FLAT = 155.0
"""Degrees from which on a corner of a patch is opened."""
OPEN = 135.0
"""Degrees that are enough: no further than that is moved."""
_STEPS = 8
"""Moves that are tried, up to the largest one."""
_SHORT = 0.15
"""Largest move as a share of the shorter of the two sides."""


@dataclass(frozen=True)
class FlatCorner:
    """A straight corner of a quad on features.

    Attributes
    ----------
    vertex, quad : int
        Of the mesh, from zero.
    before, after : float
        Its angle as found and as opened, degrees.
    move : float
        Distance of the corner from the reference, mm.
    """

    vertex: int
    quad: int
    before: float
    after: float
    move: float


def opened(
    quads: np.ndarray,
    ends: np.ndarray,
    edge: np.ndarray,
    following: np.ndarray,
    sides: np.ndarray,
    reach: float,
) -> tuple[np.ndarray, list[FlatCorner]]:
    """Sides of quads with their straight corners on features opened.

    Parameters
    ----------
    quads : (nf, 4) int array
    ends : (e, 2) int array
        Ends of the edges, the smaller number first.
    edge : (nf, 4) int array
        Edge of each side of each quad.
    following : (e,) bool array
        Edges on features.
    sides : (e, k + 1, 3) array
        Points of each edge from its first end.
    reach : float
        Largest move, mm.

    Returns
    -------
    sides : (e, k + 1, 3) array
    corners : list of FlatCorner
    """
    corner = following[edge] & following[np.roll(edge, 1, axis=1)]
    rows, at = np.nonzero(corner)
    if not len(rows):
        return sides, []
    vertex = quads[rows, at]
    ahead = _from(vertex, ends, sides, edge[rows, at])
    back = _from(vertex, ends, sides, edge[rows, (at - 1) % 4])
    angle = _between(ahead[:, 1] - ahead[:, 0], back[:, 1] - back[:, 0])
    moved = sides.copy()
    found = []
    for k in np.flatnonzero(angle > FLAT):
        quad = quads[rows[k]]
        normal = _normal(sides, ends, edge[rows[k]], quad)
        inward = np.cross(normal, _unit(ahead[k, 1] - ahead[k, 0]) - _unit(back[k, 1] - back[k, 0]))
        inward = _unit(inward)
        lengths = [np.linalg.norm(np.diff(c, axis=0), axis=1).sum() for c in (ahead[k], back[k])]
        most = min(reach, _SHORT * min(lengths))
        # another sector of the same vertex may have been opened already
        start = _from(vertex[k : k + 1], ends, moved, edge[rows[k], at[k]][None])[0, 0]
        already = start - ahead[k, 0]
        if np.linalg.norm(already) > 0.0:
            logger.info("vertex %d has two straight corners", vertex[k] + 1)
            continue
        for step in range(1, _STEPS + 1):
            move = -most * step / _STEPS * inward
            curves = [_opened(curve, move, inward) for curve in (ahead[k], back[k])]
            after = _between(*(curve[1] - curve[0] for curve in curves))
            if after <= OPEN:
                break
        taken = edge[rows[k], [at[k], (at[k] - 1) % 4]]
        for one, curve, old in zip(taken, curves, (ahead[k], back[k]), strict=True):
            _add(moved, ends, one, vertex[k], curve - old)
        share = np.linspace(1.0, 0.0, sides.shape[1])[:, None] ** 3
        for one in np.setdiff1d(np.flatnonzero((ends == vertex[k]).any(axis=1)), taken):
            _add(moved, ends, one, vertex[k], share * move)
        place = (int(vertex[k]), int(rows[k]), float(angle[k]), float(after))
        found.append(FlatCorner(*place, float(np.linalg.norm(move))))
    return moved, found


def _from(vertex: np.ndarray, ends: np.ndarray, sides: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """Points of edges (m, k + 1, 3) from the given ends."""
    own = sides[edge]
    return np.where((ends[edge, 0] == vertex)[:, None, None], own, own[:, ::-1])


def _add(sides: np.ndarray, ends: np.ndarray, edge: int, vertex: int, step: np.ndarray) -> None:
    """Move the points of an edge, seen from a vertex."""
    sides[edge] += step if ends[edge, 0] == vertex else step[::-1]


def _normal(sides: np.ndarray, ends: np.ndarray, edge: np.ndarray, quad: np.ndarray) -> np.ndarray:
    """Unit normal of a quad by all points around it."""
    around = _from(quad, ends, sides, edge)[:, :-1].reshape(-1, 3)
    around = around - around.mean(axis=0)
    return _unit(np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0))


def _opened(curve: np.ndarray, move: np.ndarray, inward: np.ndarray) -> np.ndarray:
    """A side whose first point moves: the steeper of a tangent to it and of a bend."""
    start = curve[0] + move
    along = _unit(curve[1] - curve[0])
    along = _unit(along - (along @ inward) * inward)
    to = curve[1:] - start
    slope = (to @ inward) / np.maximum(to @ along, 1e-300)
    slope[to @ along <= 0.0] = np.inf
    touch = int(slope.argmin())
    line = curve.copy()
    share = np.linspace(0.0, 1.0, touch + 2)[:, None]
    line[: touch + 2] = (1 - share) * start + share * curve[touch + 1]
    bent = curve + np.linspace(1.0, 0.0, len(curve))[:, None] ** 3 * move
    first = [(c[1] - c[0]) @ inward / max((c[1] - c[0]) @ along, 1e-300) for c in (line, bent)]
    return line if first[0] > first[1] else bent


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-300)


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Degrees between vectors."""
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.degrees(np.arctan2(sine, (a * b).sum(axis=-1)))
