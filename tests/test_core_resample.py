# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The triangle complex that stands for the midstructure: even, embedded, on the given facets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay
from test_core_harmonic import midstructure_of, shell_of_a_box
from test_core_midstructure import axis_of, surface_of
from test_core_tetmesh import icosphere

from HybridVolume.core.intersection import self_intersections
from HybridVolume.core.midstructure.closest import Carrier, on_triangles
from HybridVolume.core.midstructure.conform import conform
from HybridVolume.core.midstructure.pieces import in_pieces
from HybridVolume.core.midstructure.resample import Complex, resample
from HybridVolume.core.midstructure.shapes import Edges, smallest_angles


def rectangle(corner, one, two) -> tuple[np.ndarray, np.ndarray]:
    """Two triangles."""
    corner, one, two = (np.array(x, dtype=float) for x in (corner, one, two))
    x = np.array([corner, corner + one, corner + one + two, corner + two])
    return x, np.array([[0, 1, 2], [0, 2, 3]])


def together(*parts) -> tuple[np.ndarray, np.ndarray]:
    count = np.cumsum([0] + [len(x) for x, _ in parts])
    facets = [f + n for (_, f), n in zip(parts, count[:-1], strict=True)]
    return np.vstack([x for x, _ in parts]), np.vstack(facets)


def own(vertices: np.ndarray, facets: np.ndarray, radius: float = 0.5):
    """What a user draws, inside of a large sphere."""
    facets = np.asarray(facets)
    return replace(midstructure_of(np.asarray(vertices, float), facets, radius), method="own")


def even(midstructure, size: float, boundary=None) -> Complex:
    boundary = icosphere(3, 4.0) if boundary is None else boundary
    return resample(midstructure, lambda radius: np.full(len(radius), size), boundary)


def areas(x: np.ndarray) -> np.ndarray:
    return 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)


def area_of(c: Complex) -> float:
    return float(areas(c.vertices[c.triangles]).sum())


def euler(c: Complex) -> int:
    edges = Edges.of(c.triangles, len(c.vertices))
    return len(c.vertices) - len(edges.keys) + len(c.triangles)


def seam_length(c: Complex, count: int) -> float:
    edges = Edges.of(c.triangles, len(c.vertices))
    a, b = edges.ends[edges.count == count].T
    return float(np.linalg.norm(c.vertices[a] - c.vertices[b], axis=1).sum())


def check_even(c: Complex, size) -> None:
    """Shapes, lengths, and no two triangles that meet but in common corners and sides."""
    angle = smallest_angles(c.vertices[c.triangles])
    assert angle.min() > 8.0 and np.quantile(angle, 0.05) > 25.0
    a, b = Edges.of(c.triangles, len(c.vertices)).ends.T
    length = np.linalg.norm(c.vertices[a] - c.vertices[b], axis=1) / size
    assert np.mean((length > 0.5) & (length < 2.0)) > 0.9
    assert not len(self_intersections(c.vertices, c.triangles))


# ------------------------------------------------------------------------ medial axes


@pytest.mark.parametrize("name", ["box", "L", "wedge", "hollow sphere"])
def test_medial_axes_become_even_triangles(name):
    m, surface = axis_of(name), surface_of(name)
    mesh = surface.triangulation(8)
    boundary = (mesh.vertices, mesh.triangles)
    c = resample(m, lambda radius: 0.25 * radius, boundary)
    given = in_pieces(m, boundary)
    radius = given.radius[given.facets].mean(axis=1)
    carrier = Carrier(given.vertices[given.facets], 0.1 * radius)
    near, facet = carrier.closest(c.vertices)
    local = radius[facet]
    edges = Edges.of(c.triangles, len(c.vertices))
    if name == "L":
        # noisy where four sheets meet: shapes are not as good there
        assert smallest_angles(c.vertices[c.triangles]).min() > 5.0
        assert not len(self_intersections(c.vertices, c.triangles))
    else:
        check_even(c, 0.25 * local[edges.ends].mean(axis=1))
    off = np.linalg.norm(near - c.vertices, axis=1)
    assert (off < 0.03 * local).all() and np.quantile(off / local, 0.99) < 0.02
    outer = Carrier(mesh.vertices[mesh.triangles], np.full(len(mesh.triangles), np.inf))
    distance = np.linalg.norm(outer.closest(c.vertices)[0] - c.vertices, axis=1)
    assert (distance > 0.7 * local).all()
    everything = np.vstack([mesh.vertices, c.vertices])
    triangles = np.vstack([mesh.triangles, c.triangles + len(mesh.vertices)])
    assert not (self_intersections(everything, triangles) >= len(mesh.triangles)).any()
    exact = {"box": 3.0, "hollow sphere": 4.0 * np.pi * 1.5**2}.get(name)
    if exact:
        assert area_of(c) == pytest.approx(exact, rel=0.01)
    if name == "box":
        assert np.abs(c.vertices[:, 2] - 0.5).max() < 2e-3
        assert euler(c) == 1 and seam_length(c, 1) == pytest.approx(8.0, rel=0.01)
        for x in ([0.5, 0.5, 0.5], [3.5, 0.5, 0.5], [3.5, 1.5, 0.5], [0.5, 1.5, 0.5]):
            assert np.linalg.norm(c.vertices - x, axis=1).min() < 0.02
    if name == "hollow sphere":
        assert euler(c) == 2 and (edges.count == 2).all()
    if name == "wedge":
        assert area_of(c) == pytest.approx(m.area, rel=0.01) and euler(c) == 1


def test_size_and_place_do_not_matter():
    """The box 1000 times smaller or larger, turned, and far from the origin."""
    m, mesh = axis_of("box"), surface_of("box").triangulation(8)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    for scale, shift in ((1e-3, 0.0), (1e3, 0.0), (1.0, 1e4)):
        moved = replace(m, vertices=scale * m.vertices @ turn.T + shift, radius=scale * m.radius)
        outer = scale * mesh.vertices @ turn.T + shift
        c = resample(moved, lambda radius: 0.25 * radius, (outer, mesh.triangles))
        check_even(c, 0.125 * scale)
        assert area_of(c) == pytest.approx(3.0 * scale**2, rel=0.01) and euler(c) == 1


# ------------------------------------------------------------------------ what a user draws


def test_two_triangles_are_split():
    c = even(own(*rectangle((-1, -0.5, 0), (2, 0, 0), (0, 1, 0))), 0.1)
    check_even(c, 0.1)
    assert area_of(c) == pytest.approx(2.0, rel=1e-3)
    assert euler(c) == 1 and seam_length(c, 1) == pytest.approx(6.0, rel=1e-3)


def test_crossing_plates_share_vertices():
    plates = together(
        rectangle((-1, -1, 0), (2, 0, 0), (0, 2, 0)), rectangle((0, -1, -1), (0, 2, 0), (0, 0, 2))
    )
    c = even(own(*plates), 0.2)
    check_even(c, 0.2)
    assert area_of(c) == pytest.approx(8.0, rel=1e-3)
    assert seam_length(c, 4) == pytest.approx(2.0, rel=1e-3) and euler(c) == 1
    slanted = together(plates, rectangle((0.1, -0.7, -0.8), (0.1, 1.3, 0.2), (0.3, 0, 1.7)))
    c = even(own(*slanted), 0.2)
    check_even(c, 0.2)
    third = np.linalg.norm(np.cross([0.1, 1.3, 0.2], [0.3, 0, 1.7]))
    assert area_of(c) == pytest.approx(8.0 + third, rel=0.01)


def test_plate_on_a_plate():
    """A tee: the rim of one lies in the other without a common vertex."""
    tee = together(
        rectangle((-1, -1, 0), (2, 0, 0), (0, 2, 0)), rectangle((0.1, -1, 0), (0, 2, 0), (0, 0, 1))
    )
    c = even(own(*tee), 0.2)
    check_even(c, 0.2)
    assert area_of(c) == pytest.approx(6.0, rel=1e-3)
    assert seam_length(c, 3) == pytest.approx(2.0, rel=1e-3)
    assert seam_length(c, 1) == pytest.approx(8.0 + 4.0, rel=1e-3)


def test_plates_in_one_plane_count_once():
    both = together(
        rectangle((-1, -1, 0), (2, 0, 0), (0, 2, 0)),
        rectangle((-0.5, -0.5, 0), (2, 0, 0), (0, 1.2, 0)),
    )
    c = even(own(*both), 0.2)
    check_even(c, 0.2)
    assert area_of(c) == pytest.approx(4.0 + 2.4 - 1.8, rel=1e-3) and euler(c) == 1


def test_conforming_parts_keep_the_area():
    x, f = together(
        rectangle((-1, -1, 0), (2, 0, 0), (0, 2, 0)), rectangle((0, -1, -1), (0, 2, 0), (0, 0, 2))
    )
    vertices, triangles, parent = conform(x, f)
    assert np.array_equal(vertices[: len(x)], x)
    assert not len(self_intersections(vertices, triangles))
    mine = np.bincount(parent, areas(vertices[triangles]))
    assert mine == pytest.approx(areas(x[f]), rel=1e-12)


def disc(count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Unit disc of rings."""
    x, f = [np.zeros((1, 3))], []
    for ring in range(1, count + 1):
        angle = 2.0 * np.pi * np.arange(6 * ring) / (6 * ring)
        x.append(np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]) * ring / count)
    points = np.vstack(x)
    f = Delaunay(points[:, :2]).simplices
    return points, f.astype(np.int64)[areas(points[f]) > 1e-9]


def test_rim_of_a_disc():
    c = even(own(*disc()), 0.15)
    check_even(c, 0.15)
    assert area_of(c) == pytest.approx(np.pi, rel=0.01) and euler(c) == 1
    edges = Edges.of(c.triangles, len(c.vertices))
    rim = np.unique(edges.ends[edges.count == 1])
    assert np.hypot(*c.vertices[rim].T[:2]) == pytest.approx(1.0, abs=0.01)
    assert (edges.count <= 2).all()


def test_hole_stays_a_hole_and_a_small_one_closes():
    x, f = disc()
    radius = np.hypot(*x[f].mean(axis=1).T[:2])
    c = even(own(x, f[radius > 0.4]), 0.15)
    check_even(c, 0.15)
    assert euler(c) == 0 and area_of(c) == pytest.approx(np.pi * (1 - 0.4**2), rel=0.02)
    c = even(own(x, f[radius > 0.02]), 0.15)
    assert euler(c) == 1 and area_of(c) == pytest.approx(np.pi, rel=0.01)


def test_three_sheets_at_a_seam():
    parts = []
    for k in range(3):
        away = np.array([np.cos(2 * np.pi * k / 3), np.sin(2 * np.pi * k / 3), 0.0])
        parts.append(rectangle((0, 0, -1), away, (0, 0, 2)))
    c = even(own(*together(*parts)), 0.12)
    check_even(c, 0.12)
    assert seam_length(c, 3) == pytest.approx(2.0, rel=1e-3) and euler(c) == 1
    assert area_of(c) == pytest.approx(6.0, rel=1e-3)
    on_axis = np.hypot(*c.vertices.T[:2]) < 1e-3
    assert on_axis.sum() >= 2.0 / 0.24


def test_closed_surfaces_stay_closed():
    x, f = icosphere(4, 1.0)
    c = even(own(x, f), 0.12)
    check_even(c, 0.12)
    edges = Edges.of(c.triangles, len(c.vertices))
    assert euler(c) == 2 and (edges.count == 2).all()
    assert area_of(c) == pytest.approx(4 * np.pi, rel=0.01)
    # small beside its distance to the surface, and still round
    c = even(own(0.1 * x, f, radius=4.0), 1.0)
    assert euler(c) == 2 and area_of(c) == pytest.approx(0.04 * np.pi, rel=0.06)


def test_closed_box_keeps_its_edges():
    """Faces of 3x1x0.4 mm in one piece: edges and corners stay where they are."""
    low, high = np.array([0.5, 0.5, 0.3]), np.array([3.5, 1.5, 0.7])
    for size in (0.1, 0.2):
        c = even(own(*shell_of_a_box(low - 1.0, high - 1.0), radius=0.3), size)
        check_even(c, size)
        assert euler(c) == 2 and area_of(c) == pytest.approx(9.2, rel=2e-3)
        for corner in np.ndindex(2, 2, 2):
            x = np.where(corner, high, low) - 1.0
            assert np.linalg.norm(c.vertices - x, axis=1).min() < 1e-3
        assert not len(c.rest)


def test_lines_and_points():
    x = np.array([[-2.0, 0, 0], [2, 0, 0], [0, 3, 0]])
    c = even(own(x, [[0, 1, 1], [2, 2, 2]], radius=0.8), 0.2)
    assert not len(c.triangles) and len(c.vertices) == 0
    assert [0.0, 3.0, 0.0] in c.rest.tolist()
    line = c.rest[np.abs(c.rest[:, 1]) < 1e-12]
    places = np.sort(line[:, 0])
    assert places[0] == -2.0 and places[-1] == 2.0
    distance = 4.0 - np.linalg.norm(c.rest, axis=1)
    inner = np.abs(c.rest[:, 0]) < 1.9
    assert c.rest_radius[inner & (c.rest[:, 1] == 0.0)] == pytest.approx(
        distance[inner & (c.rest[:, 1] == 0.0)], rel=0.02
    )
    # balls of 0.3 of the distance to the surface overlap
    assert (np.diff(places) < 0.6 * 2.0).all() and np.diff(places).max() < 0.5 * distance.max()


def test_closest_points_against_sampling():
    rng = np.random.default_rng(2)
    corners, points = rng.normal(size=(200, 3, 3)), rng.normal(size=(200, 3))
    corners[::10, 2] = corners[::10, 1]
    share = rng.dirichlet(np.ones(3) * 0.5, size=3000)
    sampled = np.linalg.norm(
        np.einsum("sk,fki->fsi", share, corners) - points[:, None], axis=2
    ).min(axis=1)
    exact = np.linalg.norm(on_triangles(points, corners) - points, axis=1)
    assert (exact <= sampled + 1e-9).all() and (sampled < exact + 0.15).all()
