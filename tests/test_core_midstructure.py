# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The medial axis of bodies whose medial axis is known."""

from __future__ import annotations

from functools import cache

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.intersection import points_inside, self_intersections
from HybridVolume.core.midstructure import Midstructure, medial_axis
from HybridVolume.core.midstructure.samples import sample_surface
from HybridVolume.core.midstructure.resample import resample
from HybridVolume.core.midstructure.smooth_groups import smooth_groups
from HybridVolume.core.surface import PatchSurface


def fin() -> bodies.Body:
    """Block of 4x4x4 mm with a wall of 0.2 mm on top."""
    x = (0.0, 1.9, 2.1, 4.0)
    quads = [[(a, 0), (b, 0), (b, 4), (a, 4)] for a, b in zip(x[:-1], x[1:], strict=True)]
    quads.append([(1.9, 4), (2.1, 4), (2.1, 8), (1.9, 8)])
    return bodies.prism(quads, 4.0, 67.2, name="fin")


def triangle() -> bodies.Body:
    """Equilateral prism: all sheets run into edges."""
    corner = np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 3.0**0.5]])
    centre = corner.mean(axis=0)
    middle = 0.5 * (corner + np.roll(corner, -1, axis=0))
    quads = [[corner[k], middle[k], centre, middle[k - 1]] for k in range(3)]
    return bodies.prism(quads, 2.0, 2.0 * 3.0**0.5, name="triangle")


BODIES = {
    "box": lambda: bodies.box((4.0, 2.0, 1.0), (4, 2, 2)),
    "bar": lambda: bodies.box((6.0, 1.0, 1.0), (4, 2, 2)),
    "cube": lambda: bodies.box((1.0, 1.0, 1.0), (2, 2, 2)),
    "L": bodies.l_bracket,
    "plate 50": lambda: bodies.plate(50.0),
    "wedge": bodies.wedge,
    "triangle": triangle,
    "cylinder": lambda: bodies.cylinder(1.0, 4.0),
    "sphere": bodies.sphere,
    "hollow sphere": bodies.hollow_sphere,
    "torus": bodies.torus,
    "ring": bodies.ring,
    "fin": fin,
}


@cache
def surface_of(name: str) -> PatchSurface:
    return build_surface(list(BODIES[name]().faces))


@cache
def axis_of(name: str) -> Midstructure:
    return medial_axis(surface_of(name))


def kept_points(name: str) -> np.ndarray:
    m = axis_of(name)
    return m.vertices[np.unique(m.facets[m.kept])]


@pytest.mark.parametrize("name", list(BODIES))
def test_every_body_has_a_midstructure(name):
    m, surface = axis_of(name), surface_of(name)
    assert m.kept.any() and m.kept_sheets > 0
    assert m.facets.max() < len(m.vertices) == len(m.radius)
    assert len(m.sheet) == len(m.facets) == len(m.kept)
    kept = np.zeros(len(m.sheets), dtype=bool)
    kept[m.sheet[m.kept]] = True
    assert kept.tolist() == [sheet.kept for sheet in m.sheets]
    mesh = surface.triangulation(8)
    points = kept_points(name)
    points = points[:: max(1, len(points) // 300)]
    assert points_inside(mesh.vertices, mesh.triangles, points).all()


def test_box_has_its_central_sheet():
    m = axis_of("box")
    big = [sheet for sheet in m.sheets if sheet.kept and sheet.area > 0.1]
    assert len(big) == 1
    assert set(big[0].faces) == {"Face5", "Face6"}
    assert big[0].angle == pytest.approx((180.0, 180.0))
    assert m.area == pytest.approx(3.0, rel=0.01)
    points = kept_points("box")
    assert np.abs(points[:, 2] - 0.5).max() < 1e-3
    assert points[:, 0].min() == pytest.approx(0.5, abs=0.02)
    assert points[:, 0].max() == pytest.approx(3.5, abs=0.02)
    # the twelve sheets of the edges are there, to be looked at, and dropped
    assert sum("edge" in sheet.reason and not sheet.kept for sheet in m.sheets) == 12


def test_plate_has_its_sheet():
    assert axis_of("plate 50").area == pytest.approx(49.0**2, rel=0.02)
    # samples are as far apart as the plate is thick: a few vertices at the rim are off
    assert np.quantile(np.abs(kept_points("plate 50")[:, 2] - 0.5), 0.99) < 0.02


def test_hollow_sphere_has_a_closed_sheet():
    m = axis_of("hollow sphere")
    assert m.area == pytest.approx(4.0 * np.pi * 1.5**2, rel=0.02)
    assert np.linalg.norm(kept_points("hollow sphere"), axis=1) == pytest.approx(1.5, abs=0.02)


@pytest.mark.parametrize("name", ["bar", "cylinder", "torus", "ring", "sphere", "cube"])
def test_lines_and_points(name):
    """Where the midstructure is a line or a point, what is kept stays near it."""
    x = kept_points(name)
    if name == "bar":
        distance = np.hypot(x[:, 1] - 0.5, x[:, 2] - 0.5)
        assert x[:, 0].min() < 0.6 and x[:, 0].max() > 5.4
    elif name == "cylinder":
        distance = np.hypot(x[:, 0], x[:, 1])
        assert x[:, 2].min() < 1.1 and x[:, 2].max() > 2.9
    elif name == "torus":
        distance = np.hypot(np.hypot(x[:, 0], x[:, 1]) - 3.0, x[:, 2])
    elif name == "ring":
        distance = np.hypot(np.hypot(x[:, 0], x[:, 1]) - 2.5, x[:, 2] - 0.5)
    else:
        distance = np.linalg.norm(x - (0.0 if name == "sphere" else 0.5), axis=1)
    half = 0.5 if name in ("bar", "ring", "cube") else 1.0
    assert distance.max() < 0.35 * half
    if name in ("torus", "ring"):
        angle = np.sort(np.arctan2(x[:, 1], x[:, 0]))
        assert np.diff(angle).max() < 0.2


def test_acute_wedge_keeps_its_thick_part():
    x = kept_points("wedge")
    sheet = max((s for s in axis_of("wedge").sheets if s.kept), key=lambda s: s.area)
    assert sheet.angle == pytest.approx((160.0, 160.0), abs=0.1)
    # the plane that halves the angle, and nothing near the tip
    assert np.abs(np.arctan2(x[:, 1], x[:, 0]) - np.radians(10.0)).max() < 0.03
    assert 0.8 < x[:, 0].min() < 1.6


def test_triangle_keeps_its_middle():
    x = kept_points("triangle")[:, :2] - [1.0, 3.0**-0.5]
    assert np.linalg.norm(x, axis=1).max() < 0.35 * 3.0**-0.5
    assert axis_of("triangle").kept.any()


def test_thin_wall_keeps_its_sheet_beside_a_thick_block():
    m = axis_of("fin")
    x = kept_points("fin")
    wall = x[x[:, 1] > 4.3]
    assert np.abs(wall[:, 0] - 2.0).max() < 0.02
    inside = m.kept & (m.vertices[m.facets].mean(axis=1)[:, 1] > 4.1)
    # from 0.1 mm under the rims to the foot
    assert m.facet_areas[inside].sum() == pytest.approx(3.8 * 3.8, rel=0.05)
    block = x[x[:, 1] < 3.5]
    assert len(block) and np.linalg.norm(block.mean(axis=0) - 2.0) < 0.6


def test_samples_are_denser_in_the_wall():
    surface = surface_of("fin")
    samples = sample_surface(surface, 16000, smooth_groups(surface).of_patch)
    # rounding to whole numbers a patch may go beyond
    assert 8000 < len(samples.points) < 24000
    assert np.linalg.norm(samples.normals, axis=1) == pytest.approx(1.0)
    wall = (samples.points[:, 1] > 4.5) & (samples.points[:, 1] < 7.5)
    assert np.median(samples.spacing[wall]) < 0.075 < np.median(samples.spacing[~wall])


def test_same_seed_same_result():
    one = medial_axis(surface_of("L"), samples=4000)
    two = medial_axis(surface_of("L"), samples=4000)
    assert np.array_equal(one.vertices, two.vertices)
    assert np.array_equal(one.facets, two.facets) and one.sheets == two.sheets


def test_smooth_groups():
    groups = smooth_groups(surface_of("cylinder"))
    assert len(np.unique(groups.of_patch)) == 3
    assert len(groups.edge_pair) == 8 and groups.edge_convex.all()
    groups = smooth_groups(surface_of("L"))
    assert len(np.unique(groups.of_patch)) == 8
    concave = ~groups.edge_convex.all(axis=1)
    assert concave.sum() == 1
    assert groups.edge_points[concave][0, :, :2] == pytest.approx(1.0)
    assert len(np.unique(smooth_groups(surface_of("hollow sphere")).of_patch)) == 2


@pytest.mark.parametrize("name", ["box", "hollow sphere", "fin", "bar"])
def test_simplified_sheets_can_be_embedded(name):
    m, surface = axis_of(name), surface_of(name)
    mesh = surface.triangulation(8)
    size = {"box": 0.2, "hollow sphere": 0.25, "fin": 0.1, "bar": 0.1}[name]
    simple = resample(m, lambda radius: np.full(len(radius), size), (mesh.vertices, mesh.triangles))
    everything = np.vstack([mesh.vertices, simple.vertices])
    triangles = np.vstack([mesh.triangles, simple.triangles + len(mesh.vertices)])
    pairs = self_intersections(everything, triangles)
    assert not (pairs >= len(mesh.triangles)).any()
    x = simple.vertices[simple.triangles]
    area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum()
    if name == "bar":
        assert len(simple.rest) or area > 0.0
    else:
        assert 0.8 * m.area < area < 1.02 * m.area
