# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Meshes as other programs write them, and subdivision beside rules written out anew."""

import struct

import numpy as np
import pytest
from scipy.spatial import cKDTree

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.catmull_clark import catmull_clark
from HybridVolume.core.polygon_repair import bodies, mended
from HybridVolume.core.polygons import PolygonMesh, bilinear_faces
from HybridVolume.core.quad_folds import check_quads
from HybridVolume.core.smooth_quads import smooth_quads
from HybridVolume.core.subdivision import limit_points, subdivide
from HybridVolume.errors import InputError, SelfIntersectionError, SingularSurfaceError
from HybridVolume.sources.polygon_files import read_polygons

CUBE = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
QUADS = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
LINES = "".join("v {} {} {}\n".format(*x) for x in CUBE)
FACES = "".join("f {} {} {} {}\n".format(*(v + 1 for v in f)) for f in QUADS)
PLY = (
    "ply\nformat {} 1.0\ncomment its end_header is below\nelement vertex 8\nproperty double x\n"
    "property double y\nproperty double z\nelement nothing 9999999999\nelement face 6\n"
    "property list int ushort vertex_index\nend_header{}\n"
)


def read(tmp_path, content, suffix=".obj"):
    path = tmp_path / f"mesh{suffix}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_polygons(path)


def cuboid(size=1.0, shift=0.0):
    return CUBE * size + shift, [list(face) for face in QUADS]


def several(*parts):
    points, rows, count = [], [], 0
    for vertices, faces in parts:
        points.append(vertices)
        rows += [[v + count for v in face] for face in faces]
        count += len(vertices)
    return np.concatenate(points), rows


def plate(holes):
    """Unit cubes in three rows with holes in the middle one: a body of that genus."""
    cells = {(x, y) for x in range(2 * holes + 1) for y in range(3)}
    cells -= {(x, 1) for x in range(1, 2 * holes, 2)}
    places, faces = {}, []
    steps = ((0, 0, -1), (0, 0, 1), (0, -1, 0), (0, 1, 0), (-1, 0, 0), (1, 0, 0))
    for x, y in sorted(cells):
        for face, (i, j, k) in zip(QUADS, steps, strict=True):
            if k or (x + i, y + j) not in cells:
                corners = [tuple((CUBE[v] + (x, y, 0)).tolist()) for v in face]
                faces.append([places.setdefault(corner, len(places)) for corner in corners])
    return np.array(list(places)), faces


def test_files_of_other_programs(tmp_path):
    swapped = struct.pack(">24d", *CUBE.ravel())
    swapped += b"".join(struct.pack(">i4H", 4, *face) for face in QUADS)
    blender = (
        "# Blender 4.1\r\nmtllib part.mtl\r\no Part.001\r\n" + LINES + "vn 0 0 1\r\nvt 0 0\r\n"
        "s 0\r\ng one two\r\nusemtl Steel#2\r\n"
        + "".join("f {}/1/1 {}//1 {}/1 {}\n".format(*(v - 8 for v in f)) for f in QUADS)
        + "l 1 2\np 3\n"
    )
    rows = "".join("{} {} {} 1 0 0 .5 .5\n".format(*x) for x in CUBE)
    rows += "".join("4 {} {} {} {} 255 0 0\n".format(*f) for f in QUADS)
    for content, suffix in (
        (b"\xef\xbb\xbf" + (LINES + FACES).encode(), ".obj"),
        ((LINES + FACES).encode("utf-16"), ".obj"),
        (FACES + LINES.replace("\n", "\r"), ".obj"),
        (blender, ".obj"),
        ("# made by hand\nSTNOFF # header\n8 6\n" + rows, ".off"),
        (PLY.format("binary_big_endian", " ").encode() + swapped, ".ply"),
        (PLY.format("binary_big_endian", "").replace("\n", "\r\n").encode() + swapped, ".ply"),
    ):
        mesh = mended(read(tmp_path, content, suffix))
        assert mesh.volume() == pytest.approx(1.0, rel=1e-12)
        assert mesh.notes == ()


@pytest.mark.parametrize(
    ("content", "suffix", "words"),
    [
        (LINES + "f 1 2 99999999999999999999\n", ".obj", "line 9 has '1 2 9999"),
        (LINES.replace("1.0", "1_0") + FACES, ".obj", "line 2 has '1_0 0.0 0.0'"),
        (LINES + FACES + "t crease 2/1/0 0 1 nan\n", ".obj", "sharpness that is no number"),
        (LINES + FACES + "t crease 2/1/0 0 99 2\n", ".obj", "vertex 99, counted from 0, of 8"),
        (LINES + FACES + "t crease -2/1/0 0 1 2\n", ".obj", "line 15 has no readable crease"),
        ("nOFF\n3\n8 6 0\n", ".off", "a header nOFF"),
        (PLY.format("ascii", "") + "0 " * 24 + "3 0 1 nan " * 6, ".ply", "face 0 has vertices"),
        (PLY.format("ascii", "") + "0 " * 24 + "-3 0 1 2", ".ply", "face 0 is not readable"),
        (PLY.format("ascii", "").replace("property double x", "property"), ".ply", "line 5"),
        (PLY.format("ascii", "").replace("double y", "double x"), ".ply", "line 6 has a second x"),
    ],
)  # fmt: skip
def test_damage_is_told_with_its_line(tmp_path, content, suffix, words):
    with pytest.raises(InputError, match=words):
        read(tmp_path, content, suffix)


def test_vertices_that_rounding_parted_and_parts_there_twice():
    rng = np.random.default_rng(0)
    split = CUBE[np.array(QUADS)].reshape(-1, 3) + 1e-9 * rng.standard_normal((24, 3))
    mesh = mended(PolygonMesh.of(split + [1e3, 0.0, 0.0], np.arange(24).reshape(6, 4).tolist()))
    assert (len(mesh.vertices), mesh.volume()) == (8, pytest.approx(1.0, rel=1e-6))
    assert mesh.notes == ("16 vertices that lay beside others joined with them",)
    (body,) = bodies(mended(PolygonMesh.of(*several(cuboid(), cuboid()))))
    assert (len(body), body.volume()) == (6, pytest.approx(1.0))
    assert body.notes == ("the 6 faces around face 7: there twice, left out once",)


def test_cavities_are_told_and_cages_must_not_cut_each_other():
    vertices, faces = several(cuboid(9.0), cuboid(5.0, 2.0))
    (body,) = bodies(mended(PolygonMesh.of(vertices, faces)))
    assert body.notes == ("the 6 faces around face 7: a cavity, turned",)
    # the boxes of these cages meet, their limit surfaces do not
    apart = PolygonMesh.of(*several(cuboid(2.0), cuboid(2.0, 1.8)))
    assert len(bodies(mended(apart, cage=True), cage=True)) == 2
    cutting = PolygonMesh.of(*several(cuboid(2.0), cuboid(2.0, 0.9)))
    with pytest.raises(SelfIntersectionError, match=r"faces 2, 4, .* each other or touch \(near"):
        bodies(mended(cutting, cage=True), cage=True)


@pytest.mark.parametrize("size", [1e-7, 1e10, 0.0])
def test_a_size_that_cannot_be_meant_is_refused(size):
    with pytest.raises(InputError, match="mm wide"):
        mended(PolygonMesh.of(CUBE * size, QUADS), cage=True)


def test_twisted_quads_are_no_crossed_quads():
    # a prism whose upper face is turned by a quarter: seen along their normals its sides cross
    turned = CUBE[[0, 1, 2, 3, 5, 7, 4, 6]]
    mesh = mended(PolygonMesh.of(turned, QUADS))
    assert mesh.notes == ()
    patches = bilinear_faces(bodies(mesh)[0])
    nets = np.stack([patch.control_points for patch in patches])
    check_quads(build_surface(patches), nets, mesh.face_number)
    # its section at the height t is a square of the area 1 - 2 t + 2 t^2
    assert build_surface(patches).volume() == pytest.approx(2.0 / 3.0, rel=1e-12)


def test_sides_without_length_and_folds_are_refused_by_quads():
    flat = CUBE.copy()
    flat[6] = flat[7]
    with pytest.raises(InputError, match="faces 2 and 4 have a side without length"):
        mended(PolygonMesh.of(flat, QUADS))
    # a corner of the upper face is drawn in until that face is not convex
    drawn = CUBE.copy()
    drawn[7] = [0.4, 0.4, 1.0]
    mesh = mended(PolygonMesh.of(drawn, QUADS, first=0))
    patches = bilinear_faces(mesh)
    nets = np.stack([patch.control_points for patch in patches])
    with pytest.raises(SingularSurfaceError, match=r"faces 1.* of the mesh: the normal turns over"):
        check_quads(build_surface(patches), nets, mesh.face_number)
    # half-way, a straight corner, is not refused
    drawn[7] = [0.5, 0.5, 1.0]
    mesh = mended(PolygonMesh.of(drawn, QUADS))
    patches = bilinear_faces(mesh)
    nets = np.stack([patch.control_points for patch in patches])
    check_quads(build_surface(patches), nets, mesh.face_number)


def written_out(points, faces, creases, corners):
    """One step of Catmull and Clark's rules with tags, face by face."""
    middles = [np.mean([points[v] for v in face], axis=0) for face in faces]
    beside, around = {}, {}
    for number, face in enumerate(faces):
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            beside.setdefault(frozenset((a, b)), []).append(number)
            around.setdefault(a, []).append(number)

    def rule(v, tags, sharp):
        ends = [e for e in beside if v in e]
        tips = [points[next(iter(e - {v}))] for e in ends if tags.get(e, 0.0) > 0.0]
        if sharp > 0.0 or len(tips) > 2:
            return points[v]
        if len(tips) == 2:
            return 0.75 * points[v] + 0.125 * (tips[0] + tips[1])
        n = len(ends)
        halves = np.mean([0.5 * sum(points[w] for w in e) for e in ends], axis=0)
        faces_mean = np.mean([middles[k] for k in around[v]], axis=0)
        return (faces_mean + 2.0 * halves + (n - 3.0) * points[v]) / n

    def less(sharpness):
        return sharpness if sharpness >= 10.0 else max(sharpness - 1.0, 0.0)

    then = {e: less(s) for e, s in creases.items()}
    later = {v: less(s) for v, s in corners.items()}
    moved = []
    for v in range(len(points)):
        now = rule(v, creases, corners.get(v, 0.0))
        ending = [s for e, s in creases.items() if v in e and s > 0.0 == then[e]]
        if corners.get(v, 0.0) > 0.0 == later[v]:
            ending.append(corners[v])
        share = min(np.mean(ending), 1.0) if ending else 1.0
        moved.append(share * now + (1.0 - share) * rule(v, then, later.get(v, 0.0)))
    edge_number = {}
    for edge, pair in beside.items():
        a, b = (points[v] for v in edge)
        share = min(creases.get(edge, 0.0), 1.0)
        smooth = 0.25 * (a + b + middles[pair[0]] + middles[pair[1]])
        edge_number[edge] = len(moved)
        moved.append(share * 0.5 * (a + b) + (1.0 - share) * smooth)
    first = len(moved)
    quads = []
    for number, face in enumerate(faces):
        for before, v, after in zip(face[-1:] + face[:-1], face, face[1:] + face[:1], strict=True):
            quads.append([v, edge_number[frozenset((v, after))], first + number,
                          edge_number[frozenset((before, v))]])  # fmt: skip
    tags = {frozenset((v, edge_number[e])): s for e, s in then.items() for v in e}
    return np.array(moved + middles), quads, tags, later


def test_subdivision_is_that_of_rules_written_out():
    # a wedge of two triangles and three quads; a crease ends at a dart, others are half sharp
    points = np.array([[0, 0, 0], [2, 0, 0], [0, 1.5, 0], [0.3, 0, 1], [2, 0.2, 1.4], [0, 1, 1.0]])
    faces = [[0, 2, 1], [3, 4, 5], [0, 1, 4, 3], [1, 2, 5, 4], [2, 0, 3, 5]]
    creases = [(0, 1, 10.0), (3, 4, 2.5), (4, 5, 2.5), (5, 3, 1.3), (1, 4, 0.6), (2, 5, 3.0)]
    corners = [(2, 10.0), (3, 1.4)]
    mesh = mended(PolygonMesh.of(points, faces, creases, points=corners), cage=True)
    tags = {frozenset((a, b)): s for a, b, s in creases}
    own = (points, faces, tags, dict(corners))
    for _ in range(4):
        own, mesh = written_out(*own), subdivide(mesh)
        off, _ = cKDTree(own[0]).query(mesh.vertices)
        assert len(own[0]) == len(mesh.vertices)
        assert off.max() < 1e-13
    assert 0.05 < mesh.volume() < 1.4


def torus(around, along):
    i, j = (a.ravel() for a in np.meshgrid(np.arange(around), np.arange(along), indexing="ij"))
    u, v = 2 * np.pi * i / around, 2 * np.pi * j / along
    r = 3.0 + np.cos(v)
    x = np.column_stack([r * np.cos(u), r * np.sin(u), np.sin(v)])
    corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
    quads = np.column_stack([(a % around) * along + b % along for a, b in corners])
    ring = [(k * along, (k + 1) % around * along) for k in range(around)]
    return x, quads.tolist(), ring


def test_semi_sharp_creases_are_used_up_or_their_distance_is_told():
    x, quads, ring = torus(8, 4)
    low = mended(PolygonMesh.of(x, quads, [(a, b, 1.7) for a, b in ring]), cage=True)
    found = catmull_clark(low)
    assert (found.steps, found.distance) == (2, pytest.approx(0.0, abs=1e-12))
    high = mended(PolygonMesh.of(x, quads, [(a, b, 4.7) for a, b in ring]), cage=True)
    found = catmull_clark(high)
    assert found.steps == 1
    # how much farther out the crest is than that of the limit surface
    deep = subdivide(high, 5)
    assert not deep.creases.size
    crest = np.hypot(*limit_points(deep)[:, :2].T).max()
    patches = build_surface(list(found.faces)).triangulation(16).vertices
    off = np.hypot(*patches[:, :2].T).max() - crest
    assert 1e-4 * high.diagonal < off <= found.distance < 2.0 * off


@pytest.mark.parametrize("valence", [3, 5, 8, 12])
def test_smooth_patches_of_uneven_twisted_meshes(valence):
    # two poles of that valence over a zigzag, stretched, shaken, small and far off the origin
    angle = np.pi * np.arange(2 * valence) / valence
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0.2 * (-1.0) ** np.arange(2 * valence)])
    x = np.concatenate([ring, [[0, 0, 1.0], [0, 0, -1.0]]])
    x += 0.1 * np.random.default_rng(valence).standard_normal(x.shape)
    x = x * [1e-2, 0.2, 1e-3] + [10.0, -1e3, 0.0]
    m, quads = 2 * valence, []
    for k in range(0, m, 2):
        quads += [[m, k, k + 1, (k + 2) % m], [m + 1, k + 1, k, (k - 1) % m]]
    mesh = mended(PolygonMesh.of(x, quads, [(0, 1, 10.0)]), cage=True)
    for steps in (0, 1):
        found = smooth_quads(mesh, steps)
        assert found.normal_jump < 1e-9
        assert found.moved < 0.03 * mesh.diagonal
        assert build_surface(list(found.faces)).genus == (0,)


def test_vertices_of_two_faces_are_dissolved():
    # two quads in the place of one, and a vertex on an edge with a crease
    points = np.concatenate([CUBE, [[0.5, 0.5, 1.2], [0.3, 0.0, 0.0]]])
    faces = [[0, 2, 3, 1, 9], [4, 5, 7, 8], [4, 8, 7, 6], [0, 9, 1, 5, 4], *QUADS[3:]]
    mesh = mended(PolygonMesh.of(points, faces, [(0, 9, 10.0), (9, 1, 10.0)]), cage=True)
    assert mesh.notes == ("vertices 9 and 10: of two faces only, dissolved",)
    assert (len(mesh), len(mesh.vertices), mesh.volume()) == (6, 8, pytest.approx(1.0))
    assert np.unique(mesh.creases, axis=0).tolist() == [[0, 1]]
    assert build_surface(list(smooth_quads(mesh).faces)).genus == (0,)
    lens = PolygonMesh.of(CUBE[:4] * [1, 1, 0] + [[0, 0, 0.1]] * 4, [[0, 1, 3, 2], [2, 3, 1, 0]])
    with pytest.raises(InputError, match="vertices 1, 2, 3 and 4 belong to two faces only"):
        smooth_quads(mended(lens, cage=True))


@pytest.mark.parametrize("holes", [1, 5])
def test_plates_with_holes_by_every_scheme(holes):
    mesh = mended(PolygonMesh.of(*plate(holes)), cage=True)
    assert mesh.volume() == pytest.approx(5 * holes + 3)
    for made in (catmull_clark(mesh), smooth_quads(mesh)):
        surface = build_surface(list(made.faces))
        assert surface.genus == (holes,)
        check_quads(surface, made.nets, made.numbers)
        assert 0.6 * mesh.volume() < surface.volume() < mesh.volume()
