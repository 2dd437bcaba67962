# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Finer simplices of the same core: every element is cut in its own reference coordinates.

Each element becomes 2^d that are its image, so that the core stays point for point what it was;
then the new nodes on the interface go to the inner surface, since the shell has not changed either.
That moves them by O(h^(k+1)), and elements of degree k stay as smooth as they were.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .simplex_space import (
    DIAGONALS,
    SimplexSpace,
    found_rows,
    lattice,
    lattice_keys,
    parts_of_simplex,
    shape_functions,
)
from .spline_space import SplineSpace
from .unfold import unfolded, yielded


def cut_simplices(space: SimplexSpace, spline: SplineSpace) -> tuple[SimplexSpace, int]:
    """Cut every element into 2^d; their nodes on the interface stand on the shell's boundary.

    Parameters
    ----------
    space : SimplexSpace
    spline : SplineSpace
        The shell around it (or what takes its place in the plane), of any fineness.

    Returns
    -------
    space : SimplexSpace
    moved : int
        Nodes inside that were moved since elements would have been folded.
    """
    degree, dim = space.degree, space.dimension
    # nodes of the parts are the lattice of twice the degree in the element
    keys = lattice_keys(space.elements[:, : dim + 1], 2 * degree)
    flat, inverse = np.unique(keys.reshape(-1, 2 * degree), axis=0, return_inverse=True)
    inverse = inverse.reshape(keys.shape[:2])
    values, _ = shape_functions(degree, lattice(dim, 2 * degree)[:, 1:] / (2 * degree))
    nodes = np.empty((len(flat), dim))
    nodes[inverse] = values @ space.nodes[space.elements]
    nodes[inverse[:, : dim + 1]] = space.nodes[space.elements[:, : dim + 1]]
    elements = _parts(inverse, nodes, dim, degree)

    face_keys = lattice_keys(space.faces[:, :dim], 2 * degree)
    numbers = found_rows(flat, face_keys.reshape(-1, 2 * degree)).reshape(face_keys.shape[:2])
    faces = _parts(numbers, nodes, dim - 1, degree)
    (corners,) = parts_of_simplex(dim - 1) / 2.0
    face_uv = np.einsum("pkc,fcd->fpkd", corners, space.face_uv).reshape(-1, dim, dim - 1)
    face_w = np.einsum("pkc,fc->fpk", corners, space.face_w).reshape(-1, dim)
    face_patch = np.repeat(space.face_patch, len(corners))
    on, patch, uv, w = interface_places(faces, face_patch, face_uv, face_w, degree)
    old = np.unique(space.interface)
    safe = nodes.copy()
    nodes[on] = spline.basis_at(patch, uv, w) @ spline.control_points
    # nodes that stood on the interface before keep their bits
    corner = np.intersect1d(on, inverse[:, : dim + 1])
    home = np.full(len(nodes), -1)
    home[inverse[:, : dim + 1]] = space.elements[:, : dim + 1]
    kept = corner[np.isin(home[corner], old)]
    nodes[kept] = space.nodes[home[kept]]
    fine = replace(
        space,
        nodes=nodes,
        elements=elements,
        interface=on,
        interface_patch=patch,
        interface_uv=uv,
        interface_w=w,
        faces=faces,
        face_patch=face_patch,
        face_uv=face_uv,
        face_w=face_w,
    )
    found, moved = unfolded(fine)
    if (found.jacobian_bounds > 0.0).all():
        return found, moved
    return yielded(fine, safe)


def raised_simplices(
    space: SimplexSpace, spline: SplineSpace, degree: int, light: bool = False, yields: bool = False
) -> tuple[SimplexSpace, int]:
    """The same elements with polynomials of a higher degree.

    Nodes inside stand where the map of the lower degree has them, those on the interface on the
    shell's boundary.

    Parameters and results as for :func:`cut_simplices`; ``light`` as for
    :func:`.unfold.unfolded`. With ``yields`` nodes on the interface stay on faces of the lower
    degree where elements would be folded otherwise.
    """
    dim = space.dimension
    keys = lattice_keys(space.elements[:, : dim + 1], degree)
    flat, inverse = np.unique(keys.reshape(-1, degree), axis=0, return_inverse=True)
    elements = inverse.reshape(keys.shape[:2])
    values, _ = shape_functions(space.degree, lattice(dim, degree)[:, 1:] / degree)
    nodes = np.empty((len(flat), dim))
    nodes[elements] = values @ space.nodes[space.elements]
    nodes[elements[:, : dim + 1]] = space.nodes[space.elements[:, : dim + 1]]
    face_keys = lattice_keys(space.faces[:, :dim], degree)
    faces = found_rows(flat, face_keys.reshape(-1, degree)).reshape(face_keys.shape[:2])
    sides = space.face_patch, space.face_uv, space.face_w
    on, patch, uv, w = interface_places(faces, *sides, degree)
    inside = ~np.isin(on, elements[:, : dim + 1])
    there = patch[inside], uv[inside], w[inside]
    safe = nodes.copy()
    nodes[on[inside]] = spline.basis_at(*there) @ spline.control_points
    raised = type(space)(degree, nodes, elements, on, patch, uv, w, faces, *sides)
    found, moved = unfolded(raised, light)
    if yields and not (found.jacobian_bounds > 0.0).all():
        return yielded(raised, safe)
    return found, moved


def interface_places(
    faces: np.ndarray,
    face_patch: np.ndarray,
    face_uv: np.ndarray,
    face_w: np.ndarray,
    degree: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of faces and where each is on the shell, on one of the faces that have it.

    Parameters
    ----------
    faces, face_patch, face_uv, face_w
        As in :class:`.simplex_space.SimplexSpace`.
    degree : int

    Returns
    -------
    nodes, patch : (k,) int arrays
    uv : (k, d - 1) array
    w : (k,) array
    """
    on, first = np.unique(faces, return_index=True)
    face, place = np.divmod(first, faces.shape[1])
    share = lattice(face_uv.shape[2], degree)[place] / degree
    uv = np.einsum("kc,kcd->kd", share, face_uv[face])
    return on, face_patch[face], uv, (share * face_w[face]).sum(axis=1)


def _parts(numbers: np.ndarray, nodes: np.ndarray, dim: int, degree: int) -> np.ndarray:
    """Nodes of the parts of simplices whose lattices of twice the degree are given.

    Tets are cut along the shortest diagonal.
    """
    ways = parts_of_simplex(dim)
    place = {tuple(c): k for k, c in enumerate(lattice(dim, 2 * degree).tolist())}
    counts = lattice(dim, degree)
    table = np.array([
        [[place[tuple(c)] for c in (counts @ part).tolist()] for part in way] for way in ways
    ])  # fmt: skip
    if len(ways) == 1:
        return numbers[:, table[0]].reshape(-1, len(counts))
    lengths = []
    for (a, b), (c, d) in DIAGONALS:
        first, second = np.zeros((2, dim + 1), dtype=int)
        first[[a, b]] = second[[c, d]] = degree
        ends = (nodes[numbers[:, place[tuple(end.tolist())]]] for end in (first, second))
        lengths.append(np.linalg.norm(np.subtract(*ends), axis=1))
    best = np.argmin(lengths, axis=0)
    return numbers[np.arange(len(numbers))[:, None, None], table[best]].reshape(-1, len(counts))
