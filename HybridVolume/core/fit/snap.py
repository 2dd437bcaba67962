# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A quad mesh onto a reference: into its frame, corners to corners, sharp edges to features."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...errors import InputError
from ..polygons import PolygonMesh
from .reference import Chain, Reference, edge_turns, feature_chains, feature_nodes

SHARP = 30.0
"""Degrees by which the quads at an edge turn where it should be a feature."""
ROUNDS = 60
ALIKE = 0.05
"""Mean distance of a mesh from its reference, as a share of the diagonal, that is too much."""
NEAR = 0.6
"""Distance of a sharp vertex from a feature, in mean sides of the quads there, that is near."""
FAR = 2.0
"""So many times as far a line may go on beside a feature that it follows."""


@dataclass(frozen=True)
class Snapped:
    """A quad mesh on its reference.

    Attributes
    ----------
    mesh : PolygonMesh
        Its vertices lie on the reference.
    chain : (e,) int array
        For each edge of the mesh the feature of the reference that it follows, or -1.
    length : (e, 2) array
        Where on it the edge's ends are.
    """

    mesh: PolygonMesh
    chain: np.ndarray
    length: np.ndarray


def aligned(mesh: PolygonMesh, reference: Reference) -> PolygonMesh:
    """The mesh moved, turned and scaled alike in all directions onto the reference.

    From bounding box to bounding box, then by nearest points and their best similarity.

    Raises
    ------
    InputError
        The two do not look alike.
    """
    x, y = mesh.vertices, reference.vertices
    scale = np.linalg.norm(np.ptp(y, axis=0)) / np.linalg.norm(np.ptp(x, axis=0))
    middle = 0.5 * (x.max(axis=0) + x.min(axis=0))
    x = (x - middle) * scale + 0.5 * (y.max(axis=0) + y.min(axis=0))
    for _ in range(ROUNDS):
        near, _ = reference.nearest(x)
        a, b = x - x.mean(axis=0), near - near.mean(axis=0)
        u, size, v = np.linalg.svd(a.T @ b)
        sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
        turn = (u * sign) @ v
        grown = float((size * sign).sum() / (a * a).sum())
        moved = grown * (x - x.mean(axis=0)) @ turn + near.mean(axis=0)
        step = float(np.abs(moved - x).max())
        x = moved
        if step < 1e-6 * reference.diagonal:
            break
    off = float(np.linalg.norm(reference.nearest(x)[0] - x, axis=1).mean())
    if off > ALIKE * reference.diagonal:
        raise InputError(
            f"the quads lie {off / reference.diagonal:.1%} of the diagonal beside the reference"
            " in the mean",
            figure=off,
            remedy="bring them into the same frame first",
        )
    return replace(mesh, vertices=x)


def snapped(mesh: PolygonMesh, reference: Reference, sharp: float = SHARP) -> Snapped:
    """The mesh with all vertices on the reference, sharp ones on its features.

    Where a line of sharp edges runs on beyond the end of a feature, it is smooth from there.

    Parameters
    ----------
    mesh : PolygonMesh
        Of quads, `aligned`.
    reference : Reference
    sharp : float
        Degrees.
    """
    x = mesh.vertices
    ends, turn = edge_turns(mesh)
    number = {tuple(pair): k for k, pair in enumerate(ends.tolist())}
    chain_of = np.full(len(ends), -1)
    length_of = np.zeros((len(ends), 2))
    edges = ends[turn > sharp]
    nodes = feature_nodes(x, edges)
    places: dict[int, list[np.ndarray]] = {}
    for line in feature_chains(x, edges, nodes):
        side = float(np.diff(line.length).mean())
        best, run = _follow(line.points, reference, NEAR * side)
        if best < 0:
            continue
        feature = reference.chains[best]
        first, last = run
        at = _ends_on(feature, line.points[first : last + 1], NEAR * side)
        own = line.length[first : last + 1]
        share = (own - own[0]) / max(own[-1] - own[0], 1e-300)
        stations = at[0] + (at[1] - at[0]) * share
        points = feature.at(stations)
        for k, vertex in enumerate(line.vertices[first : last + 1].tolist()):
            places.setdefault(vertex, []).append(points[k])
        for k in range(first, last):
            a, b = line.vertices[k], line.vertices[k + 1]
            row = number[(min(a, b), max(a, b))]
            chain_of[row] = best
            one, other = stations[k - first], stations[k - first + 1]
            length_of[row] = (one, other) if a < b else (other, one)
    normals = np.zeros_like(x)
    np.add.at(normals, mesh.corners, mesh.area_vectors()[mesh.face_of])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    moved, _ = reference.nearest(x, normals)
    for vertex, found in places.items():
        moved[vertex] = np.mean(found, axis=0)
    return Snapped(replace(mesh, vertices=moved), chain_of, length_of)


def _ends_on(feature: Chain, points: np.ndarray, near: float) -> np.ndarray:
    """Where a line begins and ends on a feature, (2,); around a closed one by the way it takes."""
    at, _ = feature.nearest(points)
    total = feature.length[-1]
    if feature.closed:
        steps = np.diff(at)
        steps -= total * np.round(steps / total)
        return np.array([at[0], at[0] + steps.sum()])
    ends = at[[0, -1]]
    # ends near a node of the reference are that node
    for k in (0, 1):
        for node in (0.0, total):
            if abs(ends[k] - node) < near:
                ends[k] = node
    return ends


def _follow(points: np.ndarray, reference: Reference, near: float) -> tuple[int, tuple[int, int]]:
    """The feature that a line follows best, and the first and last of its points that do."""
    best, most, nearest = -1, 1, np.inf
    run = (0, 0)
    for k, feature in enumerate(reference.chains):
        at, off = feature.nearest(points)
        on = off < near
        if not on.any():
            continue
        # once there a line may be further off, but not beyond a feature's end
        beside = (off < FAR * near) & (feature.closed | ((at > 0.0) & (at < feature.length[-1])))
        # while it runs along it
        step = np.abs(np.diff(at))
        if feature.closed:
            step = np.minimum(step, feature.length[-1] - step)
        along = step > 0.5 * np.linalg.norm(np.diff(points, axis=0), axis=1)
        beside &= np.append(along, along[-1:]) & np.append(along[:1], along)
        on = _grown(on, beside)
        # the longest stretch of points that are near
        edges = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(int), [0]])))
        starts, stops = edges[::2], edges[1::2]
        longest = int(np.argmax(stops - starts))
        count = int(stops[longest] - starts[longest])
        mean = float(off[starts[longest] : stops[longest]].mean())
        if count > 1 and (count > most or (count == most and mean < nearest)):
            best, most, nearest = k, count, mean
            run = (int(starts[longest]), int(stops[longest]) - 1)
    return best, run


def _grown(on: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """Where a line is on something, with stretches beside it that reach there."""
    both = on | beside
    number = np.cumsum(np.diff(both, prepend=False))
    return both & np.isin(number, number[on & both])
