# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Speed of analysis: quadrature points of tricubic elements a second, and elasticity on a torus.

``environment/bin/python bench/analysis.py --split 6 --parts 2 --methods direct,cg``

Seconds are those of the processor on one core: numpy is told to use one thread.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_variable] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np  # noqa: E402

from HybridVolume.core.analysis.assembly import elastic, mass, stiffness  # noqa: E402
from HybridVolume.core.analysis.boundary import boundary_load, given_on_faces  # noqa: E402
from HybridVolume.core.analysis.elevation import elevated_shell  # noqa: E402
from HybridVolume.core.analysis.hybrid_space import of_volume  # noqa: E402
from HybridVolume.core.analysis.linear import solved  # noqa: E402
from HybridVolume.core.analysis.rigid import coefficient_points, rigid_motions  # noqa: E402
from HybridVolume.core.analysis.spline_space import SplineSpace  # noqa: E402
from HybridVolume.core.assembly import build_surface  # noqa: E402
from HybridVolume.core.pipeline import Options, complete  # noqa: E402
from HybridVolume.core.recovery import Material  # noqa: E402
from HybridVolume.core.refinement import split_spans  # noqa: E402
from HybridVolume.reproduce.bodies import torus  # noqa: E402

STEEL = Material(210_000.0, 0.3)
POINTS = 4
"""Gauss points a direction of a tricubic element."""


def timed(function, *arguments):
    """Seconds of the processor, and the answer."""
    start = time.process_time()
    answer = function(*arguments)
    return time.process_time() - start, answer


def assembly_speed(space: SplineSpace) -> None:
    """Print how many quadrature points a second are summed into each matrix."""
    count = space.shell.element_count * POINTS**3
    print(f"{space.shell.element_count} tricubic elements of {POINTS**3} points")
    for name, make in (
        ("mass", lambda: mass(space, POINTS)),
        ("conduction", lambda: stiffness(space, POINTS)),
        ("elasticity", lambda: elastic(space, STEEL.lame, STEEL.shear, POINTS)),
    ):
        make()
        seconds = min(timed(make)[0] for _ in range(3))
        print(f"  {name:10s} {count / seconds:10.0f} points/s")


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--split", type=int, default=6, help="parts of each knot span of the faces")
    parser.add_argument("--parts", type=int, default=2, help="parts of each layer of the shell")
    parser.add_argument("--coupling", default="collocation", help="or nitsche")
    parser.add_argument("--methods", default="direct", help="direct, cg or both")
    options = parser.parse_args()
    surface = split_spans(build_surface(list(torus(3.0, 1.0))), options.split)
    volume = complete(surface, Options())
    assembly_speed(SplineSpace(elevated_shell(volume.shell, 3)))
    space = of_volume(volume, coupling=options.coupling, parts=options.parts)
    seconds, matrix = timed(space.elasticity, STEEL, STEEL)
    print(
        f"elasticity, {3 * space.size} unknowns: matrix of {matrix.nnz} entries in {seconds:.1f} s"
    )
    spline = space.spline
    faces = spline.face_names
    unknown, component, values = given_on_faces(spline, {faces[0]: np.zeros_like}, 3)
    pushed = boundary_load(spline, lambda x, n: -n, [faces[-1]])
    right = space.loaded(pushed, np.zeros((space.tets.size, 3))).T.ravel()
    motions = np.swapaxes(rigid_motions(coefficient_points(space)), 1, 2).reshape(6, -1)
    answers = []
    for method in options.methods.split(","):
        answer, figures = solved(
            matrix, right, unknown + component * space.size, values, motions, method
        )
        answers.append(answer)
        print(
            f"  {figures.method:6s} {figures.unknowns} unknowns, {figures.seconds:.1f} s,"
            f" {figures.memory:.0f} MB, {figures.iterations} iterations,"
            f" residual {figures.residual:.1e} {figures.note}"
        )
    for other in answers[1:]:
        apart = np.linalg.norm(other - answers[0]) / np.linalg.norm(answers[0])
        print(f"  apart by {apart:.1e}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
