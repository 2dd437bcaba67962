# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The medial axis of bodies whose medial axis is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from time import process_time

import bodies
import numpy as np
import pytest
from patches import interpolating_face, make_body, uniform_knots
from variants import mixed_splines

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.intersection import points_inside
from HybridVolume.core.midstructure import Midstructure, medial_axis
from HybridVolume.core.midstructure.samples import sample_surface
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


def bracket() -> bodies.Body:
    """L of two plates of 0.6 mm, 3 and 2 mm long and 2 mm wide."""
    quads = [
        [(0, 0), (0.6, 0), (0.6, 0.6), (0, 0.6)],
        [(0.6, 0), (3, 0), (3, 0.6), (0.6, 0.6)],
        [(0, 0.6), (0.6, 0.6), (0.6, 2), (0, 2)],
    ]
    return bodies.prism(quads, 2.0, 2.0 * 0.6 * 4.4, name="bracket")


def bracket_area() -> float:
    """Of the medial axis of the bracket between the plates' faces and through its corner."""
    t, width = 0.6, 2.0
    # around the inner edge it is a parabola, from where the outer sides are as near
    x = np.linspace(t * (2.0 - 2.0**0.5), t, 20001)
    radius = (x - t) ** 2 / (2.0 * t) + 0.5 * t
    strip = (width - 2.0 * radius) * np.hypot(1.0, (x - t) / t)
    corner = 2.0 * float(np.sum(0.5 * (strip[1:] + strip[:-1]) * np.diff(x)))
    return corner + (width - t) * ((3.0 - 1.5 * t) + (2.0 - 1.5 * t))


def tapered() -> bodies.Body:
    """Bar of 6 mm whose square section goes from 1 to 0.3 mm."""
    bar = bodies.box((6.0, 1.0, 1.0), (4, 2, 2))

    def thinner(face):
        x = face.control_points.copy()
        x[..., 1:] = 0.5 + (x[..., 1:] - 0.5) * (1.0 - 0.7 * x[..., :1] / 6.0)
        return replace(face, control_points=x)

    return make_body("tapered", [thinner(face) for face in bar.faces], 6.0 * (1.39 / 3.0))


def hollow_box() -> bodies.Body:
    """Box of 4x4x4 mm with a cavity of 2x2x2 mm."""
    faces = bodies.box((4.0, 4.0, 4.0), (2, 2, 2)).faces
    faces += bodies.box((2.0, 2.0, 2.0), (2, 2, 2), corner=(1.0, 1.0, 1.0)).faces
    return make_body("hollow box", faces, 56.0, (0, 0))


def rounded(length: float, width: float, height: float, radius: float) -> bodies.Body:
    """Plate whose four upright edges are rounded; arcs are polynomials to 1e-4 mm."""
    knots = (uniform_knots(4, 1), uniform_knots(4, 1))
    corner = np.array([length, width]) / 2.0 - radius
    outline, inner = [], []
    for k, sign in enumerate([(1, -1), (1, 1), (-1, 1), (-1, -1)]):
        start = 0.5 * np.pi * (k - 1)
        turn = start + np.linspace(0.0, 1.0, 5) * 0.5 * np.pi
        arc = corner * sign + radius * np.column_stack([np.cos(turn), np.sin(turn)])
        outline += [arc, None]
        inner += [0.5 * arc[0], 0.5 * arc[-1]]
    for k in range(1, 8, 2):
        begin, end = outline[k - 1][-1], outline[(k + 1) % 8][0]
        outline[k] = begin + np.linspace(0.0, 1.0, 5)[:, None] * (end - begin)
    faces = []

    def add(function):
        faces.append(interpolating_face(function, (4, 4), knots))

    def along(k, t):
        return np.stack([np.interp(t, _FIFTHS, outline[k][:, i]) for i in (0, 1)], axis=-1)

    def upright(plane, z):
        return np.concatenate([plane, np.broadcast_to(z, plane.shape[:-1] + (1,))], axis=-1)

    for k in range(8):
        a, b = inner[k], inner[(k + 1) % 8]

        def wall(u, v, k=k):
            plane = along(k, np.broadcast_arrays(u, v)[0])
            return upright(plane, height * np.broadcast_arrays(u, v)[1][..., None])

        add(wall)
        for z in (0.0, height):

            def strip(u, v, k=k, a=a, b=b, z=z):
                u, v = np.broadcast_arrays(u, v)
                straight = a + u[..., None] * (b - a)
                return upright(straight + v[..., None] * (along(k, u) - straight), z)

            add(strip)
    for k in range(0, 8, 2):
        x = [np.zeros(2), inner[k], inner[k + 1], inner[(k + 2) % 8]]
        for z in (0.0, height):

            def quad(u, v, x=x, z=z):
                u, v = (a[..., None] for a in np.broadcast_arrays(u, v))
                plane = (1 - u) * ((1 - v) * x[0] + v * x[3]) + u * ((1 - v) * x[1] + v * x[2])
                return upright(plane, z)

            add(quad)
    volume = height * (length * width - (4.0 - np.pi) * radius**2)
    return make_body("rounded", faces, volume)


_FIFTHS = np.linspace(0.0, 1.0, 5)

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
    "bracket": bracket,
    "tapered": tapered,
    "hollow box": hollow_box,
    "rounded plate": lambda: rounded(6.0, 4.0, 1.0, 0.8),
    "rounded block": lambda: rounded(6.0, 2.0, 4.0, 0.5),
    "voxels": lambda: bodies.bent_voxels(0, 3),
    "mixed": lambda: mixed_splines(bodies.torus()),
}


@cache
def surface_of(name: str) -> PatchSurface:
    return build_surface(list(BODIES[name]().faces))


@cache
def axis_of(name: str) -> Midstructure:
    # thin walls ask for more, and for more time
    return medial_axis(surface_of(name), {"fin": 16000, "plate 50": 16000}.get(name, 0))


def kept_points(name: str) -> np.ndarray:
    m = axis_of(name)
    return m.vertices[np.unique(m.facets[m.kept])]


def moved(surface: PatchSurface, seed: int, scale: float, shift: float) -> PatchSurface:
    """The body turned at random, moved away by so many diagonals, and scaled."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    points = surface.control_points @ turn.T + shift * surface.diagonal * np.array([0.6, -0.8, 1.0])
    return surface.with_points(scale * points)


@pytest.mark.parametrize("name", list(BODIES))
def test_every_body_has_a_midstructure(name):
    m, surface = axis_of(name), surface_of(name)
    assert m.kept.any() and m.kept_sheets > 0
    assert m.facets.max() < len(m.vertices) == len(m.radius)
    assert len(m.sheet) == len(m.facets) == len(m.kept)
    kept = np.zeros(len(m.sheets), dtype=bool)
    kept[m.sheet[m.kept]] = True
    assert kept.tolist() == [sheet.kept for sheet in m.sheets]
    mesh = surface.triangulation(4 if surface.rational else 2)
    points = kept_points(name)
    points = points[:: max(1, len(points) // 100)]
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


@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0.0), (1e3, 0.0), (1.0, 0.0), (1.0, 1000.0)])
def test_box_of_any_size_anywhere(scale, shift):
    surface = moved(surface_of("box"), 5, scale, shift)
    m = medial_axis(surface)
    assert m.area == pytest.approx(3.0 * scale**2, rel=0.01)
    corner = [surface.control_points[surface.patches[k].index[0, 0]] for k in (4, 5)]
    normal = (corner[1] - corner[0]) / np.linalg.norm(corner[1] - corner[0])
    x = m.vertices[np.unique(m.facets[m.kept])]
    height = (x - 0.5 * (corner[0] + corner[1])) @ normal
    assert np.abs(height).max() < 1e-3 * scale


@pytest.mark.parametrize("name", ["bracket", "voxels", "ring"])
def test_a_moved_body_has_the_same_sheets(name):
    one = axis_of(name)
    for seed, scale, shift in ((1, 1e-3, 0.0), (2, 1e3, 30.0)):
        two = medial_axis(moved(surface_of(name), seed, scale, shift))
        # the ridges of its square bars come and go with the samples
        off = 0.03 if name == "voxels" else 0.01
        assert two.area == pytest.approx(one.area * scale**2, rel=off)
        pairs = []
        for m in (one, two):
            area = np.bincount(m.sheet[m.kept], m.facet_areas[m.kept], len(m.sheets))
            main = np.flatnonzero(area > 0.05 * m.area)
            pairs.append({frozenset(m.sheets[k].faces) for k in main})
        assert pairs[0] == pairs[1]


def test_bracket_has_its_sheet_through_the_corner():
    m = axis_of("bracket")
    big = [sheet for sheet in m.sheets if sheet.kept and sheet.area > 0.1]
    # a sheet a plate, each with its half of the corner
    assert len(big) == 2
    assert m.area == pytest.approx(bracket_area(), rel=0.01)
    x = kept_points("bracket")
    long = x[(x[:, 0] > 0.7) & (x[:, 1] < 0.6)]
    assert np.abs(long[:, 1] - 0.3).max() < 1e-3
    assert x[:, 0].max() == pytest.approx(2.7, abs=0.02)


def test_rounded_plate_has_one_sheet():
    m = axis_of("rounded plate")
    assert len(np.unique(smooth_groups(surface_of("rounded plate")).of_patch)) == 3
    assert sum(sheet.kept for sheet in m.sheets) == 1 and len(m.sheets) == 3
    # the plate's outline, half a millimetre smaller all around
    assert m.area == pytest.approx(5.0 * 3.0 - (4.0 - np.pi) * 0.3**2, rel=0.01)
    assert np.abs(kept_points("rounded plate")[:, 2] - 0.5).max() < 2e-3


def test_rounded_block_keeps_sheets_apart_within_one_smooth_group():
    m = axis_of("rounded block")
    (middle,) = (sheet for sheet in m.sheets if sheet.kept)
    assert m.area == pytest.approx(4.0 * 2.0, rel=0.01)
    x = kept_points("rounded block")
    assert np.abs(x[:, 1]).max() < 1e-3
    # from its ends to the axes of the roundings: four sheets that end inside
    inside = [s for s in m.sheets if not s.at_edge and not s.kept and s.area > 0.5]
    assert len(inside) == 4
    assert all(s.radius[0] > 0.45 for s in inside) and middle.angle[0] > 170.0


def test_hollow_box_has_a_sheet_a_wall():
    m = axis_of("hollow box")
    kept = [sheet for sheet in m.sheets if sheet.kept and sheet.area > 0.5]
    assert len(kept) == 6
    walls = np.abs(kept_points("hollow box") - 2.0).max(axis=1)
    assert np.quantile(np.abs(walls - 1.5), 0.5) < 1e-3


def test_tapered_bar_keeps_its_axis_to_the_thin_end():
    x = kept_points("tapered")
    half = 0.5 * (1.0 - 0.7 * x[:, 0] / 6.0)
    assert (np.hypot(x[:, 1] - 0.5, x[:, 2] - 0.5) < 0.5 * half).all()
    assert x[:, 0].min() < 0.6 and x[:, 0].max() > 5.7
    assert np.diff(np.sort(x[:, 0])).max() < 0.3


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
    samples = sample_surface(surface, 16000)
    # rounding to whole numbers a patch may go beyond
    assert 12000 < len(samples.points) < 20000
    assert np.linalg.norm(samples.normals, axis=1) == pytest.approx(1.0)
    wall = (samples.points[:, 1] > 4.5) & (samples.points[:, 1] < 7.5)
    assert np.median(samples.spacing[wall]) < 0.075 < np.median(samples.spacing[~wall])


def test_the_body_tells_the_number_of_samples():
    assert 6000 < len(sample_surface(surface_of("cube")).points) < 10000
    # a plate of 50 x 50 x 1 mm needs three samples in half a millimetre, if so many are allowed
    assert 40000 < len(sample_surface(surface_of("plate 50")).points) < 60000


def test_samples_follow_the_curvature():
    surface = surface_of("rounded block")
    samples = sample_surface(surface, 8000)
    corner = (np.abs(samples.points[:, 0]) > 2.6) & (np.abs(samples.points[:, 1]) > 0.6)
    upright = corner & (np.abs(samples.points[:, 2] - 2.0) < 1.9)
    flat = np.abs(samples.points[:, 0]) < 2.0
    assert np.median(samples.spacing[upright]) <= np.median(samples.spacing[flat])


@pytest.mark.parametrize("name", ["box", "cylinder"])
def test_twenty_thousand_samples_take_little_time(name):
    begin = process_time()
    medial_axis(surface_of(name), 20000)
    # 2 s where nothing else runs
    assert process_time() - begin < 8.0


def test_many_patches_take_little_time():
    n = 18
    quads = [[(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)] for i in range(n) for j in range(n)]
    surface = build_surface(list(bodies.prism(quads, 2.0, 2.0 * n * n, name="many").faces))
    begin = process_time()
    m = medial_axis(surface)
    assert process_time() - begin < 8.0
    assert len(surface.patches) == 2 * n * n + 4 * n
    assert m.sheets[0].kept and m.area == pytest.approx((n - 2.0) ** 2, rel=0.01)


def test_a_small_turned_ball_has_its_centre():
    # of its inner balls, all as large as each other but for rounding, none may outdo the others
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    faces = bodies.sphere().faces
    faces = [replace(f, control_points=1e-3 * f.control_points @ turn.T) for f in faces]
    m = medial_axis(build_surface(faces))
    kept = m.vertices[m.facets[m.kept].ravel()]
    assert len(kept) and np.linalg.norm(kept, axis=1).max() < 1e-5


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
