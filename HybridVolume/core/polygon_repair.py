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
from scipy.spatial import cKDTree

from ..errors import (
    InputError,
    NonManifoldError,
    OpenBodyError,
    OrientationError,
    SelfIntersectionError,
)
from .doublets import without_doublets
from .intersection import self_intersections, surfaces_intersect
from .polygons import PolygonMesh, have, near, number_of, some, some_edges
from .subdivision import limit_points, subdivide

FLAT = 1e-10
"""Area of a face over the square of its longest side below which it has none."""
SHORT = 1e-9
"""Side of a face over its longest one below which it has no length."""
EXTENT = (1e-6, 1e9)
"""Least and largest width of a mesh, mm."""
_WELD = 1e-5
"""Share of the diagonal within which vertices of open edges are one, and of these edges..."""
_WELD_SIDE = 0.05
"""...the share that it must be below."""


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
    mesh = _without_repeats(mesh)
    mesh = _welded(mesh)
    mesh = _without_doubles(mesh)
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
    rows, face = mesh.triangles()
    pairs = () if cage else self_intersections(mesh.vertices, rows)
    if len(pairs):
        raise _cut(mesh, face[np.asarray(pairs).ravel()])
    skins = [mesh.take(members) for members in _components(mesh)]
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


def _welded(mesh: PolygonMesh) -> PolygonMesh:
    """With one vertex where several of open edges are at one place, as split vertices are."""
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


def _without_doubles(mesh: PolygonMesh) -> PolygonMesh:
    """Without faces, and without whole parts of the surface, that are there twice."""
    notes = mesh.notes
    _, edge = mesh.edges
    # all edges of a face too many have too many faces
    least = np.minimum.reduceat(np.bincount(edge)[edge], mesh.start[:-1])
    double = (_first_alike(mesh, mesh.corners) != np.arange(len(mesh))) & (least > 2)
    if double.any():
        notes = (*notes, f"{some('face', mesh.face_number[double])}: there twice, left out once")
        mesh = replace(mesh.take(np.flatnonzero(~double)), notes=notes)
    parts = _components(mesh)
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
            f"the surface touches itself only in {some('vertex', mesh.vertex_number[bad])}"
            f"{near(mesh.vertices[bad[:1]])}",
            figure=float(len(bad)),
            remedy="part the faces there, or join them along edges",
        )
