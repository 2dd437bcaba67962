# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""NAME_core.msh and NAME_interface.csv: the core for other solvers, and where it meets the shell.

The mesh has Gmsh's format 2.2, which MFEM reads too, with the physical groups Core and Interface.
Tetrahedra are curved: their nodes on the interface stand on the shell's inner surface.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from HybridVolume.core.analysis.simplex_space import lattice
from HybridVolume.core.atomic import replacing

from .blocks import CORE, INTERFACE

if TYPE_CHECKING:
    from HybridVolume.core.analysis.tet_space import TetSpace
    from HybridVolume.core.solver_patches import SolverPatches

TETS = {1: 4, 2: 11, 3: 29}
TRIANGLES = {1: 2, 2: 9, 3: 21}
"""Gmsh's numbers of the elements of each degree."""

_EDGES = ((0, 1), (1, 2), (2, 0), (3, 0), (3, 2), (3, 1))
"""Gmsh's edges of a tetrahedron, the way their nodes go; its triangles have the first three."""
_FACES = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))


@cache
def gmsh_order(dimension: int, degree: int) -> np.ndarray:
    """Places in the lattice of a simplex's nodes, in Gmsh's order, (n,).

    Corners, then the nodes of each edge, then those inside each face.

    Parameters
    ----------
    dimension : {2, 3}
    degree : {1, 2, 3}
    """
    place = {tuple(row): k for k, row in enumerate(lattice(dimension, degree).tolist())}
    corners = range(dimension + 1)
    unit = np.eye(dimension + 1, dtype=int)
    rows = [degree * unit[c] for c in corners]
    for a, b in _EDGES if dimension == 3 else _EDGES[:3]:
        rows += [(degree - k) * unit[a] + k * unit[b] for k in range(1, degree)]
    if degree == 3:
        rows += [unit[list(face)].sum(axis=0) for face in _FACES[: 4 if dimension == 3 else 1]]
    return np.array([place[tuple(row.tolist())] for row in rows])


def write_core(path: str | os.PathLike, core: TetSpace) -> None:
    """Write the core; an existing file is replaced in one step, or stays as it was.

    Elements 1, 2, ... are the interface's triangles, pointing out of the core, then the tetrahedra.

    Parameters
    ----------
    path : path
    core : TetSpace

    Raises
    ------
    OSError
        The place cannot be written.
    """
    with replacing(path) as file:
        for line in _mesh_lines(core):
            file.write(line.encode("utf-8") + b"\n")


def write_interface(path: str | os.PathLike, core: TetSpace, shell: SolverPatches) -> None:
    """Write where the core's nodes lie on the shell, one line a node of the interface.

    ``node`` is the number in the core's mesh; ``patch`` the patch of the shell's file from 0;
    ``t1, t2, t3`` the parameters there; ``x, y, z`` the place, mm. A field of the shell has the
    value u(t1, t2, t3) at the node: that is how the two are coupled by collocation.

    Parameters
    ----------
    path : path
    core : TetSpace
    shell : SolverPatches

    Raises
    ------
    OSError
        The place cannot be written.
    """
    places = shell.places(core.interface_patch, core.interface_uv, core.interface_w)
    x = core.nodes[core.interface]
    with replacing(path) as file:
        file.write(b"node,patch,t1,t2,t3,x,y,z\n")
        for node, (patch, *t), at in zip(
            (core.interface + 1).tolist(), places.tolist(), x.tolist(), strict=True
        ):
            numbers = ",".join(map(repr, (*t, *at)))
            file.write(f"{node},{int(patch)},{numbers}\n".encode())


def write_interface_triangles(
    path: str | os.PathLike, core: TetSpace, shell: SolverPatches
) -> None:
    """Write the corners' parameters of each triangle of the interface, on one patch each.

    Parameters between the corners are linear in the triangle's own coordinates: what a coupling by
    Nitsche's method or mortars needs at its quadrature points. ``element`` is the number in the
    core's mesh, ``n1, n2, n3`` its corners.

    Parameters
    ----------
    path : path
    core : TetSpace
    shell : SolverPatches

    Raises
    ------
    OSError
        The place cannot be written.
    """
    count = len(core.faces)
    # the middle tells the patch where a source is cut: triangles do not reach over knots
    middle = shell.places(core.face_patch, core.face_uv.mean(axis=1), core.face_w.mean(axis=1))
    t = np.concatenate([core.face_uv[..., ::-1], core.face_w[..., None]], axis=-1)
    names = ",".join(f"{c}{k}" for k in (1, 2, 3) for c in ("r", "s", "t"))
    with replacing(path) as file:
        file.write(f"element,n1,n2,n3,patch,{names}\n".encode())
        for element, corners, patch, numbers in zip(
            range(1, count + 1),
            (core.faces[:, :3] + 1).tolist(),
            middle[:, 0].astype(int).tolist(),
            t.reshape(count, 9).tolist(),
            strict=True,
        ):
            line = [element, *corners, patch, *map(repr, numbers)]
            file.write((",".join(map(str, line)) + "\n").encode())


def _mesh_lines(core: TetSpace) -> Iterator[str]:
    yield from ("$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", "2")
    yield from (f'2 1 "{INTERFACE}"', f'3 2 "{CORE}"', "$EndPhysicalNames")
    yield from ("$Nodes", str(len(core.nodes)))
    for number, row in enumerate(core.nodes.tolist(), 1):
        yield f"{number} {' '.join(map(repr, row))}"
    yield from ("$EndNodes", "$Elements", str(len(core.faces) + len(core.elements)))
    number = 1
    for kind, group, dimension, rows in (
        (TRIANGLES[core.degree], 1, 2, core.faces),
        (TETS[core.degree], 2, 3, core.elements),
    ):
        for row in (rows[:, gmsh_order(dimension, core.degree)] + 1).tolist():
            yield f"{number} {kind} 2 {group} {group} {' '.join(map(str, row))}"
            number += 1
    yield "$EndElements"
