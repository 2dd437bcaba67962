# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Poisson's equation on shell and core together: fields at their rates."""

import bodies
import numpy as np
import pytest
import shells

from HybridVolume.core.analysis.coupling import CollocationSpace, NitscheSpace
from HybridVolume.core.analysis.poisson import solve_poisson
from HybridVolume.core.analysis.refine import refine_shell
from HybridVolume.core.analysis.spline_space import SplineSpace
from HybridVolume.core.analysis.tet_space import tet_space
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.interior import build_interface, fill_interior
from HybridVolume.errors import InputError

SLOPE = np.array([0.9, -0.4, 1.3])
WAVE = 2.0 * np.pi / 14.0**0.5 * np.array([1.0, 0.7, 0.5])


def small_box():
    surface = build_surface(list(bodies.box((3.0, 2.0, 1.0), (1, 1, 1)).faces))
    return shells.shell_towards(surface, lambda x: x + 0.5 * ([1.5, 1.0, 0.5] - x), layers=1)


def space(name, parts=1, degree=2, kind=CollocationSpace):
    shell = small_box() if name == "box" else shells.make_shell(name)
    if parts > 1:
        shell = refine_shell(shell, parts)
    interface = build_interface(shell)
    core = tet_space(shell, interface, fill_interior(interface), degree)
    return kind(SplineSpace(shell, max(1, parts // 2)), core)


@pytest.mark.parametrize(("name", "degree"), [("box", 1), ("box", 3), ("sphere", 2)])
def test_the_core_gets_linear_fields_exactly(name, degree):
    both = space(name, degree=degree)
    core = both.tets
    moved = both.trace @ both.spline.control_points - core.nodes[core.interface]
    assert np.abs(moved).max() < 1e-12


@pytest.mark.parametrize("degree", [1, 3])
def test_linear_solutions_pass_a_flat_interface(degree):
    both = space("box", degree=degree, kind=NitscheSpace)
    found = solve_poisson(both, lambda x: np.zeros(len(x)), lambda x: x @ SLOPE)
    off = found.errors(lambda x: x @ SLOPE, lambda x: np.broadcast_to(SLOPE, x.shape))
    assert max(off) < 1e-12


@pytest.mark.parametrize("kind", [CollocationSpace, NitscheSpace])
def test_rates(kind):
    def exact(x):
        return np.sin(x @ WAVE)

    def slope(x):
        return np.cos(x @ WAVE)[:, None] * WAVE

    def source(x):
        return WAVE @ WAVE * np.sin(x @ WAVE)

    off = [
        solve_poisson(space("box", parts, kind=kind), source, exact).errors(exact, slope)
        for parts in (2, 4)
    ]
    assert (np.log2(np.divide(*off)) >= (2.8, 1.8)).all()


def test_conductivities_differ():
    # with k = 1 in the shell and 10 in the core a linear field is none, but a constant is
    both = space("box")
    found = solve_poisson(
        both, lambda x: np.zeros(len(x)), lambda x: np.full(len(x), 3.0), (1.0, 10.0)
    )
    assert np.abs(np.concatenate(both.parts(found.values)) - 3.0).max() < 1e-10
    field = solve_poisson(both, lambda x: np.zeros(len(x)), lambda x: x @ SLOPE, (1.0, 10.0))
    assert max(field.errors(lambda x: x @ SLOPE, lambda x: np.broadcast_to(SLOPE, x.shape))) > 0.01


def test_folded_tets_and_other_degrees_are_refused():
    with pytest.raises(InputError, match="choose 1, 2 or 3"):
        space("box", degree=4)
    with pytest.raises(InputError, match=r"Face\d+.*folded.*refine the shell"):
        space("torus")
