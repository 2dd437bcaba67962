# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Growth of shells: levels and shapes that are reached, planes between fronts, local proofs."""

from __future__ import annotations

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.bound import scaled_jacobian_bound
from HybridVolume.core.column_state import ColumnSpace
from HybridVolume.core.contacts import TestGrid, planes_between
from HybridVolume.core.growth import grow_shell
from HybridVolume.core.harmonic import solve_harmonic
from HybridVolume.core.intersection import self_intersections
from HybridVolume.core.midstructure import medial_axis
from HybridVolume.core.refinement import flatten_spans
from HybridVolume.core.validity import certify, scaled_jacobian


def prepared(body, tets=12_000):
    surface = flatten_spans(build_surface(list(body.faces)))
    return surface, solve_harmonic(surface, medial_axis(surface, 20_000), tets=tets)


@pytest.fixture(scope="module")
def wedge():
    return prepared(bodies.wedge(30.0, spans=3))


def shape(shell):
    return float(scaled_jacobian(shell.bezier_elements()).min())


def test_a_sharp_wedge_reaches_its_level_in_good_shape(wedge):
    """The level falls like the sixth power of the distance from an edge of 30 degrees."""
    surface, field = wedge
    shell, certificate = grow_shell(surface, field, 0.5)
    assert certificate.all_valid
    assert shell.w0 == pytest.approx(0.5, rel=0.1)
    assert shape(shell) > 0.5 * scaled_jacobian_bound(surface).min()


def test_a_rational_body_keeps_upright_columns():
    surface, field = prepared(bodies.torus())
    shell, certificate = grow_shell(surface, field, 0.5)
    assert certificate.all_valid
    assert shell.w0 == pytest.approx(0.5, rel=0.03)
    assert shape(shell) > 0.78


def test_less_fidelity_gives_better_shapes_and_a_thinner_shell():
    surface, field = prepared(bodies.box(spans=(6, 4, 2)))
    near, _ = grow_shell(surface, field, 0.5)
    shapely, certificate = grow_shell(surface, field, 0.5, fidelity=0.3)
    assert certificate.all_valid
    assert shape(shapely) > max(0.4, shape(near))
    assert shapely.w0 < near.w0


def test_proofs_of_what_moved_agree_with_proofs_of_everything(wedge):
    surface, field = wedge
    space = ColumnSpace(surface, field, 3)
    spacing = space.frame.smooth(space.frame.spacing, 3, least=True)
    d = (0.02 * spacing)[:, None] * space.frame.direction
    rng = np.random.default_rng(2)
    space.certificate(d)
    invalid = 0
    for _ in range(4):
        moved = rng.choice(len(d), 6, replace=False)
        d = d.copy()
        d[moved] += 0.3 * spacing[moved, None] * rng.normal(size=(6, 3))
        found = space.certificate(d)
        whole = certify(space.shell(d).bezier_elements())
        assert np.array_equal(found.element, whole.element)
        assert np.array_equal(found.status, whole.status)
        invalid += whole.invalid
    assert invalid > 0


def crossing_plate():
    """Columns of a thin plate whose two fronts run through each other, and sound ones."""
    surface = flatten_spans(build_surface(list(bodies.plate(4.0, 6).faces)))
    space = ColumnSpace(surface, None, 3)
    sound = 0.2 * space.frame.direction * space.frame.spacing.min()
    middle = np.linalg.norm(space.frame.nodes[:, :2] - 2.0, axis=1) < 0.9
    wanted = sound.copy()
    wanted[middle] = 0.6 * space.frame.direction[middle]
    return space, sound, wanted


def test_planes_part_fronts_that_cross():
    space, sound, wanted = crossing_plate()
    grid = TestGrid(space.surface, 1)
    triangles, pairs = grid.crossing(space.base + wanted)
    assert len(pairs)
    planes = planes_between(grid, triangles, pairs, space.base + sound)
    assert len(planes)
    # both fronts are flat and apart in z, so the planes are z = const. between them
    assert np.abs(planes.normal[:, 2]).min() > 1.0 - 1e-9
    assert planes.energy(space.base + sound)[0] == 0.0
    energy, pull = planes.energy(space.base + wanted)
    assert energy > 0.0
    rng = np.random.default_rng(1)
    step = 1e-6 * rng.normal(size=wanted.shape)
    ahead = planes.energy(space.base + wanted + step)[0]
    behind = planes.energy(space.base + wanted - step)[0]
    assert np.sum(pull * step) == pytest.approx((ahead - behind) / 2, rel=1e-5)


def test_vertices_by_the_matrix_are_those_of_the_inner_surface():
    space, _, wanted = crossing_plate()
    for cells in (1, 2):
        grid = TestGrid(space.surface, cells)
        inner = space.shell(wanted).inner_surface()
        mesh = inner.triangulation_at(*space.surface.grid_parameters(cells))
        assert np.abs(grid.matrix @ (space.base + wanted) - mesh.vertices).max() < 1e-13
        # cells with equal diagonals may be cut otherwise
        assert len(grid.crossing(space.base + wanted)[1])
        assert len(self_intersections(mesh.vertices, mesh.triangles))


def test_equal_input_gives_equal_bits(wedge):
    surface, field = wedge
    shells = [grow_shell(surface, field, 0.3)[0] for _ in range(2)]
    assert np.array_equal(shells[0].layers, shells[1].layers)


def test_a_finer_look_finds_what_coarse_triangles_miss():
    """Two fronts that run through each other at a quarter of a span, not at its ends and middle."""
    surface, field = prepared(bodies.box((2.0, 2.0, 0.4), (1, 1, 1), degree=3), tets=3_000)
    space = ColumnSpace(surface, field, 3)
    x = surface.control_points
    plain = 0.35 * (x.mean(axis=0) - x) * [0.3, 0.3, 1.0]
    # control points at thirds go up and down: curves that meet at both ends and in the middle only
    along = np.round(3.0 * x[:, 0] / 2.0)
    wave = np.where(along == 1, 2.0, np.where(along == 2, -2.0, 0.0))
    wave *= np.abs(x[:, 1] - 1.0) < 0.9
    d = plain.copy()
    d[:, 2] += wave * np.where(x[:, 2] > 0.3, -1.0, np.where(x[:, 2] < 0.1, 1.0, 0.0))

    def crossings(columns):
        return [len(grid.crossing(space.base + columns)[1]) for grid in space.grids]

    assert crossings(d) == [0, 0]
    assert space.look_closer(space.check(d))
    assert len(space.grids) == 3
    assert crossings(d)[2] > 0
    assert crossings(plain) == [0, 0, 0]
    assert not space.look_closer(space.check(plain))
