# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The conforming mesh: on the exact surfaces, without gaps, every element proved."""

from dataclasses import replace

import numpy as np
import pytest
from shells import BODIES, exact_volume, make_shell, make_volume

from HybridVolume.core import diagonals
from HybridVolume.core import finite_elements as module
from HybridVolume.core.curving import untangle
from HybridVolume.core.density import Density
from HybridVolume.core.element_jacobians import prove_positive
from HybridVolume.core.elements import FACES, jacobians, quadrature, shape_gradients
from HybridVolume.core.finite_elements import build_finite_elements, conforming_mesh
from HybridVolume.core.remesh import remesh
from HybridVolume.errors import FaultError, MesherError

ORDERS = (1, 2)


def off_surface(name, x):
    """Distance of points to the exact boundary."""
    if name == "box":
        size = np.array([3.0, 2.0, 1.0])
        return np.minimum(np.abs(x), np.abs(x - size)).min(axis=1)
    if name == "torus":
        return np.abs(np.hypot(np.hypot(x[:, 0], x[:, 1]) - 3.0, x[:, 2]) - 1.0)
    radius = np.linalg.norm(x, axis=1)
    radii = (1.0,) if name == "sphere" else (1.0, 2.0)
    return np.abs(radius[:, None] - radii).min(axis=1)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", BODIES)
def test_outer_nodes_lie_on_the_exact_body(name, order):
    fem = make_volume(name, order).fem
    assert off_surface(name, fem.nodes[np.unique(fem.boundary)]).max() < 1e-12
    assert fem.boundary.shape[1] == fem.interface.shape[1] == 3 * order
    assert set(fem.face_names) == {p.face for p in make_shell(name).surface.patches}
    nodes = [set(fem.face_nodes(face).tolist()) for face in fem.face_names]
    assert set().union(*nodes) == set(np.unique(fem.boundary).tolist())


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", BODIES)
def test_every_outer_node_knows_its_place_on_the_surface(name, order):
    fem = make_volume(name, order).fem
    assert np.array_equal(np.sort(fem.surface_nodes), np.unique(fem.boundary))
    surface = make_shell(name).surface
    x = surface.evaluate_at(fem.surface_patch, *fem.surface_uv.T)
    assert np.array_equal(x, fem.nodes[fem.surface_nodes])


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", BODIES)
def test_every_element_is_proved_and_positive_at_samples(name, order):
    fem = make_volume(name, order).fem
    for kind, connectivity, bound, quality in (
        (fem.wedge_kind, fem.wedges, fem.wedge_bound, fem.wedge_quality),
        (fem.tet_kind, fem.tets, fem.tet_bound, fem.tet_quality),
    ):
        nodes = fem.nodes[connectivity]
        assert prove_positive(kind, nodes).proved.all()
        points, _ = quadrature(kind.rstrip("0123456789"), 4)
        assert np.linalg.det(jacobians(kind, nodes, points)).min() > 0.0
        assert bound.min() > 0.0 and quality.min() > 0.0
    assert fem.min_scaled_jacobian > 0.01


def face_rows(connectivity, faces):
    rows = [np.sort(connectivity[:, face], axis=1) for face in faces]
    return [tuple(row) for part in rows for row in part.tolist()]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", BODIES)
def test_faces_match_in_pairs_and_volumes_add_up(name, order):
    fem = make_volume(name, order).fem
    rows = face_rows(fem.wedges, FACES[fem.wedge_kind]) + face_rows(fem.tets, FACES[fem.tet_kind])
    count: dict[tuple, int] = {}
    for row in rows:
        count[row] = count.get(row, 0) + 1
    single = {row for row, times in count.items() if times == 1}
    assert max(count.values()) == 2
    assert single == set(face_rows(fem.boundary, [range(fem.boundary.shape[1])]))
    interface = set(face_rows(fem.interface, [range(fem.interface.shape[1])]))
    assert interface == set(face_rows(fem.wedges, FACES[fem.wedge_kind][:1])) & set(
        face_rows(fem.tets, FACES[fem.tet_kind])
    )
    assert len(np.unique(np.concatenate([fem.wedges.ravel(), fem.tets.ravel()]))) == len(fem.nodes)
    assert fem.volume == pytest.approx(fem.boundary_volume, rel=1e-12)


def test_boundary_triangles_are_tops_of_their_wedges():
    fem = make_volume("torus").fem
    tops = fem.wedges[fem.boundary_wedge][:, [3, 4, 5, 9, 10, 11]]
    assert np.array_equal(tops, fem.boundary)
    assert (fem.wedge_layer[fem.boundary_wedge] == 0).all()


def test_volume_converges_with_the_fourth_power():
    shell = make_shell("sphere")
    errors = []
    for parts in (1, 2):
        _, _, fem = build_finite_elements(shell, Density(subdivide=parts), finest=parts)
        errors.append(abs(fem.volume - exact_volume("sphere")))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)


def test_the_area_of_each_face_is_that_of_its_patch():
    fem = make_volume("hollow sphere").fem
    points, weights = quadrature("tri", 5)
    gradients = shape_gradients("tri6", points)
    for face in fem.face_names:
        tangents = np.einsum("qnd,tnc->tqcd", gradients, fem.nodes[fem.face_triangles(face)])
        normal = np.cross(tangents[..., 0], tangents[..., 1])
        area = np.linalg.norm(normal, axis=2) @ weights
        radius = np.linalg.norm(fem.nodes[fem.face_nodes(face)[0]])
        assert area.sum() == pytest.approx(4.0 * np.pi * radius**2 / 6.0, rel=5e-3)


def test_mid_nodes_inside_are_moved_only_where_tets_need_it():
    volume = make_volume("torus")
    fem, interface = volume.fem, volume.interface
    moved = fem.nodes[fem.interface[:, 3:]] - interface.midpoints[interface.triangle_edges]
    far = np.linalg.norm(moved, axis=2) > 1e-12
    edges = np.unique(interface.triangle_edges[far])
    assert 0 < len(edges) <= sum(fem.repairs.values())
    # a straightened node stands between the curve and the chord
    ends = interface.vertices[interface.edges[edges]].mean(axis=1)
    nodes = np.empty((len(interface.edges), 3))
    nodes[interface.triangle_edges] = fem.nodes[fem.interface[:, 3:]]
    along = nodes[edges] - interface.midpoints[edges]
    whole = ends - interface.midpoints[edges]
    share = np.einsum("ei,ei->e", along, whole) / np.einsum("ei,ei->e", whole, whole)
    assert np.allclose(along, share[:, None] * whole, atol=1e-12)
    assert share.min() > 0.4 and share.max() <= 1.0 + 1e-12
    assert not any(make_volume("box").fem.repairs.values())


def test_inverted_elements_are_untangled_and_the_outside_stays():
    fem = make_volume("sphere").fem
    elements = [("penta15", fem.wedges), ("tet10", fem.tets)]
    free = np.ones(len(fem.nodes), dtype=bool)
    free[np.unique(fem.boundary)] = False
    corners = np.unique(np.concatenate([fem.wedges[:, :6].ravel(), fem.tets[:, :4].ravel()]))
    free[corners] = False
    rng = np.random.default_rng(2)
    chosen = rng.choice(np.flatnonzero(free), 40, replace=False)
    tangled = fem.nodes.copy()
    tangled[chosen] += 0.12 * rng.normal(size=(40, 3))

    def inverted(nodes):
        return sum(int((~prove_positive(k, nodes[c]).proved).sum()) for k, c in elements)

    assert inverted(tangled) > 30
    found = untangle(tangled, elements, free)
    assert inverted(found) == 0
    assert np.array_equal(found[~free], tangled[~free])


def test_a_grid_that_fails_is_refined(monkeypatch):
    shell = make_shell("box")
    asked = []
    build = diagonals.build_interface

    def counted(shell, nodes, parts, lines, **repairs):
        asked.append(lines.cells)
        if lines.cells <= 52:
            error = MesherError("too coarse")
            error.triangles = [0]
            raise error
        return build(shell, nodes, parts, lines=lines, **repairs)

    monkeypatch.setattr(diagonals, "build_interface", counted)
    _, _, fem = build_finite_elements(shell)
    # the strips of the first cell, around the box both ways: 4 + 4 intervals of 2 + 2 faces
    assert asked[0] == 52 and asked[1] == len(fem.boundary) // 2
    assert fem.repairs["refined"] > 0 and fem.min_scaled_jacobian > 0.0
    with pytest.raises(MesherError, match="too coarse"):
        build_finite_elements(shell, finest=1)


def test_an_invalid_shell_is_refused_with_its_faces():
    shell = make_shell("box")
    layers = shell.layers.copy()
    face = shell.surface.patches[0]
    # one inner control point pulled out through its face
    middle = face.index[face.index.shape[0] // 2, face.index.shape[1] // 2]
    layers[1:, middle] += 6.0 * (layers[0, middle] - layers[-1, middle])
    broken = replace(shell, layers=layers)
    interface = make_volume("box").interface
    with pytest.raises(MesherError) as caught:
        conforming_mesh(broken, interface, make_volume("box").interior)
    assert face.face in caught.value.faces
    assert "not proved" in caught.value.message


def test_a_hole_between_elements_is_a_fault():
    fem = make_volume("box").fem
    module._check(fem)
    for broken in (
        replace(fem, tets=fem.tets[1:]),
        replace(fem, tets=np.concatenate([fem.tets, fem.tets[:1]])),
        replace(fem, wedges=fem.wedges[:, [1, 2, 0, 4, 5, 3, 7, 8, 6, 10, 11, 9, 12, 13, 14]]),
    ):
        with pytest.raises(FaultError):
            module._check(broken)


def test_another_mesh_leaves_the_shell_as_it_is():
    volume = make_volume("torus")
    density = Density(subdivide=2)
    finer = remesh(volume, density)
    assert finer.shell is volume.shell and finer.fem.density == density
    assert len(finer.fem.wedges) == 4 * len(volume.fem.wedges)
    exact = exact_volume("torus")
    assert abs(finer.fem.volume - exact) < 0.1 * abs(volume.fem.volume - exact)
    assert finer.shell.volume() + finer.interior.volume + finer.gap_volume == pytest.approx(exact)
