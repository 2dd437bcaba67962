# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Meshes of files of earlier versions, with what can be told about them since."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .columns import evaluate_columns
from .density import Density
from .finite_elements import FiniteElementMesh
from .interior import Interface
from .mid_nodes import outer_mids
from .shell import Shell

_TOLD = 1e-9
"""Distance between a node and its told place that is none, as a share of the diagonal."""


def completed(mesh: FiniteElementMesh, shell: Shell, interface: Interface) -> FiniteElementMesh:
    """A mesh as files before version 4 hold it, with what can be told about it since.

    Where its outer nodes are not where they are made now, their places stay untold.
    """
    if len(mesh.surface_nodes):
        return mesh
    mesh = replace(mesh, density=Density(interface.nodes, interface.subdivide))
    wanted = interface.triangles
    blocks = [(mesh.boundary[:, :3], wanted, interface.vertex_patch, interface.vertex_uv)]
    if mesh.order == 2:
        mids = evaluate_columns(shell, interface.edge_patch, interface.edge_uv, np.zeros(1))[0]
        _, patch, uv = outer_mids(shell, interface, mids)
        blocks.append((mesh.boundary[:, 3:], interface.triangle_edges, patch, uv))
    nodes = []
    for boundary, number, patch, _ in blocks:
        place = np.empty(len(patch), dtype=np.int64)
        place[number] = boundary
        nodes.append(place)
    number = np.concatenate(nodes)
    patch = np.concatenate([patch for _, _, patch, _ in blocks])
    uv = np.concatenate([uv for *_, uv in blocks])
    # the first versions left mid nodes of singular faces in the middle of the parameters
    off = shell.surface.evaluate_at(patch, *uv.T) - mesh.nodes[number]
    if np.abs(off).max() > _TOLD * shell.surface.diagonal:
        return mesh
    return replace(mesh, surface_nodes=number, surface_patch=patch, surface_uv=uv)
