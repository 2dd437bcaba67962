# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Patches of quad meshes: as many as their irregular vertices ask for, all rectangles."""

import numpy as np
import pytest

from HybridVolume.core.polygon_repair import mended
from HybridVolume.core.quad_layout import quad_layout
from HybridVolume.sources.polygon_files import read_polygons


def torus(around, along):
    i, j = np.meshgrid(np.arange(around), np.arange(along), indexing="ij")
    i, j = i.ravel(), j.ravel()
    corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
    return np.column_stack([(a % around) * along + b % along for a, b in corners])


def cube(n):
    """A cube's surface with n x n quads a side, oriented outward."""
    points, quads = {}, []

    def vertex(*at):
        return points.setdefault(at, len(points))

    for axis in range(3):
        for far in (0, n):
            for a in range(n):
                for b in range(n):
                    ring = [(a, b), (a + 1, b), (a + 1, b + 1), (a, b + 1)]
                    ring = ring if far else ring[::-1]
                    quads.append([vertex(*np.roll([far, p, q], axis).tolist()) for p, q in ring])
    return np.array(list(points)), np.array(quads)


def check(quads, layout):
    """Every quad is the cell that the layout says, with the same orientation."""
    for k, (patch, (i, j), first) in enumerate(
        zip(layout.patch, layout.cell.tolist(), layout.first, strict=True)
    ):
        grid = layout.grids[patch]
        cell = [grid[i, j], grid[i + 1, j], grid[i + 1, j + 1], grid[i, j + 1]]
        assert np.roll(quads[k], -first).tolist() == cell


def test_a_cube_has_six_patches():
    _, quads = cube(5)
    layout = quad_layout(quads)
    assert [grid.shape for grid in layout.grids] == [(6, 6)] * 6
    check(quads, layout)


def test_sides_that_are_asked_for_cut_on_through_neighbours():
    points, quads = cube(4)
    place = {tuple(p): k for k, p in enumerate(points.tolist())}
    layout = quad_layout(quads, np.array([[place[4, 1, 2], place[4, 2, 2]]]))
    # one line around the cube: four sides are cut into two
    assert len(layout) == 10
    check(quads, layout)


@pytest.mark.parametrize("shape", [(4, 4), (8, 5), (12, 7)])
def test_a_regular_torus_is_cut_until_no_patch_meets_itself(shape):
    quads = torus(*shape)
    layout = quad_layout(quads)
    assert sum((g.shape[0] - 1) * (g.shape[1] - 1) for g in layout.grids) == len(quads)
    check(quads, layout)
    for grid in layout.grids:
        assert len(np.unique(grid)) == grid.size


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "count"),
    [("quads/ant.obj", 94), ("quads/rod.obj", 18), ("fandisk/fandisk_quads.obj", 108),
     ("fandisk/fandisk_quads_dense.off", 408)],
)  # fmt: skip
def test_real_meshes(shared_data, name, count):
    quads = mended(read_polygons(shared_data / name)).quads
    layout = quad_layout(quads)
    assert len(layout) == count
    check(quads, layout)
