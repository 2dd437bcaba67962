# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The thickness in FreeCAD's real window, by mouse and keys, with the real worker."""

import re

import pytest
from gui_play import needs_window, play, worker_python

pytestmark = needs_window

PARTS = ["Box", "Core", "FemMesh", "HybridVolume", "InnerBoundary", "Midstructure", "Shell"]
EVEN = {
    "ThicknessKind": "Even",
    "Thickness": "1.5",
    "FaceFactors": "Face6 = 2",
    "Method": "certified",
    "Layers": "2",
    "Spacing": "Equal volume",
    "Degree": "3",
}
RANGE = r"Shell ([\d.]+) to ([\d.]+) mm thick, ([\d.]+) mm in the mean\."


def thickness(told):
    """Smallest, largest and mean thickness that the panel tells."""
    return [float(x) for x in re.match(RANGE, told["figures"]).groups()]


def is_red(pixel):
    return pixel[0] > 1.5 * max(pixel[1:])


def test_even_thickness_with_a_face(tmp_path):
    found = play("gui_thickness.even_with_a_face", tmp_path, HYBRIDVOLUME_PYTHON=worker_python())
    # the body is selected when the panel opens: green all over, until it becomes glass
    red, green, blue = found["wholly selected"]
    assert green > 1.5 * max(red, blue)
    red, green, blue = found["glass"]
    assert green < 1.5 * blue
    # half the height of the box is 5 mm: half of it is 2.5, and near the edges it is more
    low, high, mean = thickness(found["at w0 = .5"])
    assert low == pytest.approx(2.5, abs=0.1) and low < mean < high < 5.0
    held = found["held at .2"]
    assert 0.15 < held["w0"] < 0.25
    assert thickness(held)[0] == pytest.approx(5.0 * held["w0"], rel=0.06)
    assert held["pixel"] != found["glass"]
    assert found["seconds a step"] < 0.15

    assert found["even"] == {
        "figures": "Shell 1.5 mm thick.", "warning": "", "w0 is shown": False
    }  # fmt: skip
    assert "click faces" in found["nothing selected"]
    assert found["face picked"] == ["Box.Face6"]
    assert found["with a face"]["rows"] == [["Face6", 2.0]]
    low, high, mean = thickness(found["with a face"])
    # the top is 600 of 2200 mm²; between faces the factor is evened out
    assert (low, high) == pytest.approx((1.5, 3.0), abs=0.2)
    assert mean == pytest.approx(1.5 + 1.5 * 600.0 / 2200.0, abs=0.15)
    assert found["another face picked"]["marked"] == []
    assert found["another face picked"]["picked"] not in ([], ["Box.Face6"])
    assert found["row clicked"] == {"picked": ["Box.Face6"], "marked": [0]}
    assert found["before the run"] == []

    done = found["done"]
    assert done["undo"] == ["Complete the volume"] and done["objects"] == PARTS
    assert done["properties"] == EVEN and not done["shown"]
    assert done["reached"] in done["told"]["figures" if not done["sentence"] else "warning"]
    assert (done["sentence"] in done["log"]) and "all proved valid" in done["log"]
    assert found["closed"] == {"open": False, "nodes": ["Transform", "Coordinate3", "Switch"]}

    assert found["reopened"] == {
        "told": done["told"],
        "kind": "Even thickness",
        "length": 1.5,
        "rows": [["Face6", 2.0]],
        "section": "Faces with another thickness (1)",
        "box is hidden": True,
    }
    assert found["hidden box picked"] == ["Box.Face6"]
    assert found["cancelled"] == {"open": False, "changed": []}
    after = found["after OK"]
    assert not after["open"] and after["undo"] == ["Shell thickness"]
    assert after["properties"]["ThicknessKind"] == "Share of radius"
    assert after["properties"]["Share"] == "40.0"
    assert after["status"] == "Out of date: ThicknessKind changed"
    assert found["OK undone"] == {"properties": EVEN, "status": "Up to date"}

    line = "vol.complete(thickness='1.5 mm', face_factors={'Face6': 2.0}, layers=2, degree=3"
    assert line in found["macro"]
    assert found["replayed"] == {
        "objects": PARTS,
        "undo": ["Complete the volume"],
        "properties": EVEN,
    }


def test_a_ring(tmp_path):
    found = play("gui_thickness.ring", tmp_path, HYBRIDVOLUME_PYTHON=worker_python())
    assert found["cancelled"] == {"workers": [], "folders": [], "checked": False, "can run": True}
    good = found["good"]
    # a tube of radius 1 around a line: w = 0.5 is at the radius exp(-0.5 ln(1 / 0.3)) or so
    assert 0.4 < thickness(good)[2] < 0.6 and good["warning"] == ""
    assert not any(map(is_red, good["pixels"]))
    higher = found["higher"]
    assert thickness(higher)[2] > thickness(good)[2]
    far = found["too far"]
    assert far["warning"] == (
        "At w0 = 0.55 the inner boundary has genus 1, the body 3: the shell will stop at 0.30."
    )
    assert sum(map(is_red, far["pixels"])) >= 14
    again = found["shown again"]
    assert again["workers"] == [] and thickness(again)[2] > 0.0
    assert found["body moved"] == {
        "figures": "",
        "warning": "Body or midstructure changed: show the inner boundary again.",
        "checked": False,
    }
    assert found["closed"] == {"nodes": True, "changed": []}
