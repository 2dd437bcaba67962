# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Seconds of the medial axis, of a choice among its sheets, and of the hints.

``python -m HybridVolume.reproduce.timing [BODY ...] [--samples N ...] [--runs N]`` prints JSON; it
runs in the worker's environment, so that what is told is what a user waits for.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from statistics import median
from typing import Any

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.midstructure import medial_axis
from HybridVolume.core.midstructure.hints import hints
from HybridVolume.core.surface import PatchSurface

from .bodies import exact_bodies

BODIES = ("box", "bracket", "cylinder")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bodies", nargs="*", default=list(BODIES), help="names, or surface files")
    parser.add_argument("--samples", type=int, nargs="+", default=[20_000])
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args(arguments)
    rows = []
    for name in options.bodies:
        surface = surface_of(name)
        rows.extend(measure(name, surface, samples, options.runs) for samples in options.samples)
    json.dump(rows, sys.stdout, indent=1)
    print()
    return 0


def surface_of(name: str) -> PatchSurface:
    """A body made here, or one of a file that :mod:`HybridVolume.exchange` wrote."""
    made = {body.name: body.faces for body in exact_bodies()}
    if name in made:
        return build_surface(made[name])
    from pathlib import Path

    from HybridVolume.exchange import read_surface

    return build_surface(read_surface(Path(name)))


def measure(name: str, surface: PatchSurface, samples: int, runs: int) -> dict[str, Any]:
    """Medians over some runs.

    Returns
    -------
    dict
        ``body``, ``samples``, ``sheets``, ``facets``, and for ``medial_axis``, ``choose`` and
        ``hints`` the seconds on the wall, and as ``..._cpu`` those of the processor, which do not
        depend on what else the machine does.
    """
    finding, found = _median(lambda: medial_axis(surface, samples), runs)
    choosing, chosen = _median(lambda: found.choose(angle=120.0), runs)
    telling, _ = _median(lambda: hints(chosen), runs)
    row = {
        "body": name,
        "samples": samples,
        "sheets": len(found.sheets),
        "facets": len(found.facets),
    }
    spent = {"medial_axis": finding, "choose": choosing, "hints": telling}
    for what, (wall, processor) in spent.items():
        row[what], row[f"{what}_cpu"] = wall, processor
    return row


def _median(work: Callable[[], Any], runs: int) -> tuple[tuple[float, float], Any]:
    wall, processor, result = [], [], None
    for _ in range(runs):
        started = time.perf_counter(), time.process_time()
        result = work()
        wall.append(time.perf_counter() - started[0])
        processor.append(time.process_time() - started[1])
    return (median(wall), median(processor)), result


if __name__ == "__main__":
    sys.exit(main())
