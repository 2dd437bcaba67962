# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Elastic bodies in motion: energies of known strains, derivatives, free flight, contact."""

from functools import cache

import bodies
import numpy as np
import pytest
import shells

from HybridVolume.core.analysis.contact import PlaneContact
from HybridVolume.core.analysis.coupling import CollocationSpace, NitscheSpace
from HybridVolume.core.analysis.hyperelastic import Hyperelastic, Viscous
from HybridVolume.core.analysis.modal import modal
from HybridVolume.core.analysis.newmark import Newmark
from HybridVolume.core.analysis.plane import plane_space
from HybridVolume.core.analysis.plane_curve import ellipse
from HybridVolume.core.analysis.spline_space import SplineSpace
from HybridVolume.core.analysis.tet_space import tet_space
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.interior import build_interface, fill_interior
from HybridVolume.core.recovery import Material
from HybridVolume.errors import FaultError, InputError

RUBBER = Material(0.1, 0.3)
DENSITY = 1e-9
SIZE = np.array([3.0, 2.0, 1.0])
BEND = np.array([[0.2, -0.3, 0.1], [0.4, 0.1, -0.2], [0.1, 0.3, -0.3]])


@cache
def space(kind=CollocationSpace, degree=2):
    """A box with a shell of one layer and quadratic tets."""
    surface = build_surface(list(bodies.box(SIZE, (1, 1, 1)).faces))
    shell = shells.shell_towards(surface, lambda x: x + 0.5 * (0.5 * SIZE - x), layers=1)
    interface = build_interface(shell)
    core = tet_space(shell, interface, fill_interior(interface), degree)
    return kind(SplineSpace(shell), core)


def noise(shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape)


def turned(points, axis=(1.0, -2.0, 0.5), angle=2.0):
    """Displacement that turns points about the origin and moves them."""
    a = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.cross(np.eye(3), -a)
    turn = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return points @ (turn - np.eye(3)).T + [5.0, -3.0, 40.0]


def stored(material, strain, volume):
    """Energy of a homogeneous strain, W = lambda / 2 (tr E)² + mu E : E."""
    trace = np.trace(strain)
    return volume * (0.5 * material.lame * trace**2 + material.shear * (strain**2).sum())


@pytest.mark.parametrize("kind", [CollocationSpace, NitscheSpace])
def test_energy_of_known_strains(kind):
    body = Hyperelastic(space(kind), RUBBER, DENSITY)
    deformation = np.eye(3) + BEND
    green = 0.5 * (deformation.T @ deformation - np.eye(3))
    exact = stored(RUBBER, green, 6.0)
    assert body.energy(body.reference @ BEND.T) == pytest.approx(exact, rel=1e-12)
    # far turns cost nothing, nor do they change what a strain costs
    assert abs(body.energy(turned(body.reference))) < 1e-12 * exact
    bent = body.reference @ deformation.T
    both = bent - body.reference + turned(bent)
    assert body.energy(both) == pytest.approx(exact, rel=1e-12)
    linear = Hyperelastic(space(), RUBBER, DENSITY, law="linear")
    exact = stored(RUBBER, 0.5 * (BEND + BEND.T), 6.0)
    assert linear.energy(linear.reference @ BEND.T) == pytest.approx(exact, rel=1e-12)
    assert body.mass.sum() == pytest.approx(6.0 * DENSITY, rel=1e-12)


@pytest.mark.parametrize("law", ["svk", "linear"])
def test_forces_and_tangent_are_derivatives(law):
    stiff = Material(0.4, 0.2)
    body = Hyperelastic(space(), (RUBBER, stiff), DENSITY, law=law, viscosity=(0.02, 0.01))
    x = body.reference
    u, along = x @ BEND.T + 0.02 * noise(x.shape), noise(x.shape, 1)
    step, h = Viscous(0.05 * noise(x.shape, 2), 0.1), 1e-5
    for viscous in (None, step):
        rise = body.energy(u + h * along, viscous) - body.energy(u - h * along, viscous)
        forces = body.forces(u, viscous)
        assert rise / (2 * h) == pytest.approx((forces * along).sum(), rel=1e-6)
        change = body.forces(u + h * along, viscous) - body.forces(u - h * along, viscous)
        tangent = body.tangent(u, viscous)
        found = (tangent @ along.T.ravel()).reshape(3, -1).T
        assert np.abs(change / (2 * h) - found).max() < 1e-6 * np.abs(found).max()
    # a squeezed body is soft against buckling: only the projected tangent stays positive
    if law == "svk":
        squeezed = -0.5 * x
        least = [
            np.linalg.eigvalsh(body.tangent(squeezed, projected=p).toarray())[0]
            for p in (False, True)
        ]
        scale = abs(tangent).max()
        assert least[0] < -1e-3 * scale
        assert least[1] > -1e-12 * scale


def test_forces_over_the_interface_are_derivatives():
    body = Hyperelastic(space(NitscheSpace), RUBBER, DENSITY)
    x = body.reference
    u, along = x @ BEND.T + 0.02 * noise(x.shape), noise(x.shape, 1)
    h = 1e-5
    rise = body.energy(u + h * along) - body.energy(u - h * along)
    assert rise / (2 * h) == pytest.approx((body.forces(u) * along).sum(), rel=1e-6)
    # the tangent is exact but for the size of the jump: here there is none
    u = x @ BEND.T
    change = body.forces(u + h * along) - body.forces(u - h * along)
    found = (body.tangent(u) @ along.T.ravel()).reshape(3, -1).T
    assert np.abs(change / (2 * h) - found).max() < 1e-6 * np.abs(found).max()


@pytest.mark.parametrize("kind", [CollocationSpace, NitscheSpace])
def test_small_strains_of_both_laws_agree(kind):
    bent, straight = (
        Hyperelastic(space(kind), RUBBER, DENSITY, law=law) for law in ("svk", "linear")
    )
    nothing = np.zeros_like(bent.reference)
    off = bent.tangent(nothing) - straight.tangent(nothing)
    assert abs(off).max() < 1e-12 * abs(straight.tangent(nothing)).max()


@pytest.mark.parametrize("rule", ["newmark", "midpoint"])
def test_a_mode_swings_as_the_rule_tells(rule):
    both = space()
    mode = modal(both, RUBBER, DENSITY, 8)
    omega, shape = mode.angular[7], mode.shapes[7]
    step = 0.3 / omega
    body = Hyperelastic(both, RUBBER, DENSITY, law="linear")
    motion = Newmark(body, step, rule=rule)
    *_, end = motion.run(motion.start(displacement=shape), 5)
    # both rules swing with tan(w h / 2) = omega h / 2
    w = 2.0 / step * np.arctan(0.5 * omega * step)
    assert (
        np.abs(end.displacement - np.cos(5 * w * step) * shape).max() < 1e-7 * np.abs(shape).max()
    )


def test_free_flight_keeps_its_momenta():
    body = Hyperelastic(space(), RUBBER, DENSITY)
    x = body.reference
    velocity = np.cross([300.0, 2000.0, 500.0], x - 0.5 * SIZE) + [900.0, 0.0, 50.0]
    velocity += 2000.0 * (x - 0.5 * SIZE) * [1.0, -0.5, 0.2]
    drift = {}
    for rule, halved in (("conserving", 1), ("midpoint", 1), ("newmark", 1), ("newmark", 2)):
        motion = Newmark(body, 4e-5 / halved, rule=rule, tolerance=1e-11)
        start = motion.start(velocity)
        flow, spin = motion.momentum(start)
        energy = motion.energies(start).total
        *_, end = motion.run(start, 6 * halved)
        assert motion.energies(end).elastic > 0.1 * energy
        after = motion.momentum(end)
        assert np.abs(after[0] - flow).max() < 1e-11 * np.abs(flow).max()
        drift[rule, halved] = np.abs(after[1] - spin).max() / np.abs(spin).max()
        off = abs(motion.energies(end).total / energy - 1.0)
        assert off < (1e-10 if rule == "conserving" else 0.02)
    # angular momentum: these two rules keep it, Newmark's comes as near as its order says
    assert max(drift["conserving", 1], drift["midpoint", 1]) < 1e-10
    assert drift["newmark", 1] < 0.02
    assert drift["newmark", 2] < 0.4 * drift["newmark", 1]


def test_a_body_coupled_after_nitsche_flies_alike():
    body = Hyperelastic(space(NitscheSpace), RUBBER, DENSITY)
    x = body.reference
    velocity = np.cross([300.0, 2000.0, 500.0], x - 0.5 * SIZE)
    velocity += 1000.0 * (x - 0.5 * SIZE) * [1.0, -0.5, 0.2]
    motion = Newmark(body, 4e-5, rule="midpoint", tolerance=1e-11)
    start = motion.start(velocity)
    *_, end = motion.run(start, 5)
    for found, before in zip(motion.momentum(end), motion.momentum(start), strict=True):
        assert np.abs(found - before).max() < 1e-9 * np.abs(motion.momentum(start)[1]).max()
    other = Newmark(Hyperelastic(space(), RUBBER, DENSITY), 4e-5, rule="midpoint")
    y = other.body.reference
    velocity = np.cross([300.0, 2000.0, 500.0], y - 0.5 * SIZE)
    velocity += 1000.0 * (y - 0.5 * SIZE) * [1.0, -0.5, 0.2]
    *_, last = other.run(other.start(velocity), 5)
    outer = body.space.spline.outer
    moved = np.abs(last.displacement[outer]).max()
    assert np.abs(end.displacement[outer] - last.displacement[outer]).max() < 0.05 * moved


@pytest.mark.parametrize("coupling", ["collocation", "nitsche"])
def test_in_the_plane(coupling):
    both = plane_space(ellipse((1.0, 0.7)).refined(2), 0.3, 1, 2, coupling, size=0.5)
    body = Hyperelastic(both, RUBBER, DENSITY)
    x = body.reference
    bend = BEND[:2, :2]
    deformation = np.eye(2) + bend
    green = 0.5 * (deformation.T @ deformation - np.eye(2))
    area = body.weights.sum() / DENSITY
    assert area == pytest.approx(0.7 * np.pi, rel=2e-3)
    assert body.energy(x @ bend.T) == pytest.approx(stored(RUBBER, green, area), rel=1e-9)
    turn = np.array([[-0.4, -0.8], [0.8, -0.4]]) @ x.T
    turn = turn.T / np.hypot(0.4, 0.8) - x
    assert abs(body.energy(turn)) < 1e-10 * stored(RUBBER, green, area)
    rule = "conserving" if coupling == "collocation" else "midpoint"
    floor = PlaneContact([0.0, 1.0], -0.71, 2.0)
    motion = Newmark(body, 2e-5, contacts=[floor], gravity=[0.0, -9810.0], rule=rule)
    start = motion.start(np.column_stack([-500.0 * x[:, 1], 500.0 * x[:, 0] - 800.0]))
    *_, last = motions = list(motion.run(start, 25))
    total = motion.energies(start).total
    drift = max(abs(motion.energies(m).total / total - 1.0) for m in motions)
    assert drift < (1e-8 if rule == "conserving" else 0.02)
    assert max(motion.energies(m).contact for m in motions) > 0.01 * total
    assert motion.momentum(last)[0][1] > 0.0 > motion.momentum(start)[0][1]
    # the plane has no friction
    assert abs(motion.momentum(last)[0][0]) < 1e-9 * motion.momentum(last)[0][1]


def test_a_plane_presses_back():
    body = Hyperelastic(space(), RUBBER, DENSITY)
    contact = PlaneContact([0.0, 0.0, 2.0], -0.1, 5.0).of(space())
    sunk = np.zeros_like(body.reference)
    sunk[:, 2] = -0.3
    # the bottom of 6 mm² is .2 mm behind the plane, and so is that much of the four sides
    bottom, sides = 6.0 * 0.2**2, 10.0 * 0.2**3 / 3.0
    assert contact.energy(sunk) == pytest.approx(2.5 * (bottom + sides), rel=0.01)
    push = -contact.forces(sunk).sum(axis=0)
    assert push[:2] == pytest.approx(0.0, abs=1e-14)
    assert push[2] == pytest.approx(5.0 * (6.0 * 0.2 + 10.0 * 0.2**2 / 2.0), rel=0.03)
    along, h = noise(sunk.shape), 1e-6
    change = contact.forces(sunk + h * along) - contact.forces(sunk - h * along)
    found = (contact.tangent(sunk) @ along.T.ravel()).reshape(3, -1).T
    assert np.abs(change / (2 * h) - found).max() < 1e-4 * np.abs(found).max()
    assert contact.energy(sunk + 1.0) == 0.0


def test_a_body_falls_and_bounces():
    body = Hyperelastic(space(), RUBBER, DENSITY)
    gravity, step = [0.0, 0.0, -9810.0], 4e-5
    falling = Newmark(body, step, gravity=gravity)
    fallen = falling.advance(falling.start([0.0, 0.0, -500.0]))
    exact = -500.0 * step - 0.5 * 9810.0 * step**2
    assert fallen.displacement[:, 2] == pytest.approx(exact, rel=1e-8)
    floor = PlaneContact([0.0, 0.0, 1.0], -0.01, 1.0)
    motion = Newmark(body, step, gravity=gravity, contacts=[floor], rule="conserving")
    start = motion.start([0.0, 0.0, -500.0])
    *_, last = motions = list(motion.run(start, 16))
    found = [motion.energies(m) for m in motions]
    kinetic = motion.energies(start).kinetic
    assert kinetic == pytest.approx(0.5 * 6.0 * DENSITY * 500.0**2, rel=1e-10)
    assert max(e.contact for e in found) > 0.02 * kinetic
    assert max(e.elastic for e in found) > 0.4 * kinetic
    # it leaves the plane upwards, and all energy is somewhere
    assert found[-1].contact == 0.0
    assert motion.momentum(last)[0][2] > 0.6 * 500.0 * 6.0 * DENSITY
    assert max(abs(e.total / kinetic - 1.0) for e in found) < 1e-8


@pytest.mark.parametrize("law", ["svk", "linear"])
def test_viscosity_turns_motion_into_heat(law):
    body = Hyperelastic(space(), RUBBER, DENSITY, law=law, viscosity=2e-6)
    x = body.reference - 0.5 * SIZE
    for rule in ("conserving", "newmark"):
        motion = Newmark(body, 2e-5, rule=rule)
        start = motion.start(500.0 * x * [1.0, -0.5, 0.2])
        total = motion.energies(start).total
        energies = [motion.energies(m) for m in motion.run(start, 5)]
        lost = [e.dissipated for e in energies]
        assert np.diff(lost).min() > 0.0
        assert lost[-1] > 0.1 * total
        assert energies[-1].total == pytest.approx(total, rel=0.1 if rule == "newmark" else 1e-8)
    # turning has no heat
    if law == "svk":
        spinning = motion.start(np.cross([0.0, 0.0, 10.0], x))
        heat = motion.advance(spinning).dissipated
        assert heat < 1e-6 * motion.energies(spinning).total


def test_what_cannot_be_moved():
    both = space()
    body = Hyperelastic(both, RUBBER, DENSITY)
    with pytest.raises(InputError, match="choose linear or svk"):
        Hyperelastic(both, RUBBER, DENSITY, law="rubber")
    with pytest.raises(InputError, match="density"):
        Hyperelastic(both, RUBBER, 0.0)
    jumping = Newmark(Hyperelastic(space(NitscheSpace), RUBBER, DENSITY), 1e-4, rule="conserving")
    with pytest.raises(InputError, match="choose collocation"):
        jumping.advance(jumping.start([1.0, 0.0, 0.0]))
    with pytest.raises(InputError, match="time step"):
        Newmark(body, -1.0)
    with pytest.raises(InputError, match="Face99: no such face"):
        Newmark(body, 1e-3, fixed=["Face99"])
    with pytest.raises(InputError, match="velocity"):
        Newmark(body, 1e-3).start(velocity=[np.nan, 0.0, 0.0])
    with pytest.raises(InputError, match="2 coordinates for a body with 3"):
        PlaneContact([0.0, 1.0], 0.0, 1.0).of(both)
    # a motion that is not found is refused, not told
    tets = Hyperelastic(both.tets, RUBBER, DENSITY)
    never = Newmark(tets, 1e-4, rule="conserving", tolerance=0.0)
    with pytest.raises(FaultError, match="cannot be followed"):
        never.advance(never.start(1e3 * tets.reference))
