# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The certificate on whole shells: elements inverted on purpose, random smooth bodies, corners."""

from __future__ import annotations

from dataclasses import replace

import bodies
import numpy as np
import pytest
from shells import shell_towards
from singular_bodies import doubled, pole

from HybridVolume.core import bspline
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.bezier import BezierElements, bernstein
from HybridVolume.core.shell import Shell
from HybridVolume.core.validity import INVALID, VALID, VALID_INSIDE, certify


def least_determinants(shell: Shell, count: int = 9, inset: float = 0.0) -> np.ndarray:
    """Smallest det J of every element at count^3 points, by Bernstein tables of our own."""
    x = np.linspace(inset, 1.0 - inset, count)
    found = np.full(shell.element_count, np.nan)
    for batch in shell.bezier_elements():
        weights = np.ones(batch.control_points.shape[:-1])
        weights = weights if batch.weights is None else batch.weights
        net = np.concatenate([batch.control_points * weights[..., None], weights[..., None]], -1)

        def at(orders, net=net, degrees=batch.degrees):
            tables = [bernstein(p, x, k) for p, k in zip(degrees, orders, strict=True)]
            return np.einsum("ai,bj,ck,eijkd->eabcd", *tables, net, optimize=True)

        value = at((0, 0, 0))
        place = value[..., :3] / value[..., 3:]
        slopes = [at(orders) for orders in np.eye(3, dtype=int)]
        rows = [(d[..., :3] - place * d[..., 3:]) / value[..., 3:] for d in slopes]
        found[batch.element] = np.linalg.det(np.stack(rows, axis=-1)).min(axis=(1, 2, 3))
    return found


def inward(body, share=0.6, layers=1):
    surface = build_surface(list(body.faces))
    if body.name == "torus":
        ring = surface.control_points[:, :2]
        ring = np.column_stack([3.0 * ring / np.linalg.norm(ring, axis=1)[:, None],
                                np.zeros(len(ring))])  # fmt: skip
        return shell_towards(surface, lambda p: p + share * (ring - p), layers)
    centre = surface.control_points.mean(axis=0)
    return shell_towards(surface, lambda p: p + share * (centre - p), layers)


# --------------------------------------------------------------------- inverted on purpose


@pytest.mark.parametrize(
    ("body", "tries"),
    [(bodies.box((3.0, 2.0, 1.0), (2, 2, 1)), 24), (bodies.torus(), 30), (bodies.sphere(), 7)],
)
def test_every_element_that_a_control_point_inverts_is_caught(body, tries):
    """The inner end of one column after the other is pulled out through the surface."""
    shell = inward(body)
    assert certify(shell.bezier_elements()).all_valid
    surface = shell.surface
    caught = np.zeros(shell.element_count, dtype=bool)
    columns = len(surface.control_points)
    for column in range(0, columns, max(1, columns // tries)):
        layers = shell.layers.copy()
        layers[1:, column] = 8.0 * layers[0, column] - 7.0 * layers[1:, column]
        broken = Shell(surface, layers, shell.degree_w, shell.knots_w)
        certificate = certify(broken.bezier_elements())
        least = least_determinants(broken, 5)
        status = certificate.status
        assert np.all(status[least <= 0.0] < VALID)
        touched = np.zeros(surface.element_count, dtype=bool)
        for group in surface.groups:
            touched[group.element] = (group.index == column).any(axis=(1, 2))
        assert np.all(status[np.repeat(~touched, shell.layer_count)] == VALID)
        assert (least <= 0.0).any()
        caught |= least <= 0.0
    assert caught.all()  # every element was inverted at least once


def test_weights_that_invert_elements_are_caught():
    """A heavy outer control point draws the outer side through the inner one."""
    shell = inward(bodies.torus(spans=2), 0.2)
    batch = shell.bezier_elements()[0]
    assert batch.weights is not None
    inverted = 0
    for factor in (30.0, 1e-3, 1.3):
        weights = batch.weights.copy()
        weights[:, 1, 1, 0] *= factor
        changed = replace(batch, weights=weights)
        status = certify([changed]).status
        one = _Single(changed)
        least = least_determinants(one, 7)
        assert np.all(status[least <= 0.0] < VALID)
        assert np.all(least[status == VALID] > 0.0)
        inverted += np.sum(least <= 0.0)
    assert inverted > 20
    for bad in (0.0, -0.5, np.nan, np.inf):
        weights = batch.weights.copy()
        weights[3, 0, 0, 0] = bad
        assert certify([replace(batch, weights=weights)]).status[3] == INVALID


class _Single:
    """One batch in place of a shell."""

    def __init__(self, batch: BezierElements) -> None:
        self.batch, self.element_count = batch, len(batch)

    def bezier_elements(self) -> list[BezierElements]:
        return [self.batch]


def test_a_knot_that_inverts_an_element_is_caught():
    """x(u) of slopes d0, d1, d2, d3; at the inner knot t the slope is (1 - t) d1 + t d2."""
    slopes = np.array([2.0, -0.1, 0.3, 1.0])
    x = np.concatenate([[0.0], np.cumsum(slopes * [0.5, 1.0, 1.0, 0.5] / 3.0)])
    net = np.zeros((5, 2, 2, 3))
    net[..., 0] = x[:, None, None]
    net[:, 1, :, 1] = 1.0
    net[:, :, 1, 2] = 1.0

    def elements(knot: float) -> BezierElements:
        knots = np.array([0, 0, 0, 0, knot, 1, 1, 1, 1.0])
        first, operators = bspline.bezier_extraction(3, knots)
        points = np.array([np.einsum("ai,ijkd->ajkd", operators[e], net[first[e] : first[e] + 4])
                           for e in range(2)])  # fmt: skip
        return BezierElements((3, 1, 1), points, None, np.arange(2), np.zeros(2, dtype=int))

    assert certify([elements(0.5)]).all_valid
    late = certify([elements(0.1)])  # slope -.06 at the knot, which both elements have
    assert late.status.tolist() == [INVALID, INVALID]


# ------------------------------------------------------------------- random smooth bodies


def smooth_map(rng, size: float):
    """Random affine map and a wave, of points."""
    matrix = np.eye(3) + 0.3 * rng.uniform(-1, 1, (3, 3))
    wave, phase = rng.normal(size=(3, 3)) / size, rng.uniform(0, 6, 3)
    height = 0.12 * size * rng.uniform(-1, 1, (3, 3))

    def mapped(points):
        return points @ matrix.T + np.sin(points @ wave.T + phase) @ height.T

    return mapped


@pytest.mark.parametrize("seed", range(5))
def test_random_smooth_bodies_against_sampling_and_motion(seed):
    rng = np.random.default_rng(seed)
    body = (bodies.box((2.0, 2.0, 2.0), (3, 2, 2)), bodies.sphere(), bodies.torus())[seed % 3]
    plain = inward(body, rng.uniform(0.3, 0.7), layers=2)
    mapped = smooth_map(rng, 2.0)
    layers = np.array([mapped(layer) for layer in plain.layers])
    layers[-1] += rng.uniform(0.02, 0.3) * rng.normal(size=layers[-1].shape)
    surface = plain.surface.with_points(layers[0])
    shell = Shell(surface, layers, plain.degree_w, plain.knots_w)
    certificate = certify(shell.bezier_elements())
    least = least_determinants(shell, 9)
    assert np.all(least[certificate.status == VALID] > 0.0)
    # what is proved invalid has a point where it is; samples come close to it
    fine = least_determinants(shell, 17)
    volume = np.abs(shell.element_volumes()).mean()
    assert np.all(fine[certificate.status == INVALID] < 0.03 * volume)
    assert np.all(certificate.status[fine <= 0.0] < VALID)
    assert certificate.undecided <= 0.05 * len(certificate)
    # rotated, scaled, moved
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    for scale, shift in ((1e-3, 0.0), (1e3, 1e5), (1.0, 1e3)):
        moved = scale * layers @ turn.T + shift * np.array([1.0, -1.0, 0.5])
        other = Shell(surface.with_points(moved[0]), moved, shell.degree_w, shell.knots_w)
        again = certify(other.bezier_elements())
        assert np.all(certificate.status * again.status >= 0)  # nothing valid becomes invalid
        both = (certificate.status == VALID) & (again.status == VALID)
        assert both.sum() >= 0.98 * certificate.valid
        # bounds may come from more or fewer halvings, but the figure itself has no unit
        ratio = again.min_bernstein[both] / certificate.min_bernstein[both]
        assert 0.5 < np.median(ratio) < 2.0


# ------------------------------------------------------------- singular corners and lines


def opened(body, lift: float) -> Shell:
    """Shell towards the middle whose inner corners are closed a little, so that they open up."""
    surface = build_surface(list(body.faces))
    points = surface.control_points
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    flags = surface.singular_flags
    corner = np.zeros(len(points), dtype=bool)
    for group in surface.groups:
        for i, j in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
            hit = flags[group.element][:, 0 if i == 0 else 2, 0 if j == 0 else 2]
            corner[group.index[hit, i, j]] = True
    target = points + 0.5 * (middle - points)
    # corners stay farther out than the sides beside them
    target[corner, :2] += lift * (points - middle)[corner, :2]
    return shell_towards(surface, lambda _: target, layers=2, degree=1)


def test_flat_corners_are_proved_but_for_themselves():
    shell = opened(pole(), 0.25)
    certificate = certify(shell.bezier_elements())
    assert certificate.all_valid
    assert certificate.valid_inside == 2
    inside = certificate.status == VALID_INSIDE
    assert np.all(certificate.min_bernstein[inside] == 0.0)
    assert np.all(certificate.min_bernstein[~inside] > 0.0)
    # zero at the corners, positive next to them and everywhere else
    at = least_determinants(shell, 5)
    assert np.abs(at[inside]).max() < 1e-14
    for inset in (1e-6, 1e-3):
        assert least_determinants(shell, 9, inset).min() > 0.0


def test_flat_corners_all_the_way_in_are_not_proved():
    """A similar shell has 180 degrees at its inner corners too: det J = 0 along whole columns."""
    shell = opened(pole(), 0.0)
    certificate = certify(shell.bezier_elements())
    assert not certificate.all_valid
    caps = np.isin(certificate.patch, [0, 1])
    assert np.all(certificate.status[caps] < VALID)
    # corners that are bent over 180 degrees inside are inverted
    over = certify(opened(pole(), -0.2).bezier_elements())
    assert over.invalid >= 2


def test_only_the_outer_boundary_is_excused():
    """The second layer of a shell may not be singular at its outer side."""
    shell = opened(pole(), 0.25)
    batches = shell.bezier_elements()
    flagged = {int(e) for b in batches if b.singular is not None
               for e in b.element[b.singular.any(axis=(1, 2))]}  # fmt: skip
    assert len(flagged) == 2
    assert all(e % shell.layer_count == 0 for e in flagged)
    without = [replace(b, singular=None) for b in batches]
    assert certify(batches).all_valid
    assert certify(without).valid == shell.element_count - 2


def test_a_singular_line_can_be_proved_but_for_itself():
    """Doubled control points that part on the way in."""
    body = doubled()
    surface = build_surface(list(body.faces))
    points = surface.control_points
    inner = points + 0.2 * (np.array([0.3, 0.6, 0.5]) - points)
    corner = np.flatnonzero(np.linalg.norm(points[:, :2] - [1.0, 0.0], axis=1) < 1e-12)
    # the first of the two goes back along the wall before, the second along the wall behind
    for patch in surface.patches:
        if patch.face == "Face1":
            grid = patch.index if patch.index.shape[0] == 4 else patch.index.T
            before, behind = grid[1], grid[2]
            if np.linalg.norm(points[grid[0]][:, 1] - 0.0) > 1e-9:
                before, behind = behind, before
    assert set(before) | set(behind) <= set(corner)
    inner[before, :2] += [-0.08, 0.0]
    inner[behind, :2] += [0.0, 0.08]
    shell = shell_towards(surface, lambda _: inner, 1)
    certificate = certify(shell.bezier_elements())
    assert certificate.all_valid
    assert certificate.valid_inside > 0
    assert least_determinants(shell, 9, 1e-4).min() > 0.0
    # without parting the derivative is zero at every depth
    together = inner.copy()
    together[before], together[behind] = inner[corner].mean(axis=0), inner[corner].mean(axis=0)
    together[before, 2], together[behind, 2] = inner[before, 2], inner[behind, 2]
    assert not certify(shell_towards(surface, lambda _: together, 1).bezier_elements()).all_valid
