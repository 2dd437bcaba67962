# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Seconds of the processor against the number of patches, one bilinear patch a quad.

A wavy torus is cut into more and more quads and completed by the command line each time:

``/usr/bin/python3 bench/many_patches.py --patches 500 2000 10000 [options of run.sh]``

The last column tells how the time grows from one row to the next: 1 is in proportion to the
patches. The stages are wall seconds of the report; on a busy machine only the processor's count.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
STAGES = ("reading", "surface", "midstructure", "field", "shell", "interior", "exports", "document")


def wavy_torus(patches: int) -> str:
    """An OBJ file of a torus (mm) whose tube swells six times, in about so many quads."""
    across = max(8, round(math.sqrt(patches / 4.0)))
    along = max(24, round(patches / across))
    lines = []
    for i in range(along):
        a = 2.0 * math.pi * i / along
        thick = 4.0 + 0.8 * math.cos(6.0 * a)
        for j in range(across):
            b = 2.0 * math.pi * j / across
            out = 14.0 + thick * math.cos(b)
            x, y, z = out * math.cos(a), out * math.sin(a), 0.7 * thick * math.sin(b)
            lines.append(f"v {x:.9f} {y:.9f} {z:.9f}")
    for i in range(along):
        for j in range(across):
            corners = ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
            numbers = [k % along * across + n % across + 1 for k, n in corners]
            lines.append("f " + " ".join(map(str, numbers)))
    return "\n".join(lines) + "\n"


def main() -> int:
    """Complete the bodies and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--patches", type=int, nargs="+", default=[500, 2000, 10000])
    arguments, options = parser.parse_known_args()
    print(f"{'patches':>8} {'processor s':>12} {'s a 1000':>9} {'growth':>7}   {'  '.join(STAGES)}")
    before: tuple[int, float] | None = None
    for wanted in arguments.patches:
        with tempfile.TemporaryDirectory() as folder:
            body, out = Path(folder) / "torus.obj", Path(folder) / "out"
            body.write_text(wavy_torus(wanted), encoding="utf-8")
            started = _processor_seconds()
            command = [PROJECT / "run.sh", body, "--scheme", "bilinear", "-o", out, *options]
            answer = subprocess.run(command, capture_output=True, text=True)
            if answer.returncode:
                sys.stderr.write(answer.stderr)
                return answer.returncode
            spent = _processor_seconds() - started
            report = json.loads((out / "report.json").read_text(encoding="utf-8"))
        patches = report["input"]["patches"]
        growth = ""
        if before is not None:
            growth = f"{math.log(spent / before[1]) / math.log(patches / before[0]):.2f}"
        before = patches, spent
        stages = "  ".join(f"{report['seconds'].get(name, 0.0):{len(name)}.1f}" for name in STAGES)
        print(
            f"{patches:8d} {spent:12.1f} {1000.0 * spent / patches:9.1f} {growth:>7}   {stages}",
            flush=True,
        )
    return 0


def _processor_seconds() -> float:
    """Of all processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    sys.exit(main())
