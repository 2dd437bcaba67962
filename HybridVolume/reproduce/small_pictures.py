# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Small copies of the pictures that runs of the command line drew; needs Pillow."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path

from HybridVolume.core.atomic import beside

SIZE = (800, 600)
"""Pixels at most."""
COLOURS = 96
TIME_LIMIT = 120.0
"""Seconds for all of them."""


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


def shrink_volumes(pictures: Mapping[str, str], arguments: list[str] | None = None) -> int:
    """Shrink the pictures of volumes, and print the names of the copies; return the exit code.

    Parameters
    ----------
    pictures : mapping of str to str
        What the copy is called of each folder in ``volumes``; those without a picture of a volume
        are left out.
    arguments : list of str, optional
        The folder that holds ``volumes``, and the copies then; by default as the command line
        names it.
    """
    (name,) = sys.argv[1:] if arguments is None else arguments
    folder, made = Path(name), []
    for case, target in pictures.items():
        drawn = sorted((folder / "volumes" / case).glob("*.png"))
        # of a body that was refused there is one picture, of the places
        whole = [path for path in drawn if not path.stem.endswith("_refused")]
        if whole:
            shrunk(whole[0], folder / target)
            made.append(target)
    print(json.dumps(made))
    return 0
