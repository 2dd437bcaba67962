# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Repair of a core whose curved tets are folded.

Nodes inside give way first. Where that does not help, edges, faces and tets that join points of the
interface through the core get a vertex of their own. Triangles on the interface that curve too much
for any tet are split, and the core is filled anew.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...errors import MesherError
from ..interior import Interface, fill_interior
from ..tetmesh import TetMesh
from ..tetmesh.mesh import row_keys
from ..tetmesh.split import separate_boundary
from .simplex_space import lattice, shape_functions
from .spline_space import SplineSpace
from .subdivision import raised_simplices
from .tet_space import Sides, TetSpace, curved_tets
from .unfold import unfolded, yielded

_FILLS = 1
"""How often the core is filled under a finer interface."""
_SPLITS = 12
"""How often triangles on the interface are split that do not follow it."""
_SEPARATIONS = 3
"""How often vertices are put in around folded tets; the last time nodes move as much as can be."""
_PARTED = 4
"""How often triangles that cut each other are split before columns are shortened."""
_STEP, _SHORTEST = 0.1, 0.3
"""Share of a column that it loses at a time, and what must be left."""
_FEW = 40
"""Folded tets up to which moving nodes as much as can be, or a finer interface, is worth while."""
_SMOOTH = np.cos(np.radians(30.0))
"""Cosine of the angle between normals at an edge from which on the interface counts as smooth."""
_BULGE = 0.05
"""Distance of an edge's middle from its chord, over its length, from which on it is split."""
_LOOKS = 6
"""Parts of a triangle's side at which its normals are looked at."""
_TURNED, _SHRUNK = 0.2, 0.2
"""Cosine between a triangle's normal and the inner surface's, and area there over its mean, below
which a triangle is split."""


def repaired_core(
    spline: SplineSpace, mesh: TetMesh, sides: Sides, degree: int
) -> tuple[TetSpace, list[str]]:
    """Tets that are valid as far as that can be had, and what was done for it.

    Parameters
    ----------
    spline : SplineSpace
    mesh : TetMesh
    sides : Sides
        All triangles of its boundary.
    degree : {1, 2, 3}

    Returns
    -------
    space : TetSpace
    notes : list of str

    Raises
    ------
    MesherError
        The core could not be filled under a finer interface.
    """
    first = len(sides.triangles)
    if degree > 1:
        mesh, sides = _followed(spline, mesh, sides)
    space, notes = _valid_tets(spline, mesh, sides, degree)
    for _ in range(_FILLS):
        bad = folded(space)
        # of many folds a finer interface would leave many
        if not 0 < np.count_nonzero(bad) <= _FEW:
            break
        # faces stand in the order of the triangles
        under = np.isin(space.faces[:, :3], space.elements[bad, :4]).any(axis=1)
        finer = _split(spline, sides, under, _BULGE)
        if len(finer.triangles) == len(sides.triangles):
            finer = _split(spline, sides, under, 0.0)
        if len(finer.triangles) == len(sides.triangles):
            break
        mesh, sides = _followed(spline, *filled_core(spline, finer))
        space, notes = _valid_tets(spline, mesh, sides, degree)
    more = len(sides.triangles) - first
    if more:
        notes.insert(0, f"{more // 2} edges on the interface were split, and the core filled anew")
    return space, notes + overlap_note(sides)


def yielding_core(
    spline: SplineSpace, mesh: TetMesh, sides: Sides, degree: int
) -> tuple[TetSpace, int]:
    """Valid tets on a mesh as it is: where they would be folded they are straight.

    Parameters as for :func:`repaired_core`.

    Returns
    -------
    space : TetSpace
    count : int
        Nodes on the interface that stand off the inner surface.
    """
    low = min(degree, 2)
    space = curved_tets(spline, mesh, sides, low)
    # nodes of elements are means of the straight mesh's vertices
    counts = lattice(3, low) / low
    safe = np.empty_like(space.nodes)
    safe[space.elements] = counts @ mesh.vertices[mesh.tets]
    space, _ = yielded(space, safe)
    if degree > low:
        space, _ = raised_simplices(space, spline, degree, light=True, yields=True)
    place = space.interface_patch, space.interface_uv, space.interface_w
    there = spline.basis_at(*place) @ spline.control_points
    off = np.linalg.norm(space.nodes[space.interface] - there, axis=1)
    return space, int(np.count_nonzero(off > 1e-9 * np.ptp(there, axis=0).max()))


def folded(space: TetSpace) -> np.ndarray:
    """Elements that are not proved valid, (m,) bool."""
    return space.jacobian_bounds <= 0.0


def _valid_tets(
    spline: SplineSpace, mesh: TetMesh, sides: Sides, degree: int
) -> tuple[TetSpace, list[str]]:
    """Tets that are valid as far as that can be had under these triangles.

    Cubic tets are those of degree 2 with more nodes, so that what is hard is done with few.
    """
    low = min(degree, 2)

    def attempt(light: bool) -> tuple[TetSpace, np.ndarray, int]:
        space, moved = unfolded(curved_tets(spline, mesh, sides, low), light)
        bad = folded(space)
        if degree > low and not bad.any():
            space, more = raised_simplices(space, spline, degree, light)
            bad, moved = folded(space), moved + more
        return space, bad, moved

    before = len(mesh.vertices)
    moved = 0
    space = curved_tets(spline, mesh, sides, low)
    bad = _pressed_flat(space, spline)
    if not bad.any():
        space, bad, moved = attempt(True)
    for step in range(_SEPARATIONS):
        if not bad.any():
            break
        chosen = np.zeros(len(mesh.vertices), dtype=bool)
        chosen[mesh.tets[bad]] = True
        mesh, _ = separate_boundary(mesh, chosen=chosen)
        few = np.count_nonzero(bad) <= _FEW
        space, bad, moved = attempt(step < _SEPARATIONS - 1 or not few)
    notes = []
    count = len(mesh.vertices) - before
    if count:
        notes.append(f"{count} vertices were put into the core, where curved tets were folded")
    if moved:
        notes.append(f"{moved} nodes of the core were moved, where curved tets were folded")
    return space, notes


def _pressed_flat(space: TetSpace, spline: SplineSpace) -> np.ndarray:
    """Tets with two faces on the interface that meet in an edge where it is smooth, (m,) bool.

    However fine the elements get, det J vanishes on such an edge, since the faces have one tangent
    plane there.
    """
    found = np.zeros(len(space.elements), dtype=bool)
    if space.degree == 1:
        return found
    element, _ = space.elements_of_faces
    number = np.flatnonzero(np.bincount(element, minlength=len(found))[element] > 1)
    sides = np.array([[0, 1], [1, 2], [2, 0]])
    ends = np.sort(space.faces[number][:, sides], axis=2).reshape(-1, 2)
    middle = space.face_uv[number][:, sides].mean(axis=2).reshape(-1, 2)
    w = space.face_w[number][:, sides].mean(axis=2).ravel()
    tangents = spline.tangents_at(np.repeat(space.face_patch[number], 3), middle, w)
    normal = np.cross(tangents[:, 0], tangents[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    owner = np.repeat(element[number], 3)
    order = np.lexsort((*ends.T, owner))
    first, second = order[:-1], order[1:]
    same = (owner[first] == owner[second]) & (ends[first] == ends[second]).all(axis=1)
    smooth = (normal[first] * normal[second]).sum(axis=1) > _SMOOTH
    found[owner[first[same & smooth]]] = True
    return found


def _followed(spline: SplineSpace, mesh: TetMesh, sides: Sides) -> tuple[TetMesh, Sides]:
    """Triangles that follow the interface, and a core under them that is filled anew if need be."""
    count = len(sides.triangles)
    for _ in range(_SPLITS):
        twisted = _twisted(spline, sides)
        if not twisted.any():
            break
        sides = _split(spline, sides, twisted, 0.0)
    return (mesh, sides) if len(sides.triangles) == count else filled_core(spline, sides)


def _twisted(spline: SplineSpace, sides: Sides) -> np.ndarray:
    """Triangles that hardly follow the interface: no tet under them could be valid, (t,) bool.

    Their normals turn away from those of the inner surface, or their area nearly vanishes.
    """
    at = lattice(2, _LOOKS)[:, 1:] / _LOOKS
    _, slopes = shape_functions(2, at)
    found = _crossed(slopes @ _nodes(spline, sides, lattice(2, 2) / 2.0)[:, None])
    share = np.column_stack([1.0 - at.sum(axis=1), at])
    true = _crossed(spline.tangents_at(*_places(sides, share))[:, :2]).reshape(found.shape)
    along = (found * true).sum(axis=2) / np.maximum(np.linalg.norm(true, axis=2), 1e-300)
    # triangles run one way round all over the interface, parameters either way
    along *= np.sign(np.median(along, axis=1, keepdims=True))
    turned = (along < _TURNED * np.linalg.norm(found, axis=2)).any(axis=1)
    return turned | (along.min(axis=1) < _SHRUNK * along.mean(axis=1))


def _crossed(tangents: np.ndarray) -> np.ndarray:
    return np.cross(tangents[..., 0, :], tangents[..., 1, :])


def _places(sides: Sides, share: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patch, parameters and depth of points of all triangles, by their barycentric coordinates."""
    uv = np.einsum("qc,fcd->fqd", share, sides.uv)
    return np.repeat(sides.patch, len(share)), uv.reshape(-1, 2), (sides.w @ share.T).ravel()


def _nodes(spline: SplineSpace, sides: Sides, share: np.ndarray) -> np.ndarray:
    """Points of the inner surface in all triangles, (t, m, 3), mm."""
    found = spline.basis_at(*_places(sides, share)) @ spline.control_points
    return found.reshape(-1, len(share), 3)


_ENDS = np.array([[0, 1], [0, 2], [1, 2]])
"""Corners of the edges of a triangle."""


def _split(spline: SplineSpace, sides: Sides, chosen: np.ndarray, least: float) -> Sides:
    """Triangles with the middles of edges of chosen ones as new vertices.

    Of several edges of a triangle only the longest is split, so that shapes stay bounded.

    Parameters
    ----------
    spline : SplineSpace
    sides : Sides
    chosen : (t,) bool array
    least : float
        Distance of an edge's middle from its chord, over its length, from which on it is split.
    """
    count = int(sides.triangles.max()) + 1
    points = _nodes(spline, sides, np.eye(3))
    middles = _nodes(spline, sides, np.array([[0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]]))
    start, end = points[:, _ENDS[:, 0]], points[:, _ENDS[:, 1]]
    length = np.linalg.norm(end - start, axis=2)
    off = np.linalg.norm(middles - 0.5 * (start + end), axis=2)
    keys = row_keys(sides.triangles[:, _ENDS].reshape(-1, 2), count)
    wanted = np.repeat(chosen, 3) & (off >= least * length).ravel()
    if not wanted.any():
        return sides
    table, first = np.unique(keys[wanted], return_index=True)
    rank = np.empty(len(table), dtype=np.int64)
    rank[np.argsort(length.ravel()[wanted][first], kind="stable")] = np.arange(len(table))
    place = np.minimum(np.searchsorted(table, keys), len(table) - 1)
    mark = np.where(table[place] == keys, rank[place], -1).reshape(-1, 3)
    beaten = mark[(mark >= 0) & (mark < mark.max(axis=1, keepdims=True))]
    return _cut(sides, keys.reshape(-1, 3), table[~np.isin(rank, beaten)], count)


def _cut(sides: Sides, keys: np.ndarray, chosen: np.ndarray, count: int) -> Sides:
    """Triangles cut at chosen edges, of which none has more than one."""
    place = np.minimum(np.searchsorted(chosen, keys), len(chosen) - 1)
    hit = chosen[place] == keys
    cut = np.flatnonzero(hit.any(axis=1))
    which = hit[cut].argmax(axis=1)
    a, b = _ENDS[which].T
    rows = np.arange(len(cut))
    uv, w = sides.uv[cut], sides.w[cut]
    middle = (
        count + place[cut, which],
        0.5 * (uv[rows, a] + uv[rows, b]),
        0.5 * (w[rows, a] + w[rows, b]),
    )
    halves = []
    for corner in (b, a):
        half = sides.triangles[cut].copy(), uv.copy(), w.copy()
        for part, value in zip(half, middle, strict=True):
            part[rows, corner] = value
        halves.append(half)
    keep = np.ones(len(keys), dtype=bool)
    keep[cut] = False
    kept = sides.triangles[keep], sides.uv[keep], sides.w[keep]
    triangles, uv, w = (np.concatenate(part) for part in zip(kept, *halves, strict=True))
    patch = np.concatenate([sides.patch[keep], sides.patch[cut], sides.patch[cut]])
    return Sides(triangles, patch, uv, w)


def filled_core(spline: SplineSpace, sides: Sides) -> tuple[TetMesh, Sides]:
    """Straight tets inside triangles on the interface, whose vertices come first.

    Triangles that cut each other are split, and where that does not part them the core reaches
    into the shell by a little: both are there twice then, and :func:`overlap_note` tells so.

    Raises
    ------
    MesherError
        The triangles cut each other nevertheless, or no mesher fills them.
    """
    for step in range(_SPLITS):
        interface = _interface(spline, sides)
        try:
            return fill_interior(interface, surface=spline.shell.surface).mesh, sides
        except MesherError as error:
            crossing = getattr(error, "triangles", np.zeros(0, dtype=int))
            if step == _SPLITS - 1 or not len(crossing):
                raise
        hit = np.zeros(len(sides.triangles), dtype=bool)
        hit[crossing] = True
        if step < _PARTED:
            sides = _split(spline, sides, hit, 0.0)
        else:
            there = np.zeros(len(interface.vertices))
            there[sides.triangles[hit]] = _STEP
            sides = replace(sides, w=np.maximum(sides.w - there[sides.triangles], _SHORTEST))
    raise AssertionError("the last step raises")


def overlap_note(sides: Sides) -> list[str]:
    """What to say of columns that the core reaches into."""
    short = np.unique(sides.triangles[sides.w < 1.0])
    if not len(short):
        return []
    return [
        f"the core reaches into the shell at {len(short)} points of the interface, up to"
        f" {100.0 * (1.0 - sides.w.min()):.0f} % of its columns: both are counted there"
    ]


def _interface(spline: SplineSpace, sides: Sides) -> Interface:
    """What meshers need to know of an interface."""
    _, first = np.unique(sides.triangles, return_index=True)
    row, corner = np.divmod(first, 3)
    place = sides.patch[row], sides.uv[row, corner], sides.w[row, corner]
    none = np.zeros(0, dtype=np.int64)
    return Interface(
        vertices=spline.basis_at(*place) @ spline.control_points,
        vertex_patch=place[0],
        vertex_uv=place[1],
        triangles=sides.triangles,
        triangle_patch=sides.patch,
        triangle_uv=sides.uv,
        edges=none.reshape(0, 2),
        edge_patch=none,
        edge_uv=np.zeros((0, 2)),
        midpoints=np.zeros((0, 3)),
        triangle_edges=none.reshape(0, 3),
        nodes="knots",
        subdivide=1,
    )
