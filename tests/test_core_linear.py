# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Linear systems of analysis: both ways agree, and what is not solved is said."""

import sys

import numpy as np
import pytest
import shells

from HybridVolume.core.analysis.boundary import boundary_load, given_on_faces
from HybridVolume.core.analysis.hybrid_space import of_volume
from HybridVolume.core.analysis.linear import factored, solved
from HybridVolume.core.analysis.rigid import coefficient_points, rigid_motions
from HybridVolume.core.recovery import Material
from HybridVolume.errors import FaultError, InputError

STEEL = Material(210_000.0, 0.3)


@pytest.fixture(scope="module")
def box():
    """A box held at one face and drawn at another: matrix, right side, unknowns held, motions."""
    space = of_volume(shells.make_volume("box"), coupling="nitsche")
    names = space.spline.face_names
    unknown, component, values = given_on_faces(space.spline, {names[0]: np.zeros_like}, 3)
    drawn = boundary_load(space.spline, lambda x, n: 100.0 * n, [names[1]])
    right = space.loaded(drawn, np.zeros((space.tets.size, 3))).T.ravel()
    moves = np.swapaxes(rigid_motions(coefficient_points(space)), 1, 2).reshape(6, -1)
    held = unknown + component * space.size
    return space.elasticity(STEEL, STEEL), right, held, values, moves


def test_both_methods_agree_and_tell_what_they_did(box):
    pytest.importorskip("pyamg")
    direct, figures = solved(*box, method="direct")
    iterated, other = solved(*box, method="cg")
    assert np.linalg.norm(iterated - direct) < 1e-8 * np.linalg.norm(direct)
    assert (figures.method, other.method) == ("direct", "cg")
    matrix, right, held, _, _ = box
    assert figures.unknowns == other.unknowns == len(right) - len(held)
    assert figures.iterations == 0 < other.iterations < 600
    free = np.setdiff1d(np.arange(len(right)), held)
    missed = np.linalg.norm((matrix @ direct - right)[free]) / np.linalg.norm(right[free])
    assert missed < 1e-9 and max(figures.residual, other.residual) < 1e-9
    assert min(figures.memory, other.memory) > 12e-6 * figures.entries
    assert not figures.note and not other.note


def test_without_pyamg_it_says_so_and_factors(box, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyamg", None)
    values, figures = solved(*box, method="cg")
    assert figures.method == "direct" and "pyamg is not installed" in figures.note
    assert np.array_equal(values, solved(*box)[0])


def test_bodies_that_nothing_holds_are_refused(box):
    matrix, right, _, _, moves = box
    nothing = np.zeros(0, dtype=int)
    with pytest.raises(FaultError, match="was not solved.*cannot move freely"):
        # a load that does not balance: there is no solution at all
        solved(matrix, right, nothing, np.zeros(0), moves)
    with pytest.raises(InputError, match="method 'magic'"):
        solved(*box, method="magic")


def test_factors_of_a_symmetric_matrix_have_fewer_entries(box):
    from scipy.sparse.linalg import splu

    matrix, right, held, _, _ = box
    free = np.setdiff1d(np.arange(len(right)), held)
    inside = matrix[free][:, free]
    factors = factored(inside)
    assert factors.nnz < 0.9 * splu(inside.tocsc()).nnz
    found = factors.solve(right[free])
    assert np.linalg.norm(inside @ found - right[free]) < 1e-8 * np.linalg.norm(right)
