# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Features that fade out where the quads are smooth: vertices near them move onto them.

No line of the layout has to follow such a feature; but a knot line along it can bend where the
feature does, and a span that lies across it cannot.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .reference import Reference
from .snap import Snapped

NEAR = 0.45
"""Distance of a vertex from a feature, in mean sides of the quads there, that is near."""
APART = 0.4
"""Distance from the stretch that sharp lines of the quads follow, likewise."""
ROUNDS = 10
STEP = 0.5
"""Share of the way to the mean of the wanted places."""
_LEAST = 0.05
"""Weight of a perfect square beside one that is folded, which has 1."""


def faded(snap: Snapped, reference: Reference) -> Snapped:
    """The mesh with vertices near features that no sharp line follows moved onto these.

    The others then go where the squares nearest to the quads around would have them; what lies on
    features stays. A move that would make the sharpest or widest corner worse is taken back.

    Parameters
    ----------
    snap : Snapped
    reference : Reference
    """
    mesh = snap.mesh
    quads, x = mesh.quads, mesh.vertices.copy()
    ends, _ = mesh.edges
    side = np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)
    side = np.bincount(ends.ravel(), np.repeat(side, 2), len(x)) / np.bincount(
        ends.ravel(), minlength=len(x)
    )
    free = np.ones(len(x), dtype=bool)
    free[ends[snap.chain >= 0].ravel()] = False
    for number, chain in enumerate(reference.chains):
        rows = np.flatnonzero(free)
        at, off = chain.nearest(x[rows])
        near = off < NEAR * side[rows]
        taken = snap.length[snap.chain == number]
        if len(taken):
            gap = np.maximum(taken.min() - at, at - taken.max())
            near &= gap > APART * side[rows]
        x[rows[near]] = chain.at(at[near])
        free[rows[near]] = False
    if not free.any():
        return snap
    best, most = (mesh.vertices, _sines(mesh.vertices[quads]).min(axis=1))
    for _ in range(ROUNDS):
        x = evened(x, quads, free, reference)
    # a few quads may be worse than before, but none of them bad
    sine = _sines(x[quads]).min(axis=1)
    if (sine < np.minimum(most, 0.2)).any():
        return replace(snap, mesh=replace(mesh, vertices=best))
    return replace(snap, mesh=replace(mesh, vertices=x))


def evened(x: np.ndarray, quads: np.ndarray, free: np.ndarray, reference: Reference) -> np.ndarray:
    """Free vertices part of the way to where the squares around would have them.

    Parameters
    ----------
    x : (n, 3) array
    quads : (nf, 4) int array
    free : (n,) bool array
    reference : Reference
        What they stay on.

    Returns
    -------
    (n, 3) array
    """
    wanted, weight = _squares(x[quads])
    flat = quads.ravel()
    total = np.bincount(flat, np.repeat(weight, 4), len(x))
    wanted = (weight[:, None, None] * wanted).reshape(-1, 3)
    moved = np.column_stack([np.bincount(flat, wanted[:, c], len(x)) for c in range(3)])
    moved /= np.maximum(total, 1e-300)[:, None]
    normal = np.zeros_like(x)
    np.add.at(normal, quads, _normals(x[quads])[:, None])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    found = x.copy()
    found[free] = reference.nearest((x + STEP * (moved - x))[free], normal[free])[0]
    return found


def _normals(corners: np.ndarray) -> np.ndarray:
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)


def _sines(corners: np.ndarray) -> np.ndarray:
    """Sines (nf, 4) of corners (nf, 4, 3), seen along the quads' normals."""
    ahead = np.roll(corners, -1, axis=1) - corners
    ahead /= np.maximum(np.linalg.norm(ahead, axis=2, keepdims=True), 1e-300)
    back = -np.roll(ahead, 1, axis=1)
    return np.einsum("fkd,fd->fk", np.cross(ahead, back), _normals(corners))


def _squares(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The square nearest to each quad, (nf, 4, 3), and how much it counts, (nf,)."""
    normal = _normals(corners)[:, None]
    middle = corners.mean(axis=1, keepdims=True)
    away = corners - middle
    away = away - (away * normal).sum(axis=2, keepdims=True) * normal
    side = np.cross(np.broadcast_to(normal, away.shape), away)
    # turned back by 0, 90, 180 and 270 degrees all corners of a square are the same
    one = (away[:, 0] - side[:, 1] - away[:, 2] + side[:, 3])[:, None] / 4.0
    other = np.cross(normal, one)
    square = middle + np.concatenate([one, other, -one, -other], axis=1)
    bad = 1.0 - np.clip(_sines(corners).min(axis=1), 0.0, 1.0)
    return square, _LEAST + bad**4
