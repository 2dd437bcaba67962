# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Corners in which two edges touch, and knots that nearly agree."""

import numpy as np
import pytest

from HybridVolume.core.covering.cusps import cusps_of
from HybridVolume.core.covering.geometry import SplineCurve
from HybridVolume.core.covering.lattice import bicubic_nets
from HybridVolume.core.covering.outline import Outline
from HybridVolume.core.covering.places import places_on_knots
from HybridVolume.core.covering.quad_mesh import QuadCover
from HybridVolume.core.covering.rims import rims_of
from HybridVolume.core.surface import SplineFace

LINE = np.array([0.0, 0.0, 1.0, 1.0])
SMALL = 1e-5


def crescent():
    """A plane face between the x axis, a parabola y = x^2 / 2, and x = 1; the file's parabola
    begins in a direction that is off by `SMALL`."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0.5, 0]])
    nets = [
        np.array([[0.0, 0, 0], [1, 0, 0]]),
        np.array([[1.0, 0, 0], [1, 0.5, 0]]),
        np.array([[1, 0.5, 0], [0.5, -SMALL / 2, 0], [0.0, 0, 0]]),
    ]
    curves = [
        SplineCurve(len(net) - 1, np.repeat([0.0, 1.0], len(net)), net, np.ones(len(net)))
        for net in nets
    ]
    edges = np.array([[0, 1], [1, 2], [2, 0]])
    zeros = np.zeros(3, dtype=int)
    outline = Outline(
        vertices, edges, vertices[edges].mean(axis=1), np.ones(3), np.zeros(3), zeros, zeros,
        np.arange(3), np.ones(3, dtype=bool), np.array([np.pi / 2, np.pi / 4, np.pi]),
    )  # fmt: skip
    return outline, curves


def test_edges_in_cusps_get_one_direction():
    outline, curves = crescent()
    (cusp,) = cusps_of(outline, curves)
    assert cusp.edges == (2, 0) and cusp.point == pytest.approx(0.0)
    assert cusp.direction.tolist() == [1.0, 0.0, 0.0]  # of the straight edge, it is the simpler
    # a quad with half of the line and half of the parabola
    middle = [0.5, 0.125 - SMALL / 4, 0.0]
    points = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.7, 0.15, 0], middle])
    cover = QuadCover(
        points, np.array([[0, 1, 2, 3]]), np.zeros(1, dtype=int),
        np.array([[0, 1], [0, 3]]), np.array([0, 2]),
    )  # fmt: skip
    box = np.array([[[-1.0, -1, 0], [-1, 2, 0]], [[2, -1, 0], [2, 2, 0]]])
    plane = SplineFace("Face1", (1, 1), (LINE, LINE), box, np.ones((2, 2)))
    for cusps, off in (((), SMALL), ((cusp,), 0.0)):
        net = bicubic_nets(cover, curves, [plane], cusps)[0]
        along = net[0, 1] - net[0, 0]
        assert along[1] / along[0] == pytest.approx(-off, rel=1e-6, abs=1e-16)
        # a cubic that begins in another direction stays near the parabola
        x, y = (net[0].T @ [0.125, 0.375, 0.375, 0.125])[:2]
        assert y == pytest.approx(x**2 / 2, abs=2 * SMALL)


def test_corners_beside_knots_stand_on_them():
    t = np.array([0.0, 0, 0, 0, 0.5, 1, 1, 1, 1])
    net = np.array([[0.0, 0, 0], [1, 1, 0], [2, 1, 0], [3, 1, 0], [4, 0, 0]])
    curve = SplineCurve(3, t, net, np.ones(5))
    straight = SplineCurve(1, LINE, net[[0, 4]], np.ones(2))
    points = np.concatenate([curve.evaluate(np.array([0.0, 0.25, 0.5 - 1e-8, 0.8, 1.0]))])
    chains = {0: np.arange(5), 1: np.array([0, 4])}
    found = places_on_knots([0, 1], [curve, straight], points, chains)
    assert list(found) == [0] and found[0][2] == 0.5
    assert found[0] == pytest.approx([0.0, 0.25, 0.5, 0.8, 1.0], abs=1e-7)
    # and where all is far from knots nothing is said
    points[2] = curve.evaluate(np.array([0.4]))[0]
    assert places_on_knots([0, 1], [curve, straight], points, chains) == {}


@pytest.mark.parametrize("simple", [False, True])
def test_nearly_equal_knots_become_one_where_nothing_has_to_be_exact(simple):
    """Two opposite sides with copies of one curve, the second with other last digits."""
    net = np.array([[0.0, 0, 0], [1, 1, 0], [2, 1, 0], [3, 0, 0]])
    curves = [
        SplineCurve(2, np.array([0.0, 0, 0, knot, 1, 1, 1]), net + [0, 0, z], np.ones(4))
        for z, knot in ((0.0, 0.3), (1.0, 0.3 + 5e-9))
    ]
    points = np.array([net[0], net[3], net[3] + [0, 0, 1], net[0] + [0, 0, 1]])
    cover = QuadCover(
        points, np.array([[0, 1, 2, 3]]), np.zeros(1, dtype=int),
        np.array([[0, 1], [2, 3]]), np.array([0, 1]),
    )  # fmt: skip
    chains = {0: np.array([0, 1]), 1: np.array([3, 2])}
    for needed in ([0, 0], [0, 1]):
        rims, torn = rims_of(
            cover, curves, chains, {}, np.ones(2, dtype=bool), np.array(needed), simple
        )
        knots = [rims.piece[0].knots[3], rims.piece[1].turned().knots[3]]
        assert rims.exact.all() and not torn
        assert np.ptp(knots) == pytest.approx(0.0 if simple else 5e-9, rel=1e-6, abs=1e-15)
        if simple and needed[1]:  # the other follows the one that must keep its bits
            assert knots[0] == pytest.approx(0.3 + 5e-9, abs=1e-15)
