# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Proved positivity, volume and quality of curved tets, wedges and hexahedra.

The determinant of a curved element is a polynomial. In Bernstein form its coefficients bound it
from below, so that positive coefficients prove the element valid at every point: 20 coefficients
of degree 3 for tet10, 15 x 6 of degree (4, 5) for penta15, whose derivatives along the triangle
are of degree (1, 2) and along the line of degree (2, 1). Elements that the coefficients do not
decide are subdivided (Johnen, Remacle and Geuzaine 2013). Hexahedra are those of `hex_jacobians`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations
from math import comb, factorial

import numpy as np

from .elements import jacobians, reference, shape_functions
from .hex_jacobians import hexahedron_quality, hexahedron_volumes, prove_hexahedra

VALID, UNDECIDED, INVALID = 1, 0, -1
"""Answers of the proof; undecided counts as not proved."""

_CHUNK = 4096
_UNIT_ROUNDOFF = 2.0**-53


@dataclass(frozen=True)
class _Form:
    """Bernstein polynomials of a degree on a simplex times those of a degree on [0, 1]."""

    dimension: int
    degree: int
    line: int

    @property
    def indices(self) -> list[tuple[tuple[int, ...], int]]:
        return [(a, k) for a in _multi_indices(self.dimension, self.degree) for k in self.steps]

    @property
    def steps(self) -> range:
        return range(self.line + 1)

    @property
    def corners(self) -> list[int]:
        """Positions of the coefficients that are values at the corners."""
        return [
            i
            for i, (a, k) in enumerate(self.indices)
            if max(a) == self.degree and k in (0, self.line)
        ]

    def __add__(self, other: _Form) -> _Form:
        return _Form(self.dimension, self.degree + other.degree, self.line + other.line)


@cache
def _multi_indices(dimension: int, degree: int) -> tuple[tuple[int, ...], ...]:
    if dimension == 0:
        return ((degree,),)
    return tuple(
        (first, *rest)
        for first in range(degree, -1, -1)
        for rest in _multi_indices(dimension - 1, degree - first)
    )


def _multinomial(index: tuple[int, ...]) -> float:
    value = factorial(sum(index))
    for i in index:
        value //= factorial(i)
    return float(value)


def _values(form: _Form, points: np.ndarray) -> np.ndarray:
    """Bernstein polynomials of a form at reference points, (m, n)."""
    simplex = points[:, : form.dimension]
    bary = np.column_stack([1.0 - simplex.sum(axis=1), simplex])
    z = points[:, form.dimension] if form.line else np.zeros(len(points))
    columns = [
        _multinomial(a)
        * np.prod(bary ** np.array(a), axis=1)
        * (comb(form.line, k) * z**k * (1.0 - z) ** (form.line - k))
        for a, k in form.indices
    ]
    return np.column_stack(columns)


def _lattice(form: _Form) -> np.ndarray:
    simplex = np.array([a[1:] for a, _ in form.indices]) / max(form.degree, 1)
    if not form.line:
        return simplex
    return np.column_stack([simplex, [k / form.line for _, k in form.indices]])


def _simplex_derivative(form: _Form, axis: int) -> tuple[np.ndarray, _Form]:
    lower = _Form(form.dimension, form.degree - 1, form.line)
    position = {index: i for i, index in enumerate(form.indices)}
    matrix = np.zeros((len(lower.indices), len(position)))
    for row, (a, k) in enumerate(lower.indices):
        for corner, sign in ((axis + 1, 1.0), (0, -1.0)):
            raised = tuple(x + (i == corner) for i, x in enumerate(a))
            matrix[row, position[raised, k]] += sign * form.degree
    return matrix, lower


def _line_derivative(form: _Form) -> tuple[np.ndarray, _Form]:
    lower = _Form(form.dimension, form.degree, form.line - 1)
    position = {index: i for i, index in enumerate(form.indices)}
    matrix = np.zeros((len(lower.indices), len(position)))
    for row, (a, k) in enumerate(lower.indices):
        matrix[row, position[a, k + 1]] += form.line
        matrix[row, position[a, k]] -= form.line
    return matrix, lower


def _product(first: _Form, second: _Form) -> np.ndarray:
    """Matrix from all products of two coefficients to the coefficients of the product."""
    result = first + second
    position = {index: i for i, index in enumerate(result.indices)}
    matrix = np.zeros((len(position), len(first.indices) * len(second.indices)))
    column = 0
    for a, k in first.indices:
        for b, m in second.indices:
            total = tuple(x + y for x, y in zip(a, b, strict=True))
            share = _multinomial(a) * _multinomial(b) / _multinomial(total)
            share *= comb(first.line, k) * comb(second.line, m) / comb(result.line, k + m)
            matrix[position[total, k + m], column] = share
            column += 1
    return matrix


def _restriction(form: _Form, vertices: np.ndarray, upper: bool | None) -> np.ndarray:
    """Coefficients on a part: a sub-simplex by its barycentric vertices, one half of the line."""
    simplex = _multi_indices(form.dimension, form.degree)
    position = {a: i for i, a in enumerate(simplex)}
    on_simplex = np.zeros((len(simplex), len(simplex)))
    for row, a in enumerate(simplex):
        terms = {(0,) * (form.dimension + 1): 1.0}
        for vertex, times in zip(vertices, a, strict=True):
            for _ in range(times):
                grown: dict[tuple[int, ...], float] = {}
                for index, value in terms.items():
                    for corner in np.flatnonzero(vertex):
                        raised = tuple(x + (i == corner) for i, x in enumerate(index))
                        grown[raised] = grown.get(raised, 0.0) + value * vertex[corner]
                terms = grown
        for index, value in terms.items():
            on_simplex[row, position[index]] = value
    on_line = np.eye(form.line + 1)
    if upper is not None:
        on_line = np.zeros_like(on_line)
        for i in form.steps:
            for j in range(i + 1):
                on_line[i, j] = comb(i, j) / 2.0**i
        if upper:
            on_line = on_line[::-1, ::-1]
    return np.kron(on_simplex, on_line)


def _children(form: _Form) -> list[np.ndarray]:
    """Restrictions to the eight parts that an element is cut into."""
    corners = np.eye(form.dimension + 1)
    mid = {
        pair: 0.5 * (corners[pair[0]] + corners[pair[1]])
        for pair in combinations(range(form.dimension + 1), 2)
    }

    def between(i: int, j: int) -> np.ndarray:
        return corners[i] if i == j else mid[min(i, j), max(i, j)]

    size = range(form.dimension + 1)
    parts = [np.array([between(i, j) for j in size]) for i in size]
    if form.dimension == 2:
        parts.append(np.array([mid[0, 1], mid[1, 2], mid[0, 2]]))
        return [_restriction(form, p, upper) for p in parts for upper in (False, True)]
    ring = [mid[0, 1], mid[1, 2], mid[2, 3], mid[0, 3]]
    parts += [np.array([mid[0, 2], mid[1, 3], ring[i], ring[(i + 1) % 4]]) for i in range(4)]
    return [_restriction(form, p, None) for p in parts]


@dataclass(frozen=True, eq=False)
class _Determinant:
    """Tables that take node coordinates of one kind of element to the coefficients of det J."""

    form: _Form
    derivatives: tuple[np.ndarray, np.ndarray, np.ndarray]
    cross: np.ndarray
    dot: np.ndarray
    children: list[np.ndarray]


@cache
def _determinant(kind: str) -> _Determinant:
    if not kind.startswith(("tet", "penta")):
        raise ValueError(f"there is no Bernstein form of det J for {kind}")
    degree = 1 if kind in ("tet4", "penta6") else 2
    wedge = kind.startswith("penta")
    form = _Form(2, degree, degree) if wedge else _Form(3, degree, 0)
    lattice = _lattice(form)
    to_bernstein = np.linalg.solve(_values(form, lattice), shape_functions(kind, lattice))
    # entries are multiples of a quarter: rounding makes them exact
    to_bernstein = np.round(16.0 * to_bernstein) / 16.0
    parts = [_simplex_derivative(form, axis) for axis in range(form.dimension)]
    if wedge:
        parts.append(_line_derivative(form))
    (a, fa), (b, fb), (c, fc) = parts
    total = fa + fb + fc
    return _Determinant(
        total,
        (a @ to_bernstein, b @ to_bernstein, c @ to_bernstein),
        _product(fa, fb),
        _product(fa + fb, fc),
        _children(total),
    )


def bernstein_coefficients(kind: str, coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bernstein coefficients of det J of each element and a bound of their rounding errors.

    Parameters
    ----------
    kind : {"tet4", "tet10", "penta6", "penta15", "penta18"}
    coordinates : (ne, n, 3) array
        Node coordinates, mm.

    Returns
    -------
    coefficients : (ne, nc) array
        mm^3; nc is 1, 20, 9 or 90 (both quadratic wedges).
    rounding : (ne,) array
        No coefficient is farther from its exact value, mm^3.
    """
    table = _determinant(kind)
    coordinates = np.asarray(coordinates, dtype=float)
    coefficients = np.empty((len(coordinates), len(table.form.indices)))
    rounding = np.empty(len(coordinates))
    for start in range(0, len(coordinates), _CHUNK):
        part = slice(start, start + _CHUNK)
        # from the first node on: rounding is then relative to the element, not to its place
        local = coordinates[part] - coordinates[part, :1]
        length = np.linalg.norm(local, axis=2)
        a, b, c = (np.einsum("in,enc->eic", d, local, optimize=True) for d in table.derivatives)
        cross = np.cross(a[:, :, None, :], b[:, None, :, :]).reshape(len(a), -1, 3)
        cross = np.einsum("ij,ejc->eic", table.cross, cross, optimize=True)
        pairs = np.einsum("eic,ejc->eij", cross, c, optimize=True).reshape(len(a), -1)
        coefficients[part] = pairs @ table.dot.T
        # First order: a derivative is a sum of at most 18 terms; then come sums of at most 81 and
        # 360 products with positive weights of sum 1.
        size = [np.linalg.norm(d, axis=2).max(axis=1) for d in (a, b, c)]
        terms = [(length @ np.abs(d).T).max(axis=1) for d in table.derivatives]
        share = 512.0 * size[0] * size[1] * size[2]
        for i, j, k in ((0, 1, 2), (1, 0, 2), (2, 0, 1)):
            share += 64.0 * terms[i] * size[j] * size[k]
        rounding[part] = _UNIT_ROUNDOFF * share
    return coefficients, rounding


@dataclass(frozen=True)
class JacobianProof:
    """What was proved about det J of a batch of elements.

    Attributes
    ----------
    status : (ne,) int array
        VALID (det J > 0 everywhere), INVALID (negative somewhere) or UNDECIDED.
    lower_bound : (ne,) array
        det J is nowhere smaller, mm^3; rounding is accounted for.
    """

    status: np.ndarray
    lower_bound: np.ndarray

    @property
    def proved(self) -> np.ndarray:
        """(ne,) bool array: elements with det J > 0 proved everywhere."""
        return self.status == VALID


def prove_positive(kind: str, coordinates: np.ndarray, depth: int = 5) -> JacobianProof:
    """Prove det J > 0 in every element, by Bernstein coefficients and subdivision.

    Parameters
    ----------
    kind : {"tet4", "tet10", "penta6", "penta15", "penta18", "hex20"}
    coordinates : (ne, n, 3) array
        Node coordinates, mm.
    depth : int
        How often an element that is not decided is cut into eight.
    """
    if kind == "hex20":
        return JacobianProof(*prove_hexahedra(coordinates))
    table = _determinant(kind)
    corners = table.form.corners
    coefficients, rounding = bernstein_coefficients(kind, coordinates)
    rounding = rounding * (1.0 + depth / 8.0)
    top = coefficients.min(axis=1) - rounding
    status = np.where(top > 0.0, VALID, UNDECIDED)
    owner = np.flatnonzero(status == UNDECIDED)
    parts = coefficients[owner]
    least = top[owner]
    lower = top.copy()
    lower[owner] = np.inf
    for level in range(depth + 1):
        negative = parts[:, corners].min(axis=1, initial=np.inf) < -rounding[owner]
        status[owner[negative]] = INVALID
        settled = least > 0.0
        np.minimum.at(lower, owner[settled], least[settled])
        open_ = ~settled & (status[owner] == UNDECIDED)
        owner, parts, least = owner[open_], parts[open_], least[open_]
        if level == depth or not len(owner):
            break
        parts = np.stack([parts @ child.T for child in table.children], axis=1)
        parts = parts.reshape(-1, coefficients.shape[1])
        owner = np.repeat(owner, len(table.children))
        least = parts.min(axis=1) - rounding[owner]
    np.minimum.at(lower, owner, least)
    done = status == UNDECIDED
    done[owner] = False
    status[done] = VALID
    return JacobianProof(status, np.where(status == INVALID, top, lower))


def volumes(kind: str, coordinates: np.ndarray) -> np.ndarray:
    """Signed volume of each element, exact (mean of the Bernstein coefficients), (ne,), mm^3."""
    if kind == "hex20":
        return hexahedron_volumes(coordinates)
    coefficients, _ = bernstein_coefficients(kind, coordinates)
    return coefficients.mean(axis=1) / (2.0 if kind.startswith("penta") else 6.0)


def relative_bound(kind: str, coordinates: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """A bound of det J relative to the mean edge product of each element, (ne,)."""
    corners = reference(kind).corners
    points = np.asarray(coordinates)[:, :corners]
    if kind.startswith("penta"):
        around = points[:, [0, 1, 2, 3, 4, 5]] - points[:, [1, 2, 0, 4, 5, 3]]
        upward = points[:, 3:6] - points[:, :3]
        size = _mean_length(around) ** 2 * _mean_length(upward)
    elif kind == "hex20":
        size = np.ones(len(points))
        for start, end in (([0, 3, 4, 7], [1, 2, 5, 6]), ([0, 1, 4, 5], [3, 2, 7, 6]),
                           ([0, 1, 2, 3], [4, 5, 6, 7])):  # fmt: skip
            size *= _mean_length(points[:, end] - points[:, start])
    else:
        pairs = np.array(list(combinations(range(4), 2)))
        size = _mean_length(points[:, pairs[:, 0]] - points[:, pairs[:, 1]]) ** 3
    return bound / size


def _mean_length(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors, axis=2).mean(axis=1)


@cache
def bernstein_lattice(kind: str, density: int) -> np.ndarray:
    """Reference points of an even lattice, ``density + 1`` along an edge, (m, 3)."""
    wedge = kind.startswith("penta")
    return _lattice(_Form(2, density, density) if wedge else _Form(3, density, 0))


def tet_quality(corners: np.ndarray) -> np.ndarray:
    """Scaled Jacobian of straight tets, as of :func:`scaled_jacobian`, (...).

    Parameters
    ----------
    corners : (..., 4, 3) array
    """
    x = [corners[..., k, :] for k in range(4)]
    a, b, c = x[1] - x[0], x[2] - x[0], x[3] - x[0]
    det = (
        a[..., 0] * (b[..., 1] * c[..., 2] - b[..., 2] * c[..., 1])
        - a[..., 1] * (b[..., 0] * c[..., 2] - b[..., 2] * c[..., 0])
        + a[..., 2] * (b[..., 0] * c[..., 1] - b[..., 1] * c[..., 0])
    )
    ab, ac, bc = b - a, c - a, c - b
    la, lb, lc, lab, lac, lbc = (np.einsum("...i,...i->...", v, v) for v in (a, b, c, ab, ac, bc))
    size = np.maximum(
        np.maximum(la * lb * lc, la * lab * lac), np.maximum(lb * lab * lbc, lc * lac * lbc)
    )
    return np.sqrt(2.0) * det / np.sqrt(np.maximum(size, np.finfo(float).tiny))


def scaled_jacobian(
    kind: str, coordinates: np.ndarray, points: np.ndarray | None = None
) -> np.ndarray:
    """Smallest scaled Jacobian of each element over a lattice of points, (ne,).

    At a point it is det J over the product of the three longest edge derivatives of one corner,
    scaled so that a regular tet and a regular wedge have 1 and a flat one 0.

    Parameters
    ----------
    kind : {"tet4", "tet10", "penta6", "penta15", "penta18", "hex20"}
    coordinates : (ne, n, 3) array
    points : (m, 3) array, optional
        Reference points; by default a lattice with 5 points along an edge (6 in hexahedra, where
        they cannot be chosen).
    """
    if kind == "hex20":
        return hexahedron_quality(coordinates)
    if kind == "tet4":
        return tet_quality(np.asarray(coordinates, dtype=float))
    if points is None:
        points = bernstein_lattice(kind, 1 if kind == "penta6" else 4)
    wedge = kind.startswith("penta")
    coordinates = np.asarray(coordinates, dtype=float)
    result = np.empty(len(coordinates))
    step = max(1, 200_000 // len(points))
    for start in range(0, len(coordinates), step):
        part = slice(start, start + step)
        j = jacobians(kind, coordinates[part], points)
        a, b, c = j[..., 0], j[..., 1], j[..., 2]
        det = np.einsum("emc,emc->em", np.cross(a, b), c)
        la, lb, lab = (np.linalg.norm(x, axis=2) for x in (a, b, a - b))
        if wedge:
            longest = np.maximum(np.maximum(la * lb, la * lab), lb * lab)
            size = longest * np.linalg.norm(c, axis=2) / (2.0 / np.sqrt(3.0))
        else:
            lc, lac, lbc = (np.linalg.norm(x, axis=2) for x in (c, a - c, b - c))
            corners = np.stack([la * lb * lc, la * lab * lac, lb * lab * lbc, lc * lac * lbc])
            size = corners.max(axis=0) / np.sqrt(2.0)
        result[part] = (det / np.maximum(size, np.finfo(float).tiny)).min(axis=1)
    return result
