# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Wedges and tets of a finite element mesh, to be drawn and to be cut.

Quadratic elements are taken as small linear ones between their nodes; a wedge gets three more
points for that, in the middles of its sides, which lie on the element.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from .elements import EDGES, FACES, shape_functions
from .section import Section, cut_tets, cut_triangles, heights

if TYPE_CHECKING:
    from .finite_elements import FiniteElementMesh

_MIDDLES = np.array([(0.5, 0.0, 0.5), (0.5, 0.5, 0.5), (0.0, 0.5, 0.5)])
"""Middles of a wedge's sides in its reference; they become nodes 15 to 17."""
_SMALL_TRIANGLES = ((0, 3, 5), (1, 4, 3), (2, 5, 4), (3, 4, 5))
_SMALL_QUADS = ((0, 4, 8, 7), (4, 1, 5, 8), (8, 5, 2, 6), (7, 8, 6, 3))
_TETS_OF_WEDGE = ((0, 1, 2, 5), (0, 1, 5, 4), (0, 4, 5, 3))
_LEVELS = ((0, 1, 2, 6, 7, 8), (12, 13, 14, 15, 16, 17), (3, 4, 5, 9, 10, 11))
_TETS = {
    "tet4": ((0, 1, 2, 3),),
    "tet10": (
        *((0, 4, 6, 7), (1, 5, 4, 8), (2, 6, 5, 9), (3, 7, 9, 8)),
        *((4, 9, 5, 6), (4, 9, 6, 7), (4, 9, 7, 8), (4, 9, 8, 5)),
    ),
    "penta6": _TETS_OF_WEDGE,
    "penta15": tuple(
        tuple((low + high)[corner] for corner in tet)
        for bottom, top in zip(_LEVELS, _LEVELS[1:], strict=False)
        for small in _SMALL_TRIANGLES
        for low, high in [(tuple(bottom[k] for k in small), tuple(top[k] for k in small))]
        for tet in _TETS_OF_WEDGE
    ),
}
"""Small tets that an element is taken as."""


class MeshCells:
    """Elements of a mesh, by numbers that run over the wedges, then over the tets.

    Parameters
    ----------
    mesh : FiniteElementMesh

    Attributes
    ----------
    nodes : (n, 3) array
        mm; behind the mesh's own, the middles of the wedges' sides where these are quadratic.
    wedges : (m, 18 or 6) int array
    tets : (k, 10 or 4) int array
    """

    def __init__(self, mesh: FiniteElementMesh) -> None:
        self.nodes, self.wedges, self.tets = mesh.nodes, mesh.wedges, mesh.tets
        self._kinds = (mesh.wedge_kind, mesh.tet_kind)
        self._boundary, self._above = mesh.boundary, mesh.boundary_wedge
        if mesh.order == 2:
            weights = shape_functions("penta15", _MIDDLES)
            points = np.einsum("qn,enc->eqc", weights, mesh.nodes[mesh.wedges])
            number = len(mesh.nodes) + np.arange(3 * len(mesh.wedges)).reshape(-1, 3)
            self.nodes = np.concatenate([mesh.nodes, points.reshape(-1, 3)])
            self.wedges = np.hstack([mesh.wedges, number])

    def __len__(self) -> int:
        return len(self.wedges) + len(self.tets)

    def outside(self, core: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The boundary of the body, or of the core.

        Returns
        -------
        triangles : (t, 3) int array
            Normals point outward.
        owner : (t,) int array
            Element of each.
        edges : (e, 2 or 3) int array
            Sides of the elements, with their mid nodes.
        """
        rows, owner = self._boundary, self._above
        if core:
            faces = np.array(FACES[self._kinds[1]])
            every = self.tets[:, faces].reshape(-1, faces.shape[1])
            corners = np.sort(every[:, :3], axis=1)
            _, first, count = np.unique(corners, axis=0, return_index=True, return_counts=True)
            rows, owner = every[first[count == 1]], first[count == 1] // len(faces)
            owner = owner + len(self.wedges)
        quadratic = rows.shape[1] == 6
        small = np.array(_SMALL_TRIANGLES if quadratic else [(0, 1, 2)])
        sides = [(0, 3, 1), (1, 4, 2), (2, 5, 0)] if quadratic else [(0, 1), (1, 2), (2, 0)]
        edges = rows[:, sides].reshape(-1, len(sides[0]))
        ends = np.sort(edges[:, [0, -1]], axis=1)
        edges = edges[np.unique(ends, axis=0, return_index=True)[1]]
        return rows[:, small].reshape(-1, 3), np.repeat(owner, len(small)), edges

    def faces(self, elements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """All faces of some elements as small triangles, and the element of each triangle."""
        return self._parts(elements, _small_faces)

    def edges(self, elements: np.ndarray) -> np.ndarray:
        """All edges of some elements as lines between two nodes, (e, 2)."""
        return self._parts(elements, _small_edges)[0]

    def section(
        self, elements: np.ndarray, normal: np.ndarray, distance: float
    ) -> tuple[Section, Section]:
        """Where the plane ``normal . x = distance`` cuts elements.

        Returns
        -------
        cut, rims : Section
            Triangles of the section, and lines along the faces of the elements; ``owner`` is the
            element's number.
        """
        height = heights(self.nodes, normal, distance)
        met = [elements[:0]]
        for rows, start, group in self._groups(elements):
            above = height[rows[group]] >= 0.0
            met.append(start + group[above.any(axis=1) & ~above.all(axis=1)])
        near = np.concatenate(met)
        found = []
        for cut, template in ((cut_tets, _small_tets), (cut_triangles, _small_faces)):
            parts, owner = self._parts(near, template)
            one = cut(self.nodes, parts, height)
            found.append(replace(one, owner=owner[one.owner]))
        return found[0], found[1]

    def _groups(self, elements: np.ndarray) -> list[tuple[np.ndarray, int, np.ndarray]]:
        """Connectivity of wedges and tets, their first number, and which of them are meant."""
        count = len(self.wedges)
        return [
            (self.wedges, 0, elements[elements < count]),
            (self.tets, count, elements[elements >= count] - count),
        ]

    def _parts(self, elements: np.ndarray, template: object) -> tuple[np.ndarray, np.ndarray]:
        found, owner = [], []
        for (rows, start, group), kind in zip(self._groups(elements), self._kinds, strict=True):
            small = template(kind)
            found.append(rows[group][:, small].reshape(-1, small.shape[1]))
            owner.append(np.repeat(start + group, len(small)))
        return np.concatenate(found), np.concatenate(owner)


@cache
def _small_tets(kind: str) -> np.ndarray:
    return np.array(_TETS[kind])


@cache
def _small_faces(kind: str) -> np.ndarray:
    """Small triangles of all faces of a kind, their normals outward."""
    small: list[tuple[int, ...]] = []
    for number, face in enumerate(FACES[kind]):
        if len(face) in (3, 6):
            parts = _SMALL_TRIANGLES if len(face) == 6 else ((0, 1, 2),)
            small += [tuple(face[k] for k in part) for part in parts]
            continue
        # the sides of a wedge come after its two triangles, as their middles do
        nodes = (*face, 15 + number - 2)
        for a, b, c, d in _SMALL_QUADS if len(face) == 8 else ((0, 1, 2, 3),):
            small += [(nodes[a], nodes[b], nodes[c]), (nodes[a], nodes[c], nodes[d])]
    return np.array(small)


@cache
def _small_edges(kind: str) -> np.ndarray:
    corners = {"tet10": 4, "penta15": 6}.get(kind)
    if corners is None:
        return np.array(EDGES[kind])
    pairs = [((a, corners + e), (corners + e, b)) for e, (a, b) in enumerate(EDGES[kind])]
    return np.array(pairs).reshape(-1, 2)
