# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The shell: volumes, bits, handedness, levels; refinement; the energy's gradient."""

from __future__ import annotations

import bodies
import numpy as np
import pytest

from HybridVolume.core import bspline
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.bezier import bernstein
from HybridVolume.core.check import check_surface
from HybridVolume.core.column_samples import column_samples
from HybridVolume.core.column_state import nodal_matrix, polynomial_correction
from HybridVolume.core.cones import most_inward
from HybridVolume.core.front import column_frame
from HybridVolume.core.levels import spaced_layers, uniform_layers
from HybridVolume.core.refinement import flatten_spans, insert_knots, split_spans
from HybridVolume.core.shell import Shell
from HybridVolume.core.untangle import ColumnEnergy
from HybridVolume.core.validity import certify


def surface_of(body):
    return build_surface(list(body.faces))


def scaled_shell(surface, share, layers=2, degree=3):
    """Shell between a star-shaped surface and its copy shrunk towards its centre."""
    centre = surface.control_points.mean(axis=0)
    knots = bspline.clamped_knots(degree, layers)
    displacement = share * (centre - surface.control_points)
    points = uniform_layers(surface.control_points, displacement, degree, knots)
    return Shell(surface, points, degree, knots)


def test_box_shell_has_the_exact_volume_and_is_right_handed():
    surface = surface_of(bodies.box())
    shell = scaled_shell(surface, 0.25)
    assert shell.volume() == pytest.approx(6.0 * (1.0 - 0.75**3), rel=1e-13)
    assert shell.element_volumes().min() > 0.0
    certificate = certify(shell.bezier_elements())
    assert certificate.all_valid
    assert len(certificate) == shell.element_count == 2 * surface.element_count


def test_outer_layer_keeps_every_bit():
    surface = surface_of(bodies.torus())
    shell = scaled_shell(surface, 0.1)
    assert np.array_equal(shell.layers[0], surface.control_points)
    u = np.linspace(0.0, 1.0, 7)
    for k in range(len(surface.patches)):
        outer = shell.evaluate(k, u, u[::-1], np.zeros(7))
        assert np.abs(outer - surface.evaluate(k, u, u[::-1])).max() < 1e-14


def test_rational_shell_agrees_with_the_volumes_of_its_two_boundaries():
    surface = flatten_spans(surface_of(bodies.sphere()))
    frame = column_frame(surface)
    nodal = nodal_matrix(surface)
    bulge = polynomial_correction(surface, frame.nodes, nodal)
    knots = bspline.clamped_knots(3, 3)
    points = uniform_layers(surface.control_points, bulge - 0.3 * surface.control_points, 3, knots)
    shell = Shell(surface, points, 3, knots)
    between = surface.volume() - shell.inner_surface().volume()
    assert shell.volume() == pytest.approx(between, rel=1e-11)
    assert surface.volume() == pytest.approx(4.0 / 3.0 * np.pi, rel=1e-12)


def test_derivatives_of_the_shell_match_differences():
    surface = flatten_spans(surface_of(bodies.torus()))
    shell = scaled_shell(surface, 0.05)
    rng = np.random.default_rng(3)
    u, v, w = rng.uniform(0.1, 0.9, (3, 20))
    step = 1e-6
    _, *found = shell.evaluate(2, u, v, w, 1)
    for axis, derivative in enumerate(found):
        ahead, behind = [u, v, w], [u, v, w]
        ahead[axis] = ahead[axis] + step
        behind[axis] = behind[axis] - step
        difference = (shell.evaluate(2, *ahead) - shell.evaluate(2, *behind)) / (2 * step)
        assert np.abs(difference - derivative).max() < 1e-6


def test_polynomial_correction_brings_the_unweighted_surface_back():
    surface = flatten_spans(surface_of(bodies.torus()))
    frame = column_frame(surface)
    bulge = polynomial_correction(surface, frame.nodes, nodal_matrix(surface))
    plain = surface.with_points(surface.control_points + bulge, polynomial=True)
    assert np.abs(plain.triangulation("greville").vertices - frame.nodes).max() < 1e-12
    # without it the arcs bulge out by far more
    bare = surface.with_points(surface.control_points, polynomial=True)
    assert np.abs(bare.triangulation("greville").vertices - frame.nodes).max() > 1e-3


def test_equal_volume_layers_halve_a_shrunken_ball():
    surface = flatten_spans(surface_of(bodies.sphere()))
    displacement = -0.6 * surface.control_points
    knots = bspline.clamped_knots(3, 2)
    even = uniform_layers(surface.control_points, displacement, 3, knots)
    equal = spaced_layers(surface.control_points, displacement, 3, knots, surface)
    ratios = []
    for points in (even, equal):
        sizes = Shell(surface, points, 3, knots).element_volumes().reshape(-1, 2)
        ratios.append((sizes.max(axis=1) / sizes.min(axis=1)).max())
    assert ratios[0] > 1.8
    assert ratios[1] < 1.25


@pytest.mark.parametrize("body", [bodies.box(), bodies.torus(), bodies.l_bracket()])
def test_splitting_spans_changes_no_point(body):
    surface = surface_of(body)
    fine = split_spans(surface, 3)
    assert fine.element_count == 9 * surface.element_count
    assert fine.volume() == pytest.approx(body.volume, rel=1e-11)
    line = np.linspace(0.01, 0.99, 6)
    for k in range(len(surface.patches)):
        off = surface.evaluate_grid(k, line, line) - fine.evaluate_grid(k, line, line)
        assert np.abs(off).max() < 1e-13 * surface.diagonal


def test_knots_spread_along_strips_only_and_leave_other_patches_alone():
    surface = surface_of(bodies.box())
    fine = insert_knots(surface, lambda k, d: np.array([0.03]) if (k, d) == (0, 0) else [])
    grown = [
        sum(a != b for a, b in zip(p.index.shape, q.index.shape, strict=True))
        for p, q in zip(surface.patches, fine.patches, strict=True)
    ]
    # the strip around a box crosses four of its six faces once
    assert sorted(grown) == [0, 0, 1, 1, 1, 1]
    assert fine.exact.sum() - surface.exact.sum() == 4
    for k in np.flatnonzero(np.array(grown) == 0):
        old = surface.control_points[surface.patches[k].index]
        assert np.array_equal(old, fine.control_points[fine.patches[k].index])


def test_flattened_spans_turn_less():
    surface = flatten_spans(surface_of(bodies.torus()))
    x = np.linspace(0.0, 1.0, 5)
    samples = surface.element_samples(x, x)
    _, x_u, x_v = samples.surface(surface.control_points)
    normals = np.cross(x_u, x_v)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosine = np.einsum("eai,ebi->eab", *(2 * [normals.reshape(-1, 25, 3)]))
    assert np.degrees(np.arccos(np.clip(cosine.min(), -1, 1))) < 91.0


def test_most_inward_direction_of_a_cube_corner():
    d = most_inward(np.eye(3)[None], np.ones((1, 3), dtype=bool))
    assert np.abs(d - 1.0 / np.sqrt(3.0)).max() < 1e-3
    opposite = np.array([[[1.0, 0, 0], [-1.0, 0, 0]]])
    d = most_inward(opposite, np.ones((1, 2), dtype=bool))
    assert np.einsum("mki,mi->mk", opposite, d).min() <= 0.0


@pytest.mark.parametrize("eps", [1e-9, 0.4])
@pytest.mark.parametrize(
    ("body", "share"), [(bodies.torus(), 0.3), (bodies.wedge(), 0.1), (bodies.cylinder(), 0.1)]
)
def test_energy_gradient_matches_differences(body, share, eps):
    surface = flatten_spans(surface_of(body))
    frame = column_frame(surface)
    nodal = nodal_matrix(surface)
    bulge = polynomial_correction(surface, frame.nodes, nodal)
    rng = np.random.default_rng(5)
    d = frame.direction + 3e-3 * rng.normal(size=bulge.shape)
    d *= share * frame.smooth(frame.spacing, 3, least=True)[:, None]
    free = rng.uniform(size=len(d)) < 0.4
    base = surface.control_points + bulge
    energy = ColumnEnergy(
        surface, base, _Slope(), np.full(len(d), 0.4), np.full(len(d), 0.3), 3, nodal, d,
        free=free, fidelity=3.0,
    )  # fmt: skip
    energy.add_samples(energy.elements[:4], 6)
    energy.eps = eps
    flat = energy.start()
    assert energy.least_determinant(flat) > 0.0
    direction = rng.normal(size=flat.shape)
    step = 1e-7
    _, gradient = energy(flat)
    difference = (energy(flat + step * direction)[0] - energy(flat - step * direction)[0]) / 2
    assert gradient @ direction == pytest.approx(difference / step, rel=1e-6)


class _Slope:
    """A field whose level rises linearly along z."""

    def evaluate(self, points):
        gradient = np.tile([0.0, 0.0, 0.2], (len(points), 1))
        return 0.5 + 0.2 * points[:, 2], gradient, np.ones(len(points), dtype=bool)

    def evaluate_near(self, points, near):
        return *self.evaluate(points), near


def test_samples_agree_with_the_shell():
    """det A times det S is det J of the shell that the samples stand for."""
    for body in (bodies.cylinder(), bodies.box(spans=(2, 2, 1))):
        surface = flatten_spans(surface_of(body))
        frame, nodal = column_frame(surface), nodal_matrix(surface)
        base = surface.control_points + polynomial_correction(surface, frame.nodes, nodal)
        d = 0.1 * frame.direction
        knots = bspline.clamped_knots(3, 1)
        layers = uniform_layers(base, d, 3, knots)
        layers[0] = surface.control_points
        shell = Shell(surface, layers, 3, knots)
        uv, w = np.array([0.0, 0.3, 1.0]), np.array([0.0, 0.25, 1.0])
        reference = np.full(len(d), 0.1)
        batches = {
            number: batch.determinants(number, uv, w)
            for batch in map(_Batch, shell.bezier_elements())
            for number in batch.batch.element
        }
        for samples in column_samples(
            surface, base, reference, 3, uv, w, np.arange(surface.element_count)
        ):
            least = samples.least(d)
            _, s_u, s_v = surface.element_samples(uv, uv, samples.element).surface(
                surface.control_points
            )
            size = 0.1 * np.linalg.norm(np.cross(s_u, s_v), axis=1).reshape(len(least), 9, 1)
            for row, number in enumerate(samples.element):
                relative = batches[number] / size[row]
                assert least[row] == pytest.approx(relative.min(), rel=1e-9)


class _Batch:
    """det J of Bézier elements by the derivatives of their homogeneous control points."""

    def __init__(self, batch):
        self.batch = batch

    def determinants(self, number, uv, w):
        """At (u, v) rows of the surface's grid and levels w, (9, 3)."""
        row = int(np.flatnonzero(self.batch.element == number)[0])
        net = self.batch.control_points[row]
        weight = np.ones(net.shape[:3])
        if self.batch.weights is not None:
            weight = self.batch.weights[row]
        net = np.concatenate([net * weight[..., None], weight[..., None]], axis=-1)
        lines = (uv, uv, w)

        def at(orders):
            tables = [
                bernstein(degree, x, k)
                for degree, x, k in zip(self.batch.degrees, lines, orders, strict=True)
            ]
            return np.einsum("ai,bj,ck,ijkd->abcd", *tables, net)

        value = at((0, 0, 0))
        point = value[..., :3] / value[..., 3:]
        parts = [at(tuple(int(i == k) for i in range(3))) for k in range(3)]
        parts = [(p[..., :3] - point * p[..., 3:]) / value[..., 3:] for p in parts]
        det = np.einsum("...i,...i->...", np.cross(parts[0], parts[1]), parts[2])
        # the element's first direction is v; rows of the surface's grid run over u first
        return det.transpose(1, 0, 2).reshape(9, 3)


def test_surface_check_lets_sound_bodies_pass():
    for body in (bodies.box(), bodies.torus(), bodies.wedge(20.0), bodies.hollow_sphere()):
        check_surface(flatten_spans(surface_of(body)))
