# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""From loose NURBS faces to one closed surface: pairing, conforming, welding, orientation.

Sides that meet get the same degree and knots by exact elevation and insertion along whole strips of
patches; then their control points agree and become one. What cannot match is refused by name.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from .. import errors
from . import bspline
from .pairing import Net, check_sides, make_net, natural_order, pair_sides
from .sides import Meetings, meetings
from .surface import SIDE_DIRECTION, Patch, PatchSurface, SplineFace

_COUNTER_CLOCKWISE = np.array([-1, 1, 1, -1])
"""Whether each side runs with (+1) or against (-1) the patch's boundary seen from outside."""


def build_surface(faces: list[SplineFace], tolerance: float = 1e-7) -> PatchSurface:
    """Join faces to the closed surface of one body.

    Parameters
    ----------
    faces : list of SplineFace
        All faces of the body, cavities included.
    tolerance : float
        Largest gap between sides that meet, as a share of the body's diagonal.

    Returns
    -------
    PatchSurface
        One patch a face, in the order given, oriented outward.

    Raises
    ------
    InputError
        One of its kinds, naming the faces.
    """
    if not faces:
        raise errors.InputError(
            "the body has no NURBS faces", remedy="give a body of untrimmed NURBS faces"
        )
    nets = [make_net(face) for face in faces]
    corners = np.concatenate([net.points.reshape(-1, 3) for net in nets])
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    gap = tolerance * diagonal
    check_sides(nets, gap)
    partner, reverse = pair_sides(nets, gap)
    _conform(nets, partner, reverse)
    met = meetings([net.weights.shape for net in nets], partner, reverse)
    _match_weights(nets, met, gap)
    points, indices, weights, moved = _weld(nets, met, gap)
    _check_vertices(nets, points, indices, gap)
    flipped = _orientation(nets, partner, reverse)
    patches = tuple(
        Patch(net.name, tuple(net.degrees), tuple(net.knots), index, weight)
        for net, index, weight in zip(nets, indices, weights, strict=True)
    )
    exact = np.array([net.exact for net in nets])
    surface = _oriented(points, patches, partner, reverse, flipped, moved, exact)
    return _turn_outward(surface)


def _conform(nets: list[Net], partner: np.ndarray, reverse: np.ndarray) -> None:
    """Give every strip of patches one degree and one knot vector."""
    label, turn, symmetric = direction_strips(partner, reverse)
    for strip in range(label.max() + 1):
        members = np.argwhere(label == strip)
        if _agree([(nets[k].degrees[d], nets[k].knots[d]) for k, d in members]):
            continue
        degree = max(nets[k].degrees[d] for k, d in members)
        vectors = []
        for k, d in members:
            net = nets[k]
            times = degree - net.degrees[d]
            if times:
                matrix, knots = bspline.elevation_matrix(net.degrees[d], net.knots[d], times)
                net.refine(d, matrix)
                net.knots[d], net.degrees[d] = knots, degree
            vectors.append(1.0 - net.knots[d][::-1] if turn[k, d] else net.knots[d])
        if symmetric[strip]:
            vectors += [1.0 - knots[::-1] for knots in vectors]
        target = bspline.merge_knots(degree, vectors)
        for k, d in members:
            net = nets[k]
            wanted = 1.0 - target[::-1] if turn[k, d] else target
            # a knot of the face keeps its bits
            wanted = bspline.snap_knots(wanted, net.knots[d])
            if len(wanted) != len(net.knots[d]):
                net.refine(d, bspline.insertion_matrix(degree, net.knots[d], wanted))
                net.knots[d] = wanted


def _agree(splines: list[tuple[int, np.ndarray]]) -> bool:
    """Whether all have one degree and one knot vector, which is the same both ways."""
    degree, knots = splines[0]
    if not np.array_equal(knots, 1.0 - knots[::-1]):
        return False
    given = knots.tobytes()
    return all(p == degree and t.tobytes() == given for p, t in splines[1:])


def direction_strips(
    partner: np.ndarray, reverse: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[bool]]:
    """Parameter directions of patches that must agree because their sides meet.

    Parameters
    ----------
    partner : (np, 4, 2) int array
        Patch and side that meet each side.
    reverse : (np, 4) bool array
        Whether the partner runs the other way.

    Returns
    -------
    label : (np, 2) int array
        Strip of each patch's u and v.
    turn : (np, 2) bool array
        Whether the patch runs against its strip.
    symmetric : list of bool
        Strips that meet themselves the other way round, like a Möbius band.
    """
    along = np.asarray(SIDE_DIRECTION)
    here = 2 * np.arange(len(partner))[:, None] + along
    there = 2 * partner[..., 0] + along[partner[..., 1]]
    label, turn, symmetric = _signs(2 * len(partner), here.ravel(), there.ravel(), reverse.ravel())
    return label.reshape(-1, 2), turn.reshape(-1, 2), symmetric.tolist()


def _signs(
    count: int, one: np.ndarray, other: np.ndarray, unlike: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signs of things of which pairs are known to be alike or unlike.

    Parameters
    ----------
    count : int
    one, other : (m,) int arrays
    unlike : (m,) bool array

    Returns
    -------
    label : (count,) int array
        Which things hang together, numbered in the order of their first ones.
    turn : (count,) bool array
        Whether a thing is unlike the first of those that it hangs together with.
    torn : (labels,) bool array
        Those in which a thing would have to be unlike itself.
    """
    # each thing stands there twice, as it is and turned
    rows = np.concatenate([one, one + count])
    columns = np.concatenate([other + count * unlike, other + count * ~unlike])
    shape = (2 * count, 2 * count)
    graph = sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=shape)
    _, part = sparse.csgraph.connected_components(graph, directed=False)
    plain, turned = part[:count], part[count:]
    _, first, label = np.unique(np.minimum(plain, turned), return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    first = first[order]
    label = rank[label.ravel()]
    return label, plain != plain[first][label], plain[first] == turned[first]


def _match_weights(nets: list[Net], met: Meetings, gap: float) -> None:
    """Scale each patch's weights by one factor so that shared sides carry the same weights.

    Polynomial patches keep weight 1 where that can be; a face of equal weights between two arcs may
    need another one.
    """
    sizes = np.array([net.weights.size for net in nets])
    start = np.cumsum(sizes) - sizes
    raw = np.concatenate([net.weights.ravel() for net in nets])
    least, largest = np.minimum.reduceat(raw, start), np.maximum.reduceat(raw, start)
    plain = largest - least <= 1e-15 * largest
    for k in np.flatnonzero(plain & ((least != 1.0) | (largest != 1.0))):
        nets[k].weights = np.ones_like(nets[k].weights)
    raw = np.where(np.repeat(plain, sizes), 0.0, np.log(raw))
    points = np.concatenate([net.points.reshape(-1, 3) for net in nets])
    count = np.diff(np.append(met.start, len(met.left)))
    ratio = raw[met.left] - raw[met.right]
    jump = np.add.reduceat(ratio, met.start) / count
    size = np.linalg.norm(
        np.maximum.reduceat(points[met.left], met.start)
        - np.minimum.reduceat(points[met.left], met.start),
        axis=1,
    )
    # a relative change of one weight moves the curve by at most a quarter of it times the side
    spread = np.abs(np.expm1(ratio - np.repeat(jump, count)))
    off = np.maximum.reduceat(spread, met.start) * size / 4.0
    if np.any(off > gap):
        raise errors.GapError(
            f"the weights of sides that meet differ by more than a factor: off by {off.max():.2g}"
            f" mm, allowed {gap:.2g} mm",
            faces=_names(nets, met.pairs[off > gap]),
            figure=float(off.max()),
            remedy="rebuild the faces with matching weights or raise --tolerance",
        )
    level = np.add.reduceat(raw, start) / sizes
    first = None
    for fixed in (plain, np.zeros(len(nets), dtype=bool)):
        factor = _factors(met.pairs, jump, fixed, level)
        left = np.abs(jump + factor[met.pairs[:, 0]] - factor[met.pairs[:, 2]])
        twisted = np.expm1(left) * size / 4.0 > gap
        if not twisted.any():
            break
        first = first or (_names(nets, met.pairs[twisted]), float(np.exp(left[twisted].max())))
    else:
        # the sides of the volume elements below would not match
        faces, largest = first
        raise errors.GapError(
            "the weights of sides that meet agree up to factors, but around a closed strip of"
            f" faces the factors multiply to {largest:.4g}, not to 1",
            faces=faces,
            figure=largest,
            remedy="rebuild the faces with equal weights at their corners",
        )
    for k in np.flatnonzero(np.abs(factor) > 1e-15):
        # exp2 is exact for whole numbers
        power = factor[k] / np.log(2.0)
        whole = np.abs(power - np.round(power)) < 1e-14
        nets[k].weights = nets[k].weights * np.exp2(np.round(power) if whole else power)


def _factors(
    pairs: np.ndarray, jump: np.ndarray, fixed: np.ndarray, level: np.ndarray
) -> np.ndarray:
    """Logarithms of the patches' factors, spread from fixed patches.

    A shell without one spreads from its first patch, and a power of two, which keeps all bits of
    the weights, then brings their mean near to 1: the weights inside will be 1.

    Parameters
    ----------
    pairs : (ns, 4) int array
    jump : (ns,) array
        What the other patch needs more than the first.
    fixed : (np,) bool array
        Patches with factor 1.
    level : (np,) array
        Mean logarithm of the weights.
    """
    count = len(fixed)
    factor = np.zeros(count)
    source = np.concatenate([pairs[:, 0], pairs[:, 2]])
    target = np.concatenate([pairs[:, 2], pairs[:, 0]])
    graph = sparse.coo_matrix((np.ones(len(source)), (source, target)), shape=(count, count))
    shells, shell = sparse.csgraph.connected_components(graph, directed=False)
    free = ~np.isin(np.arange(shells), shell[fixed])
    if np.any(np.abs(jump) > 1e-15):
        first = np.unique(shell, return_index=True)[1]
        seeds = np.concatenate([np.flatnonzero(fixed), first[free]])
        # one more node from which all seeds hang
        rows = np.concatenate([source, np.full(len(seeds), count)])
        columns = np.concatenate([target, seeds])
        tree = sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(count + 1,) * 2)
        order, before = sparse.csgraph.breadth_first_order(tree, count)
        inner = order[(before[order] >= 0) & (before[order] < count)]
        key, chosen = np.unique(source * count + target, return_index=True)
        step = np.concatenate([jump, -jump])[chosen]
        steps = step[np.searchsorted(key, before[inner] * count + inner)]
        for k, last, more in zip(inner, before[inner], steps, strict=True):
            factor[k] = factor[last] + more
    mean = np.bincount(shell, factor + level) / np.bincount(shell)
    return factor - np.where(free, np.log(2.0) * np.round(mean / np.log(2.0)), 0.0)[shell]


def _names(nets: list[Net], pairs: np.ndarray) -> list[str]:
    """Faces of pairs of sides."""
    return natural_order({nets[k].name for k in np.unique(pairs[:, [0, 2]])})


def _weld(
    nets: list[Net], met: Meetings, gap: float
) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray], np.ndarray]:
    """One global control point for all that meet; the lowest-numbered face's bits win."""
    shapes = [net.weights.shape for net in nets]
    offsets = np.concatenate([[0], np.cumsum([a * b for a, b in shapes])])
    raw = np.concatenate([net.points.reshape(-1, 3) for net in nets])
    raw_weights = np.concatenate([net.weights.ravel() for net in nets])
    apart = np.linalg.norm(raw[met.left] - raw[met.right], axis=1)
    off = np.maximum.reduceat(apart, met.start)
    # control points may be farther apart than the curves that they make
    if np.any(off > 16.0 * gap):
        raise errors.GapError(
            f"control points of sides that meet are {off.max():.2g} mm apart, allowed"
            f" {16 * gap:.2g} mm: the sides are the same curve at different speed",
            faces=_names(nets, met.pairs[off > 16.0 * gap]),
            figure=float(off.max()),
            remedy="rebuild the faces on common curves or raise --tolerance",
        )
    ids, kept = met.welded(len(raw))
    shift = np.linalg.norm(raw - raw[kept][ids], axis=1)
    moved = np.maximum.reduceat(shift, offsets[:-1])
    indices = [
        ids[a:b].reshape(shape)
        for a, b, shape in zip(offsets[:-1], offsets[1:], shapes, strict=True)
    ]
    shared = raw_weights[kept]
    return raw[kept], indices, [shared[index] for index in indices], moved


def _check_vertices(
    nets: list[Net], points: np.ndarray, indices: list[np.ndarray], gap: float
) -> None:
    """Faces that touch in a point without a chain of shared sides around it."""
    corner = np.array([index[np.ix_((0, -1), (0, -1))].ravel() for index in indices])
    used = np.unique(corner)
    pairs = cKDTree(points[used]).query_pairs(4.0 * gap, output_type="ndarray")
    if len(pairs):
        touching = np.isin(corner, used[pairs.ravel()]).any(axis=1)
        raise errors.NonManifoldError(
            "faces touch in a point without sharing a side there",
            faces=[nets[k].name for k in np.flatnonzero(touching)],
            remedy="separate the parts or join them in faces",
        )


def _orientation(nets: list[Net], partner: np.ndarray, reverse: np.ndarray) -> np.ndarray:
    """Patches to turn over so that all normals of a shell agree."""
    count = len(partner)
    other, other_side = partner[..., 0], partner[..., 1]
    run = _COUNTER_CLOCKWISE * _COUNTER_CLOCKWISE[other_side] * np.where(reverse, -1, 1)
    here = np.repeat(np.arange(count), 4)
    label, turn, torn = _signs(count, here, other.ravel(), run.ravel() > 0)
    if torn.any():
        raise errors.OrientationError(
            "the surface is one-sided: inside and outside cannot be told",
            faces=[nets[k].name for k in np.flatnonzero(torn[label])],
            remedy="give a closed solid",
        )
    return turn


_TRANSPOSED_SIDE = np.array([2, 3, 0, 1])


def _oriented(
    points: np.ndarray,
    patches: tuple[Patch, ...],
    partner: np.ndarray,
    reverse: np.ndarray,
    flipped: np.ndarray,
    moved: np.ndarray,
    exact: np.ndarray,
) -> PatchSurface:
    patches = tuple(
        p.transposed() if f else p for p, f in zip(patches, flipped, strict=True)
    )  # fmt: skip
    new_partner = partner.copy()
    new_partner[..., 1] = np.where(
        flipped[partner[..., 0]], _TRANSPOSED_SIDE[partner[..., 1]], partner[..., 1]
    )
    rows = np.where(flipped[:, None], _TRANSPOSED_SIDE, np.arange(4))
    new_partner = np.take_along_axis(new_partner, rows[..., None], axis=1)
    new_reverse = np.take_along_axis(reverse, rows, axis=1)
    count = len(patches)
    graph = sparse.coo_matrix(
        (np.ones(4 * count), (np.repeat(np.arange(count), 4), partner[..., 0].ravel())),
        shape=(count, count),
    )
    _, shell = sparse.csgraph.connected_components(graph, directed=False)
    return PatchSurface(points, patches, new_partner, new_reverse, shell, moved, exact, flipped)


def _turn_outward(surface: PatchSurface) -> PatchSurface:
    """Outer shell positive and first, cavities negative, by signed volumes."""
    volumes = surface.shell_volumes(settle=False)
    small = np.abs(volumes) <= 1e-12 * surface.diagonal**3
    if small.any():
        shell = int(np.flatnonzero(small)[0])
        raise errors.OrientationError(
            f"a shell encloses no volume ({volumes[shell]:.2g} mm³)",
            faces=[p.face for p, s in zip(surface.patches, surface.shell_of_patch, strict=True)
                   if s == shell],
            figure=float(volumes[shell]),
            remedy="give a closed solid with a volume",
        )  # fmt: skip
    order = np.argsort(-np.abs(volumes), kind="stable")
    rank = np.empty(len(order), dtype=int)
    rank[order] = np.arange(len(order))
    if len(order) > 1:
        _check_cavities(surface, order)
    shell = rank[surface.shell_of_patch]
    wrong = np.where(rank == 0, volumes < 0, volumes > 0)[surface.shell_of_patch]
    turned = _oriented(
        surface.control_points,
        surface.patches,
        surface.neighbour,
        surface.reversed,
        wrong,
        surface.moved,
        surface.exact,
    )
    return PatchSurface(
        turned.control_points,
        turned.patches,
        turned.neighbour,
        turned.reversed,
        shell,
        surface.moved,
        surface.exact,
        surface.turned ^ wrong,
    )


def _solid_angle(vertices: np.ndarray, triangles: np.ndarray, point: np.ndarray) -> float:
    """Winding number of a closed triangle surface about a point."""
    a, b, c = (vertices[triangles[:, i]] - point for i in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    numerator = np.einsum("ij,ij->i", a, np.cross(b, c))
    denominator = (
        la * lb * lc
        + np.einsum("ij,ij->i", a, b) * lc
        + np.einsum("ij,ij->i", b, c) * la
        + np.einsum("ij,ij->i", c, a) * lb
    )
    return float(np.arctan2(numerator, denominator).sum() / (2.0 * np.pi))


def _check_cavities(surface: PatchSurface, order: np.ndarray) -> None:
    """Every cavity must lie inside the outer shell and outside the other cavities."""
    mesh = surface.triangulation(3)
    shell_of_triangle = surface.shell_of_patch[mesh.triangle_patch]
    parts = [mesh.triangles[shell_of_triangle == s] for s in range(surface.shells)]
    for inner in order[1:]:
        point = mesh.vertices[parts[inner][0, 0]]
        faces = [
            p.face
            for p, s in zip(surface.patches, surface.shell_of_patch, strict=True)
            if s == inner
        ]
        if abs(_solid_angle(mesh.vertices, parts[order[0]], point)) < 0.5:
            raise errors.InputError(
                "the body is made of shells that lie side by side",
                faces=faces,
                remedy="give each part as a solid of its own",
            )
        for other in order[1:]:
            if other != inner and abs(_solid_angle(mesh.vertices, parts[other], point)) > 0.5:
                raise errors.InputError(
                    "a cavity lies inside another cavity",
                    faces=faces,
                    remedy="give the inner part as a solid of its own",
                )
