# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Surfaces of equal distance to the body's surface, as midstructures."""

from __future__ import annotations

import logging

import numpy as np
from scipy.sparse import coo_matrix

from ...errors import FaultError, InputError
from ..intersection import self_intersections
from ..surface import PatchSurface
from .assembled import connected_facets, from_pieces
from .distances import SurfaceDistance
from .lattice import Lattice, build_lattice
from .marching import bad_vertices, marching_tetrahedra
from .sheets import Midstructure
from .thickness import Thickness, local_thickness

log = logging.getLogger(__name__)

# Squares of the cell size that the surface of equal distance has, has at most for the sake of round
# parts, and at most for the sake of thin ones.
CELLS, ROUND_CELLS, THIN_CELLS = 800, 1500, 8000
# Share of the area that may be resolved worse than needed: where thin layers run out.
UNRESOLVED = 0.1
# Cells of the octree at most: flat parts take as many as they need.
LIMIT = 120_000
# Cell size in units of the distance from the surface of equal distance to the middle of the body:
# fine enough for a round part, and at least needed for a flat one.
ROUND, FLAT = 0.35, 1.4
# A vertex of the tetrahedra within this share of its cell from the surface is moved onto it.
SNAP = 0.25
# Pieces of fewer triangles are too small for the cells to tell their form.
FEWEST = 12
# Largest error of the distance at the vertices, relative.
EXACT = 0.01

REASON = "at the chosen depth"


def distance_surface(surface: PatchSurface, value: float, share: bool) -> Midstructure:
    """Take the places at an equal distance from the surface as the midstructure.

    Parameters
    ----------
    surface : PatchSurface
    value : float
        Depth in mm, or as a share of the largest depth inside the body.
    share : bool

    Returns
    -------
    Midstructure
        Closed triangles, one sheet for every connected piece. Parts of the body that are nowhere
        as deep have none.

    Raises
    ------
    InputError
        The depth is not less than the largest one, or what is left is too thin to be resolved;
        ``figure`` is the largest possible depth, mm.
    """
    distance = SurfaceDistance(surface)
    thickness = local_thickness(distance)
    largest = largest_depth(distance, thickness)
    depth = value * largest if share else value
    if not 0.0 < depth < 0.995 * largest:
        raise InputError(
            f"no place inside the body is {depth:.4g} mm deep; the deepest is at {largest:.4g} mm",
            figure=largest,
            remedy="choose a smaller depth, or a share such as 50%",
        )
    lattice = _lattice(distance, thickness, depth, largest)
    vertices, triangles = _isosurface(distance, lattice, depth)
    piece = connected_facets(triangles, len(vertices))
    size = np.bincount(piece)
    small = size < min(FEWEST, int(size.max()))
    if small.any():
        log.info("%d pieces of the distance surface are too small", int(small.sum()))
        used, triangles = np.unique(triangles[~small[piece]], return_inverse=True)
        vertices, triangles = vertices[used], triangles.reshape(-1, 3)
        piece = connected_facets(triangles, len(vertices))
    return from_pieces(surface, distance, vertices, triangles, piece, "distance", REASON)


def largest_depth(distance: SurfaceDistance, thickness: Thickness) -> float:
    """Radius of the largest ball in the body, mm."""
    order = np.argsort(-thickness.ball)[:300]
    # balls between samples may be too large: look along the whole way to their centres
    way = thickness.centre[order] - thickness.points[order]
    share = np.array([0.4, 0.7, 1.0])[:, None, None]
    centres = (thickness.points[order] + share * way).reshape(-1, 3)
    centres = centres[distance.inside(centres)]
    if not len(centres):
        raise FaultError("no place inside the body was found")
    depth = distance(centres)
    if depth.max() > 0.999 * thickness.ball.max():
        # no ball that touches the surface is larger
        return float(depth.max())
    best = np.argsort(-depth)[:6]
    centres, depth = centres[best], depth[best]
    step = 0.2 * depth.max()
    rng = np.random.default_rng(0)
    for _ in range(40):
        ways = rng.normal(size=(len(centres), 12, 3))
        ways /= np.linalg.norm(ways, axis=2, keepdims=True)
        trial = centres[:, None] + step * ways
        value = distance(trial.reshape(-1, 3)).reshape(len(centres), -1)
        pick = value.argmax(axis=1)
        rows = np.arange(len(centres))
        better = value[rows, pick] > depth
        centres[better] = trial[rows, pick][better]
        depth[better] = value[rows, pick][better]
        if not better.any():
            step *= 0.5
        if step < 3e-4 * depth.max():
            break
    return float(depth.max())


def _lattice(
    distance: SurfaceDistance, thickness: Thickness, depth: float, largest: float
) -> Lattice:
    """Points and tetrahedra, small near the given depth."""
    reached = thickness.half > depth
    area = thickness.area[reached]
    left = thickness.half[reached] - depth
    even = np.sqrt(area.sum() / CELLS)
    needed = np.minimum(np.minimum(even, 2.0 * depth), FLAT * left)
    # where a layer runs out it is as thin as can be: some of the area is left to larger cells
    floor = 0.5 * even
    while area[needed < 0.7 * floor].sum() > UNRESOLVED * area.sum():
        floor *= 0.9
        if (area / np.maximum(needed, floor) ** 2).sum() > THIN_CELLS:
            raise InputError(
                f"{depth:.4g} mm deep, what is left of the body is too thin to be resolved",
                figure=largest,
                remedy="choose another depth, or the medial axis",
            )
    needed = np.maximum(needed, floor)
    fine = np.minimum(needed, np.maximum(ROUND * left, floor))
    share = 1.0
    while (area / np.minimum(fine * share, needed) ** 2).sum() > ROUND_CELLS and share < 10.0:
        share *= 1.1
    fine = np.minimum(fine * share, needed)
    cell = np.full(len(thickness.half), even)
    cell[reached] = fine

    def wanted(sample: np.ndarray, _depth: np.ndarray) -> np.ndarray:
        return cell[thickness.of_sample[sample]]

    # the distance to the nearest sample is too large by so much
    error = min(distance.spacing, 0.5 * distance.spacing**2 / depth)

    def near(middle: np.ndarray, half: float) -> np.ndarray:
        return np.abs(middle - depth) < 1.1 * half + error

    lattice = build_lattice(distance, wanted, near, depth, limit=LIMIT)
    if lattice is None:
        raise InputError(
            f"{depth:.4g} mm deep, what is left of the body is too large to be resolved",
            figure=largest,
            remedy="choose another depth, or the medial axis",
        )
    return lattice


def _isosurface(
    distance: SurfaceDistance, lattice: Lattice, depth: float
) -> tuple[np.ndarray, np.ndarray]:
    values = lattice.depth - depth
    points, zero = _snapped(lattice, values)
    for _ in range(50):
        edges, triangles = marching_tetrahedra(lattice.tets, values, zero)
        bad = bad_vertices(triangles, len(edges))
        if not len(bad):
            break
        drawn = np.unique(edges[bad])
        if not zero[drawn].any():
            raise FaultError("the surface of equal distance is not closed")
        zero[drawn] = False
    else:
        edges, triangles = marching_tetrahedra(lattice.tets, values, np.zeros_like(zero))
        points = lattice.points
    if not len(triangles):
        raise FaultError("no surface of equal distance was found")
    high, low = edges.T
    points = np.where(zero[:, None], points, lattice.points)
    with np.errstate(invalid="ignore", divide="ignore"):
        t = np.where(high == low, 0.0, values[high] / (values[high] - values[low]))
    raw = points[high] + t[:, None] * (points[low] - points[high]) + lattice.origin
    size = lattice.size[edges].max(axis=1)
    smooth = _onto(distance, raw, depth, size)
    sharp = _fitted(distance, smooth, triangles, depth, size)
    return _uncut(triangles, sharp, smooth, raw), triangles


def _snapped(lattice: Lattice, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points near the surface moved onto it, as long as no tetrahedron turns over, and which."""
    zero = np.abs(values) < SNAP * lattice.size
    moved = lattice.points - values[:, None] * lattice.inward
    tets = lattice.tets[zero[lattice.tets].any(axis=1)]

    def volumes(points: np.ndarray) -> np.ndarray:
        x = points[tets]
        a, b, c = (x[:, k] - x[:, 0] for k in (1, 2, 3))
        return np.einsum("mi,mi->m", a, np.cross(b, c))

    before = volumes(lattice.points)
    while True:
        points = np.where(zero[:, None], moved, lattice.points)
        turned = volumes(points) < 0.1 * before
        turned &= zero[tets].any(axis=1)
        if not turned.any():
            return points, zero
        zero[tets[turned]] = False


def _uncut(
    triangles: np.ndarray, sharp: np.ndarray, smooth: np.ndarray, raw: np.ndarray
) -> np.ndarray:
    """The sharp vertices, but where triangles cut each other the smooth ones, or the raw ones."""
    vertices = sharp.copy()
    some = np.zeros(len(vertices), dtype=bool)
    for k in range(12):
        pairs = self_intersections(vertices, triangles)
        if not len(pairs):
            return vertices
        some[triangles[np.unique(pairs)]] = True
        for _ in range(max(0, k - 4)):
            some[triangles[some[triangles].any(axis=1)]] = True
        log.info("%d triangles of the distance surface cut each other", len(np.unique(pairs)))
        vertices[some] = (smooth if k == 0 else raw)[some]
    if len(self_intersections(raw, triangles)):
        raise FaultError("the surface of equal distance cuts itself")
    return raw


def _onto(
    distance: SurfaceDistance, points: np.ndarray, depth: float, size: np.ndarray
) -> np.ndarray:
    """Points moved along the gradient of the distance until it is the depth."""
    points = points.copy()
    active = np.arange(len(points))
    for _ in range(4):
        gap, gradient = _gap(distance, points[active], depth)
        step = np.clip(gap, -0.5 * size[active], 0.5 * size[active])
        points[active] -= step[:, None] * gradient
        active = active[np.abs(gap) > 1e-4 * depth]
        if not len(active):
            break
    return points


def _gap(
    distance: SurfaceDistance, points: np.ndarray, depth: float
) -> tuple[np.ndarray, np.ndarray]:
    """How much deeper than the depth points inside are, and the gradient of the distance."""
    feet = distance.nearest(points, candidates=2)
    gradient = points - feet.points
    gradient /= np.maximum(feet.distance, np.finfo(float).tiny)[:, None]
    return feet.distance - depth, gradient


def _fitted(
    distance: SurfaceDistance,
    vertices: np.ndarray,
    triangles: np.ndarray,
    depth: float,
    size: np.ndarray,
) -> np.ndarray:
    """Vertices moved onto creases and to the middle of their neighbours.

    Each vertex comes as near as possible to the tangent planes over the triangles around it: on
    smooth parts that is the surface itself, at a crease the line where its two sides meet. After
    Ohtake and Belyaev, *Dual/primal mesh optimization for polygonized implicit surfaces* (2002).
    """
    n = len(vertices)
    start = vertices
    owner, triangle = triangles.ravel(), np.repeat(np.arange(len(triangles)), 3)
    shape = (n, len(triangles))
    gather = coo_matrix((np.ones(len(owner)), (owner, triangle)), shape=shape).tocsr()
    for _ in range(3):
        middle = vertices[triangles].mean(axis=1)
        gap, normal = _gap(distance, middle, depth)
        plane = middle - gap[:, None] * normal
        x = vertices[triangles]
        area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
        weight = gather @ area
        weight = np.maximum(weight, np.finfo(float).tiny)
        centre = (gather @ (middle * area[:, None])) / weight[:, None]
        # relative to the centre: minimise the weighted squares of distances to all planes, and a
        # little the distance to the centre
        shares = gather.multiply(area[None, :]).tocsr()
        square = np.einsum("ti,tj->tij", normal, normal).reshape(-1, 9)
        matrix = (shares @ square).reshape(n, 3, 3) / weight[:, None, None]
        offset = np.einsum("ti,ti->t", normal, plane)
        right = (shares @ (normal * offset[:, None])) / weight[:, None]
        right -= np.einsum("nij,nj->ni", matrix, centre)
        matrix += 0.01 * np.eye(3)
        move = centre + np.linalg.solve(matrix, right[..., None])[..., 0] - vertices
        length = np.linalg.norm(move, axis=1)
        limit = 0.5 * size
        move *= np.minimum(1.0, limit / np.maximum(length, np.finfo(float).tiny))[:, None]
        vertices = vertices + move
    gap, _ = _gap(distance, vertices, depth)
    smooth = np.abs(gap) > 0.5 * EXACT * depth
    vertices[smooth] = _onto(distance, vertices[smooth], depth, size[smooth])
    gap, _ = _gap(distance, vertices[smooth], depth)
    lost = np.flatnonzero(smooth)[np.abs(gap) > EXACT * depth]
    vertices[lost] = start[lost]
    return vertices
