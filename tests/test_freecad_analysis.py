# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Analyses of the FEM workbench and stresses from displacements, on a box made by hand."""

import shutil

import numpy as np
import pytest

from HybridVolume.errors import InputError, SetupError

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
    with pytest.raises(InputError, match="out of date"):
        HybridVolume.recover_stress(analysis)
    with pytest.raises(InputError, match="out of date.*compute the hybrid volume again"):
        HybridVolume.make_analysis(volume)
    empty = ObjectsFem.makeAnalysis(doc, "Empty")
    with pytest.raises(InputError, match="Empty has no meshes"):
        HybridVolume.recover_stress(empty)
