# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The command line as a process, in folders that show what it leaves behind; needs FreeCAD."""

import os
import subprocess
import sys
from pathlib import Path

import FreeCAD
import Part

PROJECT = Path(__file__).resolve().parent.parent


def command(place, *arguments, **variables):
    environment = {
        **os.environ,
        "PYTHONPATH": str(PROJECT),
        "TMPDIR": str(place.parent / "temporary"),
        **variables,
    }
    return {
        "args": [sys.executable, "-P", "-m", "HybridVolume", *map(str, arguments)],
        "cwd": place,
        "env": environment,
        "stdin": subprocess.DEVNULL,
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "text": True,
    }


def run(place, *arguments, **variables):
    return subprocess.run(**command(place, *arguments, **variables), timeout=120)


def tree(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def leftovers(place):
    """Job folders and the like (FreeCAD's own lock files are not ours)."""
    return [name for name in tree(place.parent / "temporary") if "ybrid" in name]


def one_line(answer, code):
    assert answer.returncode == code, answer.stderr
    assert answer.stdout == ""
    lines = answer.stderr.splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: "), answer.stderr
    return lines[0]


def box(length=3.0, width=2.0, height=1.0, at=(0, 0, 0)):
    return Part.makeBox(length, width, height, FreeCAD.Vector(*at))


def write_step(shape, path):
    shape.exportStep(str(path))
    return path
