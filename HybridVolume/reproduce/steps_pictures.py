# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Small copies of the pictures that the runs of ``./run.sh reproduce steps`` drew.

``python -m HybridVolume.reproduce.steps_pictures FOLDER`` in the worker's Python, which has Pillow.
"""

from __future__ import annotations

import sys
from pathlib import Path

from .cases import drawn_elsewhere
from .small_pictures import TIME_LIMIT, shrink_volumes

NAMES = ("flange", "tee", "bracket", "shaft", "linkrods", "component8")
"""Bodies whose pictures are copied."""
PICTURES = {name: f"steps_{name}.png" for name in NAMES}
"""What the copies are called."""


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


if __name__ == "__main__":
    sys.exit(shrink_volumes(PICTURES))
