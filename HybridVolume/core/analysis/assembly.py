# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Matrices and vectors of a space, summed over blocks of elements by batched products."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

import numpy as np
from scipy import sparse

from .spline_space import Samples


class Space(Protocol):
    """What can be assembled: a number of unknowns, and samples of all elements."""

    @property
    def size(self) -> int:
        """Number of unknowns."""

    def samples(self, points: int | None = None) -> Iterable[Samples]:
        """Functions at quadrature points, a block of elements at a time."""


def mass(space: Space, points: int | None = None) -> sparse.csr_matrix:
    """Integrals of products of two functions, (size, size), mm³."""
    return _summed(
        space,
        points,
        lambda s: np.swapaxes(s.values * s.measure[..., None], 1, 2) @ s.values,
    )


def stiffness(space: Space, points: int | None = None) -> sparse.csr_matrix:
    """Integrals of products of two gradients, (size, size), mm."""

    def block(s: Samples) -> np.ndarray:
        ne, nq, _, nl = s.gradients.shape
        flat = s.gradients.reshape(ne, 3 * nq, nl)
        weighted = (s.gradients * s.measure[..., None, None]).reshape(ne, 3 * nq, nl)
        return np.swapaxes(flat, 1, 2) @ weighted

    return _summed(space, points, block)


def load(space: Space, source: Callable, points: int | None = None) -> np.ndarray:
    """Integrals of a function times each function of the space, (size,).

    Parameters
    ----------
    space : Space
    source : callable
        Takes (m, 3) points, mm, and returns (m,) values.
    points : int, optional
        Gauss points a direction.
    """
    total = np.zeros(space.size)
    for s in space.samples(points):
        value = source(s.points.reshape(-1, 3)).reshape(s.measure.shape) * s.measure
        part = np.einsum("eq,eqi->ei", value, s.values)
        total += np.bincount(s.unknowns.ravel(), part.ravel(), space.size)
    return total


def errors(
    space: Space,
    coefficients: np.ndarray,
    exact: Callable,
    slope: Callable,
    points: int | None = None,
) -> tuple[float, float]:
    """Squares of the errors in L2 and in the H1 seminorm over the space's elements.

    Parameters
    ----------
    space : Space
    coefficients : (size,) array
    exact, slope : callables
        Take (m, 3) points and return (m,) values and (m, 3) gradients.
    points : int, optional
    """
    found = np.zeros(2)
    for s in space.samples(points):
        inside = coefficients[s.unknowns]
        x = s.points.reshape(-1, 3)
        value = np.einsum("eqi,ei->eq", s.values, inside) - exact(x).reshape(s.measure.shape)
        gradient = np.einsum("eqci,ei->eqc", s.gradients, inside)
        gradient -= slope(x).reshape(gradient.shape)
        found += [(value**2 * s.measure).sum(),
                  (gradient**2 * s.measure[..., None]).sum()]  # fmt: skip
    return float(found[0]), float(found[1])


def _summed(space: Space, points: int | None, block: Callable) -> sparse.csr_matrix:
    shape = (space.size, space.size)
    parts = [sparse.csr_matrix(shape)]
    for s in space.samples(points):
        number = s.unknowns.shape[1]
        rows = np.repeat(s.unknowns, number, axis=1).ravel()
        columns = np.tile(s.unknowns, (1, number)).ravel()
        parts.append(sparse.coo_matrix((block(s).ravel(), (rows, columns)), shape=shape).tocsr())
    # two by two: each entry is touched a few times, not once a block
    while len(parts) > 1:
        odd = parts[len(parts) // 2 * 2 :]
        parts = [a + b for a, b in zip(parts[::2], parts[1::2], strict=False)] + odd
    return parts[0]
