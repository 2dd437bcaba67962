# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The random bodies are what they are said to be: genus, volume, embedding, rules."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.check import check_surface
from HybridVolume.core.intersection import self_intersections
from HybridVolume.core.isosurface import (
    genus_from_euler,
    isosurface_euler,
    largest_level,
    steady_level,
)
from HybridVolume.core.tetmesh import TetMesh
from HybridVolume.errors import SingularSurfaceError
from HybridVolume.reproduce.random_bodies import BODIES, SEEDS, build, random_body
from HybridVolume.reproduce.voxels import (
    PolynomialMap,
    bent_grid,
    faces_one_way,
    is_manifold,
    voxel_genus,
)


def test_surface_has_the_genus_of_the_voxels_and_the_volume_of_the_map() -> None:
    """The surface knows nothing of the cells: its volume is by the divergence theorem."""
    for name in BODIES:
        body = random_body(SEEDS[name])
        surface = build_surface(list(body.faces))
        assert surface.genus == (body.genus,), name
        assert surface.volume() == pytest.approx(body.grid.volume(), rel=1e-9), name


def test_neighbours_share_the_bits_of_their_sides() -> None:
    """Nothing is moved by welding, and every control point of a side is met again."""
    for name in BODIES[::5]:
        surface = build_surface(list(build(name)))
        assert not surface.moved.any()


def test_bodies_differ() -> None:
    """Holes, degrees, rational and thin ones are among them, at scales of five decades."""
    bodies = [random_body(seed) for seed in SEEDS.values()]
    assert {body.genus for body in bodies} == {0, 1, 2, 3}
    assert {p for body in bodies for p in body.degrees} == {1, 2, 3}
    assert sum(body.rational for body in bodies) == 10
    assert sum(body.thinnest() < 0.05 * body.diagonal for body in bodies) >= 8
    sizes = [body.diagonal for body in bodies]
    assert max(sizes) > 1e5 * min(sizes)
    kinds = {name for body in bodies for name in body.maps}
    assert kinds == {
        *("shear", "taper", "twist", "bend", "wave", "polynomial", "arc", "projective")
    }


def test_bodies_do_not_cut_themselves_and_pass_the_check() -> None:
    """One to one as a whole, and with an inward direction at every control point."""
    for name in BODIES[1::4]:
        surface = build_surface(list(build(name)))
        mesh = surface.triangulation(4)
        assert not len(self_intersections(mesh.vertices, mesh.triangles)), name
        check_surface(surface)


def test_volume_of_a_bend_is_pappus() -> None:
    """An exact arc of a solid block: area times the way of its middle."""
    cells = np.ones((1, 1, 3), dtype=bool)

    def bend(x: np.ndarray) -> np.ndarray:
        t = 0.1 * x[..., 2]
        w = 1.0 + t**2
        reach = 2.0 + x[..., 0]
        return np.stack([reach * (1 - t**2), x[..., 1] * w, 2 * reach * t, w], axis=-1)

    grid = bent_grid(cells, bend, degrees=(1, 1, 2))
    assert grid.volume() == pytest.approx(2.5 * 2.0 * np.arctan(0.3), rel=1e-12)
    surface = build_surface(list(grid.faces()))
    assert surface.volume() == pytest.approx(grid.volume(), rel=1e-11)


def test_rule_of_the_vertices_is_what_the_check_refuses() -> None:
    """Two steps that meet in a vertex: manifold, but two of its faces look at each other."""
    cells = np.zeros((2, 2, 2), dtype=bool)
    cells[0] = True
    cells[1, 0, 0] = True
    assert is_manifold(cells) and faces_one_way(cells) and voxel_genus(cells) == 0
    for keep, one_way in ((cells, True), (_saddle(), False)):
        assert is_manifold(keep) and faces_one_way(keep) == one_way
        surface = build_surface(list(bent_grid(keep, PolynomialMap(1, 2, (2, 2, 2), 0.3)).faces()))
        if one_way:
            check_surface(surface)
        else:
            with pytest.raises(SingularSurfaceError):
                check_surface(surface)


def _saddle() -> np.ndarray:
    """Three floor tiles and a block on one of them, another below the floor: an S at its middle."""
    cells = np.zeros((2, 2, 2), dtype=bool)
    cells[0, 0] = cells[0, 1, 0] = cells[1, 0, 1] = True
    return cells


def test_a_common_factor_of_all_weights_changes_no_bit() -> None:
    """NURBS mean the same with all weights times 1000; a power of two leaves their bits."""
    faces = [replace(face, weights=face.weights * 1024.0) for face in build("random-02")]
    plain, scaled = build_surface(list(build("random-02"))), build_surface(faces)
    for one, other in zip(plain.patches, scaled.patches, strict=True):
        assert np.array_equal(one.weights, other.weights)
    assert np.array_equal(plain.control_points, scaled.control_points)


def test_levels_at_which_a_neck_and_a_hole_cancel_are_not_right() -> None:
    """A ring that is thin at one place, with a blind hole: genus 1, 0 and 1 again as w rises."""
    mesh = _block((40, 40, 12))
    x = mesh.vertices
    ring = 1.0 - np.hypot(np.hypot(x[:, 0], x[:, 1]) - 1.0, x[:, 2]) / 0.5
    ring -= 0.6 * np.clip(1.0 - np.hypot(x[:, 0] - 1.0, x[:, 1]) / 0.6, 0.0, 1.0)
    away = np.hypot(x[:, 0] + 1.0, x[:, 1])
    disc = np.minimum(1.5 - away / 0.4, 1.0 - np.abs(x[:, 2]) / 0.5)
    values = np.maximum(np.minimum(np.maximum(ring, disc), 0.6 + 2.0 * away), 0.0)
    values[mesh.on_boundary] = 0.0
    assert [genus_from_euler(isosurface_euler(mesh, values, c)) for c in (0.2, 0.5, 0.8)] == [
        (1,),
        (0,),
        (1,),
    ]
    assert largest_level(mesh, values, (1,), 0.8) == 0.8
    assert 0.3 < steady_level(mesh, values, (1,), 0.8, 0.1) < 0.5
    assert steady_level(mesh, values, (1,), 0.3, 0.1) == 0.3
    # what comes and goes within .4 is left alone if that is asked for
    assert steady_level(mesh, values, (1,), 0.8, 0.4) == 0.8


def _block(cells: tuple[int, int, int]) -> TetMesh:
    """A block of 3 x 3 x 1.2, each cell cut into six tetrahedra."""
    lines = [
        np.linspace(-half, half, n + 1) for half, n in zip((1.5, 1.5, 0.6), cells, strict=True)
    ]
    x = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    number = np.arange(x[..., 0].size).reshape(x.shape[:3])
    tets = []
    for order in permutations(range(3)):
        corner = np.zeros(3, dtype=int)
        path = [corner.copy()]
        for axis in order:
            corner[axis] = 1
            path.append(corner.copy())
        part = [
            number[tuple(slice(a, a + n) for a, n in zip(step, cells, strict=True))].ravel()
            for step in path
        ]
        odd = order in ((0, 2, 1), (1, 0, 2), (2, 1, 0))
        tets.append(np.stack(part, axis=1)[:, [0, 2, 1, 3] if odd else slice(None)])
    return TetMesh(x.reshape(-1, 3), np.concatenate(tets))
