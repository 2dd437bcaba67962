# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The finite element mesh for VTK and ParaView: wedges, tets and the triangles of the CAD faces.

Not the exact shell, which `exports.vtu` writes. VTK has the node order of Abaqus; only the six-node
wedge of older versions had its base the other way round, and they show that one inside out.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from HybridVolume.core.atomic import replacing
from HybridVolume.core.elements import VTK_TYPES, to_order

from .blocks import SHELL, Block, blocks_of, interface_wedges
from .vtk_xml import HEADER, Appended, strings_tag

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh


def write_fem_vtu(path: str | os.PathLike, mesh: FiniteElementMesh) -> None:
    """Write a mesh; an existing file is replaced in one step, or stays as it was.

    Cell data: ``group`` is a position in the field data ``group_names`` (Shell, Core, the CAD
    faces, Interface); ``layer`` counts the shell's layers from outside, -1 elsewhere;
    ``scaled_jacobian`` and ``min_bernstein`` are those of the element, of a triangle's wedge.

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
    appended = Appended()
    sizes = np.concatenate([np.full(len(b.connectivity), b.connectivity.shape[1]) for b in blocks])
    cells = [to_order("vtk", b.kind, b.connectivity).ravel() for b in blocks]
    types = [np.full(len(b.connectivity), VTK_TYPES[b.kind], dtype=np.uint8) for b in blocks]
    groups = np.repeat(np.arange(len(blocks)), [len(b.connectivity) for b in blocks])
    wedge = np.concatenate([_wedges(mesh, block) for block in blocks])
    text = [
        HEADER,
        f"<FieldData>\n{strings_tag('group_names', [b.group for b in blocks])}</FieldData>\n"
        f'<Piece NumberOfPoints="{len(mesh.nodes)}" NumberOfCells="{len(sizes)}">\n<CellData>\n',
        appended.tag("group", groups.astype(np.int32)),
        appended.tag("layer", np.append(mesh.wedge_layer, -1)[wedge].astype(np.int32)),
        *(
            appended.tag(name, _of_cells(blocks, wedge, of_wedges, of_tets))
            for name, of_wedges, of_tets in (
                ("scaled_jacobian", mesh.wedge_quality, mesh.tet_quality),
                ("min_bernstein", mesh.wedge_bound, mesh.tet_bound),
            )
        ),
        "</CellData>\n<Points>\n",
        appended.tag("Points", mesh.nodes),
        "</Points>\n<Cells>\n",
        appended.tag("connectivity", np.concatenate(cells).astype(np.int64)),
        appended.tag("offsets", np.cumsum(sizes).astype(np.int64)),
        appended.tag("types", np.concatenate(types)),
        "</Cells>\n</Piece>\n</UnstructuredGrid>\n",
    ]
    with replacing(path) as file:
        file.write("".join(text).encode("utf-8"))
        appended.finish(file)


def _wedges(mesh: FiniteElementMesh, block: Block) -> np.ndarray:
    """The wedge that each cell of a block is, or is a side of; -1 for tets."""
    if block.group == SHELL:
        return np.arange(len(mesh.wedges))
    if block.dimension == 3:
        return np.full(len(block.connectivity), -1)
    if block.face >= 0:
        return mesh.boundary_wedge[mesh.boundary_face == block.face]
    return interface_wedges(mesh)


def _of_cells(
    blocks: list[Block], wedge: np.ndarray, of_wedges: np.ndarray, of_tets: np.ndarray
) -> np.ndarray:
    """Values of all cells from those of the wedges and the tets."""
    found = np.append(of_wedges, np.nan)[wedge]
    tets = slice(len(blocks[0].connectivity), sum(len(b.connectivity) for b in blocks[:2]))
    found[tets] = of_tets
    return found
