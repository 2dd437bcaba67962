# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The outer boundary of a finite element mesh with the exact normals of its NURBS faces."""

from __future__ import annotations

import numpy as np

from .boundary_surface import Boundary
from .elements import reference, shape_gradients
from .finite_elements import FiniteElementMesh
from .interior import Interface
from .surface import PatchSurface

_NEAR = 1e-6
"""Distance, as a share of the diagonal, up to which parameters belong to a node."""
_OPPOSITE = 0.5
"""Least cosine between an exact normal and that of the triangle."""
_SINGULAR = 1e-6
"""Area element, as a share of the largest, below which a surface has no normal."""


def boundary_of(
    mesh: FiniteElementMesh,
    surface: PatchSurface,
    interface: Interface | None = None,
    pressure: np.ndarray | None = None,
) -> Boundary:
    """Boundary of a mesh for `HybridVolume.core.recovery.recover`.

    Parameters
    ----------
    mesh : FiniteElementMesh
    surface : PatchSurface
        The shell's.
    interface : Interface, optional
        Of the same mesh; with it nodes on sides of patches have the normals of all of them.
    pressure : (nf,) array, optional
        MPa, where it is known; see `Boundary`.
    """
    triangles = mesh.boundary
    normals = np.full((*triangles.shape, 3), np.nan)
    if interface is not None and len(interface.triangles) == len(triangles):
        uv = interface.triangle_uv
        if mesh.order == 2:
            uv = np.concatenate([uv, 0.5 * (uv + uv[:, [1, 2, 0]])], axis=1)
        patch = np.repeat(interface.triangle_patch[:, None], triangles.shape[1], axis=1)
        _fill(normals, mesh, surface, patch, uv)
    place = np.full(len(mesh.nodes), -1)
    place[mesh.surface_nodes] = np.arange(len(mesh.surface_nodes))
    row = place[triangles]
    if len(mesh.surface_nodes):
        patch = np.where(row >= 0, mesh.surface_patch[row], -1)
        number = {name: k for k, name in enumerate(mesh.face_names)}
        names = np.array([number[p.face] for p in surface.patches])
        same = (patch >= 0) & (names[patch] == mesh.boundary_face[:, None])
        _fill(normals, mesh, surface, np.where(same, patch, -1), mesh.surface_uv[row])
    return Boundary(triangles, mesh.boundary_face, normals, pressure=pressure)


def _fill(
    normals: np.ndarray,
    mesh: FiniteElementMesh,
    surface: PatchSurface,
    patch: np.ndarray,
    uv: np.ndarray,
) -> None:
    """Write normals at the parameters of nodes of triangles where there are none yet."""
    row, column = np.nonzero(np.isnan(normals[..., 0]) & (patch >= 0))
    u, v = uv[row, column].T
    x, x_u, x_v = surface.evaluate_at(patch[row, column], u, v, derivative=1)
    normal = np.cross(x_u, x_v)
    length = np.linalg.norm(normal, axis=1)
    normal = normal / np.where(length > 0.0, length, 1.0)[:, None]
    gradients = shape_gradients(mesh.face_kind, reference(mesh.face_kind).nodes)
    corners = mesh.nodes[mesh.boundary[row]]
    tangents = np.einsum("rnc,rnd->rcd", corners, gradients[column])
    flat = np.cross(tangents[..., 0], tangents[..., 1])
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), np.finfo(float).tiny)
    cosine = np.sum(normal * flat, axis=1)
    at = mesh.nodes[mesh.boundary[row, column]]
    good = np.linalg.norm(x - at, axis=1) <= _NEAR * surface.diagonal
    good &= (length > _SINGULAR * length.max(initial=0.0)) & (np.abs(cosine) > _OPPOSITE)
    normals[row[good], column[good]] = (normal * np.sign(cosine)[:, None])[good]
