# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Interface and core: exact volumes, rates of the gap, meshers that are not believed."""

from dataclasses import replace

import numpy as np
import pytest
from shells import BODIES, exact_volume, make_shell, make_volume, shell_towards

from HybridVolume.core import interior as module
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.interior import build_interface, fill_interior, gap_volume
from HybridVolume.core.surface import SplineFace
from HybridVolume.core.tetmesh import available_engines
from HybridVolume.errors import FaultError, MesherError


def volume_of(vertices, triangles):
    x = vertices[triangles]
    return np.einsum("ti,ti->", x[:, 0], np.cross(x[:, 1], x[:, 2])) / 6.0


@pytest.mark.parametrize("nodes", ["knots", "greville"])
@pytest.mark.parametrize("name", BODIES)
def test_shell_core_and_gap_are_the_body(name, nodes):
    shell = make_shell(name)
    interface = build_interface(shell, nodes)
    core = volume_of(interface.vertices, interface.triangles)
    total = shell.volume() + core + gap_volume(interface, shell)
    assert total == pytest.approx(exact_volume(name), rel=1e-9)


@pytest.mark.parametrize("name", ["torus", "sphere"])
def test_gap_shrinks_with_the_second_and_the_fourth_power(name):
    shell = make_shell(name)
    gaps = [
        [gap_volume(build_interface(shell, "knots", n), shell, curved) for n in (1, 2, 4)]
        for curved in (False, True)
    ]
    for values, rate in zip(gaps, (2.0, 4.0), strict=True):
        measured = np.log2(np.abs(values[1] / values[2]))
        assert measured == pytest.approx(rate, abs=0.25)


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("subdivide", [1, 3])
def test_triangles_are_watertight_and_do_not_straddle_knots(name, subdivide):
    shell = make_shell(name)
    interface = build_interface(shell, "knots", subdivide)
    triangles, edges = interface.triangles, interface.edges
    assert len(edges) * 2 == len(triangles) * 3
    euler = len(interface.vertices) - len(edges) + len(triangles)
    assert euler == sum(2 - 2 * g for g in shell.surface.genus)
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2)
    assert np.array_equal(ends, edges[interface.triangle_edges])
    inner = shell.inner_surface()
    for k, patch in enumerate(inner.patches):
        uv = interface.triangle_uv[interface.triangle_patch == k]
        for axis in range(2):
            lines = np.unique(patch.knots[axis])
            low = np.searchsorted(lines, uv[:, :, axis].min(axis=1) + 1e-12, side="right")
            high = np.searchsorted(lines, uv[:, :, axis].max(axis=1) - 1e-12, side="left")
            assert (low == high).all()
        for points, patches, at in (
            (interface.vertices, interface.vertex_patch, interface.vertex_uv),
            (interface.midpoints, interface.edge_patch, interface.edge_uv),
        ):
            own = patches == k
            assert np.allclose(points[own], inner.evaluate(k, *at[own].T), rtol=0, atol=1e-13)
        corner = interface.vertices[interface.triangles[interface.triangle_patch == k]]
        assert np.allclose(inner.evaluate(k, *uv.reshape(-1, 2).T), corner.reshape(-1, 3))


def test_greville_nodes_belong_to_the_control_points():
    shell = make_shell("torus")
    interface = build_interface(shell, "greville")
    mesh = shell.inner_surface().triangulation("greville")
    assert len(interface.vertices) == len(shell.surface.control_points)
    assert np.allclose(interface.vertices, mesh.vertices, rtol=0, atol=1e-13)


@pytest.mark.parametrize("engine", ["netgen", "gmsh"])
@pytest.mark.parametrize("name", BODIES)
def test_tets_keep_every_vertex_and_triangle(name, engine):
    if engine not in available_engines():
        pytest.skip(f"{engine} is not installed or left out")
    interface = build_interface(make_shell(name))
    found = fill_interior(interface, engine)
    mesh, count = found.mesh, len(interface.vertices)
    assert mesh.vertices[:count].tobytes() == interface.vertices.tobytes()
    x = mesh.vertices[mesh.tets]
    volumes = np.linalg.det(x[:, 1:] - x[:, :1]) / 6.0
    assert volumes.min() > 0.0
    wanted = volume_of(interface.vertices, interface.triangles)
    assert volumes.sum() == pytest.approx(wanted, rel=1e-12)
    assert found.volume == pytest.approx(wanted, rel=1e-12)
    faces = np.sort(mesh.tets[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3))
    unique, times = np.unique(faces, axis=0, return_counts=True)
    assert np.array_equal(unique[times == 1], np.unique(np.sort(interface.triangles), axis=0))
    assert found.boundary_exact and found.min_dihedral > 1.0


def lying(change):
    fill = module.fill

    def liar(*arguments, **options):
        return change(fill(*arguments, **options))

    return liar


@pytest.mark.parametrize(
    "change",
    [
        lambda mesh: replace(mesh, tets=mesh.tets[1:]),
        lambda mesh: replace(mesh, tets=mesh.tets[:, [0, 1, 3, 2]]),
        lambda mesh: replace(mesh, vertices=np.nextafter(mesh.vertices, 9.0)),
        lambda mesh: replace(mesh, vertices=mesh.vertices[::-1].copy()),
    ],
    ids=["a tet lost", "mirrored", "moved by one bit", "renumbered"],
)
def test_a_mesher_that_lies_is_a_fault(monkeypatch, change):
    monkeypatch.setattr(module, "fill", lying(change))
    with pytest.raises(FaultError):
        fill_interior(build_interface(make_shell("box")))


def test_flat_tets_send_the_work_to_the_next_mesher(monkeypatch):
    interface = build_interface(make_shell("box"))
    good = module.fill(interface.vertices, interface.triangles, engine="netgen")
    # a tet on four nodes of a plane face, as meshers leave them where they recover triangles
    flat = replace(good, tets=good.tets.copy())
    a, b, c = interface.triangles[0]
    plane = np.ptp(interface.vertices[[a, b, c]], axis=0).argmin()
    level = interface.vertices[:, plane] == interface.vertices[a, plane]
    fourth = np.setdiff1d(np.flatnonzero(level), [a, b, c])[0]
    flat.tets[0] = [a, b, c, fourth]
    answers = {"first": flat, "second": good}
    monkeypatch.setattr(module, "available_engines", lambda free=None: tuple(answers))
    monkeypatch.setattr(module, "fill", lambda *_, engine, **__: answers[engine])
    monkeypatch.setattr(module, "improve", lambda mesh: mesh)
    monkeypatch.setattr(
        module, "checked_interior", lambda mesh, _: module.Interior(mesh, 1.0, 9.0, True)
    )
    assert fill_interior(interface).mesh is good
    answers.pop("second")
    with pytest.raises(MesherError, match="flat"):
        fill_interior(interface)


def test_facets_that_cut_each_other_are_named():
    body, _ = BODIES["hollow sphere"]
    surface = build_surface(list(body().faces))

    def target(points):
        length = np.linalg.norm(points, axis=1, keepdims=True)
        # the cavity's shell grows to a ball, the outer one to an ellipsoid that leaves it
        return np.where(length > 1.5, points * [0.6, 0.85, 0.85], 1.5 * points)

    interface = build_interface(shell_towards(surface, target))
    with pytest.raises(MesherError) as caught:
        fill_interior(interface, surface=surface)
    assert caught.value.faces and "cut each other" in caught.value.message


def test_a_grid_that_is_too_coarse_says_so():
    # two patches on the same four sides: their triangles would have the same corners
    points = np.stack([*np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), np.zeros((3, 3))], axis=-1)
    knots = np.repeat([0.0, 1.0], 3)
    faces = []
    for name, height in (("Top", 1.0), ("Bottom", -1.0)):
        bent = points.copy()
        bent[1, 1, 2] = height
        faces.append(SplineFace(name, (2, 2), (knots, knots), bent, np.ones((3, 3))))
    shell = shell_towards(build_surface(faces), lambda x: 0.5 * x)
    with pytest.raises(MesherError, match="coarse") as caught:
        build_interface(shell)
    assert set(caught.value.faces) == {"Top", "Bottom"}
    assert len(build_interface(shell, subdivide=2).vertices) == 10


def test_pipeline_figures_add_up():
    volume = make_volume("torus")
    total = volume.shell.volume() + volume.interior.volume + volume.gap_volume
    assert total == pytest.approx(exact_volume("torus"), rel=1e-9)
