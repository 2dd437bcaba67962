# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The midstructure by hand in FreeCAD's real window: real clicks and keys, the real worker."""

import shutil

import pytest
from gui_play import needs_window, play, worker_python

pytestmark = [
    needs_window,
    pytest.mark.skipif(not shutil.which("xdotool"), reason="needs xdotool"),
]

# a box of 30 x 20 x 10: one sheet in the middle, one from each of the 12 edges
ALL = sorted(f"Sheet{k}" for k in range(1, 14))
FOUND = ["Find the midstructure", "Create a hybrid volume"]


def sheets(state):
    """Sheets that are kept: the table and the 3D view must tell the same."""
    assert state["table"] == state["view"]
    return state["table"]


def test_sheets_by_mouse(tmp_path):
    found = play(
        "gui_midstructure.by_mouse", tmp_path, ask=True, HYBRIDVOLUME_PYTHON=worker_python()
    )
    assert sheets(found["found"]) == ["Sheet1"] and found["found"]["undo"] == FOUND
    # half of the half height where the sheet is, the whole way from the corners elsewhere
    assert "1 of 13 sheets kept, in 1 piece. Shell about 2.5 to" in found["found"]["hint"]
    assert found["objects"] == ["Box", "HybridVolume", "Midstructure"]
    plain, hovered = found["hovered"]
    assert plain != hovered and hovered[2] < 100 < min(hovered[:2])  # FreeCAD's yellow

    assert sheets(found["removed"]) == [] and "Nothing is kept" in found["removed"]["warning"]
    assert found["removed"]["undo"] == ["Remove Sheet1", *FOUND]
    assert sheets(found["undone"]) == ["Sheet1"] and found["undone"]["undo"] == FOUND
    assert found["undone"]["warning"] == "" and found["undone"]["decisions"] == []
    assert sheets(found["redone"]) == []
    assert sheets(found["brought back"]) == ["Sheet1"]
    (decision,) = found["brought back"]["decisions"]
    assert decision.startswith("keep Face5+Face6@0.5")

    assert found["with Ctrl"]["rows"] == found["with Ctrl"]["picked"] == ["Sheet1"]
    assert found["with Ctrl"]["decisions"] == [decision]
    (other,) = found["row clicked"]["rows"]
    assert found["row clicked"]["picked"] == [other] != ["Sheet1"]
    assert sheets(found["kept by the button"]) == ["Sheet1", other]
    assert sheets(found["automatic again"]) == ["Sheet1"]
    assert found["automatic again"]["decisions"] == []
    assert found["in the box"]["picked"] == ALL
    assert found["in the box"]["undo"] == found["automatic again"]["undo"]

    dragged, released = found["while dragged"], found["slider released"]
    assert len(sheets(dragged)) > 1 and dragged["angle"] == 125.0
    assert dragged["undo"] == found["automatic again"]["undo"]
    assert sheets(released) == sheets(dragged) and released["angle"] == pytest.approx(60.0, abs=2.0)
    assert released["undo"] == ["Midstructure: angle", *dragged["undo"]]
    undone = found["slider undone"]
    assert sheets(undone) == ["Sheet1"] and undone["slider"] == undone["angle"] == 125.0
    assert 0.0 < found["preview seconds"] < 1.0

    assert "Nothing is kept" in found["refused"]["message"] and found["refused"]["open"]
    before = found["before OK"]
    assert sheets(before) == ["Sheet1", found["edge"]]
    after = found["after OK"]
    assert not after["open"] and after["objects"] == found["objects"]
    assert sum(after["kept"]) == 2 and after["box can be selected"]
    assert after["visible"] == {"Box": True, "HybridVolume": True, "Midstructure": False}

    again = found["reopened"]
    assert sheets(again) == sheets(before) and again["decisions"] == before["decisions"]
    assert again["kept"] == after["kept"] and again["undo"] == []
    assert not found["document closed"]


def test_cancel_and_macro(tmp_path):
    found = play(
        "gui_midstructure.cancelled_and_recorded",
        tmp_path,
        ask=True,
        HYBRIDVOLUME_PYTHON=worker_python(),
    )
    assert found["on the way"]["undo"] == ["Remove Sheet1", *FOUND]
    assert found["cancelled"] == {
        "open": False,
        "changed": [],
        "box can be selected": True,
        "box is shown": True,
    }
    assert found["undone to the start"] == {"open": False, "objects": ["Box"], "workers": []}
    assert found["with a stranger's step"] == {"objects": ["Box"], "label": "moved"}
    recorded, replayed = found["recorded"], found["replayed"]
    assert "mid.keep(faces=('Face" in found["macro"] and "mid.invert()" in found["macro"]
    assert sum(recorded["kept"]) == 11
    assert replayed["kept"] == recorded["kept"]
    assert replayed["decisions"] == recorded["decisions"]
    assert replayed["objects"] == ["Box", "HybridVolume", "Midstructure"]
