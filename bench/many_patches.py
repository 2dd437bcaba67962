# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Seconds of the processor against the number of patches, each of one knot span.

``/usr/bin/python3 bench/many_patches.py [--kinds bilinear bicubic plate] [--patches 500 2000 10000]
[options of run.sh]`` completes bodies by the command line, with everything that it writes:

- ``bilinear``: a wavy torus as an OBJ file, a bilinear patch a quad;
- ``bicubic``: the same torus as a STEP file, a bicubic patch a quad through points of the torus;
- ``plate``: a STEP file of a bent plate with a square hole in every sixteenth place, sharp edges,
  bicubic patches: what covers of mechanical parts look like.

``s a 1000`` is the processor's time for a thousand patches, and ``growth`` tells how the time grows
from one row to the next: 1 is in proportion to the patches. The stages are wall seconds of the
report; on a busy machine only the processor's count. MB is the worker's peak.
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

import numpy as np

PROJECT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PROJECT))

from HybridVolume.core.assembly import build_surface  # noqa: E402
from HybridVolume.core.surface import SplineFace  # noqa: E402
from HybridVolume.reproduce.voxels import PolynomialMap, bent_grid  # noqa: E402

KINDS = ("bilinear", "bicubic", "plate")
STAGES = ("reading", "surface", "midstructure", "field", "shell", "interior", "exports", "document")
KNOTS = np.array([0.0] * 4 + [1.0] * 4)
THIRDS = np.array([[1, 0, 0, 0], [8, 12, 6, 1], [1, 6, 12, 8], [0, 0, 0, 1]]) / [
    [1],
    [27],
    [27],
    [1],
]
"""Cubic Bernstein polynomials at 0, 1/3, 2/3 and 1."""


def torus_size(patches: int) -> tuple[int, int]:
    """Quads along and across a torus of about so many."""
    across = max(8, round(math.sqrt(patches / 4.0)))
    return max(24, round(patches / across)), across


def torus_point(along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Points (..., 3), mm, of a torus whose tube swells six times, at turns along and across."""
    a, b = 2.0 * math.pi * along, 2.0 * math.pi * across
    thick = 4.0 + 0.8 * np.cos(6.0 * a)
    out = 14.0 + thick * np.cos(b)
    return np.stack([out * np.cos(a), out * np.sin(a), 0.7 * thick * np.sin(b)], axis=-1)


def bilinear_torus(patches: int) -> str:
    """An OBJ file of the torus in about so many quads."""
    along, across = torus_size(patches)
    i, j = np.indices((along, across))
    number = i * across + j + 1
    turned = np.roll(number, -1, axis=0)
    quads = [number, turned, np.roll(turned, -1, axis=1), np.roll(number, -1, axis=1)]
    points = torus_point(i / along, j / across).reshape(-1, 3)
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in points]
    lines += [f"f {a} {b} {c} {d}" for a, b, c, d in np.stack(quads, axis=-1).reshape(-1, 4)]
    return "\n".join(lines) + "\n"


def bicubic_torus(patches: int) -> list[SplineFace]:
    """Bicubic patches through 16 points of the torus each; neighbours share the points."""
    along, across = torus_size(patches)
    i, j = np.indices((3 * along, 3 * across))
    points = torus_point(i / (3.0 * along), j / (3.0 * across))
    back = np.linalg.inv(THIRDS)
    faces = []
    for i in range(along):
        rows = points[np.arange(3 * i, 3 * i + 4) % (3 * along)]
        for j in range(across):
            own = rows[:, np.arange(3 * j, 3 * j + 4) % (3 * across)]
            net = np.einsum("ai,bj,ijd->abd", back, back, own)
            faces.append(_bicubic(len(faces), net))
    return faces


def _bicubic(number: int, net: np.ndarray) -> SplineFace:
    return SplineFace(f"Face{number + 1}", (3, 3), (KNOTS, KNOTS), net, np.ones((4, 4)))


def bent_plate(patches: int) -> list[SplineFace]:
    """About so many bicubic patches of a bent plate, two patches thick, with square holes."""
    n = max(6, round(math.sqrt(patches / 2.4)))
    cells = np.ones((n, n, 2), dtype=bool)
    cells[2:-1:4, 2:-1:4] = False
    bend = PolynomialMap(11, 3, cells.shape, 0.4)
    return list(bent_grid(cells, bend, degrees=(3, 3, 3), merge=False).faces())


def written(kind: str, patches: int, folder: Path) -> Path:
    """The file of a body."""
    if kind == "bilinear":
        body = folder / "torus.obj"
        body.write_text(bilinear_torus(patches), encoding="utf-8")
        return body
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
    from HybridVolume.exports.step import write_solid

    faces = bicubic_torus(patches) if kind == "bicubic" else bent_plate(patches)
    body = folder / f"{kind}.step"
    write_solid(body, build_surface(faces))
    return body


def main() -> int:
    """Complete the bodies and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--patches", type=int, nargs="+", default=[500, 2000, 10000])
    arguments, options = parser.parse_known_args()
    for kind in arguments.kinds:
        print(f"{kind}\n{'patches':>8} {'processor s':>12} {'s a 1000':>9} {'growth':>7} {'MB':>6}"
              f" {'w0':>5}   {'  '.join(STAGES)}")  # fmt: skip
        before: tuple[int, float] | None = None
        for wanted in arguments.patches:
            with tempfile.TemporaryDirectory() as folder:
                body, out = written(kind, wanted, Path(folder)), Path(folder) / "out"
                started = _processor_seconds()
                command = [PROJECT / "run.sh", body, "-o", out, *options]
                command += ["--scheme", "bilinear"] if kind == "bilinear" else []
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
            stages = "  ".join(
                f"{report['seconds'].get(name, 0.0):{len(name)}.1f}" for name in STAGES
            )
            print(
                f"{patches:8d} {spent:12.1f} {1000.0 * spent / patches:9.1f} {growth:>7}"
                f" {report['peak_memory_mb']:6.0f} {report['shell']['w0']:5.3f}   {stages}",
                flush=True,
            )
    return 0


def _processor_seconds() -> float:
    """Of all processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    sys.exit(main())
