# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Linear elasticity on shell and core: exact solutions, loads on faces, energy."""

import bodies
import numpy as np
import pytest
import shells

from HybridVolume.core.analysis.coupling import CollocationSpace, NitscheSpace
from HybridVolume.core.analysis.elasticity import solve_elasticity
from HybridVolume.core.analysis.spline_space import SplineSpace
from HybridVolume.core.analysis.tet_space import tet_space
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.interior import build_interface, fill_interior
from HybridVolume.core.recovery import Material
from HybridVolume.errors import InputError

STEEL = Material(210000.0, 0.3)
NAN = np.nan


def held(x):
    return np.zeros(x.shape)


def sliding(axis):
    """Fixed along one axis, free along the others."""
    given = np.where(np.arange(3) == axis, 0.0, NAN)
    return lambda x: np.broadcast_to(given, x.shape)


def space(kind):
    surface = build_surface(list(bodies.box((3.0, 2.0, 1.0)).faces))
    shell = shells.shell_towards(surface, lambda x: x + 0.5 * ([1.5, 1.0, 0.5] - x), layers=1)
    interface = build_interface(shell)
    core = tet_space(shell, interface, fill_interior(interface), 2)
    return kind(SplineSpace(shell), core)


def sides(both):
    """The CAD face at the lower and the upper end of each axis."""
    surface = both.spline.shell.surface
    found = {}
    for patch in surface.patches:
        x = surface.control_points[patch.index].reshape(-1, 3)
        (axis,) = np.flatnonzero(np.ptp(x, axis=0) == 0.0)
        found[int(axis), x[0, axis] > 0.1] = patch.face
    return found


def test_a_bar_that_is_pulled():
    both = space(NitscheSpace)
    face = sides(both)
    # sliding on three sides, pulled at one end: a uniaxial stress of 70 MPa
    found = solve_elasticity(
        both,
        STEEL,
        fixed={face[axis, False]: sliding(axis) for axis in range(3)},
        tractions={face[0, True]: lambda x, n: 70.0 * n},
    )
    strain = 70.0 / 210000.0 * np.diag([1.0, -0.3, -0.3])
    off = found.errors(lambda x: x @ strain, lambda x: np.broadcast_to(strain, (len(x), 3, 3)))
    assert max(off) < 1e-12
    assert found.energy == pytest.approx(0.5 * 70.0 * 70.0 / 210000.0 * 6.0, rel=1e-11)


def test_its_own_weight_by_collocation():
    both = space(CollocationSpace)
    bottom = sides(both)[2, False]
    stiff = Material(1000.0, 0.0)
    # held below and free to the sides: sigma_z = -g (1 - z), u_z = -g (z - z² / 2) / E
    found = solve_elasticity(
        both,
        (stiff, stiff),
        fixed={bottom: held},
        body_force=lambda x: np.broadcast_to([0.0, 0.0, -2.0], x.shape),
    )
    shell, core = both.parts(found.values)
    exact = [-2.0 * (z - 0.5 * z * z) / 1000.0 for z in both.tets.nodes[:, 2]]
    assert np.abs(core[:, 2] - exact).max() < 0.02 * np.abs(exact).max()
    # work of the weight is twice the energy: 2² / E int (1 - z)² 6 / 2 = 4 / 1000 * 1
    assert found.energy == pytest.approx(4.0 / 1000.0, rel=5e-3)


def test_what_cannot_be_solved():
    both = space(CollocationSpace)
    with pytest.raises(InputError, match="Face99: no such face"):
        solve_elasticity(both, STEEL, fixed={"Face99": held})
    with pytest.raises(InputError, match="nothing is fixed"):
        solve_elasticity(both, STEEL, fixed={})
    free = {sides(both)[0, False]: sliding(0)}
    pull = {sides(both)[1, True]: lambda x, n: n}
    with pytest.raises(InputError, match="leave the body 3 rigid motions.*cannot move freely"):
        solve_elasticity(both, STEEL, fixed=free, tractions=pull)
