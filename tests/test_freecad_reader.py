# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Reading STEP, BREP and FreeCAD shapes: figures of the shared files, round trips, refusals."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import bodies
import numpy as np
import part_bodies
import pytest
import variants

from HybridVolume import errors
from HybridVolume.core.assembly import build_surface
from HybridVolume.freecad_python import import_freecad

try:
    FreeCAD = import_freecad()
    import Part
except (errors.SetupError, ImportError) as reason:
    pytest.skip(f"FreeCAD: {reason}", allow_module_level=True)

from HybridVolume import sources

Vector = FreeCAD.Vector


def read_surface(body: sources.Body):
    """Surface of a body, checked against its CAD faces."""
    surface = build_surface(list(body.faces))
    assert sources.check_against_cad(body, surface) <= 1e-9 * surface.diagonal
    return surface


# ------------------------------------------------------------------------------ shared files

# volumes of data/README.md (Gauss points on every span), pole exactly 2 pi
SHARED = {
    "untrimmed/g_shape.step": (6, 0.2977205, 0),
    "untrimmed/chair_stand.step": (34, 0.050042467, 2),
    "untrimmed/terrific_part_02.step": (42, 0.00371655207, 2),
    "untrimmed/twisted_fichera.step": (24, 2.15175941, 0),
    "untrimmed/horseshoe.step": (6, 437.061567, 0),
    "untrimmed/pole.step": (10, 2.0 * np.pi, 0),
    "untrimmed/moebius_torus.step": (3, None, 1),
    "untrimmed/torus.step": (8, 39.4786933, 1),
    "untrimmed/twisted_pipe.step": (14, 2.07566115, None),
    "fandisk/fandisk.step": (108, 20.2356814, 0),
}


@pytest.mark.shared
@pytest.mark.parametrize("name", SHARED)
def test_shared_file(shared_data, name):
    patches, volume, genus = SHARED[name]
    (body,) = sources.read_file(shared_data / name)
    assert len(body.faces) == patches
    assert not any(face.exact for face in body.faces), "every face is taken bit for bit"
    surface = read_surface(body)
    if volume is not None:
        assert surface.volume() == pytest.approx(volume, rel=1e-6)
    if genus is not None:
        assert surface.genus == (genus,)
    assert surface.shells == 1


@pytest.mark.shared
def test_shared_control_points_bit_for_bit(shared_data):
    """The poles are those that OCC reads, the outer faces' names those of FreeCAD."""
    (body,) = sources.read_file(shared_data / "fandisk" / "fandisk.step")
    surface = build_surface(list(body.faces))
    shape = Part.Shape()
    shape.read(str(shared_data / "fandisk" / "fandisk.step"))
    for k, face in enumerate(shape.Faces):
        poles = np.array([[tuple(p) for p in row] for row in face.Surface.getPoles()])
        assert body.faces[k].name == f"Face{k + 1}"
        assert np.array_equal(body.faces[k].control_points, poles)
        mine = surface.control_points[surface.patches[k].index]
        assert np.array_equal(mine, poles) or np.array_equal(mine, poles.swapaxes(0, 1))


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "error", "faces"),
    [
        ("untrimmed/tesla_t_junctions.step", errors.TJunctionError, 8),
        ("trimmed/trimmed_cube.brep", errors.TrimmedFaceError, None),
        ("trimmed/component8.step", errors.TrimmedFaceError, 15),
        ("trimmed/linkrods.step", errors.SeamError, 8),
        ("trimmed/as1.step", errors.TrimmedFaceError, None),
    ],
)
def test_shared_file_is_refused(shared_data, name, error, faces):
    with pytest.raises(error) as caught:
        sources.read_file(shared_data / name, cover=False)
    assert caught.value.faces and all(f.startswith("Face") for f in caught.value.faces)
    if faces is not None:
        assert len(caught.value.faces) == faces
    assert "\n" not in caught.value.line


# ------------------------------------------------------------------------------- round trips

ROUND_TRIPS = [
    bodies.box(spans=(3, 2, 1)),
    bodies.l_bracket(),
    bodies.wedge(20.0),
    bodies.torus(),
    bodies.ring(),
    bodies.cylinder(),
    bodies.sphere(),
    bodies.hollow_sphere(),
    bodies.bent_voxels(1, 2),
    bodies.bent_voxels(4, 3),
    variants.turned_faces(variants.mixed_splines(bodies.cylinder())),
]


@pytest.mark.parametrize("suffix", ["", ".step", ".STP", ".brep"])
@pytest.mark.parametrize("given", ROUND_TRIPS, ids=lambda b: b.name.replace(" ", "-"))
def test_round_trip(given, suffix, tmp_path):
    solid = part_bodies.to_part_solid(given)
    if suffix:
        path = tmp_path / f"Wölbung {len(given.faces)}{suffix}"
        solid.exportBrep(str(path)) if suffix == ".brep" else solid.exportStep(str(path))
        (body,) = sources.read_file(path)
        assert body.name == path.stem
    else:
        (body,) = sources.read_shape(solid, given.name)
    assert not any(face.exact for face in body.faces)
    surface = read_surface(body)
    assert surface.volume() == pytest.approx(given.volume, rel=1e-9)
    assert surface.genus == given.genus


def test_shape_keeps_every_bit():
    given = bodies.bent_voxels(1, 2)
    (body,) = sources.read_shape(part_bodies.to_part_solid(given))
    nets = {face.control_points.tobytes() for face in given.faces}
    assert {face.control_points.tobytes() for face in body.faces} == nets


# --------------------------------------------------------------- faces converted exactly


def _polygon_face(*points):
    return Part.Face(Part.makePolygon([Vector(*p) for p in (*points, points[0])]))


def _turned_box():
    box = Part.makeBox(3, 2, 1)
    box.Placement = FreeCAD.Placement(Vector(1, 2, 3), FreeCAD.Rotation(Vector(1, 2, 3), 37))
    return box


def _quarter_tube():
    """Quarter of a tube: NURBS ends, but cylinders and planes of FreeCAD for the rest."""
    ends = [part_bodies.to_part_face(face) for face in bodies.ring().faces[0:3:2]]
    tube = Part.makeCylinder(3, 1, Vector(), Vector(0, 0, 1), 90)
    tube = tube.cut(Part.makeCylinder(2, 1, Vector(), Vector(0, 0, 1), 90))
    sides = [f for f in tube.Faces if f.BoundBox.ZLength > 0.5]
    shell = Part.makeShell([*ends, *sides])
    shell.sewShape()
    return Part.Solid(shell.Shells[0])


def _larger_surface():
    """Box whose top is a rectangle cut out of a larger B-spline surface."""
    box = bodies.box(spans=(1, 1, 1), degree=1)
    faces = [part_bodies.to_part_face(face) for face in box.faces[:5]]
    top = box.faces[5]
    corner = np.array([-3.0, -2.0, 1.0])
    wide = replace(top, control_points=corner + (top.control_points - (0, 0, 1)) * (3.0, 3.0, 1.0))
    surface = part_bodies.to_part_face(wide).Surface
    shell = Part.makeShell([*faces, surface.toShape(1 / 3, 2 / 3, 1 / 3, 2 / 3)])
    shell.sewShape(1e-6)
    return Part.Solid(shell.Shells[0])


EXACT = {
    "box": (lambda: Part.makeBox(3, 2, 1), 6.0),
    "turned box": (_turned_box, 6.0),
    "box inside out": (lambda: Part.makeBox(3, 2, 1).reversed(), 6.0),
    "box of NURBS": (lambda: Part.makeBox(3, 2, 1).toNurbs(), 6.0),
    "closed shell": (lambda: Part.makeBox(3, 2, 1).Shells[0], 6.0),
    # trapezoids and an oblique prism: planes whose wire is no rectangle of parameters
    "frustum": (
        lambda: Part.makeWedge(0, 0, 0, 0, 0, 3, 2, 2, 1, 2),
        # prismatoid: height / 6 (lower + 4 middle + upper)
        2.0 / 6.0 * (6.0 + 4.0 * 3.75 + 2.0),
    ),
    "oblique prism": (
        lambda: _polygon_face((0, 0, 0), (3, 0, 0), (4, 2, 0), (0.5, 1.5, 0)).extrude(
            Vector(0.3, 0.1, 1)
        ),
        5.5,
    ),
    "cavity": (
        lambda: Part.makeBox(3, 2, 1).cut(Part.makeBox(1, 1, 0.5, Vector(1, 0.5, 0.25))),
        5.5,
    ),
    "quarter tube": (_quarter_tube, 1.25 * np.pi),
    "larger surface": (_larger_surface, 6.0),
}


@pytest.mark.parametrize("name", EXACT)
def test_exact_conversion(name):
    make, volume = EXACT[name]
    shape = make()
    (body,) = sources.read_shape(shape)
    surface = read_surface(body)
    assert surface.volume() == pytest.approx(volume, rel=1e-12)
    converted = sum(face.exact for face in body.faces)
    expected = {"box of NURBS": 0, "quarter tube": 4, "larger surface": 1}
    assert converted == expected.get(name, len(body.faces))


def test_vertices_in_a_side_shared_by_both_faces_do_no_harm():
    """A vertex in the middle of an edge, for both faces around it, is no T-junction."""
    square = _polygon_face((0, 0, 0), (1.5, 0, 0), (3, 0, 0), (3, 2, 0), (0, 2, 0))
    prism = square.extrude(Vector(0, 0, 1))
    with pytest.raises(errors.TJunctionError):
        sources.read_shape(prism, cover=False)
    # merge the two coplanar sides, but keep the two vertices in the long edges
    merged = prism.removeSplitter()
    (body,) = sources.read_shape(merged)
    assert read_surface(body).volume() == pytest.approx(6.0)


# ------------------------------------------------------------------------- several bodies


def test_several_bodies():
    box = Part.makeBox(3, 2, 1)
    pair = Part.makeCompound([box, box.translated(Vector(9, 0, 0)), Part.makeCylinder(1, 1)])
    found = sources.read_shape(pair, "pair", cover=False)
    assert [body.name for body in found] == ["pair_1", "pair_2", "pair_3"]
    assert [body.error is None for body in found] == [True, True, False]
    assert isinstance(found[2].error, errors.SeamError)
    assert found[2].faces == ()
    for body in found[:2]:
        assert read_surface(body).volume() == pytest.approx(6.0)


def test_assembly_of_touching_parts():
    """Parts may touch in faces, and across the edge where four of them meet."""
    box = Part.makeBox(3, 2, 1)
    four = [box.translated(Vector(x, y, 0)) for x in (0, 3) for y in (0, 2)]
    small = Part.makeBox(1, 1, 1, Vector(1, 0.5, 1))
    found = sources.read_shape(Part.makeCompound([*four, small]))
    assert [body.error for body in found] == [None] * 5


def test_file_with_several_solids(tmp_path):
    given = [bodies.sphere(), bodies.box(spans=(2, 2, 2), corner=(5, 0, 0))]
    path = tmp_path / "two.step"
    Part.makeCompound([part_bodies.to_part_solid(b) for b in given]).exportStep(str(path))
    found = sources.read_file(path)
    volumes = sorted(read_surface(body).volume() for body in found)
    assert volumes == pytest.approx(sorted(b.volume for b in given), rel=1e-9)


def test_document_object_in_global_coordinates():
    document = FreeCAD.newDocument("reader")
    try:
        part = document.addObject("App::Part", "Part")
        feature = document.addObject("Part::Feature", "Box")
        feature.Shape = Part.makeBox(1, 1, 1)
        feature.Placement.Base = Vector(10, 0, 0)
        part.addObject(feature)
        part.Placement = FreeCAD.Placement(Vector(0, 100, 0), FreeCAD.Rotation(Vector(0, 0, 1), 90))
        document.recompute()
        (body,) = sources.read_object(feature)
        points = np.concatenate([f.control_points.reshape(-1, 3) for f in body.faces])
        np.testing.assert_allclose(points.min(axis=0), [-1, 110, 0], atol=1e-12)
        np.testing.assert_allclose(points.max(axis=0), [0, 111, 1], atol=1e-12)
        assert read_surface(body).volume() == pytest.approx(1.0)
    finally:
        FreeCAD.closeDocument(document.Name)


# ------------------------------------------------------------------------------- refusals


def _split_top():
    """Box whose top is split in two, so that the faces beside it have a T-junction."""
    cut = Part.makeLine(Vector(1.5, 0, 1), Vector(1.5, 2, 1))
    return Part.makeBox(3, 2, 1).generalFuse([cut])[0].Solids[0]


def _three_faces_at_an_edge():
    box = Part.makeBox(3, 2, 1)
    wall = _polygon_face((0, 0, 1), (3, 0, 1), (3, 0, 2), (0, 0, 2))
    shape = box.generalFuse([wall])[0]
    return Part.Solid(Part.makeShell(shape.Faces))


SHAPES = {
    "empty": (Part.Shape, errors.InputError, ()),
    "cylinder": (lambda: Part.makeCylinder(1, 2), errors.SeamError, ("Face1",)),
    "pipe": (
        lambda: Part.makeCylinder(2, 2).cut(Part.makeCylinder(1, 2)),
        errors.SeamError,
        None,
    ),
    "torus": (lambda: Part.makeTorus(3, 1), errors.SeamError, ("Face1",)),
    "NURBS torus": (lambda: Part.makeTorus(3, 1).toNurbs(), errors.SeamError, ("Face1",)),
    "sphere": (lambda: Part.makeSphere(1), errors.DegenerateSideError, ("Face1",)),
    "cone": (lambda: Part.makeCone(1, 0, 2), errors.DegenerateSideError, ("Face1",)),
    "quarter": (
        lambda: Part.makeCylinder(1, 2, Vector(), Vector(0, 0, 1), 90),
        errors.TrimmedFaceError,
        ("Face2", "Face3"),
    ),
    "holed box": (
        lambda: Part.makeBox(4, 4, 1).cut(Part.makeBox(1, 1, 1, Vector(1, 1, 0))),
        errors.TrimmedFaceError,
        None,
    ),
    "T-junction": (_split_top, errors.TJunctionError, None),
    "open solid": (
        lambda: Part.Solid(Part.Shell(Part.makeBox(3, 2, 1).Faces[:5])),
        errors.OpenBodyError,
        ("Face1", "Face2", "Face3", "Face4"),
    ),
    "open shell": (
        lambda: Part.Shell(Part.makeBox(3, 2, 1).Faces[:5]),
        errors.OpenBodyError,
        ("Face1", "Face2", "Face3", "Face4"),
    ),
    "one face": (lambda: Part.makePlane(1, 1), errors.OpenBodyError, ("Face1",)),
    "wires": (
        lambda: Part.makeCompound(Part.makeBox(3, 2, 1).Wires),
        errors.OpenBodyError,
        (),
    ),
    "three faces at an edge": (_three_faces_at_an_edge, errors.NonManifoldError, None),
    "joined in an edge": (
        lambda: Part.makeBox(3, 2, 1).fuse(Part.makeBox(1, 1, 1, Vector(3, 2, 0))),
        errors.NonManifoldError,
        None,
    ),
    "joined in part of an edge": (
        lambda: Part.makeCompound([Part.makeBox(3, 2, 1), Part.makeBox(1, 1, 3, Vector(3, 2, -1))]),
        errors.NonManifoldError,
        None,
    ),
    "joined in a vertex": (
        lambda: Part.makeBox(3, 2, 1).fuse(Part.makeBox(1, 1, 1, Vector(3, 2, 1))),
        errors.NonManifoldError,
        None,
    ),
}


NOT_IN_STEP = ("empty", "three faces at an edge")


@pytest.mark.parametrize(
    ("name", "through_file"),
    [(name, False) for name in SHAPES]
    + [(name, True) for name in SHAPES if name not in NOT_IN_STEP],
)
def test_shape_is_refused(name, through_file, tmp_path):
    make, error, faces = SHAPES[name]
    shape = make()
    with pytest.raises(error) as caught:
        if through_file:
            path = tmp_path / "body.step"
            shape.exportStep(str(path))
            sources.read_file(path, cover=False)
        else:
            sources.read_shape(shape, cover=False)
    if faces is not None and not (through_file and error is errors.OpenBodyError):
        assert caught.value.faces == faces
    assert caught.value.remedy and "\n" not in caught.value.line


def test_one_line_counts_the_other_reasons():
    with pytest.raises(errors.SeamError) as caught:
        sources.read_shape(Part.makeCylinder(1, 2), cover=False)
    assert "1 of 3 faces" in caught.value.line
    assert "2 trimmed faces" in caught.value.line
    assert "none of its faces is a B-spline face" in caught.value.line


def _good_step(folder: Path) -> bytes:
    path = folder / "good.step"
    part_bodies.write_step(bodies.cylinder(), path)
    return path.read_bytes()


def _good_brep(folder: Path) -> bytes:
    path = folder / "good.brep"
    part_bodies.to_part_solid(bodies.cylinder()).exportBrep(str(path))
    return path.read_bytes()


def _without_face(content: bytes) -> bytes:
    """A STEP file whose shell lists one face less."""
    start = content.index(b"CLOSED_SHELL('',(") + len(b"CLOSED_SHELL('',(")
    return content[:start] + content[content.index(b",", start) + 1 :]


BAD_FILES = {
    "text.step": lambda folder: b"this is no geometry\n" * 50,
    "text.brep": lambda folder: b"this is no geometry\n" * 50,
    "empty.step": lambda folder: b"",
    "empty.brep": lambda folder: b"",
    "blank.step": lambda folder: b" \n\n",
    "bytes.step": lambda folder: bytes(range(256)) * 20,
    "header.step": lambda folder: b"ISO-10303-21;\nEND-ISO-10303-21;\n",
    "no_shape.step": lambda folder: (
        b"ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\n"
        b"FILE_NAME('','',(''),(''),'','','');\nFILE_SCHEMA(('AUTOMOTIVE_DESIGN'));\nENDSEC;\n"
        b"DATA;\n#1=CARTESIAN_POINT('',(0.,0.,0.));\nENDSEC;\nEND-ISO-10303-21;\n"
    ),
    "cut_10.step": lambda folder: _good_step(folder)[:-10],
    "half.step": lambda folder: (lambda c: c[: len(c) // 2])(_good_step(folder)),
    "half_closed.step": lambda folder: (
        (lambda c: c[: len(c) // 2])(_good_step(folder)) + b"\nENDSEC;\nEND-ISO-10303-21;\n"
    ),
    "lost_face.step": lambda folder: _without_face(_good_step(folder)),
    "broken_points.step": lambda folder: _good_step(folder).replace(
        b"CARTESIAN_POINT", b"CARTESIAN_PAINT"
    ),
    **{
        f"cut_{share}.brep": lambda folder, share=share: (
            lambda c: c[: int(len(c) * share / 1000)]
        )(_good_brep(folder))
        for share in (1, 50, 300, 600, 900, 970, 990, 999)
    },
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_file_is_refused_in_one_line(name, tmp_path, capfd):
    path = tmp_path / name
    path.write_bytes(BAD_FILES[name](tmp_path))
    with pytest.raises(errors.InputError) as caught:
        sources.read_file(path)
    assert "\n" not in caught.value.line and caught.value.remedy
    out, err = capfd.readouterr()
    assert out == "" and err == "", "OpenCASCADE's own words are kept from the user"


def test_paths_that_are_no_files(tmp_path):
    for path, words in (
        (tmp_path, "folder"),
        (tmp_path / "missing.step", "does not exist"),
        (tmp_path / "folder.step", "folder"),
    ):
        if path.name == "folder.step":
            path.mkdir()
        with pytest.raises(errors.InputError, match=words):
            sources.read_file(path)
    other = tmp_path / "part.stl"
    other.write_text("solid\n")
    with pytest.raises(errors.InputError, match="neither STEP nor BREP"):
        sources.read_file(other)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_pipe_does_not_block(tmp_path):
    os.mkfifo(tmp_path / "pipe.step")
    with pytest.raises(errors.InputError, match="no regular file"):
        sources.read_file(tmp_path / "pipe.step")


def test_unreadable_file(tmp_path, monkeypatch):
    path = tmp_path / "secret.step"
    path.write_bytes(_good_step(tmp_path))

    def denied(self):
        raise PermissionError(13, "Permission denied")

    # the superuser may read everything: let the system say no
    monkeypatch.setattr(Path, "read_bytes", denied)
    with pytest.raises(errors.InputError, match="Permission denied.*permissions"):
        sources.read_file(path)


def test_check_against_cad_finds_a_moved_patch():
    (body,) = sources.read_shape(Part.makeBox(3, 2, 1))
    faces = [replace(f, control_points=f.control_points + (0.0, 0.0, 1e-6)) for f in body.faces]
    with pytest.raises(errors.FaultError) as caught:
        sources.check_against_cad(body, build_surface(faces))
    assert caught.value.figure == pytest.approx(1e-6, rel=1e-3)
