# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The options of the command line; :mod:`.option_words` reads their words."""

from __future__ import annotations

import argparse
from typing import NoReturn

import HybridVolume
from HybridVolume import option_words as words
from HybridVolume.job import ELEMENTS


class _Help(argparse.HelpFormatter):
    """Wraps the text, but keeps the lines of the examples."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        words, _, examples = text.partition("\n\n")
        filled = super()._fill_text(words, width, indent)
        return f"{filled}\n\n{examples}" if examples else filled


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """End with code 2."""
        self.exit(2, f"error: {message}; see {self.prog} --help\n")


def parser() -> Parser:
    """Return the parser of the command line."""
    p = Parser(
        prog="./run.sh",
        description="Complete the volume of the bodies of a STEP or BREP file, or of a closed mesh "
        "of quads or a cage (OBJ, OFF, PLY): a shell of NURBS elements that keeps untrimmed faces "
        "bit for bit, plane ones and whole rectangles of surfaces exactly and others within a "
        "tolerance, tetrahedra in the core, one mesh for FEM.",
        epilog="Writes NAME.FCStd, NAME.vtu, NAME.inp, NAME.png and report.json, and what --export "
        "names. Ends with 0 when "
        "every element is proved valid, 2 for an input that it refuses, 1 for a fault of its own. "
        "`./run.sh reproduce NAME -o DIR` makes a figure or table of the documentation again.\n\n"
        "examples:\n"
        "  ./run.sh part.step --w0 0.3\n"
        '  ./run.sh part.step --thickness "2 mm" --face-factor Face3=1.5 --face-factor Face7=0.5\n'
        '  ./run.sh part.step --thickness "30 %" --layers 4 --spacing "ratio 1.5"\n'
        '  ./run.sh part.step --thickness "min 1 mm" --layers 5 --spacing "first 0.1 mm"\n'
        "  ./run.sh part.step --cover-tolerance 0.01\n"
        "  ./run.sh part.step --size 2 --face-size Face3=0.5 --fem-layers 4 --export unv,msh\n",
        formatter_class=_Help,
    )
    p.add_argument(
        "body",
        metavar="BODY",
        help="STEP or BREP file with solids, or a mesh (.obj, .off, .ply)",
    )
    p.add_argument("-o", "--output", metavar="DIR", help="output folder (default: ./NAME)")
    _add_cover(p)
    _add_mesh_files(p)
    _add_thickness(p)
    _add_spans(p)
    p.add_argument(
        "--method",
        choices=("certified", "paper"),
        default="certified",
        help="how the shell is made: as described in docs/design.md, or as in the paper's section "
        "3, for smooth bodies and comparison; every element is proved either way "
        "(default: certified)",
    )
    _add_midstructure(p)
    _add_mesh(p)
    p.add_argument(
        "--tolerance",
        type=words.share,
        default=1e-7,
        metavar="T",
        help="points closer than this share of the diagonal are one (default: 1e-7)",
    )
    p.add_argument(
        "--pictures",
        action="store_true",
        help="draw the stages as well: NAME_field.png, NAME_columns.png, NAME_shell.png, "
        "NAME_level.png, NAME_thickness.png, NAME_histogram.png, NAME_worst.png, "
        "NAME_fem_histogram.png",
    )
    p.add_argument(
        "--singular-lines",
        action="store_true",
        help="also take bodies whose own surface is singular along lines (doubled control "
        "points): det J is zero there and proved positive everywhere else",
    )
    p.add_argument("--free-only", action="store_true", help="leave the GPL parts out")
    p.add_argument("--version", action="version", version=f"HybridVolume {HybridVolume.version}")
    return p


def _add_cover(p: Parser) -> None:
    group = p.add_argument_group(
        "faces",
        "how trimmed faces, seams, poles and T-junctions of a solid become four-sided patches; "
        "report.json says of every face whether it is kept bit for bit, exactly, or how closely",
    )
    either = group.add_mutually_exclusive_group()
    either.add_argument(
        "--cover-tolerance",
        type=words.length,
        metavar="MM",
        help="largest distance of patches from such faces; it is met or the body refused "
        "(default: 1e-4 of the diagonal)",
    )
    either.add_argument(
        "--no-cover",
        action="store_false",
        dest="cover",
        help="refuse bodies with such faces",
    )


def _add_mesh_files(p: Parser) -> None:
    from HybridVolume.sources.meshes import SCHEMES

    group = p.add_argument_group("mesh files", "how an OBJ, OFF or PLY file becomes patches")
    group.add_argument(
        "--scheme",
        choices=SCHEMES,
        default="auto",
        help="one bilinear patch a quad; the Catmull-Clark surface of a cage, with the creases of "
        "OpenSubdiv's OBJ files; or a smooth bicubic surface without creases (default: auto, "
        "Catmull-Clark where there are creases or other faces than quads, else bilinear)",
    )
    group.add_argument(
        "--steps",
        type=words.steps,
        metavar="N",
        help="subdivisions first, 0 to 5 (default: as many as the scheme needs)",
    )
    group.add_argument(
        "--sharp-angle",
        type=words.number,
        default=0.0,
        metavar="DEG",
        help="edges of a cage that turn by more are creases too (default: 0, only those named)",
    )


def _add_thickness(p: Parser) -> None:
    group = p.add_argument_group("shell", "how thick it is, and how it is cut into layers")
    wanted = group.add_mutually_exclusive_group()
    wanted.add_argument(
        "--w0",
        type=words.share,
        default=0.5,
        metavar="W",
        help="share of the way from the faces to the midstructure, as a level of the harmonic "
        "field (default: 0.5)",
    )
    wanted.add_argument(
        "--thickness",
        type=words.thickness,
        metavar="TEXT",
        help='in place of --w0: "2 mm" everywhere, "mean 2 mm", "min 2 mm" (at the thinnest '
        'place), or "30 %%" of the local radius, which is half the body\'s thickness',
    )
    group.add_argument(
        "--face-factor",
        type=words.factor,
        action="append",
        default=[],
        dest="face_factors",
        metavar="Face3=1.5",
        help="makes the shell thicker or thinner at a face (repeatable)",
    )
    group.add_argument(
        "--layers",
        type=words.count,
        default=2,
        metavar="N",
        help="layers of elements, 1 to 50 (default: 2)",
    )
    group.add_argument(
        "--spacing",
        type=words.spacing,
        default="volume",
        metavar="TEXT",
        help='layers of equal volume ("volume") or height ("distance"), each higher than the one '
        'outside of it ("ratio 1.5"), or with an outermost one of so many mm ("first 0.2 mm") '
        "(default: volume)",
    )
    group.add_argument(
        "--degree",
        type=words.count,
        default=3,
        metavar="P",
        help="degree through the shell, 1 to 6 (default: 3)",
    )


def _add_spans(p: Parser) -> None:
    group = p.add_argument_group(
        "spans",
        "how the faces are cut first, exactly, so that elements have similar size and shape; as "
        "fine as the shell needs in any case: where normals turn by more than 80 degrees, and "
        "where at least half of a strip is more than ten times as long as wide (of bodies of up "
        "to 5,000 spans)",
    )
    group.add_argument(
        "--span-size",
        type=words.evenness("size"),
        default=0.0,
        metavar="MM",
        help="longest side of a span (default: 0, any)",
    )
    group.add_argument(
        "--span-aspect",
        type=words.evenness("aspect"),
        default=0.0,
        metavar="A",
        help="longest over shortest side, 2 or more, where half of a strip's spans ask for it "
        "(default: 0, up to 10)",
    )
    group.add_argument(
        "--span-turn",
        type=words.evenness("turn"),
        default=0.0,
        metavar="DEG",
        help="largest turn of the normal along a span, 1 to 180 degrees (default: 0, as needed)",
    )


def _add_midstructure(p: Parser) -> None:
    group = p.add_argument_group("midstructure", "what the shell grows towards, inside the body")
    group.add_argument(
        "--midstructure",
        type=words.midstructure,
        default="auto",
        metavar="M",
        help="auto, medial-axis, skeleton (curves, for tubular bodies), distance (a surface of "
        "equal distance), or a STEP or BREP file with points, wires or faces (default: auto)",
    )
    group.add_argument(
        "--depth",
        type=words.depth,
        default="50%",
        metavar="D",
        help="of distance: a share of the largest distance or mm, e.g. 50%% or 2.5mm "
        "(default: 50%%)",
    )
    group.add_argument(
        "--samples",
        type=words.samples,
        default=0,
        metavar="N",
        help="samples of the surface (default: 0, by the body)",
    )
    group.add_argument(
        "--angle",
        type=words.number,
        default=125.0,
        metavar="DEG",
        help="smallest object angle of what a medial axis keeps (default: 125)",
    )
    group.add_argument(
        "--minimum-size",
        type=words.number,
        default=1.0,
        metavar="S",
        help="smallest area of a part that a medial axis keeps, in squares of its distance to the "
        "surface (default: 1)",
    )
    p.set_defaults(decisions=[])
    for action, told in (
        ("remove", "leave the sheets between two faces out; @u,v names the one at that place of "
         "the first face (repeatable)"),
        ("keep", "keep them (repeatable)"),
        ("only", "keep them and no others (repeatable)"),
    ):  # fmt: skip
        group.add_argument(
            "--keep-only" if action == "only" else f"--{action}-sheet",
            action=words.Decide,
            const=action,
            dest="decisions",
            metavar="Face3+Face9[@u,v]",
            help=told,
        )


def _add_mesh(p: Parser) -> None:
    group = p.add_argument_group(
        "finite elements", "how fine they are, and in which files; the shell does not depend on it"
    )
    group.add_argument(
        "--order", type=int, choices=(1, 2), default=2, help="their order (default: 2)"
    )
    group.add_argument(
        "--nodes",
        choices=("knots", "greville"),
        default="knots",
        help="nodes between shell and core (default: knots)",
    )
    group.add_argument(
        "--subdivide",
        type=words.density("subdivide", int),
        default=1,
        metavar="N",
        help="parts that each side of the shell's elements is cut into at least, 1 to 64 "
        "(default: 1)",
    )
    group.add_argument(
        "--size",
        type=words.length,
        default=0.0,
        metavar="MM",
        help="largest edge along the faces (default: as the shell's elements are)",
    )
    group.add_argument(
        "--face-size",
        type=words.face_size,
        action="append",
        default=[],
        dest="face_sizes",
        metavar="Face3=0.5",
        help="the same near a face, mm (repeatable)",
    )
    group.add_argument(
        "--gradation",
        type=words.density("gradation"),
        default=0.5,
        metavar="G",
        help="by how many mm the size grows a mm away from a face of its own size (default: 0.5)",
    )
    group.add_argument(
        "--fem-layers",
        type=words.density("layers", int),
        default=0,
        metavar="N",
        help="layers of wedges through the shell, up to 100; 0: the shell's own where nothing is "
        "cut, else so many that the outermost is about a fifth of an edge (default: 0)",
    )
    group.add_argument(
        "--layer-growth",
        type=words.density("growth"),
        default=1.3,
        metavar="R",
        help="height of each layer of wedges over that of the one outside of it, 1 to 3 "
        "(default: 1.3)",
    )
    group.add_argument(
        "--elements",
        choices=ELEMENTS,
        default="wedges",
        help="what the shell consists of in NAME.inp: wedges, or hexahedra of 20 nodes with "
        "equations in the middle of the quadrilaterals between shell and core (default: wedges)",
    )
    group.add_argument(
        "--export",
        type=words.formats,
        action="extend",
        default=[],
        metavar="LIST",
        help="further files: of the mesh unv, med, msh (Gmsh 4.1) and vtu (NAME_fem.vtu), of the "
        "body's surface step (NAME_surface.step), of the shell mfem (NAME.mesh) and gismo "
        "(NAME.xml) with NAME_core.msh and NAME_interface.csv, e.g. unv,msh,step",
    )
