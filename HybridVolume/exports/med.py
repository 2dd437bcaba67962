# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""NAME.med: the conforming mesh for Salome and Code_Aster, by FreeCAD's own MED library.

This one needs FreeCAD's process. FreeCAD drops what it does not know without a word; the file is
therefore read again and compared before it takes its place.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.core.elements import to_order
from HybridVolume.errors import FaultError
from HybridVolume.freecad_python import import_freecad

from .blocks import Block, blocks_of, plain_names

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh

_LONGEST_NAME = 64
"""Bytes of a mesh's name in MED."""


def write_med(path: str | os.PathLike, mesh: FiniteElementMesh) -> None:
    """Write a mesh; an existing file is replaced in one step, or stays as it was.

    Parameters
    ----------
    path : path
        Its name ends with ``.med``.
    mesh : FiniteElementMesh

    Raises
    ------
    SetupError
        FreeCAD is not there, or not for this Python.
    FaultError
        What FreeCAD wrote is not the mesh.
    OSError
        The place cannot be written.
    """
    import_freecad()
    import Fem

    blocks = blocks_of(mesh)
    made = _freecad_mesh(Fem.FemMesh(), mesh.nodes, blocks)
    path = Path(path)
    # FreeCAD names the mesh after the file, and finds it by that name only: the file is made with
    # its own name in a folder beside its place. Longer names than MED's only other programs read.
    name = path.stem.encode("utf-8")[:_LONGEST_NAME].decode("utf-8", "ignore")
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".med-") as folder:
        part = Path(folder) / f"{name}{path.suffix}"
        made.write(str(part))
        _compare(Fem.read(str(part)), mesh.nodes, blocks)
        os.replace(part, path)


def _freecad_mesh(made: Any, nodes: np.ndarray, blocks: list[Block]) -> Any:
    for number, (x, y, z) in enumerate(nodes.tolist(), 1):
        made.addNode(x, y, z, number)
    names = plain_names(block.group for block in blocks)
    start = 1
    for block in blocks:
        add = made.addVolume if block.dimension == 3 else made.addFace
        rows = (to_order("freecad", block.kind, block.connectivity) + 1).tolist()
        for element, row in enumerate(rows, start):
            add(row, element)
        if rows:
            group = made.addGroup(names[block.group], "Volume" if block.dimension == 3 else "Face")
            made.addGroupElements(group, list(range(start, start + len(rows))))
        start += len(rows)
    return made


def _compare(found: Any, nodes: np.ndarray, blocks: list[Block]) -> None:
    names = plain_names(block.group for block in blocks)
    wanted = {names[b.group]: len(b.connectivity) for b in blocks if len(b.connectivity)}
    wanted["all nodes"] = len(nodes)
    groups = {found.getGroupName(g): len(found.getGroupElements(g)) for g in found.Groups}
    got = {**groups, "all nodes": found.NodeCount}
    if got != wanted or found.VolumeCount + found.FaceCount != sum(groups.values()):
        wrong = [name for name in {**wanted, **got} if wanted.get(name) != got.get(name)]
        raise FaultError(
            f"FreeCAD's MED file has not the whole mesh: {', '.join(sorted(wrong)) or 'elements'}",
            remedy="export to another format",
        )
    held = found.Nodes  # FreeCAD makes this dictionary anew each time it is asked for
    places = np.array([tuple(held[n]) for n in sorted(held)])
    if not np.array_equal(places, nodes):
        raise FaultError(
            "FreeCAD's MED file has the nodes at other places", remedy="export to another format"
        )
