# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Repair of simplices that a curved interface folds: the nodes inside the core give way.

Nodes on the interface stay where they are. What is repaired is proved by Bernstein coefficients
of det J, subdivided where they do not decide.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..curving import batch_towards, relaxed
from ..repairs import cluster_numbers
from .simplex_space import SimplexSpace, lattice, shape_functions

_LIGHT = ((0, 1, 2), (0, 2, 3))
_HEAVY = (*_LIGHT, (1, 2, 6), (2, 3, 6), (3, 4, 6))
"""Samples on an edge beyond those that det J has coefficients, rings of elements that move, and
rounds of the barrier."""
_YIELDS, _HALVES = 40, 3
"""Steps towards safe places, and how many of them go half-way: others go all the way, so that what
is safe spreads until nothing is folded."""
_UNEVEN = 0.02
"""Smallest det J over its mean in an element below which it is worth an attempt to be better."""


def unfolded(space: SimplexSpace, light: bool = False) -> tuple[SimplexSpace, int]:
    """The space with nodes inside moved where elements are folded, or nearly so.

    Parameters
    ----------
    space : SimplexSpace
    light : bool
        Try what takes little time only.

    Returns
    -------
    space : SimplexSpace
        Whether no element is folded any more is for the caller to see
        (:attr:`.simplex_space.SimplexSpace.jacobian_bounds`).
    moved : int
        Nodes that were moved.
    """
    fixed = np.zeros(space.size, dtype=bool)
    fixed[space.interface] = True
    nodes, elements = space.nodes, space.elements
    quality = evenness(space, nodes)
    for more, rings, rounds in _LIGHT if light else _HEAVY:
        poor = quality < _UNEVEN
        if not poor.any():
            break
        near = np.zeros(len(nodes), dtype=bool)
        near[elements[poor]] = True
        for _ in range(rings - 1):
            near[elements[near[elements].any(axis=1)]] = True
        free = near & ~fixed
        if not free.any():
            continue
        touched = np.flatnonzero(free[elements].any(axis=1))
        cluster = cluster_numbers([elements[touched]], free)
        owner = cluster[elements[touched]].max(axis=1)
        # each cluster on its own: one that is hopeless must not hold up the others
        for rows in np.split(
            touched[np.argsort(owner, kind="stable")], np.cumsum(np.bincount(owner))[:-1]
        ):
            fresh = _moved(space.degree, nodes, elements[rows], free, more, rounds)
            found = evenness(space, fresh, rows)
            if _score(found) > _score(quality[rows]):
                nodes = fresh
                quality[rows] = found
    count = int(np.count_nonzero((nodes != space.nodes).any(axis=1)))
    return replace(space, nodes=nodes) if count else space, count


def yielded(space: SimplexSpace, safe: np.ndarray) -> tuple[SimplexSpace, int]:
    """The space with nodes of folded elements taken towards places where nothing is folded.

    Nodes on the interface give way, too: they stand off the inner surface then, and what couples
    both spaces reckons with it.

    Parameters
    ----------
    space : SimplexSpace
    safe : (n, d) array
        Places of all nodes with which every element is valid, mm.

    Returns
    -------
    space : SimplexSpace
    count : int
        Nodes on the interface that gave way.
    """
    share = np.ones(space.size)
    nodes, rows = space.nodes, np.arange(len(space.elements))
    for step in range(_YIELDS):
        bad = space.bounds_of(rows, nodes)[0] <= 0.0
        touched = np.unique(space.elements[rows[bad]])
        touched = touched[share[touched] > 0.0]
        if not len(touched):
            break
        share[touched] = 0.5 * share[touched] if step < _HALVES else 0.0
        nodes = share[:, None] * space.nodes + (1.0 - share[:, None]) * safe
        nodes[share == 0.0] = safe[share == 0.0]
    count = int(np.count_nonzero(share[space.interface] < 1.0))
    return replace(space, nodes=nodes), count


def evenness(space: SimplexSpace, nodes: np.ndarray, rows: np.ndarray | None = None) -> np.ndarray:
    """Lower bound of det J over its mean in each element, (m,): in [-1, 1], and 1 if straight."""
    rows = np.arange(len(space.elements)) if rows is None else rows
    low, mean = space.bounds_of(rows, nodes)
    return np.clip(low / np.maximum(np.abs(mean), 1e-300), -1.0, 1.0)


def _score(quality: np.ndarray) -> tuple[int, float]:
    """How good a state is: few folded elements, and the poor ones less poor."""
    return -int(np.count_nonzero(quality <= 0.0)), float(np.minimum(quality, _UNEVEN).sum())


def _moved(
    degree: int, nodes: np.ndarray, elements: np.ndarray, free: np.ndarray, more: int, rounds: int
) -> np.ndarray:
    """All nodes, the free ones at places where the energy of the elements is least."""
    dim = nodes.shape[1]
    used = np.unique(elements)
    number = np.full(len(nodes), -1)
    number[used] = np.arange(len(used))
    count = max(dim * (degree - 1), 1) + more
    _, slopes = shape_functions(degree, lattice(dim, count)[:, 1:] / count)
    corners = nodes[elements[:, : dim + 1]]
    target = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)[:, None]
    batch = batch_towards(number[elements], np.swapaxes(slopes, 1, 2), target)
    result = nodes.copy()
    movable = np.flatnonzero(free[used])
    result[used[movable]] = relaxed(nodes[used], movable, [batch], rounds)
    return result
