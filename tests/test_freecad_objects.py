# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Document objects in FreeCAD without a window, on a mesh made by hand."""

import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from box_mesh import box_mesh

from HybridVolume.errors import FaultError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Fem
import Part
from made_by_hand import SIZE, completed, face_names

import HybridVolume
from HybridVolume.core.element_jacobians import scaled_jacobian
from HybridVolume.core.pipeline import METHODS, Options
from HybridVolume.objects import document, fem_mesh
from HybridVolume.objects.midstructure import chosen
from HybridVolume.objects.thickness import (
    DEFAULTS,
    KINDS,
    PROPERTIES,
    SELECTORS,
    SPACINGS,
    spacing_of,
    spacing_parameters,
    thickness_of,
    thickness_parameters,
)
from HybridVolume.objects.volume import CHILDREN, current_parameters, options_of
from HybridVolume.sources.fingerprint import fingerprint


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
    box.Length, box.Width, box.Height = SIZE
    doc.recompute()
    doc.clearUndos()
    return box


@pytest.fixture
def volume(doc, box, tmp_path):
    (volume,) = document.insert(doc, box, [document.Prepared(completed(box, tmp_path))])
    return volume


def groups(mesh):
    return {mesh.getGroupName(g): len(mesh.getGroupElements(g)) for g in mesh.Groups}


EXPECTED_GROUPS = {"Shell": 12, "Core": 12, "Interface": 26} | {f"Face{i}": 2 for i in range(1, 7)}


def test_one_step_of_undo(doc, box, volume):
    names = {obj.Name for obj in doc.Objects}
    assert names == {"Box", "HybridVolume", *CHILDREN}
    assert volume.Status == "Up to date" and volume.FemMesh.Status == "Up to date"
    assert doc.UndoCount == 1
    doc.undo()
    assert [obj.Name for obj in doc.Objects] == ["Box"]
    doc.redo()
    assert {obj.Name for obj in doc.Objects} == names
    assert groups(doc.FemMesh.FemMesh) == EXPECTED_GROUPS
    with np.load(doc.HybridVolume.Result) as stored:
        assert np.array_equal(stored["stored"], np.arange(5.0))


def test_a_fault_leaves_the_document_as_it_was(doc, box, tmp_path):
    prepared = document.Prepared(completed(box, tmp_path))
    prepared.report["shell"] = {}
    with pytest.raises(KeyError):
        document.insert(doc, box, [prepared])
    assert [obj.Name for obj in doc.Objects] == ["Box"]
    assert doc.UndoCount == 0


def test_saved_and_reopened(doc, box, volume, tmp_path):
    nodes = np.array([tuple(p) for p in volume.FemMesh.FemMesh.Nodes.values()])
    path = tmp_path / "saved.FCStd"
    doc.saveAs(str(path))
    FreeCAD.closeDocument(doc.Name)
    again = FreeCAD.openDocument(str(path), hidden=True)
    try:
        volume = again.getObject("HybridVolume")
        assert volume.Proxy.Type == "HybridVolume::Volume"
        assert volume.Source.Name == "Box" and volume.SchemaVersion == 3
        again.recompute(None, True)
        assert volume.Status == "Up to date"
        assert groups(volume.FemMesh.FemMesh) == EXPECTED_GROUPS
        stored = np.array([tuple(p) for p in volume.FemMesh.FemMesh.Nodes.values()])
        assert np.array_equal(np.unique(stored, axis=0), np.unique(nodes, axis=0))
        assert volume.Shell.FemMesh.VolumeCount == volume.Core.FemMesh.VolumeCount == 12
        assert chosen(volume.Midstructure).kept.tolist() == [True]
        assert volume.Midstructure.Kept == (True,) and volume.Midstructure.Decisions == []
        assert volume.Report["shell.elements"] == "6"
    finally:
        FreeCAD.closeDocument(again.Name)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda volume: setattr(volume, "W0", 0.3), "Out of date: W0 changed"),
        (lambda volume: setattr(volume.Source, "Height", 1.1), "Out of date: the body changed"),
        (
            lambda volume: setattr(
                volume.Source, "Placement", FreeCAD.Placement(FreeCAD.Vector(1, 0, 0), _STRAIGHT)
            ),
            "Out of date: the body changed",
        ),
        (
            lambda volume: setattr(volume.FemMesh, "Order", "First"),
            "Out of date: FemMesh.Order changed",
        ),
        (
            lambda volume: setattr(volume.Midstructure, "Method", "medial-axis"),
            "Out of date: Midstructure.Method changed",
        ),
        (
            lambda volume: setattr(volume.Midstructure, "Method", "distance"),
            "Out of date: Midstructure.Method changed",
        ),
        (
            lambda volume: setattr(volume.Midstructure, "Angle", 140.0),
            "Out of date: Midstructure.Angle changed",
        ),
        (
            lambda volume: setattr(volume, "ThicknessKind", "Even"),
            "Out of date: ThicknessKind changed",
        ),
        (
            lambda volume: setattr(volume, "FaceFactors", ["Face3 = 1.5"]),
            "Out of date: FaceFactors changed",
        ),
        (lambda volume: setattr(volume, "Spacing", "Ratio"), "Out of date: Spacing changed"),
        (lambda volume: setattr(volume, "Method", "paper"), "Out of date: Method changed"),
        (lambda volume: setattr(volume, "SpanSize", "2 cm"), "Out of date: SpanSize changed"),
        (
            lambda volume: setattr(volume, "SpanAspect", 1.5),
            "Failed: the aspect of spans is 1.5; choose 2 or more, or 0 for as needed",
        ),
        # a level is asked for, and layers of equal volume: these lengths count for nothing
        (lambda volume: setattr(volume, "Thickness", 7.0), "Up to date"),
        (lambda volume: setattr(volume, "FirstLayer", 7.0), "Up to date"),
        # the medial axis knows no depth
        (lambda volume: setattr(volume.Midstructure, "Depth", "20%"), "Up to date"),
    ],
)
def test_a_recompute_only_marks(doc, volume, change, told):
    result = volume.Result
    change(volume)
    doc.recompute()
    assert volume.Status == told and volume.Shell.Status == told
    assert volume.Result == result and volume.FemMesh.FemMesh.VolumeCount == 24


_STRAIGHT = FreeCAD.Rotation()


def test_thickness_in_the_property_editor(doc, volume):
    def shown():
        names = {
            name for choices in SELECTORS.values() for names in choices.values() for name in names
        }
        return {name for name in names if "Hidden" not in volume.getEditorMode(name)}

    assert shown() == {"W0"}
    doc.openTransaction("thickness")
    volume.ThicknessKind = "Minimum"
    volume.Thickness = "2 mm"
    volume.FaceFactors = ["Face3 = 1.5", "", "Face1=0.5"]
    volume.Spacing = "First layer"
    volume.FirstLayer = "0.25 mm"
    doc.commitTransaction()
    assert shown() == {"Thickness", "FirstLayer"}
    options = options_of(current_parameters(volume))
    assert options["thickness"] == "min 2 mm" and options["spacing"] == "first 0.25 mm"
    assert options["face_factors"] == {"Face3": 1.5, "Face1": 0.5}
    goal = Options(**options).goal
    assert (goal.kind, goal.value, goal.factors) == ("min", 2.0, {"Face3": 1.5, "Face1": 0.5})
    volume.ThicknessKind, volume.Share = "Share of radius", 30.0
    assert Options(**options_of(current_parameters(volume))).goal.text == "30 %"
    doc.recompute()
    assert volume.Status == "Out of date: FaceFactors, Spacing, ThicknessKind changed"
    volume.FaceFactors = ["Face3 is thick"]
    doc.recompute()
    assert volume.Status.startswith("Failed: 'Face3 is thick' is no factor of a face; write it as")
    doc.undo()
    doc.recompute()
    assert volume.Status == "Up to date" and shown() == {"W0"} and volume.FaceFactors == []


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("spacing", SPACINGS)
def test_values_and_what_they_ask_for(kind, spacing):
    values = {**DEFAULTS, "ThicknessKind": kind, "Spacing": spacing, "FaceFactors": ("Face2 = 3",)}
    again = {
        **DEFAULTS,
        **thickness_parameters(thickness_of(values)),
        **spacing_parameters(spacing_of(values)),
    }
    assert again == values


def test_method_has_the_choices_of_the_pipeline():
    assert PROPERTIES["Method"].choices == METHODS


def test_reached_thickness_in_the_document(doc, box, tmp_path):
    one = completed(box, tmp_path)
    figures = {"min": 1.2, "mean": 1.71, "max": 2.1}
    row = {"face": "Face3", "w0": {"min": 0.3, "mean": 0.48, "max": 0.5}, "thickness": figures}
    told = (
        "asked 2 mm, reached 1.71 mm in the mean (1.2 to 2.1); thinner than asked at Face3 (86 %)"
    )
    shell = {**one.report["shell"], "thickness": figures, "faces": [row], "sentence": told}
    one = replace(one, report={**one.report, "shell": shell})
    (volume,) = document.insert(doc, box, [document.Prepared(one)])
    assert volume.ThicknessReached == told
    assert volume.FaceThickness == {"Face3": "1.71 mm (1.2 to 2.1), w0 0.48 (0.3 to 0.5)"}


def test_a_document_of_the_first_version_is_still_up_to_date(doc, volume, tmp_path):
    older = {name: text for name, text in volume.ComputedFrom.items()
             if name in ("W0", "Layers", "Degree", "Tolerance", "Source", "FemMesh.Order",
                         "FemMesh.Density") or name.startswith("Midstructure.")}  # fmt: skip
    assert len(older) < len(volume.ComputedFrom)
    volume.ComputedFrom = older
    for name in ("ThicknessKind", "Thickness", "Share", "FaceFactors", "Method", "Spacing",
                 "LayerRatio", "FirstLayer", "ThicknessReached", "FaceThickness"):  # fmt: skip
        volume.removeProperty(name)
    for name in ("Subdivide", "Size", "FaceSizes", "Gradation", "Layers", "Growth"):
        volume.FemMesh.removeProperty(name)
    volume.SchemaVersion = volume.FemMesh.SchemaVersion = 1
    path = tmp_path / "older.FCStd"
    doc.saveAs(str(path))
    FreeCAD.closeDocument(doc.Name)
    again = FreeCAD.openDocument(str(path), hidden=True)
    try:
        volume = again.getObject("HybridVolume")
        again.recompute(None, True)
        assert volume.SchemaVersion == 3 and volume.Status == "Up to date"
        assert volume.FemMesh.SchemaVersion == 2 and volume.FemMesh.Subdivide == 1
        assert volume.ThicknessKind == "Level w0" and volume.W0 == 0.4
        volume.FaceFactors = ["Face3 = 1.5"]
        again.recompute()
        assert volume.Status == "Out of date: FaceFactors changed"
        again.save()
        FreeCAD.closeDocument(again.Name)
        again = FreeCAD.openDocument(str(path), hidden=True)
        assert again.getObject("HybridVolume").FaceFactors == ["Face3 = 1.5"]
    finally:
        FreeCAD.closeDocument(again.Name)


def test_a_fingerprint_survives_a_file_and_sees_a_moved_pole(doc, tmp_path):
    surface = Part.Face(Part.makePlane(2, 1).toNurbs().Faces[0].Surface).Surface
    surface.increaseDegree(3, 3)
    body = doc.addObject("Part::Feature", "Face")
    body.Shape = surface.toShape()
    before = fingerprint(body.Shape)
    body.Shape.tessellate(0.01)
    assert fingerprint(body.Shape) == before
    doc.saveAs(str(tmp_path / "face.FCStd"))
    again = FreeCAD.openDocument(str(tmp_path / "face.FCStd"), hidden=True)
    assert fingerprint(again.getObject("Face").Shape) == before
    surface.setPole(2, 2, surface.getPole(2, 2) + FreeCAD.Vector(0, 0, 1e-6))
    assert fingerprint(surface.toShape()) != before


def test_volume_by_freecad(volume):
    # FreeCAD's own integral, which is meaningful for ten-node tets only
    assert volume.Core.FemMesh.Volume.getValueAs("mm^3").Value == pytest.approx(6 * 0.6**3)


def test_quality_survives_freecad(volume):
    stored = volume.FemMesh.FemMesh
    (shell,) = [g for g in stored.Groups if stored.getGroupName(g) == "Shell"]
    quality = fem_mesh.element_quality(stored)
    fem = box_mesh(SIZE, [f"Face{i}" for i in range(1, 7)])
    expected = scaled_jacobian("penta15", fem.nodes[fem.wedges])
    found = [quality[element] for element in stored.getGroupElements(shell)]
    assert np.allclose(found, expected, atol=1e-12) and len(quality) == 24
    # the box's core is not to be seen
    seen = fem_mesh.element_quality(stored, outer=True)
    assert set(seen) == set(stored.getGroupElements(shell))
    assert seen == {element: quality[element] for element in seen}
    core = volume.Core.FemMesh
    assert fem_mesh.element_quality(core, outer=True) == fem_mesh.element_quality(core)


def test_a_lost_element_is_noticed(box, monkeypatch):
    arrays = fem_mesh.arrays_of(box_mesh(SIZE, face_names(box.Shape)))

    class Forgetful:
        def __init__(self, make=Fem.FemMesh):
            self.mesh = make()

        def addVolume(self, row, number):
            if number % 7:
                self.mesh.addVolume(row, number)

        def __getattr__(self, name):
            return getattr(self.mesh, name)

    monkeypatch.setattr(fem_mesh.Fem, "FemMesh", Forgetful)
    with pytest.raises(FaultError, match="20 volumes, not 24"):
        fem_mesh.build(arrays)


def test_to_fem_puts_a_mesh_into_a_document(doc, box):
    volume = SimpleNamespace(fem=box_mesh(SIZE, face_names(box.Shape), order=1))
    mesh = HybridVolume.to_fem(volume, doc, order=1, body=box)
    assert mesh.Shape is box and mesh.Order == "First"
    assert groups(mesh.FemMesh) == EXPECTED_GROUPS | {"Interface": 8}


@pytest.mark.skipif(not shutil.which("ccx"), reason="needs ccx")
def test_calculix_pulls_the_box(doc, box, volume, tmp_path):
    """A bar under tension between two opposite faces: stress and elongation are known."""
    import ObjectsFem
    from femtools import ccxtools

    analysis = ObjectsFem.makeAnalysis(doc)
    make = getattr(ObjectsFem, "makeSolverCalculixCcxTools", None)
    solver = (make or ObjectsFem.makeSolverCalculiXCcxTools)(doc)
    solver.GeometricalNonlinearity = "linear"
    material = ObjectsFem.makeMaterialSolid(doc)
    material.Material = {
        "Name": "m",
        "YoungsModulus": "1000 MPa",
        "PoissonRatio": "0",
        "Density": "1 kg/m^3",
    }
    names = face_names(box.Shape)
    fixed = ObjectsFem.makeConstraintFixed(doc)
    fixed.References = [(box, names[0])]
    force = ObjectsFem.makeConstraintForce(doc)
    force.References = [(box, names[1])]
    force.Force = 10.0 if FreeCAD.Version()[0] == "0" else "10 N"
    force.Direction = (box, ["Edge1"])
    force.DirectionVector = FreeCAD.Vector(1, 0, 0)
    analysis.addObjects([solver, material, fixed, force, volume.FemMesh])
    doc.recompute()
    run = ccxtools.FemToolsCcx(analysis, solver, test_mode=False)
    run.update_objects()
    run.setup_working_dir(str(tmp_path))
    run.setup_ccx()
    assert run.check_prerequisites() == ""
    run.purge_results()
    run.write_inp_file()
    run.ccx_run()
    assert run.results_present is False
    run.load_results()
    (result,) = [obj for obj in analysis.Group if obj.isDerivedFrom("Fem::FemResultObject")]
    ends = [
        abs(d.x)
        for node, d in zip(result.NodeNumbers, result.DisplacementVectors, strict=True)
        if abs(result.Mesh.FemMesh.Nodes[node].x - SIZE[0]) < 1e-9
    ]
    # F L / (E A), with Poisson's ratio 0 exactly the same at every node
    assert np.mean(ends) == pytest.approx(10.0 * 3.0 / (1000.0 * 2.0), rel=0.01)


def test_importing_the_package_loads_nothing():
    code = (
        "import sys, HybridVolume; print(*(m for m in sys.modules if 'numpy' in m or 'Free' in m))"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert answer.stdout.strip() == ""
    assert set(HybridVolume.__all__) <= set(dir(HybridVolume))
    with pytest.raises(AttributeError):
        HybridVolume.no_such_function  # noqa: B018


def test_one_version():
    root = Path(HybridVolume.__file__).resolve().parent.parent
    package = ElementTree.parse(root / "package.xml")
    assert package.find("{*}version").text == HybridVolume.version
    with open(root / "pyproject.toml", "rb") as file:
        assert tomllib.load(file)["project"]["version"] == HybridVolume.version
