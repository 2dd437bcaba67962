# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Matrices and vectors of a space, summed over blocks of elements by batched products."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

import numpy as np
from scipy import sparse

from .samples import Samples


class Space(Protocol):
    """What can be assembled: a number of unknowns, and samples of all elements."""

    @property
    def size(self) -> int:
        """Number of unknowns."""

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""

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
        ne, nq, dim, nl = s.gradients.shape
        flat = s.gradients.reshape(ne, dim * nq, nl)
        weighted = (s.gradients * s.measure[..., None, None]).reshape(ne, dim * nq, nl)
        return np.swapaxes(flat, 1, 2) @ weighted

    return _summed(space, points, block)


def elastic(
    space: Space, lame: float, shear: float, points: int | None = None
) -> sparse.csr_matrix:
    """Stiffness of an isotropic linear material, (d size, d size), N/mm.

    Unknowns are the x components, then the y (and the z) components. In the plane (d = 2) the
    strain is plane, and the figures are those of a slice of 1 mm.

    Parameters
    ----------
    space : Space
    lame, shear : float
        Lamé's constants, MPa.
    points : int, optional
        Gauss points a direction.
    """
    dim = space.dimension
    pairs = [(c, d) for c in range(dim) for d in range(c, dim)]

    def block(s: Samples) -> list[np.ndarray]:
        parts = np.moveaxis(s.gradients, 2, 0)
        weighted = parts * s.measure[..., None]
        # products of the derivatives along c and d, each once
        found = {(c, d): np.swapaxes(parts[c], 1, 2) @ weighted[d] for c, d in pairs}
        trace = shear * sum(found[c, c] for c in range(dim))
        return [
            (lame + shear) * found[c, c] + trace
            if c == d
            else lame * found[c, d] + shear * np.swapaxes(found[c, d], 1, 2)
            for c, d in pairs
        ]

    blocks = dict(zip(pairs, _all_summed(space, points, block, len(pairs)), strict=True))
    rows = [
        [blocks[c, d] if c <= d else blocks[d, c].T.tocsr() for d in range(dim)] for c in range(dim)
    ]
    # row by row, which needs no sorting
    return sparse.vstack([sparse.hstack(row, format="csr") for row in rows], format="csr")


def load(space: Space, source: Callable, points: int | None = None) -> np.ndarray:
    """Integrals of a function times each function of the space, (size,).

    Parameters
    ----------
    space : Space
    source : callable
        Takes (m, d) points, mm, and returns (m,) values.
    points : int, optional
        Gauss points a direction.
    """
    total = np.zeros(space.size)
    for s in space.samples(points):
        value = source(s.points.reshape(-1, s.dimension)).reshape(s.measure.shape) * s.measure
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
        Take (m, d) points and return (m,) values and (m, d) gradients.
    points : int, optional
    """
    found = np.zeros(2)
    for s in space.samples(points):
        inside = coefficients[s.unknowns]
        x = s.points.reshape(-1, s.dimension)
        value = np.einsum("eqi,ei->eq", s.values, inside) - exact(x).reshape(s.measure.shape)
        gradient = np.einsum("eqci,ei->eqc", s.gradients, inside)
        gradient -= slope(x).reshape(gradient.shape)
        found += [(value**2 * s.measure).sum(),
                  (gradient**2 * s.measure[..., None]).sum()]  # fmt: skip
    return float(found[0]), float(found[1])


def _summed(space: Space, points: int | None, block: Callable) -> sparse.csr_matrix:
    return _all_summed(space, points, lambda s: [block(s)], 1)[0]


def _all_summed(
    space: Space, points: int | None, blocks: Callable, count: int
) -> list[sparse.csr_matrix]:
    """Several matrices of which ``blocks`` gives the parts of some elements."""
    shape = (space.size, space.size)
    parts = [[sparse.csr_matrix(shape)] for _ in range(count)]
    for s in space.samples(points):
        # sorted once for all matrices, which costs more than their products
        keys = (s.unknowns[:, :, None] * space.size + s.unknowns[:, None, :]).ravel()
        order = np.argsort(keys)
        keys = keys[order]
        first = np.flatnonzero(np.diff(keys, prepend=-1))
        rows, columns = np.divmod(keys[first], space.size)
        start = np.searchsorted(rows, np.arange(space.size + 1))
        for found, values in zip(parts, blocks(s), strict=True):
            entries = np.add.reduceat(values.ravel()[order], first)
            found.append(sparse.csr_matrix((entries, columns, start), shape=shape))
    return [_added(found) for found in parts]


def _added(parts: list[sparse.csr_matrix]) -> sparse.csr_matrix:
    """The sum two by two: each entry is touched a few times, not once a block."""
    while len(parts) > 1:
        odd = parts[len(parts) // 2 * 2 :]
        parts = [a + b for a, b in zip(parts[::2], parts[1::2], strict=False)] + odd
    return parts[0]
