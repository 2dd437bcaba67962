# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The direction that a set of normals has most in common."""

from __future__ import annotations

from itertools import combinations

import numpy as np


def most_inward(vectors: np.ndarray, valid: np.ndarray, rounds: int = 200) -> np.ndarray:
    """Directions d that make the smallest n . d over a set of unit vectors as large as possible.

    The point of the convex hull of the vectors nearest to the origin, by Frank-Wolfe steps.

    Parameters
    ----------
    vectors : (m, k, 3) array
    valid : (m, k) bool array
        Which of the k vectors count.
    rounds : int

    Returns
    -------
    (m, 3) array of unit vectors (zero where the hull contains the origin)
    """
    weight = valid / valid.sum(axis=1, keepdims=True)
    d = np.einsum("mk,mki->mi", weight, vectors)
    best, best_margin = d.copy(), np.full(len(d), -np.inf)
    rows = np.arange(len(d))
    for _ in range(rounds):
        along = np.where(valid, np.einsum("mki,mi->mk", vectors, d), np.inf)
        worst = along.argmin(axis=1)
        length = np.linalg.norm(d, axis=1)
        margin = along[rows, worst] / np.maximum(length, 1e-300)
        better = margin > best_margin
        best[better], best_margin[better] = d[better], margin[better]
        step = vectors[rows, worst] - d
        size = np.einsum("mi,mi->m", step, step)
        share = np.clip(-np.einsum("mi,mi->m", d, step) / np.maximum(size, 1e-300), 0.0, 1.0)
        if np.all(share < 1e-7):
            break
        d = d + share[:, None] * step
    length = np.linalg.norm(best, axis=1, keepdims=True)
    return np.where(length > 1e-12, best / np.maximum(length, 1e-300), 0.0)


def in_half_space(vectors: np.ndarray, margin: float, rounds: int = 100) -> np.ndarray:
    """Whether a direction d has n . d > margin for all of some unit vectors n, (m,) bool.

    The point of the convex hull nearest to the origin is the best direction (but for its length).
    It is found by steps from one simplex of at most four of the vectors to the next, which adds the
    vector least along the simplex's own nearest point and leaves out what that does not need
    (Gilbert, Johnson and Keerthi, IEEE J. Robotics and Automation 4 (1988) 193). A set is settled
    as soon as a direction is found, or when the hull is known to come so near to the origin that
    there is none. That a direction is one is seen from the vectors themselves.

    Parameters
    ----------
    vectors : (m, k, 3) array
    margin : float
        Larger than 0.
    rounds : int
        Sets that are not settled after so many steps count as not found.
    """
    found = np.zeros(len(vectors), dtype=bool)
    left = np.arange(len(vectors))
    d = vectors.mean(axis=1)
    simplex: np.ndarray | None = None
    for _ in range(rounds):
        if not len(left):
            break
        along = np.matmul(vectors, d[:, :, None])[..., 0]
        worst = along.argmin(axis=1)
        rows = np.arange(len(left))
        squared = (d * d).sum(axis=1)
        length = np.sqrt(squared)
        least = along[rows, worst] / np.maximum(length, 1e-300)
        found[left[least > margin]] = True
        # no direction has more than the length of a point of the hull; a point of the hull that
        # no vector lies below is the nearest
        stay = (least <= margin) & (length > margin)
        if simplex is not None:
            stay &= along[rows, worst] < squared * (1.0 - 1e-12)
        added = vectors[rows, worst]
        if not stay.all():
            left, vectors, added = left[stay], vectors[stay], added[stay]
            simplex = None if simplex is None else simplex[stay]
        if simplex is None:
            simplex = np.repeat(added[:, None], 3, axis=1)
            d = added
        else:
            simplex, d = _nearest_simplex(simplex, added)
    return found


_FACES = ((0,), (1,), (2,), (0, 1), (0, 2), (1, 2))
"""Sides of a triangle that make edges and triangles with a fourth corner."""


def _nearest_simplex(simplex: np.ndarray, added: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The point nearest to the origin of simplices with another corner, and what holds it.

    Parameters
    ----------
    simplex : (m, 3, 3) array
        Corners of a point, an edge or a triangle; some are repeated where it has fewer than three.
    added : (m, 3) array
        A vector that is less along the simplex's nearest point: a corner of what is nearest now.

    Returns
    -------
    simplex : (m, 3, 3) array
        Corners of the face that holds the nearest point.
    nearest : (m, 3) array
        Zero where the origin is inside.
    """
    nearest, distance = added.copy(), (added * added).sum(axis=1)
    kept = np.repeat(added[:, None], 3, axis=1)
    for face in _FACES:
        steps = simplex[:, face] - added[:, None]
        share, usable = _shares(steps, added)
        point = added + (share[..., None] * steps).sum(axis=1)
        squared = (point * point).sum(axis=1)
        better = usable & (squared < distance)
        nearest[better], distance[better] = point[better], squared[better]
        kept[better, : len(face)] = simplex[better][:, face]
        kept[better, len(face) :] = added[better][:, None]
    nearest[_shares(simplex - added[:, None], added)[1]] = 0.0
    return kept, nearest


def _shares(steps: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares of steps (m, k, 3) from the start to the point nearest to the origin, and where
    all are positive with a sum of less than 1."""
    gram = steps @ steps.transpose(0, 2, 1)
    k = steps.shape[1]
    size = np.trace(gram, axis1=1, axis2=2)
    usable = np.linalg.det(gram) > 1e-14 * size**k
    gram[~usable] = np.eye(k)
    share = np.linalg.solve(gram, -(steps @ start[:, :, None]))[..., 0]
    return share, usable & (share > 0.0).all(axis=1) & (share.sum(axis=1) < 1.0)


def widest_direction(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions d that make the smallest v . d over a few vectors as large as possible.

    Exact: the best d is equally far from one, two or three of the vectors, so all of these are
    tried. Meant for few vectors (all that meet at a vertex): there are k + k (k - 1) + ... tries.

    Parameters
    ----------
    vectors : (m, k, 3) array
        Of any length.

    Returns
    -------
    direction : (m, 3) array
    margin : (m,) array
        The smallest v . d; negative where no direction has all vectors on its side.
    """
    m, k, _ = vectors.shape
    best, margin = np.zeros((m, 3)), np.full(m, -np.inf)

    def attempt(d: np.ndarray) -> None:
        length = np.linalg.norm(d, axis=1)
        d = d / np.maximum(length, 1e-300)[:, None]
        least = np.einsum("mki,mi->mk", vectors, d).min(axis=1)
        better = (length > 0.0) & (least > margin)
        best[better], margin[better] = d[better], least[better]

    for i in range(k):
        attempt(vectors[:, i])
    for i, j in combinations(range(k), 2):
        a, step = vectors[:, i], vectors[:, j] - vectors[:, i]
        size = np.einsum("mi,mi->m", step, step)
        share = -np.einsum("mi,mi->m", a, step) / np.maximum(size, 1e-300)
        attempt(a + np.clip(share, 0.0, 1.0)[:, None] * step)
    for i, j, n in combinations(range(k), 3):
        a = vectors[:, i]
        normal = np.cross(vectors[:, j] - a, vectors[:, n] - a)
        attempt(normal)
        attempt(-normal)
    # nothing to choose between vectors that all vanish
    margin[~np.isfinite(margin)] = 0.0
    return best, margin
