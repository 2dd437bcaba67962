# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Wanted density of the finite elements: sizes along the faces, layers, repairs of the grid."""

import bodies
import numpy as np
import pytest
from shells import exact_volume, make_shell, shell_towards

from HybridVolume.core import finite_elements as module
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.density import Density
from HybridVolume.core.diagonals import refine_at, wedges_over
from HybridVolume.core.finite_elements import build_finite_elements
from HybridVolume.core.gap import check_balance, gap_volume
from HybridVolume.core.sizes import wanted_lines
from HybridVolume.core.strips import base_lines, strips
from HybridVolume.errors import InputError, MesherError


def grid_edges(surface, lines):
    """Lengths of the grid's edges by patch, and how far sides that meet are apart."""
    u, v = lines.lines()
    mesh = surface.triangulation_at(u, v)
    apart, lengths = 0.0, []
    for k, grid in enumerate(mesh.grids):
        x = surface.evaluate_grid(k, u[k], v[k])
        apart = max(apart, np.abs(x - mesh.vertices[grid]).max())
        steps = [np.linalg.norm(np.diff(x, axis=a), axis=2).ravel() for a in (0, 1)]
        lengths.append(np.concatenate(steps))
    return lengths, apart


@pytest.mark.parametrize("name", ["box", "torus", "sphere", "hollow sphere"])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_edges_are_as_short_as_wanted_and_lines_meet(name, scale):
    surface = make_shell(name).surface
    surface = surface.with_points(scale * surface.control_points + 70.0 * scale)
    density = Density(size=0.5 * scale, face_sizes={"Face1": 0.06 * scale}, gradation=0.4)
    lengths, apart = grid_edges(surface, wanted_lines(surface, density))
    assert apart < 1e-13 * np.abs(surface.control_points).max()
    assert 0.9 * 0.045 * scale < lengths[0].max() < 1.06 * 0.06 * scale
    assert max(part.max() for part in lengths) < 1.06 * 0.5 * scale
    # away from the face it is not as fine everywhere
    assert max(part.max() for part in lengths) > 4.0 * lengths[0].max()


def test_a_face_may_be_coarser_than_the_others():
    surface = make_shell("box").surface
    names = [patch.face for patch in surface.patches]
    everywhere = wanted_lines(surface, Density(size=0.2))
    but_one = wanted_lines(surface, Density(size=0.2, face_sizes={n: 9.0 for n in names[1:]}))
    assert but_one.cells < everywhere.cells
    assert grid_edges(surface, but_one)[0][0].max() < 1.06 * 0.2


def test_strips_go_around_a_torus_and_a_box():
    # a torus of 4 x 4 patches: four lines of patches one way, four the other
    found = strips(make_shell("torus").surface)
    assert sorted(np.bincount(found.number.ravel())) == [4] * 8
    # a box: three belts of four faces each
    found = strips(make_shell("box").surface)
    assert sorted(np.bincount(found.number.ravel())) == [4, 4, 4]
    assert not found.twisted.any()


def test_equal_parts_are_those_of_each_cell():
    surface = make_shell("box").surface
    lines = wanted_lines(surface, Density(subdivide=3))
    assert lines.cells == 9 * base_lines(surface, "knots").cells
    u, _ = lines.lines()
    base, _ = surface.grid_parameters("knots")
    for fine, coarse in zip(u, base, strict=True):
        assert np.array_equal(fine[::3], coarse)
        assert np.allclose(np.diff(fine), np.repeat(np.diff(coarse) / 3.0, 3), atol=1e-15)


def test_a_size_that_cannot_be_meant_is_refused():
    surface = make_shell("box").surface
    for density in (Density(size=1e-4), Density(subdivide=64), Density(subdivide=20, layers=50)):
        with pytest.raises(InputError, match="about .* nodes"):
            wanted_lines(surface, density)
    with pytest.raises(InputError) as caught:
        wanted_lines(surface, Density(face_sizes={"Face77": 0.1}))
    assert caught.value.faces == ("Face77",)


def columns_of(fem):
    """Points up each column over a corner of a boundary triangle, from outside, (m, k, 3)."""
    count = len(fem.boundary)
    layers = fem.wedge_layer.max() + 1
    wedges = fem.wedges.reshape(layers, count, -1)
    rows = [wedges[0][:, 3:6]]
    for layer in wedges:
        rows += [layer[:, 12:15], layer[:, :3]]
    return fem.nodes[np.stack([r.ravel() for r in rows], axis=1)]


def test_layers_have_the_growth_that_is_asked_for():
    _, _, fem = build_finite_elements(make_shell("sphere"), Density(layers=4, growth=1.5))
    radius = np.linalg.norm(columns_of(fem), axis=2)
    heights = radius[:, :-2:2] - radius[:, 2::2]
    assert heights.shape[1] == 4
    assert np.allclose(heights[:, 1:] / heights[:, :-1], 1.5, rtol=2e-3)
    # mid nodes in the middle of their edges
    halves = radius[:, :-2:2] - radius[:, 1::2]
    assert np.allclose(halves / heights, 0.5, atol=2e-3)


def test_layers_by_themselves_follow_the_edges():
    counts = []
    for size in (0.6, 0.25):
        _, _, fem = build_finite_elements(make_shell("sphere"), Density(size=size))
        columns = columns_of(fem)
        first = np.linalg.norm(columns[:, 2] - columns[:, 0], axis=1)
        x = fem.nodes[fem.boundary[:, :3]]
        edge = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).mean()
        assert 0.125 * edge < first.min() and abs(np.median(first) / edge - 0.2) < 0.075
        counts.append(int(fem.wedge_layer.max()) + 1)
    assert counts == sorted(set(counts))


def test_the_core_grows_inward():
    shell = make_shell("sphere")
    interface, interior, _ = build_finite_elements(shell, Density(size=0.2))
    x = interior.mesh.vertices[interior.mesh.tets]
    depth = 0.6 - np.linalg.norm(x.mean(axis=1), axis=1)
    size = np.cbrt(interior.mesh.volumes)
    assert np.median(size[depth > 0.3]) > 1.5 * np.median(size[depth < 0.1])
    assert interior.mesh.volume == pytest.approx(interface.volume)


@pytest.mark.parametrize("density", [Density(), Density(subdivide=2)])
def test_a_core_that_reaches_into_the_shell_still_fills_the_body(monkeypatch, density):
    """Facets that cut each other are drawn back along their columns, until they do not."""
    shell = make_shell("torus")
    fill, asked = module.fill_interior, []

    def crossing(interface):
        return np.arange(6) if len(interface.vertex_w) == 0 else np.zeros(0, dtype=int)

    def refuse(interface, *args, **kwargs):
        asked.append(interface)
        if len(crossing(interface)):
            raise MesherError("6 triangles cut each other")
        return fill(interface, *args, **kwargs)

    monkeypatch.setattr(module, "crossing_triangles", crossing)
    monkeypatch.setattr(module, "fill_interior", refuse)
    interface, interior, fem = build_finite_elements(shell, density)
    assert fem.repairs["withdrawn"] > 6 and fem.repairs["refined"] == 0
    assert interface.vertex_w.min() == 0.9 and np.count_nonzero(interface.vertex_w == 0.9) < 12
    surface = shell.inner_surface()
    off = interface.vertices - surface.evaluate_at(interface.vertex_patch, *interface.vertex_uv.T)
    assert np.array_equal(np.abs(off).max(axis=1) > 1e-9, interface.vertex_w < 1.0)
    assert np.array_equal(fem.nodes[fem.interface[:, :3]], interface.vertices[interface.triangles])
    # shell, core and the space between them are the body all the same
    check_balance(shell.surface, shell, interior, gap_volume(interface, shell))
    assert fem.min_scaled_jacobian > 0.0


def test_long_cells_are_halved_across_only():
    surface = build_surface(list(bodies.box((8.0, 1.0, 1.0), (1, 1, 1)).faces))
    shell = shell_towards(surface, lambda x: x + 0.3 * (np.array([4.0, 0.5, 0.5]) - x))
    lines = base_lines(surface, "knots")
    wedges, _ = wedges_over(shell, lines, Density(), 2)
    sides = wedges.cell_sides()
    assert sorted(map(tuple, np.round(np.sort(sides, axis=1), 12).tolist())) == [
        *[(1.0, 1.0)] * 2,
        *[(1.0, 8.0)] * 4,
    ]
    long = int(np.argmax(sides.max(axis=1)))
    finer = refine_at(lines, lines, np.array([2 * long]), 4, sides)
    # one belt of four long faces is halved, and the two ends stay
    assert finer.cells == 10 and finer.within(lines) == 4
    assert refine_at(finer, lines, np.arange(2 * finer.cells), 2) is not None
    assert refine_at(lines, lines, np.array([0]), 1, sides) is None


def test_the_volume_converges_with_sizes():
    shell, errors = make_shell("sphere"), []
    for size in (0.5, 0.25):
        _, _, fem = build_finite_elements(shell, Density(size=size))
        errors.append(abs(fem.volume - exact_volume("sphere")))
    assert errors[1] < errors[0] / 10.0
