# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Plays scenarios in FreeCAD's real window under a virtual screen."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from HybridVolume import job
from HybridVolume.errors import SetupError

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

needs_window = pytest.mark.skipif(
    not (shutil.which("freecad") and shutil.which("xvfb-run")), reason="needs freecad and xvfb-run"
)


def worker_python():
    """Interpreter of the worker; the test is skipped where there is none."""
    try:
        return job.worker_python()
    except SetupError as missing:
        pytest.skip(missing.line)


def play(scenario, folder, ask=False, **variables):
    """Run a scenario in FreeCAD's window and return its answer.

    Parameters
    ----------
    scenario : str
        ``"module.function"``.
    folder : Path
    ask : bool
        The preference that shows the midstructure first.
    **variables
        Of the environment; None takes one away.
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
        timeout=480,  # other runs go on beside this one
    )
    assert answer.is_file(), run.stdout[-3000:] + run.stderr[-3000:]
    found = json.loads(answer.read_text())
    assert found.get("finished"), f"{found.get('traceback')}\n{run.stderr[-3000:]}"
    return found


if __name__ == "__main__":
    # Looking at a scenario: python tests/gui_play.py MODULE.FUNCTION FOLDER [ask]
    print(json.dumps(play(sys.argv[1], Path(sys.argv[2]), ask=len(sys.argv) > 3), indent=1))
