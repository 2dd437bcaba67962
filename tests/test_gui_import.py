# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Import of mesh files in FreeCAD's real window."""

import shutil

import pytest
from gui_play import needs_window, play, worker_python

pytestmark = [
    needs_window,
    pytest.mark.skipif(not shutil.which("xdotool"), reason="needs xdotool"),
]

POINTS = [(x, y, z) for z in (0, 2) for y in (0, 2) for x in (0, 2)]
FACES = [(1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6)]


def obj(faces=FACES, more=""):
    lines = [f"v {x} {y} {z}" for x, y, z in POINTS]
    lines += ["f " + " ".join(map(str, face)) for face in faces]
    return "\n".join(lines) + "\n" + more


def dart():
    """A prism over a quad that is not convex: bilinear patches would be folded."""
    corners = [(0, 0), (2, -1), (0.5, 0), (2, 1)]
    lines = [f"v {x} {y} {z}" for z in (0, 1) for x, y in corners]
    lines += ["f 3 2 1 4", "f 7 8 5 6", "f 1 2 6 5", "f 2 3 7 6", "f 3 4 8 7", "f 4 1 5 8"]
    return "\n".join(lines) + "\n"


def off(boxes):
    """Boxes of side 2 along x, as one OFF file."""
    points = [(x + 5 * k, y, z) for k in range(boxes) for x, y, z in POINTS]
    faces = [[v - 1 + 8 * k for v in face] for k in range(boxes) for face in FACES]
    rows = [" ".join(map(str, row)) for row in points]
    rows += ["4 " + " ".join(map(str, face)) for face in faces]
    return f"OFF\n{len(points)} {len(faces)} 0\n" + "\n".join(rows) + "\n"


def test_meshes_are_imported(tmp_path):
    python = worker_python()
    # the bottom is sharp by its file
    ring = "".join(f"t crease 2/1/0 {a} {b} 10\n" for a, b in ((0, 1), (1, 3), (3, 2), (2, 0)))
    (tmp_path / "creased.obj").write_text(obj(more=ring))
    (tmp_path / "open.obj").write_text(obj(FACES[1:]))
    (tmp_path / "two.off").write_text(off(2))
    (tmp_path / "dart.obj").write_text(dart())
    (tmp_path / "no.ply").write_text("ply\nformat binary\n")
    found = play("gui_import.imported", tmp_path, HYBRIDVOLUME_PYTHON=python)

    ours = [text for text in found["filters"] if text.startswith("HybridVolume")]
    assert ours == ["HybridVolume quad mesh or cage (*.obj *.off *.ply)"]
    first = found["first"]
    assert first["found"].splitlines()[0] == "8 vertices, 6 faces: 6 quads"
    assert "2 x 2 x 2 mm" in first["found"] and "4 creases named" in first["found"]
    assert first["checked"] == ["catmullClark"] and len(first["enabled"]) == 5
    assert first["import"] and first["stepsWords"] == "24 quads"
    plain = found["bilinear"]
    assert plain["enabled"] == ["bilinear", "catmullClark", "smooth"]
    assert plain["stepsWords"] == "6 quads" and plain["angleWords"] == ""
    assert found["by angle"]["angleWords"] == "12 edges turn by more"
    assert found["by angle"]["stepsWords"] == "96 quads"

    assert found["objects"] == ["MeshBody"] and found["undo"] == ["Import mesh"]
    # with all twelve edges sharp the cage is its own limit surface
    made = found["imported"]
    assert (made["scheme"], made["steps"], made["angle"]) == ("catmull-clark", 2, 60.0)
    assert made["patches"] == made["faces"] == 6
    assert made["volume"] == pytest.approx(8.0, rel=1e-5)
    assert made["drawn"] and made["edges"] == 12 and made["creases"] == 4 + 12
    assert "HybridVolume.import_mesh(" in found["macro"]
    assert found["undone"] == [] and not found["asked again"]
    assert found["replayed"] == made

    smooth, mesh = found["smooth"], found["mesh"]
    # between the limit surface without creases, .327 of the cage, and the cage; it stays in place
    assert 2.0 < smooth["volume"] < 3.0 and smooth["creases"] == 0
    assert 4.0 < smooth["box"] < 5.0
    assert mesh["volume"] == pytest.approx(8.0, rel=1e-5) and mesh["box"] == pytest.approx(5.0)
    assert "the sharp angle is 200 degrees" in found["refused"]["text"]
    assert "Invalid" in found["refused"]["state"]
    assert found["refused"]["status"].startswith("Failed: the sharp angle")
    assert found["refused"]["volume"] == mesh["volume"]
    without = found["without cage"]
    assert not without["drawn"] and without["status"] == "Up to date"
    again = found["reopened"]
    assert not again["drawn"]
    assert {k: again[k] for k in ("scheme", "volume")} == {k: mesh[k] for k in ("scheme", "volume")}
    after = found["changed after all"]
    assert after["drawn"] and after["edges"] == 12 and after["volume"] == made["volume"]
    assert not found["hidden"]

    broken = found["open"]
    assert not broken["import"] and broken["checked"] == []
    assert "edges 1-2, 1-3, 2-4 and 3-4" in broken["refusal"] and broken["why"]
    assert broken["enabled"] == []
    assert not found["unreadable"]["import"] and "no.ply" in found["unreadable"]["refusal"]
    assert found["nothing"] == ["MeshBody"]
    # found out only when the patches are made: the question is asked again
    folded = found["folded"]
    assert folded["refusal"].startswith("Not imported: ") and "face" in folded["refusal"]
    assert folded["checked"] == ["bilinear"] and folded["import"]
    assert found["after all"]["scheme"] == "smooth" and found["after all"]["volume"] > 0.0

    # FreeCAD itself asks, as its own workbench reads such files too
    assert len(found["modules"]) == 2
    assert sum(text.startswith("HybridVolume quad mesh") for text in found["modules"]) == 1
    assert "2 bodies" in found["two"]["found"]
    assert found["new document"] == "two"
    assert found["opened"] == [["two_1", 8.0], ["two_2", 8.0]]
    done = found["completed"]
    assert done["status"] == "Up to date" and done["source"] and done["elements"] > 0
    assert not done["cage"] and done["report"] == "bilinear"
    assert "the body changed" in found["outdated"]
