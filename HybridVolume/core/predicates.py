# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Orientation predicates: fast with an error bound, exact where that is not enough.

All work on arrays of points whose coordinates are floats, taken as exact numbers. A determinant of
differences, evaluated as written here, carries at most 8 roundings in each of its products, so its
error is below 10 eps (eps = 2^-53) times the sum of the absolute products (Shewchuk, Discrete
Comput. Geom. 18, 1997, has 7 eps for the same formula with another order of the sums). Where the
value is not larger, the sign is taken from integers.
"""

from __future__ import annotations

import numpy as np

_ERROR = 10.0 * 2.0**-53
# Far below anything the products of coordinates near 1 can be; covers underflow.
_TINY = 1e-280


def certain_sign(value: np.ndarray, magnitude: np.ndarray) -> np.ndarray:
    """Sign of a determinant where its error cannot change it, else 0.

    Parameters
    ----------
    value, magnitude : arrays of one shape
        Determinant and the same sum with absolute products.

    Returns
    -------
    int8 array
        1, -1, or 0 for "not certain".
    """
    bound = _ERROR * magnitude + _TINY
    return (value > bound).astype(np.int8) - (value < -bound).astype(np.int8)


def cross_product(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cross products of vectors (3, m), and the same sums with absolute products.

    Returns
    -------
    value, magnitude : (3, m) arrays
    """
    value, magnitude = np.empty_like(a), np.empty_like(a)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        first, second = a[j] * b[k], a[k] * b[j]
        np.subtract(first, second, out=value[i])
        np.add(np.abs(first, out=first), np.abs(second, out=second), out=magnitude[i])
    return value, magnitude


def dot_sign(cross: tuple[np.ndarray, np.ndarray], a: np.ndarray) -> np.ndarray:
    """Certain sign (0: not certain) of vectors a (3, m) on cross products with their magnitudes."""
    value, magnitude = cross
    total = value[0] * a[0]
    total += value[1] * a[1]
    total += value[2] * a[2]
    size = magnitude[0] * np.abs(a[0])
    size += magnitude[1] * np.abs(a[1])
    size += magnitude[2] * np.abs(a[2])
    return certain_sign(total, size)


def integers(*points: np.ndarray) -> list[np.ndarray]:
    """Points as exact Python integers, all multiplied by one power of two.

    Parameters
    ----------
    *points : float arrays
        Finite.

    Returns
    -------
    list of object arrays of the same shapes
    """
    split = [np.frexp(np.asarray(a, dtype=float)) for a in points]
    used = [e[m != 0.0] for m, e in split]
    lowest = min((int(e.min()) for e in used if e.size), default=0)
    out = []
    for mantissa, exponent in split:
        whole = (mantissa * 2.0**53).astype(np.int64).astype(object)
        shift = np.where(mantissa != 0.0, exponent - lowest, 0).astype(object)
        out.append(np.left_shift(whole, shift))
    return out


def _sign(values: np.ndarray) -> np.ndarray:
    return (values > 0).astype(np.int8) - (values < 0).astype(np.int8)


def orientation_3d(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Exact sign of det[b - a, c - a, d - a]: 1 where d is on the side of (b-a) x (c-a).

    Parameters
    ----------
    a, b, c, d : (m, 3) arrays

    Returns
    -------
    (m,) int8 array
    """
    base = a.T
    sign = dot_sign(cross_product(b.T - base, c.T - base), d.T - base)
    doubtful = np.flatnonzero(sign == 0)
    if len(doubtful):
        a, b, c, d = integers(a[doubtful], b[doubtful], c[doubtful], d[doubtful])
        u, v, w = ((x - a).T for x in (b, c, d))
        sign[doubtful] = _sign(
            (u[1] * v[2] - u[2] * v[1]) * w[0]
            + (u[2] * v[0] - u[0] * v[2]) * w[1]
            + (u[0] * v[1] - u[1] * v[0]) * w[2]
        )
    return sign


def orientation_2d(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Exact sign of det[b - a, c - a]: 1 where a, b, c turn left.

    Parameters
    ----------
    a, b, c : (m, 2) arrays

    Returns
    -------
    (m,) int8 array
    """
    first = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1])
    second = (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    sign = certain_sign(first - second, np.abs(first) + np.abs(second))
    doubtful = np.flatnonzero(sign == 0)
    if len(doubtful):
        a, b, c = integers(a[doubtful], b[doubtful], c[doubtful])
        u, v = (b - a).T, (c - a).T
        sign[doubtful] = _sign(u[0] * v[1] - u[1] * v[0])
    return sign
