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
from .doublets import without_doublets
from .intersection import self_intersections, surfaces_intersect
from .polygon_doubles import components, welded, without_doubles, without_repeats
from .polygons import PolygonMesh, have, near, some, some_edges
from .subdivision import Corners, limit_points, subdivide

FLAT = 1e-10
"""Area of a face over the square of its longest side below which it has none."""
SHORT = 1e-9
"""Side of a face over its longest one below which it has no length."""
EXTENT = (1e-6, 1e9)
"""Least and largest width of a mesh, mm."""
_HALVINGS = 4


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
    size = float(np.ptp(mesh.vertices[mesh.corners], axis=0).max())
    if not EXTENT[0] <= size <= EXTENT[1]:
        raise InputError(
            f"the mesh is {size:.3g} mm wide",
            figure=size,
            remedy=f"scale it to between {EXTENT[0]:g} and {EXTENT[1]:g} mm",
        )
    mesh = without_repeats(mesh)
    mesh = welded(mesh)
    mesh = without_doubles(mesh)
    mesh = _checked_faces(mesh, cage)
    _check_edges(mesh)
    mesh = _oriented(mesh)
    _check_vertices(mesh)
    if cage:
        mesh = without_doublets(mesh)
    return _checked_creases(mesh)


def bodies(mesh: PolygonMesh, *, cage: bool = False) -> list[PolygonMesh]:
    """Bodies of a mended mesh: each outer skin with the cavities in it, oriented outward.

    Parameters
    ----------
    mesh : PolygonMesh
    cage : bool
        As for `mended`; a cage may cut itself where its surface does not, and of several skins
        the limit surfaces are compared.

    Raises
    ------
    SelfIntersectionError
        Faces cut each other.
    OrientationError
        A skin has no volume.
    """
    if not cage:
        _check_uncut(mesh)
    skins = [mesh.take(members) for members in components(mesh)]
    sizes = np.array([skin.volume() for skin in skins])
    for skin, size in zip(skins, sizes, strict=True):
        if abs(size) < FLAT * skin.diagonal**3:
            raise OrientationError(
                f"the {len(skin)} faces around face {skin.face_number[0]} enclose no volume"
                f"{near(skin.vertices[:1])}",
                figure=float(size),
                remedy="give a mesh that encloses a volume",
            )
    inside = _nested(skins, cage)
    depth = inside.sum(axis=1)
    found = []
    for k in np.flatnonzero(depth % 2 == 0):
        holes = [i for i in np.flatnonzero(inside[:, k]) if depth[i] == depth[k] + 1]
        parts, notes = [], []
        for i in (k, *holes):
            wrong = (sizes[i] < 0) == (i == k)
            parts.append(skins[i].turned(np.full(len(skins[i]), wrong)))
            what = [] if i == k else ["a cavity"]
            if what or (wrong and len(skins) > 1):
                what += ["turned to look outward" if i == k else "turned"] if wrong else []
                notes.append(
                    f"the {len(skins[i])} faces around face {skins[i].face_number[0]}:"
                    f" {', '.join(what)}"
                )
        found.append(replace(_joined(parts), notes=(*mesh.notes, *notes)))
    return found


def _check_uncut(mesh: PolygonMesh) -> None:
    """Refuse faces that cut each other, quads as the bilinear surfaces that they are."""
    whole = mesh
    for halving in range(1, _HALVINGS + 2):
        rows, face = mesh.triangles()
        pairs = self_intersections(mesh.vertices, rows)
        if not len(pairs):
            return
        # the two triangles of a twisted quad may cut what its surface does not
        bad = np.unique(mesh.face_number[face[pairs.ravel()]])
        mesh = _halved(whole.take(np.flatnonzero(np.isin(whole.face_number, bad))), halving)
    raise _cut(whole, np.flatnonzero(np.isin(whole.face_number, bad)))


def _halved(mesh: PolygonMesh, times: int) -> PolygonMesh:
    """The same bilinear surfaces by smaller quads."""
    for _ in range(times):
        x, topology = mesh.vertices, Corners.of(mesh)
        n, e = len(x), len(topology.edges)
        middle = np.add.reduceat(x[mesh.corners], mesh.start[:-1], axis=0) / mesh.sizes[:, None]
        quads = np.column_stack(
            [mesh.corners, n + topology.edge, n + e + mesh.face_of, n + topology.before]
        )
        mesh = replace(
            mesh,
            vertices=np.concatenate([x, x[topology.edges].mean(axis=1), middle]),
            corners=quads.ravel(),
            start=4 * np.arange(len(quads) + 1),
            face_number=mesh.face_number[mesh.face_of],
        )
    return mesh


def _cut(mesh: PolygonMesh, faces: np.ndarray) -> SelfIntersectionError:
    faces = np.unique(faces)
    return SelfIntersectionError(
        f"{some('face', mesh.face_number[faces])} {have(faces, 'cuts', 'cut')}"
        f" {have(faces, 'itself', 'each other or touch')}{_at(mesh, faces)}",
        figure=float(len(faces)),
        remedy="mend the mesh where they are",
    )


def _nested(skins: Sequence[PolygonMesh], cage: bool) -> np.ndarray:
    """Which skins (rows) are inside which others (columns).

    Raises
    ------
    SelfIntersectionError
        The limit surfaces of two cages cut each other.
    """
    inside = np.zeros((len(skins), len(skins)), dtype=bool)
    low = np.array([skin.vertices.min(axis=0) for skin in skins])
    high = np.array([skin.vertices.max(axis=0) for skin in skins])
    meet = ((low[:, None] <= high) & (low <= high[:, None])).all(axis=2)
    pairs = np.argwhere(np.triu(meet, 1))
    shapes = dict.fromkeys(np.unique(pairs).tolist())
    for k in shapes:
        # steps keep the number of faces, each step makes four of one
        steps = 2 if len(skins[k]) < 2000 else 1
        fine = subdivide(skins[k], steps) if cage else skins[k]
        shapes[k] = replace(fine, vertices=limit_points(fine)) if cage else fine
    for i, j in pairs.tolist():
        one, other = shapes[i], shapes[j]
        if cage:
            (rows, of), (others, of_other) = one.triangles(), other.triangles()
            hits = surfaces_intersect(one.vertices, rows, other.vertices, others)
            if len(hits):
                both = _joined([one, other])
                raise _cut(both, np.concatenate([of[hits[:, 0]], len(one) + of_other[hits[:, 1]]]))
        inside[i, j] = _contains(other, one.vertices[0])
        inside[j, i] = not inside[i, j] and _contains(one, other.vertices[0])
    return inside


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
        points=np.concatenate([p.points + s for p, s in zip(parts, shift, strict=False)]),
        point_sharpness=np.concatenate([part.point_sharpness for part in parts]),
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


def _checked_creases(mesh: PolygonMesh) -> PolygonMesh:
    """Without creases that are no edges."""
    ends, _ = mesh.edges
    n = len(mesh.vertices)
    known = np.isin(mesh.creases[:, 0] * n + mesh.creases[:, 1], ends[:, 0] * n + ends[:, 1])
    if known.all():
        return mesh
    lost = some_edges(mesh, np.unique(mesh.creases[~known], axis=0))
    return replace(
        mesh,
        creases=mesh.creases[known],
        sharpness=mesh.sharpness[known],
        notes=(*mesh.notes, f"creases left out, for no face has them: {lost}"),
    )


def _checked_faces(mesh: PolygonMesh, cage: bool) -> PolygonMesh:
    """Refuse faces with a vertex twice, without area, or that cross themselves."""
    order = np.lexsort((mesh.corners, mesh.face_of))
    face, corner = mesh.face_of[order], mesh.corners[order]
    twice = np.unique(face[1:][(face[1:] == face[:-1]) & (corner[1:] == corner[:-1])])
    if len(twice):
        raise InputError(
            f"{some('face', mesh.face_number[twice])} {have(twice)} a vertex twice"
            f"{_at(mesh, twice)}",
            figure=float(len(twice)),
            remedy="split them in the program that the mesh is from",
        )
    area = np.linalg.norm(mesh.area_vectors(), axis=1)
    sides = np.linalg.norm(mesh.vertices[mesh.corners] - mesh.vertices[mesh.following], axis=1)
    longest = np.maximum.reduceat(sides, mesh.start[:-1])
    crossed = _bow_ties(mesh)
    flat = np.setdiff1d(np.flatnonzero(area <= FLAT * longest**2), crossed)
    short = np.unique(mesh.face_of[sides <= SHORT * longest[mesh.face_of]])
    short = np.setdiff1d(short, np.concatenate([crossed, flat]))
    if cage:
        told = [
            f"{some('face', mesh.face_number[faces])} of the cage: {what}"
            for faces, what in (
                (crossed, "sides cross"),
                (flat, "no area"),
                (short, "sides without length"),
            )  # fmt: skip
            if len(faces)
        ]
        return replace(mesh, notes=(*mesh.notes, *told))
    if len(flat):
        raise InputError(
            f"{some('face', mesh.face_number[flat])} {have(flat)} no area{_at(mesh, flat)}",
            figure=float(area[flat].min()),
            remedy="remove or collapse them in the program that the mesh is from",
        )
    if len(crossed):
        raise InputError(
            f"sides of {some('face', mesh.face_number[crossed])} cut each other"
            f"{_at(mesh, crossed)}",
            figure=float(len(crossed)),
            remedy="put the corners of these faces in order",
        )
    if len(short):
        raise InputError(
            f"{some('face', mesh.face_number[short])} {have(short)} a side without length"
            f"{_at(mesh, short)}",
            figure=float(len(short)),
            remedy="move one of its ends, or choose Catmull-Clark, which takes triangles",
        )
    return mesh


def _at(mesh: PolygonMesh, faces: np.ndarray) -> str:
    """Where the first of some faces is."""
    return near(mesh.vertices[mesh.corners[mesh.face_of == faces[0]]])


def _bow_ties(mesh: PolygonMesh) -> np.ndarray:
    """Quads of which opposite sides cut each other, seen along their normal, and that turn over.

    A twisted quad may look crossed and still be a patch with one side.
    """
    quads = np.flatnonzero(mesh.sizes == 4)
    if not len(quads):
        return quads
    x = mesh.vertices[mesh.corners[mesh.start[quads][:, None] + np.arange(4)]]
    normal = np.cross(np.roll(x, -1, axis=1) - x, np.roll(x, 1, axis=1) - x)
    over = np.einsum("qci,qi->qc", normal, normal.sum(axis=1)).min(axis=1) <= 0.0
    frame = np.linalg.svd(x - x.mean(axis=1, keepdims=True), full_matrices=False)[2][:, :2]
    flat = np.einsum("qci,qki->qck", x - x.mean(axis=1, keepdims=True), frame)

    def side(a: int, b: int, c: int) -> np.ndarray:
        p, q = flat[:, b] - flat[:, a], flat[:, c] - flat[:, a]
        return p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]

    def cut(a: int, b: int, c: int, d: int) -> np.ndarray:
        return (side(a, b, c) * side(a, b, d) < 0.0) & (side(c, d, a) * side(c, d, b) < 0.0)

    return quads[over & (cut(0, 1, 2, 3) | cut(1, 2, 3, 0))]


def _check_edges(mesh: PolygonMesh) -> None:
    ends, edge = mesh.edges
    count = np.bincount(edge, minlength=len(ends))
    many = np.flatnonzero(count > 2)
    if len(many):
        inner = np.flatnonzero(np.minimum.reduceat(count[edge], mesh.start[:-1]) > 2)
        walls = f" ({some('face', mesh.face_number[inner])} may be)" if len(inner) else ""
        raise NonManifoldError(
            f"{some_edges(mesh, ends[many])} {have(many, 'belongs', 'belong')} to more than two"
            f" faces{near(mesh.vertices[ends[many[0]]])}",
            figure=float(len(many)),
            remedy=f"remove inner faces{walls}, or give the bodies apart",
        )
    rims = np.flatnonzero(count == 1)
    if len(rims):
        raise OpenBodyError(
            f"{some_edges(mesh, ends[rims])} {have(rims, 'belongs', 'belong')} to one face only:"
            f" the mesh is not closed{near(mesh.vertices[ends[rims[0]]])}",
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
    parts = components(mesh)
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
            f"the surface touches itself only in {some('vertex', mesh.vertex_number[bad])}"
            f"{near(mesh.vertices[bad[:1]])}",
            figure=float(len(bad)),
            remedy="part the faces there, or join them along edges",
        )
