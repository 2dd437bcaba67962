# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Catmull-Clark surfaces as bicubic B-spline patches (Figs. 1 and 3).

Where all vertices of a quad have four edges its bicubic patch is the limit surface itself; around
the others it is the approximation of Loop and Schaefer 2008, which meets its neighbours without a
gap and nearly with one normal. Sharp edges are cubic B-spline curves. Quads of a patch that the
layout gives become one B-spline patch, whose knots are simple where the quads meet with continuous
curvature all along a line.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .merged_quads import merged_faces
from .polygons import SHARP, PolygonMesh, off_centre
from .subdivision import Corners, dart_points, limit_points, subdivide
from .surface import SplineFace

STEPS = 1
"""Subdivisions before the patches are made, at least..."""
MOST_STEPS = 4
"""...and at most, where semi-sharp creases need more."""
MOST_QUADS = 20_000
"""So many quads are not exceeded by steps that nobody asked for."""
NEARLY_SHARP = 3.0
"""Sharpness that is left from which on a semi-sharp edge is nearly one that is sharp for good."""
STILL_SHARP = 0.5
"""Sharpness that is left after them from which on an edge is taken as sharp for good."""
_DEEP = 2
_DEEP_QUADS = 60_000
_NEARER = 4
_MARGIN = 1.05
"""On top of the largest distance that was seen, for what lies between the places."""
_PLACES = 4
_SHARE = 0.4
_MOST_ROWS = 4000


@dataclass(frozen=True)
class CatmullClark:
    """Patches of a Catmull-Clark surface, and how near they come to it.

    Attributes
    ----------
    faces : tuple of SplineFace
    quads : int
        Quads of the cage that the patches stand for.
    distance : float
        Largest distance of points of the limit surface from the patch of their quad, of points of
        sides from its side, mm.
    normal_jump : float
        Largest angle between normals at sides of quads that are not sharp, rad.
    steps : int
        Subdivisions that were made.
    nets, numbers : (q, 4, 4, 3) array, (q,) int array
        Bézier points of each quad, mm, and the face of the cage that it is from.
    """

    faces: tuple[SplineFace, ...]
    quads: int
    distance: float
    normal_jump: float
    steps: int
    nets: np.ndarray
    numbers: np.ndarray


def catmull_clark(mesh: PolygonMesh, steps: int | None = None) -> CatmullClark:
    """Bicubic patches of the limit surface of a cage.

    Parameters
    ----------
    mesh : PolygonMesh
        Closed, as `mended` gives it.
    steps : int, optional
        Subdivisions first, at least one where there are other faces than quads. Each about halves
        the distance to the limit surface. Without it one, or so many that semi-sharp creases are
        used up or still nearly sharp.
    """
    steps = default_steps(mesh) if steps is None else steps
    if (mesh.sizes != 4).any():
        steps = max(steps, 1)
    shift = off_centre(mesh)
    cage = subdivide(replace(mesh, vertices=mesh.vertices - shift), steps)
    nets, sharp = bezier_nets(cage)
    quads = cage.quads
    sides = np.column_stack([quads.ravel(), np.roll(quads, -1, axis=1).ravel()])[sharp]
    faces = merged_faces(quads, nets, sides, cage.diagonal)
    return CatmullClark(
        tuple(replace(face, control_points=face.control_points + shift) for face in faces),
        len(cage),
        _distance(cage, nets),
        _normal_jump(cage, nets, sharp),
        steps,
        nets + shift,
        cage.face_number,
    )


def default_steps(mesh: PolygonMesh) -> int:
    """Subdivisions after which no edge or vertex is half sharp, as far as `MOST_QUADS` allow."""
    tags = np.concatenate([mesh.sharpness, mesh.point_sharpness])
    tags = tags[(tags > 0.0) & (tags < SHARP)]
    count = len(mesh.corners) / 4.0
    for steps in range(STEPS, MOST_STEPS + 1):
        if count * 4**steps > MOST_QUADS and steps > STEPS:
            return steps - 1
        left = tags - steps
        if not ((left > 0.0) & (left < NEARLY_SHARP)).any():
            return steps
    return MOST_STEPS


def bezier_nets(cage: PolygonMesh, *, creases: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Bicubic Bézier control points of each quad.

    Parameters
    ----------
    cage : PolygonMesh
        Of quads.
    creases : bool
        Obey them; else all is smooth.

    Returns
    -------
    nets : (nf, 4, 4, 3) array
        u runs from the first corner of a quad to the second.
    sharp : (nc,) bool array
        Whether the side after each corner is sharp.
    """
    x, quads, topology = cage.vertices, cage.quads, Corners.of(cage)
    on_edge = (topology.sharpness >= STILL_SHARP) & creases
    sharp = on_edge[topology.edge]
    count = topology.sharp_count(on_edge, (topology.point_sharpness >= STILL_SHARP) & creases)
    corner = np.arange(quads.size)
    vertex = quads.ravel()
    after = np.roll(quads, -1, axis=1).ravel()
    across = np.roll(quads, -2, axis=1).ravel()
    before = np.roll(quads, 1, axis=1).ravel()
    # inner points, each near its vertex: a crease has as many faces on its side twice
    n = np.where(
        count[vertex] < 2, topology.valence[vertex], 2 * _side_faces(topology, cage, sharp)
    )
    n = np.where(count[vertex] > 2, 4, n)[:, None].astype(float)
    inner = (n * x[vertex] + 2.0 * (x[after] + x[before]) + x[across]) / (n + 5.0)
    # points on sides, at the corner before the side and at the one after it
    order = np.argsort(topology.edge, kind="stable").reshape(-1, 2)
    twin = np.empty_like(corner)
    twin[order[:, 0]], twin[order[:, 1]] = order[:, 1], order[:, 0]
    following = corner - corner % 4 + (corner + 1) % 4
    # the twin side runs back: the corner after it is at this vertex
    begin = 0.5 * (inner + inner[following[twin]])
    end = 0.5 * (inner[following] + inner[twin])
    ruled = sharp & (count[vertex] >= 1)
    begin[ruled] = (2.0 * x[vertex] + x[after])[ruled] / 3.0
    ruled = sharp & (count[after] >= 1)
    end[ruled] = (2.0 * x[after] + x[vertex])[ruled] / 3.0
    places = _corner_points(cage, topology, inner, on_edge, count)
    nets = np.empty((len(quads), 4, 4, 3))
    inner, begin, end = (a.reshape(-1, 4, 3) for a in (inner, begin, end))
    corners = places[quads]
    at = ((0, 0), (3, 0), (3, 3), (0, 3))
    inside = ((1, 1), (2, 1), (2, 2), (1, 2))
    starts = ((1, 0), (3, 1), (2, 3), (0, 2))
    ends = ((2, 0), (3, 2), (1, 3), (0, 1))
    for k in range(4):
        for (i, j), values in zip(
            (at[k], inside[k], starts[k], ends[k]), (corners, inner, begin, end), strict=True
        ):
            nets[:, i, j] = values[:, k]
    return nets, sharp


def _side_faces(topology: Corners, cage: PolygonMesh, sharp: np.ndarray) -> np.ndarray:
    """Faces at the vertex of each corner that no sharp edge parts from it, (nc,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    order = np.argsort(topology.edge, kind="stable").reshape(-1, 2)
    order = order[~sharp[order[:, 0]]]
    one, other = order.T

    def following(c: np.ndarray) -> np.ndarray:
        return c - c % 4 + (c + 1) % 4

    rows = np.concatenate([one, following(one)])
    columns = np.concatenate([following(other), other])
    n = len(cage.corners)
    graph = coo_array((np.ones(len(rows)), (rows, columns)), (n, n))
    _, label = connected_components(graph, directed=False)
    return np.bincount(label)[label]


def _corner_points(
    cage: PolygonMesh, topology: Corners, inner: np.ndarray, on_edge: np.ndarray, count: np.ndarray
) -> np.ndarray:
    """Where the vertices come to lie, (n, 3): on the limit surface."""
    x = cage.vertices
    places = np.column_stack(
        [np.bincount(cage.corners, column, len(x)) for column in inner.T]
    ) / np.bincount(cage.corners, minlength=len(x))[:, None]  # fmt: skip
    crease = (4.0 * x + topology.sum_of_neighbours(x, on_edge)) / 6.0
    places = np.where((count == 2)[:, None], crease, places)
    places = np.where((count > 2)[:, None], x, places)
    darts, ends = dart_points(cage, topology, on_edge, count)
    places[darts] = ends
    return places


def _bernstein(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cubic Bernstein polynomials and their derivatives, (nt, 4) each."""
    s = 1.0 - t
    value = np.stack([s**3, 3 * s * s * t, 3 * s * t * t, t**3], axis=-1)
    slope = np.stack([-3 * s * s, 3 * s * s - 6 * s * t, 6 * s * t - 3 * t * t, 3 * t * t], axis=-1)
    return value, slope


def _distance(cage: PolygonMesh, nets: np.ndarray) -> float:
    """Largest distance of the limit surface from the patches, by a much finer cage.

    All its vertices are looked at, and between them where they are farthest off.
    """
    uv = np.tile(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), (len(cage), 1, 1))
    root = np.arange(len(cage))
    deep = cage
    tags = np.concatenate([cage.sharpness, cage.point_sharpness])
    semi = tags[tags < SHARP].max(initial=0.0)
    # deep enough for few quads, and for semi-sharp edges to be used up
    wanted = max(_DEEP + (len(cage) <= 500), int(np.ceil(semi)))
    room = int(np.log(max(_DEEP_QUADS / len(cage), 1.0)) / np.log(4.0))
    for _ in range(max(min(wanted, room), _DEEP)):
        deep = subdivide(deep)
        after, before = np.roll(uv, -1, axis=1), np.roll(uv, 1, axis=1)
        middle = np.broadcast_to(uv.mean(axis=1, keepdims=True), uv.shape)
        uv = np.stack([uv, 0.5 * (uv + after), middle, 0.5 * (uv + before)], axis=2)
        uv = uv.reshape(-1, 4, 2)
        root = np.repeat(root, 4)
    limit = limit_points(deep)[deep.quads]
    # one corner of each quad says it all but for sides, which neighbours have in common
    off = _off(nets[root], uv[:, 0], limit[:, 0])
    if off.max() > 1e-12 * cage.diagonal:
        off = np.maximum(off, _between(deep, uv, root, off, nets))
    # edges that are still half sharp: the limit is between that with and that without them
    hard, peak = deep.sharpness >= SHARP, deep.point_sharpness >= SHARP
    if not (hard.all() and peak.all()):
        deep = replace(
            deep,
            creases=deep.creases[hard], sharpness=deep.sharpness[hard],
            points=deep.points[peak], point_sharpness=deep.point_sharpness[peak],
        )  # fmt: skip
        limit = limit_points(deep)[deep.quads]
        off = np.maximum(off, _off(nets[root], uv[:, 0], limit[:, 0]))
    return _MARGIN * float(off.max())


def _between(
    deep: PolygonMesh, uv: np.ndarray, root: np.ndarray, off: np.ndarray, nets: np.ndarray
) -> float:
    """Largest distance between vertices of the finer cage, in the quads that are farthest off."""
    worst = np.zeros(len(nets))
    np.maximum.at(worst, root, off)
    topology = Corners.of(deep)
    # their own patches are the limit surface
    regular = (topology.valence[deep.quads] == 4).all(axis=1)
    rows = np.flatnonzero(regular & (worst[root] > _SHARE * worst.max()))
    rows = rows[np.argsort(-worst[root[rows]], kind="stable")][:_MOST_ROWS]
    exact = bezier_nets(deep)[0][rows]
    line = np.linspace(0.0, 1.0, _PLACES, endpoint=False)
    value = _bernstein(line)[0]
    points = np.einsum("sa,tb,qabd->qstd", value, value, exact, optimize=True).reshape(-1, 3)
    first, along, across = (uv[rows, k][:, None, None] for k in (0, 1, 3))
    s, t = line[:, None, None], line[:, None]
    places = (first + s * (along - first) + t * (across - first)).reshape(-1, 2)
    return float(
        _off(np.repeat(nets[root[rows]], _PLACES**2, axis=0), places, points).max(initial=0)
    )


def _off(nets: np.ndarray, uv: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distances of points (q, 3) from patches, at most; uv (q, 2) is near the nearest place.

    Points of sides are compared with the patch's side: beside a crest, which is farther off the
    limit surface than that is off it, a patch may be nearer than its crest.
    """
    inner = (uv > 0.0) & (uv < 1.0)
    best = np.full(len(points), np.inf)
    for _ in range(_NEARER):
        (left, du), (right, dv) = (_bernstein(uv[:, axis]) for axis in (0, 1))
        rows = np.einsum("qb,qabd->qad", right, nets, optimize=True)
        away = points - np.einsum("qa,qad->qd", left, rows)
        best = np.minimum(best, np.linalg.norm(away, axis=1))
        # a Gauss-Newton step along the surface; any place bounds the distance from above
        along = np.einsum("qa,qad->qd", du, rows) * inner[:, :1]
        across = np.einsum("qa,qb,qabd->qd", left, dv, nets, optimize=True) * inner[:, 1:]
        uu, uw, ww = (
            (a * b).sum(axis=1) for a, b in ((along, along), (along, across), (across, across))
        )
        at_u, at_w = (along * away).sum(axis=1), (across * away).sum(axis=1)
        uu, ww = (a + (a == 0.0) for a in (uu, ww))
        whole = np.maximum(uu * ww - uw * uw, 1e-12 * uu * ww)
        step = np.column_stack([ww * at_u - uw * at_w, uu * at_w - uw * at_u]) / whole[:, None]
        uv = np.clip(uv + np.clip(step, -0.5, 0.5), 0.0, 1.0)
    return best


def _normal_jump(cage: PolygonMesh, nets: np.ndarray, sharp: np.ndarray) -> float:
    """Largest angle of the normals of neighbours at 9 places of their sides that are not sharp."""
    edge = Corners.of(cage).edge
    order = np.argsort(edge, kind="stable").reshape(-1, 2)
    order = order[~sharp[order[:, 0]]]
    t = np.linspace(0.0, 1.0, 9)
    normal = np.empty((len(nets), 4, len(t), 3))
    for side, (u, v) in enumerate(((t, 0 * t), (0 * t + 1, t), (1 - t, 0 * t + 1), (0 * t, 1 - t))):
        (left, du), (right, dv) = _bernstein(u), _bernstein(v)
        normal[:, side] = np.cross(
            np.einsum("qa,qb,fabd->fqd", du, right, nets, optimize=True),
            np.einsum("qa,qb,fabd->fqd", left, dv, nets, optimize=True),
        )
    normal /= np.maximum(np.linalg.norm(normal, axis=3, keepdims=True), 1e-300)
    normal = normal.reshape(-1, len(t), 3)
    one, other = normal[order[:, 0]], normal[order[:, 1], ::-1]
    sine = np.linalg.norm(np.cross(one, other), axis=2)
    return float(np.arctan2(sine, (one * other).sum(axis=2)).max(initial=0.0))
