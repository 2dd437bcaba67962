# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What macros set on the mesh of a document, and what is refused before any work."""

import pytest

from HybridVolume.errors import InputError, OutOfDateError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

from made_by_hand import completed

import HybridVolume
from HybridVolume.core.density import Density
from HybridVolume.objects import document
from HybridVolume.objects.mesh_editor import MeshEditor
from HybridVolume.objects.volume import remesh_suffices, start


@pytest.fixture
def volume(tmp_path):
    doc = FreeCAD.newDocument("test", hidden=True, temp=True)
    doc.UndoMode = 1
    box = doc.addObject("Part::Box", "Box")
    box.Length, box.Width, box.Height = 3, 2, 1
    doc.recompute()
    (made,) = document.insert(doc, box, [document.Prepared(completed(box, tmp_path))])
    doc.clearUndos()
    name = doc.Name
    yield made
    FreeCAD.closeDocument(name)


def test_values_as_one_step_of_undo(volume):
    doc, mesh = volume.Document, volume.FemMesh
    editor = MeshEditor(mesh)
    assert editor.volume is volume and editor.wanted() == (Density(), 2)
    editor.set(size=0.5, face_sizes={"Face2": 0.125}, order=1)
    assert doc.UndoNames == ["Density of the mesh"]
    assert (mesh.Order, mesh.Size.Value, mesh.FaceSizes) == ("First", 0.5, ["Face2 = 0.125 mm"])
    assert volume.Status.startswith("Out of date: FemMesh.") and remesh_suffices(volume)
    # what is not named stays
    wanted = Density(size=0.5, face_sizes={"Face2": 0.125}, layers=4)
    assert MeshEditor(volume.Source).wanted(fem_layers=4) == (wanted, 1)
    job = editor.job(*editor.wanted(fem_layers=4), python="/nowhere")
    assert job.goal == "mesh" and job.volume == volume.Result
    options = {"order": 1, "engine": "auto", "nodes": "knots", "subdivide": 1, "size": 0.5}
    options |= {"face_sizes": {"Face2": 0.125}, "gradation": 0.5, "fem_layers": 4, "growth": 1.3}
    assert job.options == options
    doc.undo()
    assert (mesh.Order, mesh.Size.Value, list(mesh.FaceSizes)) == ("Second", 0.0, [])
    assert volume.Status == "Up to date" and editor.wanted() == (Density(), 2)


def test_refusals_leave_the_document_alone(volume):
    for values, told in (
        ({"size": -1.0}, "-1 mm"),
        ({"layers": 2}, "no such value: layers"),
        ({"order": 0}, "order is 0; choose 1 or 2"),
        ({"nodes": "greville", "size": 1.0}, "have no size"),
    ):
        for method in (MeshEditor(volume).set, lambda **v: HybridVolume.remesh(volume, **v)):
            with pytest.raises(InputError, match=told):
                method(**values)
    assert volume.Document.UndoCount == 0 and volume.Status == "Up to date"


def test_a_body_that_changed_is_told_before_any_work(volume):
    volume.Source.Height = 1.5
    volume.Document.recompute()
    with pytest.raises(OutOfDateError, match="the body changed; complete the hybrid volume again"):
        HybridVolume.remesh(volume, subdivide=2, python="/bin/false")


def test_what_has_no_mesh(volume):
    doc = volume.Document
    with pytest.raises(InputError, match="Cylinder has no hybrid volume"):
        MeshEditor(doc.addObject("Part::Cylinder", "Cylinder"))
    with pytest.raises(InputError, match="has no result yet; complete the volume first"):
        HybridVolume.remesh(start(doc, volume.Source))
