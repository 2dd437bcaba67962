# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A finite element mesh as any mesher gives it: what all accuracy cases are solved on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..core.elements import reference
from ..core.finite_elements import FiniteElementMesh

Group = tuple[str, np.ndarray]
"""Kind of elements ("tet10", "penta15", "tri6") and their nodes, (m, k) int, in Abaqus order."""


@dataclass(frozen=True)
class Meshed:
    """Nodes, elements and the triangles on each CAD face.

    Attributes
    ----------
    nodes : (n, 3) array
        mm; every one belongs to an element.
    elements : tuple of (str, (m, k) int array)
        Kind and connectivity in the order of Abaqus, right-handed.
    faces : mapping of str to (str, (m, k) int array)
        For each CAD face its triangles with their mid nodes, normals out of the body.
    name : str
        The mesher, as tables call it.
    """

    nodes: np.ndarray
    elements: tuple[Group, ...]
    faces: Mapping[str, Group]
    name: str = ""
    unproved: int = field(default=0)
    """Elements whose Jacobian was not proved positive."""

    def __post_init__(self) -> None:
        for kind, rows in (*self.elements, *self.faces.values()):
            if rows.ndim != 2 or rows.shape[1] != len(reference(kind).nodes):
                raise ValueError(f"{kind} has {len(reference(kind).nodes)} nodes, not {rows.shape}")
        used = np.zeros(len(self.nodes), dtype=bool)
        for _, rows in self.elements:
            used[rows] = True
        if not used.all():
            raise ValueError(f"{np.count_nonzero(~used)} nodes belong to no element")

    @classmethod
    def of(cls, mesh: FiniteElementMesh, name: str = "hybrid") -> Meshed:
        """The conforming mesh of a hybrid volume, whose elements are all proved."""
        elements = ((mesh.wedge_kind, mesh.wedges), (mesh.tet_kind, mesh.tets))
        faces = {face: (mesh.face_kind, mesh.face_triangles(face)) for face in mesh.face_names}
        return cls(mesh.nodes, tuple(e for e in elements if len(e[1])), faces, name)

    def face_nodes(self, *names: str) -> np.ndarray:
        """Nodes on CAD faces, mid nodes included, sorted."""
        return np.unique(np.concatenate([self.faces[name][1].ravel() for name in names]))

    def triangles(self, *names: str) -> Group:
        """Triangles of several CAD faces as one group."""
        kinds = {self.faces[name][0] for name in names}
        if len(kinds) != 1:
            raise ValueError(f"faces {', '.join(names)} have triangles of kinds {sorted(kinds)}")
        return kinds.pop(), np.concatenate([self.faces[name][1] for name in names])
