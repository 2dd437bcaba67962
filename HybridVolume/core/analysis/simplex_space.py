# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Polynomials on simplices: curved tets of a core in space, curved triangles in the plane.

Nodes stand on the lattice of each simplex: corners, and for degree k also the points that cut its
edges (faces, inside) into k parts. The elements are isoparametric. The dimension d is that of the
nodes; its faces on the interface are triangles for d = 3 and edges for d = 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product
from math import factorial

import numpy as np
from scipy import sparse

from ..elements import gauss_line, quadrature
from .samples import FaceSamples, Samples

DEGREES = (1, 2, 3)
_BLOCK = 2_000_000
"""Values of basis functions that are held at once, which bounds the memory."""


@cache
def lattice(dimension: int, degree: int) -> np.ndarray:
    """Points of the simplex lattice as counts of its corners, (n, dimension + 1), corners first."""
    all_counts = product(range(degree + 1), repeat=dimension + 1)
    counts = np.array([c for c in all_counts if sum(c) == degree])
    order = np.lexsort((*(-counts.T[::-1]), -counts.max(axis=1)))
    return counts[order]


def bernstein(degree: int, barycentric: np.ndarray) -> np.ndarray:
    """Bernstein polynomials of the simplex at m points, (m, n) in the order of the lattice."""
    counts = lattice(barycentric.shape[1] - 1, degree)
    fact = np.array([factorial(k) for k in range(degree + 1)], dtype=float)
    scale = fact[degree] / fact[counts].prod(axis=1)
    return (barycentric[:, None, :] ** counts).prod(axis=2) * scale


@cache
def bernstein_coefficients(dimension: int, degree: int) -> np.ndarray:
    """Bernstein polynomials at the lattice, inverted: (n, n), functions of nodes in columns."""
    return np.linalg.inv(bernstein(degree, lattice(dimension, degree) / degree))


def _bernstein_slopes(degree: int, barycentric: np.ndarray) -> np.ndarray:
    """Derivatives with respect to the barycentric coordinates, (m, n, d + 1)."""
    counts = lattice(barycentric.shape[1] - 1, degree)
    lower = {tuple(c): k for k, c in enumerate(lattice(counts.shape[1] - 1, degree - 1).tolist())}
    values = bernstein(degree - 1, barycentric)
    slopes = np.zeros((len(barycentric), *counts.shape))
    for n, count in enumerate(counts.tolist()):
        for d in np.flatnonzero(count):
            less = list(count)
            less[d] -= 1
            slopes[:, n, d] = degree * values[:, lower[tuple(less)]]
    return slopes


def shape_functions(degree: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lagrange polynomials of the lattice's nodes in the reference simplex.

    Parameters
    ----------
    degree : {1, 2, 3}
    points : (m, d) array
        Reference coordinates: the barycentric ones of all corners but the first.

    Returns
    -------
    values : (m, n) array
    slopes : (m, d, n) array
        With respect to the reference coordinates.
    """
    barycentric = np.column_stack([1.0 - points.sum(axis=1), points])
    coefficients = bernstein_coefficients(points.shape[1], degree)
    slopes = _bernstein_slopes(degree, barycentric)
    along = slopes[:, :, 1:] - slopes[:, :, :1]
    values = bernstein(degree, barycentric) @ coefficients
    return values, np.swapaxes(along, 1, 2) @ coefficients


def simplex_rule(dimension: int, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss points (m, dimension) and weights (m,) of the reference simplex."""
    if dimension == 1:
        at, weight = gauss_line(points)
        return at[:, None], weight
    return quadrature("tri" if dimension == 2 else "tet", points)


def cut_rule(dimension: int, points: int, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss points and weights of a reference edge or triangle whose sides are cut into parts."""
    at, weight = simplex_rule(dimension, points)
    corner = np.array(list(product(range(parts), repeat=dimension)))
    corner = corner[corner.sum(axis=1) < parts]
    # in a triangle, those between three of the first kind are turned by half a turn
    turned = corner[corner.sum(axis=1) < parts - 1] + 1 if dimension == 2 else corner[:0]
    places = np.concatenate([corner[:, None] + at, turned[:, None] - at]) / parts
    count = len(corner) + len(turned)
    return places.reshape(-1, dimension), np.tile(weight, count) / parts**dimension


def lattice_keys(simplices: np.ndarray, degree: int) -> np.ndarray:
    """What each lattice node of simplices is the mean of, (m, n, degree), sorted.

    Corners' numbers with repetition: nodes that simplices share have the same key, so that they
    are found by numbers and not by distance.
    """
    counts = lattice(simplices.shape[1] - 1, degree)
    places = np.array([np.repeat(np.arange(len(c)), c) for c in counts])
    return np.sort(simplices[:, places], axis=2)


def found_rows(table: np.ndarray, keys: np.ndarray) -> np.ndarray:
    """Rows of a sorted table of different rows that keys are; all of them must be there."""
    both, inverse = np.unique(np.concatenate([table, keys]), axis=0, return_inverse=True)
    if len(both) != len(table):
        raise ValueError("the interface has corners that no element has")
    return inverse.ravel()[len(table) :]


@dataclass(frozen=True)
class SimplexSpace:
    """Polynomials of one degree on curved tets (d = 3) or triangles (d = 2).

    Attributes
    ----------
    degree : {1, 2, 3}
    nodes : (n, d) array
        mm
    elements : (m, nl) int array
        Nodes of each element in the order of ``lattice(d, degree)``; positively oriented.
    interface : (k,) int array
        Nodes on the interface.
    interface_patch : (k,) int array
    interface_uv : (k, d - 1) array
        Their parameters on that patch of the boundary.
    interface_w : (k,) array
        Their parameters through the shell: 1 on its inner boundary.
    faces : (t, nf) int array
        Nodes of the elements' faces on the interface, in the order of ``lattice(d - 1, degree)``.
    face_patch : (t,) int array
    face_uv : (t, d, d - 1) array
        Parameters of the faces' corners on that patch.
    face_w : (t, d) array
        And through the shell.
    """

    degree: int
    nodes: np.ndarray
    elements: np.ndarray
    interface: np.ndarray
    interface_patch: np.ndarray
    interface_uv: np.ndarray
    interface_w: np.ndarray
    faces: np.ndarray
    face_patch: np.ndarray
    face_uv: np.ndarray
    face_w: np.ndarray

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return self.nodes.shape[1]

    @property
    def size(self) -> int:
        """Number of unknowns (of one component)."""
        return len(self.nodes)

    def samples(self, points: int | None = None) -> Iterator[Samples]:
        """Functions at Gauss points of all elements, a block at a time.

        Parameters
        ----------
        points : int, optional
            Gauss points a direction; by default exact for products of two functions.
        """
        at, weight = simplex_rule(self.dimension, points or self.degree + 2)
        values, slopes = shape_functions(self.degree, at)
        size = slopes.size
        for rows in np.array_split(
            np.arange(len(self.elements)), 1 + len(self.elements) * size // _BLOCK
        ):
            unknowns = self.elements[rows]
            x = self.nodes[unknowns]
            jacobian = slopes @ x[:, None]
            yield Samples(
                rows,
                unknowns,
                values @ x,
                np.broadcast_to(values, (len(rows), *values.shape)),
                np.linalg.inv(jacobian) @ slopes,
                np.linalg.det(jacobian) * weight,
            )

    def face_samples(self, points: int | None = None, parts: int = 1) -> FaceSamples:
        """Functions and their gradients at Gauss points of the interface's faces.

        Parameters
        ----------
        points : int, optional
            Gauss points a direction.
        parts : int
            Parts that each side is cut into, with so many points in each: for faces that reach
            over knots, where the functions beside them are not smooth.
        """
        dim = self.dimension
        at, weight = cut_rule(dim - 1, points or self.degree + 3, parts)
        share = np.column_stack([1.0 - at.sum(axis=1), at])
        element, corners = self.elements_of_faces
        count = len(weight)
        rows = np.arange(len(element) * count).reshape(len(element), count)
        values = np.empty((len(element), count, self.elements.shape[1]))
        gradients = np.empty((dim, *values.shape))
        place = np.empty((len(element), count, dim))
        normals = np.empty((len(element), count, dim))
        area = np.empty((len(element), count))
        unit = np.eye(dim + 1)
        # faces whose corners have the same places in their elements have the same functions
        ways, way = np.unique(corners, axis=0, return_inverse=True)
        for number, places in enumerate(ways):
            chosen = np.flatnonzero(way.ravel() == number)
            reference = share @ unit[places][:, 1:]
            inside, along = shape_functions(self.degree, reference)
            x = self.nodes[self.elements[element[chosen]]]
            jacobian = along @ x[:, None]
            inverse = np.linalg.inv(jacobian)
            # the barycentric coordinate of the corner off the face falls along the outer normal
            (off,) = np.setdiff1d(np.arange(dim + 1), places)
            fall = -1.0 * (unit[off, 1:] - unit[off, 0])
            normal = inverse @ fall
            length = np.linalg.norm(normal, axis=-1)
            values[chosen] = inside
            gradients[:, chosen] = np.moveaxis(inverse @ along, 2, 0)
            place[chosen] = inside @ x
            normals[chosen] = normal / length[..., None]
            area[chosen] = np.abs(np.linalg.det(jacobian)) * length * weight
        unknowns = np.repeat(self.elements[element], count, axis=0)

        def matrix(entries: np.ndarray) -> sparse.csr_matrix:
            row = np.broadcast_to(rows.reshape(-1, 1), unknowns.shape)
            data = entries.reshape(unknowns.shape)
            at = row.ravel(), unknowns.ravel()
            return sparse.csr_matrix((data.ravel(), at), shape=(rows.size, self.size))

        uv = np.einsum("qc,fcd->fqd", share, self.face_uv)
        return FaceSamples(
            np.repeat(self.face_patch, count),
            uv.reshape(-1, dim - 1),
            (self.face_w @ share.T).ravel(),
            place.reshape(-1, dim),
            matrix(values),
            tuple(matrix(part) for part in gradients),
            normals.reshape(-1, dim),
            area.ravel(),
            np.repeat(self._stiffness_of_faces(area.sum(axis=1), element), count),
        )

    @cached_property
    def elements_of_faces(self) -> tuple[np.ndarray, np.ndarray]:
        """Element behind each face of the interface, and the places of its corners there."""
        count = self.dimension + 1
        corners = self.elements[:, :count]
        without = np.array([[k for k in range(count) if k != omitted] for omitted in range(count)])
        table = np.sort(corners[:, without].reshape(-1, count - 1), axis=1)
        keys = np.sort(self.faces[:, : count - 1], axis=1)
        _, inverse = np.unique(np.concatenate([keys, table]), axis=0, return_inverse=True)
        inverse = inverse.ravel()
        place = np.full(inverse.max() + 1, -1)
        place[inverse[len(keys) :]] = np.arange(len(table))
        element = place[inverse[: len(keys)]] // count
        own = self.faces[:, : count - 1, None]
        where = (corners[element][:, None, :] == own).argmax(axis=2)
        return element, where

    def _stiffness_of_faces(self, area: np.ndarray, element: np.ndarray) -> np.ndarray:
        """Bounds C_F of the squared normal derivative on a face by its element's energy, 1/mm.

        k (k + d - 1) / d |F| / |K| (Warburton and Hesthaven), times the unevenness of det J, and
        times the number of faces that the element has on the interface.
        """
        k, dim = self.degree, self.dimension
        at, weight = simplex_rule(dim, k + 2)
        _, slopes = shape_functions(k, at)
        determinant = np.linalg.det(slopes @ self.nodes[self.elements[element]][:, None])
        uneven = determinant.max(axis=1) / determinant.min(axis=1)
        shared = np.bincount(element, minlength=len(self.elements))[element]
        return k * (k + dim - 1) / dim * area / (determinant @ weight) * uneven * shared

    @cached_property
    def jacobian_bounds(self) -> np.ndarray:
        """Lower bounds of det J of each element, (m,), mm³; positive: the element is proved valid.

        Bernstein coefficients, of parts of the element where those of the whole do not decide.
        """
        return self.bounds_of(np.arange(len(self.elements)))[0]

    def bounds_of(
        self, rows: np.ndarray, nodes: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Lower bounds and means of det J of some elements, with other places of the nodes if so.

        Parameters
        ----------
        rows : (k,) int array
        nodes : (n, d) array, optional

        Returns
        -------
        bounds, means : (k,) arrays
            mm³
        """
        dim = self.dimension
        degree = max(dim * (self.degree - 1), 1)
        at = lattice(dim, degree)[:, 1:] / degree
        _, slopes = shape_functions(self.degree, at)
        x = (self.nodes if nodes is None else nodes)[self.elements[rows]]
        coefficients = np.linalg.det(slopes @ x[:, None]) @ bernstein_coefficients(dim, degree).T
        return _least(coefficients, dim, degree), coefficients.mean(axis=1)


_DEPTH = 4
"""How often an element is subdivided whose coefficients do not decide."""
_ROUNDING = 1e-12
"""Share of the largest coefficient that rounding may take from the smallest one."""


def _least(coefficients: np.ndarray, dim: int, degree: int) -> np.ndarray:
    """Lower bounds of polynomials by their Bernstein coefficients (k, n), and those of parts."""
    corner = coefficients[:, : dim + 1].min(axis=1)
    margin = _ROUNDING * np.abs(coefficients).max(axis=1, initial=0.0)
    bound = coefficients.min(axis=1) - margin
    # values at corners are exact: where they are not positive, no subdivision can help
    rows = np.flatnonzero((bound <= 0.0) & (corner > 0.0))
    part, owner = coefficients[rows], rows
    restrict = np.concatenate([
        bernstein_coefficients(dim, degree)
        @ bernstein(degree, lattice(dim, degree) / degree @ corners)
        for corners in parts_of_simplex(dim)[0] / 2.0
    ])  # fmt: skip
    width = coefficients.shape[1]
    settled = np.full(len(bound), np.inf)
    for _ in range(_DEPTH):
        if not len(part):
            break
        part = (part @ restrict.T).reshape(-1, width)
        owner = np.repeat(owner, 2**dim)
        low = part.min(axis=1) - margin[owner]
        positive = low > 0.0
        np.minimum.at(settled, owner[positive], low[positive])
        bound[owner] = settled[owner]
        np.minimum.at(bound, owner[~positive], low[~positive])
        # a value that is not positive refutes the whole element
        folded = np.zeros(len(bound), dtype=bool)
        folded[owner[part[:, : dim + 1].min(axis=1) <= 0.0]] = True
        again = ~positive & ~folded[owner]
        part, owner = part[again], owner[again]
    return bound


DIAGONALS = (((0, 1), (2, 3)), ((0, 2), (1, 3)), ((0, 3), (1, 2)))
"""Pairs of opposite edges of a tet, between whose middles the octahedron may be cut."""


@cache
def parts_of_simplex(dimension: int) -> np.ndarray:
    """Corners of the 2^d equal parts of a simplex, (ways, 2^d, d + 1, d + 1).

    Barycentric coordinates in halves: rows (2, 0, ..) are corners, (1, 1, 0, ..) middles of edges.
    A tet has three ways, one for each diagonal of the octahedron in its middle (Bey 1995).
    """
    count = dimension + 1
    middle = {
        (a, b): np.eye(count, dtype=int)[a] + np.eye(count, dtype=int)[b]
        for a in range(count)
        for b in range(count)
    }
    corner = [
        np.array([middle[k, j] if j != k else middle[k, k] for j in range(count)])
        for k in range(count)
    ]
    if dimension == 1:
        return np.array([corner])
    if dimension == 2:
        return np.array([[*corner, [middle[1, 2], middle[0, 2], middle[0, 1]]]])
    ways = []
    for (a, b), (c, d) in DIAGONALS:
        # around the diagonal from the middle of ab to that of cd
        ring = [middle[a, c], middle[c, b], middle[b, d], middle[d, a]]
        inside = [
            np.array([middle[a, b], middle[c, d], ring[k], ring[(k + 1) % 4]]) for k in range(4)
        ]
        oriented = [t if np.linalg.det(t) > 0 else t[[1, 0, 2, 3]] for t in inside]
        ways.append([*corner, *oriented])
    return np.array(ways)
