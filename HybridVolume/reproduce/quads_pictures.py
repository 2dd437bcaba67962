# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Small copies of the pictures that the runs of ``./run.sh reproduce quads`` drew.

``python -m HybridVolume.reproduce.quads_pictures FOLDER`` in the worker's Python, which has Pillow.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from HybridVolume.core.atomic import beside

from .cases import drawn_elsewhere

PICTURES = {
    "ant_bilinear": "quads_ant.png",
    "fish": "quads_fish.png",
    "fandisk_quads_bilinear": "quads_fandisk.png",
}
"""Cases, and what their pictures are called."""
SIZE = (800, 600)
"""Pixels at most."""
COLOURS = 96
TIME_LIMIT = 120.0


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


def shrunk(source: Path, target: Path) -> None:
    """Write a picture without its margin, and not larger than ``SIZE``."""
    from PIL import Image, ImageChops

    with Image.open(source) as file:
        picture = file.convert("RGB")
    white = Image.new("RGB", picture.size, (255, 255, 255))
    box = ImageChops.difference(picture, white).getbbox()
    if box:
        edge = 0.01 * picture.size[0]
        low = [max(0, int(x - edge)) for x in box[:2]]
        high = [min(n, int(x + edge)) for x, n in zip(box[2:], picture.size, strict=True)]
        picture = picture.crop((*low, *high))
    picture.thumbnail(SIZE, Image.Resampling.LANCZOS)
    picture = picture.quantize(COLOURS, dither=Image.Dither.NONE)
    with beside(target) as path:
        picture.save(path, format="PNG", optimize=True)


def main(arguments: list[str] | None = None) -> int:
    """Shrink and print; return the exit code."""
    (name,) = sys.argv[1:] if arguments is None else arguments
    folder, made = Path(name), []
    for case, target in PICTURES.items():
        for source in sorted((folder / "volumes" / case).glob("*.png")):
            shrunk(source, folder / target)
            made.append(target)
            break
    print(json.dumps(made))
    return 0


if __name__ == "__main__":
    sys.exit(main())
