# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Curve skeletons: loops, middle, branches."""

from __future__ import annotations

from functools import cache

import bodies
import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.intersection import points_inside
from HybridVolume.core.midstructure import Midstructure, Search, find_midstructure
from HybridVolume.core.midstructure.skeleton import curve_skeleton
from HybridVolume.core.surface import PatchSurface
from HybridVolume.errors import InputError


def tunnels() -> bodies.Body:
    """Bent voxels with one tunnel."""
    cells = bodies.random_voxels(4, (4, 3, 3), 0.55)
    assert bodies.voxel_genus(cells) == 1
    return bodies.bent_voxels(4, 2, cells=cells)


BODIES = {
    "cylinder": lambda: bodies.cylinder(1.0, 6.0),
    "torus": bodies.torus,
    "ring": bodies.ring,
    "L": bodies.l_bracket,
    "tunnels": tunnels,
}


@cache
def surface_of(name: str) -> PatchSurface:
    return build_surface(list(BODIES[name]().faces))


@cache
def skeleton_of(name: str) -> Midstructure:
    return find_midstructure(surface_of(name), Search(method="skeleton"))


def loops(m: Midstructure) -> int:
    """Cycle rank of the lines, which must be connected."""
    edges, n = m.facets[:, :2], len(m.vertices)
    parts, _ = connected_components(coo_matrix((np.ones(len(edges)), tuple(edges.T)), (n, n)))
    assert parts == 1
    return len(edges) - n + 1


def check(m: Midstructure, surface: PatchSurface) -> None:
    assert m.method == "skeleton" and m.kept.all()
    assert np.array_equal(m.facets[:, 1], m.facets[:, 2])
    assert (m.facets[:, 0] != m.facets[:, 1]).all()
    ends = m.vertices[m.facets[:, :2]]
    # the balls of both ends of a line meet, so that the line lies inside the body
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert (length < m.radius[m.facets[:, :2]].sum(axis=1)).all()
    mesh = surface.triangulation(8)
    assert points_inside(mesh.vertices, mesh.triangles, m.vertices).all()
    assert loops(m) == sum(surface.genus)


@pytest.mark.parametrize("name", list(BODIES))
def test_loops_are_the_handles_of_the_body(name):
    check(skeleton_of(name), surface_of(name))


def test_axis_of_a_cylinder():
    m = skeleton_of("cylinder")
    assert len(m.sheets) == 1
    assert np.hypot(m.vertices[:, 0], m.vertices[:, 1]).max() < 0.02
    low, high = m.vertices[:, 2].min(), m.vertices[:, 2].max()
    # the ends stay about one radius before the caps
    assert 0.7 < low < 1.3 and 4.7 < high < 5.3


def test_centre_circle_of_a_torus():
    m = skeleton_of("torus")
    assert np.abs(np.hypot(m.vertices[:, 0], m.vertices[:, 1]) - 3.0).max() < 0.02
    assert np.abs(m.vertices[:, 2]).max() < 0.02
    ends = m.vertices[m.facets[:, :2]]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()
    assert length == pytest.approx(6.0 * np.pi, rel=0.01)
    assert len(m.sheets) == 1


def test_branches_are_sheets():
    m = skeleton_of("tunnels")
    assert len(m.sheets) > 1
    degree = np.bincount(m.facets[:, :2].ravel(), minlength=len(m.vertices))
    for k in range(len(m.sheets)):
        inner = np.bincount(m.facets[m.sheet == k][:, :2].ravel(), minlength=len(degree))
        assert (degree[inner == 2] == 2).sum() >= (inner == 2).sum() - 1
    fewer = m.choose(decisions=[f"remove {m.sheets[-1].name}"])
    assert not fewer.unmatched and fewer.kept_sheets == len(m.sheets) - 1
    assert set(m.sheets[0].faces) <= set(m.faces) and m.probe_points is not None


@pytest.mark.parametrize("size, shift", [(1e3, 1e6)])
def test_size_and_place_do_not_matter(size, shift):
    surface = surface_of("L")
    turn, _ = np.linalg.qr(np.array([[1.0, 2.0, 3.0], [-2.0, 1.0, 0.5], [0.3, -1.0, 2.0]]))
    turn *= np.sign(np.linalg.det(turn))
    moved = surface.with_points(size * surface.control_points @ turn.T + shift)
    m = curve_skeleton(moved)
    check(m, moved)
    back = (m.vertices - shift) / size @ turn
    # two bars of 1 x 1 mm that meet in (0.5, 0.5, 0.5)
    arm = back[(back[:, 0] > 1.0) | (back[:, 1] > 1.0)]
    across = arm - 0.5
    off = np.hypot(np.abs(across[:, :2]).min(axis=1), across[:, 2])
    assert len(arm) > 2 and off.max() < 0.05


def test_as_high_as_wide_is_a_point():
    m = curve_skeleton(build_surface(list(bodies.cylinder(1.0, 2.0).faces)))
    assert np.array_equal(m.facets, [[0, 0, 0]])
    assert np.linalg.norm(m.vertices[0] - [0.0, 0.0, 1.0]) < 0.05


def test_cavity_is_refused():
    with pytest.raises(InputError, match="1 cavity") as caught:
        curve_skeleton(build_surface(list(bodies.hollow_sphere().faces)))
    assert len(caught.value.faces) == 6 and "distance" in caught.value.remedy
