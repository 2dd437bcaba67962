# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The process in which a mesher runs: ``python -m HybridVolume.core.tetmesh.run FOLDER ENGINE``.

Reads ``input.npz`` of the folder and writes ``output.npz``, or ``error.txt`` with a complaint.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import signal
import sys
from pathlib import Path

import numpy as np

ADAPTERS = {"gmsh": "gmsh", "netgen": "netgen", "pytetwild": "pytetwild"}


def end_with_parent() -> None:
    """Ask Linux to end this process when its parent dies: no mesher is left running alone."""
    if not sys.platform.startswith("linux"):
        return
    try:
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)
    except (OSError, AttributeError):
        return


def main(folder: Path, engine: str) -> int:
    """Run one mesher on the arrays of a folder; 0 when it gave an answer."""
    end_with_parent()
    adapter = importlib.import_module(f"{__package__}.{ADAPTERS[engine]}")
    with np.load(folder / "input.npz") as data:
        given = {name: data[name] for name in data.files}
    options = {
        name: float(given[name]) for name in ("max_size", "grading") if not np.isnan(given[name])
    }
    options["optimise"] = bool(given["optimise"])
    try:
        vertices, tets = adapter.fill(
            given["vertices"], given["triangles"], given["facets"], **options
        )
    except Exception as error:  # whatever a foreign mesher raises becomes one sentence
        (folder / "error.txt").write_text(f"{type(error).__name__}: {error}", encoding="utf-8")
        return 3
    np.savez(folder / "part.npz", vertices=vertices, tets=tets)
    os.replace(folder / "part.npz", folder / "output.npz")
    return 0


if __name__ == "__main__":
    code = main(Path(sys.argv[1]), sys.argv[2])
    sys.stdout.flush()
    sys.stderr.flush()
    # the answer is on disk; a mesher's own clean-up at exit may crash and tells nothing
    os._exit(code)
