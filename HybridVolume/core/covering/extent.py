# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How many control points a cover has once all patches along a strip have one degree and one set
of knots.

Exact edges may have high degrees and many knots; every patch of the strip that begins at such an
edge takes them over.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .coons import Nets
from .quad_mesh import QuadCover


def control_points(cover: QuadCover, nets: Sequence[Nets]) -> np.ndarray:
    """Control points of the patch of each quad, (m,), when joined with all others.

    Knots of sides that run against each other are counted as they are, which is too many at most.

    Parameters
    ----------
    cover : QuadCover
    nets : sequence of Nets
        Patches of all quads.
    """
    quads, count = cover.quads, len(cover.points)
    pairs = np.stack([quads, np.roll(quads, -1, axis=1)], axis=2)
    keys, place = np.unique(pairs.min(axis=2) * count + pairs.max(axis=2), return_inverse=True)
    place = place.reshape(-1, 4)
    links = np.concatenate([place[:, [0, 2]], place[:, [1, 3]]])
    shape = (len(keys), len(keys))
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=shape)
    strips, label = connected_components(graph, directed=False)
    strip = label[place[:, :2]]
    degree = np.zeros(strips, dtype=int)
    inner: list[dict[float, int]] = [{} for _ in range(strips)]
    for group in nets:
        for axis, (p, knots) in enumerate(zip(group.degrees, group.knots, strict=True)):
            own = np.unique(strip[group.quads, axis])
            degree[own] = np.maximum(degree[own], p)
            values, times = np.unique(np.round(knots[p + 1 : -p - 1], 9), return_counts=True)
            for k in own.tolist() if len(values) else ():
                for value, number in zip(values.tolist(), times.tolist(), strict=True):
                    # raising the degree keeps the smoothness
                    inner[k][value] = max(inner[k].get(value, -p), number - p)
    rows = np.array([
        p + 1 + sum(number + p for number in known.values())
        for p, known in zip(degree.tolist(), inner, strict=True)
    ])  # fmt: skip
    return rows[strip].prod(axis=1)
