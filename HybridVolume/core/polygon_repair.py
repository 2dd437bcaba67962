# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Closed, oriented meshes of polygons: what can be mended is, the rest is refused by its numbers.

Mixed orientation is mended; so are vertices and faces that nothing needs, and corners that stand
twice in a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from ..errors import (
    InputError,
    NonManifoldError,
    OpenBodyError,
    OrientationError,
    SelfIntersectionError,
)
from .intersection import self_intersections
from .polygons import PolygonMesh, have, some, some_edges

FLAT = 1e-10
"""Area of a face over the square of its longest side below which it has none."""


def mended(mesh: PolygonMesh, *, cage: bool = False) -> PolygonMesh:
    """A closed mesh of one orientation, or an error that says why not.

    Parameters
    ----------
    mesh : PolygonMesh
    cage : bool
        Whether it is the cage of a subdivision surface, which may have crossed or flat faces.

    Raises
    ------
    InputError
        A face has no area, crosses itself, or has a vertex twice.
    OpenBodyError, NonManifoldError, OrientationError
        By the edges and vertices that are concerned.
    """
    mesh = _without_repeats(mesh)
    mesh = _without_doubles(mesh)
    mesh = _checked_faces(mesh, cage)
    _check_edges(mesh)
    mesh = _oriented(mesh)
    _check_vertices(mesh)
    return mesh


def bodies(mesh: PolygonMesh, *, cage: bool = False) -> list[PolygonMesh]:
    """Bodies of a mended mesh: each outer skin with the cavities in it, oriented outward.

    Parameters
    ----------
    mesh : PolygonMesh
    cage : bool
        As for `mended`; a cage may cut itself where its surface does not.

    Raises
    ------
    SelfIntersectionError
        Faces cut each other.
    OrientationError
        A skin has no volume.
    """
    rows, face = mesh.triangles()
    pairs = () if cage else self_intersections(mesh.vertices, rows)
    if len(pairs):
        bad = np.unique(face[np.asarray(pairs).ravel()])
        raise SelfIntersectionError(
            f"{some('face', mesh.face_number[bad])} cut each other",
            figure=float(len(bad)),
            remedy="mend the mesh where they are",
        )
    skins = [mesh.take(members) for members in _components(mesh)]
    sizes = np.array([skin.volume() for skin in skins])
    for skin, size in zip(skins, sizes, strict=True):
        if abs(size) < FLAT * skin.diagonal**3:
            raise OrientationError(
                f"the {len(skin)} faces around face {skin.face_number[0]} enclose no volume",
                figure=float(size),
                remedy="give a mesh that encloses a volume",
            )
    inside = np.array(
        [[i != j and _contains(skins[j], skins[i].vertices[0]) for j in range(len(skins))]
         for i in range(len(skins))]
    )  # fmt: skip
    depth = inside.sum(axis=1)
    found = []
    for k in np.flatnonzero(depth % 2 == 0):
        holes = [i for i in np.flatnonzero(inside[:, k]) if depth[i] == depth[k] + 1]
        parts = [skins[k] if sizes[k] > 0 else skins[k].turned(np.ones(len(skins[k]), bool))]
        for i in holes:
            turn = np.full(len(skins[i]), sizes[i] > 0)
            parts.append(skins[i].turned(turn))
        found.append(_joined(parts))
    return found


def _joined(parts: Sequence[PolygonMesh]) -> PolygonMesh:
    shift = np.cumsum([0, *(len(part.vertices) for part in parts)])
    corners = [part.corners + s for part, s in zip(parts, shift, strict=False)]
    sizes = np.concatenate([part.sizes for part in parts])
    return replace(
        parts[0],
        vertices=np.concatenate([part.vertices for part in parts]),
        corners=np.concatenate(corners),
        start=np.concatenate([[0], np.cumsum(sizes)]),
        creases=np.concatenate([p.creases + s for p, s in zip(parts, shift, strict=False)]),
        sharpness=np.concatenate([part.sharpness for part in parts]),
        face_number=np.concatenate([part.face_number for part in parts]),
        vertex_number=np.concatenate([part.vertex_number for part in parts]),
    )


def _contains(skin: PolygonMesh, point: np.ndarray) -> bool:
    """Whether a point is inside a skin, by the solid angle that it sees."""
    rows, _ = skin.triangles()
    a, b, c = (skin.vertices[rows[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    det = np.einsum("ij,ij->i", a, np.cross(b, c))
    ab, bc, ca = ((x * y).sum(axis=1) for x, y in ((a, b), (b, c), (c, a)))
    angle = 2.0 * np.arctan2(det, la * lb * lc + ab * lc + bc * la + ca * lb)
    return abs(angle.sum()) > 2.0 * np.pi


def _components(mesh: PolygonMesh) -> list[np.ndarray]:
    """Faces by parts that share vertices."""
    n = len(mesh.vertices)
    graph = coo_array((np.ones(len(mesh.corners)), (mesh.corners, mesh.following)), (n, n))
    _, label = connected_components(graph, directed=False)
    part = label[mesh.corners[mesh.start[:-1]]]
    return [np.flatnonzero(part == k) for k in np.unique(part)]


def _without_repeats(mesh: PolygonMesh) -> PolygonMesh:
    """Without corners that repeat the one before."""
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


def _without_doubles(mesh: PolygonMesh) -> PolygonMesh:
    """Without faces that are there twice, and with one vertex where several are at one place."""
    places, inverse = np.unique(mesh.vertices, axis=0, return_inverse=True)
    inverse = inverse.reshape(-1)
    if len(places) < len(mesh.vertices) and _open_count(mesh):
        # split vertices, as exported with normals or texture: one place is one vertex
        joined = replace(mesh, vertices=places, corners=inverse[mesh.corners],
                         creases=np.sort(inverse[mesh.creases], axis=1))  # fmt: skip
        number = np.zeros(len(places), dtype=np.int64)
        number[inverse[::-1]] = mesh.vertex_number[::-1]
        count = len(mesh.vertices) - len(places)
        note = f"{count} vertices that lay on others were joined with them"
        mesh = replace(joined, vertex_number=number, notes=(*mesh.notes, note))
    kept = np.ones(len(mesh), dtype=bool)
    for size in np.unique(mesh.sizes):
        faces = np.flatnonzero(mesh.sizes == size)
        rows = np.sort(mesh.corners[mesh.start[faces][:, None] + np.arange(size)], axis=1)
        _, first = np.unique(rows, axis=0, return_index=True)
        kept[np.setdiff1d(faces, faces[first])] = False
    if kept.all():
        return mesh
    note = f"{some('face', mesh.face_number[~kept])}: there twice, left out once"
    return replace(mesh.take(np.flatnonzero(kept)), notes=(*mesh.notes, note))


def _open_count(mesh: PolygonMesh) -> int:
    _, edge = mesh.edges
    return int(np.count_nonzero(np.bincount(edge) == 1))


def _checked_faces(mesh: PolygonMesh, cage: bool) -> PolygonMesh:
    """Refuse faces with a vertex twice, without area, or that cross themselves."""
    order = np.lexsort((mesh.corners, mesh.face_of))
    face, corner = mesh.face_of[order], mesh.corners[order]
    twice = np.unique(face[1:][(face[1:] == face[:-1]) & (corner[1:] == corner[:-1])])
    if len(twice):
        raise InputError(
            f"{some('face', mesh.face_number[twice])} {have(twice)} a vertex twice",
            figure=float(len(twice)),
            remedy="split them in the program that the mesh is from",
        )
    area = np.linalg.norm(mesh.area_vectors(), axis=1)
    sides = np.linalg.norm(mesh.vertices[mesh.corners] - mesh.vertices[mesh.following], axis=1)
    longest = np.maximum.reduceat(sides, mesh.start[:-1])
    crossed = _bow_ties(mesh)
    flat = np.setdiff1d(np.flatnonzero(area <= FLAT * longest**2), crossed)
    if cage:
        told = [
            f"{some('face', mesh.face_number[faces])} of the cage: {what}"
            for faces, what in ((crossed, "sides cross"), (flat, "no area"))
            if len(faces)
        ]
        return replace(mesh, notes=(*mesh.notes, *told))
    if len(flat):
        raise InputError(
            f"{some('face', mesh.face_number[flat])} {have(flat)} no area",
            figure=float(area[flat].min()),
            remedy="remove or collapse them in the program that the mesh is from",
        )
    if len(crossed):
        raise InputError(
            f"sides of {some('face', mesh.face_number[crossed])} cut each other",
            figure=float(len(crossed)),
            remedy="put the corners of these faces in order",
        )
    return mesh


def _bow_ties(mesh: PolygonMesh) -> np.ndarray:
    """Faces with four corners of which opposite sides cut each other, seen along their normal."""
    quads = np.flatnonzero(mesh.sizes == 4)
    if not len(quads):
        return quads
    x = mesh.vertices[mesh.corners[mesh.start[quads][:, None] + np.arange(4)]]
    # of a crossed quad the diagonals' product is small or the two halves turn against each other
    frame = np.linalg.svd(x - x.mean(axis=1, keepdims=True), full_matrices=False)[2][:, :2]
    flat = np.einsum("qci,qki->qck", x - x.mean(axis=1, keepdims=True), frame)

    def side(a: int, b: int, c: int) -> np.ndarray:
        p, q = flat[:, b] - flat[:, a], flat[:, c] - flat[:, a]
        return p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]

    def cut(a: int, b: int, c: int, d: int) -> np.ndarray:
        return (side(a, b, c) * side(a, b, d) < 0.0) & (side(c, d, a) * side(c, d, b) < 0.0)

    return quads[cut(0, 1, 2, 3) | cut(1, 2, 3, 0)]


def _check_edges(mesh: PolygonMesh) -> None:
    ends, edge = mesh.edges
    count = np.bincount(edge, minlength=len(ends))
    many = np.flatnonzero(count > 2)
    if len(many):
        raise NonManifoldError(
            f"{some_edges(mesh, ends[many])} {have(many, 'belongs', 'belong')} to more than two"
            " faces",
            figure=float(len(many)),
            remedy="remove inner faces, or give the bodies apart",
        )
    rims = np.flatnonzero(count == 1)
    if len(rims):
        raise OpenBodyError(
            f"{some_edges(mesh, ends[rims])} {have(rims, 'belongs', 'belong')} to one face only:"
            " the mesh is not closed",
            figure=float(len(rims)),
            remedy="close the holes in the program that the mesh is from",
        )


def _oriented(mesh: PolygonMesh) -> PolygonMesh:
    """All faces turned as the majority of their part is, and each part outward as a whole."""
    _, edge = mesh.edges
    order = np.argsort(edge, kind="stable").reshape(-1, 2)
    pairs = mesh.face_of[order]
    same = mesh.corners[order[:, 0]] == mesh.corners[order[:, 1]]
    turn = np.zeros(len(mesh), dtype=bool)
    if same.any():
        n = len(mesh)
        # a face and its reverse are two nodes; neighbours agree as their common edge says
        a, b = pairs.T
        rows = np.concatenate([a, a + n])
        columns = np.concatenate([np.where(same, b + n, b), np.where(same, b, b + n)])
        graph = coo_array((np.ones(len(rows)), (rows, columns)), (2 * n, 2 * n)).tocsr()
        _, label = connected_components(graph, directed=False)
        bad = np.flatnonzero(label[:n] == label[n:])
        if len(bad):
            raise OrientationError(
                f"the {len(bad)} faces around face {mesh.face_number[bad[0]]} have one side only",
                figure=float(len(bad)),
                remedy="inside and outside cannot be told: give a surface that encloses a volume",
            )
        seen = np.zeros(2 * n, dtype=bool)
        for first in range(n):
            if seen[first] or seen[first + n]:
                continue
            reached = breadth_first_order(graph, first, directed=False)[0]
            seen[reached] = True
            part = reached[reached >= n] - n
            # the side that fewer faces are against
            turn[part if 2 * len(part) <= len(reached) else reached[reached < n]] = True
    notes = mesh.notes
    if turn.any():
        mesh = mesh.turned(turn)
        notes = (*notes, f"{some('face', mesh.face_number[turn])}: turned as their neighbours")
    inward = np.zeros(len(mesh), dtype=bool)
    parts = _components(mesh)
    for part in parts:
        inward[part] = mesh.take(part).volume() < 0.0
    if len(parts) == 1 and inward.any():
        mesh = mesh.turned(inward)
        notes = (*notes, "all faces looked inward and were turned")
    return replace(mesh, notes=notes)


def _check_vertices(mesh: PolygonMesh) -> None:
    """Refuse vertices where parts of the surface touch in a point only."""
    # corners around a vertex are joined by the edges that leave it
    _, edge = mesh.edges
    order = np.argsort(edge, kind="stable").reshape(-1, 2)
    after = np.arange(1, len(mesh.corners) + 1)
    after[mesh.start[1:] - 1] = mesh.start[:-1]
    one, other = order.T
    rows = np.concatenate([one, after[one]])
    columns = np.concatenate([after[other], other])
    n = len(mesh.corners)
    _, label = connected_components(coo_array((np.ones(2 * len(one)), (rows, columns)), (n, n)))
    fans = np.unique(np.column_stack([mesh.corners, label]), axis=0)[:, 0]
    bad = np.flatnonzero(np.bincount(fans, minlength=len(mesh.vertices)) > 1)
    if len(bad):
        raise NonManifoldError(
            f"the surface touches itself only in {some('vertex', mesh.vertex_number[bad])}",
            figure=float(len(bad)),
            remedy="part the faces there, or join them along edges",
        )
