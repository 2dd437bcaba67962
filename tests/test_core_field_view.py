# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The inner boundary that is seen before the run, against balls whose levels are known."""

import numpy as np
import pytest
from bodies import sphere
from scipy.spatial import Delaunay

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.field_view import FieldView
from HybridVolume.core.goals import Thickness
from HybridVolume.core.harmonic import HarmonicField
from HybridVolume.core.tetmesh.mesh import TetMesh, tet_volumes
from HybridVolume.errors import FileFormatError

KERNEL = 0.4
"""Radius of the ball in the middle of the unit ball on which w is 1."""


def delaunay(points):
    tets = Delaunay(points).simplices
    volumes = tet_volumes(points, tets)
    tets = np.where((volumes > 0)[:, None], tets, tets[:, [0, 2, 1, 3]])
    return TetMesh(points, tets[np.abs(volumes) > 1e-9 * np.abs(volumes).max()])


@pytest.fixture(scope="module")
def ball():
    """The unit ball with w = 1 on a ball in its middle: w = (1/r - 1) / (1/KERNEL - 1)."""
    k = np.arange(400) + 0.5
    z = 1.0 - 2.0 * k / 400
    turn, across = np.pi * (1.0 + 5.0**0.5) * k, np.sqrt(1.0 - z**2)
    rays = np.column_stack([across * np.cos(turn), across * np.sin(turn), z])
    radii = [*np.linspace(1.0, KERNEL, 13), 0.2, 0.1]
    points = np.concatenate([r * rays for r in radii] + [np.zeros((1, 3))])
    # the rim of the hull stays exact, so that all of it is boundary
    points[400:] += np.random.default_rng(0).normal(0.0, 1e-6, points[400:].shape)
    mesh = delaunay(points)
    r = np.linalg.norm(mesh.vertices, axis=1)
    w = (1.0 / np.maximum(r, KERNEL) - 1.0) / (1.0 / KERNEL - 1.0)
    field = HarmonicField(mesh, w, np.zeros((len(w), 3)), r < KERNEL + 1e-4, True)
    return FieldView.of(field, build_surface(list(sphere(1.0).faces)))


def radius_of(level):
    return 1.0 / (1.0 + level * (1.0 / KERNEL - 1.0))


def test_distances_and_radius_of_a_ball(ball):
    r = np.linalg.norm(ball.vertices, axis=1)
    assert np.abs(ball.distance - (1.0 - r)).max() < 1e-5
    assert ball.radius == pytest.approx(1.0, rel=0.01)
    assert ball.area.sum() == pytest.approx(4.0 * np.pi, rel=1e-3)
    assert ball.genus.tolist() == [0] and ball.largest_w0 == pytest.approx(0.99)


@pytest.mark.parametrize("level", [0.1, 0.5, 0.9])
def test_levels_of_a_ball(ball, level):
    inner = ball.inner(Thickness("w0", level))
    r = np.linalg.norm(inner.vertices, axis=1)
    assert r == pytest.approx(radius_of(level), abs=0.02)
    assert ball.figures(inner) == pytest.approx([1.0 - radius_of(level)] * 3, abs=0.02)
    corner = inner.vertices[inner.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    volume = np.einsum("ki,ki->", corner[:, 0], normal) / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * radius_of(level) ** 3, rel=0.05)
    assert ball.genus_at(Thickness("w0", level)) == (0,)


@pytest.mark.parametrize("kind", ["even", "mean", "min", "share"])
def test_lengths_and_shares_of_a_ball(ball, kind):
    # the local radius of the unit ball is 1, so that a share is a length as well
    inner = ball.inner(Thickness(kind, 0.3))
    assert ball.figures(inner) == pytest.approx([0.3] * 3, abs=0.02)
    level = ball.level(Thickness(kind, 0.3))
    if kind in ("mean", "min"):
        assert level == pytest.approx((1.0 / 0.7 - 1.0) / (1.0 / KERNEL - 1.0), abs=0.03)
    else:
        assert level is None


def test_a_body_too_thin(ball):
    # the field ends at w = .95
    thickness = Thickness("even", 0.8)
    inner = ball.inner(thickness)
    assert ball.figures(inner)[2] == pytest.approx(1.0 - radius_of(0.95), abs=0.02)
    share, faces = ball.short(thickness, inner)
    assert share == pytest.approx(1.0) and faces == ball.faces.tolist()
    assert ball.short(Thickness("even", 0.3), ball.inner(Thickness("even", 0.3))) == (0.0, [])
    assert ball.level(Thickness("mean", 5.0)) == pytest.approx(0.95)


@pytest.mark.parametrize("kind", ["w0", "even"])
def test_a_face_with_a_factor(ball, kind):
    face = ball.faces[0]
    thickness = Thickness(kind, 0.2, {face: 2.0})
    inner = ball.inner(thickness)
    middle = ball.places[ball.place_face == 0].mean(axis=0)
    middle /= np.linalg.norm(middle)
    along = inner.vertices @ middle / np.linalg.norm(inner.vertices, axis=1)
    there, away = inner.distance[along > 0.98].mean(), inner.distance[along < -0.98].mean()
    plain, double = (1.0 - radius_of(0.2), 1.0 - radius_of(0.4)) if kind == "w0" else (0.2, 0.4)
    assert there == pytest.approx(double, rel=0.05) and away == pytest.approx(plain, rel=0.05)


def test_stored_and_read_again(ball, tmp_path):
    path = tmp_path / "field.npz"
    ball.save(path)
    again = FieldView.load(path)
    for name, value in vars(ball).items():
        if not name.startswith("_") and name in FieldView.__dataclass_fields__:
            assert np.array_equal(getattr(again, name), value), name
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(FileFormatError, match=r"field\.npz"):
        FieldView.load(path)
    with pytest.raises(FileFormatError, match="holds no field"):
        FieldView.load(tmp_path / "absent.npz")


def test_where_the_inner_boundary_falls_apart():
    # two hills of height .9 and 1 with a saddle of .6 between them
    line = np.linspace(-1.0, 1.0, 21)
    points = np.stack(np.meshgrid(2.0 * line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    mesh = delaunay(points + np.random.default_rng(1).normal(0.0, 1e-7, points.shape))
    x, y, z = mesh.vertices.T
    along = 0.6 + 0.3 * np.sin(np.pi * np.abs(x)) + 0.05 * np.sign(x) * np.sin(np.pi * np.abs(x))
    rim = np.minimum(1.0, 2.0 * (2.0 - np.abs(x)))
    w = along * rim * (1.0 - y**2) * (1.0 - z**2)
    n = len(w)
    view = FieldView(
        vertices=mesh.vertices, tets=mesh.tets, w=w, distance=np.zeros(n), radius=np.ones(n),
        face=np.zeros(n, dtype=int), faces=np.array(["Face1"]), places=np.zeros((1, 3)),
        area=np.ones(1), place_face=np.zeros(1, dtype=int), curve=np.zeros((1, 4)),
        genus=np.array([0]), largest_w0=0.58,
    )  # fmt: skip
    assert view.same_genus(view.genus_at(Thickness("w0", 0.5)))
    assert view.genus_at(Thickness("w0", 0.75)) == (0, 0)
    assert not view.same_genus((0, 0)) and not view.same_genus((1,))
    assert view.stops_at(0.75) == 0.58 and view.stops_at(0.5) == 0.5
