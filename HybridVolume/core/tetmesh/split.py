# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Refinement of tetrahedra by splitting edges; existing vertices keep their numbers and places."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .mesh import EDGES, FACES, TetMesh, row_keys


def split_edges(
    mesh: TetMesh, edges: np.ndarray, faces: np.ndarray | None = None
) -> tuple[TetMesh, np.ndarray]:
    """Split edges at their middle, with all tetrahedra around them.

    Edges that share a tetrahedron are split one after the other, the longest first.

    Parameters
    ----------
    mesh : TetMesh
    edges : (k, 2) int array
    faces : (f, 3) int array, optional
        Triangles of the mesh that are split along, e.g. those of a sheet.

    Returns
    -------
    mesh : TetMesh
    faces : (f', 3) int array
    """
    faces = np.zeros((0, 3), dtype=np.int64) if faces is None else faces
    vertices, tets = mesh.vertices, mesh.tets
    count = len(vertices)
    limit = count + len(edges)
    keys = np.unique(row_keys(edges, limit))
    ends = np.column_stack([keys // limit, keys % limit])
    length = np.linalg.norm(vertices[ends[:, 1]] - vertices[ends[:, 0]], axis=1)
    rank = np.empty(len(keys), dtype=np.int64)
    rank[np.argsort(length, kind="stable")] = np.arange(len(keys))
    middle = 0.5 * (vertices[ends[:, 0]] + vertices[ends[:, 1]])
    vertices = np.vstack([vertices, middle])

    done: list[np.ndarray] = []
    active = tets
    while len(active):
        mark = _marked(active, EDGES, keys, rank, limit)
        touched = (mark >= 0).any(axis=1)
        done.append(active[~touched])
        active, mark = active[touched], mark[touched]
        if not len(active):
            break
        # an edge is split when no longer marked edge shares a tetrahedron with it
        best = mark.max(axis=1)
        wins = np.bincount(best, minlength=len(keys))
        all_of = np.bincount(mark[mark >= 0], minlength=len(keys))
        chosen = (wins == all_of) & (wins > 0)
        now = chosen[best]
        waiting, splitting = active[~now], active[now]
        which = best[now]
        local = EDGES[(mark[now] == which[:, None]).argmax(axis=1)]
        edge_number = np.empty(len(keys), dtype=np.int64)
        edge_number[rank] = np.arange(len(keys))
        new = count + edge_number[which]
        rows = np.arange(len(splitting))
        first, second = splitting.copy(), splitting
        first[rows, local[:, 1]] = new
        second[rows, local[:, 0]] = new
        faces = _split_faces(faces, keys, rank, limit, chosen, edge_number, count)
        active = np.vstack([waiting, first, second])
    return TetMesh(vertices, np.vstack(done), mesh.engine, mesh.exact), faces


def _marked(
    cells: np.ndarray, pairs: np.ndarray, keys: np.ndarray, rank: np.ndarray, limit: int
) -> np.ndarray:
    """Rank of every edge of every cell among the edges to be split, -1 for the others."""
    found = row_keys(cells[:, pairs].reshape(-1, 2), limit)
    place = np.minimum(np.searchsorted(keys, found), len(keys) - 1)
    return np.where(keys[place] == found, rank[place], -1).reshape(len(cells), len(pairs))


def _split_faces(
    faces: np.ndarray,
    keys: np.ndarray,
    rank: np.ndarray,
    limit: int,
    chosen: np.ndarray,
    edge_number: np.ndarray,
    count: int,
) -> np.ndarray:
    if not len(faces):
        return faces
    sides = np.array([[0, 1], [1, 2], [2, 0]])
    mark = _marked(faces, sides, keys, rank, limit)
    hit = (mark >= 0) & chosen[np.maximum(mark, 0)]
    cut = hit.any(axis=1)
    local = sides[hit[cut].argmax(axis=1)]
    new = count + edge_number[mark[cut][hit[cut]]]
    rows = np.arange(len(local))
    first, second = faces[cut].copy(), faces[cut].copy()
    first[rows, local[:, 1]] = new
    second[rows, local[:, 0]] = new
    return np.vstack([faces[~cut], first, second])


def separate_boundary(
    mesh: TetMesh, faces: np.ndarray | None = None, chosen: np.ndarray | None = None
) -> tuple[TetMesh, np.ndarray]:
    """Split whatever joins boundary vertices through the inside.

    Afterwards no tetrahedron has four boundary vertices, so that a function that is zero on the
    boundary is zero on no tetrahedron, and its lowest isosurfaces look like the boundary.

    Parameters
    ----------
    mesh : TetMesh
    faces : (f, 3) int array, optional
        Triangles of the mesh that are split along, e.g. those of a sheet.
    chosen : (n,) bool array, optional
        Boundary vertices between which it shall be done; all by default.

    Returns
    -------
    mesh : TetMesh
    faces : (f', 3) int array
    """
    faces = np.zeros((0, 3), dtype=np.int64) if faces is None else faces
    n = len(mesh.vertices)
    chosen = mesh.on_boundary if chosen is None else mesh.on_boundary & chosen
    both = chosen[mesh.edges].all(axis=1)
    inner = mesh.edges[both]
    inner = inner[~np.isin(row_keys(inner, n), row_keys(mesh.boundary_edges, n))]
    if len(inner):
        mesh, faces = split_edges(mesh, inner, faces)
    mesh = _split_inner_faces(mesh, chosen)
    flat = _grown(chosen, mesh)[mesh.tets].all(axis=1)
    if flat.any():
        mesh = _insert(mesh, mesh.tets[flat], np.flatnonzero(flat)[:, None])
    return mesh, faces


def _grown(flags: np.ndarray, mesh: TetMesh) -> np.ndarray:
    """Flags of vertices with those that came after, which have none."""
    return np.concatenate([flags, np.zeros(len(mesh.vertices) - len(flags), dtype=bool)])


def _split_inner_faces(mesh: TetMesh, chosen: np.ndarray) -> TetMesh:
    """Put a vertex into every inner face whose three vertices are chosen ones on the boundary."""
    for _ in range(8):
        tet, face = np.nonzero(mesh.neighbours > np.arange(len(mesh))[:, None])
        corners = mesh.tets[tet[:, None], FACES[face]]
        bad = _grown(chosen, mesh)[corners].all(axis=1)
        if not bad.any():
            break
        tet, corners, other = tet[bad], corners[bad], mesh.neighbours[tet[bad], face[bad]]
        # at most one face of a tetrahedron in a round
        pairs = np.column_stack([tet, other])
        order = np.arange(len(pairs))
        first = np.full(len(mesh), len(pairs))
        np.minimum.at(first, pairs.ravel(), np.repeat(order, 2))
        now = (first[pairs] == order[:, None]).all(axis=1)
        mesh = _insert(mesh, corners[now], pairs[now])
    return mesh


def _insert(mesh: TetMesh, simplices: np.ndarray, tets: np.ndarray) -> TetMesh:
    """Put a vertex into the middle of each simplex and split its tetrahedra (k, 1 or 2)."""
    n = len(mesh.vertices)
    vertices = np.vstack([mesh.vertices, mesh.vertices[simplices].mean(axis=1)])
    keep = np.ones(len(mesh), dtype=bool)
    keep[tets] = False
    parts = [mesh.tets[keep]]
    new = n + np.arange(len(simplices))
    for column in tets.T:
        old = mesh.tets[column]
        for place in range(4):
            # replacing a vertex outside the simplex would give a tetrahedron without volume
            inside = (old[:, place, None] == simplices).any(axis=1)
            part = old[inside].copy()
            part[:, place] = new[inside]
            parts.append(part)
    return TetMesh(vertices, np.vstack(parts), mesh.engine, mesh.exact)


def refine(
    mesh: TetMesh,
    size: Callable[[np.ndarray], np.ndarray],
    faces: np.ndarray | None = None,
    *,
    max_tets: int = 200_000,
    rounds: int = 12,
) -> tuple[TetMesh, np.ndarray]:
    """Split long edges until they are no longer than a wanted size.

    Only edges that are among the longest of a tetrahedron are split, so that shapes stay bounded.

    Parameters
    ----------
    mesh : TetMesh
    size : callable
        Wanted edge length, mm, at (k, 3) points.
    faces : (f, 3) int array, optional
        Triangles that are split along.
    max_tets : int
        Stop there.
    rounds : int

    Returns
    -------
    mesh : TetMesh
    faces : (f', 3) int array
    """
    faces = np.zeros((0, 3), dtype=np.int64) if faces is None else faces
    for _ in range(rounds):
        if len(mesh) >= max_tets:
            break
        edges = mesh.edges
        n = len(mesh.vertices)
        a, b = mesh.vertices[edges[:, 0]], mesh.vertices[edges[:, 1]]
        length = np.linalg.norm(b - a, axis=1)
        excess = length / (1.4 * size(0.5 * (a + b)))
        long = excess > 1.0
        if not long.any():
            break
        keys = row_keys(edges, n)
        of_tet = np.searchsorted(keys, row_keys(mesh.tets[:, EDGES].reshape(-1, 2), n))
        lengths = length[of_tet].reshape(-1, 6)
        marked = long[of_tet].reshape(-1, 6) & (lengths >= 0.9 * lengths.max(axis=1, keepdims=True))
        chosen = np.unique(of_tet.reshape(-1, 6)[marked])
        if not len(chosen):
            # long edges exist only beside longer ones that are short enough for their place
            break
        # every tetrahedron around a split edge becomes two
        grown = np.bincount(of_tet, minlength=len(edges))[chosen]
        order = np.argsort(-excess[chosen], kind="stable")
        room = np.searchsorted(np.cumsum(grown[order]), max_tets - len(mesh), side="right")
        mesh, faces = split_edges(mesh, edges[chosen[order[: room + 1]]], faces)
    return mesh, faces
