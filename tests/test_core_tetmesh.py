# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Meshers keep what they are given, and their failures become errors."""

from __future__ import annotations

import numpy as np
import pytest

from HybridVolume.core import tetmesh
from HybridVolume.core.tetmesh import TetMesh, door, fill
from HybridVolume.core.tetmesh.mesh import FACES, row_keys
from HybridVolume.core.tetmesh.split import refine, separate_boundary
from HybridVolume.errors import MesherError, SetupError

CONFORMING = [name for name in tetmesh.available_engines() if name != "pytetwild"]


def icosphere(rounds: int, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of a sphere, oriented outward."""
    t = (1.0 + 5.0**0.5) / 2.0
    x = np.array(
        [[-1, t, 0], [1, t, 0], [-1, -t, 0], [1, -t, 0], [0, -1, t], [0, 1, t], [0, -1, -t],
         [0, 1, -t], [t, 0, -1], [t, 0, 1], [-t, 0, -1], [-t, 0, 1]]
    )  # fmt: skip
    f = np.array(
        [[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4],
         [11, 10, 2], [10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8],
         [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1]]
    )  # fmt: skip
    for _ in range(rounds):
        sides = np.sort(f[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        pairs, inverse = np.unique(sides, axis=0, return_inverse=True)
        m = inverse.reshape(-1, 3) + len(x)
        x = np.vstack([x, x[pairs].mean(axis=1)])
        a, b, c = f.T
        f = np.vstack(
            [np.column_stack(p) for p in
             ((a, m[:, 0], m[:, 2]), (b, m[:, 1], m[:, 0]), (c, m[:, 2], m[:, 1]), m.T)]
        )  # fmt: skip
    return radius * x / np.linalg.norm(x, axis=1, keepdims=True), f


def polyhedron_volume(x: np.ndarray, f: np.ndarray) -> float:
    return float(np.linalg.det(x[f]).sum() / 6.0)


def triangle_set(triangles: np.ndarray) -> set:
    return {tuple(sorted(row)) for row in triangles.tolist()}


def all_faces(mesh: TetMesh) -> set:
    return triangle_set(mesh.tets[:, FACES].reshape(-1, 3))


def concentric(inner: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, f = icosphere(2)
    y, g = icosphere(1, inner)
    return np.vstack([x, y]), f, g + len(x)


def test_derived_arrays_of_a_cube():
    x = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=float)
    # six tetrahedra around the diagonal from 0 to 7
    paths = [(1, 3), (1, 5), (2, 3), (2, 6), (4, 5), (4, 6)]
    tets = np.array([[0, a, b, 7] for a, b in paths])
    flip = np.linalg.det(x[tets[:, 1:]] - x[tets[:, :1]]) < 0
    tets[flip] = tets[flip][:, [0, 2, 1, 3]]
    mesh = TetMesh(x, tets)
    assert mesh.volumes == pytest.approx(np.full(6, 1 / 6))
    assert len(mesh.boundary_triangles) == 12
    assert polyhedron_volume(x, mesh.boundary_triangles) == pytest.approx(1.0)
    assert len(mesh.edges) == 19 and len(mesh.boundary_edges) == 18
    assert (mesh.neighbours >= 0).sum() == 12
    assert mesh.min_dihedral_angles() == pytest.approx(np.full(6, 45.0))


@pytest.mark.parametrize("engine", CONFORMING)
def test_boundary_is_kept_exactly(engine):
    x, f = icosphere(2)
    mesh = fill(x, f, engine=engine)
    assert mesh.engine == engine and mesh.exact
    assert np.array_equal(mesh.vertices[: len(x)], x)
    assert triangle_set(mesh.boundary_triangles) == triangle_set(f)
    assert mesh.volumes.min() > 0.0
    assert mesh.volume == pytest.approx(polyhedron_volume(x, f), rel=1e-12)
    assert mesh.min_dihedral_angles().min() > 5.0


@pytest.mark.parametrize("engine", CONFORMING)
def test_cavity_stays_empty(engine):
    x, f, g = concentric(0.5)
    mesh = fill(x, np.vstack([f, g[:, ::-1]]), engine=engine)
    wanted = polyhedron_volume(x, f) - polyhedron_volume(x, g)
    assert mesh.volume == pytest.approx(wanted, rel=1e-12)
    assert np.linalg.norm(mesh.vertices, axis=1).min() > 0.4


@pytest.mark.parametrize("engine", CONFORMING)
def test_two_solids_and_a_cavity_in_the_second(engine):
    x, f, g = concentric(0.5)
    other, h = icosphere(1)
    vertices = np.vstack([x, other + [5.0, 0.0, 0.0]])
    triangles = np.vstack([h + len(x), f, g[:, ::-1]])
    mesh = fill(vertices, triangles, engine=engine)
    wanted = polyhedron_volume(other, h) + polyhedron_volume(x, f) - polyhedron_volume(x, g)
    assert mesh.volume == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("engine", CONFORMING)
def test_inner_facets_become_faces(engine, closed):
    x, f, g = concentric(0.5)
    facets = g if closed else g[2:]
    mesh = fill(x, f, facets=facets, engine=engine)
    assert triangle_set(facets) <= all_faces(mesh)
    assert triangle_set(mesh.boundary_triangles) == triangle_set(f)
    assert mesh.volume == pytest.approx(polyhedron_volume(x, f), rel=1e-12)


@pytest.mark.parametrize("engine", CONFORMING)
def test_smaller_size_gives_more_tetrahedra(engine):
    x, f = icosphere(2)
    coarse = fill(x, f, engine=engine, optimise=False)
    fine = fill(x, f, engine=engine, max_size=0.17, optimise=False)
    assert len(fine) > 2 * len(coarse)
    a, b = fine.vertices[fine.edges].swapaxes(0, 1)
    inner = ~fine.on_boundary[fine.edges].any(axis=1)
    assert np.median(np.linalg.norm(b - a, axis=1)[inner]) < 0.25


@pytest.mark.parametrize("engine", CONFORMING)
def test_surface_that_cuts_itself_is_an_error(engine):
    x, f = icosphere(2)
    x[20] *= -2.0
    with pytest.raises(MesherError, match=engine):
        fill(x, f, engine=engine)


def test_netgen_without_tetrahedra_is_an_error():
    """Netgen says nothing and gives nothing: that must not look like an empty success."""
    x, f = icosphere(2)
    x[[3, 60]] = x[[60, 3]]
    with pytest.raises(MesherError, match="no tetrahedra"):
        fill(x, f, engine="netgen")


def test_pytetwild_fills_what_cuts_itself():
    pytest.importorskip("pytetwild")
    x, f = icosphere(1)
    y = x + [0.9, 0.0, 0.0]
    mesh = fill(np.vstack([x, y]), np.vstack([f, f + len(x)]), engine="pytetwild", optimise=False)
    assert not mesh.exact and mesh.volumes.min() > 0.0
    one = polyhedron_volume(x, f)
    assert 1.2 * one < mesh.volume < 1.9 * one


def test_open_surface_is_an_error():
    x, f = icosphere(1)
    with pytest.raises(MesherError, match="do not close"):
        fill(x, f[1:])
    with pytest.raises(MesherError, match="do not close"):
        fill(x, np.vstack([f, f[:1]]))


def test_time_limit():
    x, f = icosphere(1)
    with pytest.raises(MesherError, match=r"no answer within 0\.01 s"):
        fill(x, f, engine="netgen", time_limit=0.01)


def test_crash_is_an_error(tmp_path, monkeypatch):
    script = tmp_path / "python"
    script.write_text("#!/bin/sh\nkill -11 $$\n")
    script.chmod(0o755)
    monkeypatch.setattr(door, "interpreter", lambda: str(script))
    x, f = icosphere(1)
    with pytest.raises(MesherError, match=r"netgen crashed \(signal 11\)"):
        fill(x, f, engine="netgen")


def test_wrong_answers_are_found():
    x, f = icosphere(1)
    mesh = fill(x, f, engine="netgen")
    none = np.zeros((0, 3), dtype=np.int64)
    check = door._checked
    assert len(check("netgen", x, f, none, mesh.vertices, mesh.tets)) == len(mesh)
    with pytest.raises(MesherError, match="boundary triangles"):
        check("netgen", x, f, none, mesh.vertices, mesh.tets[1:])
    with pytest.raises(MesherError, match="given vertices"):
        check("netgen", x, f, none, mesh.vertices + 1e-15, mesh.tets)
    with pytest.raises(MesherError, match="lost 1 inner"):
        check("netgen", x, f, np.array([[0, 1, 40]]), mesh.vertices, mesh.tets)
    # numbered the other way round: put right, bit for bit
    turned = check("netgen", x, f, none, mesh.vertices[::-1], len(mesh.vertices) - 1 - mesh.tets)
    assert np.array_equal(turned.vertices[: len(x)], x)


def test_free_parts_only(monkeypatch):
    monkeypatch.setenv("HYBRIDVOLUME_FREE_ONLY", "1")
    assert "gmsh" not in tetmesh.available_engines()
    x, f = icosphere(1)
    assert fill(x, f).engine == "netgen"
    with pytest.raises(SetupError, match="gmsh"):
        fill(x, f, engine="gmsh")


def test_splitting_keeps_volume_sheet_and_separates_the_boundary():
    # a plate of two layers of nothing: every vertex of the coarse mesh is on the boundary
    x = np.array([[i, j, k] for i in range(5) for j in range(5) for k in range(2)], dtype=float)
    quads = []
    for i in range(4):
        for j in range(4):
            a, b, c, d = (
                10 * p + 2 * q for p, q in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
            )
            quads += [[d, c, b, a], [a + 1, b + 1, c + 1, d + 1]]
        a, b = 10 * i, 10 * (i + 1)
        quads += [[a, b, b + 1, a + 1], [b + 8, a + 8, a + 9, b + 9]]
        a, b = 2 * i, 2 * (i + 1)
        quads += [[b, a, a + 1, b + 1], [a + 40, b + 40, b + 41, a + 41]]
    quads = np.array(quads)
    f = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    mesh = fill(x, f, engine="netgen", optimise=False)
    assert mesh.on_boundary[mesh.tets].all(axis=1).any()
    apart, _ = separate_boundary(mesh)
    assert not apart.on_boundary[apart.tets].all(axis=1).any()
    inner = apart.edges[~np.isin(
        row_keys(apart.edges, len(apart.vertices)),
        row_keys(apart.boundary_edges, len(apart.vertices)),
    )]  # fmt: skip
    assert not apart.on_boundary[inner].all(axis=1).any()
    assert apart.volume == pytest.approx(16.0, rel=1e-12) and apart.volumes.min() > 0.0

    y, f, g = concentric(0.5)
    mesh = fill(y, f, facets=g[2:], engine="netgen")
    fine, facets = refine(mesh, lambda points: np.full(len(points), 0.15), g[2:])
    assert fine.volume == pytest.approx(mesh.volume, rel=1e-12)
    assert triangle_set(facets) <= all_faces(fine)
    a, b = fine.vertices[fine.edges].swapaxes(0, 1)
    assert np.linalg.norm(b - a, axis=1).max() < 0.3

    single = TetMesh(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]]))
    assert len(separate_boundary(single)[0]) == 4
