# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Splines over the layout of a quad mesh come as near to a triangulated surface as asked."""

import dataclasses

import numpy as np
import pytest

from HybridVolume.core.fit.fitting import fit
from HybridVolume.core.fit.reference import Reference
from HybridVolume.core.fit.snap import aligned
from HybridVolume.core.midstructure.distances import SurfaceDistance
from HybridVolume.core.polygon_repair import mended
from HybridVolume.core.polygons import PolygonMesh
from HybridVolume.errors import InputError
from HybridVolume.sources.polygon_files import read_polygons


def cylinder_triangles(segments=96, rows=6):
    """Radius 1, height 2."""
    angle = 2.0 * np.pi * np.arange(segments) / segments
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    heights = np.linspace(0.0, 2.0, rows + 1)
    x = [np.column_stack([ring, np.full(segments, z)]) for z in heights]
    x += [[[0.0, 0.0, 0.0]], [[0.0, 0.0, 2.0]]]
    faces = []
    for i in range(rows):
        for k in range(segments):
            a, b = i * segments + k, i * segments + (k + 1) % segments
            faces += [[a, b, b + segments], [a, b + segments, a + segments]]
    for base, centre, up in ((0, -2, 0), (rows * segments, -1, 1)):
        centre += (rows + 1) * segments + 2
        for k in range(segments):
            pair = [base + k, base + (k + 1) % segments]
            faces.append([centre, *(pair if up else pair[::-1])])
    return mended(PolygonMesh.of(np.concatenate(x), faces))


def cylinder_quads():
    """Coarse: eight quads around, caps of a square and a ring around it."""
    angle = 2.0 * np.pi * np.arange(8) / 8
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    square = np.array([[x, y] for y in (-0.4, 0.0, 0.4) for x in (-0.4, 0.0, 0.4)])
    # the square's rim in the order of the ring, from (.4, 0)
    rim = [5, 8, 7, 6, 3, 0, 1, 2]
    x, faces = [], []
    for i in range(4):
        x.append(np.column_stack([ring, np.full(8, 2.0 * i / 3)]))
    for z in (0.0, 2.0):
        x.append(np.column_stack([square, np.full(9, z)]))
    for i in range(3):
        for k in range(8):
            a, b = 8 * i + k, 8 * i + (k + 1) % 8
            faces.append([a, b, b + 8, a + 8])
    for start, outer, up in ((32, 0, False), (41, 24, True)):
        cap = [[start + c for c in (a, a + 1, a + 4, a + 3)] for a in (0, 1, 3, 4)]
        for k in range(8):
            k1 = (k + 1) % 8
            cap.append([start + rim[k], outer + k, outer + k1, start + rim[k1]])
        faces += cap if up else [face[::-1] for face in cap]
    return mended(PolygonMesh.of(np.concatenate(x), faces))


def caps_of_four():
    """A cylinder whose caps are four quads each: four corners of each cap lie on its rim."""
    angle = 2.0 * np.pi * np.arange(8) / 8
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    x = [np.column_stack([ring, np.full(8, 2.0 * i / 3)]) for i in range(4)]
    x.append(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]]))
    faces = []
    for i in range(3):
        for k in range(8):
            a, b = 8 * i + k, 8 * i + (k + 1) % 8
            faces.append([a, b, b + 8, a + 8])
    for k in range(0, 8, 2):
        faces.append([32, (k + 2) % 8, k + 1, k])
        faces.append([33, 24 + k, 25 + k, 24 + (k + 2) % 8])
    return mended(PolygonMesh.of(np.concatenate(x), faces))


@pytest.fixture(scope="module")
def goal():
    return cylinder_triangles()


def test_nearest_points_and_features(goal):
    reference = Reference(goal)
    assert len(reference.chains) == 2
    assert all(chain.closed for chain in reference.chains)
    assert sum(chain.length[-1] for chain in reference.chains) == pytest.approx(4 * np.pi, rel=1e-3)
    points = np.array([[0.0, 0.0, 2.7], [3.0, 0.0, 1.0], [0.2, 0.1, -1.0], [2.0, 0.0, 3.0]])
    found, _ = reference.nearest(points)
    expected = [[0.0, 0.0, 2.0], [1.0, 0.0, 1.0], [0.2, 0.1, 0.0], [1.0, 0.0, 2.0]]
    assert np.allclose(found, expected, atol=1e-12)


def test_nearest_points_of_long_thin_triangles():
    """A prism of 60 strips, each cut in two: the exact distance is that of its flat sides."""
    goal = Reference(cylinder_triangles(60, 1))
    rng = np.random.default_rng(2)
    angle, height = rng.uniform(0.0, 2.0 * np.pi, 400), rng.uniform(0.1, 1.9, 400)
    points = np.column_stack([np.cos(angle), np.sin(angle), height])
    # how far the middle of a flat side is below the circle, at an angle from it
    off = np.mod(angle, np.pi / 30) - np.pi / 60
    exact = np.cos(off) - np.cos(np.pi / 60)
    found = np.linalg.norm(goal.nearest(points)[0] - points, axis=1)
    assert np.abs(found - exact).max() < 1e-12


def test_a_cylinder(goal):
    quads = cylinder_quads()
    found = fit(quads, goal, 0.004)
    assert found.surface.genus == (0,)
    assert found.surface.volume() == pytest.approx(2.0 * np.pi, rel=2e-3)
    assert found.distance <= 0.004
    # measured again from outside: the reference's vertices, and the rims that must stay sharp
    assert SurfaceDistance(found.surface)(goal.vertices).max() <= 0.004
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.full(200, 2.0)])
    assert SurfaceDistance(found.surface)(rim).max() < 0.005


def corner_angles(surface):
    """Angles between the sides at the corners of all patches, degrees."""
    angles = []
    for k, patch in enumerate(surface.patches):
        u, v = (np.array([t[0], t[-1]]) for t in patch.knots)
        u, v = (a.ravel() for a in np.meshgrid(u, v, indexing="ij"))
        _, a, b = surface.evaluate_at(np.full(4, k), u, v, 1)
        a, b = a * [[1], [1], [-1], [-1]], b * [[1], [-1], [1], [-1]]
        cosine = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
        angles.append(np.degrees(np.arccos(cosine)))
    return np.concatenate(angles)


@pytest.mark.parametrize(("tolerance", "patches", "widest"), [(0.05, 6, 160), (0.004, 14, 135)])
def test_corners_on_a_smooth_rim_are_opened_or_moved_inside(goal, tolerance, patches, widest):
    found = fit(caps_of_four(), goal, tolerance)
    assert len(found.faces) == patches
    assert found.distance <= tolerance
    angles = corner_angles(found.surface)
    assert angles.max() < widest
    assert angles.min() > 45.0
    assert found.surface.volume() == pytest.approx(2.0 * np.pi, rel=5e-3)


def test_another_frame_does_not_matter(goal):
    quads = cylinder_quads()
    turn = 0.2
    matrix = np.array(
        [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    moved = dataclasses.replace(quads, vertices=30.0 * quads.vertices @ matrix.T + [5.0, 7.0, 9.0])
    back = aligned(moved, Reference(goal))
    assert np.abs(back.vertices.max(axis=0) - [1.0, 1.0, 2.0]).max() < 0.1
    assert fit(moved, goal, 0.02).distance <= 0.02


def test_what_cannot_be_reached_is_said(goal):
    quads = cylinder_quads()
    with pytest.raises(InputError, match="come no nearer than"):
        fit(quads, goal, 1e-6)
    flat = dataclasses.replace(quads, vertices=quads.vertices * [1.0, 1.0, 0.05])
    with pytest.raises(InputError, match="beside the reference"):
        fit(flat, goal, 0.01)


@pytest.mark.shared
def test_the_fandisk(shared_data):
    folder = shared_data / "fandisk"
    goal = mended(read_polygons(folder / "fandisk_triangles.obj"))
    found = fit(mended(read_polygons(folder / "fandisk_quads.obj")), goal)
    assert len(found.faces) == 108
    assert found.surface.genus == (0,)
    assert found.surface.volume() == pytest.approx(20.243, rel=1e-3)
    assert found.distance <= 0.003 * goal.diagonal
