# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Midstructures in documents: found, decided about, undone, stored, replayed on another body.

Of a box a x b x c (c the smallest) the sheet between the two large faces has the area
(a - c)(b - c), and that of an edge of length a, from half its largest radius on, the area
c (a - 3 c / 4) / sqrt(8).
"""

import math

import numpy as np
import pytest

import HybridVolume
from HybridVolume import job
from HybridVolume.errors import HybridVolumeError, InputError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Part
from bodies import prism
from made_by_hand import SIZE, completed
from part_bodies import to_part_solid

from HybridVolume.core.hybrid import save_midstructure
from HybridVolume.core.midstructure import Decision
from HybridVolume.objects import document, midstructure
from HybridVolume.objects import volume as volumes
from HybridVolume.objects.midstructure import chosen
from HybridVolume.objects.properties import DocumentObject, Property


@pytest.fixture(scope="module", autouse=True)
def python():
    try:
        return job.worker_python()
    except SetupError as missing:
        pytest.skip(missing.line)


@pytest.fixture
def doc():
    doc = FreeCAD.newDocument("test", hidden=True, temp=True)
    doc.UndoMode = 1
    name = doc.Name
    yield doc
    if name in FreeCAD.listDocuments():
        FreeCAD.closeDocument(name)


@pytest.fixture
def box(doc):
    box = doc.addObject("Part::Box", "Box")
    box.Length, box.Width, box.Height = 4, 2, 1
    doc.recompute()
    return box


@pytest.fixture(scope="module")
def found_file(tmp_path_factory):
    """The midstructure of the box, found once."""
    path = tmp_path_factory.mktemp("found") / "box.npz"
    save_midstructure(HybridVolume.find_midstructure(Part.makeBox(4, 2, 1), samples=3000), path)
    return path


@pytest.fixture
def volume(doc, box):
    volume = volumes.start(doc, box)
    HybridVolume.edit_midstructure(volume).set(samples=3000)
    doc.clearUndos()
    return volume


@pytest.fixture
def mid(volume, found_file):
    """Editor of the box's midstructure, which is found already."""
    mid = HybridVolume.edit_midstructure(volume)
    mid.insert(found_file)
    volume.Document.clearUndos()
    return mid


def area(obj):
    return chosen(obj).area


def state(obj):
    names = ("Decisions", "Kept", "Unmatched", "Angle", "MinimumSize", "Method", "Status")
    return {name: getattr(obj, name) for name in names}


def between(mid, *faces):
    """Number of the sheet between two faces, from 1."""
    return 1 + next(k for k, s in enumerate(mid.sheets) if set(s.faces) == set(faces))


OPPOSITE = ("Face5", "Face6")
EDGE = ("Face4", "Face5")
"""The upper and lower face of the box, and two that meet at an edge of length 4."""


def edge_area(length, height):
    """Of an edge's sheet from half its radius on: the trapezoid between two insets."""
    return 0.25 * math.sqrt(2.0) * height * (length - 0.75 * height)


# ------------------------------------------------------------------------- before anything


def test_a_volume_starts_with_nothing_computed(doc, box):
    doc.clearUndos()
    volume = volumes.start(doc, box)
    assert doc.UndoNames == ["Create a hybrid volume"]
    assert volume.Status == "Not computed" and volume.Midstructure.Status == "Not found"
    assert volume.Shell is None and volume.FemMesh is None
    assert chosen(volume.Midstructure) is None and volume.Midstructure.Kept == ()
    mid = HybridVolume.edit_midstructure(volume)
    with pytest.raises(InputError, match="no midstructure was found yet; call find"):
        mid.remove("Sheet1")
    doc.recompute()
    assert volume.Status == "Not computed" and volume.Midstructure.Status == "Not found"
    doc.undo()
    assert [obj.Name for obj in doc.Objects] == ["Box"]


def test_a_result_fills_a_volume_that_was_started(doc, box, tmp_path):
    box.Length, box.Width, box.Height = SIZE
    doc.recompute()
    volume = volumes.start(doc, box)
    child = volume.Midstructure
    HybridVolume.edit_midstructure(volume).set(angle=130.0)
    doc.clearUndos()
    one = completed(box, tmp_path)
    one = document.Completed(**{**vars(one), "parameters": {
        **one.parameters, "Midstructure.Angle": 130.0
    }})  # fmt: skip
    document.insert(doc, box, [document.Prepared(one)], volume)
    assert volume.Status == "Up to date" and volume.Midstructure is child
    assert child.Status == "Up to date" and child.Kept == (True,)
    assert volume.Shell.Elements == 12 and volume.FemMesh.FemMesh.VolumeCount == 24
    HybridVolume.edit_midstructure(volume).remove(faces=OPPOSITE)
    assert volume.Status == volume.Shell.Status == "Out of date: Midstructure.Decisions changed"
    assert child.Status == "Nothing is kept: keep a sheet"
    # the worker was busy with an older choice: the newer one stays, and is told
    document.insert(doc, box, [document.Prepared(one)], volume)
    assert child.Decisions == ["remove Face5+Face6"] and child.Kept == (False,)
    assert volume.Status == "Out of date: Midstructure.Decisions changed"
    doc.undo()
    doc.undo()
    assert volume.Status == "Up to date" and child.Status == "Up to date"
    doc.undo()
    assert volume.Status == "Not computed" and volume.Shell is None
    assert {obj.Name for obj in doc.Objects} == {"Box", "HybridVolume", "Midstructure"}


def test_a_cancelled_search_changes_nothing(volume):
    mid = HybridVolume.edit_midstructure(volume)
    before = state(mid.object)

    def stop(news):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mid.find(stop)
    assert state(mid.object) == before and volume.Status == "Not computed"
    assert volume.Document.UndoNames == []


# ------------------------------------------------------------------------------ decisions


def test_found_and_chosen(volume):
    mid = HybridVolume.edit_midstructure(volume)
    told = []
    sheets = mid.find(told.append)
    assert [news.stage for news in told][-1] == "exports"
    assert set(sheets[0].faces) == set(OPPOSITE) and sheets[0].kept
    assert area(mid.object) == pytest.approx(3.0, rel=0.01)
    assert mid.object.Kept == tuple(sheet.kept for sheet in sheets)
    assert mid.object.Kept.count(True) == 1
    assert mid.object.Status == "Up to date" and mid.object.MethodUsed == "medial-axis"
    assert volume.Document.UndoNames == ["Find the midstructure"]
    assert volume.Status == "Not computed"


def test_every_decision_is_one_step_of_undo(doc, mid):
    obj = mid.object
    edge = f"Sheet{between(mid, *EDGE)}"
    steps = [
        (lambda: mid.remove(faces=OPPOSITE), "Remove Sheet1", 0.0),
        (lambda: mid.keep(edge), f"Keep {edge}", edge_area(4.0, 1.0)),
        (lambda: mid.invert("Sheet1"), "Invert Sheet1", 3.0 + edge_area(4.0, 1.0)),
        (lambda: mid.only(edge), f"Keep only {edge}", edge_area(4.0, 1.0)),
        (lambda: mid.set(minimum_size=2.0), "Midstructure: minimum size", edge_area(4.0, 1.0)),
        (lambda: mid.automatic(), "Automatic choice of the sheets", 3.0),
    ]
    states = [state(obj)]
    for number, (step, name, wanted) in enumerate(steps, start=1):
        step()
        assert doc.UndoCount == number and doc.UndoNames[0] == name
        assert area(obj) == pytest.approx(wanted, rel=0.08)
        assert obj.Kept == tuple(sheet.kept for sheet in mid.sheets)
        states.append(state(obj))
    for before in reversed(states[:-1]):
        doc.undo()
        assert state(obj) == before
    for after in states[1:]:
        doc.redo()
        assert state(obj) == after
    doc.recompute()
    assert state(obj) == states[-1]


def test_nothing_kept_is_said(volume, mid):
    volumes.set_status(volume, "Failed: no valid shell")
    mid.remove("Sheet1")
    assert volume.Status == "Not computed"
    assert mid.object.Status == "Nothing is kept: keep a sheet"
    mid.invert()
    assert all(mid.object.Kept)


def test_decisions_stay_few(mid):
    obj, edge = mid.object, between(mid, *EDGE)
    for _ in range(3):
        mid.remove(f"Sheet{edge}")
        mid.keep(f"Sheet{edge}")
    assert obj.Decisions == [f"keep {mid.sheets[edge - 1].name}"]
    # a decision about both faces covers the one about a place between them
    mid.remove(faces=EDGE[::-1])
    assert obj.Decisions == ["remove Face5+Face4"]
    # what only says about the others outlives the removal of its own sheet
    mid.only("Sheet1")
    mid.remove("Sheet1")
    assert [Decision.parse(text).action for text in obj.Decisions] == ["only", "remove"]
    assert not any(obj.Kept)


def test_every_sheet_is_found_by_its_name(mid):
    for number, sheet in enumerate(mid.sheets, start=1):
        mid.only(f"Sheet{number}")
        assert [k for k, kept in enumerate(mid.object.Kept, start=1) if kept] == [number]
        mid.only(sheet.name)
        assert [k for k, kept in enumerate(mid.object.Kept, start=1) if kept] == [number]


def test_what_a_macro_recorder_writes_replays(mid):
    sheet = mid.sheets[between(mid, *EDGE) - 1]
    line = f"mid.keep(faces={sheet.faces!r}, at={sheet.foot!r})"
    mid.keep(sheet.name)
    by_hand = state(mid.object)
    mid.automatic()
    macro = ["import HybridVolume", "mid = HybridVolume.edit_midstructure(obj)", line]
    exec("\n".join(macro), {"obj": mid.object})
    assert state(mid.object) == by_hand


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda mid: mid.remove("Sheet99"), r"no sheet Sheet99; the largest are Sheet1 \(Face"),
        (lambda mid: mid.remove("Sheet0"), "no sheet Sheet0"),
        (lambda mid: mid.keep(faces=("Face1", "Face9")), r"no sheet Face1\+Face9; the largest"),
        (lambda mid: mid.keep("Sheet1", "Sheet99"), "no sheet Sheet99"),
        (lambda mid: mid.remove("nonsense"), "names no sheet"),
        (lambda mid: mid.remove(), "no sheet is named"),
        (lambda mid: mid.only(at=(0.5, 0.5)), "a place without faces"),
        (lambda mid: mid.only(faces=OPPOSITE, at=(2.0, 0.5)), "no place on Face5"),
        (lambda mid: mid.only(faces="Face5"), "no pair of faces"),
        (lambda mid: mid.set(angle=20.0), "angle is 20; choose a value from 60 to 179"),
        (lambda mid: mid.set(method="magic"), "no kind of midstructure"),
        (lambda mid: mid.set(depth="deep"), "no depth"),
        (lambda mid: mid.set(colour=3), "no parameter colour"),
        (lambda mid: HybridVolume.edit_midstructure(mid.object.InList[0].Source), "no midstruct"),
    ],
)
def test_refused_and_nothing_changed(doc, mid, call, told):
    before = state(mid.object)
    with pytest.raises(InputError, match=told):
        call(mid)
    assert state(mid.object) == before and doc.UndoCount == 0


def test_what_the_choice_does_to_the_shell(volume, mid):
    # half the way to the sheet in the middle, 0.5 below the large faces
    hints, exact = mid.hints(0.5), mid.thickness(0.5)
    assert hints.pieces == 1 and hints.unreached == ()
    assert hints.thinnest == pytest.approx(0.25, abs=0.02)
    assert exact["min"] == pytest.approx(0.25, abs=0.02) and exact["w0"] == 0.5
    large = {part["face"]: part["mean"] for part in exact["faces"]}
    assert all(large[name] < large["Face1"] for name in OPPOSITE)
    assert volume.Document.UndoCount == 0 and volume.Status == "Not computed"


def test_a_property_changed_by_hand_chooses_again(doc, mid):
    mid.object.Decisions = ["remove Face5+Face6"]
    doc.recompute()
    assert not any(mid.object.Kept)
    mid.object.Decisions = ["forget Face5+Face6"]
    doc.recompute()
    assert mid.object.Status.startswith("Failed: 'forget' decides nothing")
    mid.object.Decisions = []
    doc.recompute()
    assert mid.object.Status == "Up to date" and mid.object.Kept[0]


# --------------------------------------------------------------------- other body, other file


def test_the_search_is_out_of_date_until_it_is_done_again(doc, volume, mid):
    obj = mid.object
    mid.set(samples=4000)
    assert obj.Status == "Out of date: Samples changed"
    mid.set(samples=3000)
    assert obj.Status == "Up to date"
    mid.set(method="distance")
    assert obj.Status == "Out of date: Method changed"
    mid.set(method="medial-axis", depth="20%")
    assert obj.Status == "Up to date"
    volume.Source.Height = 1.2
    doc.recompute()
    assert obj.Status == "Out of date: the body changed"


def test_decisions_are_replayed_on_a_changed_body(doc, volume, mid):
    obj, edge = mid.object, between(mid, *EDGE)
    mid.keep(f"Sheet{edge}")
    box = volume.Source
    box.Length, box.Height = 5, 1.2
    doc.recompute()
    mid.find()
    assert obj.Unmatched == [] and obj.Status == "Up to date"
    assert obj.Kept.count(True) == 2 and obj.Kept[between(mid, *EDGE) - 1]
    assert area(obj) == pytest.approx(3.8 * 0.8 + edge_area(5.0, 1.2), rel=0.03)


def test_decisions_that_fit_no_more_are_listed(doc, volume, mid):
    obj = mid.object
    place = "Face1+Face9@0.5,0.5"
    obj.Decisions = ["remove Face5+Face6", f"keep {place}"]
    mid.find()
    assert obj.Unmatched == [f"keep {place}"]
    assert obj.Status == "Nothing is kept: keep a sheet"
    mid.keep("Sheet1")
    assert obj.Status == f"Up to date, but no sheet fits: keep {place}"
    # it may fit again: it stays
    assert f"keep {place}" in obj.Decisions


def test_an_l_bracket_keeps_its_decision(doc):
    """The sheet between the two L faces, eroded by half the height, of an L of area 3."""

    def bracket(height):
        corners = [(0, 0), (1, 0), (0, 1)]
        squares = [[(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)] for x, y in corners]
        return to_part_solid(prism(squares, height, 3.0 * height, name="L"))

    def eroded(d):
        return 3.0 - 8.0 * d + 5.0 * d**2 - 0.25 * math.pi * d**2

    body = doc.addObject("Part::Feature", "L")
    body.Shape = bracket(0.4)
    volume = volumes.start(doc, body)
    mid = HybridVolume.edit_midstructure(volume)
    mid.set(samples=3000)
    mid.find()
    middle = mid.sheets[0]
    assert area(mid.object) == pytest.approx(eroded(0.2), rel=0.02)
    mid.only(middle.name)
    body.Shape = bracket(0.3)
    doc.recompute()
    mid.find()
    assert mid.object.Unmatched == [] and mid.object.Kept[0]
    assert mid.object.Kept.count(True) == 1
    assert area(mid.object) == pytest.approx(eroded(0.15), rel=0.02)


def test_saved_and_reopened(doc, volume, mid, tmp_path):
    mid.keep(faces=EDGE)
    mid.set(angle=130.0, minimum_size=0.5)
    before, kept_area = state(mid.object), area(mid.object)
    path = tmp_path / "saved.FCStd"
    doc.saveAs(str(path))
    FreeCAD.closeDocument(doc.Name)
    again = FreeCAD.openDocument(str(path), hidden=True)
    try:
        obj = again.getObject("Midstructure")
        assert state(obj) == before and area(obj) == kept_area
        again.recompute(None, True)
        assert state(obj) == before
        mid = HybridVolume.edit_midstructure(again.getObject("HybridVolume"))
        mid.automatic()
        assert obj.Kept.count(True) == 1
    finally:
        FreeCAD.closeDocument(again.Name)


class OldMidstructure(DocumentObject):
    """The properties of version 1."""

    Type = "HybridVolume::Midstructure"
    PROPERTIES = {
        "Method": Property(
            "App::PropertyEnumeration", "Search", "", choices=("auto", "medial-axis")
        ),
        "MethodUsed": Property("App::PropertyString", "Found", "", mode=("ReadOnly",)),
        "Decisions": Property("App::PropertyStringList", "Found", "", mode=("ReadOnly",)),
        "Facets": Property("App::PropertyFileIncluded", "Found", "", mode=("ReadOnly", "Hidden")),
        "Status": Property("App::PropertyString", "Base", "", mode=("ReadOnly",)),
    }


def test_a_document_of_version_1_opens(doc, box, tmp_path, monkeypatch):
    box.Length, box.Width, box.Height = SIZE
    doc.recompute()
    volume = volumes.make_volume(doc)
    document.insert(doc, box, [document.Prepared(completed(box, tmp_path))], volume)
    # the object as version 1 wrote it, under the class's present name
    doc.removeObject(volume.Midstructure.Name)
    old = doc.addObject("App::FeaturePython", "Midstructure")
    OldMidstructure(old)
    old.Method, old.MethodUsed, old.Status = "medial-axis", "medial-axis", "Up to date"
    old.Decisions = ["kept Face5+Face6 @ 1.5 1 0.5"]
    np.savez(tmp_path / "facets.npz", vertices=np.eye(3), facets=[[0, 1, 2]], kept=[True])
    old.Facets = (str(tmp_path / "facets.npz"), "Midstructure_Facets.npz")
    proxy = midstructure.MidstructureObject.__new__(midstructure.MidstructureObject)
    old.Proxy = proxy
    volume.Midstructure = old
    volume.ComputedFrom = {
        name: value
        for name, value in volume.ComputedFrom.items()
        if not name.startswith("Midstructure.") or name == "Midstructure.Method"
    }
    path = tmp_path / "old.FCStd"
    doc.saveAs(str(path))
    FreeCAD.closeDocument(doc.Name)
    again = FreeCAD.openDocument(str(path), hidden=True)
    try:
        obj, volume = again.getObject("Midstructure"), again.getObject("HybridVolume")
        assert obj.SchemaVersion == 2 and obj.Method == "medial-axis"
        assert obj.Decisions == [] and obj.Kept == () and chosen(obj) is None
        assert obj.Status == "Not found: computed by an earlier version; find it again"
        again.recompute(None, True)
        assert volume.Status == "Out of date: computed by an earlier version"
        assert volume.FemMesh.FemMesh.VolumeCount == 24
        mid = HybridVolume.edit_midstructure(volume)
        mid.set(samples=3000)
        mid.find()
        mid.remove("Sheet1")
        assert obj.Status == "Nothing is kept: keep a sheet"
    finally:
        FreeCAD.closeDocument(again.Name)


# --------------------------------------------------------------------------------- macros


def test_decisions_in_a_macro():
    body = Part.makeBox(4, 2, 1)
    names = ["only Face4+Face5"]
    found = HybridVolume.find_midstructure(body, samples=3000, decisions=names)
    assert found.area == pytest.approx(edge_area(4.0, 1.0), rel=0.08)
    with pytest.raises(InputError, match=r"Face1\+Face9: no such sheet; the largest"):
        HybridVolume.find_midstructure(body, samples=3000, decisions=["keep Face1+Face9"])
    with pytest.raises(HybridVolumeError, match="nothing is left of the midstructure"):
        HybridVolume.complete(body, samples=3000, decisions=["remove Face5+Face6"])
