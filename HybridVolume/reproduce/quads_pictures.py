# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Small copies of the pictures that the runs of ``./run.sh reproduce quads`` drew.

``python -m HybridVolume.reproduce.quads_pictures FOLDER`` in the worker's Python, which has Pillow.
"""

from __future__ import annotations

import sys
from pathlib import Path

from .cases import drawn_elsewhere
from .small_pictures import TIME_LIMIT, shrink_volumes

PICTURES = {
    "ant_bilinear": "quads_ant.png",
    "fish": "quads_fish.png",
    "fandisk_quads_bilinear": "quads_fandisk.png",
}
"""Cases, and what their pictures are called."""


def draw(folder: Path, python: str) -> list[str]:
    """Names of the pictures beside ``quads.json``, of all cases that have one.

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
