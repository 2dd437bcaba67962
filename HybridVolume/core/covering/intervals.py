# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How many parts each edge of a body is cut into, so that four-sided faces get regular grids.

Opposite sides of a four-sided face need equal numbers. Cutting on from face to face need not end;
one integer programme over all edges of the body always does.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, milp

from .iso_sides import IsoSides
from .outline import Outline

logger = logging.getLogger(__name__)

SECONDS = 20.0
"""Longest time for the integer programme; what it has found till then is taken."""


def lower_bounds(outline: Outline, turn: float, size: float) -> np.ndarray:
    """Fewest intervals of each edge.

    Parameters
    ----------
    outline : Outline
    turn : float
        Largest angle that the tangent may turn within an interval, rad.
    size : float
        Largest length of an interval, mm.

    Returns
    -------
    (ne,) int array
    """
    by_turn = np.ceil(outline.turning / turn - 1e-6)
    by_size = np.ceil(outline.length / size - 1e-6)
    # edges between the same vertices, and closed ones, must not fall together
    ends = np.sort(outline.edges, axis=1)
    _, inverse, count = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    twins = np.where(count[inverse.ravel()] > 1, 2, 1)
    least = np.where(ends[:, 0] == ends[:, 1], 3, twins)
    return np.maximum(least, np.maximum(by_turn, by_size)).astype(int)


def assign_intervals(
    outline: Outline,
    fewest: np.ndarray,
    iso: Mapping[int, IsoSides] | None = None,
    rows: tuple[sparse.csr_matrix, np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, dict[int, list[np.ndarray]]]:
    """Numbers of intervals with equal sums on opposite sides of all four-sided faces.

    Parameters
    ----------
    outline : Outline
    fewest : (ne,) int array
    iso : mapping, optional
        Faces whose sides are those of their surface, whatever their corners are.
    rows : (matrix, low, high), optional
        What else the intervals should obey, as :func:`.iso_sides.order_rows` makes it; given up
        where no numbers do.

    Returns
    -------
    intervals : (ne,) int array
        Nowhere below ``fewest``; the sum of ``intervals / fewest`` is as small as was found.
    sides : dict
        Edges of the four sides of each face that gets a regular grid. A four-sided face is missing
        where the numbers cannot be made equal (an edge that is on opposite sides of a face).
    """
    sides = {face: found for face in range(outline.face_count) if (found := outline.sides(face))}
    sides |= {face: list(around.order) for face, around in (iso or {}).items()}
    used = np.unique(outline.edge)
    while sides:
        faces = list(sides)
        matrix = _balance(outline, [sides[face] for face in faces])
        found = None
        if rows is not None and len(rows[1]):
            found = _solved(matrix, fewest, used, rows)
            if found is None:
                logger.info("vertices on opposite sides of faces cannot all be joined")
        if found is None:
            found = _solved(matrix, fewest, used)
        if found is not None:
            return found, sides
        # cannot happen on surfaces that are two-sided and cut at their seams; be safe
        worst = max(faces, key=lambda face: sum(len(side) for side in sides[face]))
        logger.info("face %d gets no regular grid: its sides cannot be balanced", worst + 1)
        del sides[worst]
    return fewest.copy(), sides


def _balance(outline: Outline, all_sides: list[list[np.ndarray]]) -> sparse.csr_matrix:
    """Rows that vanish where opposite sides have equal sums, two a face."""
    rows, columns, values = [], [], []
    for number, (a, b, c, d) in enumerate(all_sides):
        for k, (one, other) in enumerate(((a, c), (b, d))):
            for side, sign in ((one, 1.0), (other, -1.0)):
                rows += [2 * number + k] * len(side)
                columns += side.tolist()
                values += [sign] * len(side)
    shape = (2 * len(all_sides), len(outline.edges))
    return sparse.csr_matrix((values, (rows, columns)), shape=shape)


def _solved(
    matrix: sparse.csr_matrix,
    fewest: np.ndarray,
    used: np.ndarray,
    rows: tuple[sparse.csr_matrix, np.ndarray, np.ndarray] | None = None,
) -> np.ndarray | None:
    upper = np.full(len(fewest), np.inf)
    cost = 1.0 / fewest
    constraints = [LinearConstraint(matrix, 0.0, 0.0)]
    if rows is not None:
        constraints.append(LinearConstraint(*rows))
    result = milp(
        cost,
        constraints=constraints,
        bounds=Bounds(fewest, upper),
        integrality=np.ones(len(fewest)),
        options={"time_limit": SECONDS},
    )
    if result.x is None:
        return None
    found = np.round(result.x).astype(int)
    if np.any(matrix @ found != 0) or np.any(found[used] < fewest[used]):
        return None
    if rows is not None:
        sums = rows[0] @ found
        if np.any((sums < rows[1]) | (sums > rows[2])):
            return None
    return found
