# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The command line: ``python -m HybridVolume BODY [options]``, in FreeCAD's Python.

``reproduce`` as the first word remakes a figure or table of the documentation instead, ``fit``
makes spline patches of a quad mesh.

Ends with 0 when every element is certified, 2 for an input that is refused (one line says why), 1
for a fault of its own; 128 + n when signal n ended it. Nothing half-written ever stays.
"""

from __future__ import annotations

import logging
import signal
import sys
import traceback
from collections.abc import Sequence
from typing import Any, NoReturn

import HybridVolume
from HybridVolume.completion import Screen, complete_file
from HybridVolume.errors import HybridVolumeError
from HybridVolume.job import exit_code
from HybridVolume.options import parser

LATER = ("bench",)
"""Words that a later version takes as commands."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] == ["reproduce"]:
        from HybridVolume.reproduce import main as reproduce

        return reproduce(words[1:])
    if words[:1] == ["fit"]:
        from HybridVolume.fit_command import main as fit

        return fit(words[1:])
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
