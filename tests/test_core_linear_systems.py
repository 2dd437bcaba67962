# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Systems as badly conditioned as those of thin plates: solved, while singular ones are refused."""

import numpy as np
import pytest
from scipy import sparse

from HybridVolume.core.analysis.linear import RESIDUAL, solved
from HybridVolume.errors import FaultError


def beam(count):
    """Bending of a beam by differences: free matrix, and the deflection under a load of ones.

    Clamped at its first two nodes, everything is sums of integers.
    """
    second = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(count - 2, count))
    moment = np.cumsum(np.cumsum(np.ones(count - 2)))[::-1]
    deflection = np.concatenate([[0.0, 0.0], np.cumsum(np.cumsum(moment))])
    return (second.T @ second).tocsr(), deflection


def test_a_slender_beam_is_solved_though_rounding_leaves_a_residual():
    matrix, exact = beam(300)
    found, figures = solved(matrix, np.ones(300), np.array([0, 1]), np.zeros(2), method="direct")
    assert figures.residual > RESIDUAL
    assert np.abs(found - exact).max() < 1e-6 * exact.max()


def test_a_beam_that_nothing_holds_is_refused():
    matrix, _ = beam(300)
    for held in (np.zeros(0, dtype=int), np.array([4])):
        with pytest.raises(FaultError, match="not solved"):
            solved(matrix, np.ones(300), held, np.zeros(len(held)), method="direct")
