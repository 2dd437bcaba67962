# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The same input gives the same shell, bit for bit, in another process with one thread."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import bodies

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.pipeline import Options, complete

HERE = Path(__file__).resolve().parent


def digest() -> str:
    """Hash of all layers of control points of a small body's shell, and of its proof."""
    surface = build_surface(list(bodies.l_bracket(spans=2).faces))
    options = Options(thickness="0.15 mm", spacing="ratio 1.3", samples=3000)
    volume = complete(surface, options)
    # this mesher asks for a time, and its answer depends on it
    assert volume.field["mesher"] != "pytetwild"
    found = hashlib.sha256(volume.shell.layers.tobytes())
    found.update(volume.certificate.min_bernstein.tobytes())
    found.update(volume.interior.mesh.vertices.tobytes())
    return found.hexdigest()


def test_two_processes_give_the_same_bits():
    running = []
    for seed in ("1", "2"):
        environment = {
            **os.environ,
            "PYTHONHASHSEED": seed,
            "PYTHONPATH": os.pathsep.join([str(HERE), str(HERE.parent)]),
            **{f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")},
        }
        command = [sys.executable, "-c", "import test_core_determinism as t; print(t.digest())"]
        running.append(
            subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        )
    found = [process.communicate(timeout=240)[0].split()[-1:] for process in running]
    assert [process.returncode for process in running] == [0, 0]
    assert len(found[0][0]) == 64 and found[0] == found[1]
