# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Analyses of the FEM workbench and stresses from displacements, on a box made by hand."""

import shutil

import numpy as np
import pytest

from HybridVolume.errors import InputError, OutOfDateError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import ObjectsFem
from femtools import ccxtools
from made_by_hand import SIZE, completed, face_names

import HybridVolume
from HybridVolume.objects import document
from HybridVolume.objects.analysis import problems

needs_ccx = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is absent")
FORCE = 10.0
AREA = SIZE[1] * SIZE[2]


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
    return box


@pytest.fixture
def volume(doc, box, tmp_path):
    (volume,) = document.insert(doc, box, [document.Prepared(completed(box, tmp_path))])
    return volume


def pull(analysis, box, folder):
    """Fix one end of the box, pull at the other, and solve."""
    doc, names = box.Document, face_names(box.Shape)
    fixed = ObjectsFem.makeConstraintFixed(doc)
    fixed.References = [(box, names[0])]
    force = ObjectsFem.makeConstraintForce(doc)
    force.References = [(box, names[1])]
    force.Force = FORCE if FreeCAD.Version()[0] == "0" else f"{FORCE} N"
    force.Direction = (box, ["Edge1"])
    force.DirectionVector = FreeCAD.Vector(1, 0, 0)
    analysis.addObjects([fixed, force])
    doc.recompute()
    (solver,) = [one for one in analysis.Group if "Solver" in one.Name]
    run = ccxtools.FemToolsCcx(analysis, solver, test_mode=False)
    run.update_objects()
    run.setup_working_dir(str(folder))
    run.setup_ccx()
    assert run.check_prerequisites() == ""
    run.purge_results()
    run.write_inp_file()
    run.ccx_run()
    run.load_results()


def without_contraction(analysis):
    for one in analysis.Group:
        if one.isDerivedFrom("App::MaterialObjectPython"):
            one.Material = {**one.Material, "PoissonRatio": "0"}


def column(result, name):
    return np.array(getattr(result, name))


def test_an_analysis_is_one_step_of_undo_and_lacks_only_the_loads(doc, box, volume):
    doc.clearUndos()
    before = {one.Name for one in doc.Objects}
    analysis = HybridVolume.make_analysis(box)
    kinds = sorted(one.TypeId for one in analysis.Group)
    assert volume.FemMesh in analysis.Group and len(kinds) == 3
    assert doc.UndoCount == 1
    doc.undo()
    assert {one.Name for one in doc.Objects} == before


@needs_ccx
def test_a_pulled_bar_has_the_same_stress_at_every_node(doc, box, volume, tmp_path):
    analysis = HybridVolume.make_analysis(volume)
    without_contraction(analysis)
    pull(analysis, box, tmp_path)
    result = HybridVolume.recover_stress(analysis)
    # F / A; displacements are printed with six digits
    assert column(result, "NodeStressXX") == pytest.approx(FORCE / AREA, rel=2e-4)
    assert column(result, "vonMises") == pytest.approx(FORCE / AREA, rel=2e-4)
    assert column(result, "PrincipalMax") == pytest.approx(FORCE / AREA, rel=2e-4)
    assert column(result, "NodeStrainXX") == pytest.approx(FORCE / AREA / 210e3, rel=2e-4)
    assert max(result.Stats) == pytest.approx(FORCE / AREA, rel=2e-4)
    again = HybridVolume.recover_stress(analysis)
    assert [one for one in analysis.Group if one.Name.startswith("HybridVolume")] == [again]


@needs_ccx
def test_shell_and_core_with_a_material_each(doc, box, volume, tmp_path):
    analysis = HybridVolume.make_analysis(volume.FemMesh, materials_apart=True)
    without_contraction(analysis)
    doc.CoreMaterial.Material = {**doc.CoreMaterial.Material, "YoungsModulus": "21 GPa"}
    pull(analysis, box, tmp_path)
    result = HybridVolume.recover_stress(analysis)
    stress, strain = column(result, "NodeStressXX"), column(result, "NodeStrainXX")
    points = np.array([tuple(result.Mesh.FemMesh.Nodes[n]) for n in result.NodeNumbers])
    outside = (np.isclose(points, 0.0) | np.isclose(points, SIZE)).any(axis=1)
    modulus = stress / strain
    assert modulus[outside] == pytest.approx(210e3, rel=1e-6)
    assert set(np.round(modulus[~outside] / 1e3)) == {210.0, 21.0}
    # a softer core: the bar gets longer than one of steel, shorter than one of the core's material
    longest = max(vector.x for vector in result.DisplacementVectors)
    steel = FORCE * SIZE[0] / (AREA * 210e3)
    assert 1.05 * steel < longest < 10.0 * steel


def on_face(doc, analysis, kind, body, *names):
    """Add a constraint of the FEM workbench on parts of a body."""
    one = getattr(ObjectsFem, f"makeConstraint{kind}")(doc)
    one.References = [(body, name) for name in names]
    analysis.addObject(one)
    doc.recompute()
    return one


def megapascals(value):
    """A pressure as this FreeCAD takes it."""
    return value if FreeCAD.Version()[0] == "0" else f"{value} MPa"


@needs_ccx
def test_a_pressed_bar_has_its_pressure_as_normal_stress_at_the_end(doc, box, volume, tmp_path):
    names = face_names(box.Shape)
    analysis = HybridVolume.make_analysis(volume)
    on_face(doc, analysis, "Fixed", box, names[0])
    press = on_face(doc, analysis, "Pressure", box, names[1])
    press.Pressure = megapascals(50.0)
    result = HybridVolume.solve(analysis, tmp_path / "solver")
    assert list((tmp_path / "solver").glob("*.frd"))
    place = {number: row for row, number in enumerate(result.BoundaryNodes)}
    nodes = np.array([tuple(result.Mesh.FemMesh.Nodes[n]) for n in place])
    normals = np.array([tuple(n) for n in result.BoundaryNormals])
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    pressed = np.isclose(nodes[:, 0], SIZE[0]) & (normals[:, 0] > 0.9)
    free = np.isclose(np.abs(normals[:, 1]), 1.0) & (nodes[:, 0] > 0.4 * SIZE[0])
    free &= nodes[:, 0] < 0.99 * SIZE[0]
    normal, shear = column(result, "NormalStress"), column(result, "ShearStress")
    assert pressed.sum() > 4 and free.sum() > 4
    assert normal[pressed] == pytest.approx(-50.0, rel=1e-2)
    assert np.abs(normal[free]).max() < 1.0 and shear[free].max() < 1.0
    assert column(result, "TangentialMin")[free] == pytest.approx(-50.0, rel=0.1)
    said = dict(text.split(": ") for text in result.FaceLoads)
    assert said[names[1]] == "pressure" and said[names[0]] not in ("free", "pressure")
    assert [said[name] for name in names[2:]] == ["free"] * 4
    # the solver's own result stays beside it, and both are still there after saving
    doc.saveAs(str(tmp_path / "solved.FCStd"))
    again = FreeCAD.openDocument(str(tmp_path / "solved.FCStd"), hidden=True)
    try:
        kept = again.getObject(result.Name)
        assert kept.NormalStress == result.NormalStress and kept.FaceLoads == result.FaceLoads
        solvers = [one for one in again.findObjects("Fem::FemResultObject") if one is not kept]
        assert len(solvers) == 1
    finally:
        FreeCAD.closeDocument(again.Name)


@needs_ccx
def test_loads_on_edges_and_vertices_act(doc, box, volume):
    analysis = HybridVolume.make_analysis(volume)
    ends = [
        [
            f"Edge{k}"
            for k, edge in enumerate(box.Shape.Edges, start=1)
            if all(abs(v.X - x) < 1e-9 for v in edge.Vertexes)
        ]
        for x in (0.0, SIZE[0])
    ]
    on_face(doc, analysis, "Fixed", box, *ends[0])
    force = on_face(doc, analysis, "Force", box, *ends[1])
    force.Force = FORCE if FreeCAD.Version()[0] == "0" else f"{FORCE} N"
    force.Direction = (box, ["Edge1"])
    force.DirectionVector = FreeCAD.Vector(1, 0, 0)
    corner = on_face(doc, analysis, "Fixed", box, "Vertex1")
    assert corner.References
    doc.recompute()
    result = HybridVolume.solve(analysis)
    points = np.array([tuple(result.Mesh.FemMesh.Nodes[n]) for n in result.NodeNumbers])
    middle = np.isclose(points[:, 0], 0.5 * SIZE[0])
    # the force goes through the middle, whatever happens at the edges of so coarse a mesh
    assert column(result, "NodeStressXX")[middle].mean() == pytest.approx(FORCE / AREA, rel=0.3)
    assert {text.split(": ")[1] for text in result.FaceLoads} <= {"free", "unknown"}


def test_what_keeps_an_analysis_from_a_right_answer_is_said_at_once(doc, box, volume, monkeypatch):
    analysis = HybridVolume.make_analysis(volume)
    (nothing, *_) = problems(analysis)
    assert "has no supports and no loads" in nothing.line
    cube = doc.addObject("Part::Box", "Cube")
    doc.recompute()
    load = on_face(doc, analysis, "Pressure", cube, "Face2", "Face3")
    (wrong,) = [error for error in problems(analysis) if error.code == "input"]
    assert wrong.line == (
        f"{load.Label} is on Face2, Face3 of Cube, but Box was meshed; pick its faces, edges or "
        "vertices on Box"
    )
    with pytest.raises(InputError, match="but Box was meshed"):
        HybridVolume.solve(analysis)
    # a feature of the same shape will do
    twin = doc.addObject("Part::Feature", "Twin")
    twin.Shape = box.Shape
    load.References = [(twin, "Face2")]
    assert not [error for error in problems(analysis) if error.code == "input"]
    (solver,) = [one for one in analysis.Group if "Solver" in one.Name]
    solver.GeometricalNonlinearity = "nonlinear"
    (wrong,) = [error for error in problems(analysis) if error.code == "input"]
    assert "GeometricalNonlinearity nonlinear" in wrong.line
    solver.GeometricalNonlinearity = "linear"
    volume.FemMesh.Lost = ["Face2"]
    (wrong,) = [error for error in problems(analysis) if error.code == "input"]
    assert "does not find every node of the mesh on Face2" in wrong.line
    volume.FemMesh.Lost = []
    monkeypatch.setattr("shutil.which", lambda *_: None)
    with pytest.raises(SetupError, match="CalculiX .ccx. is not installed; install the package"):
        HybridVolume.solve(analysis)


def test_what_cannot_be_done_is_said(doc, box, volume):
    cube = doc.addObject("Part::Box", "Cube")
    with pytest.raises(InputError, match="Cube has no meshes"):
        HybridVolume.make_analysis(cube)
    analysis = HybridVolume.make_analysis(volume)
    with pytest.raises(InputError, match="no displacements yet"):
        HybridVolume.recover_stress(analysis)
    box.Length = 2 * box.Length.Value
    doc.recompute()
    document.update_status(volume)
    with pytest.raises(OutOfDateError, match="out of date"):
        HybridVolume.recover_stress(analysis)
    assert "out-of-date" in [error.code for error in problems(analysis)]
    with pytest.raises(InputError, match="out of date.*compute the hybrid volume again"):
        HybridVolume.make_analysis(volume)
    empty = ObjectsFem.makeAnalysis(doc, "Empty")
    with pytest.raises(InputError, match="Empty has no meshes"):
        HybridVolume.recover_stress(empty)
