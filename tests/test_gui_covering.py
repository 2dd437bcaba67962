# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies of trimmed faces in FreeCAD's real window, with the real worker."""

import re

import pytest
from gui_play import needs_window, play, worker_python

pytestmark = needs_window


def hue(colour):
    """Which of blue, green and orange a colour is, dark or light."""
    red, green, blue = colour
    if blue > 1.2 * max(red, green):
        return "blue"
    if green > 1.2 * max(red, blue):
        return "green"
    return "orange" if red > 1.2 * green > 1.44 * blue else "plain"


def test_a_drilled_plate_is_checked(tmp_path):
    found = play("gui_covering.drilled", tmp_path, HYBRIDVOLUME_PYTHON=worker_python())
    # 1e-4 of the diagonal, which is (24^2 + 16^2 + 8^2)^(1/2) mm
    assert found["at first"] == {"section": "Geometry: exact, or within 0.003 mm", "rows": []}
    # the panel is long: the wheel that scrolls it must not change what it passes
    passed = {"w0": True, "w0Slider": True, "kind": True, "layers": True}
    assert found["wheel"] == {**passed, "clicked into": True}
    assert found["covering"]["enabled"] == [False, True, False]
    assert found["covering"]["stage"].startswith("covering")
    assert found["cancelled"] == {
        "stage": "Cancelled",
        "meshers": [],
        "folders": [],
        "rows": [],
    }
    assert found["longest pause"] < 1.0
    checked = found["checked"]
    assert [row[0] for row in checked["rows"]] == [f"Face{k}" for k in range(1, 8)]
    # a cylinder between slanted ellipses is no piece between lines of its parameters
    assert [row[1] for row in checked["rows"]] == ["exact"] * 6 + ["tolerance"]
    assert all(int(row[2]) >= 1 for row in checked["rows"])
    assert [float(row[3]) for row in checked["rows"][:6]] == [0.0] * 6
    assert 0.0 < float(checked["rows"][6][3]) <= 0.003
    assert re.match("7 faces: 6 exact, 1 within 0.00", checked["hint"])
    assert checked["hint"] in checked["log"]
    assert [hue(colour) for colour in checked["colours"]] == ["green", "orange"]
    assert found["row clicked"] == {"picked": ["Plate.Face7"], "marked": ["Face7"]}
    (top,) = found["top clicked"]["marked"]
    assert found["top clicked"]["picked"] == [f"Plate.{top}"] != ["Plate.Face7"]
    assert found["not coloured"] == {"as before": True, "nodes": True}
    assert found["section closed"] == {
        "section": "Geometry: 6 exact, 1 within tolerance",
        "as before": True,
    }
    assert found["body moved"] == [] and found["changed"] == []


STUB = """#!/bin/sh
# Stands in for a mesher that refuses tolerances below 0.1 mm.
for folder; do :; done
case "$*" in
*covering.exchange*)
    if ! grep -q '"tolerance": 0[.][1-9]' "$folder/task.json"; then
        cat > "$folder/error.json" <<END
{{"message": "patches miss faces by up to 0.2 mm", "faces": ["Face1"], "figure": 0.2,
 "remedy": "allow a larger deviation"}}
END
        exit 2
    fi;;
esac
exec "{python}" "$@"
"""


def test_a_refused_cover_is_shown_in_red(tmp_path):
    stub = tmp_path / "stub"
    stub.write_text(STUB.format(python=worker_python()))
    stub.chmod(0o755)
    found = play("gui_covering.refused", tmp_path, HYBRIDVOLUME_PYTHON=str(stub))
    refused = found["refused"]
    assert "Face1: patches miss faces by up to 0.2 mm" in refused["message"]
    assert "allow a larger deviation" in refused["message"]
    assert refused["red"] == ["Face1"] and refused["picked"] == ["Plate.Face1"]
    assert refused["stage"] == "Failed" and refused["rows"] == []
    assert found["with another"] == {
        "kinds": ["exact", "tolerance"],
        "red": False,
        "changed": [],
    }


def test_a_wedge_goes_all_the_way(tmp_path):
    found = play("gui_covering.wedge", tmp_path, ask=True, HYBRIDVOLUME_PYTHON=worker_python())
    names = [f"Face{k}" for k in range(1, 6)]
    assert set(found["sheets"]["between"]) <= set(names) and found["sheets"]["kept"] >= 1
    assert "sheets kept" in found["sheets"]["hint"]
    done = found["done"]
    assert [row[:2] for row in done["rows"]] == [[name, "exact"] for name in names]
    assert done["section"] == "Geometry" and done["status"] == "Up to date"
    assert done["kept"].startswith("5 faces: 5 exact") and done["kept"] in done["log"]
    assert "all proved valid" in done["log"]
    assert done["volume"] == pytest.approx(0.5 * 20 * 14 * 8, rel=1e-9)
    again = found["reopened"]
    assert again["rows"] == done["rows"] and again["status"] == "Up to date"
    assert again["section"] == "Geometry: 5 exact"
    # the body was not seen since the file was opened
    assert again["coloured"] == 5
    assert found["another tolerance"]["rows"] == []
    after = found["after OK"]
    assert after["tolerance"] == pytest.approx(0.1) and len(after["undo"]) == 1
    assert after["status"] == "Out of date: CoverTolerance changed"
    assert found["undone"] == "Up to date"
    quality = found["quality"]
    assert quality["faces"] == names and quality["elements"] and quality["marked"]
    assert quality["told"].startswith("Face5: w0") and all(quality["levels"])
    mesh = found["mesh"]
    assert mesh["stage"] == "Done" and mesh["finer"] and mesh["status"] == "Up to date"
