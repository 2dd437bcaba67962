# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Whether vectors lie on one side of a plane, against linear programmes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from HybridVolume.core.cones import in_half_space


def margin(vectors: np.ndarray) -> float:
    """Largest t with n . d >= t for all vectors n and some d in the unit cube."""
    count = len(vectors)
    answer = linprog(
        [0.0, 0.0, 0.0, -1.0],
        A_ub=np.column_stack([-vectors, np.ones(count)]),
        b_ub=np.zeros(count),
        bounds=[(-1.0, 1.0)] * 3 + [(None, 1.0)],
    )
    return float(answer.x[3])


@pytest.mark.parametrize("flat", [1.0, 1e-3])
def test_sets_of_vectors_against_a_linear_programme(flat):
    rng = np.random.default_rng(5)
    told = set()
    for spread in (0.5, 1.1, 2.0):
        for count in (3, 7, 40):
            vectors = rng.normal(size=(12, 1, 3)) + spread * rng.normal(size=(12, count, 3))
            vectors[..., 2] *= flat
            vectors /= np.linalg.norm(vectors, axis=2, keepdims=True)
            wanted = np.array([margin(some) for some in vectors])
            clear = np.abs(wanted - 1e-7) > 1e-9
            found = in_half_space(vectors, 1e-7)
            assert np.array_equal(found[clear], wanted[clear] > 1e-7)
            told |= set(found.tolist())
    assert told == {False, True}


def test_what_is_hard_for_steps_to_single_vectors():
    # a needle: a direction exists by 1e-4 only, seen after thousands of such steps
    turn = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), np.full(60, 1e-4)], axis=1)
    ring /= np.linalg.norm(ring, axis=1, keepdims=True)
    # the same around the origin: no direction
    level = ring * [1.0, 1.0, 0.0]
    both = in_half_space(np.stack([ring, level, -ring]), 1e-7)
    assert both.tolist() == [True, False, True]
    assert in_half_space(np.zeros((0, 4, 3)), 1e-7).shape == (0,)
    # vectors that are none, and one that repeats
    assert not in_half_space(np.zeros((1, 5, 3)), 1e-7)[0]
    assert in_half_space(np.tile([0.0, 0.6, 0.8], (1, 5, 1)), 1e-7)[0]
