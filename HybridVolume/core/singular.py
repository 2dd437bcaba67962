# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The normal of every knot span as a polynomial, and the places where it vanishes.

s_u x s_v of a Bézier patch is a polynomial of degree (2p - 1, 2q - 1). For a rational patch x = A/w

    w^3 (x_u x x_v) = w A_u x A_v - w_v A_u x A - w_u A x A_v

is one, of degree (3p - 2, 3q - 2), since the highest powers cancel. Its Bernstein coefficients
bound the normal everywhere in the span, between samples as well.

Where a corner of a patch has 180 degrees, or a control point is doubled, the normal is zero: there
det J = (s_u x s_v) . x_w of any shell is zero too. Nothing can be done about it without another
parametrisation, but such places are corners or sides of knot spans, and everywhere else det J can
be positive.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import comb
from typing import TYPE_CHECKING

import numpy as np

from .bezier import bernstein
from .jacobian import gamma, lobatto_inverse, lobatto_nodes

if TYPE_CHECKING:
    from .surface import ElementGroup, PatchSurface

VANISHING = 1e-9
"""Share of a span's largest normal coefficient below which a normal is zero."""
SAMPLED = 1e-9
"""Share of its magnitude to which a normal must be known if it is interpolated from values."""
BESIDE = 0.96
"""Places beside singular ones are drawn to the middle of the span by this factor."""


@dataclass(frozen=True)
class NormalNets:
    """Bernstein coefficients of the outward normals (times weight³) of a group's knot spans.

    Attributes
    ----------
    group : ElementGroup
    coefficients : (ne, n1, n2, 3) array
        Per unit of the span's own parameters, mm².
    error : (ne,) array
        No coefficient is wrong by more, mm².
    """

    group: ElementGroup
    coefficients: np.ndarray
    error: np.ndarray


def normal_nets(surface: PatchSurface) -> list[NormalNets]:
    """Normals of all knot spans as polynomials, one set a degree pair and kind.

    Rational and polynomial spans of one degree pair come apart: their normals have other degrees.
    """
    nets = []
    for group in surface.groups:
        flat = group.weights.reshape(len(group.element), -1)
        rational = np.ptp(flat, axis=1) > 0.0
        for chosen, is_rational in ((~rational, False), (rational, True)):
            if chosen.any():
                names = ("element", "patch", "index", "weights", "extraction_u", "extraction_v")
                part = {name: getattr(group, name)[chosen] for name in (*names, "low", "high")}
                part = replace(group, **part)
                nets.append(_nets(surface.control_points, part, is_rational))
    return nets


def _nets(control_points: np.ndarray, group: ElementGroup, rational: bool) -> NormalNets:
    points = control_points[group.index]
    # from the middle of the span on: rounding is then relative to the span, not to its place
    points = points - 0.5 * (
        points.min(axis=(1, 2), keepdims=True) + points.max(axis=(1, 2), keepdims=True)
    )
    p, q = group.degrees
    if rational:
        # at most 1: they do not add to the magnitude
        weights = group.weights / group.weights.max(axis=(1, 2), keepdims=True)
        net = group.bezier(np.concatenate([points * weights[..., None], weights[..., None]], -1))
        totals = (3 * p - 2, 3 * q - 2)
    else:
        net = group.bezier(points)
        totals = (2 * p - 1, 2 * q - 1)
    # sums of absolute values: sum |B_i'| <= 2 p, sum |B_i| = 1
    reach = np.abs(net[..., :3]).max(axis=(1, 2, 3))
    magnitude = (6.0 if rational else 2.0) * (2 * p * reach) * (2 * q * reach)
    # extraction twice, sums over p + 1 and q + 1 terms with rounded tables, in two or three factors
    roundings = 3 * (3 * (p + 1) + 3 * (q + 1) + 12) + sum(n + 3 for n in totals) + 12
    inverses = [lobatto_inverse(n) for n in totals]
    factor = inverses[0][1] * inverses[1][1] * gamma(roundings)
    if factor > SAMPLED:
        roundings += 2 * (p + 1) * (q + 1) + 3 * (p + q)
        return NormalNets(group, _by_products(net, rational), gamma(roundings) * magnitude)
    nodes = [lobatto_nodes(n) for n in totals]
    values, slopes = (
        [bernstein(d, x, k) for d, x in zip((p, q), nodes, strict=True)] for k in (0, 1)
    )

    def at(left: np.ndarray, right: np.ndarray) -> np.ndarray:
        half = np.einsum("ai,eijc->eajc", left, net)
        return np.einsum("bj,eajc->eabc", right, half)

    a_u, a_v = at(slopes[0], values[1]), at(values[0], slopes[1])
    if rational:
        a = at(values[0], values[1])
        w, w_u, w_v = (x[..., 3:] for x in (a, a_u, a_v))
        a, a_u, a_v = (x[..., :3] for x in (a, a_u, a_v))
        normals = w * np.cross(a_u, a_v) - w_v * np.cross(a_u, a) - w_u * np.cross(a, a_v)
    else:
        normals = np.cross(a_u, a_v)
    half = np.einsum("ai,eijc->eajc", inverses[0][0], normals)
    coefficients = np.einsum("bj,eajc->eabc", inverses[1][0], half)
    return NormalNets(group, coefficients, factor * magnitude)


def _by_products(net: np.ndarray, rational: bool) -> np.ndarray:
    """Coefficients of normals as sums of products of those of the span.

    No values are interpolated, so high degrees lose nothing: every coefficient is a mean of
    products. Rational ones come out a degree higher than they are.
    """
    u, v = (np.diff(net, axis=axis) * (net.shape[axis] - 1) for axis in (1, 2))
    if not rational:
        return _product(u, v, np.cross)
    a, w = net[..., :3], net[..., 3:]
    (a_u, w_u), (a_v, w_v) = ((x[..., :3], x[..., 3:]) for x in (u, v))
    return (
        _product(w, _product(a_u, a_v, np.cross), np.multiply)
        - _product(w_v, _product(a_u, a, np.cross), np.multiply)
        - _product(w_u, _product(a, a_v, np.cross), np.multiply)
    )


def _product(a: np.ndarray, b: np.ndarray, of: Callable) -> np.ndarray:
    """Bernstein coefficients (ne, ., ., 3) of a product of polynomials on the square."""
    shape = [m + n - 1 for m, n in zip(a.shape[1:3], b.shape[1:3], strict=True)]
    a, b = a * _binomials(a.shape[1:3]), b * _binomials(b.shape[1:3])
    found = np.zeros((len(a), *shape, 3))
    for i, j in np.ndindex(a.shape[1:3]):
        found[:, i : i + b.shape[1], j : j + b.shape[2]] += of(a[:, i : i + 1, j : j + 1], b)
    return found / _binomials(shape)


def _binomials(shape: Sequence[int]) -> np.ndarray:
    """Products of the binomials of two directions, (n1, n2, 1)."""
    rows = [np.array([comb(n - 1, i) for i in range(n)], dtype=float) for n in shape]
    return np.multiply.outer(*rows)[..., None]


def singular_flags(nets: NormalNets) -> np.ndarray:
    """Corners and sides of knot spans along which the normal is zero.

    Returns
    -------
    (ne, 3, 3) bool array
        Entry [i, j] is about u = 0, between, 1 (i = 0, 1, 2) and v likewise: [0, 2] is the corner
        (0, 1), [0, 1] the side u = 0 as a whole. [1, 1] is never set.
    """
    c = nets.coefficients
    size = np.abs(c).max(axis=3)
    largest = size.max(axis=(1, 2))
    # coefficients on sides are those of the side alone: their errors are far below the bound
    zero = size <= VANISHING * largest[:, None, None]
    flags = np.zeros((len(c), 3, 3), dtype=bool)
    ends = (0, -1)
    for i, row in zip((0, 2), ends, strict=True):
        flags[:, i, 1] = zero[:, row].all(axis=1)
        flags[:, 1, i] = zero[:, :, row].all(axis=1)
        for j, column in zip((0, 2), ends, strict=True):
            flags[:, i, j] = zero[:, row, column]
    return flags


def surface_flags(surface: PatchSurface) -> np.ndarray:
    """:func:`singular_flags` of all knot spans, in the order of the element numbers."""
    flags = np.zeros((surface.element_count, 3, 3), dtype=bool)
    for nets in normal_nets(surface):
        flags[nets.group.element] = singular_flags(nets)
    return flags


def vanishing_normals(s_u: np.ndarray, s_v: np.ndarray, count: int) -> np.ndarray:
    """Samples at which the surface's normal is zero, (m,) bool.

    Parameters
    ----------
    s_u, s_v : (m, 3) arrays
        Derivatives at samples, ``count`` of each knot span in a row.
    count : int
    """
    size = np.linalg.norm(np.cross(s_u, s_v), axis=1).reshape(-1, count)
    largest = size.max(axis=1, keepdims=True)
    return (size <= VANISHING * largest).ravel()


def beside_singular(
    surface: PatchSurface,
    uv: np.ndarray,
    elements: np.ndarray,
    s_u: np.ndarray,
    s_v: np.ndarray,
    vanishing: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives at samples, those where the normal is zero taken a little inside of the span.

    Parameters
    ----------
    surface : PatchSurface
    uv : (m,) array
        Sample lines of the elements in both directions.
    elements : (ne,) int array
    s_u, s_v : (ne * m * m, 3) arrays
    vanishing : (ne * m * m,) bool array

    Returns
    -------
    s_u, s_v : arrays of the same shape
        The replaced ones are as long as those of their span in the mean.
    """
    count = len(uv) ** 2
    rows = np.flatnonzero(vanishing.reshape(-1, count).any(axis=1))
    near = surface.element_samples(0.5 + BESIDE * (uv - 0.5), 0.5 + BESIDE * (uv - 0.5),
                                   elements[rows])  # fmt: skip
    _, *found = near.surface(surface.control_points)
    mask = vanishing.reshape(-1, count)[rows]
    result = []
    for given, moved in zip((s_u, s_v), found, strict=True):
        typical = np.linalg.norm(given.reshape(-1, count, 3)[rows], axis=2).mean(axis=1)
        length = np.linalg.norm(moved, axis=1, keepdims=True)
        moved = moved / np.maximum(length, 1e-300) * np.repeat(typical, count)[:, None]
        out = given.copy().reshape(-1, count, 3)
        part = out[rows]
        part[mask] = moved.reshape(-1, count, 3)[mask]
        out[rows] = part
        result.append(out.reshape(-1, 3))
    return result[0], result[1]


def normals_around(surface: PatchSurface, patch: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Inward normals a little beside parameter pairs, on all four sides, (4, m, 3).

    For places where the normal itself is zero; outside of the patch the nearest pair inside stands.
    """
    steps = [0.5 * (1.0 - BESIDE) * np.diff(np.unique(k)).min() for k in
             surface.patches[patch].knots]  # fmt: skip
    found = []
    for i, j in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
        # at the rim of the patch one must leave the other rim as well: a corner has two
        a, b = _reflected(u + i * steps[0]), _reflected(v + j * steps[1])
        _, x_u, x_v = surface.evaluate(patch, a, b, 1)
        found.append(-np.cross(x_u, x_v))
    return np.array(found)


def _reflected(x: np.ndarray) -> np.ndarray:
    """Values in [0, 1]; what is outside comes back as far inside."""
    return 1.0 - np.abs(1.0 - np.abs(x))


def class_indices(count: int) -> np.ndarray:
    """0 for the first, 2 for the last, 1 for all others of ``count`` indices."""
    classes = np.ones(count, dtype=int)
    classes[0], classes[-1] = 0, 2
    return classes


def without_excused(
    coefficients: np.ndarray, bound: np.ndarray, excused: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients with zeros at excused places, and the most that this changed a polynomial.

    With coefficients of at least c elsewhere the true polynomial is at least c (1 - B) - slack B,
    where B <= 1 is the sum of the excused Bernstein polynomials: it is positive but where B is
    above c / (c + slack), which only happens next to these places.
    """
    mask = excused_mask(coefficients.shape, excused)
    face = coefficients[:, :, 0]
    slack = np.where(mask, np.abs(face), 0.0).max(axis=(0, 1)) + bound
    coefficients = coefficients.copy()
    coefficients[:, :, 0] = np.where(mask, 0.0, face)
    return coefficients, slack


def excused_mask(shape: tuple[int, ...], flags: np.ndarray) -> np.ndarray:
    """Which of (n1, n2, ...) coefficients of boxes stand at flagged places, (n1, n2, nb)."""
    return flags[class_indices(shape[0])][:, class_indices(shape[1])]


def watched_coefficients(coefficients: np.ndarray, flags: np.ndarray | None) -> np.ndarray:
    """Coefficients with those at excused places out of the way."""
    if flags is None or not flags.any():
        return coefficients
    watched = coefficients.copy()
    watched[:, :, 0][excused_mask(coefficients.shape, flags)] = np.inf
    return watched


HALF_CLASSES = np.array([[0, 1, 1], [1, 1, 2]])
"""What the first, inner and last indices of the lower and the upper half are in the whole."""
