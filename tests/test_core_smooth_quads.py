# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Smooth bicubic surfaces from quad meshes: one normal at every point of every side."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.polygon_repair import mended
from HybridVolume.core.polygons import PolygonMesh
from HybridVolume.core.smooth_quads import smooth_quads
from HybridVolume.sources.polygon_files import read_polygons


def prism(n, seed=0):
    """A prism over a polygon, a little uneven; one subdivision gives vertices with n sides."""
    angle = 2.0 * np.pi * np.arange(n) / n
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    x = np.concatenate([np.column_stack([ring * r, np.full(n, z)]) for r, z in ((1, 0), (0.8, 1))])
    x += 0.05 * np.random.default_rng(seed).standard_normal(x.shape)
    sides = [[k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n)]
    return mended(PolygonMesh.of(x, [list(range(n))[::-1], list(range(n, 2 * n)), *sides]))


def largest_jump(surface):
    """Angle of the normals where points of sides, 50 a side, coincide with others', rad."""
    points, normals = [], []
    line = np.linspace(0.0, 1.0, 50)
    for k, patch in enumerate(surface.patches):
        (u0, u1), (v0, v1) = ((knots[0], knots[-1]) for knots in patch.knots)
        u, v = u0 + (u1 - u0) * line, v0 + (v1 - v0) * line
        one = np.ones(50)
        at = [(u, v0 * one), (u, v1 * one), (u0 * one, v), (u1 * one, v)]
        u, v = (np.concatenate([pair[axis] for pair in at]) for axis in (0, 1))
        x, du, dv = surface.evaluate_at(np.full(200, k), u, v, 1)
        points.append(x)
        normals.append(np.cross(du, dv))
    points, normals = np.concatenate(points), np.concatenate(normals)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    pairs = cKDTree(points).query_pairs(1e-9 * surface.diagonal, output_type="ndarray")
    assert len(pairs) > 90 * len(surface.patches)
    a, b = normals[pairs[:, 0]], normals[pairs[:, 1]]
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)).max()


@pytest.mark.parametrize("n", [3, 4, 5, 6, 7, 8, 11])
def test_one_normal_at_sides_for_every_valence(n):
    mesh = prism(n)
    found = smooth_quads(mesh, 1)
    surface = build_surface(list(found.faces))
    assert surface.genus == (0,)
    assert largest_jump(surface) < 1e-9
    assert found.normal_jump < 1e-9
    assert found.moved < 0.01 * mesh.diagonal


def test_irregular_vertices_side_by_side():
    # all eight vertices of a cube have three sides, and no quad is between them
    x = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    found = smooth_quads(mended(PolygonMesh.of(x, quads)))
    assert (found.quads, found.split) == (6, 6)
    assert largest_jump(build_surface(list(found.faces))) < 1e-9


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "steps", "genus"),
    [("quads/bitorus.off", 0, 2), ("quads/polycube.off", 0, 0), ("quads/rod.obj", 0, 2),
     ("cages/osd_toroidal_tet.obj", 1, 3)],
)  # fmt: skip
def test_real_meshes(shared_data, name, steps, genus):
    mesh = mended(read_polygons(shared_data / name), cage=True)
    surface = build_surface(list(smooth_quads(mesh, steps).faces))
    assert surface.genus == (genus,)
    assert largest_jump(surface) < 1e-6
    assert surface.volume() == pytest.approx(mesh.volume(), rel=0.4)
