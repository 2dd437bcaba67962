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


def in_half_space(vectors: np.ndarray, margin: float, rounds: int = 1000) -> np.ndarray:
    """Whether a direction d has n . d > margin for all of some unit vectors n, (m,) bool.

    The same steps as `most_inward`. A set is settled as soon as a direction is found, or when the
    hull is known to come so near to the origin that there is none.

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
    for _ in range(rounds):
        if not len(left):
            break
        along = np.einsum("mki,mi->mk", vectors, d)
        worst = along.argmin(axis=1)
        rows = np.arange(len(left))
        length = np.linalg.norm(d, axis=1)
        least = along[rows, worst] / np.maximum(length, 1e-300)
        found[left[least > margin]] = True
        step = vectors[rows, worst] - d
        size = np.einsum("mi,mi->m", step, step)
        share = np.clip(-np.einsum("mi,mi->m", d, step) / np.maximum(size, 1e-300), 0.0, 1.0)
        # no direction has more than the length of a point of the hull
        stay = (least <= margin) & (length > margin) & (share >= 1e-7)
        d = d + share[:, None] * step
        if not stay.all():
            left, d, vectors = left[stay], d[stay], vectors[stay]
    return found


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
