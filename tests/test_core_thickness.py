# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Isosurfaces and shell thickness against fields whose levels are known in closed form."""

from collections import Counter

import numpy as np
import pytest
from bodies import box, cylinder, hollow_sphere, sphere, torus
from scipy.spatial import Delaunay

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.front import column_frame
from HybridVolume.core.goals import Thickness, local_radius, usable_level
from HybridVolume.core.harmonic import HarmonicField, solve_on
from HybridVolume.core.harmonic_domain import Domain
from HybridVolume.core.isosurface import isosurface
from HybridVolume.core.reached import expected_figures, isosurface_figures
from HybridVolume.core.tetmesh.mesh import TetMesh, tet_volumes
from HybridVolume.core.thickness import distance_to_triangles, shell_thickness, surface_places
from HybridVolume.errors import FaultError


def delaunay(points, keep=lambda centre: np.ones(len(centre), dtype=bool)):
    """Tetrahedra of points whose centre is to be kept."""
    tets = Delaunay(points).simplices
    volumes = tet_volumes(points, tets)
    tets = np.where((volumes > 0)[:, None], tets, tets[:, [0, 2, 1, 3]])
    tets = tets[np.abs(volumes) > 1e-9 * np.abs(volumes).max()]
    return TetMesh(points, tets[keep(points[tets].mean(axis=1))])


def given(mesh, w):
    return HarmonicField(mesh, w, np.zeros((len(w), 3)), w >= 1.0, True)


def directions(count):
    """Points spread over the unit sphere (Fibonacci)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + 5.0**0.5) * k
    across = np.sqrt(1.0 - z**2)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])


def ball_mesh(radii, count=500):
    """Tetrahedra between concentric spheres of points; the smallest one is filled."""
    rays = directions(count)
    rng = np.random.default_rng(0)
    points = np.concatenate([r * rays for r in radii] + [np.zeros((1, 3))])
    return delaunay(points + rng.normal(0.0, 1e-6, points.shape))


@pytest.fixture(scope="module")
def ball_field():
    """Between the unit sphere and a concentric one of radius .5, solved."""
    mesh = ball_mesh(np.linspace(1.0, 0.5, 12))
    inner = np.linalg.norm(mesh.vertices, axis=1) < 0.5001
    return solve_on(Domain(mesh, inner, True))


@pytest.mark.parametrize("w0", [0.2, 0.5, 0.8])
def test_concentric_spheres(ball_field, w0):
    # w = (1/r - 1) / (1/.5 - 1) between the spheres
    exact = 1.0 - 1.0 / (1.0 + w0)
    found = shell_thickness(ball_field, build_surface(sphere().faces), w0)
    # the triangles of the sphere bulge inward by .003
    assert found["mean"] == pytest.approx(exact, abs=0.004)
    assert found["min"] == pytest.approx(exact, rel=0.04)
    assert found["max"] == pytest.approx(exact, rel=0.04)
    assert found["min"] <= found["mean"] <= found["max"]
    assert [face["face"] for face in found["faces"]] == [f"Face{k}" for k in range(1, 7)]
    for face in found["faces"]:
        assert face["mean"] == pytest.approx(exact, abs=0.004)
    assert found["w0"] == w0
    assert found["largest_w0"] == pytest.approx(0.99)


def test_cylinder_around_its_axis():
    # w = ln(1/r) / ln(1/.3): the level .5 lies at r = sqrt(.3), away from the caps
    height, rows = 6.0, np.linspace(0.0, 6.0, 31)
    radii = np.concatenate([[0.0], np.linspace(0.3, 1.0, 11)])
    angle = np.arange(40) * 2 * np.pi / 40
    r, z = (x.ravel() for x in np.meshgrid(radii, rows))
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(40)])
    points = r[:, None, None] * ring + np.array([0.0, 0.0, 1.0]) * z[:, None, None]
    points = np.unique(points.reshape(-1, 3).round(9), axis=0)
    mesh = delaunay(points + np.random.default_rng(0).normal(0.0, 1e-7, points.shape))
    across = np.linalg.norm(points[:, :2], axis=1)
    w = np.log(1.0 / np.clip(across, 0.3, 1.0)) / np.log(1.0 / 0.3)
    # flat caps, so that the isosurface is closed
    w *= np.clip(np.minimum(points[:, 2], height - points[:, 2]) / 0.9, 0.0, 1.0)
    body = cylinder(1.0, height)
    found = shell_thickness(given(mesh, w), build_surface(body.faces), 0.5)
    sides = [found["faces"][k] for k in range(len(body.faces))
             if np.ptp(np.linalg.norm(body.faces[k].control_points[:, [0, -1], :2], axis=-1)) < .5
             and np.ptp(body.faces[k].control_points[..., 2]) > 1.0]  # fmt: skip
    assert len(sides) == 4
    for face in sides:
        assert face["min"] == pytest.approx(1.0 - np.sqrt(0.3), rel=0.01)


def test_box_with_an_offset_box_inside():
    # the level set of the distance to the surface: t from the faces, √2 t from the edges, √3 t
    # from the corners; per face the mean follows by quadrature of an independent formula
    lines = [np.linspace(0.0, n, 10 * n + 1) for n in (3, 2, 1)]
    x = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    depth = np.minimum(x, np.array([3.0, 2.0, 1.0]) - x).min(axis=1)
    mesh = delaunay(x + np.random.default_rng(0).normal(0.0, 1e-7, x.shape))
    found = shell_thickness(given(mesh, 2.0 * depth), build_surface(box().faces), 0.399)
    t = 0.1995  # just below a layer of vertices, so that the isosurface has its corner at one
    assert found["min"] == pytest.approx(t, rel=1e-4)
    assert found["max"] == pytest.approx(np.sqrt(3.0) * t, rel=0.01)
    u, v = (np.linspace(0.0, n, 1001) for n in (3.0, 2.0))
    off = [np.maximum(t - np.minimum(a, a[-1] - a), 0.0) for a in (u, v)]
    exact = np.sqrt(t**2 + off[0][:, None] ** 2 + off[1] ** 2).mean()
    top = max(found["faces"], key=lambda face: int(face["face"][4:]))
    assert top["mean"] == pytest.approx(exact, rel=0.01)


def test_no_level_like_the_body(ball_field):
    with pytest.raises(FaultError, match="genus"):
        shell_thickness(ball_field, build_surface(torus().faces), 0.5)


def test_figures_are_those_of_the_largest_level_where_the_asked_one_falls_apart():
    field = two_maxima(0.5)
    found = shell_thickness(field, build_surface(box().faces), 0.8)
    assert found["largest_w0"] == pytest.approx(0.5, abs=0.01)
    assert found["w0"] == pytest.approx(found["largest_w0"], abs=1e-9)
    assert shell_thickness(field, build_surface(box().faces), 0.3)["w0"] == 0.3


def two_maxima(neck):
    """A field on the box with one part below the level of its neck and two above."""
    lines = [np.linspace(0.0, n, m) for n, m in ((3.0, 25), (2.0, 9), (1.0, 9))]
    x = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    mesh = delaunay(x + np.random.default_rng(0).normal(0.0, 1e-7, x.shape))
    depth = np.minimum(x, np.array([3.0, 2.0, 1.0]) - x).min(axis=1)
    w = np.minimum(4.0 * depth, np.clip(np.abs(x[:, 0] - 1.5) * 0.8 + neck, 0.0, 1.0))
    return given(mesh, w)


def test_the_largest_level_with_the_body_s_genus_is_used_and_said():
    field, body = two_maxima(0.5), build_surface(box().faces)
    assert field.isosurface_genus(0.8) == (0, 0)
    assert usable_level(field, body.genus, 0.4) == (0.4, 0.4, "")
    largest, used, note = usable_level(field, body.genus, 0.8)
    assert used == largest == pytest.approx(0.5, abs=0.01)
    assert "w0 = 0.8 has another genus than the body" in note
    assert isosurface_figures(field, body, 0.8) == {
        "asked": 0.8, "genus": [0, 0], "body": [0], "largest_w0": largest, "w0_used": largest,
    }  # fmt: skip
    # torn by its neck nearly everywhere: columns cross it, and the level asked is kept
    largest, used, note = usable_level(two_maxima(0.01), body.genus, 0.8)
    assert largest < 0.02 and used == 0.8 and "no isosurface has the body's genus" in note


@pytest.mark.parametrize(
    ("text", "factor", "length"),
    [
        ("0.3 mm", 1.0, 0.3),
        ("0.2 mm", 1.5, 0.3),
        ("mean 0.25 mm", 1.0, 0.25),
        ("min 0.2 mm", 1.0, 0.2),
        # the local radius of a ball is its radius
        ("40 %", 1.0, 0.4),
    ],
)
def test_thickness_of_every_kind_is_told_from_the_field(ball_field, text, factor, length):
    body = build_surface(sphere(spans=2).faces)
    factors = {f"Face{k}": factor for k in range(1, 7)} if factor != 1.0 else {}
    found = expected_figures(ball_field, body, Thickness.parse(text, factors))
    least = "min" if text.startswith("min") else "mean"
    assert found[least] == pytest.approx(length, rel=0.03)
    assert found["max"] < 1.12 * length and len(found["faces"]) == 6
    # w = (1/r - 1) / (1/.5 - 1)
    assert found["w0"] == pytest.approx(1.0 / (1.0 - length) - 1.0, rel=0.08)
    assert found["estimate"] and found["notes"] == [] and found["asked"]["text"] == text
    assert found["isosurface"]["genus"] == [0]


def test_more_than_the_body_has_is_told(ball_field):
    # w is 1 from half the radius on
    body = build_surface(sphere(spans=2).faces)
    found = expected_figures(ball_field, body, Thickness.parse("0.7 mm"))
    assert found["max"] < 0.52 and "the midstructure is nearer than 0.7 mm" in found["notes"][0]
    found = expected_figures(ball_field, body, Thickness.parse("mean 0.7 mm"))
    assert found["max"] < 0.52 and "the body is too thin for mean 0.7 mm" in found["notes"][0]


def test_half_the_thickness_of_bodies():
    for body, half in ((box(), 0.5), (torus(), 1.0), (cylinder(1.0, 6.0, 2), 1.0)):
        surface = build_surface(body.faces)
        frame = column_frame(surface)
        assert np.average(local_radius(surface, frame), weights=frame.area) == pytest.approx(
            half, rel=0.05
        )


def test_isosurface_is_closed_and_points_outward():
    mesh = ball_mesh([1.0, 0.8, 0.6, 0.4, 0.2], 300)
    vertices, triangles = isosurface(mesh, -np.linalg.norm(mesh.vertices, axis=1), -0.7)
    edges = Counter(map(tuple, triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).tolist()))
    assert all(edges[b, a] == 1 for a, b in edges)
    assert len(vertices) - len(edges) // 2 + len(triangles) == 2
    x = vertices[triangles]
    volume = np.einsum("mi,mi->m", x[:, 0], np.cross(x[:, 1], x[:, 2])).sum() / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 0.7**3, rel=0.04)
    assert not len(isosurface(mesh, np.zeros(len(mesh.vertices)), 0.5)[0])


def test_distance_to_triangles():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    triangles = np.array([[0, 1, 2], [1, 3, 2], [0, 0, 1]])
    points = np.array([[0.3, 0.3, 2], [-3, -4, 0], [0.9, 0.9, -1], [2, 0.5, 0], [0.5, -1, 0]])
    expected = [2.0, 5.0, 1.0, 1.0, 1.0]
    np.testing.assert_allclose(distance_to_triangles(points, corners, triangles), expected)


def test_surface_places():
    body = build_surface(hollow_sphere().faces)
    points, area, patch = surface_places(body, 5000)
    assert area.sum() == pytest.approx(4.0 * np.pi * (4.0 + 1.0), rel=1e-6)
    radius = np.linalg.norm(points, axis=1)
    np.testing.assert_allclose(radius, np.where(patch < 6, 1.0, 2.0), rtol=1e-12)
    cube = build_surface(box((1.0, 1.0, 1.0), (1, 1, 1), 1).faces)
    corners = np.unique(surface_places(cube, 10)[0].round(12), axis=0)
    assert {(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)} <= set(map(tuple, corners))
