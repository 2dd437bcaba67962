# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Export of the FEM mesh in FreeCAD's real window."""

import os
import shutil
import subprocess

import pytest
from gui_play import TESTS, needs_window, play, worker_python

pytestmark = [
    needs_window,
    pytest.mark.skipif(not shutil.which("xdotool"), reason="needs xdotool"),
]


def test_a_mesh_goes_to_files(tmp_path):
    python, stored = worker_python(), tmp_path / "stored.npz"
    code = "import sys; from shells import make_volume; make_volume('box').save(sys.argv[1])"
    places = os.pathsep.join([str(TESTS.parent), str(TESTS)])
    subprocess.run(
        [python, "-c", code, str(stored)], check=True, env={**os.environ, "PYTHONPATH": places}
    )
    found = play("gui_export.files", tmp_path, HYBRIDVOLUME_STORED=str(stored))
    assert "there is no completed volume" in found["no volume"]
    assert len(found["kinds"]) == 7 and found["proposed"].startswith("Box")
    # the ending of the kind is added where the name has none
    made = {p.name for p in tmp_path.iterdir()} & {"one.med", "two.msh", "three.inp"}
    assert made == {"one.med", "two.msh", "three.inp"}
    assert (tmp_path / "two.msh").read_bytes().startswith(b"$MeshFormat")
    assert b"ELSET=SHELL" in (tmp_path / "three.inp").read_bytes()
    assert "<MultiPatch" in (tmp_path / "shell.xml").read_text()
    beside = {p.name for p in tmp_path.glob("shell_*")}
    assert beside == {"shell_core.msh", "shell_interface.csv", "shell_interface_triangles.csv"}
    assert not found["told"]
    assert ".stl" in found["ending"] and not list(tmp_path.glob("four*"))
    assert found["steps"]
