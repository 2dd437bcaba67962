# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The boundary of a plane body that consists of triangles alone, in the place of a ring."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from ..elements import gauss_line
from .plane_curve import PlaneCurve
from .plane_ring import chosen_edges
from .samples import BoundarySamples, Samples
from .simplex_space import lattice, lattice_keys, shape_functions


@dataclass(frozen=True)
class TriangleRim:
    """The boundary of a body of triangles alone: a ring without thickness and without elements.

    Its unknowns are the nodes of the triangles' edges on the boundary, its functions the
    triangles' own there. So what is built for shell and core serves triangles alone, too.

    Attributes
    ----------
    degree : {1, 2, 3}
    control_points : (n, 2) array
        The nodes, mm.
    edges : (t, degree + 1) int array
        Nodes of each edge in the order of ``lattice(1, degree)``, counterclockwise.
    edge_patch : (t,) int array
        Arc of each edge.
    edge_u : (t, 2) array
        Parameters of its ends there.
    curve : PlaneCurve
        The boundary that the nodes stand on.
    """

    degree: int
    control_points: np.ndarray
    edges: np.ndarray
    edge_patch: np.ndarray
    edge_u: np.ndarray
    curve: PlaneCurve

    @property
    def dimension(self) -> int:
        """2: a rim bounds a body in the plane."""
        return 2

    @property
    def face_names(self) -> tuple[str, ...]:
        """Names of the boundary's arcs."""
        return self.curve.names

    @property
    def patch_faces(self) -> tuple[str, ...]:
        """The same: an arc is a patch."""
        return self.curve.names

    @property
    def columns(self) -> int:
        """Number of nodes."""
        return len(self.control_points)

    @property
    def size(self) -> int:
        """Number of unknowns (of one component)."""
        return len(self.control_points)

    @cached_property
    def outer(self) -> np.ndarray:
        """All unknowns."""
        return np.arange(self.size)

    @property
    def inner(self) -> np.ndarray:
        """All unknowns: the rim has no thickness."""
        return self.outer

    def samples(self, points: int | None = None) -> Iterator[Samples]:
        """Nothing: a rim has no elements."""
        yield from ()

    def basis_at(self, patch: np.ndarray, uv: np.ndarray, w: np.ndarray) -> sparse.csr_matrix:
        """Functions at places of the rim, (m, size); ``w`` has no meaning here."""
        u = np.reshape(uv, len(w))
        # edges in the order of arcs and parameters: the last one that begins before the place
        order = np.lexsort((self.edge_u[:, 0], self.edge_patch))
        start = self.edge_patch[order] + self.edge_u[order, 0] / _LONG
        place = np.searchsorted(start, patch + u / _LONG, side="right") - 1
        edge = order[np.maximum(place, 0)]
        low, high = self.edge_u[edge].T
        share = ((u - low) / (high - low))[:, None]
        return self._matrix(edge, shape_functions(self.degree, share)[0])

    def boundary_samples(
        self, faces: Sequence[str] | None = None, points: int | None = None
    ) -> Iterator[BoundarySamples]:
        """Quadrature points on the triangles' edges of some arcs, see `PlaneRing`.

        Raises
        ------
        InputError
            There is no such arc.
        """
        chosen = chosen_edges(self.face_names, faces, self.edge_patch)
        x, weight = gauss_line(points or self.degree + 3)
        values, slopes = shape_functions(self.degree, x[:, None])
        nodes = self.control_points[self.edges[chosen]]
        tangent = (slopes[:, 0] @ nodes).reshape(-1, 2)
        speed = np.linalg.norm(tangent, axis=1)
        yield BoundarySamples(
            (values @ nodes).reshape(-1, 2),
            np.column_stack([tangent[:, 1], -tangent[:, 0]]) / speed[:, None],
            self._matrix(np.repeat(chosen, len(x)), np.tile(values, (len(chosen), 1))),
            speed * np.tile(weight, len(chosen)),
        )

    def refined(self) -> TriangleRim:
        """The rim with every edge halved; new nodes stand on the boundary itself."""
        k = self.degree
        keys = lattice_keys(self.edges[:, :2], 2 * k)
        _, first, inverse = np.unique(
            keys.reshape(-1, 2 * k), axis=0, return_index=True, return_inverse=True
        )
        fine = lattice(1, 2 * k)
        u = (self.edge_u @ fine.T / (2 * k)).ravel()[first]
        points = self.curve.evaluate(np.repeat(self.edge_patch, 2 * k + 1)[first], u)
        numbers = inverse.reshape(keys.shape[:2])
        # from one end to the other, then both halves in the order of the lattice
        row = numbers[:, np.argsort(fine[:, 1])]
        place = lattice(1, k)[:, 1]
        edges = np.stack([row[:, place], row[:, place + k]], axis=1).reshape(-1, k + 1)
        ends = np.column_stack([self.edge_u[:, 0], self.edge_u.mean(axis=1), self.edge_u[:, 1]])
        return TriangleRim(
            k,
            points,
            edges,
            np.repeat(self.edge_patch, 2),
            np.stack([ends[:, :2], ends[:, 1:]], axis=1).reshape(-1, 2),
            self.curve,
        )

    def _matrix(self, edge: np.ndarray, values: np.ndarray) -> sparse.csr_matrix:
        """Values (m, degree + 1) on edges as a matrix on all unknowns."""
        ends = np.arange(0, values.size + 1, self.degree + 1)
        data = values.ravel(), self.edges[edge].ravel(), ends
        return sparse.csr_matrix(data, shape=(len(edge), self.size))


_LONG = 4.0
"""Parameters of an arc are less than this: [0, 1], and a little more across a smooth end."""
