# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The workbench in FreeCAD's real window under a virtual screen, with the real worker."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from HybridVolume import job
from HybridVolume.errors import SetupError
from HybridVolume.freecad_python import import_freecad

TESTS = Path(__file__).resolve().parent
SCREEN = "-screen 0 1280x900x24 -dpi 96 +extension GLX"
SETTINGS = """<?xml version="1.0" encoding="UTF-8" standalone="no" ?>
<FCParameters>
  <FCParamGroup Name="Root"><FCParamGroup Name="BaseApp"><FCParamGroup Name="Preferences">
    <FCParamGroup Name="General"><FCText Name="AutoloadModule">PartWorkbench</FCText></FCParamGroup>
    <FCParamGroup Name="Mod"><FCParamGroup Name="HybridVolume">
      <FCBool Name="AskMidstructure" Value="{ask}"/>
    </FCParamGroup></FCParamGroup>
  </FCParamGroup></FCParamGroup></FCParamGroup>
</FCParameters>
"""

pytestmark = pytest.mark.skipif(
    not (shutil.which("freecad") and shutil.which("xvfb-run")), reason="needs freecad and xvfb-run"
)


@pytest.fixture
def python():
    try:
        return job.worker_python()
    except SetupError as missing:
        pytest.skip(missing.line)


def play(scenario, folder, ask=False, **variables):
    """Run a scenario in FreeCAD's window and return its answer.

    ``ask`` is the preference that shows the midstructure first.
    """
    home = folder / "home"
    (home / "Mod").mkdir(parents=True)
    (home / "Mod" / "HybridVolume").symlink_to(TESTS.parent, target_is_directory=True)
    (home / "user.cfg").write_text(SETTINGS.format(ask=int(ask)))
    answer = folder / "answer.json"
    environment = {
        **os.environ,
        "FREECAD_USER_HOME": str(home),
        "QTWEBENGINE_DISABLE_SANDBOX": "1",
        "TMPDIR": str(folder),
        "HYBRIDVOLUME_TESTS": str(TESTS),
        "HYBRIDVOLUME_SCENARIO": scenario,
        "HYBRIDVOLUME_ANSWER": str(answer),
        **variables,
    }
    environment.pop("PYTHONPATH", None)
    command = ["xvfb-run", "-a", "-s", SCREEN, "freecad", str(TESTS / "gui_bootstrap.py")]
    run = subprocess.run(
        command,
        env={key: value for key, value in environment.items() if value is not None},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=240,
    )
    assert answer.is_file(), run.stdout[-3000:] + run.stderr[-3000:]
    found = json.loads(answer.read_text())
    assert found.get("finished"), found.get("traceback")
    return found


PARTS = ["Midstructure", "Shell", "Core", "FemMesh"]
ALL = sorted(["Box", "HybridVolume", *PARTS])
LOOKS = {
    "Box": False,
    "HybridVolume": True,
    "Midstructure": False,
    "Shell": True,
    "Core": True,
    "FemMesh": False,
}


def test_complete_a_box(tmp_path, python):
    found = play("complete_a_box", tmp_path, HYBRIDVOLUME_PYTHON=python)
    assert "HybridVolumeWorkbench" in found["workbenches"]
    assert found["toolbar"] == ["HybridVolume_Create"]
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
    found = play("stop_on_the_way", tmp_path, HYBRIDVOLUME_PYTHON=python)
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
        "without_environment",
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
    found = play("open_a_document", tmp_path, HYBRIDVOLUME_DOCUMENT=str(tmp_path / "made.FCStd"))
    looks = {"Body" if name == "Box" else name: shown for name, shown in LOOKS.items()}
    assert found["visible"] == looks and found["red"] > 0.1


if __name__ == "__main__":
    # Looking at a scenario: python tests/test_gui_workbench.py SCENARIO FOLDER
    print(json.dumps(play(sys.argv[1], Path(sys.argv[2])), indent=1))
