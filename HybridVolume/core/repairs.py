# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Repairs of curved elements that are not valid, or nearly so: inner nodes move, and only there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from .curving import untangle
from .element_jacobians import prove_positive, scaled_jacobian

_ROUNDS, _LAST = 6, 20
"""Rounds of half-way steps, and all rounds: elements that have a curved and a straight side may be
worse than all straight, so that what is straight spreads."""
_KEPT_QUALITY = 0.5
"""Share of its straight scaled Jacobian that a curved tet should have."""
_POOR, _WORST = 0.02, 0.002
"""Scaled Jacobians below which wedges, and wedges with all around them, are worth the work."""
_PASSES = (
    (3, 0, {"penta15": 0.0, "tet10": 0.0}),
    (4, 1, {"penta15": 0.0, "tet10": 0.0}),
    (5, 2, {"penta15": 0.0, "tet10": 0.0}),
    (3, 0, {"penta15": _POOR, "tet10": 0.0}),
    (4, 1, {"penta15": _WORST, "tet10": 0.0}),
)
"""Density of samples, rings of elements around the poor ones, and what counts as poor: first those
that are not proved, then poor wedges. Tets that are proved are hardly better straight, as flat as
their corners: wedges gain much."""

_MANY = 100
"""Poor elements up to which those that are proved are worth the work."""
_FEW = 10
"""Elements that are not proved, up to which all passes are tried."""


class Elements:
    """Elements over nodes that may move, with what is proved of each.

    Parameters
    ----------
    nodes : (n, 3) array
        mm
    kinds : sequence of (kind, connectivity)

    Attributes
    ----------
    nodes : (n, 3) array
    proved, lower_bound, quality : lists of (m,) arrays
        For each kind: whether det J > 0 is proved, a bound of it (mm³), the smallest scaled
        Jacobian.
    """

    def __init__(self, nodes: np.ndarray, kinds: Sequence[tuple[str, np.ndarray]]) -> None:
        self.nodes, self.kinds = nodes, list(kinds)
        self.proved = [np.zeros(len(c), dtype=bool) for _, c in kinds]
        self.lower_bound = [np.zeros(len(c)) for _, c in kinds]
        self.quality = [np.zeros(len(c)) for _, c in kinds]
        self._judge([np.arange(len(c)) for _, c in kinds])

    @property
    def all_proved(self) -> bool:
        """Whether every element is proved valid."""
        return all(p.all() for p in self.proved)

    @property
    def unproved(self) -> int:
        """Elements that are not proved valid."""
        return sum(int(np.count_nonzero(~p)) for p in self.proved)

    def move(self, nodes: np.ndarray) -> None:
        """Give all nodes new places; elements none of whose nodes moved are not judged again."""
        moved = (nodes != self.nodes).any(axis=1)
        self.nodes = nodes
        self._judge([np.flatnonzero(moved[c].any(axis=1)) for _, c in self.kinds])

    def _judge(self, rows: list[np.ndarray]) -> None:
        for k, ((kind, c), again) in enumerate(zip(self.kinds, rows, strict=True)):
            x = self.nodes[c[again]]
            proof = prove_positive(kind, x)
            self.proved[k][again] = proof.proved
            self.lower_bound[k][again] = proof.lower_bound
            self.quality[k][again] = scaled_jacobian(kind, x)

    def judged(self) -> list[np.ndarray]:
        """Scaled Jacobian of each element of each kind, -1 where it is not proved."""
        return [np.where(p, q, -1.0) for p, q in zip(self.proved, self.quality, strict=True)]


def straighten(elements: Elements, movable: np.ndarray, ends: np.ndarray) -> int:
    """Move inner mid nodes of bad elements half-way to straight, again and again.

    Bad are elements that are not proved, and tets that curving made worse by half.

    Parameters
    ----------
    elements : Elements
    movable : (m,) int array
        Mid nodes that may move.
    ends : (m, 2) int array
        Ends of their edges.

    Returns
    -------
    int
        Nodes that were moved.
    """
    curved = elements.nodes
    straight = curved.copy()
    straight[movable] = 0.5 * (curved[ends[:, 0]] + curved[ends[:, 1]])
    least = [np.full(len(c), -np.inf) for _, c in elements.kinds]
    for low, (kind, c) in zip(least, elements.kinds, strict=True):
        if kind == "tet10":
            changed = np.zeros(len(curved), dtype=bool)
            changed[movable] = True
            rows = np.flatnonzero(changed[c].any(axis=1))
            low[rows] = _KEPT_QUALITY * scaled_jacobian(kind, straight[c[rows]])
    share = np.ones(len(curved))
    may_move = np.zeros(len(curved), dtype=bool)
    may_move[movable] = True
    for round_ in range(_LAST):
        bad = [
            c[~proved | (quality < low)].ravel()
            for (_, c), proved, quality, low in zip(
                elements.kinds, elements.proved, elements.quality, least, strict=True
            )
        ]
        bad = np.unique(np.concatenate(bad))
        bad = bad[may_move[bad] & (share[bad] > 0.0)]
        if not len(bad):
            break
        share[bad] = 0.0 if round_ >= _ROUNDS - 1 else 0.5 * share[bad]
        nodes = elements.nodes.copy()
        mix = share[bad, None]
        nodes[bad] = mix * curved[bad] + (1.0 - mix) * straight[bad]
        elements.move(nodes)
    return int(np.count_nonzero((elements.nodes != curved).any(axis=1)))


def untangle_inside(elements: Elements, may_move: np.ndarray) -> int:
    """Move nodes near elements that are not proved, and near poor wedges.

    Each cluster of such elements is taken as it was where its worst element got no better.

    Parameters
    ----------
    elements : Elements
    may_move : (n,) bool array

    Returns
    -------
    int
        Nodes that were moved.
    """
    before = elements.nodes
    for density, rings, least in _PASSES:
        judged = elements.judged()
        poor = [q < least[kind] for q, (kind, _) in zip(judged, elements.kinds, strict=True)]
        count = sum(int(np.count_nonzero(p)) for p in poor)
        if not count:
            continue
        if any(least.values()) and (count > _MANY or not elements.all_proved):
            break
        near = np.zeros(len(before), dtype=bool)
        for flags, (_, c) in zip(poor, elements.kinds, strict=True):
            near[c[flags]] = True
        for _ in range(rings):
            for _, c in elements.kinds:
                near[c[near[c].any(axis=1)]] = True
        free = near & may_move
        if not free.any():
            continue
        rows = [np.flatnonzero(free[c].any(axis=1)) for _, c in elements.kinds]
        around = [(kind, c[r]) for r, (kind, c) in zip(rows, elements.kinds, strict=True)]
        old = elements.nodes
        fresh = untangle(old, around, free, density)
        cluster = cluster_numbers([c for _, c in around], free)
        elements.move(fresh)
        clusters = int(cluster.max()) + 1
        worst = [np.full(clusters, np.inf) for _ in range(2)]
        for low, found in zip(worst, (judged, elements.judged()), strict=True):
            for r, (_, c), q in zip(rows, around, found, strict=True):
                np.minimum.at(low, cluster[c].max(axis=1), q[r])
        undone = free & np.append(worst[1] <= worst[0], False)[cluster]
        if undone.any():
            elements.move(np.where(undone[:, None], old, fresh))
        if elements.unproved > max(_FEW, 0.5 * sum(int((q < 0.0).sum()) for q in judged)):
            # denser samples around more elements would take long, and hardly help
            break
    return int(np.count_nonzero((elements.nodes != before).any(axis=1)))


def cluster_numbers(connectivity: list[np.ndarray], free: np.ndarray) -> np.ndarray:
    """Cluster of every free node, -1 for others: nodes of one element are in one, (n,)."""
    pairs = []
    for c in connectivity:
        first = np.take_along_axis(c, free[c].argmax(axis=1)[:, None], axis=1)
        chosen = free[c]
        pairs.append(np.column_stack([np.broadcast_to(first, c.shape)[chosen], c[chosen]]))
    rows, columns = np.concatenate(pairs).T
    n = len(free)
    _, label = connected_components(
        coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(n, n)), directed=False
    )
    cluster = np.full(n, -1)
    cluster[free] = np.unique(label[free], return_inverse=True)[1].reshape(-1)
    return cluster
