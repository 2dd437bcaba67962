# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The inner boundary in a document: no figures of its own, only the stored result's."""

from dataclasses import replace

import numpy as np
import pytest

from HybridVolume.errors import FileFormatError, InputError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

from box_mesh import box_mesh
from made_by_hand import SIZE, completed, face_names
from shells import make_shell

from HybridVolume.core.hybrid import HybridVolume
from HybridVolume.core.reached import inner_figures
from HybridVolume.core.validity import certify
from HybridVolume.objects import document
from HybridVolume.objects.inner import stored_volume, volume_of
from HybridVolume.objects.volume import make_volume as make_volume_object
from HybridVolume.objects.volume import set_status


@pytest.fixture
def doc():
    doc = FreeCAD.newDocument("test", hidden=True, temp=True)
    doc.UndoMode = 1
    name = doc.Name
    yield doc
    if name in FreeCAD.listDocuments():
        FreeCAD.closeDocument(name)


def result_of(box, number):
    """A result with a shell and a certificate; of core and midstructure nothing is looked at."""
    shell = make_shell("box")
    # nodes of the outer boundary: without any, reading would look for them at the interface
    fem = replace(box_mesh(SIZE, face_names(box.Shape)), surface_nodes=np.arange(8))
    certificate = certify(shell.bezier_elements())
    return HybridVolume(
        *(shell.surface, None, {}, shell, certificate, None, None, fem, 0.0, {"number": number})
    )


def prepared(box, folder, volume):
    folder.mkdir()
    one = completed(box, folder)
    volume.save(folder / "volume.npz")
    return document.Prepared(replace(one, result=folder / "volume.npz"))


@pytest.fixture
def box(doc):
    box = doc.addObject("Part::Box", "Box")
    box.Length, box.Width, box.Height = SIZE
    doc.recompute()
    doc.clearUndos()
    return box


def test_from_result_to_result(doc, box, tmp_path):
    first, second = result_of(box, 1), result_of(box, 2)
    (obj,) = document.insert(doc, box, [prepared(box, tmp_path / "first", first)])
    inner = obj.InnerBoundary
    assert inner.Proxy.Type == "HybridVolume::InnerBoundary" and volume_of(inner) is obj
    assert inner.Status == obj.Status == "Up to date"
    # no property holds figures: all are in the volume's file
    kinds = {inner.getTypeIdOfProperty(name) for name in inner.PropertiesList}
    assert not {kind for kind in kinds if "File" in kind or "FloatList" in kind}

    found = stored_volume(obj)
    assert found is not first and found.report == {"number": 1}
    assert found.shell.layers.tobytes() == first.shell.layers.tobytes()
    assert stored_volume(obj) is found
    # columns go half-way to the middle of a box of 3 x 2 x 1: the inner boundary is a quarter
    # below the lid, and half-way up it is half from the lid
    figures = inner_figures(found.shell)
    assert figures.thickness.min() == pytest.approx(0.25, rel=0.01)
    assert figures.thickness.max() == pytest.approx(0.5, rel=0.01)
    assert np.ptp(figures.vertices, axis=0) == pytest.approx([1.5, 1.0, 0.5], rel=0.01)

    document.insert(doc, box, [prepared(box, tmp_path / "second", second)], obj)
    assert obj.InnerBoundary is inner and stored_volume(obj).report == {"number": 2}
    doc.undo()
    assert stored_volume(obj).report == {"number": 1}
    box.Height = 2.0
    doc.recompute()
    assert inner.Status == "Out of date: the body changed"

    path = tmp_path / "saved.FCStd"
    doc.saveAs(str(path))
    FreeCAD.closeDocument(doc.Name)
    again = FreeCAD.openDocument(str(path), hidden=True)
    try:
        obj = again.HybridVolume
        assert volume_of(again.InnerBoundary) is obj
        assert again.InnerBoundary.Status == "Out of date: the body changed"
        assert stored_volume(obj).shell.layers.tobytes() == first.shell.layers.tobytes()
    finally:
        FreeCAD.closeDocument(again.Name)


def test_undo_takes_it_away(doc, box, tmp_path):
    document.insert(doc, box, [prepared(box, tmp_path / "first", result_of(box, 1))])
    doc.undo()
    assert [obj.Name for obj in doc.Objects] == ["Box"]


def test_documents_of_earlier_versions(doc, box, tmp_path):
    volume = result_of(box, 1)
    (obj,) = document.insert(doc, box, [prepared(box, tmp_path / "first", volume)])
    doc.removeObject(obj.InnerBoundary.Name)
    obj.removeProperty("InnerBoundary")
    obj.Proxy.onDocumentRestored(obj)
    assert obj.InnerBoundary is None and stored_volume(obj).report == {"number": 1}
    set_status(obj, "Out of date")
    document.insert(doc, box, [prepared(box, tmp_path / "second", volume)], obj)
    assert volume_of(obj.InnerBoundary) is obj and obj.InnerBoundary.Status == "Up to date"


def test_no_result(doc, box, tmp_path):
    obj = make_volume_object(doc)
    with pytest.raises(InputError, match="no result yet"):
        stored_volume(obj)
    # the box made by hand has a file that is no result
    (obj,) = document.insert(doc, box, [document.Prepared(completed(box, tmp_path))])
    with pytest.raises(FileFormatError, match="not a hybrid volume"):
        stored_volume(obj)
