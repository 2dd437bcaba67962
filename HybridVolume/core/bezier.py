# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bernstein polynomials and batches of trivariate Bézier elements."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np


def bernstein(degree: int, x: np.ndarray, derivative: int = 0) -> np.ndarray:
    """Bernstein polynomials (or their derivatives) at points of [0, 1].

    Parameters
    ----------
    degree : int
    x : (m,) array
    derivative : int

    Returns
    -------
    (m, degree + 1) array
    """
    x = np.asarray(x, dtype=float)
    if derivative > degree:
        return np.zeros((len(x), degree + 1))
    if derivative:
        lower = bernstein(degree - 1, x, derivative - 1) * degree
        padded = np.pad(lower, ((0, 0), (1, 1)))
        return padded[:, :-1] - padded[:, 1:]
    i = np.arange(degree + 1)
    binomial = np.array([comb(degree, k) for k in i], dtype=float)
    return binomial * x[:, None] ** i * (1.0 - x[:, None]) ** (degree - i)


@dataclass(frozen=True)
class BezierElements:
    """A batch of trivariate Bézier elements of one degree, right-handed (det J > 0 when valid).

    Attributes
    ----------
    degrees : (int, int, int)
    control_points : (ne, p+1, q+1, r+1, 3) array
        Euclidean control points (not multiplied by the weights), mm.
    weights : (ne, p+1, q+1, r+1) array or None
        Positive weights; None where every element is polynomial.
    element : (ne,) int array
        Number of each element in the whole shell.
    patch : (ne,) int array
        Patch that each element belongs to.
    singular : (ne, 3, 3) bool array or None
        Where the outer boundary (w = 0) that is given is singular itself, as
        :func:`HybridVolume.core.singular.singular_flags`, first index along the first direction;
        None where nowhere.
    """

    degrees: tuple[int, int, int]
    control_points: np.ndarray
    weights: np.ndarray | None
    element: np.ndarray
    patch: np.ndarray
    singular: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.control_points)
