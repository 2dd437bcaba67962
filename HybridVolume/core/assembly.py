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
from .surface import SIDE_DIRECTION, Patch, PatchSurface, SplineFace, side_of

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
    _match_weights(nets, partner, reverse, gap)
    points, indices, weights, moved = _weld(nets, partner, reverse, gap)
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
    count = len(partner)
    label = np.full((count, 2), -1)
    turn = np.zeros((count, 2), dtype=bool)
    symmetric: list[bool] = []
    for start in np.ndindex(count, 2):
        if label[start] >= 0:
            continue
        strip = len(symmetric)
        symmetric.append(False)
        label[start] = strip
        todo = [start]
        while todo:
            k, d = todo.pop()
            for side in (2, 3) if d == 0 else (0, 1):
                other, other_side = partner[k, side]
                there = (int(other), SIDE_DIRECTION[other_side])
                turned = bool(turn[k, d] ^ reverse[k, side])
                if label[there] < 0:
                    label[there], turn[there] = strip, turned
                    todo.append(there)
                elif turn[there] != turned:
                    symmetric[strip] = True
    return label, turn, symmetric


def _side_pairs(partner: np.ndarray) -> list[tuple[int, int, int, int]]:
    return [
        (k, side, int(partner[k, side, 0]), int(partner[k, side, 1]))
        for k in range(len(partner))
        for side in range(4)
        if (partner[k, side, 0], partner[k, side, 1]) > (k, side)
    ]


def _match_weights(nets: list[Net], partner: np.ndarray, reverse: np.ndarray, gap: float) -> None:
    """Scale each patch's weights by one factor so that shared sides carry the same weights."""
    count = len(nets)
    done = np.zeros(count, dtype=bool)
    polynomial = [np.ptp(net.weights) <= 1e-15 * net.weights.max() for net in nets]
    for k in np.flatnonzero(polynomial):
        nets[k].weights = np.ones_like(nets[k].weights)
        done[k] = True
    queue = list(np.flatnonzero(done))
    for seed in [None, *range(count)]:
        if seed is not None:
            if done[seed]:
                continue
            done[seed] = True
            queue = [seed]
        while queue:
            k = queue.pop()
            for side in range(4):
                other, other_side = partner[k, side]
                if done[other]:
                    continue
                mine = side_of(nets[k].weights, side)
                theirs = side_of(nets[other].weights, other_side)
                theirs = theirs[::-1] if reverse[k, side] else theirs
                factor = float(np.exp(np.mean(np.log(mine / theirs))))
                if abs(factor - 1.0) > 1e-15:
                    nets[other].weights = nets[other].weights * factor
                done[other] = True
                queue.append(other)
    bad, worst, twisted, largest = set(), 0.0, set(), 1.0
    for k, side, other, other_side in _side_pairs(partner):
        mine, theirs = side_of(nets[k].weights, side), side_of(nets[other].weights, other_side)
        theirs = theirs[::-1] if reverse[k, side] else theirs
        factor = float(np.exp(np.mean(np.log(mine / theirs))))
        length = np.linalg.norm(np.ptp(side_of(nets[k].points, side), axis=0))
        # a relative change of one weight moves the curve by at most a quarter of it times the side
        off = float(np.abs(mine / theirs / factor - 1.0).max()) * length / 4.0
        if off > gap:
            bad |= {nets[k].name, nets[other].name}
            worst = max(worst, off)
        elif abs(factor - 1.0) * length / 4.0 > gap:
            twisted |= {nets[k].name, nets[other].name}
            largest = max(largest, factor, 1.0 / factor)
    if bad:
        raise errors.GapError(
            f"the weights of sides that meet differ by more than a factor: off by {worst:.2g} mm,"
            f" allowed {gap:.2g} mm",
            faces=natural_order(bad),
            figure=worst,
            remedy="rebuild the faces with matching weights or raise --tolerance",
        )
    if twisted:
        # the sides of the volume elements below would not match
        raise errors.GapError(
            "the weights of sides that meet agree up to factors, but around a closed strip of"
            f" faces the factors multiply to {largest:.4g}, not to 1",
            faces=natural_order(twisted),
            figure=largest,
            remedy="rebuild the faces with equal weights at their corners",
        )


def _weld(
    nets: list[Net], partner: np.ndarray, reverse: np.ndarray, gap: float
) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray], np.ndarray]:
    """One global control point for all that meet; the lowest-numbered face's bits win."""
    sizes = [net.weights.size for net in nets]
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    local = [
        np.arange(offsets[k], offsets[k + 1]).reshape(net.weights.shape)
        for k, net in enumerate(nets)
    ]
    raw = np.concatenate([net.points.reshape(-1, 3) for net in nets])
    raw_weights = np.concatenate([net.weights.ravel() for net in nets])
    left, right = [], []
    bad, worst = set(), 0.0
    for k, side, other, other_side in _side_pairs(partner):
        mine, theirs = side_of(local[k], side), side_of(local[other], other_side)
        theirs = theirs[::-1] if reverse[k, side] else theirs
        off = float(np.linalg.norm(raw[mine] - raw[theirs], axis=1).max())
        # control points may be farther apart than the curves that they make
        if off > 16.0 * gap:
            bad |= {nets[k].name, nets[other].name}
            worst = max(worst, off)
        left.append(mine)
        right.append(theirs)
    if bad:
        raise errors.GapError(
            f"control points of sides that meet are {worst:.2g} mm apart, allowed {16 * gap:.2g}"
            " mm: the sides are the same curve at different speed",
            faces=natural_order(bad),
            figure=worst,
            remedy="rebuild the faces on common curves or raise --tolerance",
        )
    left, right = np.concatenate(left), np.concatenate(right)
    graph = sparse.coo_matrix((np.ones(len(left)), (left, right)), shape=(len(raw), len(raw)))
    _, label = sparse.csgraph.connected_components(graph, directed=False)
    _, first = np.unique(label, return_index=True)
    kept = np.sort(first)
    order = np.empty(len(first), dtype=int)
    order[label[kept]] = np.arange(len(kept))
    ids = order[label]
    shift = np.linalg.norm(raw - raw[kept][ids], axis=1)
    moved = np.array([shift[offsets[k] : offsets[k + 1]].max() for k in range(len(nets))])
    indices = [ids[ls] for ls in local]
    weights = [raw_weights[kept][index] for index in indices]
    return raw[kept], indices, weights, moved


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
    state = np.zeros(count, dtype=int)
    for seed in range(count):
        if state[seed]:
            continue
        state[seed] = 1
        todo = [seed]
        while todo:
            k = todo.pop()
            for side in range(4):
                other, other_side = partner[k, side]
                run = _COUNTER_CLOCKWISE[side] * _COUNTER_CLOCKWISE[other_side]
                run *= -1 if reverse[k, side] else 1
                wanted = state[k] * -run
                if state[other] == 0:
                    state[other] = wanted
                    todo.append(int(other))
                elif state[other] != wanted:
                    raise errors.OrientationError(
                        "the surface is one-sided: inside and outside cannot be told",
                        faces=[nets[k].name, nets[other].name],
                        remedy="give a closed solid",
                    )
    return state < 0


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
    return PatchSurface(points, patches, new_partner, new_reverse, shell, moved, exact)


def _turn_outward(surface: PatchSurface) -> PatchSurface:
    """Outer shell positive and first, cavities negative, by signed volumes."""
    volumes = surface.shell_volumes()
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
