# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Polynomials on the tetrahedra of the core, whose boundary follows the shell's inner surface.

Nodes stand on the lattice of each tet: corners, and for degree k also the points that cut its
edges (and faces) into k parts. A node is known by the k corners, with repetition, of which its
lattice point is the mean; so nodes that elements share are found by numbers, not by distance. The
elements are isoparametric: nodes on the interface stand on the inner surface itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product
from math import factorial

import numpy as np
from scipy import sparse

from ...errors import InputError
from ..columns import evaluate_columns
from ..elements import quadrature
from ..interior import Interface, Interior
from ..shell import Shell
from .spline_space import Samples

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


@cache
def _coefficients(degree: int) -> np.ndarray:
    """Bernstein polynomials at the lattice, inverted: (n, n), functions of nodes in columns."""
    points = lattice(3, degree) / degree
    return np.linalg.inv(_bernstein(degree, points))


def _bernstein(degree: int, barycentric: np.ndarray) -> np.ndarray:
    """Bernstein polynomials of the simplex at m points, (m, n) in the order of the lattice."""
    counts = lattice(barycentric.shape[1] - 1, degree)
    fact = np.array([factorial(k) for k in range(degree + 1)], dtype=float)
    scale = fact[degree] / fact[counts].prod(axis=1)
    return (barycentric[:, None, :] ** counts).prod(axis=2) * scale


def _bernstein_slopes(degree: int, barycentric: np.ndarray) -> np.ndarray:
    """Derivatives with respect to the barycentric coordinates, (m, n, d + 1)."""
    counts = lattice(barycentric.shape[1] - 1, degree)
    lower = {tuple(c): k for k, c in enumerate(lattice(counts.shape[1] - 1, degree - 1).tolist())}
    values = _bernstein(degree - 1, barycentric)
    slopes = np.zeros((len(barycentric), *counts.shape))
    for n, count in enumerate(counts.tolist()):
        for d in np.flatnonzero(count):
            less = list(count)
            less[d] -= 1
            slopes[:, n, d] = degree * values[:, lower[tuple(less)]]
    return slopes


def shape_functions(degree: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lagrange polynomials of the lattice's nodes in the reference tet.

    Parameters
    ----------
    degree : {1, 2, 3}
    points : (m, 3) array
        Reference coordinates: the barycentric ones of corners 1, 2 and 3.

    Returns
    -------
    values : (m, n) array
    slopes : (m, 3, n) array
        With respect to the reference coordinates.
    """
    barycentric = np.column_stack([1.0 - points.sum(axis=1), points])
    coefficients = _coefficients(degree)
    slopes = _bernstein_slopes(degree, barycentric)
    along = slopes[:, :, 1:] - slopes[:, :, :1]
    values = _bernstein(degree, barycentric) @ coefficients
    return values, np.swapaxes(along, 1, 2) @ coefficients


@dataclass(frozen=True)
class FaceSamples:
    """Functions of the core at m quadrature points on the interface.

    Attributes
    ----------
    patch : (m,) int array
    uv : (m, 2) array
        Where the shell is beside them: parameters on the patch,
    w : (m,) array
        and through the shell.
    values : (m, size) sparse matrix
    gradients : three (m, size) sparse matrices
        1/mm
    normal : (m, 3) array
        Unit normals out of the core.
    measure : (m,) array
        Area times the weight of the quadrature, mm².
    bound : (m,) array
        C_F: the integral of a squared slope over the triangle is at most C_F times that of the
        squared gradient over its tet, 1/mm.
    """

    patch: np.ndarray
    uv: np.ndarray
    w: np.ndarray
    values: sparse.csr_matrix
    gradients: tuple[sparse.csr_matrix, ...]
    normal: np.ndarray
    measure: np.ndarray
    bound: np.ndarray

    @property
    def slopes(self) -> sparse.csr_matrix:
        """Derivatives along the normals, (m, size) sparse matrix, 1/mm."""
        return sum(
            sparse.diags(n) @ gradient
            for n, gradient in zip(self.normal.T, self.gradients, strict=True)
        ).tocsr()


@dataclass(frozen=True)
class TetSpace:
    """Polynomials of one degree on curved tets.

    Attributes
    ----------
    degree : {1, 2, 3}
    nodes : (n, 3) array
        mm
    elements : (m, nl) int array
        Nodes of each tet in the order of :func:`lattice`.
    interface : (k,) int array
        Nodes on the interface.
    interface_patch : (k,) int array
    interface_uv : (k, 2) array
        Their parameters on that patch of the surface.
    interface_w : (k,) array
        Their parameters through the shell: 1 on its inner boundary.
    faces : (t, nf) int array
        Nodes of the interface's triangles, in the order of ``lattice(2, degree)``.
    face_patch : (t,) int array
    face_uv : (t, 3, 2) array
        Parameters of the triangles' corners on that patch.
    face_w : (t, 3) array
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
    def size(self) -> int:
        """Number of unknowns (of one component)."""
        return len(self.nodes)

    def samples(self, points: int | None = None) -> Iterator[Samples]:
        """Functions at Gauss points of all tets, a block at a time.

        Parameters
        ----------
        points : int, optional
            Gauss points a direction; by default exact for products of two functions.
        """
        at, weight = quadrature("tet", points or self.degree + 2)
        values, slopes = shape_functions(self.degree, at)
        size = slopes.size
        for rows in np.array_split(
            np.arange(len(self.elements)), 1 + len(self.elements) * size // _BLOCK
        ):
            unknowns = self.elements[rows]
            x = self.nodes[unknowns]
            jacobian = slopes @ x[:, None]
            gradients = np.linalg.solve(jacobian, np.broadcast_to(
                slopes, (len(rows), *slopes.shape)
            ))  # fmt: skip
            yield Samples(
                rows,
                unknowns,
                values @ x,
                np.broadcast_to(values, (len(rows), *values.shape)),
                gradients,
                np.linalg.det(jacobian) * weight,
            )

    def face_samples(self, points: int | None = None) -> FaceSamples:
        """Functions and their gradients at Gauss points of the interface's triangles.

        Parameters
        ----------
        points : int, optional
            Gauss points a direction.
        """
        at, weight = quadrature("tri", points or self.degree + 3)
        share = np.column_stack([1.0 - at.sum(axis=1), at])
        tet, corners = self._tets_of_faces
        count = len(weight)
        rows = np.arange(len(tet) * count).reshape(len(tet), count)
        values = np.empty((len(tet), count, self.elements.shape[1]))
        gradients = np.empty((3, *values.shape))
        normals = np.empty((len(tet), count, 3))
        area = np.empty((len(tet), count))
        # triangles whose corners have the same places in their tets have the same functions
        ways, way = np.unique(corners, axis=0, return_inverse=True)
        for number, places in enumerate(ways):
            chosen = np.flatnonzero(way.ravel() == number)
            reference = share @ np.eye(4)[places][:, 1:]
            inside, along = shape_functions(self.degree, reference)
            x = self.nodes[self.elements[tet[chosen]]]
            jacobian = along @ x[:, None]
            edges = np.eye(4)[places][1:, 1:] - np.eye(4)[places][:1, 1:]
            tangents = edges @ jacobian
            normal = np.cross(tangents[..., 0, :], tangents[..., 1, :])
            length = np.linalg.norm(normal, axis=-1)
            full = np.broadcast_to(along, (len(chosen), *along.shape))
            values[chosen] = inside
            gradients[:, chosen] = np.moveaxis(np.linalg.solve(jacobian, full), 2, 0)
            normals[chosen] = normal / length[..., None]
            area[chosen] = length * weight
        unknowns = np.repeat(self.elements[tet], count, axis=0)

        def matrix(entries: np.ndarray) -> sparse.csr_matrix:
            row = np.broadcast_to(rows.reshape(-1, 1), unknowns.shape)
            data = entries.reshape(unknowns.shape)
            place = row.ravel(), unknowns.ravel()
            return sparse.csr_matrix((data.ravel(), place), shape=(rows.size, self.size))

        uv = np.einsum("qc,fcd->fqd", share, self.face_uv)
        return FaceSamples(
            np.repeat(self.face_patch, count),
            uv.reshape(-1, 2),
            (self.face_w @ share.T).ravel(),
            matrix(values),
            tuple(matrix(part) for part in gradients),
            normals.reshape(-1, 3),
            area.ravel(),
            np.repeat(self._stiffness_of_faces(area.sum(axis=1), tet), count),
        )

    @cached_property
    def _tets_of_faces(self) -> tuple[np.ndarray, np.ndarray]:
        """Tet behind each triangle of the interface, and the places of its corners there."""
        corners = self.elements[:, :4]
        faces = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
        table = np.sort(corners[:, faces].reshape(-1, 3), axis=1)
        keys = np.sort(self.faces[:, :3], axis=1)
        both = np.concatenate([keys, table])
        _, first = np.unique(both[::-1], axis=0, return_inverse=True)
        first = first.ravel()[::-1]
        place = np.full(first.max() + 1, -1)
        place[first[len(keys) :]] = np.arange(len(table))
        tet = place[first[: len(keys)]] // 4
        where = (corners[tet][:, None, :] == self.faces[:, :3, None]).argmax(axis=2)
        return tet, where

    def _stiffness_of_faces(self, area: np.ndarray, tet: np.ndarray) -> np.ndarray:
        """Bounds C_F of the squared normal derivative on a face by the energy of its tet, 1/mm.

        k (k + 2) / 3 |F| / |K| (Warburton and Hesthaven), times the unevenness of det J, and
        times the number of faces that the tet has on the interface.
        """
        k = self.degree
        at, weight = quadrature("tet", k + 2)
        _, slopes = shape_functions(k, at)
        determinant = np.linalg.det(slopes @ self.nodes[self.elements[tet]][:, None])
        uneven = determinant.max(axis=1) / determinant.min(axis=1)
        shared = np.bincount(tet, minlength=len(self.elements))[tet]
        return k * (k + 2) / 3.0 * area / (determinant @ weight) * uneven * shared

    @cached_property
    def jacobian_bounds(self) -> np.ndarray:
        """Lower bounds of det J of each tet by its Bernstein coefficients, (m,), mm³."""
        degree = max(3 * (self.degree - 1), 1)
        at = lattice(3, degree)[:, 1:] / degree
        _, slopes = shape_functions(self.degree, at)
        determinant = np.linalg.det(slopes @ self.nodes[self.elements][:, None])
        return (determinant @ _coefficients(degree).T).min(axis=1)


def tet_space(shell: Shell, interface: Interface, interior: Interior, degree: int = 2) -> TetSpace:
    """Polynomials on the tets of a core.

    Parameters
    ----------
    shell : Shell
    interface : Interface
    interior : Interior
        Its first vertices are those of the interface.
    degree : {1, 2, 3}

    Raises
    ------
    InputError
        The degree is another, or a tet is folded by the curved interface; its faces are named.
    """
    if degree not in DEGREES:
        raise InputError(f"degree {degree} in the core", remedy="choose 1, 2 or 3")
    mesh = interior.mesh
    keys = _keys(mesh.tets, degree)
    flat, inverse = np.unique(keys.reshape(-1, degree), axis=0, return_inverse=True)
    elements = inverse.reshape(keys.shape[:2])
    nodes = mesh.vertices[flat].mean(axis=1)
    corners = np.full(len(mesh.vertices), -1)
    at_corner = (flat == flat[:, :1]).all(axis=1)
    corners[flat[at_corner, 0]] = np.flatnonzero(at_corner)
    nodes[corners] = mesh.vertices

    triangle_keys = _keys(interface.triangles, degree)
    faces = _found(flat, triangle_keys.reshape(-1, degree)).reshape(triangle_keys.shape[:2])
    on, first = np.unique(faces, return_index=True)
    triangle, place = np.divmod(first, faces.shape[1])
    share = lattice(2, degree)[place] / degree
    patch = interface.triangle_patch[triangle]
    uv = np.einsum("kc,kcd->kd", share, interface.triangle_uv[triangle])
    reach = interface.vertex_w if len(interface.vertex_w) else np.ones(len(interface.vertices))
    face_w = reach[interface.triangles]
    w = (share * face_w[triangle]).sum(axis=1)
    straight = nodes.copy()
    nodes[on] = evaluate_columns(shell, patch, uv, w[None])[0]
    # the mesh's own vertices keep their bits
    vertices = corners[: len(interface.vertices)]
    nodes[vertices] = interface.vertices
    if degree == 3:
        _centre_faces(nodes, straight, flat, on)
    space = TetSpace(
        degree,
        nodes,
        elements,
        on,
        patch,
        uv,
        w,
        faces,
        interface.triangle_patch,
        interface.triangle_uv,
        face_w,
    )
    folded = np.flatnonzero(space.jacobian_bounds <= 0.0)
    if len(folded):
        near = np.isin(interface.triangles, mesh.tets[folded]).any(axis=1)
        patches = np.unique(interface.triangle_patch[near])
        raise InputError(
            f"{len(folded)} tetrahedra of degree {degree} are folded by the curved interface",
            faces=list(dict.fromkeys(shell.surface.patches[k].face for k in patches)),
            figure=float(len(folded)),
            remedy="refine the shell, or choose linear tetrahedra",
        )
    return space


def _keys(simplices: np.ndarray, degree: int) -> np.ndarray:
    """What each lattice node of simplices is the mean of, (m, n, degree), sorted."""
    counts = lattice(simplices.shape[1] - 1, degree)
    places = np.array([np.repeat(np.arange(len(c)), c) for c in counts])
    return np.sort(simplices[:, places], axis=2)


def _found(table: np.ndarray, keys: np.ndarray) -> np.ndarray:
    """Rows of a sorted table that keys are; all of them are there."""
    both, inverse = np.unique(np.concatenate([table, keys]), axis=0, return_inverse=True)
    if len(both) != len(table):
        raise ValueError("the interface has corners that no tet has")
    return inverse.ravel()[len(table) :]


def _centre_faces(
    nodes: np.ndarray, straight: np.ndarray, flat: np.ndarray, interface: np.ndarray
) -> None:
    """Move the nodes in faces beside the interface, so that cubic tets stay smooth inside.

    A face's node follows the nodes of its edges such that quadratic maps are kept.
    """
    corner = (np.diff(flat, axis=1) != 0).all(axis=1)
    corner[interface] = False
    inside = np.flatnonzero(corner)
    a, b, c = flat[inside].T
    edges = np.concatenate(
        [np.sort(np.column_stack(t), axis=1)
         for t in ((a, a, b), (a, b, b), (b, b, c), (b, c, c), (a, a, c), (a, c, c))]
    )  # fmt: skip
    moved = (nodes - straight)[_found(flat, edges)].reshape(6, -1, 3)
    nodes[inside] += 0.25 * moved.sum(axis=0)
