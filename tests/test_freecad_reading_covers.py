# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Reading bodies of any faces: what is covered, what is told of each face, what stays refused."""

from dataclasses import replace

import numpy as np
import pytest

from HybridVolume import errors, sources
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.check import check_surface
from HybridVolume.freecad_python import import_freecad
from HybridVolume.sources.covered import allowed_deviation
from HybridVolume.sources.covering import forget_limits, is_known
from HybridVolume.sources.imprint import imprint_seams
from HybridVolume.sources.inner_walls import without_inner_walls

try:
    FreeCAD = import_freecad()
    import Part
except (errors.SetupError, ImportError) as reason:
    pytest.skip(f"FreeCAD: {reason}", allow_module_level=True)

Vector = FreeCAD.Vector
PI = np.pi


@pytest.fixture
def no_python(monkeypatch):
    """No mesher can be started."""
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", "/nowhere/python")


def quarter(radius=4.0, height=6.0, at=(0, 0, 0)):
    """A quarter of a cylinder: two planes with three corners, three rectangles."""
    return Part.makeCylinder(radius, height, Vector(*at), Vector(0, 0, 1), 90)


def two_boxes_in_one():
    """A box on a larger one, as one solid of two shells with a wall of two faces between them."""
    low = Part.makeBox(4, 4, 2)
    high = Part.makeBox(2, 2, 3, Vector(1, 1, 2))
    # the lower box has the footprint of the upper one as a face of its own
    lid = Part.makePlane(2, 2, Vector(1, 1, 2))
    low = low.generalFuse([lid])[0].Solids[0]
    return Part.Solid(Part.makeCompound([low.Shells[0], high.Shells[0]]))


def read(shape, **keywords):
    """The body of a shape, and its surface, which is proved and compared with the CAD faces."""
    (body,) = sources.read_shape(shape, "body", **keywords)
    surface = build_surface(list(body.faces))
    check_surface(surface)
    off = sources.check_against_cad(body, surface)
    assert off <= body.origin["geometry"]["max_deviation"] * 1.5 + 1e-9 * surface.diagonal
    return body, surface


# --------------------------------------------------------------- exact, without any mesher


@pytest.mark.parametrize(
    ("solid", "volume", "patches", "genus"),
    [
        (lambda: Part.makeSphere(10), 4000 / 3 * PI, [6], (0,)),
        (
            lambda: Part.makeSphere(1e-3, Vector(0.1, 0, 0), Vector(1, 2, 3)),
            4e-9 / 3 * PI,
            [6],
            (0,),
        ),
        (
            lambda: Part.makeSphere(10).cut(Part.makeSphere(4, Vector(3, 0, 0))),
            4 / 3 * PI * (1000 - 64),
            [6, 6],
            (0, 0),
        ),
        (
            lambda: Part.makeBox(20, 20, 20).cut(Part.makeSphere(4, Vector(10, 10, 10))),
            8000 - 256 / 3 * PI,
            [1] * 6 + [6],
            (0, 0),
        ),
        (
            lambda: Part.makeSphere(20).cut(Part.makeBox(5, 6, 7)),
            32000 / 3 * PI - 210,
            [6] + [1] * 6,
            (0, 0),
        ),
        (
            lambda: Part.makeTorus(1e3, 300, Vector(5e3, 1, 2), Vector(1, 2, 3)),
            2 * PI**2 * 1e3 * 9e4,
            [16],
            (1,),
        ),
    ],
    ids=["ball", "small ball", "hollow ball", "round cavity", "square cavity", "torus"],
)
def test_spheres_and_tori_are_exact(solid, volume, patches, genus, no_python):
    body, surface = read(solid())
    assert surface.volume() == pytest.approx(volume, rel=1e-12)
    assert surface.genus == genus
    names = [face.name for face in body.faces]
    count = len(body.shape.Faces)
    assert [names.count(f"Face{k + 1}") for k in range(count)] == patches
    assert set(body.cover.kinds) == {"exact"} and body.domains == (None,) * len(names)
    geometry = body.origin["geometry"]
    assert geometry["area"]["exact"] == 1.0 and geometry["patches"] == sum(patches)
    assert [row["patches"] for row in geometry["faces"]] == patches
    assert geometry["tolerance"] == pytest.approx(1e-4 * body.shape.BoundBox.DiagonalLength)


def test_pieces_beside_a_former_seam_are_no_seams():
    """They keep both curves of the seam, and OCC goes on calling the edge one."""
    split = imprint_seams(Part.makeTorus(10, 3)).solid
    body, surface = read(split, cover=False)
    assert body.cover is None and len(body.faces) == 16 and surface.genus == (1,)
    assert surface.volume() == pytest.approx(180 * PI**2, rel=1e-12)


def test_walls_inside_are_left_out(no_python):
    solid = two_boxes_in_one()
    assert len(solid.Faces) == 13 and solid.Volume == pytest.approx(44.0)
    united = without_inner_walls(solid)
    assert len(united.inside) == 2 and len(united.solid.Faces) == 11
    assert united.solid.Volume == pytest.approx(44.0) and united.solid.isValid()
    for piece, number in zip(united.solid.Faces, united.numbers.tolist(), strict=True):
        assert piece.Area == pytest.approx(solid.Faces[number].Area)
        assert piece.CenterOfMass.distanceToPoint(solid.Faces[number].CenterOfMass) < 1e-9
    box = Part.makeBox(1, 2, 3)
    assert without_inner_walls(box).solid is box


@pytest.mark.shared
def test_touching_parts_of_a_shared_body_are_one(shared_data, no_python):
    """Its discs lie on each other; without them every face is an untrimmed patch of the file."""
    (body,) = sources.read_file(shared_data / "untrimmed" / "tesla_t_junctions.step")
    geometry = body.origin["geometry"]
    assert geometry["counts"] == {"bit": 38, "exact": 0, "tolerance": 0}
    assert len(geometry["inside"]) == 28 and len(body.shape.Faces) == 66
    assert {"Face20", "Face29"} <= set(geometry["inside"])
    surface = build_surface(list(body.faces))
    check_surface(surface)
    assert surface.genus == (0,) and sources.check_against_cad(body, surface) < 1e-12
    for face in body.faces:
        poles = body.shape.Faces[int(face.name[4:]) - 1].Surface.getPoles()
        given = {tuple(point) for row in poles for point in row}
        assert {tuple(point) for point in face.control_points.reshape(-1, 3)} == given


# ----------------------------------------------------------------------- with the mesher


def test_a_quarter_is_covered_once(python, monkeypatch):
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", python)
    solid = quarter()
    news = []
    body, surface = read(solid, progress=lambda name, one: news.append((name, one)))
    assert surface.volume() == pytest.approx(24 * PI, rel=1e-12)
    assert set(body.cover.kinds) == {"exact"} and body.shape.isSame(solid)
    assert {name for name, _ in news} == {"body"} and news[0][1].stage == "covering"
    assert {face.name for face in body.faces} == {f"Face{k}" for k in range(1, 6)}
    geometry = body.origin["geometry"]
    assert geometry["sentence"].startswith(f"5 faces: 5 exact; covered with {len(body.faces)} p")
    areas = [row["area"] for row in geometry["faces"]]
    assert sorted(areas) == pytest.approx(sorted([12 * PI, 24, 24, 4 * PI, 4 * PI]), rel=1e-6)
    # what is known needs no process, also from a copy of the body, and with equal words
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", "/nowhere/python")
    assert is_known(solid.copy()) and not is_known(solid, 0.05)
    assert not is_known(solid, free_only=True) and not is_known(quarter(4.001))
    (again,) = sources.read_shape(solid.copy(), "again")
    assert again.cover is body.cover and again.name == "again"
    with pytest.raises(errors.SetupError, match="/nowhere/python"):
        sources.read_shape(solid, tolerance=0.05)
    document = FreeCAD.newDocument("quarter", hidden=True, temp=True)
    try:
        feature = document.addObject("Part::Feature", "Quarter")
        feature.Shape = solid
        assert sources.coverings(feature) == []
        (one,) = sources.coverings(feature, tolerance=0.05)
        assert (one.state, one.name, one.tolerance) == ("new", "Quarter", 0.05)
        feature.Placement.Base = Vector(1, 0, 0)
        assert len(sources.coverings(feature)) == 1
    finally:
        FreeCAD.closeDocument(document.Name)
    # a cover that is not on its faces is a fault
    moved = [replace(face, control_points=face.control_points + 1e-5) for face in body.faces]
    with pytest.raises(errors.FaultError, match="away from its CAD face"):
        sources.check_against_cad(body, build_surface(moved))


def test_a_covering_can_be_cancelled(python, tmp_path, monkeypatch):
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", python)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    solid = quarter(4.5)
    covering = sources.Covering(solid, name="part")
    covering.start()
    assert covering.state == "running" and len(list(tmp_path.iterdir())) == 1
    covering.cancel()
    assert covering.state == "cancelled" and not list(tmp_path.iterdir())
    with pytest.raises(errors.WorkerError, match="cancelled"):
        covering.result()
    assert not is_known(solid)


def test_a_dying_process_is_a_refusal(tmp_path, monkeypatch):
    """Whatever the process does, the body is refused in words, and nothing is left behind."""
    dying = tmp_path / "python"
    dying.write_text("#!/bin/sh\nkill -9 $$\n")
    dying.chmod(0o755)
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", str(dying))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(errors.LimitError) as caught:
        sources.read_shape(quarter(5.5))
    assert caught.value.remedy and "\n" not in caught.value.line
    assert [path.name for path in tmp_path.iterdir()] == ["python"]
    # a window covers first and reads then: known until somebody asks anew
    assert is_known(quarter(5.5))
    forget_limits()
    assert not is_known(quarter(5.5))
    # an end that nobody intended is our fault, and stays one
    dying.write_text("#!/bin/sh\necho 'ImportError: no x' >&2\nexit 1\n")
    with pytest.raises(errors.FaultError, match="ImportError: no x"):
        sources.read_shape(quarter(5.5))
    forget_limits()
    assert is_known(quarter(5.5))


def test_a_damaged_answer_is_no_cover(tmp_path, monkeypatch):
    """A process that ends well and writes nonsense."""
    lying = tmp_path / "python"
    lying.write_text('#!/bin/sh\necho nonsense > "$3/cover.npz"\n')
    lying.chmod(0o755)
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", str(lying))
    with pytest.raises(errors.WorkerError, match="cover cannot be read"):
        sources.read_shape(quarter(6.5))
    assert not is_known(quarter(6.5))


# ------------------------------------------------------------------------------- refusals


def test_one_refused_body_does_not_stop_the_others(no_python):
    open_box = Part.Solid(Part.Shell(Part.makeBox(3, 2, 1, Vector(50, 0, 0)).Faces[:5]))
    found = sources.read_shape(
        Part.makeCompound([open_box, Part.makeSphere(3), Part.makeBox(1, 1, 1, Vector(20, 0, 0))])
    )
    assert [body.error is None for body in found] == [False, True, True]
    assert isinstance(found[0].error, errors.OpenBodyError)
    assert found[1].cover is not None and found[2].cover is None
    assert found[2].origin["geometry"]["sentence"] == "6 faces: 6 exact"


@pytest.mark.parametrize("tolerance", [-1.0, float("nan"), float("inf")])
def test_a_tolerance_is_a_length(tolerance):
    with pytest.raises(errors.InputError, match="no length above 0 mm"):
        allowed_deviation(Part.makeBox(1, 1, 1), tolerance)


def test_bodies_that_touch_in_an_edge_stay_refused(no_python):
    pair = Part.makeCompound([quarter(), Part.makeBox(1, 1, 1, Vector(-1, -1, 2))])
    with pytest.raises(errors.NonManifoldError):
        sources.read_shape(pair)
