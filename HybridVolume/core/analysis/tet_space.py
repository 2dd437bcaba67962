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
from .simplex_space import DEGREES, SimplexSpace, found_rows, lattice_keys
from .spline_space import SplineSpace
from .subdivision import interface_places
from .unfold import unfolded


class TetSpace(SimplexSpace):
    """Polynomials of one degree on curved tets; see :class:`.simplex_space.SimplexSpace`."""


def tet_space(shell: Shell, interface: Interface, interior: Interior, degree: int = 2) -> TetSpace:
    """Polynomials on the tets of a core, whose inner nodes give way to the curved interface.

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
        The degree is another, or tets stay folded by the curved interface; their faces are named.
        :func:`.hybrid_space.hybrid_space` cuts tets and interface then.
    """
    space, _ = unfolded(curved_tets(shell, interface, interior, degree))
    check_valid(space, SplineSpace(shell))
    return space


def check_valid(space: SimplexSpace, spline: SplineSpace) -> None:
    """Refuse a space with elements that are not proved valid.

    Parameters
    ----------
    space : SimplexSpace
    spline : SplineSpace
        Knows the names of the faces over them.

    Raises
    ------
    InputError
        The CAD faces over them are named.
    """
    folded = np.flatnonzero(space.jacobian_bounds <= 0.0)
    if len(folded):
        dim = space.dimension
        near = np.isin(space.faces[:, :dim], space.elements[folded, : dim + 1]).any(axis=1)
        names = spline.patch_faces
        raise InputError(
            f"{len(folded)} elements of degree {space.degree} in the core are folded by the curved"
            " interface",
            faces=list(dict.fromkeys(names[k] for k in np.unique(space.face_patch[near]))),
            figure=float(len(folded)),
            remedy="refine the shell, or choose linear tetrahedra",
        )


def curved_tets(
    shell: Shell, interface: Interface, interior: Interior, degree: int = 2
) -> TetSpace:
    """Tets whose nodes on the interface stand on the inner surface; they may be folded.

    Parameters and what is refused as for :func:`tet_space`.
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
    reach = interface.vertex_w if len(interface.vertex_w) else np.ones(len(interface.vertices))
    sides = interface.triangle_patch, interface.triangle_uv, reach[interface.triangles]
    on, patch, uv, w = interface_places(faces, *sides, degree)
    straight = nodes.copy()
    nodes[on] = evaluate_columns(shell, patch, uv, w[None])[0]
    # the mesh's own vertices keep their bits
    vertices = corners[: len(interface.vertices)]
    nodes[vertices] = interface.vertices
    if degree == 3:
        _centre_faces(nodes, straight, flat, on)
    return TetSpace(degree, nodes, elements, on, patch, uv, w, faces, *sides)


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
