# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""From a STEP file to stresses in FreeCAD's real window, by real clicks."""

import shutil

import pytest
from gui_play import needs_window, play, worker_python

pytestmark = [
    needs_window,
    pytest.mark.skipif(not shutil.which("xdotool"), reason="needs xdotool"),
    pytest.mark.skipif(not shutil.which("ccx"), reason="CalculiX (ccx) is absent"),
]


def test_the_fandisk_from_its_file_to_von_mises(tmp_path):
    # elements of first order: a tenth of the solver's time, and the same way
    found = play(
        "gui_fandisk.from_file_to_stress",
        tmp_path,
        HYBRIDVOLUME_PYTHON=worker_python(),
        HYBRIDVOLUME_ORDER="1",
    )
    (body,) = found["picked"]["body"]
    assert body == "Face84"
    ((_, fixed),), ((_, pushed),) = found["picked"]["fixed"], found["picked"]["pushed"]
    assert (fixed, pushed) == (["Face4"], ["Face84"])
    assert found["force"][0] == pytest.approx(50.0)
    assert not found["told"] and found["refused"] == ""
    assert found["status bar"].startswith("Next: pick a face of ")
    assert found["von Mises is chosen"]
    steps, highest = found["again"]
    assert steps == 1 and highest == pytest.approx(max(found["mises"]))
    macro = found["macro"]
    assert max(map(abs, macro["direction"])) == pytest.approx(1.0)
    assert found["force"][1:] == pytest.approx(macro["direction"], abs=1e-6)
    for name in ("mises", "length"):
        highest = max(macro[name])
        assert highest > 0.0 and len(found[name]) == len(macro[name])
        assert found[name] == pytest.approx(macro[name], abs=0.01 * highest)
