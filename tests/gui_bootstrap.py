# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""FreeCAD's window runs this: one scenario, its answer into a JSON file."""

import importlib
import json
import os
import sys
import traceback

from PySide import QtCore

sys.path.insert(0, os.environ["HYBRIDVOLUME_TESTS"])


def run():
    """Run the scenario that the environment names and end FreeCAD."""
    answer = {}
    try:
        module, function = os.environ["HYBRIDVOLUME_SCENARIO"].split(".")
        getattr(importlib.import_module(module), function)(answer)
        answer["finished"] = True
    except BaseException:
        answer["traceback"] = traceback.format_exc()
    with open(os.environ["HYBRIDVOLUME_ANSWER"], "w", encoding="utf-8") as file:
        json.dump(answer, file)
    os._exit(0)


QtCore.QTimer.singleShot(800, run)
