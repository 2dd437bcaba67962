# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Looking at a result, and at a refused body, in FreeCAD's real window by real clicks."""

import shutil

import pytest
from gui_play import needs_window, play, worker_python

pytestmark = [
    needs_window,
    pytest.mark.skipif(not shutil.which("xdotool"), reason="needs xdotool"),
]

PARTS = ["Core", "FemMesh", "InnerBoundary", "Midstructure", "Shell"]


def grey(colour):
    return max(colour) - min(colour) < 25


def red(colour):
    return colour[0] > 1.5 * max(colour[1:])


def test_look_at_a_result(tmp_path):
    found = play("gui_quality.result", tmp_path, HYBRIDVOLUME_PYTHON=worker_python())
    figures = found["figures"]
    count = figures["elements"]
    assert found["certified"] == f"Certified: {count} of {count} elements proved"
    assert found["reached"].startswith(f"w0 {figures['w0']:.3f} of 0.500 asked")
    assert sum(figures["histogram"]) == count
    assert f"least {figures['least']:.3f}" in figures["line"]

    rows = found["faces"]
    assert sorted(row[0] for row in rows) == [f"Face{k}" for k in range(1, 7)]
    assert sum(int(row[1]) for row in rows) == count
    least = [float(row[2]) for row in rows]
    assert least == sorted(least) and least[0] == pytest.approx(figures["least"], abs=6e-4)
    for row in rows:
        thinnest, mean, thickest = map(float, row[5:])
        # nowhere can a shell be thicker than half of the box
        assert 0.0 < thinnest <= mean <= thickest <= 5.0

    assert sorted(found["hidden"]) == ["Box", *PARTS]
    assert not grey(found["whole"][0]) and not grey(found["whole"][1])
    # what is seen from the right is Face2 of FreeCAD's box, at x = 30
    assert found["clicked"].startswith("Element ") and ", Face2, layer 1: J 0." in found["clicked"]
    assert found["selected"] == 0
    assert grey(found["cut"][0]) and not grey(found["cut"][1])
    assert 0.0 < found["cut seconds"] < 1.0
    assert 0.9 < found["slider"] < 0.97 and not grey(found["almost through"])
    assert found["flipped"] == found["whole"][0]

    worst = found["worst"]
    assert [row[0] for row in worst["rows"]] == [str(k) for k in range(1, 11)]
    values = [float(row[4]) for row in worst["rows"]]
    assert values == sorted(values) and values[0] == pytest.approx(figures["least"], abs=6e-5)
    assert all(0.0 < float(row[5]) for row in worst["rows"])
    assert worst["marked"] == [int(row[1]) for row in worst["rows"]] and worst["red"] > 0.02
    assert found["one of the worst"] == [worst["marked"][2]]
    assert found["whole again"] == []
    assert found["row"][1] == [found["row"][0]]
    # as asked: green
    alone = found["inner boundary alone"]
    assert alone[1] == max(alone) and alone[1] > alone[2] + 40
    assert found["changed by the panel"] == []

    # the volume and its five parts are gone from the view, and what the panel added
    assert found["undone"] == {"open": False, "box": True, "nodes": -6}

    # at the thickest place: yellow, the upper end of the scale
    for colour in (found["object"], found["reopened"]["colour"]):
        assert min(colour[:2]) > 150 and colour[2] < 100
    assert found["reopened"]["by"] == "Thickness" and found["reopened"]["status"] == "Up to date"
    assert found["opened by the object"] == [False, True, False]
    assert not found["document closed"]


def test_red_places(tmp_path):
    found = play("gui_quality.refused", tmp_path)
    assert "no closed solid" in found["message"] and found["red faces"] == ["Face1"]
    assert not red(found["red before"]) and red(found["red"])
    assert [colour[:3] for colour in found["colours"]] == [pytest.approx([0.8] * 3, abs=1e-3)]
    cleared = found["cleared"]
    assert not cleared["shown"] and cleared["changed"] == []
    assert cleared["red"] == found["red before"]

    assert red(found["ball"]) and red(found["beside"])
    assert min(found["beside"][1:]) > max(found["ball"][1:]) + 40
    assert found["lines"] == ["Face1 at u = 0.25, v = 0.5: the derivative vanishes"]
    assert found["faces that exist"] == ["Face1"]
    assert not found["after a change"] and not found["document closed"]
    assert found["nodes"][0] == found["nodes"][1]
    assert found["cannot be meshed"] == [True, [], 1, False]
