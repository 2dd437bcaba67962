# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""NAME.unv: the conforming mesh in the I-DEAS universal format, which Salome and many others read.

Datasets 2411 (nodes), 2412 (elements) and 2467 (groups Shell, Core, one for each CAD face, and
Interface). Lengths are mm; no dataset of units is written, because readers would convert them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from HybridVolume.core.atomic import replacing

from .blocks import Block, blocks_of, plain_names

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh

DESCRIPTORS = {
    "tri3": 91,
    "tri6": 92,
    "tet4": 111,
    "tet10": 118,
    "penta6": 112,
    "penta15": 113,
}
"""The format's numbers of the kinds of elements (thin shells for faces)."""

ORDERS = {
    "tri3": (0, 1, 2),
    "tri6": (0, 3, 1, 4, 2, 5),
    "tet4": (0, 1, 2, 3),
    "tet10": (0, 4, 1, 5, 2, 6, 7, 8, 9, 3),
    "penta6": (0, 1, 2, 3, 4, 5),
    "penta15": (0, 6, 1, 7, 2, 8, 12, 13, 14, 3, 9, 4, 10, 5, 11),
}
"""The format's list of nodes is ``connectivity[:, order]``: mid nodes between their corners."""

_COLUMNS = 8
_SEPARATOR = "    -1"


def write_unv(path: str | os.PathLike, mesh: FiniteElementMesh) -> None:
    """Write a mesh; an existing file is replaced in one step, or stays as it was.

    Parameters
    ----------
    path : path
    mesh : FiniteElementMesh

    Raises
    ------
    OSError
        The place cannot be written.
    """
    blocks = blocks_of(mesh)
    with replacing(path) as file:
        for number, lines in (
            (2411, _nodes(mesh.nodes)),
            (2412, _elements(blocks)),
            (2467, _groups(blocks)),
        ):
            for line in (_SEPARATOR, f"{number:6d}", *lines, _SEPARATOR):
                file.write(line.encode("ascii") + b"\n")


def _nodes(nodes: np.ndarray) -> Iterator[str]:
    for number, row in enumerate(nodes.tolist(), 1):
        yield f"{number:10d}         1         1        11"
        # 17 significant digits, so that every double comes back as it was
        yield "".join(f"{x:25.16E}" for x in row).replace("E", "D")


def _elements(blocks: list[Block]) -> Iterator[str]:
    element = 1
    for group, block in enumerate(blocks, 1):
        table = (block.connectivity[:, ORDERS[block.kind]] + 1).tolist()
        count = block.connectivity.shape[1]
        # the group's number stands in the columns of property and material as well
        rest = f"{DESCRIPTORS[block.kind]:10d}{group:10d}{group:10d}         7{count:10d}"
        for row in table:
            yield f"{element:10d}{rest}"
            for start in range(0, count, _COLUMNS):
                yield "".join(f"{node:10d}" for node in row[start : start + _COLUMNS])
            element += 1


def _groups(blocks: list[Block]) -> Iterator[str]:
    names = plain_names(block.group for block in blocks)
    start = 1
    for number, block in enumerate(blocks, 1):
        end = start + len(block.connectivity)
        if end > start:
            yield f"{number:10d}{0:10d}{0:10d}{0:10d}{0:10d}{0:10d}{0:10d}{end - start:10d}"
            yield names[block.group]
            # 8: elements; two of them a line
            for first in range(start, end, 2):
                pair = range(first, min(first + 2, end))
                yield "".join(f"{8:10d}{element:10d}{0:10d}{0:10d}" for element in pair)
        start = end
