# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Distances to the surface, and surfaces of equal distance as midstructures."""

from __future__ import annotations

from functools import cache

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.intersection import self_intersections
from HybridVolume.core.midstructure import Midstructure, Search, find_midstructure
from HybridVolume.core.midstructure.distance import distance_surface
from HybridVolume.core.midstructure.distances import SurfaceDistance
from HybridVolume.core.surface import PatchSurface
from HybridVolume.errors import InputError


def turned() -> np.ndarray:
    """A rotation about no axis of the coordinates."""
    q, _ = np.linalg.qr(np.array([[1.0, 2.0, 3.0], [-2.0, 1.0, 0.5], [0.3, -1.0, 2.0]]))
    return q * np.sign(np.linalg.det(q))


@cache
def surface_of(name: str) -> PatchSurface:
    made = {
        "box": lambda: bodies.box((4.0, 2.0, 1.0), (4, 2, 2)),
        "torus": bodies.torus,
        "cylinder": lambda: bodies.cylinder(1.0, 4.0),
        "sphere": bodies.sphere,
        "hollow sphere": bodies.hollow_sphere,
    }
    return build_surface(list(made[name]().faces))


def enclosed(midstructure: Midstructure, which: np.ndarray | slice = slice(None)) -> float:
    """Volume inside closed triangles."""
    x = (midstructure.vertices - midstructure.vertices.mean(axis=0))[midstructure.facets[which]]
    return float(np.einsum("ti,ti->", x[:, 0], np.cross(x[:, 1], x[:, 2]))) / 6.0


def genus(triangles: np.ndarray) -> int:
    return 1 - (len(np.unique(triangles)) - len(triangles) // 2) // 2


def check(midstructure: Midstructure, depth: float) -> None:
    """Closed, oriented, not cut by itself, and at the depth."""
    m = midstructure
    sides = m.facets[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    n = len(m.vertices)
    there, back = sides @ [n, 1], sides @ [1, n]
    assert len(np.unique(there)) == len(sides) and np.array_equal(np.sort(there), np.sort(back))
    assert not len(self_intersections(m.vertices, m.facets))
    assert np.abs(m.radius - depth).max() < 0.01 * depth
    assert m.kept.all() and m.method == "distance"
    assert m.probe_points is not None and len(m.faces) > 0


@pytest.mark.parametrize("name", ["torus", "cylinder"])
def test_distance_to_rational_patches(name):
    rng = np.random.default_rng(1)
    if name == "torus":
        points = rng.uniform(-1.0, 1.0, (2000, 3)) * [4.0, 4.0, 1.0]
        tube = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 3.0, points[:, 2])
        signed = 1.0 - tube
    else:
        points = rng.uniform(-1.2, 1.2, (2000, 3)) * [1.0, 1.0, 2.0] + [0.0, 0.0, 2.0]
        out = np.column_stack(
            [np.hypot(points[:, 0], points[:, 1]) - 1.0, np.abs(points[:, 2] - 2.0) - 2.0]
        )
        signed = -np.linalg.norm(np.maximum(out, 0.0), axis=1) - np.minimum(out.max(axis=1), 0.0)
    distance = SurfaceDistance(surface_of(name))
    feet = distance.nearest(points)
    assert np.abs(feet.distance - np.abs(signed)).max() < 1e-9
    sure = np.abs(signed) > 0.01
    assert np.array_equal(distance.inside(points)[sure], signed[sure] > 0.0)
    surface = surface_of(name)
    for k in range(0, 200, 20):
        foot = surface.evaluate(feet.patch[k], feet.uv[k, :1], feet.uv[k, 1:])[0]
        assert np.linalg.norm(foot - feet.points[k]) < 1e-9


def test_box():
    m = find_midstructure(surface_of("box"), Search(method="distance", depth="0.25 mm"))
    check(m, 0.25)
    assert len(m.sheets) == 1 and genus(m.facets) == 0
    assert m.area == pytest.approx(2.0 * (3.5 * 1.5 + 3.5 * 0.5 + 1.5 * 0.5), rel=0.01)
    assert enclosed(m) == pytest.approx(3.5 * 1.5 * 0.5, rel=0.01)
    # corners and edges are sharp
    corner = np.linalg.norm(m.vertices - [0.25, 0.25, 0.25], axis=1).min()
    assert corner < 0.01
    assert set(m.sheets[0].faces) <= set(m.faces)


def test_sphere_at_a_share():
    m = distance_surface(surface_of("sphere"), 0.4, True)
    check(m, 0.4)
    assert np.abs(np.linalg.norm(m.vertices, axis=1) - 0.6).max() < 0.004
    assert enclosed(m) == pytest.approx(4.0 / 3.0 * np.pi * 0.6**3, rel=0.01)


def test_torus_keeps_its_hole():
    m = distance_surface(surface_of("torus"), 0.5, True)
    check(m, 0.5)
    assert genus(m.facets) == 1 and len(m.sheets) == 1
    assert m.area == pytest.approx(4.0 * np.pi**2 * 3.0 * 0.5, rel=0.01)


def test_around_a_cavity_there_are_two():
    m = distance_surface(surface_of("hollow sphere"), 0.3, False)
    check(m, 0.3)
    assert len(m.sheets) == 2
    volumes = sorted(abs(enclosed(m, m.sheet == k)) for k in (0, 1))
    assert volumes == pytest.approx([4 / 3 * np.pi * r**3 for r in (1.3, 1.7)], rel=0.02)


@pytest.mark.parametrize("size, shift", [(1e-3, 1.0)])
def test_size_and_place_do_not_matter(size, shift):
    surface = surface_of("box")
    moved = surface.with_points(size * surface.control_points @ turned().T + shift)
    m = distance_surface(moved, 0.5, True)
    check(m, 0.25 * size)
    assert m.area == pytest.approx(15.5 * size**2, rel=0.01)
    assert enclosed(m) == pytest.approx(2.625 * size**3, rel=0.01)


@pytest.mark.parametrize("depth", [0.5])
def test_too_deep(depth):
    with pytest.raises(InputError, match="deepest") as caught:
        distance_surface(surface_of("box"), depth, False)
    assert caught.value.figure == pytest.approx(0.5, rel=1e-3) and caught.value.remedy


def test_what_is_too_thin_is_refused():
    thin = build_surface(list(bodies.box((40.0, 40.0, 0.2), (4, 4, 2)).faces))
    with pytest.raises(InputError, match="too thin|too large") as caught:
        distance_surface(thin, 0.9, True)
    assert caught.value.remedy
