# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The workbench in FreeCAD's real window under a virtual screen, with the real worker."""

import shutil

import pytest
from gui_play import needs_window, play, worker_python

from HybridVolume.freecad_python import import_freecad

pytestmark = needs_window


@pytest.fixture
def python():
    return worker_python()


PARTS = ["Midstructure", "Shell", "InnerBoundary", "Core", "FemMesh"]
ALL = sorted(["Box", "HybridVolume", *PARTS])
LOOKS = {
    "Box": False,
    "HybridVolume": True,
    "Midstructure": False,
    "Shell": True,
    "InnerBoundary": False,
    "Core": True,
    "FemMesh": False,
}


def test_complete_a_box(tmp_path, python):
    found = play("gui_scenarios.complete_a_box", tmp_path, HYBRIDVOLUME_PYTHON=python)
    assert "HybridVolumeWorkbench" in found["workbenches"]
    assert found["toolbar"][:3] == [
        f"HybridVolume_{name}" for name in ("Create", "Quality", "ClearRed")
    ]
    assert not found["active without selection"] and found["active with a body"]
    assert found["enabled while running"] == [False, True]
    assert found["longest pause while running"] < 1.0
    assert "all proved valid" in found["log"]

    assert found["undo names"] == ["Complete the volume"] and not found["pending"]
    assert found["objects"] == ALL and found["children"] == PARTS
    assert found["status"] == "Up to date"
    assert found["visible"] == LOOKS and found["red"] > 0.1
    assert found["job folders"] == []
    assert found["undone"] == []
    assert found["redone"] == ALL

    again = found["reopened"]
    assert again["status"] == "Up to date" and again["objects"] == ALL
    assert again["visible"] == LOOKS and again["red"] > 0.1
    assert again["red by quality"] == pytest.approx(found["red by quality"], abs=0.01)
    # most wedges of so coarse a box are flat, and red as well
    assert found["red by quality"] < found["red"] - 0.01
    assert again["volumes"] == found["volumes"] > 12
    assert found["after a change"] == "Out of date: the body changed"
    assert found["again"] == {
        "status": "Up to date",
        "objects": ALL,
        "undo": ["Complete the volume"],
    }
    assert found["volume again"] == pytest.approx(30 * 20 * 12, rel=1e-5)
    assert found["undone again"] == "Out of date: the body changed"


def test_stopped_on_the_way(tmp_path, python):
    found = play("gui_scenarios.stop_on_the_way", tmp_path, HYBRIDVOLUME_PYTHON=python)
    assert found["cancelled"] == {
        "stage": "Cancelled",
        "same": True,
        "workers": [],
        "alive": False,
        "folders": [],
    }
    killed = found["killed"]
    assert "ended by SIGKILL" in killed["message"] and "\n" not in killed["message"]
    assert killed["same"] and killed["stage"] == "Failed"
    assert killed["workers"] == [] and killed["folders"] == []
    refused = found["refused"]
    assert refused["message"].startswith("Face1: ") and "\n" not in refused["message"]
    assert refused["selected"] == ["Face1"] and refused["same"]
    assert "the document was closed" in found["document closed"]["message"]
    assert found["document closed"]["folders"] == []


STUB = """#!/bin/sh
# Stands in for a Python that makes environments: takes a second and wraps one that is there.
case "$*" in
*HybridVolume.environment*)
    echo "set-up: the first step" >&2
    sleep 1
    mkdir -p "{folder}/bin"
    printf '#!/bin/sh\\nexec "{python}" "$@"\\n' > "{folder}/bin/python"
    chmod +x "{folder}/bin/python";;
*) exec "{python}" "$@";;
esac
"""


def test_first_use_without_an_environment(tmp_path, python):
    stub = tmp_path / "stub"
    stub.write_text(STUB.format(folder=tmp_path / "environment", python=python))
    stub.chmod(0o755)
    found = play(
        "gui_scenarios.without_environment",
        tmp_path,
        HYBRIDVOLUME_PYTHON=None,
        HYBRIDVOLUME_ENVIRONMENT=str(tmp_path / "environment"),
        HYBRIDVOLUME_BASE_PYTHON=shutil.which("false"),
        HYBRIDVOLUME_STUB=str(stub),
    )
    assert str(tmp_path / "environment") in found["question"] and "MB" in found["question"]
    assert found["declined"]["stage"].startswith("Not started") and found["declined"]["same"]
    assert "no Python" in found["failed"]["message"] and found["failed"]["same"]
    assert found["set-up cancelled"] == {"stage": "Cancelled", "same": True}
    assert found["in the end"] == ALL


def test_a_document_made_without_a_window(tmp_path):
    FreeCAD = import_freecad()
    from made_by_hand import SIZE, completed

    from HybridVolume.objects import document

    doc = FreeCAD.newDocument("source", hidden=True, temp=True)
    box = doc.addObject("Part::Box", "Box")
    box.Length, box.Width, box.Height = SIZE
    doc.recompute()
    document.save_new([document.Prepared(completed(box, tmp_path))], tmp_path / "made.FCStd")
    FreeCAD.closeDocument(doc.Name)
    found = play(
        "gui_scenarios.open_a_document",
        tmp_path,
        HYBRIDVOLUME_DOCUMENT=str(tmp_path / "made.FCStd"),
    )
    looks = {"Body" if name == "Box" else name: shown for name, shown in LOOKS.items()}
    assert found["visible"] == looks and found["red"] > 0.1
