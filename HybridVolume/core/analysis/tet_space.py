# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Polynomials on the tetrahedra of the core, whose boundary follows the shell's inner surface.

Nodes on the interface stand on the inner surface itself, at the parameters of their lattice points
in the interface's triangles.
"""

from __future__ import annotations

import numpy as np

from ...errors import InputError
from ..columns import evaluate_columns
from ..interior import Interface, Interior
from ..shell import Shell
from .simplex_space import DEGREES, SimplexSpace, found_rows, lattice, lattice_keys


class TetSpace(SimplexSpace):
    """Polynomials of one degree on curved tets; see :class:`.simplex_space.SimplexSpace`."""


def tet_space(shell: Shell, interface: Interface, interior: Interior, degree: int = 2) -> TetSpace:
    """Polynomials on the tets of a core.

    Parameters
    ----------
    shell : Shell
    interface : Interface
    interior : Interior
        Its first vertices are those of the interface.
    degree : {1, 2, 3}

    Raises
    ------
    InputError
        The degree is another, or a tet is folded by the curved interface; its faces are named.
    """
    if degree not in DEGREES:
        raise InputError(f"degree {degree} in the core", remedy="choose 1, 2 or 3")
    mesh = interior.mesh
    keys = lattice_keys(mesh.tets, degree)
    flat, inverse = np.unique(keys.reshape(-1, degree), axis=0, return_inverse=True)
    elements = inverse.reshape(keys.shape[:2])
    nodes = mesh.vertices[flat].mean(axis=1)
    corners = np.full(len(mesh.vertices), -1)
    at_corner = (flat == flat[:, :1]).all(axis=1)
    corners[flat[at_corner, 0]] = np.flatnonzero(at_corner)
    nodes[corners] = mesh.vertices

    triangle_keys = lattice_keys(interface.triangles, degree)
    faces = found_rows(flat, triangle_keys.reshape(-1, degree)).reshape(triangle_keys.shape[:2])
    on, first = np.unique(faces, return_index=True)
    triangle, place = np.divmod(first, faces.shape[1])
    share = lattice(2, degree)[place] / degree
    patch = interface.triangle_patch[triangle]
    uv = np.einsum("kc,kcd->kd", share, interface.triangle_uv[triangle])
    reach = interface.vertex_w if len(interface.vertex_w) else np.ones(len(interface.vertices))
    face_w = reach[interface.triangles]
    w = (share * face_w[triangle]).sum(axis=1)
    straight = nodes.copy()
    nodes[on] = evaluate_columns(shell, patch, uv, w[None])[0]
    # the mesh's own vertices keep their bits
    vertices = corners[: len(interface.vertices)]
    nodes[vertices] = interface.vertices
    if degree == 3:
        _centre_faces(nodes, straight, flat, on)
    space = TetSpace(
        degree,
        nodes,
        elements,
        on,
        patch,
        uv,
        w,
        faces,
        interface.triangle_patch,
        interface.triangle_uv,
        face_w,
    )
    folded = np.flatnonzero(space.jacobian_bounds <= 0.0)
    if len(folded):
        near = np.isin(interface.triangles, mesh.tets[folded]).any(axis=1)
        patches = np.unique(interface.triangle_patch[near])
        raise InputError(
            f"{len(folded)} tetrahedra of degree {degree} are folded by the curved interface",
            faces=list(dict.fromkeys(shell.surface.patches[k].face for k in patches)),
            figure=float(len(folded)),
            remedy="refine the shell, or choose linear tetrahedra",
        )
    return space


def _centre_faces(
    nodes: np.ndarray, straight: np.ndarray, flat: np.ndarray, interface: np.ndarray
) -> None:
    """Move the nodes in faces beside the interface, so that cubic tets stay smooth inside.

    A face's node follows the nodes of its edges such that quadratic maps are kept.
    """
    corner = (np.diff(flat, axis=1) != 0).all(axis=1)
    corner[interface] = False
    inside = np.flatnonzero(corner)
    a, b, c = flat[inside].T
    edges = np.concatenate(
        [np.sort(np.column_stack(t), axis=1)
         for t in ((a, a, b), (a, b, b), (b, b, c), (b, c, c), (a, a, c), (a, c, c))]
    )  # fmt: skip
    moved = (nodes - straight)[found_rows(flat, edges)].reshape(6, -1, 3)
    nodes[inside] += 0.25 * moved.sum(axis=0)
