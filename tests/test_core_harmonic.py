# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The harmonic field against solutions that are known, and the topology of its isosurfaces."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import bodies
import numpy as np
import pytest
from test_core_midstructure import axis_of, surface_of
from test_core_tetmesh import icosphere

from HybridVolume.core import tetmesh
from HybridVolume.core.adaptive_triangulation import adaptive_triangulation
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.harmonic import HarmonicField, solve_harmonic, solve_on
from HybridVolume.core.harmonic_domain import Domain
from HybridVolume.core.harmonic_topology import tie_parts
from HybridVolume.core.isosurface import genus_from_euler, isosurface_euler
from HybridVolume.core.midstructure import Midstructure, Sheet
from HybridVolume.core.tetmesh import TetMesh, enclosed_volume, fill

ENGINES = [name for name in tetmesh.available_engines() if name != "pytetwild"]


def midstructure_of(vertices: np.ndarray, facets: np.ndarray, radius: float) -> Midstructure:
    """A midstructure made by hand, all of it kept."""
    count = len(facets)
    seed = tuple(float(x) for x in vertices[0])
    sheet = Sheet(("Face1", "Face2"), 1.0, (radius, radius), (180.0, 180.0), True, "", seed)
    return Midstructure(
        vertices,
        facets,
        np.zeros(count, dtype=int),
        np.ones(count, dtype=bool),
        np.full(len(vertices), radius),
        (sheet,),
    )


@cache
def field_of(name: str) -> HarmonicField:
    return solve_harmonic(surface_of(name), axis_of(name), tets=20_000)


def check_field(field: HarmonicField) -> None:
    mesh = field.mesh
    assert not mesh.on_boundary[mesh.tets].all(axis=1).any()
    assert field.w.min() >= 0.0 and field.w.max() <= 1.0
    assert (field.w[mesh.on_boundary] == 0.0).all()
    assert (field.w[field.fixed] == 1.0).all() and not field.fixed[mesh.on_boundary].any()
    inner = ~mesh.on_boundary & ~field.fixed
    assert (field.w[inner] > 0.0).all()


@pytest.mark.parametrize("engine", ENGINES)
def test_concentric_spheres(engine):
    """w = 1/r - 1 between a sphere of radius 1 and one of radius 1/2; errors fall with the size."""
    surface = build_surface(list(bodies.sphere(spans=2).faces))
    midstructure = midstructure_of(*icosphere(4, 0.5), 0.5)
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(3000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    r = rng.uniform(0.55, 0.95, 3000)
    exact, slope = 1.0 / r - 1.0, -direction / r[:, None] ** 2
    errors = []
    for tets in (4_000, 40_000):
        field = solve_harmonic(surface, midstructure, tets=tets, engine=engine)
        check_field(field)
        assert field.embedded and field.mesh.engine == engine
        w, gradient, inside = field.evaluate(direction * r[:, None])
        assert inside.all()
        off = np.linalg.norm(gradient - slope, axis=1) / np.linalg.norm(slope, axis=1)
        errors.append((np.sqrt(np.mean((w - exact) ** 2)), np.sqrt(np.mean(off**2))))
    assert errors[1][0] < 0.01 and errors[1][1] < 0.05
    assert errors[1][0] < 0.5 * errors[0][0] and errors[1][1] < 0.7 * errors[0][1]


@pytest.mark.parametrize("name", ["box", "L", "wedge", "cylinder", "sphere", "torus", "ring",
                                  "hollow sphere", "fin", "cube"])  # fmt: skip
def test_field_and_genus(name):
    field, surface = field_of(name), surface_of(name)
    check_field(field)
    assert field.mesh.volume == pytest.approx(surface.volume(), rel=0.02)
    wanted = tuple(sorted(surface.genus))
    assert field.isosurface_genus(0.02) == wanted
    level = field.largest_level(surface.genus, 0.9)
    assert field.isosurface_genus(level) == wanted
    # the thin foot of the wall is a neck where w is small
    assert level > (0.02 if name == "fin" else 0.7)


def test_box_is_linear_across_its_middle():
    field = field_of("box")
    x, y, z = np.meshgrid([1.5, 2.0, 2.5], [0.9, 1.0, 1.1], np.linspace(0.05, 0.45, 9))
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    w, gradient, inside = field.evaluate(points)
    assert inside.all()
    assert w == pytest.approx(2.0 * points[:, 2], abs=0.02)
    assert gradient == pytest.approx(np.broadcast_to([0.0, 0.0, 2.0], gradient.shape), abs=0.2)


def test_plate_of_50_to_1():
    surface, midstructure = surface_of("plate 50"), axis_of("plate 50")
    field = solve_harmonic(surface, midstructure)
    check_field(field)
    assert field.embedded
    w, _, inside = field.evaluate(np.array([[25.0, 25.0, z] for z in (0.1, 0.25, 0.75)]))
    assert inside.all() and w == pytest.approx([0.2, 0.5, 0.5], abs=0.03)
    assert field.largest_level((0,), 0.7) == pytest.approx(0.7)


def test_locate_finds_every_point():
    field = field_of("L")
    mesh = field.mesh
    rng = np.random.default_rng(0)
    tet = rng.integers(len(mesh), size=5000)
    share = rng.dirichlet(np.ones(4), size=5000)
    points = np.einsum("kj,kji->ki", share, mesh.vertices[mesh.tets[tet]])
    found, barycentric, inside = field.locate(points)
    assert inside.all()
    again = np.einsum("kj,kji->ki", barycentric, mesh.vertices[mesh.tets[found]])
    assert again == pytest.approx(points, abs=1e-9)
    linear = replace(field, w=mesh.vertices @ [1.0, -2.0, 0.5])
    assert linear.evaluate(points)[0] == pytest.approx(points @ [1.0, -2.0, 0.5], abs=1e-9)
    assert linear.tet_gradient == pytest.approx(
        np.broadcast_to([1.0, -2.0, 0.5], (len(mesh), 3)), abs=1e-6
    )
    outside = np.array([[1.5, 1.5, 0.5], [-0.1, 0.5, 0.5], [5.0, 5.0, 5.0]])
    w, _, inside = field.evaluate(outside)
    assert not inside.any() and (w < 0.0).all()


def test_isosurfaces_of_known_functions():
    x, f = icosphere(2, 3.0)
    mesh = fill(x, f, engine="netgen", max_size=0.5, optimise=False)
    p = mesh.vertices
    torus = 1.0 - np.hypot(np.hypot(p[:, 0], p[:, 1]) - 1.6, p[:, 2])
    assert genus_from_euler(isosurface_euler(mesh, torus, 0.4)) == (1,)
    two = np.maximum(*(1.0 - np.linalg.norm(p - [a, 0.0, 0.0], axis=1) for a in (-1.2, 1.2)))
    assert genus_from_euler(isosurface_euler(mesh, two, 0.1)) == (0, 0)
    shell = 1.0 - np.abs(np.linalg.norm(p, axis=1) - 1.7)
    assert genus_from_euler(isosurface_euler(mesh, shell, 0.5)) == (0, 0)
    assert genus_from_euler(isosurface_euler(mesh, shell, 2.0)) == ()


def test_maximum_principle_on_flat_tetrahedra():
    """Points in a plane layer give flat tetrahedra; w stays in [0, 1] all the same."""
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(3)
    x = rng.uniform(size=(3000, 3)) * [6.0, 6.0, 0.3]
    x[:400] *= [1.0, 1.0, 0.0]
    x[400:800] *= [1.0, 1.0, 0.0]
    x[400:800, 2] = 0.3
    tets = Delaunay(x).simplices.astype(np.int64)
    volume = np.linalg.det(x[tets[:, 1:]] - x[tets[:, :1]]) / 6.0
    tets = np.where((volume < 0)[:, None], tets[:, [0, 1, 3, 2]], tets)[np.abs(volume) > 1e-12]
    mesh = TetMesh(x, tets)
    inner = ~mesh.on_boundary & (np.abs(x[:, 2] - 0.15) < 0.02)
    field = solve_on(Domain(mesh, inner, False))
    assert mesh.min_dihedral_angles().min() < 0.5
    assert field.w.min() >= 0.0 and field.w.max() <= 1.0


def test_pieces_are_tied_together():
    """Two spots far apart in a bar: their isosurfaces near 1 are one all the same."""
    surface = surface_of("bar")
    a, f = icosphere(1, 0.15)
    vertices = np.vstack([a + [1.0, 0.5, 0.5], a + [5.0, 0.5, 0.5]])
    midstructure = midstructure_of(vertices, np.vstack([f, f + len(a)]), 0.5)
    field = solve_harmonic(surface, midstructure, tets=20_000)
    check_field(field)
    assert field.isosurface_genus(0.95) == (0,)
    alone = field.fixed & (np.abs(field.mesh.vertices[:, 0] - 3.0) > 1.5)
    assert len(tie_parts(field.mesh, field.w, alone))
    assert len(tie_parts(field.mesh, field.w, field.fixed)) == 0


def test_envelope_mesher_takes_over():
    pytest.importorskip("pytetwild")
    field = solve_harmonic(surface_of("cube"), axis_of("cube"), tets=2_000, engine="pytetwild")
    check_field(field)
    assert not field.embedded and field.mesh.engine == "pytetwild"
    assert field.mesh.volume == pytest.approx(1.0, rel=0.02)
    assert field.isosurface_genus(0.5) == (0,)
    w, _, _ = field.evaluate(np.array([[0.5, 0.5, 0.1], [0.5, 0.5, 0.5]]))
    assert 0.05 < w[0] < 0.5 and w[1] > 0.9


def test_adaptive_triangles_are_closed_and_on_the_surface():
    body = bodies.torus()
    surface = build_surface(list(body.faces))
    mesh = adaptive_triangulation(surface, lambda points: np.full(len(points), 0.3))
    ring = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) - 3.0
    assert np.hypot(ring, mesh.vertices[:, 2]) == pytest.approx(1.0, abs=1e-12)
    sides = mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    forward = {tuple(s) for s in sides.tolist()}
    assert len(forward) == len(sides) and all((b, a) in forward for a, b in forward)
    assert enclosed_volume(mesh.vertices, mesh.triangles) == pytest.approx(body.volume, rel=0.02)
    length = np.linalg.norm(mesh.vertices[sides[:, 1]] - mesh.vertices[sides[:, 0]], axis=1)
    assert length.max() < 0.5


def test_domain_without_any_mesher(monkeypatch):
    """When every mesher fails, tetrahedra are carved out of the Delaunay triangulation."""
    refused = tetmesh.door.MesherError("no")

    def fail(*_, **__):
        raise refused

    monkeypatch.setattr("HybridVolume.core.harmonic_domain.fill", fail)
    for name in ("L", "torus"):
        surface = surface_of(name)
        field = solve_harmonic(surface, axis_of(name), tets=10_000)
        check_field(field)
        assert not field.embedded and field.mesh.engine == "delaunay"
        assert field.mesh.volume == pytest.approx(surface.volume(), rel=0.02)
        assert field.isosurface_genus(0.5) == surface.genus


def test_holes_and_missing_handles_are_mended():
    """A sheet with a hole, and a ring that is not closed: the isosurfaces look like the body."""
    m = axis_of("box")
    centre = m.vertices[m.facets].mean(axis=1)
    hole = np.hypot(centre[:, 0] - 2.0, centre[:, 1] - 1.0) < 0.25
    field = solve_harmonic(surface_of("box"), replace(m, kept=m.kept & ~hole), tets=20_000)
    assert field.largest_level((0,), 0.9) == pytest.approx(0.9)
    m = axis_of("torus")
    centre = m.vertices[m.facets].mean(axis=1)
    gap = np.abs(np.arctan2(centre[:, 1], centre[:, 0])) < 0.5
    field = solve_harmonic(surface_of("torus"), replace(m, kept=m.kept & ~gap), tets=20_000)
    assert field.largest_level((1,), 0.9) == pytest.approx(0.9)


def shell_of_a_box(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([np.where(bits, high, low) for bits in np.ndindex(2, 2, 2)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([q[:3] for q in quads] + [(q[0], q[2], q[3]) for q in quads])


DRAWN = {
    "line": ([[0.6, 1, 0.5], [3.4, 1, 0.5]], [[0, 1, 1]]),
    "points": ([[1, 1, 0.5], [3, 1, 0.5]], [[0, 0, 0], [1, 1, 1]]),
    "rectangle": ([[0.5, 0.5, 0.5], [3.5, 0.5, 0.5], [3.5, 1.5, 0.5], [0.5, 1.5, 0.5]],
                  [[0, 1, 2], [0, 2, 3]]),
    "crossing": ([[0.5, 0.5, 0.5], [3.5, 0.5, 0.5], [3.5, 1.5, 0.5], [0.5, 1.5, 0.5],
                  [1, 1, 0.2], [3, 1, 0.2], [3, 1, 0.8], [1, 1, 0.8]],
                 [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]),
    "closed": shell_of_a_box(np.array([0.5, 0.5, 0.3]), np.array([3.5, 1.5, 0.7])),
}  # fmt: skip


@pytest.mark.parametrize("name", list(DRAWN))
def test_what_a_user_draws_in_a_box(name):
    """Lines, points, large triangles, crossing ones and a closed surface in a box of 4x2x1 mm."""
    vertices, facets = (np.asarray(part) for part in DRAWN[name])
    vertices = vertices.astype(float)
    m = midstructure_of(vertices, facets, 1.0)
    radius = np.minimum(vertices, np.array([4.0, 2.0, 1.0]) - vertices).min(axis=1)
    m = replace(m, radius=radius, method="own")
    field = solve_harmonic(surface_of("box"), m, tets=10_000)
    check_field(field)
    assert field.embedded
    share = np.random.default_rng(0).dirichlet(np.ones(3), size=(300, len(facets)))
    points = np.einsum("sfk,fki->sfi", share, vertices[facets]).reshape(-1, 3)
    w, _, inside = field.evaluate(points)
    # lines and points are balls, which tetrahedra only resemble
    assert inside.all() and w.min() > (0.95 if name in ("line", "points") else 0.999)
    assert field.isosurface_genus(0.5) == (0,)
    assert field.largest_level((0,), 0.9) == pytest.approx(0.9)
    if name == "closed":
        within = np.random.default_rng(1).uniform(vertices.min(axis=0), vertices.max(axis=0),
                                                  (1000, 3))  # fmt: skip
        assert field.evaluate(within)[0].min() > 0.999
