# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Repairs of thin bodies: better tets, shorter columns, flat cells without a mesher."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay
from shells import make_shell

from HybridVolume.core.density import Density
from HybridVolume.core.diagonals import flip_flat, make_wedges
from HybridVolume.core.element_jacobians import scaled_jacobian, tet_quality
from HybridVolume.core.finite_elements import build_finite_elements
from HybridVolume.core.interior import checked_interior, fill_interior
from HybridVolume.core.sizes import wanted_lines
from HybridVolume.core.tetmesh import TetMesh, improve
from HybridVolume.core.withdrawal import thicken, withdraw_poor, withdraw_under


def random_tets(seed: int) -> TetMesh:
    """Delaunay tets of random points in a ball, slivers included."""
    points = np.random.default_rng(seed).normal(size=(150, 3))
    points /= np.maximum(1.0, np.linalg.norm(points, axis=1, keepdims=True))
    tets = Delaunay(points).simplices.astype(np.int64)
    corners = points[tets]
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1])
    tets[volume < 0.0] = tets[volume < 0.0][:, [0, 1, 3, 2]]
    return TetMesh(points, tets[np.abs(volume) > 1e-9])


def oriented(triangles: np.ndarray) -> set[tuple[int, ...]]:
    first = triangles.argmin(axis=1)[:, None]
    return {tuple(t) for t in np.take_along_axis(triangles, (first + np.arange(3)) % 3, 1).tolist()}


@pytest.mark.parametrize("seed", range(4))
def test_better_tets_fill_the_same_body(seed):
    mesh = random_tets(seed)
    before = tet_quality(mesh.vertices[mesh.tets])
    assert np.allclose(before, scaled_jacobian("tet4", mesh.vertices[mesh.tets]))
    better = improve(mesh)
    after = tet_quality(better.vertices[better.tets])
    assert oriented(better.boundary_triangles) == oriented(mesh.boundary_triangles)
    assert better.volumes.min() > 0.0
    assert better.volume == pytest.approx(mesh.volume, rel=1e-12)
    outside = mesh.on_boundary
    assert np.array_equal(better.vertices[outside], mesh.vertices[outside])
    assert after.min() >= before.min()
    assert np.count_nonzero(after < 0.05) < 0.5 * np.count_nonzero(before < 0.05)


def test_shorter_columns_move_the_core_along():
    shell, density = make_shell("torus"), Density()
    lines = wanted_lines(shell.surface, density)
    flipped = np.zeros(lines.cells, dtype=bool)
    wedges = make_wedges(shell, lines, density, 2, flipped)
    interior = fill_interior(wedges.interface)
    assert thicken(shell, lines, density, wedges, flipped, interior)[0] is wedges
    assert withdraw_poor(shell, lines, density, wedges, flipped)[1] is None
    under = np.arange(6)
    found, core = withdraw_under(shell, lines, density, wedges, flipped, interior, under)
    w = found.interface.vertex_w
    corners = np.unique(wedges.interface.triangles[under])
    assert w.max() == 1.0 and (w[corners] < 1.0).all() and w.min() >= 0.1
    # columns are straight: each vertex stands between its two ends
    outer = shell.surface.evaluate_at(found.interface.vertex_patch, *found.interface.vertex_uv.T)
    whole = wedges.interface.vertices - outer
    left = found.interface.vertices - outer
    assert np.allclose(np.cross(whole, left), 0.0, atol=1e-12)
    assert (np.einsum("ni,ni->n", whole, left)[corners] > 0.0).all()
    assert core.mesh.volumes.min() > 0.0 and core.boundary_exact
    # a torus' core grows where the shell gives way
    assert core.volume > interior.volume
    assert core.volume == pytest.approx(found.interface.volume, rel=1e-12)


def test_a_flat_cell_is_flipped_without_a_mesher(monkeypatch):
    shell, density = make_shell("sphere"), Density()
    lines = wanted_lines(shell.surface, density)
    flipped = np.zeros(lines.cells, dtype=bool)
    wedges = make_wedges(shell, lines, density, 2, flipped)
    interior = fill_interior(wedges.interface)
    # the core of the flipped cell and the tet between its two pairs of triangles fill the old one
    chosen = flipped.copy()
    chosen[3] = True
    other = make_wedges(shell, lines, density, 2, chosen)
    difference = wedges.interface.volume - other.interface.volume
    inner, outer = (other, wedges) if difference > 0.0 else (wedges, other)
    core = interior.mesh if inner is wedges else fill_interior(inner.interface).mesh
    tet = np.unique(wedges.interface.triangles[6:8])
    corners = core.vertices[tet]
    if np.linalg.det(corners[1:] - corners[0]) < 0.0:
        tet = tet[[0, 1, 3, 2]]
    mesh = replace(core, tets=np.vstack([core.tets, tet]))
    whole = checked_interior(mesh, outer.interface)
    monkeypatch.setattr("HybridVolume.core.diagonals._FLAT", 2.0)
    monkeypatch.setattr("HybridVolume.core.diagonals._FLIPS", 1)
    start = chosen if outer is other else flipped
    after, flags, left = flip_flat(shell, lines, density, outer, np.zeros_like(start), None, whole)
    assert flags.any()
    assert len(left.mesh) <= len(mesh) and left.volume < whole.volume
    assert left.volume == pytest.approx(after.interface.volume, rel=1e-12)


def test_a_thin_plate_has_a_proved_mesh():
    shell = make_shell("box")
    layers = shell.layers.copy()
    # the columns of both large faces nearly meet in the middle
    layers[1:, :, 2] += 0.96 * np.linspace(0, 1, len(layers))[1:, None] * (0.5 - layers[1:, :, 2])
    thin = replace(shell, layers=layers)
    _, _, fem = build_finite_elements(thin)
    # .016 with the meshers' tets and the columns as they were
    assert fem.min_scaled_jacobian > 0.02 and fem.repairs["withdrawn"] > 0
    assert (fem.wedge_bound > 0.0).all() and (fem.tet_bound > 0.0).all()
    assert fem.volume == pytest.approx(6.0, rel=1e-12)
