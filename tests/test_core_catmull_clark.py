# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Catmull-Clark surfaces: exact where they are regular, near the limit surface elsewhere."""

import dataclasses

import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.catmull_clark import bezier_nets, catmull_clark
from HybridVolume.core.polygon_repair import mended
from HybridVolume.core.polygons import PolygonMesh
from HybridVolume.core.subdivision import limit_points, subdivide
from HybridVolume.sources.polygon_files import read_polygons

CUBE = np.array([[x, y, z] for z in (-1.0, 1.0) for y in (-1.0, 1.0) for x in (-1.0, 1.0)])
QUADS = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(CUBE[a] - CUBE[b]).sum() == 2]


def cube(sharpness=()):
    return PolygonMesh.of(CUBE, QUADS, [(a, b, s) for (a, b), s in zip(EDGES, sharpness)])  # noqa: B905


def torus(around=8, along=6):
    i, j = (a.ravel() for a in np.meshgrid(np.arange(around), np.arange(along), indexing="ij"))
    u, v = 2 * np.pi * i / around, 2 * np.pi * j / along
    r = 3.0 + np.cos(v)
    x = np.column_stack([r * np.cos(u), r * np.sin(u), np.sin(v)])
    corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
    quads = np.column_stack([(a % around) * along + b % along for a, b in corners])
    return mended(PolygonMesh.of(x, quads.tolist()))


def limit_volume(mesh, steps):
    deep = subdivide(mesh, steps)
    return dataclasses.replace(deep, vertices=limit_points(deep)).volume()


def test_subdivision_keeps_what_it_must():
    mesh = subdivide(cube(), 1)
    # a cube of edge 2: new points of faces, edges and vertices by hand
    assert np.allclose(np.abs(mesh.vertices[-6:]).max(axis=1), 1.0)
    assert np.allclose(np.sort(np.abs(mesh.vertices[8:20]), axis=1), [0.0, 0.75, 0.75])
    assert np.allclose(np.abs(mesh.vertices[:8]), 5.0 / 9.0)
    sharp = subdivide(cube([10.0] * 12), 3)
    assert sharp.volume() == pytest.approx(8.0, rel=1e-12)
    # half a step of sharpness lies between both rules
    between = subdivide(cube([0.5] * 12), 1)
    assert np.allclose(np.sort(np.abs(between.vertices[8:20]), axis=1), [0.0, 0.875, 0.875])
    assert np.allclose(np.abs(between.vertices[:8]), 0.5 * (1.0 + 5.0 / 9.0))


def test_limit_points_are_where_subdivision_leads_to():
    mesh = subdivide(cube([10.0, 10.0, 10.0]), 1)
    deep = subdivide(mesh, 7)
    off = np.linalg.norm(deep.vertices[: len(mesh.vertices)] - limit_points(mesh), axis=1)
    # three creases end at vertices 1, 2 and 4
    assert off[[1, 2, 4]].max() < 3e-4
    assert np.delete(off, [1, 2, 4]).max() < 2e-4
    assert np.linalg.norm(mesh.vertices - limit_points(mesh), axis=1).max() > 0.1


def test_regular_meshes_are_exact():
    mesh = torus()
    found = catmull_clark(mesh, 0)
    assert found.distance < 1e-14 * mesh.diagonal
    assert found.normal_jump < 1e-7
    # whole regular regions are one patch with simple knots
    spans = sum((len(f.knots[0]) - 7) * (len(f.knots[1]) - 7) for f in found.faces)
    assert spans == len(mesh)
    assert len(found.faces) < 10
    assert build_surface(list(found.faces)).genus == (1,)
    assert build_surface(list(catmull_clark(mesh, 1).faces)).volume() == pytest.approx(
        build_surface(list(found.faces)).volume(), rel=1e-12
    )


def test_patches_come_nearer_with_each_step():
    figures = [catmull_clark(cube(), steps) for steps in (1, 2, 3)]
    assert all(a.distance > 1.7 * b.distance for a, b in zip(figures, figures[1:], strict=False))
    assert all(
        a.normal_jump > 1.5 * b.normal_jump for a, b in zip(figures, figures[1:], strict=False)
    )
    volumes = [build_surface(list(f.faces)).volume() for f in figures]
    assert volumes[2] == pytest.approx(limit_volume(cube(), 6), rel=1e-3)
    assert all(len(f.faces) == 6 for f in figures)


def test_sharp_edges_stay_sharp():
    every = catmull_clark(cube([10.0] * 12), 1)
    assert build_surface(list(every.faces)).volume() == pytest.approx(8.0, rel=1e-12)
    assert every.distance < 1e-14
    # one crease that ends at both sides of a cube's edge: patches are near all along it
    dart = catmull_clark(cube([10.0]), 1)
    assert dart.distance < 1.5e-3 * cube().diagonal
    # a lid: four sharp edges around one face; its rim is a plane cubic curve
    lid = [10.0 if CUBE[a][2] == CUBE[b][2] == 1.0 else 0.0 for a, b in EDGES]
    found = catmull_clark(cube(lid), 1)
    surface = build_surface(list(found.faces))
    assert surface.volume() == pytest.approx(limit_volume(cube(lid), 6), rel=5e-3)
    points = np.concatenate([face.control_points.reshape(-1, 3) for face in found.faces])
    assert np.count_nonzero(np.abs(points[:, 2] - 1.0) < 1e-12) > 20


def test_neighbours_meet_bit_for_bit():
    nets, _ = bezier_nets(subdivide(cube([2.5, 0.0, 10.0, 10.0, 0.3]), 1))
    sides = np.concatenate([nets[:, :, 0], nets[:, -1], nets[:, ::-1, -1], nets[:, 0, ::-1]])
    found = {side.tobytes() for side in np.ascontiguousarray(sides)}
    assert all(np.ascontiguousarray(side[::-1]).tobytes() in found for side in sides)


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "genus", "rel"),
    [("fish", 0, 1e-3), ("osd_toroidal_tet", 3, 1.5e-2), ("osd_torus_creases0", 1, 3e-3)],
)
def test_real_cages(shared_data, name, genus, rel):
    mesh = mended(read_polygons(shared_data / f"cages/{name}.obj"), cage=True)
    surface = build_surface(list(catmull_clark(mesh, 1).faces))
    assert surface.genus == (genus,)
    assert surface.volume() == pytest.approx(limit_volume(mesh, 4), rel=rel)
