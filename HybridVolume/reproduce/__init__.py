# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Figures and tables of the documentation, made again: ``./run.sh reproduce NAME -o DIR``."""

from __future__ import annotations

import logging
import signal
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module

from HybridVolume.errors import HybridVolumeError
from HybridVolume.job import exit_code
from HybridVolume.options import Parser

FIGURES = {
    "midstructure": "the automatic midstructure of all bodies, up to their shells",
    "shell": "shells of many bodies at many levels, and what is demanded of them",
    "quads": "quad meshes and cages: volumes, smoothness, limit surfaces, broken meshes",
    "steps": "CAD bodies of any faces, the whole way to finite elements",
    "fem": "finite element meshes: patch tests, sums of loads, accuracy",
    "rates2d": "analysis in the plane: rates of the paper's section 4, and higher ones",
    "fig7": "analysis in the plane: the paper's Fig. 7",
    "depth": "analysis in the plane: the error against the ring's thickness and layers",
    "rates3d": "analysis in space: rates of errors on refined volumes, beside quadratic tets",
    "fig2": "an elastic disk dropped on a plane: flipped elements (Fig. 2 of the paper)",
    "dynamics": "elastic bodies in motion: a drop, free flights, frequencies, rigid motions",
}
"""What can be made again: modules of this package, with ``add_arguments`` and ``run``."""


def parser() -> Parser:
    """Return the parser of ``./run.sh reproduce``."""
    p = Parser(prog="./run.sh reproduce", description=__doc__)
    names = p.add_subparsers(dest="figure", required=True, metavar="NAME", parser_class=Parser)
    for name, words in FIGURES.items():
        own = names.add_parser(name, help=words, description=words)
        own.add_argument("-o", "--output", required=True, metavar="DIR", help="output folder")
        import_module(f"{__name__}.{name}").add_arguments(own)
    return p


def main(arguments: Sequence[str]) -> int:
    """Make one figure or table again.

    Returns
    -------
    int
        0 when all is as it should be, 2 for an input that is refused, 1 for anything else.
    """
    options = parser().parse_args(arguments)
    logging.getLogger("HybridVolume").addHandler(logging.NullHandler())
    try:
        return import_module(f"{__name__}.{options.figure}").run(options)
    except HybridVolumeError as error:
        print(f"error: {error.line}", file=sys.stderr)
        return exit_code(error)
    except KeyboardInterrupt:
        print("error: stopped; what is finished stays and is not done again", file=sys.stderr)
        return 128 + signal.SIGINT
    except OSError as fault:
        print(f"error: {fault}", file=sys.stderr)
        return 2
    except Exception as fault:
        print(f"error: fault of HybridVolume: {type(fault).__name__}: {fault}", file=sys.stderr)
        traceback.print_exc()
        return 1
