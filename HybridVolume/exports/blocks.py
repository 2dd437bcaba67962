# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What every file of a conforming mesh holds, in one order: its groups of elements."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain, count
from typing import TYPE_CHECKING

import numpy as np

from HybridVolume.core.elements import reference

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh

SHELL, CORE, INTERFACE = "Shell", "Core", "Interface"
"""Names of the groups beside the CAD faces'."""


@dataclass(frozen=True, eq=False)
class Block:
    """Elements of one kind in one group.

    Attributes
    ----------
    group : str
        Shell, Core, the name of a CAD face, or Interface; each once.
    dimension : {2, 3}
    kind : str
        As in `HybridVolume.core.elements`.
    connectivity : (m, n) int array
        Nodes from 0, in the order of Abaqus.
    face : int
        Position among the mesh's CAD faces; -1 where it is none of them.
    """

    group: str
    dimension: int
    kind: str
    connectivity: np.ndarray
    face: int = -1


def blocks_of(mesh: FiniteElementMesh) -> list[Block]:
    """Groups of a mesh, volumes first: an element has the same number in every file.

    Parameters
    ----------
    mesh : FiniteElementMesh

    Returns
    -------
    list of Block
        Shell, Core, each CAD face, Interface; those without elements too. Triangles of CAD faces
        point outward, those of the interface out of the core.
    """
    found = [
        Block(SHELL, 3, mesh.wedge_kind, mesh.wedges),
        Block(CORE, 3, mesh.tet_kind, mesh.tets),
    ]
    taken = {SHELL, CORE, INTERFACE}
    for face, name in enumerate(mesh.face_names):
        # a face may be called as one of our own groups is
        group = next(n for n in chain([name], (f"{name}_{k}" for k in count(2))) if n not in taken)
        taken.add(group)
        rows = mesh.boundary[mesh.boundary_face == face]
        found.append(Block(group, 2, mesh.face_kind, rows, face))
    return [*found, Block(INTERFACE, 2, mesh.face_kind, mesh.interface)]


def interface_wedges(mesh: FiniteElementMesh) -> np.ndarray:
    """The wedge over each triangle of the interface, (ni,); its bottom has the same corners."""
    corners = reference(mesh.face_kind).corners
    bottoms = np.sort(mesh.wedges[:, :corners], axis=1)
    wanted = np.sort(mesh.interface[:, :corners], axis=1)
    _, row = np.unique(np.concatenate([bottoms, wanted]), axis=0, return_inverse=True)
    row = row.reshape(-1)
    owner = np.full(row.max(initial=0) + 1, -1)
    owner[row[: len(bottoms)]] = np.arange(len(bottoms))
    return owner[row[len(bottoms) :]]


def plain_names(names: Iterable[str], capitals: bool = False, longest: int = 60) -> dict[str, str]:
    """Names of letters, digits and underscores, each of them once, for formats with few letters.

    Parameters
    ----------
    names : iterable of str
    capitals : bool
        Capitals only; then names that differ in nothing else are told apart by a number.
    longest : int
        Letters of a name before that number.
    """
    found: dict[str, str] = {}
    for wanted in names:
        text = wanted.upper() if capitals else wanted
        name = base = re.sub(r"[^A-Za-z0-9_]", "_", text)[:longest] or "FACE"
        number = 1
        while name in found.values():
            number += 1
            name = f"{base}_{number}"
        found[wanted] = name
    return found
