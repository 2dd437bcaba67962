# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Corners at equal parameters, exact sides with knots and weights, planes between them."""

from types import SimpleNamespace

import numpy as np
import pytest

from HybridVolume.core import bspline
from HybridVolume.core.covering.coons import homogeneous_nets
from HybridVolume.core.covering.geometry import SplineCurve
from HybridVolume.core.covering.iso_sides import IsoSides, order_rows
from HybridVolume.core.covering.kinds import border_gaps
from HybridVolume.core.covering.places import edge_chains, spread_places
from HybridVolume.core.covering.quad_mesh import QuadCover
from HybridVolume.core.covering.rims import rims_of


def iso(low, high, ends_low, ends_high):
    """A face with edges ``low`` and ``high`` on opposite sides and edges 90, 91 on the others."""
    edge = np.array([*low, 90, *high, 91])
    side = np.array([2] * len(low) + [1] + [3] * len(high) + [0])
    ends = [*zip(ends_low, ends_low[1:], strict=False), (0, 1)]
    ends += [*zip(ends_high, ends_high[1:], strict=False), (0, 1)]
    order = (np.array(low), np.array([90]), np.array(high), np.array([91]))
    return IsoSides(order, edge, side, np.array(ends, dtype=float), ())


def test_vertices_of_opposite_sides_keep_their_order():
    matrix, low, high = order_rows({0: iso([0, 1], [2, 3], [0, 0.5, 1], [0, 0.6, 1])}, 100)
    # 0.5 comes before 0.6: the first edge has fewer intervals than the one opposite
    for first, second, good in ((1, 2, True), (2, 2, False), (3, 1, False)):
        intervals = np.zeros(100)
        intervals[[0, 2]] = first, second
        sums = matrix @ intervals
        assert bool(np.all((low <= sums) & (sums <= high))) is good


def test_corners_stand_at_the_vertices_opposite():
    face = iso([0, 1], [2, 3], [0, 0.5, 1], [0, 0.6, 1])
    counts = {0: 2, 1: 3, 2: 4, 3: 1, 90: 2, 91: 2}
    even = {edge: np.linspace(0.0, 1.0, n + 1) for edge, n in counts.items()}
    places, kept = spread_places({0: face}, counts, even, np.zeros(1))
    assert kept == {0}
    below = np.concatenate([0.5 * places[0], 0.5 + 0.5 * places[1][1:]])
    above = np.concatenate([0.6 * places[2], 0.6 + 0.4 * places[3][1:]])
    assert below == pytest.approx(above, abs=1e-14)
    assert below[2] == 0.5 and np.any(np.abs(below - 0.6) < 1e-14)
    assert np.diff(below).min() > 0.0


def test_a_face_whose_vertices_cannot_be_opposite_gives_up():
    face = iso([0, 1], [2, 3], [0, 0.5, 1], [0, 0.6, 1])
    counts = {0: 2, 1: 2, 2: 2, 3: 2, 90: 2, 91: 2}
    even = {edge: np.linspace(0.0, 1.0, n + 1) for edge, n in counts.items()}
    assert spread_places({0: face}, counts, even, np.zeros(1))[1] == set()


def arc(weight):
    """A quarter of a circle about the origin, of weights 1, .7 w, w²."""
    points = np.array([[1.0, 0, 0], [1, 1, 0], [0, 1, 0]])
    weights = np.array([1.0, np.sqrt(0.5) * weight, weight**2])
    return SplineCurve(2, np.repeat([0.0, 1.0], 3), points, weights)


def line(a, b):
    return SplineCurve(1, np.repeat([0.0, 1.0], 2), np.array([a, b], dtype=float), np.ones(2))


@pytest.mark.parametrize("weight", [1.0, 2.0])
def test_quads_between_arcs_have_the_arcs_as_sides(weight):
    # a quarter of a ring in two quads; the arcs have a knot inside each side
    outer = arc(weight)
    knots = np.insert(outer.knots, 3, [0.2, 0.7])
    matrix = bspline.insertion_matrix(2, outer.knots, knots)
    w = matrix @ outer.weights
    points = (matrix @ (outer.control_points * outer.weights[:, None])) / w[:, None]
    outer = SplineCurve(2, knots, 2.0 * points, w)
    curves = [arc(1.0), line([1, 0, 0], [2, 0, 0]), outer, line([0, 1, 0], [0, 2, 0])]
    middle = [curve.evaluate(np.array([0.5]))[0] for curve in curves]
    corners = np.array([[1, 0, 0], [2, 0, 0], middle[2], [0, 2, 0], [0, 1, 0], middle[0]])
    rim = np.array([[0, 1], [0, 5], [1, 2], [2, 3], [3, 4], [4, 5]])
    quads = np.array([[0, 1, 2, 5], [5, 2, 3, 4]])
    cover = QuadCover(corners, quads, np.zeros(2, dtype=int), rim, np.array([1, 0, 2, 2, 3, 0]))
    chains = edge_chains(cover, curves)
    wanted = np.ones(4, dtype=bool)
    rims, torn = rims_of(cover, curves, chains, {}, wanted, np.zeros(4, dtype=int))
    assert torn == []
    cubic = np.zeros((2, 4, 4, 3))
    share = np.arange(4) / 3.0
    for k, quad in enumerate(quads):
        a, b, c, d = corners[quad]
        s, t = share[:, None, None], share[None, :, None]
        cubic[k] = (1 - s) * (1 - t) * a + s * (1 - t) * b + s * t * c + (1 - s) * t * d
    x = np.linspace(0.0, 1.0, 9)
    seen = 0
    for nets in homogeneous_nets(cover, cubic, rims, np.array([True])):
        found = nets.at(x)
        assert np.abs(found[..., 2]).max() == 0.0
        radius = np.linalg.norm(found, axis=3)
        assert radius[:, 0] == pytest.approx(1.0, abs=1e-14)
        assert radius[:, -1] == pytest.approx(2.0, abs=1e-14)
        seen += len(nets.quads)
    assert seen == 2


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_faces_tell_how_far_the_edges_of_the_file_miss_the_face_beside_them(size):
    """The cubic with the tangent .5522847 is off a quarter circle by 2.7253e-4 of the radius."""
    circle, kappa = arc(1.0), 0.5522847
    cubic = np.array([[1.0, 0, 0], [1, kappa, 0], [kappa, 1, 0], [0, 1, 0]])
    circle = SplineCurve(2, circle.knots, size * circle.control_points, circle.weights)
    given = SplineCurve(3, np.repeat([0.0, 1.0], 4), size * cubic, np.ones(4))
    side = line([0, 0, 0], [0, 0, size])
    # a wall, which keeps its parameters, a plane beside the arc, and a face beside the line only
    outline = SimpleNamespace(
        vertices=size * np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]),
        face=np.array([0, 0, 1, 2]),
        edge=np.array([0, 1, 0, 1]),
    )
    geometry = SimpleNamespace(curves=(circle, side), surfaces=(None,) * 3)
    found = SimpleNamespace(grids={0: None})
    gaps = border_gaps(outline, found, geometry, [given, side])
    assert gaps == pytest.approx([0.0, 2.7253e-4 * size, 0.0], rel=1e-2)  # of 65 samples
