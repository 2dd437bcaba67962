# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The panel of the FEM mesh, and clear words to bad use, in FreeCAD's real window."""

import shutil

import pytest
from gui_play import needs_window, play, worker_python

pytestmark = [
    needs_window,
    pytest.mark.skipif(not shutil.which("xdotool"), reason="needs xdotool"),
    pytest.mark.skipif(not shutil.which("ccx"), reason="CalculiX (ccx) is absent"),
]

SIZE = (30.0, 20.0, 10.0)


def grey(colour):
    return max(colour) - min(colour) < 25


def test_a_mesh_is_looked_at_and_made_again(tmp_path):
    found = play("gui_mesh.mesh_and_words", tmp_path, HYBRIDVOLUME_PYTHON=worker_python())

    assert "there is no completed volume" in found["no volume"] == found["no mesh"]
    assert "no analysis of a hybrid volume" in found["no analysis"]

    text, nodes, wedges, tets = found["counts"]
    assert text.startswith(f"{nodes} nodes; {wedges} wedges in 2 layers, {tets} tets")
    table = found["table"]
    assert table["Elements"] == [str(wedges), str(tets), str(wedges + tets)]
    least = [float(one) for one in table["Scaled Jacobian, least"]]
    assert least[:2] == pytest.approx(found["least"], abs=6e-5) and least[2] == min(least)
    volume = SIZE[0] * SIZE[1] * SIZE[2]
    shell, core, both = map(float, table["Volume together, mm³"])
    # the box has flat faces: the elements fill it
    assert both == pytest.approx(volume, rel=1e-5) and shell + core == pytest.approx(both, rel=1e-5)
    assert sum(found["histogram"]) == wedges + tets
    assert "Face2, layer 1: J 0." in found["clicked"]
    assert found["coloured"] != found["one colour"]
    assert grey(found["cut"]) and not grey(found["one colour"])
    assert len(found["worst"]) == 10 and len(set(found["worst"])) == 10

    finer = found["finer"]
    assert found["picked"] == ["Face2"]
    assert finer["counts"][0].startswith(f"{finer['counts'][1]} nodes; ")
    assert finer["counts"][1] > 4 * nodes and finer["in the document"] == finer["counts"][1]
    assert finer["volume"] == pytest.approx(volume, rel=1e-9)
    assert finer["properties"] == [2, ["Face2 = 3 mm"], "Up to date"]
    assert finer["shell"] == "Up to date" and len(finer["undo"]) == 1
    assert found["kept by OK"] == [finer["undo"], "Up to date"]
    stored, shown, changed = found["undone"]
    assert stored == shown == nodes and set(changed) <= {"undo"}

    assert "has no supports and no loads" in found["not loaded"]
    assert "has no displacements yet; run its solver first" in found["not solved"]
    for text in (found["other body"], found["other body, solved"]):
        assert "is on Face2 of Cube, but Box was meshed" in text
    assert "CalculiX (ccx) is not installed; install the package" in found["no solver"]
    text, buttons = found["out of date"]
    assert "out of date: the body changed" in text and buttons == ["Compute again", "Cancel"]
    assert found["computed again"] == "Up to date" and not found["bar elsewhere"]
