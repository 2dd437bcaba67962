# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh fit QUADS --to REFERENCE -o NAME.step``: spline patches from a quad mesh."""

from __future__ import annotations

import argparse
import re
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from HybridVolume.errors import HybridVolumeError, InputError
from HybridVolume.job import exit_code
from HybridVolume.options import Parser

if TYPE_CHECKING:
    from HybridVolume.core.polygons import PolygonMesh

FINENESS = 2e-4
"""Share of the diagonal by which triangles of a CAD reference may miss it."""
ANGLE = 0.15
"""Radians by which they may turn from one to the next on a smooth face: less than at features."""


def parser() -> Parser:
    """Return the parser of ``./run.sh fit``."""
    p = Parser(
        prog="./run.sh fit",
        description="Cut a quad mesh along the lines of its irregular vertices into patches, fit "
        "bicubic splines to a reference surface over them, and write the closed body.",
    )
    p.add_argument("quads", metavar="QUADS", help="OBJ, OFF or PLY file of quads, the layout")
    p.add_argument(
        "--to",
        required=True,
        metavar="REFERENCE",
        help="OBJ, OFF or PLY file of triangles, or STEP or BREP file: the surface to come near",
    )
    p.add_argument(
        "-o", "--output", required=True, metavar="NAME.step", help="STEP or BREP file to write"
    )
    p.add_argument(
        "--tolerance",
        type=_length,
        default=(0.003, "share"),
        metavar="T",
        help='largest distance: "0.3 %%" of the diagonal (the default), or "0.05 mm"',
    )
    p.add_argument(
        "--sharp",
        type=float,
        default=25.0,
        metavar="DEG",
        help="angle at which an edge of the reference is a feature (default: 25)",
    )
    return p


def _length(text: str) -> tuple[float, str]:
    found = re.fullmatch(r"\s*([0-9.]+(?:e[-+]?[0-9]+)?)\s*(mm|%)\s*", text.lower())
    try:
        value = float(found[1]) if found else 0.0
    except ValueError:
        value = 0.0
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f'{text!r} is no tolerance such as "0.3 %" or "0.05 mm"')
    return (value / 100.0, "share") if found[2] == "%" else (value, "mm")


def main(arguments: Sequence[str]) -> int:
    """Run the command; return the exit code: 2 for an input that is refused, 1 for a fault."""
    options = parser().parse_args(arguments)
    try:
        print(run(options))
    except HybridVolumeError as error:
        print(f"error: {error.line}", file=sys.stderr)
        return exit_code(error)
    except OSError as fault:
        print(f"error: {fault}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("error: stopped; nothing was written", file=sys.stderr)
        return 130
    except Exception as fault:
        print(f"error: fault of HybridVolume: {type(fault).__name__}: {fault}", file=sys.stderr)
        traceback.print_exc()
        return 1
    return 0


def run(options: argparse.Namespace) -> str:
    """Fit and write; return a line that tells what was reached."""
    from HybridVolume.core.fit.fitting import fit
    from HybridVolume.core.polygon_repair import mended
    from HybridVolume.exports.step import SUFFIXES, write_solid
    from HybridVolume.freecad_python import import_freecad
    from HybridVolume.sources.polygon_files import read_polygons

    output = Path(options.output)
    if output.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"{output.name} is no STEP or BREP file", remedy=f"end it with {', '.join(SUFFIXES)}"
        )
    if not 1.0 <= options.sharp <= 179.0:
        raise InputError(
            f"features from {options.sharp:g} degrees", remedy="choose from 1 to 179 degrees"
        )
    import_freecad()
    reference = reference_mesh(options.to)
    value, kind = options.tolerance
    tolerance = value * reference.diagonal if kind == "share" else value
    quads = mended(read_polygons(options.quads))
    found = fit(quads, reference, tolerance, sharp=options.sharp)
    write_solid(output, found.surface)
    return (
        f"{output.name}: {len(found.faces)} patches, {len(found.surface.control_points)} control"
        f" points, at most {found.distance:.3g} mm from the reference"
        f" ({found.distance / reference.diagonal:.2%} of the diagonal), volume"
        f" {found.surface.volume():.6g} mm³ (reference {reference.volume():.6g}); corners of"
        f" {found.corners.min():.0f} to {found.corners.max():.0f} degrees, normals of a knot span"
        f" within {found.cone:.0f} degrees"
        + (f", {len(found.opened)} straight corners opened" if found.opened else "")
    )


def reference_mesh(path: str) -> PolygonMesh:
    """The reference as a closed mesh of triangles.

    Raises
    ------
    InputError
        It cannot be read, or is not closed.
    """
    from HybridVolume.core.polygon_repair import mended
    from HybridVolume.core.polygons import PolygonMesh
    from HybridVolume.sources.polygon_files import SUFFIXES, read_polygons
    from HybridVolume.sources.step import read_any_shape

    if Path(path).suffix.lower() in SUFFIXES:
        return mended(read_polygons(path))
    import MeshPart

    shape = read_any_shape(path)
    # Shape.tessellate does not come to an end on some filleted bodies (OpenCASCADE 7.6)
    points, triangles = MeshPart.meshFromShape(
        Shape=shape,
        LinearDeflection=FINENESS * shape.BoundBox.DiagonalLength,
        AngularDeflection=ANGLE,
        Relative=False,
    ).Topology
    return mended(PolygonMesh.of([tuple(point) for point in points], triangles))
