# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Processor seconds by stage against the number of elements of the surface, and peak memory.

``environment/bin/python bench/shell_size.py [--sizes 100 300 1000] [--kinds small big]``: a cube
without one of its eight parts, bent by a quadratic map, once as one patch an element, once as 24
patches with many spans. In brackets the exponent against the row before: 1 is linear. What the
shell stage calls is told apart from the rest of it. One thread each, which makes runs comparable.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import os
import pstats
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

PROJECT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PROJECT))

from HybridVolume.core import (  # noqa: E402
    check,
    column_state,
    contacts,
    growth,
    pipeline,
    refinement,
)
from HybridVolume.core.assembly import build_surface  # noqa: E402
from HybridVolume.core.finite_elements import build_finite_elements  # noqa: E402
from HybridVolume.core.gap import gap_volume  # noqa: E402
from HybridVolume.core.midstructure import Search, find_midstructure  # noqa: E402
from HybridVolume.core.surface import SplineFace  # noqa: E402
from HybridVolume.reproduce.voxels import PolynomialMap, bent_grid  # noqa: E402

INSIDE = {
    "front": "solve_front",
    "untangle": "optimise",
    "proof": "certify",
    "crossings": "self_intersections",
}
"""Parts of the shell stage, and the functions that they are."""
MODULES = (growth, column_state, contacts)
STAGES = ("assemble", "check", "midstructure", "field", *INSIDE, "shell", "interior")


def notched_cube(elements: int, *, merge: bool) -> tuple[SplineFace, ...]:
    """A bent cube without an eighth, of about so many quadratic surface elements."""
    n = max(2, round((elements / 6.0) ** 0.5))
    cells = np.ones((n, n, n), dtype=bool)
    cells[n // 2 :, n // 2 :, n // 2 :] = False
    bend = PolynomialMap(7, 2, cells.shape, 0.4)
    return bent_grid(cells, bend, merge=merge).faces()


def measure(kind: str, size: int, profile: bool, shell_too: bool) -> dict[str, Any]:
    """Processor seconds of all stages for one body; with the shell's figures."""
    spent = dict.fromkeys(STAGES, 0.0)

    def timed(name: str, work: Callable) -> Callable:
        def run(*arguments: Any, **named: Any) -> Any:
            started = time.process_time()
            try:
                return work(*arguments, **named)
            finally:
                spent[name] += time.process_time() - started

        return run

    for name, function in INSIDE.items():
        for module in MODULES:
            if hasattr(module, function):
                setattr(module, function, timed(name, getattr(module, function)))
    faces = notched_cube(size, merge=kind == "big")
    profiler = cProfile.Profile(time.process_time)
    if profile:
        profiler.enable()
    surface = timed("assemble", build_surface)(list(faces))

    def checked() -> Any:
        body = refinement.flatten_spans(surface)
        pipeline._deviation(surface, body)
        check.check_surface(body)
        check.check_uncut(body)
        return body

    body = timed("check", checked)()
    found = timed("midstructure", find_midstructure)(body, Search())
    stage = pipeline.Stage(body, 0.0, found)
    field = timed("field", pipeline.field_stage)(stage)
    row = {
        "kind": kind,
        "elements": body.element_count,
        "patches": len(body.patches),
        "tets": len(field.mesh.tets),
    }
    if shell_too:
        shell, certificate = timed("shell", growth.grow_shell)(body, field, 0.5)
        spent["shell"] -= sum(spent[name] for name in INSIDE)
        interface, interior, fem = timed("interior", build_finite_elements)(shell)
        timed("interior", gap_volume)(interface, shell)
        row["w0"], row["valid"] = shell.w0, bool(certificate.all_valid)
    profiler.disable()
    if profile:
        pstats.Stats(profiler, stream=sys.stderr).sort_stats("tottime").print_stats(45)
    row["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return {**row, "spent": spent}


def main() -> int:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+",
                        default=[100, 300, 1000, 3000, 10_000, 20_000])  # fmt: skip
    parser.add_argument("--kinds", nargs="+", choices=("small", "big"), default=["small", "big"])
    parser.add_argument("--limit", type=float, default=1800.0, help="seconds for a body (1800)")
    parser.add_argument("--profile", action="store_true", help="functions by their own seconds")
    parser.add_argument("--field-only", action="store_true", help="only as far as the field")
    parser.add_argument("--one", nargs=2, metavar=("KIND", "SIZE"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        kind, size = options.one
        row = measure(kind, int(size), options.profile, not options.field_only)
        json.dump(row, sys.stdout)
        return 0
    print("| patches | elements | " + " | ".join(STAGES) + " | all | MB | w0 | tets |")
    print("|---" * (len(STAGES) + 6) + "|")
    for kind in options.kinds:
        before: dict[str, Any] | None = None
        for size in options.sizes:
            command = [sys.executable, __file__, "--one", kind, str(size)]
            command += ["--profile"] * options.profile + ["--field-only"] * options.field_only
            try:
                done = subprocess.run(
                    command,
                    stdout=subprocess.PIPE,
                    text=True,
                    timeout=options.limit,
                    env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
                )
            except subprocess.TimeoutExpired:
                print(f"| {kind} | {size} | not done in {options.limit:g} s |", flush=True)
                continue
            if done.returncode:
                print(f"| {kind} | {size} | failed |", flush=True)
                continue
            # a mesher may have printed before
            row = json.loads(done.stdout[done.stdout.rindex('{"kind"') :])
            print(as_line(row, before), flush=True)
            before = row
    return 0


def as_line(row: dict[str, Any], before: dict[str, Any] | None) -> str:
    """A row of the table."""
    spent = {**row["spent"], "all": sum(row["spent"].values())}
    words = []
    for name, seconds in spent.items():
        word = f"{seconds:.2f}"
        if before and seconds > 0.05:
            last = {**before["spent"], "all": sum(before["spent"].values())}[name]
            growth_of = np.log(row["elements"] / before["elements"])
            word += f" ({np.log(seconds / max(last, 1e-3)) / growth_of:.1f})"
        words.append(word)
    reached = f"{row['w0']:.3f}{'' if row['valid'] else ' not proved'}" if "w0" in row else "-"
    return (
        f"| {row['patches']} | {row['elements']} | {' | '.join(words)} | {row['memory']:.0f}"
        f" | {reached} | {row['tets']} |"
    )


if __name__ == "__main__":
    sys.exit(main())
