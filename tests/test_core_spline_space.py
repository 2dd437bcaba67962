# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The spline space of a shell: the volume's own functions, exactly refined."""

import numpy as np
import pytest
import shells

from HybridVolume.core.analysis.assembly import elastic
from HybridVolume.core.analysis.refine import refine_shell
from HybridVolume.core.analysis.spline_space import SplineSpace

NAMES = ["box", "sphere", "torus", "hollow sphere"]


def places(shell, count, seed=3):
    random = np.random.default_rng(seed)
    patch = random.integers(len(shell.surface.patches), size=count)
    return patch, random.random((count, 2)), random.random(count)


@pytest.mark.parametrize(("name", "parts"), [("box", 1), ("torus", 2), ("hollow sphere", 1)])
def test_linear_fields_are_in_the_space(name, parts):
    space = SplineSpace(shells.make_shell(name), parts)
    slope = np.array([0.3, -1.2, 0.7])
    field = space.control_points @ slope + 2.0
    volume = 0.0
    for block in space.samples(5):
        inside = field[block.unknowns]
        value = np.einsum("eqi,ei->eq", block.values, inside)
        assert np.abs(value - block.points @ slope - 2.0).max() < 1e-12
        gradient = np.einsum("eqci,ei->eqc", block.gradients, inside)
        assert np.abs(gradient - slope).max() < 1e-9
        assert block.measure.min() > 0.0
        volume += block.measure.sum()
    # Gauss points miss a rational volume by some digits
    assert volume == pytest.approx(space.shell.volume(), rel=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_finer_shells_are_the_same_volume(name):
    shell = shells.make_shell(name)
    fine = refine_shell(shell, 3)
    assert fine.element_count == 9 * shell.element_count
    patch, uv, w = places(shell, 200)
    for k in np.unique(patch):
        here = patch == k
        old = shell.evaluate(int(k), *uv[here].T, w[here])
        new = fine.evaluate(int(k), *uv[here].T, w[here])
        assert np.abs(new - old).max() < 1e-13 * shell.surface.diagonal


@pytest.mark.parametrize("name", NAMES)
def test_functions_at_places(name):
    shell = shells.make_shell(name)
    space = SplineSpace(shell, 2)
    patch, uv, w = places(shell, 200)
    basis = space.basis_at(patch, uv, w)
    assert np.abs(basis.sum(axis=1) - 1.0).max() < 1e-13
    mapped = basis @ space.control_points
    for k in np.unique(patch):
        here = patch == k
        exact = shell.evaluate(int(k), *uv[here].T, w[here])
        assert np.abs(mapped[here] - exact).max() < 1e-13 * shell.surface.diagonal
    # the ends of the columns: the outer boundary's functions alone, and the inner one's
    for level, own in ((0.0, space.outer), (1.0, space.inner)):
        there = space.basis_at(patch, uv, np.full(len(w), level))
        assert set(there[:, :].nonzero()[1].tolist()) <= set(own.tolist())


@pytest.mark.parametrize("name", ["box", "sphere"])
def test_rigid_motions_have_no_energy(name):
    space = SplineSpace(shells.make_shell(name))
    matrix = elastic(space, 1.2, 0.8)
    x, y, z = space.control_points.T
    one, none = np.ones(space.size), np.zeros(space.size)
    for motion in ((one, none, none), (-y, x, none), (none, -z, y)):
        field = np.concatenate(motion)
        assert abs(field @ (matrix @ field)) < 1e-13 * abs(matrix).max() * (field @ field)
    # a stretch along x: (lame + 2 shear) times the volume
    stretch = np.concatenate([x, none, none])
    volume = sum(block.measure.sum() for block in space.samples())
    assert stretch @ (matrix @ stretch) == pytest.approx((1.2 + 2 * 0.8) * volume, rel=1e-12)
