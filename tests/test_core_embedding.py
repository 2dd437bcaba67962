# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The proof that a curved surface does not cut itself: what is proved, and what must not be."""

from __future__ import annotations

from dataclasses import replace

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.embedding_proof import prove_embedded
from HybridVolume.core.intersection import self_intersections
from HybridVolume.core.refinement import flatten_spans


def surface_of(body, change=lambda x: x):
    faces = [replace(f, control_points=change(f.control_points)) for f in body.faces]
    return flatten_spans(build_surface(faces))


@pytest.mark.parametrize(
    "body",
    [
        bodies.box((3.0, 2.0, 1.0), (3, 2, 1)),
        bodies.plate(20.0, 4),
        bodies.l_bracket(spans=2),
        bodies.wedge(5.0, spans=2),
        bodies.sphere(),
        bodies.hollow_sphere(2.0, 1.9),
        bodies.torus(),
        bodies.cylinder(),
    ],
    ids=lambda body: body.name,
)
def test_embedded_bodies_are_proved_at_any_size_and_place(body):
    rng = np.random.default_rng(3)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    for scale, shift in ((1e-3, 1.0), (1e3, -1e5)):
        found = prove_embedded(surface_of(body, lambda x, s=scale, t=shift: s * x @ turn.T + t))
        assert found.proved
        assert len(found.open) == 0


def bar(turns: float):
    """A bar bent around an axis; from one turn on its ends meet."""

    def bent(points):
        angle = (points[..., :1] - 4.0) * (turns * 2.0 * np.pi / 8.0)
        radius = 2.0 + points[..., 1:2]
        return np.concatenate(
            [radius * np.cos(angle), radius * np.sin(angle), points[..., 2:]], axis=-1
        )

    return surface_of(bodies.box((8.0, 1.0, 1.0), (6, 1, 1), 2), bent)


def test_ends_that_run_through_each_other_are_not_proved():
    assert prove_embedded(bar(0.97)).proved
    found = prove_embedded(bar(1.05), depth=3)
    assert not found.proved
    # the spans in the middle of the bar have nothing to do with it
    assert 0 < len(found.open) < bar(1.05).element_count / 2


@pytest.mark.parametrize(("centre", "expected"), [(0.89, True), (0.91, False), (1.5, False)])
def test_a_cavity_near_the_outer_surface(centre, expected):
    """Spheres of radius 2 and 1.1, whose centres are as far apart as said."""
    body = bodies.hollow_sphere(2.0, 1.1)
    shift = np.array([centre, 0.0, 0.0])
    surface = flatten_spans(build_surface(list(body.faces)))
    cavity = np.unique(np.concatenate([
        p.index.ravel() for p, s in zip(surface.patches, surface.shell_of_patch, strict=True) if s
    ]))  # fmt: skip
    points = surface.control_points.copy()
    points[cavity] += shift
    assert prove_embedded(surface.with_points(points), depth=5).proved is expected


@pytest.mark.parametrize("seed", range(8))
def test_nothing_is_proved_whose_triangles_cross(seed):
    rng = np.random.default_rng(seed)
    body = (bodies.box((2.0, 2.0, 2.0), (2, 2, 1)), bodies.torus())[seed % 2]
    surface = build_surface(list(body.faces))
    noise = (0.05, 0.15, 0.25, 0.35)[seed // 2] * rng.normal(size=surface.control_points.shape)
    surface = surface.with_points(surface.control_points + noise)
    mesh = surface.triangulation(6)
    crossing = self_intersections(mesh.vertices, mesh.triangles)
    found = prove_embedded(surface, depth=2)
    assert not (found.proved and len(crossing))
    if seed < 2:
        assert found.proved


def test_a_patch_that_folds_over_is_not_proved():
    """One side of a cube pulled through the opposite one, and a tip bent back over its own face."""
    surface = build_surface(list(bodies.box((1.0, 1.0, 1.0), (3, 3, 3), 2).faces))
    points = surface.control_points
    through = points.copy()
    inner = np.all((points[:, :2] > 0.2) & (points[:, :2] < 0.8), axis=1) & (points[:, 2] == 1.0)
    through[inner, 2] = -1.5
    assert prove_embedded(surface.with_points(points)).proved
    assert not prove_embedded(surface.with_points(through), depth=2).proved
    over = points.copy()
    over[inner & (np.abs(points[:, 0] - 0.5) < 0.1), 0] = 1.6
    assert not prove_embedded(surface.with_points(over), depth=2).proved
