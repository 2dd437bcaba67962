# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bernstein coefficients of det J and their error bounds, against exact fractions."""

from fractions import Fraction
from math import comb

import numpy as np
import pytest

from HybridVolume.core.jacobian import (
    coefficients_by_products,
    coefficients_by_sampling,
    determinant_nets,
    subdivide,
)


def cube(degrees):
    axes = (np.linspace(0.0, 1.0, p + 1) for p in degrees)
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def perturbed(rng, degrees, amplitude):
    net = cube(degrees)
    return (net + rng.uniform(-1, 1, net.shape) * amplitude / np.array(degrees))[None]


def integers(values, bits=110):
    return np.vectorize(lambda x: int(Fraction(float(x)) * 2**bits), otypes=[object])(values)


def convolve(a, b):
    """Product of two object nets in the scaled Bernstein basis."""
    shape = tuple(m + n - 1 for m, n in zip(a.shape, b.shape, strict=True))
    out = np.zeros(shape, dtype=object)
    for i, j, k in np.ndindex(a.shape):
        out[i : i + b.shape[0], j : j + b.shape[1], k : k + b.shape[2]] += a[i, j, k] * b
    return out


def binomials(shape):
    rows = [np.array([comb(n - 1, i) for i in range(n)], dtype=object) for n in shape]
    return rows[0][:, None, None] * rows[1][:, None] * rows[2]


def exact_determinant(points, weights=None):
    """Fractions: Bernstein coefficients of the determinant of the nets scaled as in the package."""
    differences = np.abs(np.concatenate([np.diff(points, axis=d).ravel() for d in range(3)]))
    shift = -np.frexp(differences.max())[1]
    x = integers(np.ldexp(points, shift))
    unit = Fraction(2**110)
    if weights is None:
        columns = [np.diff(x, axis=d) for d in range(3)]
    else:
        w = integers(np.ldexp(weights, -np.frexp(weights.max())[1]))
        h = np.concatenate([w[..., None] * 2**110, w[..., None] * x], axis=-1)
        unit *= 2**110
        columns = [h[:-1], *(np.diff(h, axis=d) for d in range(3))]
    size = len(columns)
    columns = [[a[..., c] * binomials(a.shape[:3]) for c in range(size)] for a in columns]
    # Laplace expansion along the first column, recursively: slow, plain, exact.

    def determinant(nets, rows):
        if len(nets) == 1:
            return nets[0][rows[0]]
        total = 0
        for position, row in enumerate(rows):
            rest = determinant(nets[1:], rows[:position] + rows[position + 1 :])
            total = total + (-1) ** position * convolve(nets[0][row], rest)
        return total

    value = determinant(columns, list(range(size)))
    scale = binomials(value.shape)
    return np.vectorize(lambda a, b: Fraction(int(a), int(b)) / unit**size, otypes=[object])(
        value, scale
    )


def elevate(coefficients, axis):
    """Degree n -> n + 1 in one direction, in fractions."""
    c = np.moveaxis(coefficients, axis, 0)
    n = len(c)
    out = [c[0]]
    out += [Fraction(i, n) * c[i - 1] + Fraction(n - i, n) * c[i] for i in range(1, n)]
    return np.moveaxis(np.stack([*out, c[-1]]), 0, axis)


def as_fractions(values):
    return np.vectorize(lambda x: Fraction(float(x)), otypes=[object])(values)


CASES = [
    ((2, 2, 2), False, 0.0),
    ((3, 3, 3), False, 0.0),
    ((3, 3, 3), False, 1e4),
    ((4, 4, 4), False, 0.0),
    ((3, 1, 2), False, -1e4),
    ((1, 1, 1), True, 0.0),
    ((2, 1, 2), True, 1e4),
    ((2, 2, 2), True, 0.0),
]


@pytest.mark.parametrize(("degrees", "rational", "offset"), CASES)
def test_both_routes_against_exact_fractions(degrees, rational, offset):
    rng = np.random.default_rng(sum(degrees))
    points = perturbed(rng, degrees, 0.4) * np.array([1.0, 0.3, 0.05]) + offset
    weights = rng.uniform(0.4, 1.7, points.shape[:-1]) if rational else None
    nets = determinant_nets(points, weights)
    exact = exact_determinant(points[0], None if weights is None else weights[0])
    for route in (coefficients_by_products, coefficients_by_sampling):
        values, bound = route(nets)
        values = as_fractions(values[..., 0])
        for axis in (1, 2):
            if values.shape[axis] < exact.shape[axis]:
                values = elevate(values, axis)
        error = float(np.abs(values - exact).max())
        assert error <= bound[0]
        assert bound[0] < (1e-12 if route is coefficients_by_products else 1e-4)
    assert max(abs(float(a)) for a in exact.ravel()) <= nets.magnitude[0]


def test_thin_element_far_away_keeps_relative_accuracy():
    # Differences lose nothing far from the origin: error bound and error stay relative to det J.
    points = cube((3, 3, 3))[None] * np.array([1.0, 1.0, 2.0**-20]) + 2.0**14
    nets = determinant_nets(points)
    values, bound = coefficients_by_products(nets)
    exact = exact_determinant(points[0])
    assert np.abs(as_fractions(values[..., 0]) - exact).max() <= bound[0]
    assert bound[0] < 1e-12 * values.min()


def test_halves_against_exact_fractions():
    rng = np.random.default_rng(5)
    coefficients = rng.uniform(-1, 1, (9, 6, 4, 1))
    children, bound = subdivide(coefficients, np.zeros(1))
    exact = as_fractions(coefficients[..., 0])

    def halves(c, axis):
        c = np.moveaxis(c, axis, 0)
        row, left, right = list(c), [c[0]], [c[-1]]
        while len(row) > 1:
            row = [(a + b) / 2 for a, b in zip(row[:-1], row[1:], strict=True)]
            left.append(row[0])
            right.insert(0, row[-1])
        return [np.moveaxis(np.stack(a), 0, axis) for a in (left, right)]

    for a, first in enumerate(halves(exact, 0)):
        for b, second in enumerate(halves(first, 1)):
            for c, third in enumerate(halves(second, 2)):
                error = np.abs(as_fractions(children[a, :, b, :, c, :, 0]) - third).max()
                assert error <= bound[0] < 1e-14
