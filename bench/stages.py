# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Seconds by stage of the command line, medians over some runs.

``/usr/bin/python3 bench/stages.py resources/examples/fandisk.step --runs 3 [options of run.sh]``
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

PROJECT = Path(__file__).resolve().parent.parent


def main() -> int:
    """Run the body some times and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("body", type=Path)
    parser.add_argument("--runs", type=int, default=3)
    arguments, options = parser.parse_known_args()
    reports = []
    for _ in range(arguments.runs):
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "out"
            command = [PROJECT / "run.sh", arguments.body.resolve(), "-o", out, *options]
            answer = subprocess.run(command, capture_output=True, text=True)
            if answer.returncode:
                sys.stderr.write(answer.stderr)
                return answer.returncode
            reports.append(json.loads((out / "report.json").read_text()))
    for stage in reports[0]["seconds"]:
        spent = [report["seconds"].get(stage, 0.0) for report in reports]
        print(f"{stage:14s} {median(spent):7.2f} s   {min(spent):7.2f} ... {max(spent):7.2f}")
    last = reports[-1]
    print(
        f"memory {last['peak_memory_mb']:.0f} MB, w0 {last['shell']['w0']:.3f}, meshers:"
        f" {last['field']['mesher']} (field), {last['interior']['mesher']} (core)"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
