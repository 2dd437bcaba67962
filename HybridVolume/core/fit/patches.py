# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bicubic splines over a layout: samples of the reference under every quad, fitted with knots.

Curvature is continuous inside a patch; patches meet in common curves, fitted once. Knots stand
where quads meet, as far apart as the quads are wide, the same for all quads of a ring.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .. import bspline
from ..quad_layout import QuadLayout, quad_layout
from ..surface import SplineFace
from .corners import FlatCorner, opened
from .reference import Reference
from .snap import Snapped

SAMPLES = 8
"""Samples along the side of a quad."""
SMOOTHINGS = 8
"""Times that samples inside quads are evened out on the reference."""
STIFFNESS = 1e-6
"""Weight of second differences of control points beside the samples."""


@dataclass(frozen=True)
class Sampled:
    """Points of the reference under every quad.

    Attributes
    ----------
    layout : QuadLayout
    points : tuple of (m k + 1, n k + 1, 3) arrays
        Samples of each patch with k to a quad; neighbours have the same on common sides.
    lines : tuple of ((m + 1,), (n + 1,)) arrays
        Parameters of the lines of quads, in mm of the rings' widths.
    rings : tuple of ((m,), (n,)) int arrays
        Ring of quads between each line and the next.
    opened : tuple of FlatCorner
        Straight corners on features, which are opened.
    """

    layout: QuadLayout
    points: tuple[np.ndarray, ...]
    lines: tuple[tuple[np.ndarray, np.ndarray], ...]
    rings: tuple[tuple[np.ndarray, np.ndarray], ...]
    opened: tuple[FlatCorner, ...] = ()

    @property
    def ring_count(self) -> int:
        """Number of rings."""
        return 1 + max(int(ring.max()) for pair in self.rings for ring in pair)


def sampled(snap: Snapped, reference: Reference, reach: float = 0.0) -> Sampled:
    """Sample the reference under a snapped mesh.

    Parameters
    ----------
    snap : Snapped
    reference : Reference
    reach : float
        Distance by which straight corners on features may be moved, mm.
    """
    mesh = snap.mesh
    quads, x = mesh.quads, mesh.vertices
    ends, edge = mesh.edges
    following = snap.chain >= 0
    layout = quad_layout(quads, ends[following])
    normals = np.zeros_like(x)
    np.add.at(normals, mesh.corners, mesh.area_vectors()[mesh.face_of])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    share = np.arange(SAMPLES + 1) / SAMPLES
    # sides of quads, from the end with the smaller number
    a, b = x[ends[:, 0]], x[ends[:, 1]]
    line = a[:, None] + share[:, None] * (b - a)[:, None]
    look = normals[ends[:, 0]][:, None] * (1 - share)[:, None]
    look = look + normals[ends[:, 1]][:, None] * share[:, None]
    sides = _on(reference, line, look)
    for k in np.flatnonzero(following):
        feature = reference.chains[snap.chain[k]]
        sides[k] = feature.at(snap.length[k, 0] + share * np.diff(snap.length[k]))
    sides[:, 0], sides[:, -1] = a, b
    around = edge.reshape(-1, 4)
    inside = _inside(quads, ends, around, sides, normals, reference)
    moved, corners = opened(quads, ends, around, following, sides, reach)
    inside = inside + _between(quads, ends, around, moved - sides)
    lines, rings = _widths(layout, quads, edge, moved)
    return Sampled(layout, _assembled(layout, inside), lines, rings, tuple(corners))


def _on(reference: Reference, points: np.ndarray, look: np.ndarray) -> np.ndarray:
    shape = points.shape
    look = look / np.maximum(np.linalg.norm(look, axis=-1, keepdims=True), 1e-300)
    return reference.nearest(points.reshape(-1, 3), look.reshape(-1, 3))[0].reshape(shape)


def _between(
    quads: np.ndarray, ends: np.ndarray, edge: np.ndarray, sides: np.ndarray
) -> np.ndarray:
    """Coons' surface (nf, k + 1, k + 1, 3) between the sides of each quad."""
    share = np.arange(SAMPLES + 1) / SAMPLES
    rows = []
    for k in range(4):
        forward = quads[:, k] == ends[edge[:, k], 0]
        own = sides[edge[:, k]]
        rows.append(np.where(forward[:, None, None], own, own[:, ::-1]))
    low, high = rows[0], rows[2][:, ::-1]
    left, right = rows[3][:, ::-1], rows[1]
    u, v = share[None, :, None, None], share[None, None, :, None]
    grid = (1 - v) * low[:, :, None] + v * high[:, :, None]
    grid = grid + (1 - u) * left[:, None] + u * right[:, None]
    for i, j, su, sv in (
        (0, 0, 1 - u, 1 - v),
        (-1, 0, u, 1 - v),
        (0, -1, 1 - u, v),
        (-1, -1, u, v),
    ):
        grid = grid - su * sv * (low if j == 0 else high)[:, i][:, None, None]
    return grid


def _inside(
    quads: np.ndarray,
    ends: np.ndarray,
    edge: np.ndarray,
    sides: np.ndarray,
    normals: np.ndarray,
    reference: Reference,
) -> np.ndarray:
    """Samples (nf, k + 1, k + 1, 3) of each quad, u from its first corner to the second."""
    share = np.arange(SAMPLES + 1) / SAMPLES
    u, v = share[None, :, None, None], share[None, None, :, None]
    grid = _between(quads, ends, edge, sides)
    corner = normals[quads]
    look = (1 - u) * (1 - v) * corner[:, None, None, 0] + u * (1 - v) * corner[:, None, None, 1]
    look = look + u * v * corner[:, None, None, 2] + (1 - u) * v * corner[:, None, None, 3]
    inner = (slice(None), slice(1, -1), slice(1, -1))
    grid[inner] = _on(reference, grid[inner], look[inner])
    for _ in range(SMOOTHINGS):
        mean = 0.25 * (
            grid[:, 2:, 1:-1] + grid[:, :-2, 1:-1] + grid[:, 1:-1, 2:] + grid[:, 1:-1, :-2]
        )
        grid[inner] = _on(reference, 0.5 * (mean + grid[inner]), look[inner])
    return grid


def _assembled(layout: QuadLayout, inside: np.ndarray) -> tuple[np.ndarray, ...]:
    k = SAMPLES
    grids = [
        np.empty((k * (g.shape[0] - 1) + 1, k * (g.shape[1] - 1) + 1, 3)) for g in layout.grids
    ]
    for quad, (patch, (i, j)) in enumerate(zip(layout.patch, layout.cell.tolist(), strict=True)):
        net = np.rot90(inside[quad], -int(layout.first[quad]), axes=(0, 1))
        grids[patch][k * i : k * i + k + 1, k * j : k * j + k + 1] = net
    return tuple(grids)


_Pairs = tuple[tuple[np.ndarray, np.ndarray], ...]


def _widths(
    layout: QuadLayout, quads: np.ndarray, edge: np.ndarray, sides: np.ndarray
) -> tuple[_Pairs, _Pairs]:
    """Parameters of the lines of quads of each patch, by the rings' mean widths; and the rings."""
    length = np.linalg.norm(np.diff(sides, axis=1), axis=2).sum(axis=1)
    around = edge.reshape(-1, 4)
    rows = np.concatenate([around[:, 0], around[:, 1]])
    columns = np.concatenate([around[:, 2], around[:, 3]])
    n = len(sides)
    _, ring = connected_components(coo_array((np.ones(len(rows)), (rows, columns)), (n, n)), False)
    width = np.bincount(ring, length) / np.bincount(ring)
    rings = [
        (np.zeros(g.shape[0] - 1, dtype=int), np.zeros(g.shape[1] - 1, dtype=int))
        for g in layout.grids
    ]
    for quad, (patch, (i, j)) in enumerate(zip(layout.patch, layout.cell.tolist(), strict=True)):
        first = int(layout.first[quad])
        rings[patch][0][i] = ring[around[quad, first]]
        rings[patch][1][j] = ring[around[quad, (first + 1) % 4]]
    lines = tuple(
        tuple(np.concatenate([[0.0], np.cumsum(width[own])]) for own in pair) for pair in rings
    )
    return lines, tuple(rings)


def fitted(made: Sampled, spans: np.ndarray, stiffness: np.ndarray) -> list[SplineFace]:
    """Bicubic spline patches of the samples.

    Parameters
    ----------
    made : Sampled
    spans : (rings,) int array
        Knot spans of each ring.
    stiffness : (patches,) array
        Weight of fairness inside each patch; sides have `STIFFNESS`.
    """
    faces = []
    for number, (points, lines, rings) in enumerate(
        zip(made.points, made.lines, made.rings, strict=True)
    ):
        knots, bases = zip(
            *(_basis(line, spans[ring]) for line, ring in zip(lines, rings, strict=True)),
            strict=True,
        )
        net = _fit(points, bases, float(stiffness[number]))
        faces.append(
            SplineFace(
                name=f"Face{number + 1}",
                degrees=(3, 3),
                knots=knots,
                control_points=net,
                weights=np.ones(net.shape[:2]),
            )
        )
    return faces


def _basis(line: np.ndarray, spans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Knots over the lines of quads, and the basis functions at the samples."""
    line = line / line[-1]
    cuts = [np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(line, line[1:], spans, strict=False)]
    knots = np.concatenate([np.zeros(4), np.concatenate(cuts)[1:], np.ones(4)])
    share = np.arange(SAMPLES) / SAMPLES
    at = np.append((line[:-1, None] + np.diff(line)[:, None] * share).ravel(), 1.0)
    return knots, bspline.basis_matrix(3, knots, at).toarray()


def _fit(points: np.ndarray, bases: tuple[np.ndarray, np.ndarray], stiffness: float) -> np.ndarray:
    """Control points: corners, then sides by themselves, then what is inside."""
    left, right = bases
    net = np.empty((left.shape[1], right.shape[1], 3))
    for j in (0, -1):
        net[:, j] = _curve(left, points[:, j], STIFFNESS)
        net[j] = _curve(right, points[j], STIFFNESS)
    rest = points - np.einsum("ua,vb,abd->uvd", left, right, _framed(net), optimize=True)
    u, v = (_solver(basis, stiffness) for basis in bases)
    inner = np.einsum("au,bv,uvd->abd", u, v, rest, optimize=True)
    net[1:-1, 1:-1] = inner + _coons(net)[1:-1, 1:-1]
    return net


def _framed(net: np.ndarray) -> np.ndarray:
    """The net with Coons points inside its frame."""
    full = net.copy()
    full[1:-1, 1:-1] = _coons(net)[1:-1, 1:-1]
    return full


def _coons(net: np.ndarray) -> np.ndarray:
    u = np.linspace(0.0, 1.0, net.shape[0])[:, None, None]
    v = np.linspace(0.0, 1.0, net.shape[1])[None, :, None]
    ruled = (1 - v) * net[:, :1] + v * net[:, -1:] + (1 - u) * net[:1] + u * net[-1:]
    return ruled - (
        (1 - u) * (1 - v) * net[0, 0]
        + u * (1 - v) * net[-1, 0]
        + (1 - u) * v * net[0, -1]
        + u * v * net[-1, -1]
    )


def _solver(basis: np.ndarray, stiffness: float) -> np.ndarray:
    """Matrix from samples to the control points inside, with ends that are zero."""
    free = basis[:, 1:-1]
    second = np.diff(np.eye(basis.shape[1]), 2, axis=0)[:, 1:-1]
    matrix = free.T @ free + stiffness * len(basis) * second.T @ second
    return np.linalg.solve(matrix, free.T)


def _curve(basis: np.ndarray, points: np.ndarray, stiffness: float) -> np.ndarray:
    """Control points of a curve between the first and last of its points."""
    n = basis.shape[1]
    share = np.linspace(0.0, 1.0, n)[:, None]
    start = (1 - share) * points[0] + share * points[-1]
    inner = _solver(basis, stiffness) @ (points - basis @ start)
    start[1:-1] += inner
    return start
