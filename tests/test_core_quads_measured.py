# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What ``./run.sh reproduce quads`` measures by, and what the surfaces of quads reach by it."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.catmull_clark import catmull_clark
from HybridVolume.core.check import check_surface, check_uncut
from HybridVolume.core.polygon_repair import bodies, mended
from HybridVolume.core.polygons import PolygonMesh, bilinear_faces
from HybridVolume.core.refinement import split_spans
from HybridVolume.core.surface import SplineFace
from HybridVolume.errors import HybridVolumeError
from HybridVolume.reproduce import quads_demands, quads_exactness, quads_limit, quads_smoothness
from HybridVolume.reproduce.quads_broken import MENDED, block, catalogue
from HybridVolume.reproduce.quads_inputs import joined_bilinear, obj_text, spindle, torus_cage
from HybridVolume.reproduce.quads_pieces import distances, pieces_of, shared_sides
from HybridVolume.sources.polygon_files import read_polygons

CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


def test_pieces_are_the_spline_on_both_sides_of_its_knots():
    random = np.random.default_rng(3)
    knots = (np.array([0, 0, 0, 0, 1, 1, 1, 3, 3, 3, 3.0]), np.array([0, 0, 0, 0, 1, 2, 2, 2, 2.0]))
    net = random.normal(size=(7, 5, 3))
    face = SplineFace("Face1", (3, 3), knots, net, np.ones((7, 5)))
    pieces = pieces_of([face])
    assert len(pieces.nets) == 4
    # the last piece: u from 1 to 3, v from 1 to 2
    u, v = np.array([0.0, 0.2, 1.0]), np.array([0.0, 0.7, 1.0])
    here, x_u, _ = pieces.at(np.full(3, 3), u, v)
    lines = BSpline(knots[0], net, 3)
    for k in range(3):
        across = BSpline(knots[1], lines(1.0 + 2.0 * u[k]), 3)
        assert here[k] == pytest.approx(across(1.0 + v[k]), abs=1e-13)
    # a triple knot is a kink: the slopes of both sides differ there
    _, before, _ = pieces.at(np.array([1]), np.ones(1), np.zeros(1))
    angle = np.dot(before[0], x_u[0]) / np.linalg.norm(before[0]) / np.linalg.norm(x_u[0])
    assert angle < 0.99


def test_sides_of_a_block_turn_by_a_right_angle_or_not_at_all():
    x, faces = block((3, 2, 4))
    sides = shared_sides(pieces_of(bilinear_faces(PolygonMesh.of(x, faces))))
    # 2 (3 2 + 2 4 + 4 3) = 52 quads have 104 sides, of which 4 (3 + 2 + 4) are on edges
    assert len(sides.angle) == 104
    assert sides.open == 0
    sharp = np.isclose(sides.angle, np.pi / 2.0, atol=1e-12).all(axis=1)
    assert np.count_nonzero(sharp) == 36
    assert np.abs(sides.angle[~sharp]).max() < 1e-12
    # the eight corners have three sides, all others four
    assert np.count_nonzero(sides.valence == 3) == 24
    assert set(np.unique(sides.valence)) == {3, 4}


def test_sides_that_meet_nothing_are_seen():
    x, faces = block()
    pieces = pieces_of(bilinear_faces(PolygonMesh.of(x, faces[1:])))
    assert shared_sides(pieces).open == 4


def test_distances_end_on_faces_edges_and_corners():
    x, faces = block()
    pieces = pieces_of(bilinear_faces(PolygonMesh.of(x, faces)))
    points = np.array([[7.0, 5.0, -3.0], [-3.0, -4.0, 5.0], [21.0, 18.0, 14.0], [4.0, 8.0, 6.0]])
    assert distances(pieces, points) == pytest.approx([3.0, 5.0, 3.0, 4.0], abs=1e-12)


def test_the_limit_of_a_cube_is_known():
    cage = quads_limit.cage_of(CUBE, SIDES)
    # (9 v + 4 sum of neighbours + sum of opposite corners) / 24 is half the corner
    assert cage.limit() == pytest.approx(0.5 * CUBE, abs=1e-15)
    deep = cage.refine().refine().refine()
    assert deep.limit()[:8] == pytest.approx(0.5 * CUBE, abs=1e-14)


def test_the_limit_of_a_sharp_ring_is_the_spline_of_its_polygon():
    ring = np.array([(4, 6), (6, 7), (7, 5), (5, 4)])
    cage = quads_limit.cage_of(CUBE, SIDES, ring, np.full(4, 10.0)).refine().refine()
    on_ring = cage.limit()[cage.edges[cage.sharpness > 0].ravel()]
    points = CUBE[[4, 6, 7, 5]]
    closed = BSpline(np.arange(11.0), points[np.arange(7) % 4], 3)
    curve = closed(np.linspace(3.0, 7.0, 17)[:-1])
    off = np.linalg.norm(on_ring[:, None] - curve, axis=2).min(axis=1)
    assert off.max() < 1e-14


def test_patches_come_to_the_limit():
    points = quads_limit.refined_cage(PolygonMesh.of(CUBE, SIDES), 4).limit()
    last = np.inf
    for steps in (1, 2, 3):
        made = catmull_clark(PolygonMesh.of(CUBE, SIDES), steps)
        off = distances(pieces_of(made.faces), points).max()
        assert off <= made.distance
        assert off < 0.25 * last
        last = off
    assert last < 5e-5 * np.sqrt(12.0)


def test_regular_quads_are_the_limit():
    mesh = PolygonMesh.of(*torus_cage(12, 8))
    points = quads_limit.refined_cage(mesh, 2).limit()
    off = distances(pieces_of(catmull_clark(mesh, 0).faces), points)
    assert off.max() < 1e-12 * mesh.diagonal


@pytest.mark.parametrize("valence", [3, 4, 5, 6, 7, 8, 9, 10, 11, 12])
def test_smooth_surfaces_have_one_normal_at_every_side(valence):
    found = quads_smoothness.make({"spindle": valence, "scheme": "smooth"})
    assert found["angle"] < 1e-6
    assert found["open_sides"] == 0
    assert found["valences"].get(str(valence), {"vertices": 0})["vertices"] >= 2
    if valence > 4:
        plain = quads_smoothness.make({"spindle": valence, "scheme": "catmull-clark"})
        assert plain["angle"] > 1e-2


@pytest.mark.shared
@pytest.mark.parametrize("name", ["rod.obj", "bitorus.off", "polycube.off", "fish.obj"])
def test_smooth_surfaces_of_files_have_one_normal(shared_data, name):
    (path,) = shared_data.rglob(name)
    found = quads_smoothness.make({"file": str(path), "scheme": "smooth"})
    assert found["angle"] < 1e-6
    assert found["open_sides"] == 0


@pytest.mark.parametrize("body", ["torus", "cylinder", "spindle", "quads"])
def test_refinement_never_moves_the_surface(body):
    found = quads_exactness.make({"body": body})
    for row in found["rows"]:
        assert row["deviation"] <= 1e-12 * found["diagonal"], row["refinement"]
    assert max(row["spans"] for row in found["rows"]) > found["spans"]


def test_a_moved_point_is_seen():
    surface = build_surface(bilinear_faces(PolygonMesh.of(*torus_cage(8, 5))))
    finer = split_spans(surface, 2)
    points = finer.control_points.copy()
    points[3] += (0.0, 1e-9, 0.0)
    moved = quads_exactness.deviation(surface, finer.with_points(points))
    assert moved == pytest.approx(1e-9, rel=1e-3)


def test_joined_patches_are_the_same_surface():
    mesh = PolygonMesh.of(*block((4, 3, 2)))
    many, few = build_surface(bilinear_faces(mesh)), build_surface(joined_bilinear(mesh))
    assert (len(many.patches), len(few.patches)) == (52, 6)
    assert len(few.control_points) == len(many.control_points) == len(mesh.vertices)
    assert few.element_count == many.element_count
    assert few.volume() == pytest.approx(40.0 * 24.0 * 12.0, rel=1e-14)


def test_spindles_have_the_valence():
    x, faces = spindle(7)
    mesh = mended(PolygonMesh.of(x, faces))
    assert not mesh.notes
    count = np.bincount(mesh.edges[0].ravel())
    assert sorted(count) == [3] * 14 + [7, 7]


@pytest.mark.parametrize("mesh", catalogue(), ids=lambda mesh: mesh.name)
def test_broken_meshes_are_mended_or_refused_by_their_elements(mesh, tmp_path):
    path = tmp_path / mesh.file
    path.write_bytes(mesh.content)
    cage = mesh.scheme == "catmull-clark"
    try:
        (body,) = bodies(mended(read_polygons(path), cage=cage), cage=cage)
        surface = build_surface(bilinear_faces(body))
        check_surface(surface)
        check_uncut(surface)
    except HybridVolumeError as error:
        assert mesh.expected != MENDED, error.line
        said = error.line
    else:
        assert mesh.expected == MENDED
        said = " ".join(body.notes)
        assert surface.volume() == pytest.approx(20.0 * 16.0 * 12.0, rel=1e-12)
    assert not mesh.named or any(word in said for word in mesh.named), said


def whole(**more):
    return {
        "name": "rod_bilinear", "case": "rod_bilinear", "error": None, "way": "whole",
        "elements": 8, "proved": 8, "embedded": True, "w0": 0.5, "fem_nodes": 90, "fem_order": 2,
        "fem_min_scaled_jacobian": 0.1, "seconds_cpu": 30.0, "patches": 9, "control_points": 10,
        **more,
    }  # fmt: skip


def test_demands_are_met_by_figures_only():
    empty = {name: [] for name in ("many_patches", "smoothness", "limit_distance", "exactness",
                                   "broken")}  # fmt: skip

    def met(**more):
        rows = quads_demands.demands({**empty, "cases": [whole(**more)]})
        return [row["met"] for row in rows]

    assert met() == [True]
    assert met(proved=7) == [False]
    assert met(embedded=False) == [False]
    assert met(fem_order=1) == [False]
    assert met(fem_min_scaled_jacobian=0.0) == [False]
    assert met(error={"code": "fault", "message": "no"}) == [False]
    for ratio, held in ((2.9, True), (3.1, False)):
        cases = [whole(case="ant-patches", seconds_cpu=30.0 * ratio), whole(case="torus")]
        (row,) = quads_demands.many_patches(cases)
        assert row["met"] is held
        assert f"{ratio:.2f} times" in row["figure"]
    broken = {"case": "open", "error": None, "expected": "refused", "named": ["edge 1-2"],
              "said": "edge 1-2 is open", "notes": [], "code": 2, "left": [],
              "traceback": False}  # fmt: skip
    for change, held in (({}, True), ({"said": "it is open"}, False), ({"code": 1}, False),
                         ({"left": ["a.vtu"]}, False), ({"traceback": True}, False)):  # fmt: skip
        rows = quads_demands.demands({**empty, "cases": [], "broken": [{**broken, **change}]})
        assert [row["met"] for row in rows] == [held]


def test_obj_text_is_read_back(tmp_path):
    x, faces = spindle(5)
    path = tmp_path / "spindle.obj"
    path.write_text(obj_text(x, faces))
    mesh = read_polygons(path)
    assert np.array_equal(mesh.vertices, x)
    assert mesh.quads.tolist() == faces
