# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Elements with two sides on a smooth rim are shared out before all elements become quads.

A corner of 180 degrees in one element stays one however often it is cut. A quad is halved there,
a triangle gives its third side up to the element behind it: then two or three elements meet in the
corner. What cannot be helped so is left to :mod:`.pillows`.
"""

from __future__ import annotations

import numpy as np

LEAST = 0.15
"""Smallest sine of a corner that new triangles may have."""


def opened_corners(
    elements: np.ndarray, rim: np.ndarray, flat: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Let more than one element of a face meet in each flat corner of its rim.

    Parameters
    ----------
    elements : (m, 4) int array
        Triangles (-1 at the end) and quads of one face, all turned the same way.
    rim : (k, 2) int array
        Sides on the rim, in any direction.
    flat : int array
        Points at which the rim goes on smoothly.
    points : (n, 3) array
        mm

    Returns
    -------
    (m', 4) int array
        The elements themselves where no corner is flat.
    """
    cells = [tuple(row[row >= 0].tolist()) for row in elements]
    sides = {frozenset(pair) for pair in rim.tolist()}
    smooth = set(flat.tolist())
    todo = [k for k in _suspects(elements, rim, flat) if _flat_places(cells[k], sides, smooth)]
    if not todo:
        return elements
    owner = {side: k for k, cell in enumerate(cells) for side in _directed(cell)}
    changed: dict[int, list[tuple[int, ...]]] = {}
    for k in todo:
        places = _flat_places(cells[k], sides, smooth)
        if len(places) != 1 or k in changed:
            continue
        cell = cells[k][places[0] :] + cells[k][: places[0]]
        if len(cell) == 4:
            parts, behind = [cell[:3], (cell[0], *cell[2:])], None
        else:
            behind = owner.get((cell[2], cell[1]))
            if behind is None or behind in changed:
                continue
            other = cells[behind]
            start = other.index(cell[1])
            chain = other[start:] + other[:start]  # from its second corner round to its third
            parts = [(cell[0], a, b) for a, b in zip(chain, chain[1:], strict=False)]
        before = [cell] if behind is None else [cell, cells[behind]]
        if any(_flat_places(part, sides, smooth) for part in parts):
            continue
        if _worst(parts, before, points) < LEAST:
            continue
        changed[k] = parts
        if behind is not None:
            changed[behind] = []
    if not changed:
        return elements
    rest = np.delete(elements, list(changed), axis=0)
    new = [part for parts in changed.values() for part in parts]
    return np.concatenate([rest, np.array([(*part, -1) for part in new])])


def _suspects(elements: np.ndarray, rim: np.ndarray, flat: np.ndarray) -> list[int]:
    """Elements with a flat corner between two rim points."""
    on = np.isin(elements, rim) & (elements >= 0)
    return np.flatnonzero((on.sum(axis=1) >= 3) & np.isin(elements, flat).any(axis=1)).tolist()


def _directed(cell: tuple[int, ...]) -> list[tuple[int, int]]:
    return list(zip(cell, (*cell[1:], cell[0]), strict=True))


def _flat_places(cell: tuple[int, ...], sides: set, smooth: set[int]) -> list[int]:
    """Places of the corners of an element between two sides on the smooth rim."""
    on = [frozenset(side) in sides for side in _directed(cell)]
    return [k for k, point in enumerate(cell) if on[k] and on[k - 1] and point in smooth]


def _worst(
    parts: list[tuple[int, ...]], before: list[tuple[int, ...]], points: np.ndarray
) -> float:
    """The smallest sine of the corners of triangles; negative where one is turned over."""
    normal = np.sum([_area(points[list(cell)]) for cell in before], axis=0)
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    found = []
    for part in parts:
        x = points[list(part)]
        ahead = np.roll(x, -1, axis=0) - x
        length = np.linalg.norm(ahead, axis=1)
        twice = float(2.0 * _area(x) @ normal)
        found.append(twice / max(float((length * np.roll(length, 1)).max()), 1e-300))
    return min(found)


def _area(x: np.ndarray) -> np.ndarray:
    """Vector of the area of a polygon, (3,)."""
    return 0.5 * np.cross(x, np.roll(x, -1, axis=0)).sum(axis=0)
