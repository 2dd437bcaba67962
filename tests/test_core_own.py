# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The user's own geometry as the midstructure."""

from __future__ import annotations

from functools import cache

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.midstructure import Search, find_midstructure
from HybridVolume.core.midstructure.own import own_midstructure
from HybridVolume.core.surface import PatchSurface
from HybridVolume.errors import InputError

RECTANGLE = np.array([[1.0, 0.5, 0.5], [3.0, 0.5, 0.5], [3.0, 1.5, 0.5], [1.0, 1.5, 0.5]])
TWO = np.array([[0, 1, 2], [0, 2, 3]])


@cache
def surface_of(name: str) -> PatchSurface:
    made = {"box": lambda: bodies.box((4.0, 2.0, 1.0), (4, 2, 2)), "L": bodies.l_bracket}
    return build_surface(list(made[name]().faces))


def test_rectangle():
    search = Search(method="own")
    m = find_midstructure(surface_of("box"), search, own=(RECTANGLE, TWO))
    assert m.method == "own" and m.kept.all() and len(m.sheets) == 1
    assert m.area == pytest.approx(2.0) and m.radius == pytest.approx(np.full(4, 0.5))
    sheet = m.sheets[0]
    surface = surface_of("box")
    flat = [p for p in surface.patches if np.ptp(surface.control_points[p.index][..., 2]) == 0.0]
    top_and_bottom = {patch.face for patch in flat}
    assert set(sheet.faces) == top_and_bottom and sheet.angle[0] > 170.0
    assert m.probe_points is not None


def test_pieces_of_each_kind_are_sheets():
    vertices = np.vstack([RECTANGLE, [[0.3, 1.0, 0.5], [0.7, 1.0, 0.5], [3.6, 1.0, 0.5]]])
    facets = np.vstack([TWO, [[4, 5, 5], [6, 6, 6]]])
    m = own_midstructure(surface_of("box"), vertices, facets)
    assert [sheet.area for sheet in m.sheets] == pytest.approx([2.0, 0.0, 0.0])
    assert np.array_equal(m.sheet, [0, 0, 1, 2])
    only = m.choose(decisions=[f"remove {m.sheets[1].name}"])
    assert np.array_equal(only.kept, [True, True, False, True]) and not only.unmatched


def test_vertices_at_one_place_are_one():
    doubled = RECTANGLE[TWO].reshape(-1, 3)
    m = own_midstructure(surface_of("box"), doubled, np.arange(6).reshape(2, 3))
    assert len(m.vertices) == 4 and len(m.sheets) == 1


@pytest.mark.parametrize("size, shift", [(1e-3, 0.0), (1e3, 1e6)])
def test_size_and_place_do_not_matter(size, shift):
    surface = surface_of("box")
    moved = surface.with_points(size * surface.control_points + shift)
    m = own_midstructure(moved, size * RECTANGLE + shift, TWO)
    assert m.radius == pytest.approx(np.full(4, 0.5 * size), rel=1e-6)
    with pytest.raises(InputError, match="outside"):
        own_midstructure(moved, size * (RECTANGLE + [0.0, 0.0, 0.6]) + shift, TWO)


@pytest.mark.parametrize(
    "move, match, figure",
    [
        ([0.0, 0.0, 0.7], "4 of 4 vertices .* outside", -0.2),
        ([2.0, 0.0, 0.0], "2 of 4 vertices .* outside", -1.0),
        ([0.0, 0.0, 0.5], "4 of 4 vertices .* touch", 0.0),
    ],
)
def test_outside(move, match, figure):
    with pytest.raises(InputError, match=match) as caught:
        own_midstructure(surface_of("box"), RECTANGLE + move, TWO)
    assert caught.value.figure == pytest.approx(figure, abs=1e-9)
    assert caught.value.faces and caught.value.remedy


@pytest.mark.parametrize("facet", [[0, 1, 1], [0, 1, 2]])
def test_cut_between_vertices_that_lie_inside(facet):
    # over the inner corner of the L at (1, 1)
    vertices = np.array([[0.6, 1.8, 0.5], [1.8, 0.6, 0.5], [1.7, 0.7, 0.4]])
    with pytest.raises(InputError, match="1 of 1 facets .* cut") as caught:
        own_midstructure(surface_of("L"), vertices, [facet])
    assert caught.value.figure == pytest.approx(-0.2, abs=0.02)


@pytest.mark.parametrize(
    "vertices, facets, match",
    [
        (RECTANGLE, TWO + 1, "1 of 2 facets refer"),
        (RECTANGLE, -TWO, "refer"),
        (RECTANGLE * [1.0, np.nan, 1.0], TWO, "4 of 4 vertices .* not finite"),
        (RECTANGLE, TWO[:0], "no facets"),
        (RECTANGLE, TWO * 1.0, "whole numbers"),
        (RECTANGLE[:, :2], TWO, "shapes"),
        (RECTANGLE[[0, 0, 0]], np.array([[0, 1, 2]]), "extent"),
    ],
)
def test_what_is_no_geometry(vertices, facets, match):
    with pytest.raises(InputError, match=match) as caught:
        own_midstructure(surface_of("box"), vertices, facets)
    assert caught.value.remedy
