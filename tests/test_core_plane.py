# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Hybrid bodies in the plane: a ring of NURBS elements, triangles inside."""

import numpy as np
import pytest

from HybridVolume.core.analysis.coupling import NitscheSpace
from HybridVolume.core.analysis.elasticity import solve_elasticity
from HybridVolume.core.analysis.hybrid_space import refined
from HybridVolume.core.analysis.plane import plane_space, triangles_only
from HybridVolume.core.analysis.plane_curve import closed_spline, ellipse, joined
from HybridVolume.core.analysis.plane_mesh import crossing_edges
from HybridVolume.core.analysis.poisson import solve_poisson
from HybridVolume.core.analysis.simplex_space import cut_rule
from HybridVolume.core.bspline import clamped_knots
from HybridVolume.core.recovery import Material
from HybridVolume.errors import GapError, InputError

SLOPE = np.array([0.9, -0.4])
STEEL = Material(210_000.0, 0.3)


def polygon(corners):
    ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return joined([(side, np.ones(2), clamped_knots(1, 1)) for side in ends])


def square(size=1.0, at=(0.0, 0.0)):
    return polygon(size * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) + at)


def clover(size=1.0, at=(0.0, 0.0)):
    turn = np.arange(12) * np.pi / 6
    reach = 1.0 + 0.3 * np.cos(3 * turn)
    points = size * reach[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    return closed_spline(points + at, 3)


def heart(size=1.0, at=(0.0, 0.0)):
    """Rational arcs of two degrees, with a notch and a tip."""
    right = np.array([[0.0, -1.2], [1.6, 0.2], [0.7, 1.6], [0.0, 0.7]])
    left = np.array([[0.0, 0.7], [-1.9, 1.5], [0.0, -1.2]])
    return joined(
        [
            (size * right + at, np.array([1.0, 0.6, 1.3, 1.0]), clamped_knots(3, 1)),
            (size * left + at, np.array([2.0, 1.4, 2.0]), clamped_knots(2, 1)),
        ]
    )


def hook(size=1.0, at=(0.0, 0.0)):
    """A strip bent to a C: it has no middle to scale it to."""
    turn = np.linspace(0.0, 1.6 * np.pi, 9)
    arc = np.column_stack([np.cos(turn), np.sin(turn)])
    return closed_spline(size * np.concatenate([2.0 * arc, arc[::-1]]) + at, 3)


def angle(size=1.0, at=(0.0, 0.0)):
    """An L with sharp corners."""
    corners = np.array([[0, 0], [2, 0], [2, 0.7], [0.7, 0.7], [0.7, 2], [0, 2]])
    return polygon(size * corners + at).elevated(2).refined(2)


CURVES = {
    "disk": (lambda size, at: ellipse((size, size), at), np.pi),
    "ellipse": (lambda size, at: ellipse((3.0 * size, size), at), 3.0 * np.pi),
    "square": (lambda size, at: square(size, at).elevated(2), 1.0),
    "clover": (clover, None),
    "heart": (heart, None),
    "hook": (hook, None),
    "angle": (angle, 2.31),
}
PLACES = [(1.0, (0.0, 0.0)), (1e-3, (7.0, -2.0)), (1e3, (-5e3, 2e4))]


def area_of(both):
    return sum(
        float(block.measure.sum()) for part in (both.spline, both.tets) for block in part.samples(8)
    )


@pytest.mark.parametrize("name", CURVES)
def test_finer_curves_and_curves_of_higher_degree_are_the_same(name):
    make, area = CURVES[name]
    curve = make(1.0, (0.2, 0.1))
    random = np.random.default_rng(1)
    patch, u = random.integers(len(curve.knots), size=100), random.random(100)
    same = [curve.refined(3), curve.refined().refined()]
    same += [] if curve.smooth else [curve.elevated(curve.degree + 2).refined()]
    for other in same:
        assert np.abs(other.evaluate(patch, u) - curve.evaluate(patch, u)).max() < 1e-13
        assert other.area == pytest.approx(curve.area, rel=1e-10)
    if area is not None:
        assert curve.area == pytest.approx(area, rel=1e-8)


@pytest.mark.parametrize(
    ("name", "size", "at"),
    [(name, *place) for name in ("disk", "heart") for place in PLACES]
    + [(name, *PLACES[0]) for name in ("ellipse", "square", "clover", "angle")],
)
def test_linear_fields_cross_the_interface(name, size, at):
    curve = CURVES[name][0](size, at).refined(4)
    both = refined(plane_space(curve, 0.3, 2, degree=2))
    core = both.tets
    moved = both.trace @ both.spline.control_points - core.nodes[core.interface]
    assert np.abs(moved).max() < 1e-12 * (size + np.abs(at).max())
    # quadratic triangles have no gaps to a quadratic curve, and small ones to a cubic one
    assert area_of(both) == pytest.approx(curve.area, rel=1e-9 if curve.degree == 2 else 1e-3)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_linear_solutions_pass_a_flat_interface(degree):
    # arcs of degree 1 are raised to the triangles' degree
    both = plane_space(square().refined(3), 0.4, 2, degree, "nitsche")
    assert isinstance(both, NitscheSpace)
    assert both.spline.degree == degree
    found = solve_poisson(both, lambda x: np.zeros(len(x)), lambda x: x @ SLOPE)
    off = found.errors(lambda x: x @ SLOPE, lambda x: np.broadcast_to(SLOPE, x.shape))
    assert max(off) < 1e-12


@pytest.mark.parametrize("coupling", ["collocation", "nitsche"])
def test_rigid_motions_have_no_energy(coupling):
    # Nitsche's terms see the gaps of a coarse interface: cubic triangles fit a cubic curve
    degree = 2 if coupling == "collocation" else 3
    both = plane_space(heart().refined(4), 0.3, degree=degree, coupling=coupling)
    matrix = both.elasticity(STEEL, STEEL)
    free = both.tets.nodes[both.free_nodes] if coupling == "collocation" else both.tets.nodes
    x, y = np.concatenate([both.spline.control_points, free]).T
    stretch = np.concatenate([x, 0.0 * y])
    scale = stretch @ (matrix @ stretch)
    for motion in ((1.0 + 0.0 * x, 0.0 * x), (0.0 * x, 1.0 + 0.0 * x), (-y, x)):
        field = np.concatenate(motion)
        assert abs(field @ (matrix @ field)) < 1e-12 * scale


def wave(x):
    return np.sin(x @ [2.0, 1.0])


def wave_slope(x):
    return np.cos(x @ [2.0, 1.0])[:, None] * [2.0, 1.0]


RATES = [
    ("disk", 2, 1, "collocation", 1.9, 0.95),
    ("clover", 3, 2, "collocation", 2.8, 1.85),
    ("disk", 2, 2, "nitsche", 2.8, 1.85),
    ("heart", 3, 3, "nitsche", 3.6, 2.7),
    ("hook", 3, 2, "collocation", 2.8, 1.85),
]


@pytest.mark.parametrize(("name", "p", "k", "coupling", "l2", "h1"), RATES)
def test_rates(name, p, k, coupling, l2, h1):
    curve = CURVES[name][0](1.0, (0.0, 0.0))
    both = plane_space(curve if curve.smooth else curve.elevated(p).refined(4), 0.4, 1, k, coupling)
    off = []
    for _ in range(3):
        both = refined(both)
        found = solve_poisson(both, lambda x: 5.0 * wave(x), wave)
        off.append(found.errors(wave, wave_slope))
    assert (np.log2(np.divide(off[1], off[2])) >= (l2, h1)).all()


def test_triangles_alone():
    both = triangles_only(clover(), degree=2)
    off = []
    for _ in range(2):
        both = refined(both)
        found = solve_poisson(both, lambda x: 5.0 * wave(x), wave)
        off.append(found.errors(wave, wave_slope))
    assert (np.log2(np.divide(*off)) >= (2.7, 1.8)).all()
    # linear triangles fill a polygon: its corners are as far apart as was asked
    coarse = triangles_only(ellipse(), size=2.0 * np.pi / 20)
    assert len(coarse.tets.interface) == 20
    assert area_of(coarse) == pytest.approx(10.0 * np.sin(np.pi / 10), rel=1e-8)


def test_a_disk_under_pressure():
    # plane strain: u = -p (1 + nu) (1 - 2 nu) / E x
    both = plane_space(ellipse().refined(3), 0.4, 1, 2)
    shrink = -100.0 * 1.3 * 0.4 / 210_000.0
    found = solve_elasticity(
        both,
        STEEL,
        fixed={"Edge1": lambda x: shrink * x},
        tractions={f"Edge{k}": lambda x, n: -100.0 * n for k in (2, 3, 4)},
    )
    off = found.errors(
        lambda x: shrink * x, lambda x: np.broadcast_to(shrink * np.eye(2), (len(x), 2, 2))
    )
    assert max(off) < 1e-4 * abs(shrink)


def test_what_cannot_be_is_refused():
    with pytest.raises(InputError, match="depth between 0 and 1"):
        plane_space(ellipse(), 1.2)
    with pytest.raises(InputError, match="counterclockwise"):
        joined([(p[::-1], np.ones(2), clamped_knots(1, 1)) for p in _sides()[::-1]])
    with pytest.raises(GapError, match=r"Edge1, Edge2: a gap of 0\.5 mm"):
        joined(
            [
                (p + [0.5 * (k == 0), 0.0], np.ones(2), clamped_knots(1, 1))
                for k, p in enumerate(_sides())
            ]
        )
    with pytest.raises(InputError, match="choose 1, 2 or 3"):
        plane_space(ellipse(), 0.3, degree=4)
    with pytest.raises(InputError, match="edges of nan mm; give a size > 0"):
        triangles_only(ellipse(), np.nan)
    bell = np.array(
        [[-3, -1.0], [-1.8, -1.2], [-1, -0.35], [0, -0.3], [1, -0.35], [1.8, -1.2], [3, -1]]
    )
    with pytest.raises(InputError, match="Edge1: the ring's inner curve crosses itself"):
        plane_space(closed_spline(np.concatenate([bell, -bell]), 3).refined(3), 0.45)
    with pytest.raises(InputError, match="Edge9: no such face"):
        list(plane_space(ellipse(), 0.3).spline.boundary_samples(["Edge9"]))


def _sides():
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return list(np.stack([corners, np.roll(corners, -1, axis=0)], axis=1))


def test_gradients_at_places():
    ring = plane_space(heart().refined(3), 0.3, 2).spline
    random = np.random.default_rng(5)
    patch, u, w = random.integers(2, size=50), random.random((50, 1)), random.random(50)
    gradients = np.stack([part @ ring.control_points for part in ring.gradients_at(patch, u, w)], 1)
    assert np.abs(gradients - np.eye(2)).max() < 1e-12
    field = np.cos(np.arange(ring.size))
    step = 1e-6
    for k, move in enumerate(([step, 0.0], [0.0, step])):
        ends = [(ring.basis_at(patch, u + s * move[0], w + s * move[1])) for s in (-1.0, 1.0)]
        along = (ends[1] - ends[0]) @ np.column_stack([ring.control_points, field])
        slope = sum(
            (part @ field) * along[:, c] for c, part in enumerate(ring.gradients_at(patch, u, w))
        )
        assert np.abs(along[:, 2] - slope).max() < 1e-8, k


def test_edges_over_two_spans():
    # the curve has a knot in the middle of each edge, where the ring's functions are only C²
    both = plane_space(clover().refined(2), 0.4, 2, 3, "nitsche", nodes=0.5)
    off = []
    for _ in range(3):
        off.append(solve_poisson(both, lambda x: 5.0 * wave(x), wave).errors(wave, wave_slope))
        both = refined(both)
    assert (np.log2(np.divide(off[1], off[2])) >= (3.8, 2.8)).all()


@pytest.mark.parametrize(("dimension", "volume"), [(1, 1.0), (2, 0.5)])
def test_cut_rules(dimension, volume):
    at, weight = cut_rule(dimension, 2, 3)
    assert weight.min() > 0.0 and weight.sum() == pytest.approx(volume, rel=1e-14)
    assert at.min() > 0.0 and at.sum(axis=1).max() < 1.0
    # exact for a function that is linear in each part: |3 x - 1| has a kink at a cut
    exact = 5.0 / 6.0 if dimension == 1 else 8.0 / 27.0
    assert np.abs(3.0 * at[:, 0] - 1.0) @ weight == pytest.approx(exact, rel=1e-14)


@pytest.mark.parametrize(("depth", "size", "at"), [(0.15, *PLACES[1]), (0.4, *PLACES[2])])
def test_rings_of_bodies_without_a_middle(depth, size, at):
    # a strip of half width R: the inner curve is at the depth's share of R
    curve = hook(size, at).refined(2)
    ring = plane_space(curve, depth, 2).spline
    assert ring.jacobian_bounds.min() > 0.0
    far = np.linspace(0.15, 0.3, 20)
    there = np.zeros(20, dtype=int)
    outer = curve.evaluate(there, far)
    points = ring.inner_curve.evaluate(np.zeros(4000, dtype=int), np.arange(4000) / 4000)
    gap = np.linalg.norm(outer[:, None] - points, axis=2).min(axis=1)
    whole = curve.evaluate(np.zeros(4000, dtype=int), np.arange(4000) / 4000)
    angle_of = np.arctan2(*(outer - at).T[::-1])
    radius = np.linalg.norm(whole - at, axis=1)
    around = np.arctan2(*(whole - at).T[::-1])
    width = [np.ptp(radius[np.abs(around - a) < 0.02]) for a in angle_of]
    assert np.abs(gap / (0.5 * np.array(width)) - depth).max() < 0.08


def test_crossing_edges():
    square_ = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    assert len(crossing_edges(square_)) == 0
    bow = square_[[0, 1, 3, 2]]
    assert crossing_edges(bow).tolist() == [1, 3]
    # edges on one line do not cross
    assert (
        len(crossing_edges(np.array([[0, 0], [1, 0], [2, 0], [3, 0], [3, 1], [0, 1.0]]) / 3.0)) == 0
    )
