# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Small copies of the pictures that the runs of ``./run.sh reproduce steps`` drew.

``python -m HybridVolume.reproduce.steps_pictures FOLDER`` in the worker's Python, which has Pillow.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from .cases import drawn_elsewhere
from .quads_pictures import TIME_LIMIT, shrunk

NAMES = ("flange", "tee", "bracket", "shaft", "linkrods", "component8")
"""Bodies whose pictures are copied."""


def draw(folder: Path, python: str) -> list[str]:
    """Names of the pictures beside ``steps.json``, of all of ``NAMES`` that have one.

    Parameters
    ----------
    folder : Path
        Holds ``volumes``.
    python : str
        The worker's interpreter.

    Raises
    ------
    WorkerError
        It failed.
    """
    return drawn_elsewhere(__name__, folder, python, TIME_LIMIT)


def main(arguments: list[str] | None = None) -> int:
    """Shrink and print; return the exit code."""
    (given,) = sys.argv[1:] if arguments is None else arguments
    folder, made = Path(given), []
    for name in NAMES:
        source = folder / "volumes" / name / f"{name}.png"
        if source.is_file():
            made.append(f"steps_{name}.png")
            shrunk(source, folder / made[-1])
    print(json.dumps(made))
    return 0


if __name__ == "__main__":
    sys.exit(main())
