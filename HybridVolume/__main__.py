# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The command line: ``python -m HybridVolume BODY.step [options]``, in FreeCAD's Python.

``reproduce`` as the first word remakes a figure or table of the documentation instead.

Ends with 0 when every element is certified, 2 for an input that is refused (one line says why), 1
for a fault of its own; 128 + n when signal n ended it. Nothing half-written ever stays.
"""

from __future__ import annotations

import argparse
import logging
import math
import signal
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import HybridVolume
from HybridVolume.completion import Screen, complete_file
from HybridVolume.errors import HybridVolumeError, InputError
from HybridVolume.job import exit_code

LATER = ("fit", "bench")
"""Words that a later version takes as commands."""
GEOMETRY_SUFFIXES = (".step", ".stp", ".brep", ".brp")


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """End with code 2."""
        self.exit(2, f"error: {message}; see ./run.sh --help\n")


def _share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no number between 0 and 1")
    return value


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no count of 1 or more")
    return int(text)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is no number")
    return value


def _samples(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is no number of samples")
    return int(text)


def _midstructure(text: str) -> str:
    """A method that needs nothing else, or a file."""
    if Path(text).suffix.lower() in GEOMETRY_SUFFIXES:
        return text
    from HybridVolume.core.midstructure.search import METHODS

    methods = [method for method in METHODS if method != "own"]
    if text not in methods:
        raise argparse.ArgumentTypeError(
            f"{text!r} is none of {', '.join(methods)}, and no STEP or BREP file"
        )
    return text


def _depth(text: str) -> str:
    from HybridVolume.core.midstructure.search import parse_depth

    try:
        parse_depth(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(error.line) from None
    return text


class _Decide(argparse.Action):
    """Collects decisions about sheets of all kinds in their order."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: Any, values: Any, option: Any = None
    ) -> None:
        from HybridVolume.core.midstructure import Decision

        try:
            decision = Decision.about(self.const, values)
        except InputError as error:
            raise argparse.ArgumentError(self, error.line) from None
        namespace.decisions = [*namespace.decisions, str(decision)]


def parser() -> Parser:
    """Return the parser of the command line."""
    p = Parser(
        prog="./run.sh",
        description="Complete the volume of the bodies of a STEP or BREP file: a shell of NURBS "
        "elements that keeps their faces bit for bit, tetrahedra in the core, one mesh for FEM.",
        epilog="Writes NAME.FCStd, NAME.vtu, NAME.inp, NAME.png and report.json. Ends with 0 when "
        "every element is proved valid, 2 for an input that it refuses, 1 for a fault of its own. "
        "`./run.sh reproduce NAME -o DIR` makes a figure or table of the documentation again.",
    )
    p.add_argument("body", metavar="BODY.step", help="STEP or BREP file with untrimmed NURBS faces")
    p.add_argument("-o", "--output", metavar="DIR", help="output folder (default: ./NAME)")
    p.add_argument(
        "--w0",
        type=_share,
        default=0.5,
        metavar="W",
        help="thickness of the shell: share of the way to the midstructure (default: 0.5)",
    )
    p.add_argument(
        "--layers",
        type=_count,
        default=2,
        metavar="N",
        help="layers of elements in the shell (default: 2)",
    )
    p.add_argument(
        "--degree",
        type=_count,
        default=3,
        metavar="P",
        help="degree through the shell (default: 3)",
    )
    p.add_argument(
        "--method",
        choices=("certified", "paper"),
        default="certified",
        help="how the shell is made: as described in docs/design.md, or as in the paper's section "
        "3, for smooth bodies and comparison; every element is proved either way "
        "(default: certified)",
    )
    _add_midstructure(p)
    p.add_argument(
        "--order", type=int, choices=(1, 2), default=2, help="order of the FEM mesh (default: 2)"
    )
    p.add_argument(
        "--nodes",
        choices=("knots", "greville"),
        default="knots",
        help="nodes between shell and core (default: knots)",
    )
    p.add_argument(
        "--tolerance",
        type=_share,
        default=1e-7,
        metavar="T",
        help="points closer than this share of the diagonal are one (default: 1e-7)",
    )
    p.add_argument(
        "--pictures",
        action="store_true",
        help="draw the stages as well: NAME_field.png, NAME_columns.png, NAME_shell.png, "
        "NAME_level.png, NAME_thickness.png, NAME_histogram.png, NAME_worst.png",
    )
    p.add_argument("--free-only", action="store_true", help="leave the GPL parts out")
    p.add_argument("--version", action="version", version=f"HybridVolume {HybridVolume.version}")
    return p


def _add_midstructure(p: Parser) -> None:
    group = p.add_argument_group("midstructure", "what the shell grows towards, inside the body")
    group.add_argument(
        "--midstructure",
        type=_midstructure,
        default="auto",
        metavar="M",
        help="auto, medial-axis, skeleton (curves, for tubular bodies), distance (a surface of "
        "equal distance), or a STEP or BREP file with points, wires or faces (default: auto)",
    )
    group.add_argument(
        "--depth",
        type=_depth,
        default="50%",
        metavar="D",
        help="of distance: a share of the largest distance or mm, e.g. 50%% or 2.5mm "
        "(default: 50%%)",
    )
    group.add_argument(
        "--samples",
        type=_samples,
        default=0,
        metavar="N",
        help="samples of the surface (default: 0, by the body)",
    )
    group.add_argument(
        "--angle",
        type=_number,
        default=125.0,
        metavar="DEG",
        help="smallest object angle of what a medial axis keeps (default: 125)",
    )
    group.add_argument(
        "--minimum-size",
        type=_number,
        default=1.0,
        metavar="S",
        help="smallest area of a part that a medial axis keeps, in squares of its distance to the "
        "surface (default: 1)",
    )
    p.set_defaults(decisions=[])
    for action, words in (
        ("remove", "leave the sheets between two faces out; @u,v names the one at that place of "
         "the first face (repeatable)"),
        ("keep", "keep them (repeatable)"),
        ("only", "keep them and no others (repeatable)"),
    ):  # fmt: skip
        group.add_argument(
            "--keep-only" if action == "only" else f"--{action}-sheet",
            action=_Decide,
            const=action,
            dest="decisions",
            metavar="Face3+Face9[@u,v]",
            help=words,
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] == ["reproduce"]:
        from HybridVolume.reproduce import main as reproduce

        return reproduce(words[1:])
    options = parser().parse_args(words)
    if options.body in LATER:
        parser().error(f"{options.body} is no command of version {HybridVolume.version}")
    # Warnings of the library are told in the report and in our own lines.
    logging.getLogger("HybridVolume").addHandler(logging.NullHandler())
    for number in _STOPPING:
        # What was told to be ignored (nohup) stays ignored.
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _interrupt)
    screen = Screen()
    try:
        return complete_file(options, screen)
    except HybridVolumeError as error:
        screen.clear()
        print(
            "\n".join([f"error: {error.line}", *getattr(error, "__notes__", ())]), file=sys.stderr
        )
        return exit_code(error)
    except KeyboardInterrupt as stop:
        screen.clear()
        print("error: stopped; nothing was written", file=sys.stderr)
        return 128 + (stop.args[0] if stop.args else signal.SIGINT)
    except Exception as fault:
        screen.clear()
        print(f"error: fault of HybridVolume: {type(fault).__name__}: {fault}", file=sys.stderr)
        traceback.print_exc()
        return 1


_STOPPING = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]


def _interrupt(number: int, _: Any) -> NoReturn:
    # A second Ctrl-C must not interrupt the cleaning up.
    for other in _STOPPING:
        signal.signal(other, signal.SIG_IGN)
    raise KeyboardInterrupt(number)


if __name__ == "__main__":
    sys.exit(main())
