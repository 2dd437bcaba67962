# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What a polygon mesh has twice: corners, vertices at one place, faces, whole parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..errors import InputError
from .polygons import PolygonMesh, have, number_of, some

_WELD = 1e-5
"""Share of the diagonal within which vertices of open edges are one, and of these edges..."""
_WELD_SIDE = 0.05
"""...the share that it must be below."""


def without_repeats(mesh: PolygonMesh) -> PolygonMesh:
    """Without corners that repeat the one before.

    Parameters
    ----------
    mesh : PolygonMesh

    Raises
    ------
    InputError
        A face has fewer than three different corners.
    """
    twice = mesh.corners == mesh.following
    if not twice.any():
        return mesh
    sizes = np.bincount(mesh.face_of[~twice], minlength=len(mesh))
    faces = np.unique(mesh.face_of[twice])
    few = faces[sizes[faces] < 3]
    if len(few):
        raise InputError(
            f"{some('face', mesh.face_number[few])} {have(few)} fewer than three different corners",
            figure=float(len(few)),
            remedy="remove them in the program that the mesh is from",
        )
    note = f"{some('face', mesh.face_number[faces])}: corners that stood twice were left out"
    return replace(
        mesh,
        corners=mesh.corners[~twice],
        start=np.concatenate([[0], np.cumsum(sizes)]),
        notes=(*mesh.notes, note),
    )


def welded(mesh: PolygonMesh) -> PolygonMesh:
    """With one vertex where several are at one place, as split vertices are, if edges are open.

    Parameters
    ----------
    mesh : PolygonMesh
        Exactly equal vertices are joined everywhere, those of open edges also where rounding has
        parted them.
    """
    if not _open_count(mesh):
        return mesh
    _, inverse = np.unique(mesh.vertices, axis=0, return_inverse=True)
    mesh = _joined_vertices(mesh, inverse.reshape(-1), "lay on")
    ends, edge = mesh.edges
    rims = ends[np.bincount(edge) == 1]
    if not len(rims):
        return mesh
    # those that rounding has parted
    sides = np.linalg.norm(mesh.vertices[rims[:, 0]] - mesh.vertices[rims[:, 1]], axis=1)
    rim = np.unique(rims)
    span = np.linalg.norm(np.ptp(mesh.vertices[rim], axis=0))
    reach = min(_WELD * span, _WELD_SIDE * sides.min())
    pairs = rim[cKDTree(mesh.vertices[rim]).query_pairs(reach, output_type="ndarray")]
    n = len(mesh.vertices)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (n, n))
    joined = _joined_vertices(mesh, connected_components(graph, directed=False)[1], "lay beside")
    return joined if _open_count(joined) < len(rims) else mesh


def _joined_vertices(mesh: PolygonMesh, label: np.ndarray, how: str) -> PolygonMesh:
    """With one vertex, the first, for all of one label (n,)."""
    _, first, label = np.unique(label, return_index=True, return_inverse=True)
    count = len(label) - len(first)
    if not count:
        return mesh
    label = label.reshape(-1)
    return replace(
        mesh,
        vertices=mesh.vertices[first],
        corners=label[mesh.corners],
        creases=np.sort(label[mesh.creases], axis=1),
        points=label[mesh.points],
        vertex_number=mesh.vertex_number[first],
        notes=(*mesh.notes, f"{number_of(count, 'vertex')} that {how} others joined with them"),
    )


def without_doubles(mesh: PolygonMesh) -> PolygonMesh:
    """Without faces, and without whole parts of the surface, that are there twice.

    Parameters
    ----------
    mesh : PolygonMesh
    """
    notes = mesh.notes
    _, edge = mesh.edges
    # all edges of a face too many have too many faces
    least = np.minimum.reduceat(np.bincount(edge)[edge], mesh.start[:-1])
    double = (_first_alike(mesh, mesh.corners) != np.arange(len(mesh))) & (least > 2)
    if double.any():
        notes = (*notes, f"{some('face', mesh.face_number[double])}: there twice, left out once")
        mesh = replace(mesh.take(np.flatnonzero(~double)), notes=notes)
    parts = components(mesh)
    if len(parts) == 1:
        return mesh
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    part = np.empty(len(mesh), dtype=np.int64)
    for k, members in enumerate(parts):
        part[members] = k
    first = _first_alike(mesh, place.reshape(-1)[mesh.corners])
    alone = np.bincount(part[part[first] == part], minlength=len(parts)) > 0
    if alone.all():
        return mesh
    again = [
        f"the {len(parts[k])} faces around face {mesh.face_number[parts[k][0]]}:"
        " there twice, left out once"
        for k in np.flatnonzero(~alone)
    ]
    return replace(mesh.take(np.flatnonzero(alone[part])), notes=(*notes, *again))


def _first_alike(mesh: PolygonMesh, corners: np.ndarray) -> np.ndarray:
    """For each face the first one that has the same corners (nc,) in any order, (nf,)."""
    result = np.arange(len(mesh))
    for size in np.unique(mesh.sizes):
        faces = np.flatnonzero(mesh.sizes == size)
        rows = np.sort(corners[mesh.start[faces][:, None] + np.arange(size)], axis=1)
        _, first, same = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        result[faces] = faces[first][same.reshape(-1)]
    return result


def _open_count(mesh: PolygonMesh) -> int:
    _, edge = mesh.edges
    return int(np.count_nonzero(np.bincount(edge) == 1))


def components(mesh: PolygonMesh) -> list[np.ndarray]:
    """Numbers of the faces of each part whose faces share vertices.

    Parameters
    ----------
    mesh : PolygonMesh
    """
    n = len(mesh.vertices)
    graph = coo_array((np.ones(len(mesh.corners)), (mesh.corners, mesh.following)), (n, n))
    _, label = connected_components(graph, directed=False)
    part = label[mesh.corners[mesh.start[:-1]]]
    return [np.flatnonzero(part == k) for k in np.unique(part)]
