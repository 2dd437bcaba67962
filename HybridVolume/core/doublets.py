# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Vertices that belong to two faces only: the surface of a cage is singular there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .polygons import PolygonMesh, some

_ROUNDS = 20


def without_doublets(mesh: PolygonMesh) -> PolygonMesh:
    """A closed, oriented cage without vertices of two faces, where that can be.

    Two quads on both sides of such a vertex become one quad; faces with more corners lose the
    vertex, which lies on what is one edge then.

    Parameters
    ----------
    mesh : PolygonMesh

    Returns
    -------
    PolygonMesh
        With a note that names the vertices; those of which two quads would make less than a quad
        stay.
    """
    notes = mesh.notes
    for _ in range(_ROUNDS):
        mesh, dissolved = _round(mesh)
        if not dissolved:
            break
        numbers = np.array(dissolved)
        notes = (*notes, f"{some('vertex', numbers)}: of two faces only, dissolved")
    return replace(mesh, notes=notes)


def _round(mesh: PolygonMesh) -> tuple[PolygonMesh, list[int]]:
    """With some of them dissolved, no two in one face, and the numbers of these."""
    ends, _ = mesh.edges
    valence = np.bincount(ends.ravel(), minlength=len(mesh.vertices))
    pairs = np.flatnonzero(valence == 2)
    if not len(pairs):
        return mesh, []
    rows = [row.tolist() for row in np.split(mesh.corners, mesh.start[1:-1])]
    at = np.flatnonzero(np.isin(mesh.corners, pairs))
    at = at[np.argsort(mesh.corners[at], kind="stable")].reshape(-1, 2)
    touched: set[int] = set()
    gone, dissolved, moved = [], [], {}
    for vertex, (one, other) in zip(pairs.tolist(), mesh.face_of[at].tolist(), strict=True):
        a, b = _from(rows[one], vertex), _from(rows[other], vertex)
        # each begins with the vertex, and the neighbours are the same the other way round
        quads = len(a) == len(b) == 4
        merged = [*a[1:], b[2]] if quads else []
        if touched & {one, other} or min(len(a), len(b)) < 4 or len(set(merged)) < len(merged):
            continue
        touched |= {one, other}
        dissolved.append(int(mesh.vertex_number[vertex]))
        rows[one] = merged if quads else a[1:]
        if quads:
            gone.append(other)
        else:
            rows[other] = b[1:]
            moved[vertex] = (a[1], a[-1])
    if not dissolved:
        return mesh, []
    sizes = np.array([len(row) for row in rows])
    mesh = replace(
        mesh,
        corners=np.concatenate([np.array(row) for row in rows]),
        start=np.concatenate([[0], np.cumsum(sizes)]),
        creases=_creases(mesh.creases, moved),
    )
    return mesh.take(np.setdiff1d(np.arange(len(mesh)), gone)), dissolved


def _from(row: list[int], vertex: int) -> list[int]:
    """Corners of a face beginning with one of them."""
    k = row.index(vertex)
    return row[k:] + row[:k]


def _creases(creases: np.ndarray, moved: dict[int, tuple[int, int]]) -> np.ndarray:
    """Ends of creases, those at a dissolved vertex as the edge that is there now."""
    creases = creases.copy()
    for vertex, pair in moved.items():
        creases[(creases == vertex).any(axis=1)] = sorted(pair)
    return creases
