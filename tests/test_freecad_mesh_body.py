# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies from mesh files in a document: they keep their mesh, and follow their scheme."""

import numpy as np
import pytest

import HybridVolume
from HybridVolume.errors import InputError, OpenBodyError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

from HybridVolume import mesh_import
from HybridVolume.objects.mesh_body import stored_mesh
from HybridVolume.sources import read_object
from HybridVolume.sources.mesh_findings import examine
from HybridVolume.sources.polygon_files import read_polygons

FACES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]


def boxes(*places):
    """Cubes as one OBJ text, each by its corner and side."""
    lines, count = [], 0
    for x, y, z, side in places:
        for k in range(8):
            p = (x + side * (k & 1), y + side * (k >> 1 & 1), z + side * (k >> 2))
            lines.append("v {} {} {}".format(*p))
        lines += ["f " + " ".join(str(v + 1 + count) for v in face) for face in FACES]
        count += 8
    return "\n".join(lines) + "\n"


@pytest.fixture
def doc():
    doc = FreeCAD.newDocument("meshes", hidden=True)
    doc.UndoMode = 1
    name = doc.Name
    yield doc
    if name in FreeCAD.listDocuments():
        FreeCAD.closeDocument(name)


def written(tmp_path, text, name="cage.obj"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_a_body_follows_its_scheme_and_stays_in_its_place(doc, tmp_path):
    path = written(tmp_path, boxes((0, 0, 0, 2)) + "t crease 2/1/0 0 1 10\n")
    (obj,) = HybridVolume.import_mesh(path, doc, sharp_angle=60)
    assert obj.Label == "cage" and obj.Scheme == "catmull-clark" and float(obj.SharpAngle) == 60
    assert doc.UndoNames == ["Import mesh"] and "Touched" not in obj.State
    assert float(obj.LimitDistance) < 1e-12 and float(obj.NormalJump) < 1e-9 and obj.Quads == 24
    obj.Placement = FreeCAD.Placement(FreeCAD.Vector(1e3, 0, 0), FreeCAD.Rotation(30, 20, 10))
    obj.SharpAngle = 0
    doc.recompute()
    # a cube without sharp edges keeps .327 of its volume; one crease holds a bit more
    assert 0.327 * 8 < obj.Shape.Volume < 4.0 and 0 < float(obj.LimitDistance) < 0.2
    assert obj.Placement.Base.x == 1e3 and obj.Shape.BoundBox.XMin > 990
    obj.Steps = 2
    doc.recompute()
    assert obj.Quads == 96 and any("96 quads" in note for note in obj.Notes)
    (body,) = read_object(obj)
    told = body.origin["mesh"]
    assert told["quads"] == 96 and told["distance"] == float(obj.LimitDistance)
    obj.Scheme = "bilinear"
    doc.recompute()
    assert np.isclose(obj.Shape.Volume, 8.0, rtol=1e-5) and obj.Quads == obj.Patches == 6
    (body,) = read_object(obj)
    assert body.error is None and len(body.faces) == 6
    assert min(face.control_points[..., 0].min() for face in body.faces) > 990


def test_what_is_refused_is_told_and_the_old_surface_stays(doc, tmp_path):
    path = written(tmp_path, boxes((0, 0, 0, 2)).replace("f 1 3 4 2", "f 1 3 4\nf 1 4 2"))
    (obj,) = HybridVolume.import_mesh(path, doc)
    assert obj.Scheme == "catmull-clark" and obj.Status == "Up to date"
    before = obj.Shape.Volume
    obj.Scheme = "bilinear"
    doc.recompute()
    assert "Invalid" in obj.State
    assert obj.Status.startswith("Failed: faces 1 and 2 have not four corners")
    assert obj.Shape.Volume == before
    obj.Scheme = "smooth"
    doc.recompute()
    assert obj.Status == "Up to date" and "Invalid" not in obj.State

    count = len(doc.Objects)
    with pytest.raises(OpenBodyError):
        HybridVolume.import_mesh(written(tmp_path, path.read_text().replace("f 1 4 2", "")), doc)
    with pytest.raises(InputError):
        HybridVolume.import_mesh(path, doc, scheme="loop")
    assert len(doc.Objects) == count and doc.UndoNames[0] == "Import mesh"


def test_several_bodies_and_cavities_are_kept_with_the_document(doc, tmp_path):
    text = boxes((0, 0, 0, 2), (10, 0, 0, 4), (11, 1, 1, 2))
    made = HybridVolume.import_mesh(written(tmp_path, text, "two.obj"), doc)
    assert [obj.Label for obj in made] == ["two_1", "two_2"]
    assert np.allclose([obj.Shape.Volume for obj in made], [8.0, 64.0 - 8.0], rtol=1e-5)
    path = str(tmp_path / "saved.FCStd")
    doc.saveAs(path)
    FreeCAD.closeDocument(doc.Name)
    again = FreeCAD.openDocument(path, hidden=True)
    try:
        hollow = next(obj for obj in again.Objects if obj.Label == "two_2")
        mesh = stored_mesh(hollow)
        # the numbers are those of the file, from 1
        assert sorted(mesh.face_number) == list(range(7, 19))
        assert sorted(mesh.vertex_number) == list(range(9, 25))
        assert hollow.State == ["Up-to-date"]
        hollow.Scheme = "catmull-clark"
        again.recompute()
        assert hollow.Status == "Up to date"
        assert len(hollow.Shape.Solids) == 1 and len(hollow.Shape.Shells) == 2
        # both skins shrink to the same share
        share = hollow.Shape.Volume / 56.0
        assert 0.32 < share < 0.34
        hollow.Steps = 9
        again.recompute()
        assert hollow.Status.startswith("Failed: 9 subdivisions; choose 0 to 5")
    finally:
        FreeCAD.closeDocument(again.Name)


def test_findings_tell_what_can_be_chosen(tmp_path):
    cube = boxes((0, 0, 0, 2))
    plain = examine(written(tmp_path, cube))
    assert plain.scheme == "bilinear" and not plain.refusals and not plain.refusal
    assert plain.lines[0] == "8 vertices, 6 faces: 6 quads"
    assert [plain.sharper(angle) for angle in (0, 89, 91)] == [12, 12, 0]
    for scheme, steps, quads in (
        *(("bilinear", None, 6), ("smooth", None, 6), ("smooth", 1, 24)),
        *(("catmull-clark", None, 24), ("catmull-clark", 0, 6), ("catmull-clark", 3, 384)),
    ):
        assert plain.quads(scheme, steps) == quads
    creased = examine(written(tmp_path, cube + "t crease 2/1/0 0 1 2.5\n"))
    assert creased.scheme == "catmull-clark"
    assert "1 crease named in the file, 1 of them semi-sharp" in creased.lines
    halved = examine(written(tmp_path, cube.replace("f 1 3 4 2", "f 1 3 4\nf 1 4 2")))
    assert "5 quads, 2 triangles" in halved.lines[0]
    assert list(halved.refusals) == ["bilinear"] and halved.scheme == "catmull-clark"
    assert halved.quads("smooth", None) == 5 * 4 + 2 * 3
    torn = examine(written(tmp_path, cube.replace("f 1 3 4 2\n", "")))
    assert torn.scheme == "" and "edges 1-2, 1-3, 2-4 and 3-4" in torn.refusal
    assert torn.lines[0] == "8 vertices, 5 faces: 5 quads"
    crossed = examine(written(tmp_path, boxes((0, 0, 0, 2), (1, 1, 1, 2))))
    assert "cut each other" in crossed.refusals["bilinear"]
    assert "cannot be read" in examine(tmp_path / "absent.obj").refusal


def test_freecad_can_call_it_without_a_window(tmp_path):
    before = set(FreeCAD.listDocuments())
    path = str(written(tmp_path, boxes((0, 0, 0, 2)), "cube.obj"))
    mesh_import.open(path)
    (name,) = set(FreeCAD.listDocuments()) - before
    try:
        mesh_import.insert(path, name)
        doc = FreeCAD.getDocument(name)
        assert [round(obj.Shape.Volume, 6) for obj in doc.Objects] == [8.0, 8.0]
    finally:
        FreeCAD.closeDocument(name)
    torn = str(written(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "torn.obj"))
    with pytest.raises(OpenBodyError):
        mesh_import.open(torn)
    assert set(FreeCAD.listDocuments()) == before


@pytest.mark.shared
def test_a_real_cage_is_stored_as_it_is(doc, shared_data):
    path = shared_data / "cages" / "osd_cube_creases0.obj"
    (obj,) = HybridVolume.import_mesh(path, doc)
    kept, given = stored_mesh(obj), read_polygons(path)
    assert np.array_equal(kept.vertices, given.vertices) and len(kept) == len(given)
    assert np.array_equal(kept.sharpness, given.sharpness)
    assert np.array_equal(kept.creases, given.creases)
