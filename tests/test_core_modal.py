# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Natural frequencies against those of a sphere (Lamb 1882) and of a bar."""

from dataclasses import replace
from functools import cache

import bodies
import numpy as np
import pytest
import shells
from scipy.optimize import brentq
from scipy.special import spherical_jn

from HybridVolume.core.analysis.hybrid_space import hybrid_space
from HybridVolume.core.analysis.modal import modal
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.interior import build_interface, fill_interior
from HybridVolume.core.recovery import Material
from HybridVolume.errors import InputError


@cache
def space(body, spans, coupling):
    if body == "sphere":
        surface = build_surface(list(bodies.sphere(1.0, spans=spans).faces))
        middle = np.zeros(3)
    else:
        surface = build_surface(list(bodies.box((4.0, 1.0, 1.0), (2, 1, 1)).faces))
        middle = np.array([2.0, 0.5, 0.5])
    shell = shells.shell_towards(surface, lambda x: x + 0.5 * (middle - x), layers=1)
    interface = build_interface(shell)
    return hybrid_space(shell, interface, fill_interior(interface), coupling=coupling)


def torsion(order, x):
    """0 where x = omega R / c_s is a torsional mode of a free sphere."""
    return (order - 1) * spherical_jn(order, x) - x * spherical_jn(order + 1, x)


def spheroid(order, ratio, k):
    """0 where k = omega R / c_s is a spheroidal mode; ratio is c_s / c_p (Eringen, Suhubi 1975)."""
    h = ratio * k
    n, (jh, jk) = order, (spherical_jn(order, h), spherical_jn(order, k))
    jh1, jk1 = spherical_jn(order + 1, h), spherical_jn(order + 1, k)
    a = (n * n - n - k * k / 2) * jh + 2 * h * jh1
    b = n * (n + 1) * ((n - 1) * jk - k * jk1)
    c = (n - 1) * jh - h * jh1
    d = (n * n - 1 - k * k / 2) * jk + k * jk1
    return a * d - b * c


@pytest.mark.parametrize("coupling", ["collocation", "nitsche"])
def test_a_free_sphere(coupling):
    # radius 1 mm, mu = 1 MPa and 1 t/mm³: omega is omega R / c_s
    material = Material(2.5, 0.25)
    modes = modal(space("sphere", 2, coupling), material, 1.0, 19)
    twist = brentq(lambda x: torsion(2, x), 2.0, 3.0)
    assert twist == pytest.approx(2.501, abs=1e-3)
    ratio = 1.0 / np.sqrt(3.0)
    swell, shake = (brentq(lambda x, n=n: spheroid(n, ratio, x), *at) for n, at in
                    ((2, (2.0, 3.2)), (1, (3.0, 3.8))))  # fmt: skip
    assert swell == pytest.approx(2.640, abs=1e-3)
    # six rigid motions, then 2 n + 1 modes of each order n
    assert modes.angular[:6] == pytest.approx(0.0, abs=1e-4)
    assert modes.angular[6:11] == pytest.approx(twist, rel=4e-3)
    assert modes.angular[11:16] == pytest.approx(swell, rel=5e-3)
    assert modes.angular[16:19] == pytest.approx(shake, rel=5e-3)


def test_a_bar_that_does_not_contract():
    # nu = 0: waves along the bar move nothing to the sides, f = n / (2 L) sqrt(E / rho)
    both = space("box", 2, "nitsche")
    steel = Material(210000.0, 0.0)
    modes = modal(both, steel, 7.85e-9, 14)
    wave = np.sqrt(210000.0 / 7.85e-9) / (2.0 * 4.0)
    one = int(np.abs(modes.frequencies - wave).argmin())
    assert modes.frequencies[one] == pytest.approx(wave, rel=4e-3)
    # cos(pi x / L) along the bar
    shape = modes.shapes[one, : both.spline.size]
    exact = np.cos(np.pi * both.spline.control_points[both.spline.outer, 0] / 4.0)
    found = shape[both.spline.outer, 0]
    assert abs(exact @ found) > 0.99 * np.linalg.norm(exact) * np.linalg.norm(found)
    # held at one end it swings half as fast
    names = both.spline.face_names
    ends = {}
    for name in names:
        at = np.concatenate([s.points for s in both.spline.boundary_samples([name])])
        if np.ptp(at[:, 0]) < 1e-9:
            ends[bool(at[0, 0] > 2.0)] = name
    held = modal(both, steel, 7.85e-9, 8, fixed=[ends[False]])
    assert np.abs(held.frequencies / wave - 0.5).min() < 4e-3
    assert held.frequencies[0] > 0.05 * wave


@pytest.mark.parametrize("scale, away", [(1e-3, 0.0), (1.0, 1e6)])
def test_small_and_far_bodies_have_all_their_rigid_motions(scale, away):
    def lowest(scale, away):
        size = np.array([3.0, 2.0, 1.0])
        faces = bodies.box(size, (1, 1, 1)).faces
        faces = [replace(f, control_points=scale * f.control_points + away) for f in faces]
        middle = 0.5 * scale * size + away
        shell = shells.shell_towards(build_surface(faces), lambda x: 0.5 * (x + middle), layers=1)
        interface = build_interface(shell)
        both = hybrid_space(shell, interface, fill_interior(interface), coupling="nitsche")
        return scale * modal(both, Material(210000.0, 0.3), 7.9e-9, 8).frequencies

    found, usual = lowest(scale, away), lowest(1.0, 0.0)
    assert np.abs(found[:6]).max() < 1e-3 * usual[6]
    assert found[6:] == pytest.approx(usual[6:], rel=1e-6)


def test_what_has_no_modes():
    both = space("box", 2, "nitsche")
    with pytest.raises(InputError, match="0 modes of"):
        modal(both, Material(1.0, 0.3), 1.0, 0)
    with pytest.raises(InputError, match="Face99: no such face"):
        modal(both, Material(1.0, 0.3), 1.0, 3, fixed=["Face99"])
