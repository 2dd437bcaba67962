# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Solutions on shell and core in documents: the example macros, in FreeCAD's own Python."""

import contextlib
import io

import numpy as np
import pytest

from HybridVolume.errors import InputError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

from conftest import PROJECT

import HybridVolume

EXAMPLES = PROJECT / "resources" / "examples"


@pytest.fixture(scope="module")
def played(python):
    """What the macros leave behind: their variables and what they print."""
    found = {}
    for name in ("elasticity", "poisson"):
        said = io.StringIO()
        space = {}
        code = compile((EXAMPLES / f"{name}.FCMacro").read_text(encoding="utf-8"), name, "exec")
        with contextlib.redirect_stdout(said):
            exec(code, space)
        found[name] = space, said.getvalue()
    yield found
    for space, _ in found.values():
        FreeCAD.closeDocument(space["doc"].Name)


def test_the_beam_bends_as_it_should(played):
    space, said = played["elasticity"]
    bent, result = space["bent"], space["result"]
    # 27-node hexahedra, 2673 nodes: strain energy 62.75 mJ, tip .1255 mm in the mean
    assert bent.energy == pytest.approx(62.75, rel=0.01)
    assert -bent.displacement(space["tip"])[:, 2].mean() == pytest.approx(0.1255, rel=0.01)
    assert bent.reaction(space["wall"]) == pytest.approx([0.0, 0.0, 1000.0], abs=1e-5)
    assert "deflection 0.127" in said
    mesh = result.Mesh.FemMesh
    assert result.isDerivedFrom("Fem::FemResultObject")
    assert mesh.NodeCount == len(result.NodeNumbers) == len(space["volume"].fem.nodes)
    assert mesh.VolumeCount == len(space["volume"].fem.wedges) + len(space["volume"].fem.tets)
    places = np.array([tuple(mesh.Nodes[number]) for number in result.NodeNumbers])
    moved = np.array([tuple(vector) for vector in result.DisplacementVectors])
    assert np.abs(moved[places[:, 0] == 0.0]).max() < 1e-9
    half = np.isclose(places[:, 0], 20.0) & np.isclose(places[:, 2], 10.0)
    # M z / I = 1000 * 20 * 5 / 833
    assert np.array(result.NodeStressXX)[half] == pytest.approx(120.0, rel=0.02)
    assert np.array(result.vonMises)[half] == pytest.approx(120.0, rel=0.03)
    assert np.array(result.PrincipalMax)[half] == pytest.approx(120.0, rel=0.02)
    length = np.linalg.norm(moved, axis=1)
    assert result.DisplacementLengths == pytest.approx(length, abs=1e-12)
    assert result.Stats[9] == pytest.approx(max(result.vonMises))


def test_the_block_is_warm(played):
    space, said = played["poisson"]
    exact = 293.0 + (0.02 * 10.0 + 0.001 * 10.0**2 / 2.0) / 0.043
    assert f"{exact:.3f} K are exact" in said
    result = space["result"]
    temperature = np.array(result.Temperature)
    places = np.array([tuple(result.Mesh.FemMesh.Nodes[n]) for n in result.NodeNumbers])
    z = places[:, 2]
    # the inner surface of this shell is not quite flat: the interface has slits
    parabola = 293.0 + (0.02 * z + 0.001 * (10.0 * z - 0.5 * z**2)) / 0.043
    assert temperature == pytest.approx(parabola, abs=3e-3)
    assert result.Stats[20:22] == pytest.approx([293.0, exact], abs=3e-3)
    assert not result.vonMises


def test_results_are_saved_and_undone(played, tmp_path):
    space, _ = played["elasticity"]
    doc, result = space["doc"], space["result"]
    doc.saveCopy(str(tmp_path / "bent.FCStd"))
    again = FreeCAD.openDocument(str(tmp_path / "bent.FCStd"), hidden=True)
    try:
        kept = again.getObject(result.Name)
        assert kept.vonMises == result.vonMises and kept.Coupling == "nitsche, core of degree 3"
        assert kept.Unknowns == space["bent"].space.size
        assert kept.Mesh.FemMesh.NodeCount == len(kept.NodeNumbers)
        assert kept in again.getObject("HybridVolume_Solved").Group
    finally:
        FreeCAD.closeDocument(again.Name)
    doc.UndoMode = 1
    names = [one.Name for one in doc.Objects]
    modes = HybridVolume.analysis.modal(space["bent"].space, count=7)
    shown = modes.to_document(doc, 6, mesh=space["volume"].fem)
    assert shown.Eigenmode == 7 and shown.EigenmodeFrequency == pytest.approx(modes.frequencies[6])
    assert max(shown.DisplacementLengths) == pytest.approx(1.0, rel=0.1)
    doc.undo()
    assert [one.Name for one in doc.Objects] == names


def test_what_has_no_mesh_or_no_document_is_said(played):
    space, _ = played["poisson"]
    warm = HybridVolume.analysis.poisson(space["warm"].space, fixed=1.0)
    with pytest.raises(InputError, match="without a mesh to sample at; give mesh="):
        warm.to_document(space["doc"])
    with pytest.raises(InputError, match="there is no document"):
        space["warm"].to_document(None)
    with pytest.raises(InputError, match="Block has no hybrid volumes"):
        HybridVolume.analysis.poisson(space["body"], fixed=1.0)
    obj = HybridVolume.to_document(space["volume"], space["doc"], space["body"])
    again = HybridVolume.analysis.poisson(obj, fixed={space["foot"]: 5.0}, coupling="nitsche")
    assert again.at(space["lid"]) == pytest.approx(5.0, rel=1e-9)
    other = played["elasticity"][0]["volume"]
    with pytest.raises(InputError, match="points are outside of the body"):
        warm.to_document(space["doc"], mesh=other.fem)
