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

INTERFACE = "Interface"


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
    blocks = list(_blocks(mesh))
    with replacing(path) as file:
        for lines in (_heading(mesh, blocks), _nodes(mesh), _elements(blocks)):
            for line in lines:
                file.write(line.encode("utf-8") + b"\n")


_Block = tuple[int, int, str, str, np.ndarray]
"""Dimension, number, name, kind and connectivity of an entity."""


def _blocks(mesh: FiniteElementMesh) -> Iterator[_Block]:
    yield 3, 1, "Shell", mesh.wedge_kind, mesh.wedges
    yield 3, 2, "Core", mesh.tet_kind, mesh.tets
    for number, name in enumerate(mesh.face_names, 1):
        yield 2, number, name, mesh.face_kind, mesh.face_triangles(name)
    yield 2, len(mesh.face_names) + 1, INTERFACE, mesh.face_kind, mesh.interface


def _heading(mesh: FiniteElementMesh, blocks: list[_Block]) -> Iterator[str]:
    yield from ("$MeshFormat", "4.1 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(blocks)))
    for dimension, number, name, _, _ in blocks:
        quoted = name.replace('"', "'")
        yield f'{dimension} {number} "{quoted}"'
    surfaces = [block for block in blocks if block[0] == 2]
    volumes = [block for block in blocks if block[0] == 3]
    yield from ("$EndPhysicalNames", "$Entities", f"0 0 {len(surfaces)} {len(volumes)}")
    for _, number, _, _, rows in (*surfaces, *volumes):
        points = mesh.nodes[np.unique(rows)] if len(rows) else np.zeros((1, 3))
        ends = " ".join(f"{x:.17g}" for x in (*points.min(axis=0), *points.max(axis=0)))
        # one physical group of the same number, no entities that bound this one
        yield f"{number} {ends} 1 {number} 0"
    yield "$EndEntities"


def _nodes(mesh: FiniteElementMesh) -> Iterator[str]:
    count = len(mesh.nodes)
    yield from ("$Nodes", f"1 {count} 1 {count}", f"3 1 0 {count}")
    yield from (str(number) for number in range(1, count + 1))
    yield from (f"{x:.17g} {y:.17g} {z:.17g}" for x, y, z in mesh.nodes.tolist())
    yield "$EndNodes"


def _elements(blocks: list[_Block]) -> Iterator[str]:
    count = sum(len(rows) for *_, rows in blocks)
    yield from ("$Elements", f"{len(blocks)} {count} 1 {count}")
    element = 1
    for dimension, number, _, kind, rows in blocks:
        yield f"{dimension} {number} {TYPES[kind]} {len(rows)}"
        for row in (to_order("gmsh", kind, rows) + 1).tolist():
            yield f"{element} {' '.join(map(str, row))}"
            element += 1
    yield "$EndElements"
