# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The way through the FEM workbench in FreeCAD's real window."""

import shutil

import pytest
from gui_play import needs_window, play, worker_python

pytestmark = [
    needs_window,
    pytest.mark.skipif(not shutil.which("xdotool"), reason="needs xdotool"),
    pytest.mark.skipif(not shutil.which("ccx"), reason="CalculiX (ccx) is absent"),
]


def test_from_a_body_to_its_stresses(tmp_path):
    found = play("gui_analysis.whole_path", tmp_path, HYBRIDVOLUME_PYTHON=worker_python())
    assert not found["told"]
    assert len(found["members"]) == 3 and "Fem::FemMeshObjectPython" in found["members"]
    assert "Box" in found["visible"] and "FemMesh" not in found["visible"]
    assert found["prerequisites"] == "" and found["undo steps"] == 1
    length, width, height = found["size"]
    tension = 1000.0 / (width * height)
    # away from the ends the bar is pulled evenly (Saint-Venant)
    mises = found["mises"]
    assert sum(mises) / len(mises) == pytest.approx(tension, rel=0.03)
    assert mises == pytest.approx([tension] * len(mises), rel=0.15)
    assert found["length"] == pytest.approx(tension * length / 210e3, rel=0.1)
