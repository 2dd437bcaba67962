# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The certificate of det J > 0: known determinants, dense sampling, interval arithmetic."""

import time

import numpy as np
import pytest
from scipy.optimize import minimize

from HybridVolume.core.bezier import BezierElements, bernstein
from HybridVolume.core.validity import (
    INVALID,
    UNDECIDED,
    VALID,
    certify,
    decide,
    scaled_jacobian,
    worst_points,
)
from HybridVolume.errors import FaultError


def batch(points, weights=None, first=0):
    points = np.asarray(points, dtype=float)
    degrees = tuple(n - 1 for n in points.shape[1:4])
    number = np.arange(first, first + len(points))
    return BezierElements(degrees, points, weights, number, number % 3)


def cube(degrees):
    axes = (np.linspace(0.0, 1.0, p + 1) for p in degrees)
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def perturbed(rng, count, degrees, amplitude):
    net = cube(degrees)
    return net + rng.uniform(-1, 1, (count, *net.shape)) * amplitude / np.array(degrees)


def jacobian(points, weights, parameters):
    """det J of one element at parameters (m, 3), by the quotient rule; nothing from the package."""
    w = np.ones(points.shape[:3]) if weights is None else weights
    net = np.concatenate([points * w[..., None], w[..., None]], axis=-1)

    def evaluate(orders):
        a = [
            bernstein(n - 1, x, k)
            for n, x, k in zip(points.shape[:3], parameters.T, orders, strict=True)
        ]
        return np.einsum("mi,mj,mk,ijkc->mc", *a, net)

    value = evaluate((0, 0, 0))
    x = value[:, :3] / value[:, 3:]
    rows = []
    for orders in np.eye(3, dtype=int):
        derivative = evaluate(orders)
        rows.append((derivative[:, :3] - x * derivative[:, 3:]) / value[:, 3:])
    return np.linalg.det(np.stack(rows, axis=-1))


def dense(points, weights=None, count=13):
    grid = (1 - np.cos(np.pi * np.arange(count) / (count - 1))) / 2
    parameters = np.stack(np.meshgrid(grid, grid, grid, indexing="ij"), axis=-1).reshape(-1, 3)
    values = jacobian(points, weights, parameters)
    return values.min(), parameters[values.argmin()]


# ---- elements with a known determinant --------------------------------------------------------


@pytest.mark.parametrize(
    "degrees", [(1, 1, 1), (2, 2, 2), (3, 3, 3), (3, 1, 3), (1, 4, 2), (5, 5, 5), (2, 7, 1)]
)
@pytest.mark.parametrize("rational", [False, True])
def test_boxes_are_valid_with_figure_one(degrees, rational):
    points = cube(degrees)[None] * np.array([3.0, 0.02, 700.0])
    # Equal weights: polynomial path. det J is constant, so every coefficient is.
    weights = np.full(points.shape[:-1], 0.3) if rational else None
    result = certify([batch(points, weights)])
    assert result.all_valid
    assert result.depth == 0
    assert result.min_bernstein[0] == pytest.approx(1.0, rel=0.04)
    assert result.min_bernstein[0] <= 1.0
    assert scaled_jacobian([batch(points, weights)]) == pytest.approx(1.0, abs=1e-13)


def edge_product(net):
    """Product over the directions of the mean length of the control polygons."""
    return np.prod(
        [
            np.linalg.norm(np.diff(net, axis=d), axis=-1).mean() * (net.shape[d] - 1)
            for d in range(3)
        ]
    )


def twisted(angle):
    """Trilinear: the unit square turned by an angle from w = 0 to w = 1.

    det J = (1-w)^2 + 2 w (1-w) cos(angle) + w^2, at least (1 + cos(angle)) / 2.
    """
    net = cube((1, 1, 1)) - [0.5, 0.5, 0.0]
    c, s = np.cos(angle), np.sin(angle)
    net[:, :, 1, :2] = net[:, :, 1, :2] @ np.array([[c, s], [-s, c]])
    return net


def test_twisted_hexahedron():
    angles = np.array([0.3, 1.2, np.pi / 2, 2.4, 2.9, 3.05, 3.1])
    result = certify([batch([twisted(a) for a in angles])])
    assert result.all_valid
    legs = np.sqrt(1 + 2 * np.sin(angles / 2) ** 2)
    least = (1 + np.cos(angles)) / 2 / legs
    assert np.all(result.min_bernstein <= least)
    # The bound sharpens only as far as the proof needs; where it needs most, it is close.
    assert result.min_bernstein[0] > 0.9 * least[0]
    scaled, where = worst_points([batch([twisted(2.9)])], points=7)
    assert where[0, 2] == 0.5
    # |x_u| = |x_v| = sqrt(det) at w = 1/2, |x_w| longest in the corners.
    assert scaled[0] == pytest.approx(1 / np.sqrt(1 + 2 * np.sin(1.45) ** 2), rel=1e-12)


def test_zero_determinant_is_never_valid():
    half_turn = twisted(np.pi)  # det J = (1 - 2 w)^2, up to the rounding of sin(pi)
    wedge = cube((2, 2, 2))
    wedge[0, :, :, 1] = 0.0  # the face u = 0 has become an edge
    pole = cube((3, 3, 3))
    pole[0, :, :] = pole[0, 0, 0]  # ... a point
    flat = cube((3, 3, 3)) * [1.0, 1.0, 0.0]
    nothing = cube((1, 1, 1)) * 0.0
    for net in (half_turn, wedge, pole, flat, nothing):
        result = certify([batch([net])])
        assert result.valid == 0
        assert not result.all_valid
        assert result.min_bernstein[0] <= 0.0
    assert certify([batch([wedge])]).undecided == 1


def test_elements_inverted_on_purpose():
    corner = cube((3, 3, 3))
    corner[0, 0, 0] = [0.9, 0.9, 0.9]
    mirrored = cube((2, 2, 2))[::-1]
    bump = cube((3, 3, 3))
    bump[1:3, 1:3, 2, 2] -= 2.0  # folds inside, all eight corners stay right
    corners = jacobian(bump, None, np.array(list(np.ndindex(2, 2, 2)), dtype=float))
    assert corners.min() > 0
    for net in (corner, mirrored, bump):
        result = certify([batch([net])])
        assert result.invalid == 1
        assert result.min_bernstein[0] <= dense(net)[0] / edge_product(net) < 0
    mild = cube((3, 3, 3))
    mild[1:3, 1:3, 2, 2] -= 0.2
    assert certify([batch([mild])]).all_valid


def test_weights_decide():
    net = cube((2, 2, 2))
    net[1, 1, 1] = [0.5, 0.5, -0.4]  # folds once its weight is large enough
    weights = np.ones((4, 3, 3, 3))
    weights[:, 1, 1, 1] = [1.0, 0.5, 40.0, -0.5]
    weights[0] = 2.0
    result = certify([batch([net] * 4, weights)])
    for k, status in enumerate(result.status[:3]):
        assert status == (VALID if dense(net, weights[k])[0] > 0 else INVALID)
    assert result.status.tolist()[2:] == [INVALID, INVALID]
    assert VALID in result.status
    assert result.min_bernstein[3] == -np.inf
    broken = cube((2, 2, 2))
    broken[1, 0, 2, 1] = np.nan
    assert certify([batch([broken, cube((2, 2, 2))])]).status.tolist() == [INVALID, VALID]


def test_quarter_ring_rational():
    # Exact quarter of a tube, radii 1 and 2, height 1, (u, v, w) = (z, angle, -r): det J is
    # r angle'(v), and angle' runs from sqrt 2 at the ends to 4 (sqrt 2 - 1) in the middle.
    arc = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    net = np.zeros((2, 3, 2, 3))
    for k, radius in enumerate((2.0, 1.0)):
        net[:, :, k, :2] = radius * arc
    net[1, :, :, 2] = 1.0
    weights = np.ones((2, 3, 2))
    weights[:, 1] = np.sqrt(0.5)
    assert dense(net, weights)[0] == pytest.approx(np.sqrt(2), rel=1e-12)
    result = certify([batch([net], weights[None])])
    assert result.all_valid
    least = np.sqrt(2) / edge_product(net)
    assert 0.25 * least < result.min_bernstein[0] <= least
    assert scaled_jacobian([batch([net], weights[None])])[0] == pytest.approx(1.0, abs=1e-12)
    # The inner radius passes the axis: det J changes sign inside.
    net[:, :, 1, :2] *= -0.1
    assert certify([batch([net], weights[None])]).invalid == 1


# ---- random elements against sampling and intervals -------------------------------------------


@pytest.mark.parametrize(
    ("degrees", "rational", "count"),
    [
        ((3, 3, 3), False, 150),
        ((2, 2, 2), False, 150),
        ((3, 1, 3), False, 100),
        ((1, 1, 1), False, 150),
        ((2, 2, 2), True, 80),
        ((3, 3, 3), True, 40),
        ((2, 1, 3), True, 80),
        ((5, 5, 5), False, 25),
        ((5, 2, 4), False, 40),
    ],
)
def test_random_elements_against_sampling(degrees, rational, count):
    rng = np.random.default_rng(11)
    points = perturbed(rng, count, degrees, 0.6) * 0.01
    weights = rng.uniform(0.6, 1.0, points.shape[:-1]) if rational else None
    result = certify([batch(points, weights)])
    assert result.undecided <= 0.02 * count
    assert min(result.valid, result.invalid) >= 0.05 * count
    for k in range(count):
        net, w = points[k], None if weights is None else weights[k]
        least, where = dense(net, w, 9)
        edges = edge_product(net)
        if result.status[k] == VALID:
            assert least / edges >= result.min_bernstein[k] > 0
        elif result.status[k] == INVALID and least > 0:
            found = minimize(
                lambda x, net=net, w=w: jacobian(net, w, x[None])[0] / 1e-6,
                where,
                bounds=[(0, 1)] * 3,
                method="L-BFGS-B",
            )
            assert found.fun < 1e-3 * edges / 1e-6


class Interval:
    """Outward rounded intervals on arrays."""

    def __init__(self, low, high):
        self.low, self.high = low, high

    def __add__(self, other):
        return Interval(
            np.nextafter(self.low + other.low, -np.inf),
            np.nextafter(self.high + other.high, np.inf),
        )

    def __neg__(self):
        return Interval(-self.high, -self.low)

    def __mul__(self, other):
        p = [a * b for a in (self.low, self.high) for b in (other.low, other.high)]
        return Interval(
            np.nextafter(np.min(p, axis=0), -np.inf), np.nextafter(np.max(p, axis=0), np.inf)
        )


def interval_jacobian(net, boxes, size):
    """Range of det J over boxes (m, 3) + [0, size]^3 of a quadratic element, by intervals."""
    zero = Interval(np.zeros(len(boxes)), np.zeros(len(boxes)))
    one = Interval(zero.low + 1, zero.low + 1)
    t = [Interval(boxes[:, d], boxes[:, d] + size) for d in range(3)]
    s = [one + -a for a in t]
    linear = [list(pair) for pair in zip(s, t, strict=True)]
    two = Interval(zero.low + 2, zero.low + 2)
    quadratic = [[a * a, two * (a * b), b * b] for a, b in linear]
    columns = []
    for d in range(3):
        difference = np.diff(net, axis=d)  # dyadic nets: exact
        basis = [linear[k] if k == d else quadratic[k] for k in range(3)]
        column = [zero] * 3
        for i, j, k in np.ndindex(difference.shape[:3]):
            b = basis[0][i] * basis[1][j] * basis[2][k]
            for c in range(3):
                value = Interval(
                    zero.low + difference[i, j, k, c], zero.low + difference[i, j, k, c]
                )
                column[c] = column[c] + b * value
        columns.append(column)
    a, b, c = columns
    total = zero
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        total = total + a[i] * (b[j] * c[k] + -(b[k] * c[j]))
    return total


def test_quadratic_elements_against_interval_arithmetic():
    rng = np.random.default_rng(3)
    size = 1 / 16
    boxes = np.stack(np.meshgrid(*[np.arange(16) * size] * 3, indexing="ij"), -1).reshape(-1, 3)
    nets = np.round(perturbed(rng, 12, (2, 2, 2), 0.35) * 2**20) / 2**20
    result = certify([batch(nets)])
    decided = 0
    for net, status, lower in zip(nets, result.status, result.min_bernstein, strict=True):
        # The interval routine leaves out the factor p q r = 8.
        edges = edge_product(net) / 8
        values = interval_jacobian(net, boxes, size)
        if values.low.min() > 0:
            assert status == VALID
            decided += 1
        if values.high.min() <= 0:
            assert status == INVALID
            decided += 1
        if status == VALID:
            assert 0 < lower <= values.high.min() / edges
    assert decided >= 6


# ---- invariance, bookkeeping, speed -----------------------------------------------------------


def rotation(rng):
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


@pytest.mark.parametrize("rational", [False, True])
def test_invariance(rational):
    rng = np.random.default_rng(8)
    points = perturbed(rng, 60, (3, 3, 3) if not rational else (2, 2, 2), 0.45)
    weights = rng.uniform(0.7, 1.0, points.shape[:-1]) if rational else None
    base = certify([batch(points, weights)])
    assert base.valid > 10
    assert base.invalid > 3
    sure = base.status == VALID
    turned = points @ rotation(rng).T
    for other in (
        points * 1e-3,
        points * 1e3,
        points * 2.0**-300,
        turned,
        points + 1e5,
        turned * 7e-3 + np.array([700.0, -690.0, 13.0]),
    ):
        result = certify([batch(other, weights)])
        assert np.array_equal(result.status, base.status)
        ratio = result.min_bernstein[sure] / base.min_bernstein[sure]
        assert np.all(np.abs(result.min_bernstein - base.min_bernstein)[sure] < 1e-3)
        assert np.median(np.abs(ratio - 1)) < 1e-4
    if rational:
        result = certify([batch(points, weights * 37.0)])
        assert np.array_equal(result.status, base.status)


def test_order_merge_and_faults():
    net = cube((2, 2, 2))
    first = batch([net, net[::-1]], first=5)
    second = batch([cube((3, 3, 3))] * 3, first=1)
    result = certify([first, second])
    assert result.element.tolist() == [1, 2, 3, 5, 6]
    assert result.patch.tolist() == [1, 2, 0, 2, 0]
    assert (result.valid, result.undecided, result.invalid) == (4, 0, 1)
    assert result.failed.tolist() == [6]
    assert not result.all_valid
    scaled = scaled_jacobian([first, second])
    assert scaled == pytest.approx([1, 1, 1, 1, -1])
    repaired = result.merge(certify([batch([net], first=6)]))
    assert repaired.all_valid
    assert len(repaired) == 5
    with pytest.raises(FaultError):
        certify([first, first])
    with pytest.raises(FaultError):
        certify([BezierElements((3, 2, 2), net[None], None, np.arange(1), np.arange(1))])
    assert not certify([]).all_valid


def test_depth_limits_and_work_is_bounded():
    rng = np.random.default_rng(4)
    hard = np.stack([twisted(np.pi - x) for x in rng.uniform(0, 1e-9, 20)])
    start = time.perf_counter()
    result = certify([batch(hard)])
    assert result.undecided + result.invalid == 20
    assert time.perf_counter() - start < 10
    shallow = certify([batch([twisted(3.1)])], max_depth=0)
    assert shallow.status[0] == UNDECIDED
    assert certify([batch([twisted(3.1)])]).status[0] == VALID


def test_unfinished_boxes_are_undecided():
    # (u - 1/3)^2 + 0.01: positive, but only deep boxes show it.
    u = np.array([1 / 9 + 0.01, -2 / 9 + 0.01, 4 / 9 + 0.01])
    coefficients = np.broadcast_to(u[:, None, None, None], (3, 2, 2, 1)).copy()
    for depth, status in ((0, UNDECIDED), (1, UNDECIDED), (6, VALID)):
        found, lower, used = decide(coefficients, np.full(1, 1e-15), max_depth=depth)
        assert found[0] == status
        assert (lower[0] > 0) == (status == VALID)
        assert used <= depth
    assert lower[0] <= 0.01
    coefficients -= 0.02
    assert decide(coefficients, np.full(1, 1e-15), max_depth=6)[0][0] == INVALID


def test_speed():
    rng = np.random.default_rng(0)
    elements = batch(perturbed(rng, 2000, (3, 3, 3), 0.3))
    certify([elements])
    start = time.perf_counter()
    assert certify([elements]).valid > 1000
    # 0.1 s on a quiet core; the limit leaves room for a busy machine.
    assert time.perf_counter() - start < 1.5
