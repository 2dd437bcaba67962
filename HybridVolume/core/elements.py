# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Node orders, shape functions and quadrature of the finite elements: the one place for all three.

The order inside the program is that of Abaqus and CalculiX, right-handed: in a tet the normal of
nodes 1-2-3 points to node 4, in a wedge to nodes 4-5-6; mid nodes follow the corners in the order
of :data:`EDGES`. Other programs' orders are permutations of it, :data:`ORDERS`.

Reference coordinates are those of the unit simplex and of [0, 1], for every kind of element.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np

_TRIANGLE_EDGES = ((0, 1), (1, 2), (2, 0))
_QUAD_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0))
_TET_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
_WEDGE_EDGES = ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5))
_HEX_EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)

EDGES: dict[str, tuple[tuple[int, int], ...]] = {
    "tri3": _TRIANGLE_EDGES,
    "tri6": _TRIANGLE_EDGES,
    "quad4": _QUAD_EDGES,
    "quad8": _QUAD_EDGES,
    "tet4": _TET_EDGES,
    "tet10": _TET_EDGES,
    "penta6": _WEDGE_EDGES,
    "penta15": _WEDGE_EDGES,
    "hex8": _HEX_EDGES,
    "hex20": _HEX_EDGES,
}
"""Corners of each edge; in the quadratic kinds mid node ``corners + e`` lies on edge ``e``."""

MIDDLES: dict[str, tuple[tuple[int, ...], ...]] = {
    "penta18": ((0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
}
"""Corners of the sides that have a node in the middle, the last nodes. This program makes no such
elements: gmsh does, and they are measured beside its own (`HybridVolume.reproduce.rivals`)."""

FACES: dict[str, tuple[tuple[int, ...], ...]] = {
    "tet4": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
    "tet10": (
        (0, 2, 1, 6, 5, 4),
        (0, 1, 3, 4, 8, 7),
        (1, 2, 3, 5, 9, 8),
        (2, 0, 3, 6, 7, 9),
    ),
    "penta6": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "penta15": (
        (0, 2, 1, 8, 7, 6),
        (3, 4, 5, 9, 10, 11),
        (0, 1, 4, 3, 6, 13, 9, 12),
        (1, 2, 5, 4, 7, 14, 10, 13),
        (2, 0, 3, 5, 8, 12, 11, 14),
    ),
    "hex8": (
        *((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4)),
        *((1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    ),
    "hex20": (
        (0, 3, 2, 1, 11, 10, 9, 8),
        (4, 5, 6, 7, 12, 13, 14, 15),
        (0, 1, 5, 4, 8, 17, 12, 16),
        (1, 2, 6, 5, 9, 18, 13, 17),
        (2, 3, 7, 6, 10, 19, 14, 18),
        (3, 0, 4, 7, 11, 16, 15, 19),
    ),
}
"""Faces with their normals outward, numbered as CalculiX numbers them (S1 is the first)."""

CALCULIX_NAMES: dict[str, str] = {
    "tet4": "C3D4",
    "tet10": "C3D10",
    "penta6": "C3D6",
    "penta15": "C3D15",
    "hex8": "C3D8",
    "hex20": "C3D20",
}
"""Element types of CalculiX."""

VTK_TYPES: dict[str, int] = {
    "tri3": 5,
    "tri6": 22,
    "quad4": 9,
    "quad8": 23,
    "tet4": 10,
    "tet10": 24,
    "penta6": 13,
    "penta15": 26,
    "hex8": 12,
    "hex20": 25,
}
"""Cell types of VTK."""

# FreeCAD (SMESH) turns the bottom face the other way round: its elements are mirrored lists.
_FREECAD = {
    "tri3": (0, 1, 2),
    "tri6": (0, 1, 2, 3, 4, 5),
    "quad4": (0, 1, 2, 3),
    "quad8": (0, 1, 2, 3, 4, 5, 6, 7),
    "tet4": (0, 2, 1, 3),
    "tet10": (0, 2, 1, 3, 6, 5, 4, 7, 9, 8),
    "penta6": (0, 2, 1, 3, 5, 4),
    "penta15": (0, 2, 1, 3, 5, 4, 8, 7, 6, 11, 10, 9, 12, 14, 13),
    "hex8": (0, 3, 2, 1, 4, 7, 6, 5),
    "hex20": (0, 3, 2, 1, 4, 7, 6, 5, 11, 10, 9, 8, 15, 14, 13, 12, 16, 19, 18, 17),
}
# VTK has the order of Abaqus for all these kinds (vtkWedge since its base was turned to agree with
# vtkQuadraticWedge); only Bézier cells need an order of their own, see exports.vtu.
_VTK = {kind: tuple(range(len(order))) for kind, order in _FREECAD.items()}
_GMSH = {
    **_VTK,
    "tet10": (0, 1, 2, 3, 4, 5, 6, 7, 9, 8),
    "penta15": (0, 1, 2, 3, 4, 5, 6, 8, 12, 7, 13, 14, 9, 11, 10),
    "hex20": (0, 1, 2, 3, 4, 5, 6, 7, 8, 11, 16, 9, 17, 10, 18, 19, 12, 15, 13, 14),
}

ORDERS: dict[str, dict[str, tuple[int, ...]]] = {
    "abaqus": _VTK,
    "freecad": _FREECAD,
    "gmsh": _GMSH,
    "vtk": _VTK,
}
"""``ORDERS[program][kind]``: the program's list is ``connectivity[:, order]``."""


def to_order(program: str, kind: str, connectivity: np.ndarray) -> np.ndarray:
    """Connectivity in another program's node order.

    Parameters
    ----------
    program : {"abaqus", "freecad", "gmsh", "vtk"}
    kind : str
    connectivity : (m, n) int array
        In the order of this program (Abaqus).

    Returns
    -------
    (m, n) int array
    """
    return np.asarray(connectivity)[:, ORDERS[program][kind]]


def from_order(program: str, kind: str, connectivity: np.ndarray) -> np.ndarray:
    """Connectivity that another program gave, in the order of this one; reverses `to_order`."""
    return np.asarray(connectivity)[:, np.argsort(ORDERS[program][kind])]


@dataclass(frozen=True, eq=False)
class ReferenceElement:
    """A kind of element: where its nodes stand and which polynomials it spans.

    Attributes
    ----------
    kind : str
    corners : int
        Number of corner nodes; they come first.
    nodes : (n, dim) array
        Reference coordinates.
    exponents : (n, dim) int array
        Monomials of the space.
    coefficients : (n, n) array
        Shape function i is ``sum_j coefficients[j, i] * monomial_j``.
    """

    kind: str
    corners: int
    nodes: np.ndarray
    exponents: np.ndarray
    coefficients: np.ndarray

    @property
    def dimension(self) -> int:
        """Number of reference coordinates."""
        return self.nodes.shape[1]


def _monomials(exponents: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.prod(points[:, None, :] ** exponents[None, :, :], axis=2)


def _simplex_exponents(dimension: int, degree: int) -> list[tuple[int, ...]]:
    grid = np.stack(np.meshgrid(*[np.arange(degree + 1)] * dimension, indexing="ij"), axis=-1)
    flat = grid.reshape(-1, dimension)
    return [tuple(e) for e in flat[flat.sum(axis=1) <= degree].tolist()]


_TRIANGLE = [(0, 0), (1, 0), (0, 1)]
_SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]
_CORNERS = {
    "tri": _TRIANGLE,
    "quad": _SQUARE,
    "tet": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
    "penta": [(*p, z) for z in (0, 1) for p in _TRIANGLE],
    "hex": [(*p, z) for z in (0, 1) for p in _SQUARE],
}


def _space(kind: str) -> list[tuple[int, ...]]:
    linear = kind in ("tri3", "quad4", "tet4", "penta6", "hex8")
    degree = 1 if linear else 2
    if kind.startswith("tri"):
        return _simplex_exponents(2, degree)
    if kind.startswith("tet"):
        return _simplex_exponents(3, degree)
    if kind == "penta18":
        return [(*e, z) for e in _simplex_exponents(2, 2) for z in range(3)]
    if kind.startswith("penta"):
        space = [(*e, z) for e in _simplex_exponents(2, degree) for z in (0, 1)]
        return space if linear else space + [(*e, 2) for e in _simplex_exponents(2, 1)]
    cube = product(range(3), repeat=2 if kind.startswith("quad") else 3)
    # serendipity: at most one square (superlinear degree 2)
    return [e for e in cube if sum(2 if x == 2 else 0 for x in e) <= (0 if linear else 2)]


@cache
def reference(kind: str) -> ReferenceElement:
    """The reference element of a kind ("tri3" ... "hex20", or gmsh's "penta18", see `MIDDLES`)."""
    corners = np.array(_CORNERS[kind.rstrip("0123456789")], dtype=float)
    exponents = np.array(_space(kind))
    nodes = corners
    if len(exponents) > len(corners):
        groups = [*EDGES.get(kind, _WEDGE_EDGES), *MIDDLES.get(kind, ())]
        middles = np.array([corners[list(group)].mean(axis=0) for group in groups])
        nodes = np.concatenate([corners, middles])
    # the coefficients are small integers: rounding makes the shape functions exact
    coefficients = np.round(np.linalg.inv(_monomials(exponents, nodes)))
    return ReferenceElement(kind, len(corners), nodes, exponents, coefficients)


def shape_functions(kind: str, points: np.ndarray) -> np.ndarray:
    """Values of the n shape functions at reference points.

    Parameters
    ----------
    kind : str
    points : (m, dim) array

    Returns
    -------
    (m, n) array
    """
    element = reference(kind)
    return _monomials(element.exponents, np.asarray(points, dtype=float)) @ element.coefficients


def shape_gradients(kind: str, points: np.ndarray) -> np.ndarray:
    """Derivatives of the shape functions with respect to the reference coordinates.

    Returns
    -------
    (m, n, dim) array
    """
    element = reference(kind)
    points = np.asarray(points, dtype=float)
    parts = []
    for axis in range(element.dimension):
        lowered = element.exponents.copy()
        factor = lowered[:, axis].astype(float)
        lowered[:, axis] = np.maximum(lowered[:, axis] - 1, 0)
        parts.append((_monomials(lowered, points) * factor) @ element.coefficients)
    return np.stack(parts, axis=2)


def jacobians(kind: str, coordinates: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Jacobian matrices dx/dxi of many elements at the same reference points.

    Parameters
    ----------
    kind : str
    coordinates : (ne, n, 3) array
        Node coordinates, mm.
    points : (m, dim) array

    Returns
    -------
    (ne, m, 3, dim) array
    """
    gradients = shape_gradients(kind, points)
    return np.einsum("enc,mnd->emcd", coordinates, gradients, optimize=True)


def gauss_line(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre rule on [0, 1], exact to degree 2n - 1."""
    x, w = np.polynomial.legendre.leggauss(n)
    return 0.5 * (x + 1.0), 0.5 * w


def quadrature(shape: str, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss rules with n points a direction; in simplices collapsed, with positive weights.

    Parameters
    ----------
    shape : {"tri", "quad", "tet", "penta", "hex"}
    n : int
        Exact to degree 2n - 2 in a triangle, 2n - 3 in a tet, 2n - 1 along a line.

    Returns
    -------
    points : (m, dim) array
    weights : (m,) array
        They add up to the volume of the reference element.
    """
    x, w = gauss_line(n)
    if shape == "hex":
        points = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
        return points, np.einsum("i,j,k->ijk", w, w, w).ravel()
    r, s = (a.ravel() for a in np.meshgrid(x, x, indexing="ij"))
    if shape == "quad":
        return np.column_stack([r, s]), np.outer(w, w).ravel()
    triangle = np.column_stack([r, s * (1.0 - r)])
    triangle_weights = np.outer(w, w).ravel() * (1.0 - r)
    if shape == "tri":
        return triangle, triangle_weights
    if shape == "penta":
        points = np.column_stack([np.repeat(triangle, n, axis=0), np.tile(x, len(triangle))])
        return points, np.outer(triangle_weights, w).ravel()
    if shape == "tet":
        height = np.repeat(x, len(triangle))
        base = np.tile(triangle, (n, 1)) * (1.0 - height)[:, None]
        weights = np.outer(w * (1.0 - x) ** 2, triangle_weights).ravel()
        return np.column_stack([base, height]), weights
    raise ValueError(f"no quadrature for {shape!r}")
