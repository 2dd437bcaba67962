# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Quad meshes and cages: what is read, what is mended, and what is refused by its numbers."""

import struct

import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.polygon_repair import bodies, mended
from HybridVolume.core.polygons import PolygonMesh, bilinear_faces
from HybridVolume.errors import (
    InputError,
    NonManifoldError,
    OpenBodyError,
    OrientationError,
    SelfIntersectionError,
)
from HybridVolume.sources.polygon_files import read_polygons

CUBE = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
QUADS = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]


def cube(size=1.0, shift=0.0, faces=QUADS):
    return CUBE * size + shift, [list(face) for face in faces]


def several(*parts):
    """Vertices and faces of several meshes as one."""
    points, rows, count = [], [], 0
    for vertices, faces in parts:
        points.append(vertices)
        rows += [[v + count for v in face] for face in faces]
        count += len(vertices)
    return np.concatenate(points), rows


def obj(vertices, faces, first=1):
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    return "\n".join([*lines, *("f " + " ".join(str(v + first) for v in f) for f in faces)])


def read(tmp_path, text, suffix=".obj"):
    path = tmp_path / f"mesh{suffix}"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_polygons(path)


def test_the_same_cube_from_all_kinds_of_files(tmp_path):
    vertices, faces = cube(2.0)
    rows = "\n".join(" ".join(map(str, v)) for v in vertices)
    quads = "\n".join("4 " + " ".join(map(str, f)) for f in faces)
    header = (
        "ply\nformat {} 1.0\ncomment a cube\nelement vertex 8\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar red\nelement face 6\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    coloured = "\n".join(" ".join(map(str, v)) + " 7" for v in vertices)
    binary = {
        order: b"".join(struct.pack(f"{order}3fB", *v, 7) for v in vertices)
        + b"".join(struct.pack(f"{order}B4i", 4, *f) for f in faces)
        for order in "<>"
    }
    negative = (
        obj(vertices, [])
        + "\n"
        + "\n".join("f " + " ".join(f"{v - 8}/1/{v + 1}" for v in f) for f in faces)
    )
    texts = [
        ("# a cube\n" + obj(vertices, faces), ".obj"),
        (negative, ".obj"),
        (f"OFF\n8 6 12\n\n{rows} # end\n{quads}\n", ".off"),
        (f"OFF 8 6 0\n{rows}\n{quads}\n", ".off"),
        (header.format("ascii") + f"{coloured}\n{quads}\n", ".ply"),
        (header.format("binary_little_endian").encode() + binary["<"], ".ply"),
        (header.format("binary_big_endian").encode() + binary[">"], ".ply"),
    ]
    for text, suffix in texts:
        (body,) = bodies(mended(read(tmp_path, text, suffix)))
        assert body.volume() == pytest.approx(8.0, rel=1e-12)
        assert len(body.edges[0]) == 12


def test_creases_of_opensubdiv(tmp_path):
    text = obj(*cube()) + "\nt crease 2/1/0 0 1 2.0\nt crease 3/2/0 1 3 2 10 0.5\n"
    mesh = read(tmp_path, text + "t interpolateboundary 1/0/0 2\n")
    assert mesh.creases.tolist() == [[0, 1], [1, 3], [2, 3]]
    assert mesh.sharpness.tolist() == [2.0, 10.0, 0.5]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "0 vertices and 0 faces"),
        ("v 1 2\n", "line 1 has no three coordinates"),
        ("v 1 2 x\n", "line 1 has '1 2 x' where numbers must be"),
        (obj(*cube(), first=0), "line 9 has vertex 0; vertices count from 1"),
        (obj(*cube()) + "\nf 1 2 99\n", "face 7 has vertices that do not exist"),
        (obj(*cube()).replace("v 0.0 0.0 0.0", "v nan 0 0", 1), "vertex 1 has coordinates"),
        (obj(*cube()) + "\nf 1 2\n", "face 7 has fewer than three corners"),
    ],
)
def test_damaged_files_are_refused_with_the_line(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read(tmp_path, text)


def test_damaged_off_and_ply(tmp_path):
    for text, suffix, words in (
        ("OFF\n8 6 0\n0 0 0\n", ".off", "ends after 1 of 8 vertices"),
        ("hello\n", ".off", "does not begin with OFF"),
        (b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nend_header\n1\n", ".ply",
         "ends in vertex 1 of 2"),
        ("solid", ".ply", "no header"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            read(tmp_path, text, suffix)
    with pytest.raises(InputError, match="no mesh file"):
        read(tmp_path, "solid", ".stl")
    with pytest.raises(InputError, match="cannot be read"):
        read_polygons(tmp_path / "nowhere.obj")


def test_mixed_orientation_is_mended_and_told():
    vertices, faces = cube()
    faces[3] = faces[3][::-1]
    mesh = mended(PolygonMesh.of(vertices, faces))
    assert mesh.volume() == pytest.approx(1.0)
    assert mesh.notes == ("face 4: turned as their neighbours",)
    mesh = mended(PolygonMesh.of(vertices, [face[::-1] for face in QUADS]))
    assert mesh.volume() == pytest.approx(1.0)
    assert mesh.notes == ("all faces looked inward and were turned",)


def test_split_vertices_doubled_faces_and_corners_are_mended():
    vertices = np.concatenate([CUBE[face] for face in QUADS])
    split = PolygonMesh.of(vertices, np.arange(24).reshape(6, 4).tolist())
    mesh = mended(split)
    assert len(mesh.vertices) == 8
    assert mesh.volume() == pytest.approx(1.0)
    assert "16 vertices" in mesh.notes[0]
    faces = [*QUADS, QUADS[2]]
    faces[0] = [0, 0, 2, 3, 1]
    mesh = mended(PolygonMesh.of(CUBE, faces))
    assert (len(mesh), mesh.volume()) == (6, pytest.approx(1.0))
    assert len(mesh.notes) == 2


def test_what_cannot_be_mended_is_refused_by_its_numbers():
    vertices, faces = cube()
    with pytest.raises(OpenBodyError, match=r"edges 1-2, 1-3, 2-4 and 3-4 belong to one face"):
        mended(PolygonMesh.of(vertices, faces[1:]))
    with pytest.raises(OpenBodyError, match=r"edges 0-1, 0-2, 1-3 and 2-3"):
        mended(PolygonMesh.of(vertices, faces[1:], first=0))
    # two cubes that share the edge 2-4
    other = CUBE + [1.0, 1.0, 0.0]
    twins = several((vertices, faces), (other, faces))
    shared = np.array(twins[1])
    shared[shared == 8] = 3
    shared[shared == 12] = 7
    with pytest.raises(NonManifoldError, match="edge 4-8 belongs to more than two"):
        mended(PolygonMesh.of(twins[0], shared.tolist()))
    # two cubes that share a corner
    twins = several((vertices, faces), (CUBE + 1.0, faces))
    shared = np.array(twins[1])
    shared[shared == 8] = 7
    with pytest.raises(NonManifoldError, match="only in vertex 8"):
        mended(PolygonMesh.of(twins[0], shared.tolist()))
    bow = [list(face) for face in faces]
    bow[1] = [4, 7, 5, 6]
    with pytest.raises(InputError, match="sides of face 2 cut each other"):
        mended(PolygonMesh.of(vertices, bow))
    twice = [list(face) for face in faces]
    twice[1] = [4, 5, 4, 6]
    with pytest.raises(InputError, match="face 2 has a vertex twice"):
        mended(PolygonMesh.of(vertices, twice))
    flat = vertices.copy()
    flat[[1, 3]] = [[0.0, 0.5, 0.0], [0.0, 0.7, 0.0]]
    with pytest.raises(InputError, match=r"face 1 has no area"):
        mended(PolygonMesh.of(flat, faces))


def test_a_surface_with_one_side_is_refused():
    # Klein's bottle: rings of four quads, the last joined to the first mirrored
    rings, around = 6, 4

    def number(i, j):
        return (i % rings) * around + (j if i < rings else -j) % around

    faces = [
        [number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)]
        for i in range(rings)
        for j in range(around)
    ]
    x = np.random.default_rng(4).random((rings * around, 3))
    with pytest.raises(OrientationError, match="one side only"):
        mended(PolygonMesh.of(x, faces), cage=True)


def test_bodies_cavities_and_bodies_in_cavities():
    nest = several(cube(9.0), cube(5.0, 2.0), cube(1.0, 4.0), cube(2.0, 20.0))
    found = bodies(mended(PolygonMesh.of(*nest)))
    assert sorted(round(body.volume(), 9) for body in found) == [1.0, 8.0, 729.0 - 125.0]
    assert build_surface(bilinear_faces(found[0])).volume() == pytest.approx(604.0)
    with pytest.raises(SelfIntersectionError, match="cut each other"):
        bodies(mended(PolygonMesh.of(*several(cube(2.0), cube(2.0, 1.0)))))


def test_bilinear_takes_quads_only():
    faces = [*QUADS[1:], [0, 2, 3], [0, 3, 1]]
    mesh = mended(PolygonMesh.of(CUBE, faces))
    with pytest.raises(InputError, match="faces 6 and 7 have not four corners"):
        bilinear_faces(mesh)
    assert mesh.volume() == pytest.approx(1.0)


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "count", "genus"),
    [("quads/rod.obj", 992, 2), ("quads/ant.obj", 2784, 0), ("quads/bitorus.off", 200, 2),
     ("quads/polycube.off", 72, 0), ("fandisk/fandisk_quads_dense.off", 764, 0)],
)  # fmt: skip
def test_real_quad_meshes(shared_data, name, count, genus):
    mesh = mended(read_polygons(shared_data / name))
    assert mesh.notes == ()
    (body,) = bodies(mesh)
    surface = build_surface(bilinear_faces(body))
    assert (len(surface.patches), surface.genus) == (count, (genus,))


@pytest.mark.shared
@pytest.mark.parametrize(("name", "genus"), [("fish", 0), ("osd_toroidal_tet", 3)])
def test_real_cages(shared_data, name, genus):
    mesh = mended(read_polygons(shared_data / f"cages/{name}.obj"), cage=True)
    (body,) = bodies(mesh, cage=True)
    assert len(body.vertices) - len(body.edges[0]) + len(body) == 2 - 2 * genus
