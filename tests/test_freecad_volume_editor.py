# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What macros set and compute on hybrid volumes of a document."""

import pytest

from HybridVolume.errors import InputError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import HybridVolume
from HybridVolume.objects.thickness import relevant, values_of
from HybridVolume.objects.volume import current_parameters, options_of, start
from HybridVolume.objects.volume_editor import changed_parameters, keywords_of


@pytest.fixture
def volume():
    doc = FreeCAD.newDocument("test", hidden=True, temp=True)
    doc.UndoMode = 1
    box = doc.addObject("Part::Box", "Box")
    doc.recompute()
    made = start(doc, box)
    name = doc.Name
    yield made
    FreeCAD.closeDocument(name)


def test_values_as_one_step_of_undo(volume):
    doc, before = volume.Document, values_of(volume)
    HybridVolume.edit_volume(volume).set(
        thickness="mean 2 mm", face_factors={"Face3": 1.5}, spacing="first 0.2 mm", layers=5
    )
    assert relevant(values_of(volume)) == {
        "ThicknessKind": "Mean",
        "Thickness": "2",
        "FaceFactors": "Face3 = 1.5",
        "Method": "certified",
        "Layers": "5",
        "Spacing": "First layer",
        "FirstLayer": "0.2",
        "Degree": "3",
    }
    assert doc.UndoNames[0] == "Shell thickness"
    options = options_of(current_parameters(volume))
    assert options["thickness"] == "mean 2 mm" and options["face_factors"] == {"Face3": 1.5}
    HybridVolume.edit_volume(volume).set(thickness="30 %")
    # what is not named stays
    assert values_of(volume)["FaceFactors"] == ("Face3 = 1.5",) and volume.Share == 30.0
    doc.undo()
    doc.undo()
    assert values_of(volume) == before


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"thickness": "2 furlongs"}, "furlongs"),
        ({"thickness": "1.5"}, "1.5"),
        ({"face_factors": {"Face3": 100.0}}, "Face3"),
        ({"spacing": "ratio 50"}, "50"),
        ({"span_size": -1.0}, "-1 mm"),
        ({"span_aspect": 1.5}, "1.5"),
        ({"span_turn": "much"}, "much"),
        ({"order": 3}, "3"),
        ({"midstructure": "bones"}, "bones"),
        ({"size": -1.0}, "-1 mm"),
        ({"face_sizes": {"Face3": 0.0}}, "Face3"),
        ({"fem_layers": 101}, "101"),
        ({"subdivide": "many"}, "many"),
        ({"nodes": "greville", "size": 1.0}, "Greville"),
        ({"thicknes": "2 mm"}, "thicknes"),
    ],
)
def test_values_that_are_refused(volume, values, word):
    doc, before, steps = volume.Document, values_of(volume), volume.Document.UndoCount
    with pytest.raises(InputError, match=word):
        HybridVolume.edit_volume(volume).set(**values)
    with pytest.raises(InputError, match=word):
        HybridVolume.edit_volume(volume.Source).complete(**values)
    assert values_of(volume) == before and doc.UndoCount == steps
    assert not doc.HasPendingTransaction


def test_keywords_and_parameters_are_one(volume):
    given = {
        "thickness": "min 0.125 mm",
        "face_factors": {"Face1": 0.5, "Face6": 2.0},
        "layers": 3,
        "degree": 2,
        "spacing": "ratio 1.25",
        "span_size": 1.5,
        "span_aspect": 4.0,
        "span_turn": 25.0,
        "cover_tolerance": 0.0625,
        "order": 1,
        "nodes": "knots",
        "subdivide": 2,
        "size": 0.75,
        "face_sizes": {"Face2": 0.125},
        "gradation": 0.25,
        "fem_layers": 4,
        "growth": 1.5,
    }
    parameters = HybridVolume.edit_volume(volume).parameters(**given)
    assert keywords_of(parameters) == given
    assert changed_parameters() == {}


def test_bodies_without_a_volume(volume):
    editor = HybridVolume.edit_volume(volume.Source)
    assert editor.volume is None and editor.source is volume.Source
    with pytest.raises(InputError, match="has no hybrid volume"):
        editor.set(layers=3)
    volume.Source = None
    with pytest.raises(InputError, match="has no body"):
        HybridVolume.edit_volume(volume)


def test_a_solid_that_is_gone(volume):
    volume.Solid = 2
    with pytest.raises(InputError, match="no solid 2"):
        HybridVolume.edit_volume(volume).complete()
    assert not volume.Result
