# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Polynomials on the tetrahedra of the core, whose boundary follows the shell's inner surface.

Nodes on the interface stand on the inner surface itself, at the parameters of their lattice points
in the interface's triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ..interior import Interface, Interior
from ..shell import Shell
from ..tetmesh import TetMesh
from .simplex_space import DEGREES, SimplexSpace, found_rows, lattice_keys
from .spline_space import SplineSpace
from .subdivision import interface_places, raised_simplices
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
    if degree not in DEGREES:
        raise InputError(f"degree {degree} in the core", remedy="choose 1, 2 or 3")
    spline = SplineSpace(shell)
    space, _ = unfolded(curved_tets(spline, interior.mesh, Sides.of(interface), min(degree, 2)))
    if degree > 2 and (space.jacobian_bounds > 0.0).all():
        space, _ = raised_simplices(space, spline, degree)
    check_valid(space, spline)
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


@dataclass(frozen=True)
class Sides:
    """Triangles of a core on the interface, and where their corners are on the shell.

    Attributes
    ----------
    triangles : (t, 3) int array
        Vertices of the core's mesh.
    patch : (t,) int array
    uv : (t, 3, 2) array
    w : (t, 3) array
        Parameters of the corners.
    """

    triangles: np.ndarray
    patch: np.ndarray
    uv: np.ndarray
    w: np.ndarray

    @staticmethod
    def of(interface: Interface) -> Sides:
        """Those of an interface."""
        count = len(interface.vertices)
        w = interface.vertex_w if len(interface.vertex_w) else np.ones(count)
        triangles = interface.triangles
        return Sides(triangles, interface.triangle_patch, interface.triangle_uv, w[triangles])


def curved_tets(spline: SplineSpace, mesh: TetMesh, sides: Sides, degree: int) -> TetSpace:
    """Tets whose nodes on the interface stand on the inner surface; they may be folded.

    Parameters
    ----------
    spline : SplineSpace
    mesh : TetMesh
    sides : Sides
        All triangles of its boundary.
    degree : {1, 2}
    """
    keys = lattice_keys(mesh.tets, degree)
    flat, inverse = np.unique(keys.reshape(-1, degree), axis=0, return_inverse=True)
    elements = inverse.reshape(keys.shape[:2])
    face_keys = lattice_keys(sides.triangles, degree)
    faces = found_rows(flat, face_keys.reshape(-1, degree)).reshape(face_keys.shape[:2])
    on, patch, uv, w = interface_places(faces, sides.patch, sides.uv, sides.w, degree)
    places = spline.basis_at(patch, uv, w) @ spline.control_points
    vertices = mesh.vertices.copy()
    corner = (flat[on] == flat[on, :1]).all(axis=1)
    vertices[flat[on[corner], 0]] = places[corner]
    nodes = vertices[flat].mean(axis=1)
    nodes[on] = places
    return TetSpace(
        degree, nodes, elements, on, patch, uv, w, faces, sides.patch, sides.uv, sides.w
    )
