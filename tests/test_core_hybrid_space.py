# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Spaces on whole hybrid volumes: folded cores are repaired, finer spaces have the same volume."""

from functools import cache

import bodies
import numpy as np
import pytest
import shells

from HybridVolume.core.analysis.core_repair import yielding_core
from HybridVolume.core.analysis.coupling import CollocationSpace, NitscheSpace
from HybridVolume.core.analysis.hybrid_space import hybrid_space, refined
from HybridVolume.core.analysis.interface_figures import gap_figures, patch_deviation
from HybridVolume.core.analysis.poisson import solve_poisson
from HybridVolume.core.analysis.refine import refine_shell
from HybridVolume.core.analysis.simplex_space import SimplexSpace, lattice_keys
from HybridVolume.core.analysis.spline_space import SplineSpace
from HybridVolume.core.analysis.tet_space import Sides
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.interior import build_interface, fill_interior
from HybridVolume.core.recovery import Material
from HybridVolume.errors import InputError


@cache
def filled(name):
    """Shell, interface and straight core of a body; "1": of one span a patch."""
    if name == "torus 1":
        faces = bodies.torus(spans=1).faces
        shell = shells.shell_towards(build_surface(list(faces)), shells._to_circle, layers=1)
    elif name == "sphere 1":
        faces = bodies.sphere(1.0, spans=1).faces
        shell = shells.shell_towards(build_surface(list(faces)), lambda x: 0.6 * x, layers=1)
    else:
        shell = shells.make_shell(name)
    interface = build_interface(shell)
    return shell, interface, fill_interior(interface)


@cache
def space(name, degree, coupling="collocation", level=0):
    if level:
        return refined(space(name, degree, coupling, level - 1))
    return hybrid_space(*filled(name), degree=degree, coupling=coupling)


def volume(part, points):
    return sum(block.measure.sum() for block in part.samples(points))


@pytest.mark.parametrize(
    ("name", "degree"), [("torus", 2), ("torus 1", 2), ("torus 1", 3), ("hollow sphere", 3)]
)
def test_folded_cores_are_repaired(name, degree):
    both = space(name, degree)
    assert both.tets.jacobian_bounds.min() > 0.0
    assert any("folded" in note for note in both.notes)
    # no other way of looking at it finds a fold: signs at many points, and the volume
    least = min(block.measure.min() for block in both.tets.samples(6))
    assert least > 0.0
    body = filled(name)[0].surface.volume()
    gap = gap_figures(both)["volume"]
    assert volume(both.spline, 8) + volume(both.tets, 5) - gap == pytest.approx(body, rel=2e-2)


@pytest.mark.parametrize("degree", [2, 3])
def test_finer_spaces_close_the_gap(degree):
    levels = [space("sphere 1", degree, level=level) for level in range(3)]
    figures = [gap_figures(each) for each in levels]
    rms = [f["rms"] for f in figures]
    # O(h^(k + 1)), and nodes on the interface are where the shell has them
    assert np.log2(np.divide(rms[:-1], rms[1:])).min() > degree + 0.6
    assert max(f["transfer"] for f in figures) < 1e-12
    # shell and core fill the ball: what is left is the gap
    left = [volume(s.spline, 7) + volume(s.tets, 5) - 4.0 / 3.0 * np.pi for s in levels]
    assert abs(left[2]) < 0.1 * abs(left[1]) < 0.01 * abs(left[0])
    assert len(levels[1].tets.elements) == 8 * len(levels[0].tets.elements)
    assert levels[2].tets.jacobian_bounds.min() > 0.0


@pytest.mark.parametrize(
    ("name", "degree"), [("torus", 2), ("torus 1", 3), ("hollow sphere", 2), ("sphere 1", 1)]
)
def test_linear_fields_pass_the_interface(name, degree):
    both = space(name, degree)
    core = both.tets
    missed = both.trace @ both.spline.control_points - core.nodes[core.interface]
    assert np.abs(missed).max() < 1e-12


@pytest.mark.parametrize("coupling", ["collocation", "nitsche"])
@pytest.mark.parametrize(("name", "degree"), [("torus 1", 3), ("hollow sphere", 2)])
def test_rigid_motions_have_no_energy(name, degree, coupling):
    both = space(name, degree, coupling)
    matrix = both.elasticity(Material(210000.0, 0.3), Material(70000.0, 0.33))
    free = both.free_nodes if isinstance(both, CollocationSpace) else np.arange(both.tets.size)
    x, y, z = (np.concatenate([both.spline.control_points, both.tets.nodes[free]]) + [5, -2, 1]).T
    one, none = np.ones(both.size), np.zeros(both.size)
    stretch = np.concatenate([x, none, none])
    scale = stretch @ (matrix @ stretch)
    for motion in (
        *((one, none, none), (none, one, none), (none, none, one)),
        *((-y, x, none), (none, -z, y), (z, none, -x)),
    ):
        field = np.concatenate(motion)
        assert abs(field @ (matrix @ field)) < 1e-10 * scale


@pytest.mark.parametrize("kind", [CollocationSpace, NitscheSpace])
def test_straight_tets_where_nothing_else_helps(kind):
    """Nodes that left the inner surface: every tet is valid, and rigid motions stay free."""
    shell, interface, interior = filled("torus 1")
    spline = SplineSpace(shell)
    core, count = yielding_core(spline, interior.mesh, Sides.of(interface), 2)
    assert count > 0
    assert core.jacobian_bounds.min() > 0.0
    both = kind(spline, core)
    matrix = both.elasticity(Material(1000.0, 0.3), Material(1000.0, 0.3))
    free = both.free_nodes if kind is CollocationSpace else np.arange(core.size)
    x, y, _ = np.concatenate([spline.control_points, core.nodes[free]]).T
    turn = np.concatenate([-y, x, np.zeros(both.size)])
    stretch = np.concatenate([x, y, np.zeros(both.size)])
    assert abs(turn @ (matrix @ turn)) < 1e-10 * (stretch @ (matrix @ stretch))


def test_linear_solutions_deviate_by_the_gap():
    off = [patch_deviation(space("torus 1", 2, "nitsche", level)) for level in (0, 1)]
    # the gap is O(h³); levels of a whole circle in four spans are coarse
    assert np.log2(np.divide(*off)).min() > 2.0


def test_shells_finer_than_the_core():
    """Nitsche's method keeps linear fields and the rate where tets reach over several spans."""
    surface = build_surface(list(bodies.box((3.0, 2.0, 1.0), (1, 1, 1)).faces))
    shell = shells.shell_towards(surface, lambda x: x + 0.5 * ([1.5, 1.0, 0.5] - x), layers=1)
    wave = 2.0 * np.pi / 14.0**0.5 * np.array([1.0, 0.7, 0.5])
    off = []
    for parts in (1, 2):
        coarse = refine_shell(shell, parts)
        interface = build_interface(coarse)
        fine = refine_shell(coarse, 2)
        both = hybrid_space(
            fine, interface, fill_interior(interface), coupling="nitsche", parts=parts
        )
        if parts == 1:
            assert max(patch_deviation(both)) < 1e-9
        found = solve_poisson(
            both, lambda x: wave @ wave * np.sin(x @ wave), lambda x: np.sin(x @ wave)
        )
        off.append(
            found.errors(lambda x: np.sin(x @ wave), lambda x: np.cos(x @ wave)[:, None] * wave)
        )
    assert (np.log2(np.divide(*off)) >= (2.6, 1.7)).all()


def test_folds_are_proved():
    """A tet of degree 2 with a mid node pushed in: bounds follow the exact sign of det J."""
    keys = lattice_keys(np.array([[0, 1, 2, 3]]), 2)[0]
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    straight = corners[keys].mean(axis=1)
    (middle,) = np.flatnonzero((keys == [0, 1]).all(axis=1))
    none = np.zeros((0, 3), dtype=int)
    for push, valid in ((0.0, True), (0.24, True), (0.26, False)):
        nodes = straight.copy()
        # the edge's end moves at speed 1 - 4 push at a corner: folded from a quarter on
        nodes[middle, 0] -= push
        one = SimplexSpace(2, nodes, np.arange(10)[None], *[none] * 8)
        assert (one.jacobian_bounds[0] > 0.0) == valid


def test_what_is_not_known_is_refused():
    with pytest.raises(InputError, match="choose 1, 2 or 3"):
        hybrid_space(*filled("torus 1"), degree=4)
    with pytest.raises(InputError, match="choose collocation or nitsche"):
        hybrid_space(*filled("torus 1"), coupling="mortar")
