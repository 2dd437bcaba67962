# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""NAME.msh: the conforming mesh in Gmsh's format 4.1, which many solvers read.

Physical groups: volumes Shell and Core, a surface for every CAD face by its name, and Interface.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from HybridVolume.core.atomic import replacing
from HybridVolume.core.elements import to_order

from .blocks import Block, blocks_of

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh

TYPES = {
    "tri3": 2,
    "tri6": 9,
    "tet4": 4,
    "tet10": 11,
    "penta6": 6,
    "penta15": 18,
}
"""Gmsh's numbers of the kinds of elements."""


def write_msh(path: str | os.PathLike, mesh: FiniteElementMesh) -> None:
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
        for lines in (_heading(mesh, blocks), _nodes(mesh), _elements(blocks)):
            for line in lines:
                file.write(line.encode("utf-8") + b"\n")


def _heading(mesh: FiniteElementMesh, blocks: list[Block]) -> Iterator[str]:
    yield from ("$MeshFormat", "4.1 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(blocks)))
    numbered = list(_numbered(blocks))
    for number, block in numbered:
        quoted = block.group.replace('"', "'")
        yield f'{block.dimension} {number} "{quoted}"'
    surfaces = [(number, block) for number, block in numbered if block.dimension == 2]
    volumes = [(number, block) for number, block in numbered if block.dimension == 3]
    yield from ("$EndPhysicalNames", "$Entities", f"0 0 {len(surfaces)} {len(volumes)}")
    for number, block in (*surfaces, *volumes):
        rows = block.connectivity
        points = mesh.nodes[np.unique(rows)] if len(rows) else np.zeros((1, 3))
        ends = " ".join(f"{x:.17g}" for x in (*points.min(axis=0), *points.max(axis=0)))
        # one physical group of the same number, no entities that bound this one
        yield f"{number} {ends} 1 {number} 0"
    yield "$EndEntities"


def _numbered(blocks: list[Block]) -> Iterator[tuple[int, Block]]:
    """Each group with its number among those of its dimension."""
    counts = {2: 0, 3: 0}
    for block in blocks:
        counts[block.dimension] += 1
        yield counts[block.dimension], block


def _nodes(mesh: FiniteElementMesh) -> Iterator[str]:
    count = len(mesh.nodes)
    yield from ("$Nodes", f"1 {count} 1 {count}", f"3 1 0 {count}")
    yield from (str(number) for number in range(1, count + 1))
    yield from (f"{x:.17g} {y:.17g} {z:.17g}" for x, y, z in mesh.nodes.tolist())
    yield "$EndNodes"


def _elements(blocks: list[Block]) -> Iterator[str]:
    count = sum(len(block.connectivity) for block in blocks)
    yield from ("$Elements", f"{len(blocks)} {count} 1 {count}")
    element = 1
    for number, block in _numbered(blocks):
        rows = (to_order("gmsh", block.kind, block.connectivity) + 1).tolist()
        yield f"{block.dimension} {number} {TYPES[block.kind]} {len(rows)}"
        for row in rows:
            yield f"{element} {' '.join(map(str, row))}"
            element += 1
    yield "$EndElements"
