# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bernstein coefficients of the Jacobian determinant, with a proved bound of their rounding errors.

Polynomial element of degree (p, q, r)
    det J = p q r det[A, B, C], where A, B, C have the differences of neighbouring control points in
    the three directions as Bernstein coefficients. det J has degree (3p-1, 3q-1, 3r-1).
Rational element
    With H = (w, w x, w y, w z), det J = D4 / w^4 and D4 = det[H, H_u, H_v, H_w], so both have one
    sign where w > 0. D4 has degree (4p-2, 4q-2, 4r-2).

Rounding errors. eps = 2^-53, gamma(k) = k eps / (1 - k eps); a product of k factors (1 + d_i) with
|d_i| <= eps differs from 1 by at most gamma(k), whatever the order of the sums (Higham, Accuracy
and Stability of Numerical Algorithms, section 3.1; fused operations only help).

* Control points and weights are exact inputs. A difference of two of them is the exact one times
  (1 + d), so a translation of the element does no harm: nothing is computed from positions but
  x - c in rational elements (c any float; again one rounding), and D4 does not depend on c.
* Homogeneous differences are taken as w_1 (x_1 - x_0) + (w_1 - w_0) (x_0 - c): at most 4 roundings
  in each summand, so the error of an entry is at most gamma(4) h with
  h = max w max|x_1 - x_0| + max|w_1 - w_0| max|x - c|, per coordinate, over the element.
* h_k is a vector of such bounds for column k, entry by entry, and M = perm[h_1, h_2, ...] (the
  determinant with plus signs only). All monomials of the determinant together are at most M at
  every point and in every Bernstein coefficient, for both are weighted means of products of
  coefficients (for coefficients by Vandermonde's identity). If every monomial carries at most k
  roundings, the error is at most gamma(k) M.
* Scaling by powers of two is exact and keeps the figures near 1; what underflow can do
  is below 1e-250, which is added to each bound.

Two routes:
sampling
    Values at N = degree + 1 Lobatto nodes per direction, then the inverse of the Bernstein matrix.
    Each value carries k_s roundings: in each column the input, 4 for the table entries and
    n1 + n2 n3 for the sums of products; then 5 (3x3) or 10 (4x4) for the determinant. The inverse
    (rounded from exact fractions) adds N + 2 a direction. Rows of |B^-1| sum to at most L_d, so
    |error| <= L_1 L_2 L_3 gamma(k_s + sum(N + 2)) M.
    L = 184 for degree 8, hence 1e-7 M for tricubic elements, and 0.04 M where p = q = r = 5: fast,
    a proof wherever the coefficients exceed it, but L grows by 4 a degree.
products
    Products of Bernstein polynomials with coefficients times binomials (Farouki and Rajan 1988):
    sums of products of the inputs, no inverse, |error| <= gamma(k) M, k the length of the sums.
    3e-14 M for tricubic elements. Rational elements: D4 = det[H0, H_u, H_v, H_w] by 2x2 minors
    with H = H0 + u H_u / p, which leaves degree (4p-2, 4q-1, 4r-1).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import permutations
from math import comb

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

EPSILON = 2.0**-53
UNDERFLOW = 1e-250

# Roundings that the entries of the nets carry.
_POLYNOMIAL_INPUT = 1
_RATIONAL_INPUT = 4

# Pairs (i, j) of a 2x2 minor a_i b_j - a_j b_i: the cross product, and the six minors of two
# columns of four entries with their complements (Laplace expansion).
_CROSS = ((1, 2), (2, 0), (0, 1))
_MINORS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
_COMPLEMENTS = ((2, 3), (3, 1), (1, 2), (0, 3), (2, 0), (0, 1))


def gamma(k: int) -> float:
    """Bound of |prod (1 + d_i) - 1| for k roundings, itself rounded upwards."""
    return k * EPSILON / (1.0 - k * EPSILON) * (1.0 + 4.0 * EPSILON)


@dataclass(frozen=True)
class DeterminantNets:
    """Columns of the determinant as Bernstein nets, scaled by powers of two.

    Attributes
    ----------
    degrees : (int, int, int)
    columns : tuple of (., ., ., c, ne) arrays
        Three columns of c = 3 entries (polynomial) or four of c = 4 (rational: H first).
    magnitude : (ne,) array
        M of the module's text: bounds the determinant and all its Bernstein coefficients.
    weight_range : (2, ne) array
        Smallest and largest weight of the element, scaled as the columns.
    edges : (ne,) array
        Product over the directions of the mean length of the control polygons' legs, scaled as the
        columns; det J over the mean edge product is the determinant over ``edges`` (over w^4 too).
    """

    degrees: tuple[int, int, int]
    columns: tuple[np.ndarray, ...]
    magnitude: np.ndarray
    weight_range: np.ndarray
    edges: np.ndarray

    @property
    def rational(self) -> bool:
        """Whether the columns are homogeneous."""
        return len(self.columns) == 4


def _permanent(bounds: list[np.ndarray]) -> np.ndarray:
    """Determinant with plus signs only, of columns (c, ne) that are >= 0; rounded upwards."""
    total = np.zeros(bounds[0].shape[1])
    for order in permutations(range(len(bounds))):
        product = bounds[0][order[0]]
        for column, entry in zip(bounds[1:], order[1:], strict=True):
            product = product * column[entry]
        total += product
    return total * (1.0 + 2.0**-40)


def _exponents(largest: np.ndarray) -> np.ndarray:
    """Exponents e with largest in [2^(e-1), 2^e); 0 where largest is 0."""
    return np.where(largest > 0.0, np.frexp(largest)[1], 0).astype(np.int32)


def determinant_nets(
    control_points: np.ndarray, weights: np.ndarray | None = None
) -> DeterminantNets:
    """Columns of det J (polynomial) or of D4 (rational) for a batch of Bézier elements.

    Parameters
    ----------
    control_points : (ne, p+1, q+1, r+1, 3) array
        Finite, p, q, r >= 1.
    weights : (ne, p+1, q+1, r+1) array or None
        Finite and positive; None for polynomial elements.

    Returns
    -------
    DeterminantNets
    """
    points = np.ascontiguousarray(np.moveaxis(control_points, 0, -1), dtype=float)
    degrees = tuple(n - 1 for n in points.shape[:3])
    differences = [np.diff(points, axis=d) for d in range(3)]
    size = np.max([np.abs(a).max(axis=(0, 1, 2, 3)) for a in differences], axis=0)
    shift = -_exponents(size)
    differences = [np.ldexp(a, shift) for a in differences]
    edges = np.ones(points.shape[-1])
    for a in differences:
        edges = edges * np.sqrt(np.einsum("ijkcn,ijkcn->ijkn", a, a)).mean(axis=(0, 1, 2))
    bounds = [np.abs(a).max(axis=(0, 1, 2)) for a in differences]
    if weights is None:
        ones = np.ones((2, points.shape[-1]))
        return DeterminantNets(degrees, tuple(differences), _permanent(bounds), ones, edges)

    w = np.ascontiguousarray(np.moveaxis(weights, 0, -1), dtype=float)
    w = np.ldexp(w, -_exponents(w.max(axis=(0, 1, 2))))[..., None, :]
    centre = 0.5 * points.min(axis=(0, 1, 2)) + 0.5 * points.max(axis=(0, 1, 2))
    points = np.ldexp(points - centre, shift)
    reach, heaviest = np.abs(points).max(axis=(0, 1, 2)), w.max(axis=(0, 1, 2))
    columns = [np.concatenate([w, w * points], axis=3)]
    homogeneous = [np.concatenate([heaviest, heaviest * reach])]
    for d, (a, bound) in enumerate(zip(differences, bounds, strict=True)):
        first, last = (np.take(w, range(s, w.shape[d] - 1 + s), axis=d) for s in (0, 1))
        start = np.take(points, range(w.shape[d] - 1), axis=d)
        growth = last - first
        largest = np.abs(growth).max(axis=(0, 1, 2))
        columns.append(np.concatenate([growth, last * a + growth * start], axis=3))
        homogeneous.append(np.concatenate([largest, heaviest * bound + largest * reach]))
    weight_range = np.stack([w.min(axis=(0, 1, 2, 3)), w.max(axis=(0, 1, 2, 3))])
    return DeterminantNets(degrees, tuple(columns), _permanent(homogeneous), weight_range, edges)


def _fraction_table(degree: int, nodes: list[Fraction]) -> list[list[Fraction]]:
    return [
        [comb(degree, i) * x**i * (1 - x) ** (degree - i) for i in range(degree + 1)] for x in nodes
    ]


@lru_cache(maxsize=64)
def _lobatto(degree: int) -> tuple[Fraction, ...]:
    """degree + 1 Chebyshev-Lobatto nodes of [0, 1], moved to multiples of 1/1024."""
    x = (1.0 - np.cos(np.pi * np.arange(degree + 1) / degree)) / 2.0
    return tuple(Fraction(round(1024 * value), 1024) for value in x)


def lobatto_nodes(degree: int) -> np.ndarray:
    """The nodes that go with :func:`lobatto_inverse`, (degree + 1,)."""
    return np.array(_lobatto(degree), dtype=float)


@lru_cache(maxsize=64)
def _table(total: int, degree: int) -> np.ndarray:
    """Bernstein polynomials of a degree at the Lobatto nodes of degree ``total``, one rounding."""
    return np.array(_fraction_table(degree, list(_lobatto(total))), dtype=float)


@lru_cache(maxsize=64)
def _plane_table(totals: tuple[int, int], degrees: tuple[int, int]) -> np.ndarray:
    return np.kron(_table(totals[0], degrees[0]), _table(totals[1], degrees[1]))


@lru_cache(maxsize=64)
def _inverse_table(degree: int) -> tuple[np.ndarray, float]:
    """Inverse of the square Bernstein matrix at the Lobatto nodes, exact but for one rounding.

    Returns
    -------
    inverse : (degree + 1, degree + 1) array
    norm : float
        Largest absolute row sum, rounded upwards.
    """
    n = degree + 1
    rows = [
        [*row, *(Fraction(int(i == j)) for j in range(n))]
        for i, row in enumerate(_fraction_table(degree, list(_lobatto(degree))))
    ]
    for i in range(n):
        pivot = next(k for k in range(i, n) if rows[k][i] != 0)
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in range(n):
            if k != i and rows[k][i] != 0:
                factor = rows[k][i]
                rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    inverse = [row[n:] for row in rows]
    norm = float(max(sum(abs(value) for value in row) for row in inverse))
    return np.array(inverse, dtype=float), norm * (1.0 + 4.0 * EPSILON)


def lobatto_inverse(degree: int) -> tuple[np.ndarray, float]:
    """Matrix from values at :func:`lobatto_nodes` to Bernstein coefficients, and its norm."""
    return _inverse_table(degree)


def _sample(column: np.ndarray, totals: tuple[int, int, int]) -> np.ndarray:
    """Values (c, N1, N2 N3, ne) of a net (., ., ., c, ne) at the Lobatto nodes of ``totals``."""
    n1, n2, n3, entries, count = column.shape
    first = _table(totals[0], n1 - 1) @ column.reshape(n1, -1)
    first = first.reshape(totals[0] + 1, n2 * n3, entries * count)
    return np.matmul(_plane_table(totals[1:], (n2 - 1, n3 - 1)), first)


def _determinant(columns: list[np.ndarray]) -> np.ndarray:
    """Determinant of columns given as (c, ...) sequences of arrays."""
    if len(columns) == 3:
        a, b, c = columns
        total = b[1] * c[2] - b[2] * c[1]
        total *= a[0]
        for i, (j, k) in ((1, (2, 0)), (2, (0, 1))):
            minor = b[j] * c[k]
            minor -= b[k] * c[j]
            minor *= a[i]
            total += minor
        return total
    a, b, c, d = columns
    total = np.zeros_like(a[0])
    for (i, j), (k, m) in zip(_MINORS, _COMPLEMENTS, strict=True):
        left = a[i] * b[j]
        left -= a[j] * b[i]
        right = c[k] * d[m]
        right -= c[m] * d[k]
        left *= right
        total += left
    return total


def _sampled_degrees(degrees: tuple[int, int, int], rational: bool) -> tuple[int, int, int]:
    return tuple(4 * p - 2 if rational else 3 * p - 1 for p in degrees)


def coefficients_by_sampling(nets: DeterminantNets) -> tuple[np.ndarray, np.ndarray]:
    """Bernstein coefficients of the determinant by values at nodes and an inverse: the fast filter.

    Parameters
    ----------
    nets : DeterminantNets

    Returns
    -------
    coefficients : (N1, N2, N3, ne) array
        Degree N - 1 = 3p - 1 per direction, or 4p - 2 for rational elements.
    bound : (ne,) array
        No coefficient is wrong by more.
    """
    totals = _sampled_degrees(nets.degrees, nets.rational)
    shape = tuple(n + 1 for n in totals)
    count = nets.columns[0].shape[-1]
    entries = len(nets.columns)
    sampled = [
        _sample(a, totals).reshape(shape[0], shape[1] * shape[2], entries, count)
        for a in nets.columns
    ]
    values = _determinant([np.moveaxis(a, 2, 0) for a in sampled])
    inverses = [_inverse_table(n)[0] for n in totals]
    values = (inverses[0] @ values.reshape(shape[0], -1)).reshape(shape[0], shape[1], -1)
    values = np.matmul(inverses[1], values).reshape(shape[0] * shape[1], shape[2], -1)
    values = np.matmul(inverses[2], values).reshape(*shape, count)
    factor = sampling_error(nets.degrees, nets.rational)
    return values, factor * nets.magnitude + UNDERFLOW


def sampling_error(degrees: tuple[int, int, int], rational: bool) -> float:
    """Error bound of :func:`coefficients_by_sampling` as a multiple of the nets' magnitude."""
    totals = _sampled_degrees(degrees, rational)
    roundings = (10 if rational else 5) + sum(n + 3 for n in totals)
    norm = 1.0
    for n in totals:
        norm *= _inverse_table(n)[1]
    sizes = [[p + (d != k) for d, p in enumerate(degrees)] for k in range(3)]
    if rational:
        sizes.append([p + 1 for p in degrees])
    for n1, n2, n3 in sizes:
        roundings += (_RATIONAL_INPUT if rational else _POLYNOMIAL_INPUT) + 4 + n1 + n2 * n3
    return norm * gamma(roundings) * (1.0 + 1e-12)


@lru_cache(maxsize=64)
def _binomials(degrees: tuple[int, int, int]) -> np.ndarray:
    """Products of the binomials of three directions, (., ., ., 1), at most one rounding each."""
    rows = [[comb(n, i) for i in range(n + 1)] for n in degrees]
    exact = [[[a * b * c for c in rows[2]] for b in rows[1]] for a in rows[0]]
    return np.array(exact, dtype=float)[..., None]


def _wedge(a: np.ndarray, b: np.ndarray, pairs: tuple[tuple[int, int], ...]) -> np.ndarray:
    """Convolution of 2x2 minors a_i b_j - a_j b_i; a, b of shapes (., ., ., c, ne)."""
    shape = tuple(m + n - 1 for m, n in zip(a.shape[:3], b.shape[:3], strict=True))
    out = np.zeros((*shape, len(pairs), a.shape[-1]))
    left, right = [i for i, _ in pairs], [j for _, j in pairs]
    b_left, b_right = (np.ascontiguousarray(b[..., k, :]) for k in (left, right))
    for i, j, k in np.ndindex(a.shape[:3]):
        part = out[i : i + b.shape[0], j : j + b.shape[1], k : k + b.shape[2]]
        product = a[i, j, k, left] * b_right
        product -= a[i, j, k, right] * b_left
        part += product
    return out


def _inner(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Convolution of the inner products sum_c a_c b_c; a, b of shapes (., ., ., c, ne).

    One matrix product for each pair of the first two indices of a: the third direction is a
    Toeplitz matrix, whose zeros add no rounding.
    """
    if a[..., 0, 0].size > b[..., 0, 0].size:
        a, b = b, a
    (a1, a2, a3, entries, count), (b1, b2, b3) = a.shape, b.shape[:3]
    n3 = a3 + b3 - 1
    padded = np.zeros((a1, a2, count, entries, a3 + 2 * b3 - 2))
    padded[..., b3 - 1 : b3 - 1 + a3] = a.transpose(0, 1, 4, 3, 2)
    shifted = sliding_window_view(padded, n3, axis=-1)[..., ::-1, :]
    rows = np.ascontiguousarray(b.transpose(4, 0, 1, 3, 2)).reshape(count, b1 * b2, entries * b3)
    out = np.zeros((count, a1 + b1 - 1, a2 + b2 - 1, n3))
    for i, j in np.ndindex(a1, a2):
        product = rows @ shifted[i, j].reshape(count, entries * b3, n3)
        out[:, i : i + b1, j : j + b2] += product.reshape(count, b1, b2, n3)
    return np.ascontiguousarray(np.moveaxis(out, 0, -1))


def _terms(a: np.ndarray, b: np.ndarray) -> int:
    """Largest number of products that meet in one coefficient of a convolution of two nets."""
    return int(np.prod([min(m, n) for m, n in zip(a.shape[:3], b.shape[:3], strict=True)]))


def coefficients_by_products(nets: DeterminantNets) -> tuple[np.ndarray, np.ndarray]:
    """Bernstein coefficients of the determinant by Bernstein products: accurate, any degree.

    Parameters
    ----------
    nets : DeterminantNets

    Returns
    -------
    coefficients : (N1, N2, N3, ne) array
        Degree N - 1 = 3p - 1 per direction; 4p - 2, 4q - 1, 4r - 1 for rational elements.
    bound : (ne,) array
        No coefficient is wrong by more.
    """
    columns = list(nets.columns)
    if nets.rational:
        columns[0] = columns[0][:-1]
    columns = [a * _binomials(tuple(n - 1 for n in a.shape[:3]))[..., None] for a in columns]
    # Input, binomial (at most 1 + 1) per factor; the final division by binomials the same again.
    carried = _RATIONAL_INPUT if nets.rational else _POLYNOMIAL_INPUT
    roundings = len(columns) * (carried + 2) + 2
    if nets.rational:
        first = _wedge(columns[0], columns[1], _MINORS)
        second = _wedge(columns[2], columns[3], _COMPLEMENTS)
        roundings += 1 + 2 * _terms(columns[0], columns[1])
    else:
        first = columns[0]
        second = _wedge(columns[1], columns[2], _CROSS)
    roundings += 1 + 2 * _terms(columns[-2], columns[-1])
    roundings += 1 + first.shape[3] * _terms(first, second)
    values = _inner(first, second)
    values /= _binomials(tuple(n - 1 for n in values.shape[:3]))
    return values, gamma(roundings) * nets.magnitude * (1.0 + 1e-12) + UNDERFLOW


def halving_matrix(degree: int) -> np.ndarray:
    """De Casteljau at 1/2: coefficients of both halves below each other, exact entries."""
    return _halves(degree)


@lru_cache(maxsize=64)
def _halves(degree: int) -> np.ndarray:
    """De Casteljau at 1/2, both halves: (2 (degree + 1), degree + 1), entries exact (dyadic)."""
    n = degree + 1
    left = np.zeros((n, n))
    for i in range(n):
        left[i, : i + 1] = [comb(i, k) / 2.0**i for k in range(i + 1)]
    return np.concatenate([left, left[::-1, ::-1]])


def subdivide(coefficients: np.ndarray, bound: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Halve boxes in all three directions.

    Coefficients of the halves are weighted means (sums of N products a direction, exact weights),
    so errors do not grow but by the roundings: bound + gamma(N1 + N2 + N3) max|coefficient|.

    Parameters
    ----------
    coefficients : (N1, N2, N3, nb) array
    bound : (nb,) array

    Returns
    -------
    coefficients : (2, N1, 2, N2, 2, N3, nb) array
    bound : (nb,) array
        For each of the eight children of a box.
    """
    n1, n2, n3, count = coefficients.shape
    grown = bound + gamma(n1 + n2 + n3) * np.abs(coefficients).max(axis=(0, 1, 2))
    out = _halves(n1 - 1) @ coefficients.reshape(n1, -1)
    out = np.matmul(_halves(n2 - 1), out.reshape(2 * n1, n2, n3 * count))
    out = np.matmul(_halves(n3 - 1), out.reshape(4 * n1 * n2, n3, count))
    return out.reshape(2, n1, 2, n2, 2, n3, count), grown * (1.0 + 1e-12) + UNDERFLOW
