# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Angles, edges, heights and volumes of elements against closed formulas; groups of a mesh."""

from dataclasses import replace

import numpy as np
import pytest
from box_mesh import box_mesh

from HybridVolume.core.elements import EDGES, reference
from HybridVolume.core.fem_quality import BINS, element_figures, mesh_quality

REGULAR_TET = np.array([[1, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1.0]])
CORNER_TET = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0]])
REGULAR_WEDGE = np.concatenate([TRIANGLE, TRIANGLE + [0, 0, 1.0]])
RIGHT = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])


def figures(kind, corners):
    """Figures of one element with straight edges, or bent by what ``corners`` already holds."""
    corners = np.asarray(corners, dtype=float)
    nodes = [*corners]
    if len(reference(kind).nodes) > len(corners):
        nodes += [corners[list(edge)].mean(axis=0) for edge in EDGES[kind]]
    one = np.ones(1)
    return element_figures(kind, np.array([nodes]), one, one)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("kinds", "corners", "angles", "aspect", "edges", "volume"),
    [
        (("tet4", "tet10"), REGULAR_TET, np.degrees(np.arccos([1 / 3] * 2)), 1.0,
         (np.sqrt(8.0), np.sqrt(8.0)), 8.0 / 3.0),
        (("tet4", "tet10"), CORNER_TET, (np.degrees(np.arccos(np.sqrt(1 / 3))), 90.0), 2.0,
         (1.0, np.sqrt(2.0)), 1.0 / 6.0),
        (("penta6", "penta15"), REGULAR_WEDGE, (60.0, 90.0), 1.0, (1.0, 1.0), np.sqrt(3) / 4),
        # the smallest height is that of the layer, 1 / 10
        (("penta6", "penta15"), np.concatenate([RIGHT, RIGHT + [0, 0, 0.1]]), (45.0, 90.0),
         10.0 * np.sqrt(2.0) * np.sqrt(0.75), (0.1, np.sqrt(2.0)), 0.05),
    ],
)  # fmt: skip
def test_straight_elements(order, kinds, corners, angles, aspect, edges, volume):
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    for scale, shift in ((1.0, 0.0), (1e-3, 0.0), (1e3, 1e4)):
        found = figures(kinds[order - 1], scale * (corners @ turn.T) + shift)
        assert found.dihedral[0] == pytest.approx(angles, abs=1e-4)
        assert found.aspect[0] == pytest.approx(aspect, rel=1e-6)
        assert found.shortest_edge[0] == pytest.approx(scale * edges[0], rel=1e-9)
        assert found.longest_edge[0] == pytest.approx(scale * edges[1], rel=1e-9)
        assert found.volume[0] == pytest.approx(scale**3 * volume, rel=1e-6)


@pytest.mark.parametrize("kind", ["penta15", "tet10"])
def test_a_sheared_element_has_curved_edges_and_angles(kind):
    bend = 0.3
    nodes = reference(kind).nodes.copy()
    nodes[:, 2] += bend * nodes[:, 0] ** 2  # exact for quadratic elements, of the same volume
    one = np.ones(1)
    found = element_figures(kind, nodes[None], one, one)
    parabola = 0.5 * np.hypot(1.0, 2 * bend) + np.arcsinh(2 * bend) / (4 * bend)
    if kind == "penta15":
        # the diagonal is longest: sqrt(2) t along the ground, bend t^2 upward
        diagonal = np.sqrt(2.0)
        slope = 2 * bend / diagonal
        longest = diagonal * (0.5 * np.hypot(1.0, slope) + np.arcsinh(slope) / (2 * slope))
        assert found.volume[0] == pytest.approx(0.5, rel=1e-14)
        # the side over the diagonal leans by 45 degrees, top and bottom by their slope at x = 1
        tilt = np.degrees(np.arccos(slope * np.sqrt(0.5) * np.sqrt(2.0) / np.hypot(1.0, 2 * bend)))
        assert found.dihedral[0] == pytest.approx((min(45.0, tilt), 180.0 - tilt), abs=1e-9)
        assert found.shortest_edge[0] == pytest.approx(1.0, rel=1e-12)
        assert found.longest_edge[0] == pytest.approx(longest, rel=1e-6)
        assert parabola < longest
    else:
        assert found.volume[0] == pytest.approx(1 / 6, rel=1e-14)
        assert found.shortest_edge[0] == pytest.approx(1.0, rel=1e-12)
        # at the end of the bent edge the ground z = x^2 falls away from the side y = 0 unturned
        assert found.dihedral[0, 1] == pytest.approx(90.0, abs=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_groups_of_a_mesh(order):
    names = ("Left", "Right", "Front", "Back", "Bottom", "Top")
    share = 0.25
    mesh = box_mesh((3.0, 2.0, 1.0), names, order, share)
    quality = rng_quality(mesh)
    found = mesh_quality(quality)
    shell, core, everything = found.groups
    assert [group.name for group in found.groups] == ["Shell", "Core", "All"]
    assert (shell.elements, core.elements, everything.elements) == (12, 12, 24)
    assert core.total_volume == pytest.approx(6.0 * (1.0 - share) ** 3, rel=1e-13)
    assert everything.total_volume == pytest.approx(6.0, rel=1e-13)
    for group, values in (
        (shell, quality.wedge_quality),
        (core, quality.tet_quality),
        (everything, np.concatenate([quality.wedge_quality, quality.tet_quality])),
    ):
        assert group.scaled_jacobian.min == values.min()
        assert group.scaled_jacobian.mean == pytest.approx(values.mean(), rel=1e-14)
        assert len(group.histogram) == BINS and sum(group.histogram) == group.elements
        assert group.histogram[0] == np.count_nonzero(values < 1.0 / BINS)
    # the body's own diagonals, in the plane of the largest side, are the longest edges
    assert everything.edge.max == pytest.approx(np.hypot(3.0, 2.0), rel=1e-12)
    worst = found.worst(3)
    assert (worst[0].group, worst[0].index, worst[0].number) == ("Core", 7, 20)
    assert worst[0].face == "" and worst[0].scaled_jacobian == 0.001
    assert (worst[1].group, worst[1].number, worst[1].layer) == ("Shell", 5, 0)
    assert worst[1].face == mesh.face_names[mesh.boundary_face[4]]
    assert worst[1].centre == pytest.approx(mesh.nodes[mesh.wedges[4, :6]].mean(axis=0))
    assert found.below(0.01) == 2
    least = found.least_by_face()
    assert set(least) == set(names) and least[worst[1].face] == 0.002


def rng_quality(mesh):
    """The mesh with other qualities than its own: known places of the worst elements."""
    wedge, tet = np.linspace(0.3, 0.9, 12), np.linspace(0.2, 1.0, 12)
    wedge[4], tet[7] = 0.002, 0.001
    return replace(mesh, wedge_quality=wedge, tet_quality=tet)


def test_figures_are_plain():
    import json

    mesh = box_mesh((1.0, 1.0, 1.0), tuple("abcdef"))
    figures = mesh_quality(mesh).figures()
    assert json.loads(json.dumps(figures)) == figures
    assert set(figures["groups"]) == {"shell", "core", "all"}
    # a mesh without a core has no such group
    hollow = replace(mesh, tets=mesh.tets[:0], tet_quality=np.empty(0), tet_bound=np.empty(0))
    assert set(mesh_quality(hollow).figures()["groups"]) == {"shell", "all"}
