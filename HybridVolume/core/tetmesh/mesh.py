# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A tetrahedral mesh and what follows from its arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

# Face i lies opposite vertex i and is oriented outward where the tetrahedron is positive.
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])


def row_keys(rows: np.ndarray, count: int) -> np.ndarray:
    """One sortable number for every row of vertex numbers, whatever their order in the row.

    Parameters
    ----------
    rows : (k, 2) or (k, 3) int array
    count : int
        Number of vertices; below two million, so that three numbers fit into 63 bits.
    """
    rows = np.sort(np.asarray(rows, dtype=np.int64), axis=1)
    key = rows[:, 0]
    for column in rows.T[1:]:
        key = key * count + column
    return key


@dataclass(frozen=True)
class TetMesh:
    """Tetrahedra of positive volume.

    Attributes
    ----------
    vertices : (n, 3) array
        mm. Vertices that were given to the mesher come first, in the given order.
    tets : (m, 4) int array
        det(x_1 - x_0, x_2 - x_0, x_3 - x_0) > 0.
    engine : str
        The mesher that made it.
    exact : bool
        Whether the boundary is the given triangulation, triangle for triangle.
    """

    vertices: np.ndarray
    tets: np.ndarray
    engine: str = ""
    exact: bool = True

    def __len__(self) -> int:
        return len(self.tets)

    @cached_property
    def volumes(self) -> np.ndarray:
        """Volume of each tetrahedron, (m,), mm³."""
        return tet_volumes(self.vertices, self.tets)

    @property
    def volume(self) -> float:
        """Volume of the whole mesh, mm³."""
        return float(self.volumes.sum())

    @cached_property
    def _face_order(self) -> tuple[np.ndarray, np.ndarray]:
        """Faces sorted so that equal ones are neighbours: order, and whether the next is equal."""
        keys = row_keys(self.tets[:, FACES].reshape(-1, 3), len(self.vertices))
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        return order, np.append(keys[1:] == keys[:-1], False)

    @cached_property
    def neighbours(self) -> np.ndarray:
        """Tetrahedron across the face opposite each vertex, (m, 4); -1 on the boundary."""
        order, same = self._face_order
        first = np.flatnonzero(same)
        result = np.full(4 * len(self.tets), -1, dtype=np.int64)
        left, right = order[first], order[first + 1]
        result[left] = right // 4
        result[right] = left // 4
        return result.reshape(-1, 4)

    @cached_property
    def faces(self) -> np.ndarray:
        """All faces, each once, (f, 3)."""
        order, same = self._face_order
        first = order[~np.append(False, same[:-1])]
        return self.tets[first[:, None] // 4, FACES[first % 4]]

    @cached_property
    def boundary_triangles(self) -> np.ndarray:
        """Faces of one tetrahedron only, (k, 3), oriented outward."""
        tet, face = np.nonzero(self.neighbours < 0)
        return self.tets[tet[:, None], FACES[face]]

    @cached_property
    def on_boundary(self) -> np.ndarray:
        """Whether each vertex is on the boundary, (n,)."""
        flag = np.zeros(len(self.vertices), dtype=bool)
        flag[self.boundary_triangles] = True
        return flag

    @cached_property
    def edges(self) -> np.ndarray:
        """Edges, (e, 2), the lower number first."""
        n = len(self.vertices)
        keys = np.unique(row_keys(self.tets[:, EDGES].reshape(-1, 2), n))
        return np.column_stack([keys // n, keys % n])

    @cached_property
    def boundary_edges(self) -> np.ndarray:
        """Edges of the boundary triangles, (e, 2), the lower number first."""
        n = len(self.vertices)
        pairs = self.boundary_triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        keys = np.unique(row_keys(pairs, n))
        return np.column_stack([keys // n, keys % n])

    def min_dihedral_angles(self) -> np.ndarray:
        """Smallest dihedral angle of each tetrahedron, (m,), degrees."""
        x = self.vertices[self.tets]
        corner = x[:, FACES]
        normal = np.cross(corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0])
        length = np.linalg.norm(normal, axis=2, keepdims=True)
        normal = normal / np.maximum(length, np.finfo(float).tiny)
        cosine = np.einsum("mia,mja->mij", normal, normal)[:, EDGES[:, 0], EDGES[:, 1]]
        return np.degrees(np.arccos(np.clip(-cosine, -1.0, 1.0))).min(axis=1)


def tet_volumes(vertices: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Signed volumes of tetrahedra, (m,)."""
    x = vertices[tets]
    a, b, c = (x[:, i] - x[:, 0] for i in (1, 2, 3))
    return np.einsum("mi,mi->m", a, np.cross(b, c)) / 6.0
