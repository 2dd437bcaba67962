# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Where the entries of a body's tangent stand: worked out once, filled at every step.

Spaces have sparse matrices of their own; with E the matrix from the coupled unknowns to a space's,
E' K E is linear in the entries of K, so it is one sparse product with them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse


def pairs(d: int) -> list[tuple[int, int]]:
    """Components (i, k) with i <= k, in the order of the blocks of a tangent."""
    return [(i, k) for i in range(d) for k in range(i, d)]


class Layout:
    """Symmetric matrices of d components over coupled unknowns.

    Parameters
    ----------
    patterns : sequence of (m, m) sparse matrices
        Entries of each space's own matrices, CSR with sorted columns.
    embeddings : sequence of (m, n) sparse matrices
        From the coupled unknowns to those of the space.
    dimension : int
    """

    def __init__(
        self,
        patterns: Sequence[sparse.csr_matrix],
        embeddings: Sequence[sparse.csr_matrix],
        dimension: int,
    ) -> None:
        size = embeddings[0].shape[1]
        self.size, self.dimension = size, dimension
        entries = [_entries(*given) for given in zip(patterns, embeddings, strict=True)]
        keys = np.unique(np.concatenate([key for key, _, _ in entries]))
        self._transfers = [
            sparse.csr_matrix(
                (value, (np.searchsorted(keys, key), entry)), shape=(len(keys), pattern.nnz)
            )
            for (key, entry, value), pattern in zip(entries, patterns, strict=True)
        ]
        rows, columns = np.divmod(keys, size)
        # the entry across the diagonal from each
        self._mirror = np.searchsorted(keys, columns * size + rows)
        count = np.bincount(rows, minlength=size)
        shift = size * np.arange(dimension)
        # a row of the whole matrix has the row's entries of each component, one after the other
        order = np.argsort(np.tile(rows, dimension), kind="stable")
        self._order = order
        self._indices = (columns + shift[:, None]).ravel()[order]
        self._indices = np.tile(self._indices, dimension).astype(np.int32)
        self._indptr = np.concatenate([[0], np.cumsum(np.tile(dimension * count, dimension))])

    def matrix(self, parts: Sequence[np.ndarray]) -> sparse.csr_matrix:
        """The coupled matrix (d n, d n) of the entries of each space's blocks (i, k), i <= k.

        Parameters
        ----------
        parts : sequence of (blocks, entries) arrays
            Of each space, blocks in the order of :func:`pairs`.
        """
        d = self.dimension
        found = {}
        for number, (i, k) in enumerate(pairs(d)):
            found[i, k] = sum(
                transfer @ part[number]
                for transfer, part in zip(self._transfers, parts, strict=True)
            )
            if i < k:
                found[k, i] = found[i, k][self._mirror]
        data = [np.concatenate([found[i, k] for k in range(d)])[self._order] for i in range(d)]
        return sparse.csr_matrix(
            (np.concatenate(data), self._indices, self._indptr), shape=(d * self.size,) * 2
        )


def _entries(
    pattern: sparse.csr_matrix, embedding: sparse.csr_matrix
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coupled entries, as row times n plus column, that each entry of a space's matrix goes to; the
    number of that entry, and the factor."""
    size = embedding.shape[1]
    rows = np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))
    columns = pattern.indices
    width = np.diff(embedding.indptr)
    across = width[columns]
    count = width[rows] * across
    entry = np.repeat(np.arange(pattern.nnz), count)
    within = np.arange(len(entry)) - np.repeat(np.cumsum(count) - count, count)
    i, k = np.divmod(within, across[entry])
    first = embedding.indptr[rows[entry]] + i
    last = embedding.indptr[columns[entry]] + k
    key = embedding.indices[first].astype(np.int64) * size + embedding.indices[last]
    return key, entry, embedding.data[first] * embedding.data[last]
