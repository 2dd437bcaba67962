# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Recovered stress inside and on the boundary, against Lamé's sphere through CalculiX and fields
whose derivatives are known.
"""

from __future__ import annotations

import shutil
from functools import cache

import lame_sector as lame
import numpy as np
import pytest
from box_mesh import box_mesh

from HybridVolume.core.boundary_surface import Boundary, BoundarySurface, free_facets
from HybridVolume.core.exact_boundary import boundary_of
from HybridVolume.core.patch_recovery import extrapolated, smooth_inside, strain_of
from HybridVolume.core.recovery import (
    Material,
    averaged,
    in_frame,
    recover,
    rounding,
    tensor,
    von_mises,
)

needs_ccx = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is absent")


@cache
def sector(count, layers, wedges):
    """Nodes, elements, displacement and CalculiX's own stress at the nodes."""
    from HybridVolume.reproduce import calculix

    nodes, elements = lame.mesh(count, layers, wedges)
    triangles, _ = free_facets(elements)
    radius = np.linalg.norm(nodes, axis=1)
    cavity = triangles[(np.abs(radius[triangles] - lame.INNER) < 1e-9).all(axis=1)]
    held = np.zeros(len(nodes), dtype=bool)
    for axis in (0, 1):
        held |= np.abs(np.abs(nodes[:, axis]) - 0.5 * nodes[:, 2]) < 1e-9
    prescribed = np.where(held[:, None], lame.displacement(nodes), np.nan)
    solution = calculix.solve(
        nodes, elements, lame.MATERIAL, prescribed, pressures=[(cavity, lame.PRESSURE)]
    )
    return nodes, elements, solution.displacement, solution.stress


def errors(nodes, stress, where):
    """Mean square and largest error, as shares of the largest exact stress."""
    off = lame.stress(nodes[where]) - stress[where]
    size = np.sqrt(np.sum(off**2 * [1, 1, 1, 2, 2, 2], axis=1))
    largest = np.sqrt(np.sum(lame.stress(nodes) ** 2 * [1, 1, 1, 2, 2, 2], axis=1)).max()
    return np.sqrt(np.mean(size**2)) / largest, size.max() / largest


@needs_ccx
@pytest.mark.parametrize("wedges", [0, 3])
def test_the_stress_of_a_loaded_surface_is_several_times_better_than_the_solvers(wedges) -> None:
    nodes, elements, displacement, solvers = sector(3, 4, wedges)
    found = recover(nodes, elements, displacement, lame.MATERIAL)
    direct = averaged(nodes, elements, displacement, lame.MATERIAL)
    cavity = np.abs(np.linalg.norm(nodes, axis=1) - lame.INNER) < 1e-9
    ours = errors(nodes, found.stress, cavity)
    for other in (errors(nodes, solvers, cavity), errors(nodes, direct.stress, cavity)):
        assert ours[0] < 0.4 * other[0] and ours[1] < 0.6 * other[1]
    assert ours[0] < 0.02
    # hoop stress and pressure give the exact peak: 1.5 P Ro^3 / (Ro^3 - Ri^3)
    assert von_mises(found.stress[cavity]).max() == pytest.approx(1.5 * 8.0 / 7.0, rel=0.03)
    seen = in_frame(found.stress[cavity], -nodes[cavity])
    assert seen.normal == pytest.approx(-lame.PRESSURE, abs=0.01)
    assert seen.shear == pytest.approx(0.0, abs=0.015)
    assert seen.tangential == pytest.approx(5.0 / 7.0, abs=0.05)
    assert {"pressure", "free"} <= {load for _, load in found.loads}


@needs_ccx
def test_inside_patches_make_the_error_smaller() -> None:
    nodes, elements, displacement, _ = sector(4, 6, 3)
    triangles, _ = free_facets(elements)
    outside = np.zeros(len(nodes), dtype=bool)
    outside[triangles] = True
    rough = strain_of(extrapolated(nodes, elements, displacement))
    fine = smooth_inside(nodes, elements, displacement, rough, outside)
    assert (fine[outside] == rough[outside]).all()
    before = errors(nodes, lame.MATERIAL.stress(rough), ~outside)
    after = errors(nodes, lame.MATERIAL.stress(fine), ~outside)
    assert after[0] < 0.8 * before[0] and after[1] < before[1]


@needs_ccx
@pytest.mark.parametrize(
    ("scale", "away", "drift"), [(1e-3, 0.0, 0.0), (1e3, 1e6, 0.0), (1.0, 0.0, 10.0)]
)
def test_size_place_and_rigid_motion_do_not_matter(scale, away, drift) -> None:
    nodes, elements, displacement, _ = sector(3, 4, 3)
    expected = recover(nodes, elements, displacement, lame.MATERIAL)
    turn = np.cross([3e-3, -2e-3, 1e-3], nodes) * drift
    found = recover(
        scale * nodes + away, elements, scale * (displacement + turn + drift), lame.MATERIAL
    )
    assert found.stress == pytest.approx(expected.stress, abs=5e-5)
    assert found.loads == expected.loads


@needs_ccx
def test_six_printed_digits_are_enough() -> None:
    nodes, elements, displacement, _ = sector(3, 4, 3)
    expected = recover(nodes, elements, displacement, lame.MATERIAL)
    printed = np.array([float(f"{value:.5E}") for value in displacement.ravel()]).reshape(-1, 3)
    assert rounding(printed).max() > 1e3 * rounding(displacement).max()
    found = recover(nodes, elements, printed, lame.MATERIAL)
    assert found.loads == expected.loads
    assert found.stress == pytest.approx(expected.stress, abs=2e-3)


@pytest.mark.parametrize("shear", [0.0, 0.4])
def test_a_quadratic_field_is_exact_at_all_nodes(shear) -> None:
    nodes, elements = lame.cube(2, 4, 2)
    nodes = nodes @ np.array([[2.0, 0.0, 0.0], [shear, 1.0, 0.0], [0.0, shear, 0.5]])
    x, y, z = nodes.T
    displacement = np.column_stack([x * y - z**2, 2.0 * y**2 + x * z, x**2 - y * z])
    exact = np.column_stack(
        [y, 4.0 * y, -y, 0.5 * (x + z), 0.5 * (-2.0 * z + 2.0 * x), 0.5 * (x - z)]
    )
    found = recover(nodes, elements, displacement, Material(1.0, 0.3))
    assert found.strain == pytest.approx(exact, abs=1e-9)


def test_a_load_that_nothing_explains_leaves_the_strain_of_the_elements() -> None:
    mesh = box_mesh((1.0, 1.0, 1.0), [f"Face{k}" for k in range(6)])
    elements = [("penta15", mesh.wedges), ("tet10", mesh.tets)]
    displacement = np.random.default_rng(0).normal(size=mesh.nodes.shape)
    found = recover(mesh.nodes, elements, displacement, Material(1.0, 0.3))
    assert {load for _, load in found.loads} == {"unknown"}
    rough = strain_of(extrapolated(mesh.nodes, elements, displacement))
    outside = np.unique(mesh.boundary)
    assert found.strain[outside] == pytest.approx(rough[outside], rel=1e-9, abs=1e-9)


def test_a_pressure_that_is_known_is_the_stress_along_the_normal() -> None:
    # of a body at rest nothing is known but the pressures that are given
    mesh = box_mesh((2.0, 1.0, 1.0), [f"Face{k}" for k in range(6)])
    elements = [("penta15", mesh.wedges), ("tet10", mesh.tets)]
    pressure = np.where(mesh.boundary_face == 1, 5.0, np.nan)
    boundary = Boundary(mesh.boundary, mesh.boundary_face, pressure=pressure)
    found = recover(
        mesh.nodes, elements, np.zeros_like(mesh.nodes), Material(1.0, 0.0), boundary=boundary
    )
    end = np.isclose(mesh.nodes[:, 0], 2.0)
    inner = end & (np.abs(mesh.nodes[:, 1:] - 0.5) < 0.49).all(axis=1)
    assert found.stress[inner, 0] == pytest.approx(-5.0, rel=1e-3)
    assert (1, "pressure") in found.loads


def test_normals_are_those_of_the_exact_faces_on_both_sides_of_an_edge() -> None:
    pytest.importorskip("netgen")
    import shells

    volume = shells.make_volume("torus")
    exact = boundary_of(volume.fem, volume.surface, volume.interface)
    assert np.isfinite(exact.normals).all()
    surface = BoundarySurface(volume.fem.nodes, exact)
    flat = surface.position * [1.0, 1.0, 0.0]
    middle = 3.0 * flat / np.linalg.norm(flat, axis=1, keepdims=True)
    outward = surface.position - middle
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert surface.normal == pytest.approx(outward, abs=1e-12)
    # without them triangles tell the normal roughly, at sides of patches the worst
    guessed = BoundarySurface(volume.fem.nodes, Boundary(exact.triangles, exact.face)).normal
    assert 1e-3 < np.abs(guessed - outward).max() < 0.3


def test_faces_in_one_plane_stay_two_for_their_loads_and_are_one_for_the_eye() -> None:
    nodes, elements = lame.cube(2, 2, 2)
    triangles, others = free_facets(elements)
    middle = nodes[triangles].mean(axis=1)
    face = (middle[:, 2] > 0.5) * 2 + (middle[:, 0] > 0.5)
    surface = BoundarySurface(nodes, Boundary(triangles, face, others=others))
    assert surface.faces == 4
    surface.join(Boundary(triangles, face, others=others))
    assert surface.faces == 4 and surface.whole.faces == 2
    assert np.abs(surface.normal) == pytest.approx(
        np.tile([0.0, 0.0, 1.0], (len(surface.normal), 1))
    )


@needs_ccx
def test_an_uneven_load_on_a_closed_smooth_surface_is_found() -> None:
    pytest.importorskip("netgen")
    import shells

    from HybridVolume.core.density import Density
    from HybridVolume.core.finite_elements import build_finite_elements
    from HybridVolume.reproduce import calculix

    shell, material = shells.make_shell("sphere"), Material(1000.0, 0.0)
    interface, _, fem = build_finite_elements(shell, Density(subdivide=2))
    elements = [("penta15", fem.wedges), ("tet10", fem.tets)]
    # the gradient of a harmonic polynomial: no body force, tractions that change over the surface
    x, y, z = fem.nodes.T
    displacement = 1e-3 * np.column_stack([3 * x**2 - 3 * y**2, -6 * x * y, 0 * z])
    exact = np.zeros((len(x), 6))
    exact[:, 0], exact[:, 1], exact[:, 3] = 6.0 * x, -6.0 * x, -6.0 * y
    boundary = boundary_of(fem, shell.surface, interface)
    surface = BoundarySurface(fem.nodes, boundary)
    traction = np.einsum("mij,mj->mi", tensor(exact)[surface.point_node], surface.normal)
    prescribed = np.full(fem.nodes.shape, np.nan)
    for axis, components in ((0, (0, 1, 2)), (1, (0, 2)), (2, (1,))):
        node = np.argmax(fem.nodes[:, axis])
        prescribed[node, components] = displacement[node, components]
    solution = calculix.solve(
        fem.nodes, elements, material, prescribed, forces=surface.mass @ traction
    )
    found = recover(fem.nodes, elements, solution.displacement, material, boundary=boundary)
    assert {load for _, load in found.loads} == {"uneven"}
    on = np.unique(fem.boundary)
    ours, solvers = (
        np.sqrt(np.mean((stress[on] - exact[on]) ** 2))
        for stress in (found.stress, solution.stress)
    )
    assert ours < 0.5 * solvers and ours < 0.01 * 6.0


def test_the_frame_of_the_boundary_parts_normal_shear_and_tangential_stress() -> None:
    stress = np.array([[-2.0, 7.0, 3.0, 1.5, 0.0, 0.0]])
    seen = in_frame(stress, np.array([[1.0, 0.0, 0.0]]))
    assert (seen.normal[0], seen.shear[0]) == pytest.approx((-2.0, 1.5))
    assert seen.tangential[0] == pytest.approx([7.0, 3.0])
