# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Spans evened out in FreeCAD's real window, by mouse and keys, with the real worker."""

from gui_play import needs_window, play, worker_python

pytestmark = needs_window


def test_spans_of_a_box(tmp_path):
    found = play("gui_spans.even_box", tmp_path, HYBRIDVOLUME_PYTHON=worker_python())
    assert found["first"] == {
        "title": "Spans: as the shell needs",
        "open": False,
        "aspect": "as needed",
        "turn": "as needed",
    }
    assert found["too small an aspect"]["open"]
    assert float(found["too small an aspect"]["aspect"].replace(",", ".")) == 2.0
    assert found["asked"]["title"] == "Spans: to 8 mm, turn to 30°"
    # 30 x 20 x 10 mm in pieces of at most 8: 4 x 3 x 2
    done = found["done"]
    assert (done["given"], done["spans"]) == (6, 2 * (4 * 3 + 4 * 2 + 3 * 2))
    assert (done["size"], done["aspect"], done["turn"]) == (8.0, 0.0, 30.0)
    assert done["status"] == "Up to date" and done["undo"] == ["Complete the volume"]
    assert "52 spans of the faces, 6 as given (asked: to 8 mm, turn to 30°)" in done["log"]
    assert "span_size=8.0, span_aspect=0.0, span_turn=30.0" in found["macro"]
    assert found["opened again"]["title"] == "Spans: to 8 mm, turn to 30°"
    assert found["after OK"] == {"aspect": 4.0, "status": "Out of date: SpanAspect changed"}
    assert found["undone"] == {"aspect": 0.0, "status": "Up to date"}
