# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Meshes of other meshers lie on the body, keep its faces' names, and are graded as asked."""

import importlib.util

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.element_jacobians import volumes
from HybridVolume.core.tetmesh import free_only
from HybridVolume.errors import InputError, MesherError
from HybridVolume.reproduce.fem_rivals import Sizes, layered_mesh, tet10_mesh

pytestmark = pytest.mark.skipif(
    free_only() or not all(importlib.util.find_spec(name) for name in ("gmsh", "netgen")),
    reason="needs gmsh and netgen",
)


@pytest.fixture(scope="module")
def hollow():
    """The body between the spheres of the radii 1 and 2."""
    return build_surface(list(bodies.hollow_sphere().faces))


def off_spheres(mesh):
    nodes = np.unique(np.concatenate([rows.ravel() for _, rows in mesh.faces.values()]))
    radius = np.linalg.norm(mesh.nodes[nodes], axis=1)
    return np.minimum(np.abs(radius - 1.0), np.abs(radius - 2.0)).max()


def edge_lengths(mesh, name):
    corners = mesh.nodes[mesh.faces[name][1][:, :3]]
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)


@pytest.mark.parametrize("mesher", ["gmsh", "netgen"])
def test_graded_tets_of_a_body_with_a_cavity(hollow, mesher):
    inner = [
        patch.face
        for k, patch in enumerate(hollow.patches)
        if np.linalg.norm(hollow.evaluate_at(np.array([k]), np.array([0.5]), np.array([0.5]))) < 1.5
    ]
    assert len(inner) == 6
    mesh = tet10_mesh(hollow, Sizes(0.3, 1.5, tuple(inner)), mesher)
    assert set(mesh.faces) == {patch.face for patch in hollow.patches}
    assert off_spheres(mesh) < 1e-12
    near = np.mean([edge_lengths(mesh, name).mean() for name in inner])
    far = np.mean([edge_lengths(mesh, name).mean() for name in mesh.faces if name not in inner])
    assert 0.2 < near < 0.4
    assert far > 1.5 * near


def test_layers_are_wedges_of_the_heights_asked(hollow):
    mesh = layered_mesh(hollow, Sizes(0.4), (0.02, 0.03))
    kinds = dict(mesh.elements)
    assert off_spheres(mesh) < 1e-12
    wedges = kinds["penta15"]
    upright = np.linalg.norm(mesh.nodes[wedges[:, :3]] - mesh.nodes[wedges[:, 3:6]], axis=2)
    assert np.median(np.minimum(abs(upright - 0.02), abs(upright - 0.03))) < 2e-3
    filled = sum(volumes(kind, mesh.nodes[rows]).sum() for kind, rows in mesh.elements)
    assert filled == pytest.approx(4.0 / 3.0 * np.pi * 7.0, rel=2e-3)
    # mid nodes of upright edges are shared by the wedges around
    assert len(np.unique(wedges[:, 12:])) < wedges[:, 12:].size / 4


def test_what_cannot_be_made_is_said(hollow):
    with pytest.raises(InputError, match="no such face"):
        tet10_mesh(hollow, Sizes(0.3, 1.0, ("Face99",)))
    with pytest.raises(MesherError, match="no end within"):
        tet10_mesh(hollow, Sizes(0.3), time_limit=0.05)
