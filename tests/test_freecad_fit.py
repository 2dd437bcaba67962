# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh fit``: a quad mesh and a reference become a body that FreeCAD opens."""

import numpy as np
import pytest
from test_core_fit import cylinder_quads, cylinder_triangles

from HybridVolume.errors import SetupError
from HybridVolume.fit_command import main

try:
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Part


def written(path, mesh):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    for start, stop in zip(mesh.start, mesh.start[1:], strict=False):
        lines.append("f " + " ".join(str(v + 1) for v in mesh.corners[start:stop]))
    path.write_text("\n".join(lines))
    return str(path)


@pytest.fixture(scope="module")
def quads(tmp_path_factory):
    return written(tmp_path_factory.mktemp("fit") / "quads.obj", cylinder_quads())


def test_to_triangles_and_to_a_body(tmp_path, capsys, quads):
    goals = [written(tmp_path / "goal.obj", cylinder_triangles()), str(tmp_path / "goal.step")]
    Part.makeCylinder(1.0, 2.0).exportStep(goals[1])
    for number, goal in enumerate(goals):
        output = tmp_path / f"fitted{number}.step"
        assert main([quads, "--to", goal, "-o", str(output), "--tolerance", "0.5 %"]) == 0
        assert "patches" in capsys.readouterr().out
        shape = Part.Shape()
        shape.read(str(output))
        assert shape.isValid()
        assert len(shape.Solids) == 1
        assert shape.Volume == pytest.approx(2.0 * np.pi, rel=5e-3)


def test_what_is_refused_leaves_no_file(tmp_path, capsys, quads):
    goal = written(tmp_path / "goal.obj", cylinder_triangles())
    output = str(tmp_path / "fitted.step")
    for arguments, words in (
        ([goal, "--to", goal, "-o", output], "have not four corners"),
        ([quads, "--to", str(tmp_path / "none.obj"), "-o", output], "cannot be read"),
        ([quads, "--to", goal, "-o", str(tmp_path / "fitted.obj")], "no STEP or BREP file"),
        ([quads, "--to", goal, "-o", output, "--sharp", "400"], "1 to 179 degrees"),
    ):
        assert main(arguments) == 2
        assert words in capsys.readouterr().err
    with pytest.raises(SystemExit) as stopped:
        main([quads, "--to", goal, "-o", output, "--tolerance", "5 parsec"])
    assert stopped.value.code == 2
    assert not list(tmp_path.glob("fitted*"))
