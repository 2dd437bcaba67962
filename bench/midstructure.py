# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Seconds of the medial axis, of a choice and of the hints, for several numbers of samples.

``/usr/bin/python3 bench/midstructure.py [--samples 5000 10000 20000 50000] [--runs 3]``: medians
of the processor's seconds, and each in units of the one before. The fandisk is read by FreeCAD; all
is measured in the worker's environment. ``OMP_NUM_THREADS=1`` makes runs comparable.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PROJECT))

from HybridVolume import exchange, sources  # noqa: E402
from HybridVolume.freecad_python import import_freecad  # noqa: E402
from HybridVolume.job import worker_python  # noqa: E402

MADE = ("box", "bracket", "cylinder")
WHAT = ("medial_axis_cpu", "choose_cpu", "hints_cpu")


def main() -> int:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, nargs="+", default=[5000, 10_000, 20_000, 50_000])
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    import_freecad()
    with tempfile.TemporaryDirectory() as folder:
        fandisk = Path(folder) / "fandisk.npz"
        body = sources.read_file(PROJECT / "resources" / "examples" / "fandisk.step")[0]
        exchange.write_surface(fandisk, body.faces)
        command = [worker_python(), "-m", "HybridVolume.reproduce.timing", *MADE, str(fandisk)]
        command += ["--samples", *map(str, options.samples), "--runs", str(options.runs)]
        done = subprocess.run(command, cwd=PROJECT, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        return done.returncode
    print(f"{'body':10s} {'samples':>8s} {'facets':>8s} {'sheets':>6s}", end="")
    print("".join(f" {name:>18s}" for name in WHAT))
    before: dict = {}
    for row in json.loads(done.stdout):
        name = Path(row["body"]).stem
        line = f"{name:10s} {row['samples']:8d} {row['facets']:8d} {row['sheets']:6d}"
        for what in WHAT:
            ratio = f"x{row[what] / before[what]:.1f}" if before.get("body") == name else ""
            line += f" {row[what]:9.3f} s {ratio:>6s}"
        before = {**row, "body": name}
        print(line)
    return 0


if __name__ == "__main__":
    sys.exit(main())
