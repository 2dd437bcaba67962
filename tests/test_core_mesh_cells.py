# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Elements of a finite element mesh as they are drawn and cut, against a box's own figures."""

import numpy as np
import pytest
from box_mesh import box_mesh

from HybridVolume.core.mesh_cells import MeshCells

SIZE = np.array([3.0, 2.0, 1.0])
SHARE = 0.4
NAMES = [f"Face{k}" for k in range(1, 7)]


@pytest.fixture(params=(1, 2), ids=("order 1", "order 2"))
def cells(request):
    return MeshCells(box_mesh(SIZE, NAMES, order=request.param, share=SHARE))


def areas(points, triangles):
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def volume(points, triangles):
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    return np.einsum("tc,tc->", a, np.cross(b, c)) / 6.0


def test_the_boundary_of_body_and_core(cells):
    for core, size in ((False, SIZE), (True, (1.0 - SHARE) * SIZE)):
        triangles, owner, edges = cells.outside(core)
        a, b, c = size
        assert areas(cells.nodes, triangles).sum() == pytest.approx(2 * (a * b + b * c + c * a))
        assert volume(cells.nodes, triangles) == pytest.approx(a * b * c)
        assert set(owner) == set(range(12, 24) if core else range(12))
        # twelve edges of the box and a diagonal on each of its six sides
        assert len(edges) == 18


def test_each_element_is_closed_and_all_fill_the_box(cells):
    every = np.arange(len(cells))
    triangles, owner = cells.faces(every)
    each = [volume(cells.nodes, triangles[owner == element]) for element in every]
    assert min(each) > 0.0 and sum(each) == pytest.approx(SIZE.prod())
    assert sum(each[12:]) == pytest.approx(((1.0 - SHARE) * SIZE).prod())
    # no two edges of an element are counted once for both
    assert len(cells.edges(every[:1])) == 9 * (2 if cells.wedges.shape[1] == 18 else 1)


def test_a_cut_has_the_area_of_the_box_and_of_its_core(cells):
    normal, distance = np.array([1.0, 0.0, 0.0]), 1.7
    every = np.arange(len(cells))
    cut, rims = cells.section(every, normal, distance)
    area = areas(cut.points, cut.parts)
    assert cut.points[:, 0] == pytest.approx(distance)
    assert area.sum() == pytest.approx(SIZE[1] * SIZE[2])
    core = area[cut.owner >= 12].sum()
    assert core == pytest.approx((1.0 - SHARE) ** 2 * SIZE[1] * SIZE[2])
    assert rims.points[:, 0] == pytest.approx(distance) and len(rims.parts)
    alone, _ = cells.section(every[12:], normal, distance)
    assert areas(alone.points, alone.parts).sum() == pytest.approx(core)
    nothing, _ = cells.section(every, normal, 4.0)
    assert len(nothing.parts) == 0
