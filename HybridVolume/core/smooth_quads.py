# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Smooth bicubic surfaces from quad meshes: one normal across every side (Fig. 8 a, b).

Quads with regular vertices keep the bicubic patch of Catmull and Clark. Quads at an irregular
vertex get three by three bicubic pieces with equal slopes (Fan and Peters 2008 show that about so
many are needed). Along a side with the curve b the two slopes across it obey

    left(t) + right(t) = alpha(t) b'(t)

with alpha = 2 cos(2 pi / n) at an end with n sides and minus that at the other one. Beside a
vertex with four sides alpha has no slope either: it is zero on the first third, quadratic on the
second, linear on the last; else it is linear. Given alpha, that is linear in the control points:
the nearest solution to the patches of Loop and Schaefer is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import lsmr

from ..errors import FaultError, InputError
from . import bspline
from .catmull_clark import bezier_nets
from .merged_quads import merged_faces
from .polygons import PolygonMesh, have, off_centre, some
from .subdivision import Corners, subdivide
from .surface import SplineFace

LEFT = 1e-11
"""Largest slope across a side that is left open, as a share of the mesh's mean side."""
_SPLINE = bspline.clamped_knots(3, 3, 2)
_COARSE = bspline.insertion_matrix(3, bspline.clamped_knots(3, 1), _SPLINE)
_PIECES = bspline.insertion_matrix(3, _SPLINE, bspline.clamped_knots(3, 3, 3))
_ELEVATE = bspline.bezier_elevation(3, 1)


@dataclass(frozen=True)
class SmoothQuads:
    """Bicubic patches with one normal across every side.

    Attributes
    ----------
    faces : tuple of SplineFace
    quads : int
        Quads that they stand for, and of them those with three by three pieces.
    split : int
    normal_jump : float
        Largest angle between normals at 50 places of every side of a quad, rad.
    moved : float
        Farthest that a control point was moved from the patches of Loop and Schaefer, mm.
    nets, numbers : (q, 4, 4, 3) array, (q,) int array
        Bézier points of all pieces, mm, and the face of the mesh that each is from.
    """

    faces: tuple[SplineFace, ...]
    quads: int
    split: int
    normal_jump: float
    moved: float
    nets: np.ndarray
    numbers: np.ndarray


def smooth_quads(mesh: PolygonMesh, steps: int = 0) -> SmoothQuads:
    """Smooth bicubic patches of a closed mesh.

    Parameters
    ----------
    mesh : PolygonMesh
        As `mended` gives it; creases are smoothed over.
    steps : int
        Subdivisions of Catmull and Clark first, at least one where there are other faces than
        quads.

    Raises
    ------
    InputError
        A vertex belongs to two faces only.
    FaultError
        No smooth surface was found.
    """
    pairs = np.flatnonzero(Corners.of(mesh).valence == 2)
    if len(pairs):
        raise InputError(
            f"{some('vertex', mesh.vertex_number[pairs])} {have(pairs, 'belongs', 'belong')} to two"
            " faces only, which no smooth surface can have",
            figure=float(len(pairs)),
            remedy="dissolve them, so that the two faces are one, or choose Catmull-Clark",
        )
    if (mesh.sizes != 4).any():
        steps = max(steps, 1)
    shift, no_edges, none = off_centre(mesh), np.zeros((0, 2), dtype=np.int64), np.zeros(0)
    mesh = replace(
        mesh,
        vertices=mesh.vertices - shift,
        creases=no_edges, sharpness=none, points=no_edges[:, 0], point_sharpness=none,
    )  # fmt: skip
    cage = subdivide(mesh, steps)
    nets, _ = bezier_nets(cage, creases=False)
    quads, topology = cage.quads, Corners.of(cage)
    irregular = topology.valence != 4
    chosen = np.flatnonzero(irregular[quads].any(axis=1))
    split: dict[int, np.ndarray] = {}
    moved = 0.0
    if len(chosen):
        start = np.einsum("pa,qb,fabd->fpqd", _COARSE, _COARSE, nets[chosen], optimize=True)
        found = _smoothed(quads, topology, chosen, start)
        moved = float(np.linalg.norm(found - start, axis=-1).max())
        pieces = np.einsum("pa,qb,fabd->fpqd", _PIECES, _PIECES, found, optimize=True)
        split = dict(zip(chosen.tolist(), pieces, strict=True))
    faces = merged_faces(quads, nets, np.zeros((0, 2), dtype=int), cage.diagonal, split or None)
    plain = np.setdiff1d(np.arange(len(quads)), chosen)
    thirds = [
        pieces[:, 3 * i : 3 * i + 4, 3 * j : 3 * j + 4]
        for i in range(3) for j in range(3) if len(chosen)
    ]  # fmt: skip
    return SmoothQuads(
        tuple(replace(face, control_points=face.control_points + shift) for face in faces),
        len(quads),
        len(chosen),
        _jump(quads, topology, nets, split),
        moved,
        np.concatenate([nets[plain], *thirds]) + shift,
        cage.face_number[np.concatenate([plain, *(chosen for _ in thirds)])],
    )


_ROWS = tuple(
    (np.ravel_multi_index(side, (8, 8)), np.ravel_multi_index(inner, (8, 8)))
    for side, inner in (
        ((np.arange(8), np.full(8, 0)), (np.arange(8), np.full(8, 1))),
        ((np.full(8, 7), np.arange(8)), (np.full(8, 6), np.arange(8))),
        ((np.arange(7, -1, -1), np.full(8, 7)), (np.arange(7, -1, -1), np.full(8, 6))),
        ((np.full(8, 0), np.arange(7, -1, -1)), (np.full(8, 1), np.arange(7, -1, -1))),
    )
)
"""Coefficients on each side of a quad from corner to corner, and those of the row inside."""


def _smoothed(
    quads: np.ndarray, topology: Corners, chosen: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """Spline coefficients (ns, 8, 8, 3) of the chosen quads that meet smoothly."""
    place = np.full(len(quads), -1)
    place[chosen] = np.arange(len(chosen))
    order = np.argsort(topology.edge, kind="stable").reshape(-1, 2)
    here, there = place[order // 4].T
    table, points = _numbered(quads[chosen], order, place, start)
    fixed = np.zeros(len(points), dtype=bool)
    # next to quads that keep their patch, position and slope stay
    for one, other, column in ((here, there, 0), (there, here, 1)):
        for half in order[(one >= 0) & (other < 0), column]:
            for row in _ROWS[half % 4]:
                fixed[table[place[half // 4]][row]] = True
    both = order[(here >= 0) & (there >= 0)]
    valence = topology.valence[quads.ravel()]
    heads = topology.valence[np.roll(quads, -1, axis=1).ravel()]
    rows, columns, values = [], [], []
    for number, (half, twin) in enumerate(both.tolist()):
        side, inner = (table[place[half // 4]][row] for row in _ROWS[half % 4])
        _, across = (table[place[twin // 4]][row[::-1]] for row in _ROWS[twin % 4])
        slope, curve = _condition(int(valence[half]), int(heads[half]))
        for at, block in ((inner, slope), (across, slope), (side, curve)):
            rows.append(np.repeat(15 * number + np.arange(15), 8))
            columns.append(np.tile(at, 15))
            values.append(block.ravel())
    rows, columns, values = (np.concatenate(a) for a in (rows, columns, values))
    matrix = coo_array((values, (rows, columns)), (15 * len(both), len(points))).tocsr()
    free = np.flatnonzero(~fixed)
    open_ = matrix[:, free]
    size = np.linalg.norm(start[:, -1, 0] - start[:, 0, 0], axis=1).mean()
    for axis in range(3):
        # a second time for what rounding left of the first
        for _ in range(3):
            missing = matrix @ points[:, axis]
            if np.abs(missing).max() <= LEFT * size:
                break
            step = lsmr(open_, -missing, atol=1e-14, btol=1e-14, conlim=0, maxiter=20_000)[0]
            points[free, axis] += step
    left = float(np.abs(matrix @ points).max())
    if left > 100.0 * LEFT * size:
        raise FaultError(
            f"slopes across sides of quads stay open by {left:.2g} mm",
            figure=left,
            remedy="subdivide the quads once",
        )
    return points[table].reshape(start.shape)


def _numbered(
    quads: np.ndarray, order: np.ndarray, place: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Number of each coefficient (ns, 64), those on common sides the same, and their places."""
    n = len(quads)
    label = np.arange(64 * n).reshape(n, 64)
    one, other = order.T
    both = (place[one // 4] >= 0) & (place[other // 4] >= 0)
    ends: list[np.ndarray] = []
    for half, twin in order[both].tolist():
        side, _ = _ROWS[half % 4]
        back, _ = _ROWS[twin % 4]
        ends.append(
            np.column_stack([label[place[half // 4], side], label[place[twin // 4], back[::-1]]])
        )
    # corners of quads around one vertex that share no side with a chosen quad
    corner = label[:, [0, 56, 63, 7]].ravel()
    vertex = quads.ravel()
    by = np.argsort(vertex, kind="stable")
    same = vertex[by][1:] == vertex[by][:-1]
    ends.append(np.column_stack([corner[by][1:][same], corner[by][:-1][same]]))
    pairs = np.concatenate(ends)
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(pairs)), tuple(pairs.T)), (64 * n, 64 * n))
    count, table = connected_components(graph, directed=False)
    points = np.zeros((count, 3))
    points[table] = start.reshape(-1, 3)
    return table.reshape(n, 64), points


@cache
def _condition(tail: int, head: int) -> tuple[np.ndarray, np.ndarray]:
    """Factors (15, 8) of a row inside, and of the side, in left + right - alpha b' = 0.

    Rows are Bernstein coefficients of degree 4 on each third; all is divided by 9, the factor of a
    slope across.
    """
    first = 2.0 * np.cos(2.0 * np.pi / tail) if tail != 4 else 0.0
    last = -2.0 * np.cos(2.0 * np.pi / head) if head != 4 else 0.0
    raised = np.concatenate([_ELEVATE @ _PIECES[3 * k : 3 * k + 4] for k in range(3)])
    curve = -2.0 * raised
    for k, alpha in enumerate(_alpha(first, last)):
        slope = np.diff(_PIECES[3 * k : 3 * k + 4], axis=0)  # degree 2, over 9
        curve[5 * k : 5 * k + 5] -= _times(alpha) @ slope
    return raised, curve


def _alpha(first: float, last: float) -> np.ndarray:
    """Bernstein coefficients of degree 2 of alpha on each third, (3, 3)."""
    if first == 0.0:
        return last / 3.0 * np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 2.0, 3.0]])
    if last == 0.0:
        return _alpha(0.0, first)[::-1, ::-1]
    t = np.arange(3)[:, None] / 3.0 + np.arange(3) / 6.0
    return first + (last - first) * t


def _times(alpha: np.ndarray) -> np.ndarray:
    """Matrix (5, 3) from the Bernstein coefficients of a quadratic to those of alpha times it."""
    result = np.zeros((5, 3))
    binomial = np.array([1.0, 2.0, 1.0])
    total = np.array([1.0, 4.0, 6.0, 4.0, 1.0])
    for i in range(3):
        for j in range(3):
            result[i + j, j] += alpha[i] * binomial[i] * binomial[j] / total[i + j]
    return result


def _jump(
    quads: np.ndarray, topology: Corners, nets: np.ndarray, split: dict[int, np.ndarray]
) -> float:
    """Largest angle between the normals of both sides at 50 places of every side."""
    t = np.linspace(0.0, 1.0, 50)
    knots = {4: bspline.clamped_knots(3, 1), 10: bspline.clamped_knots(3, 3, 3)}
    ways = ((t, 0 * t), (0 * t + 1, t), (1 - t, 0 * t + 1), (0 * t, 1 - t))
    normal = np.empty((len(quads), 4, len(t), 3))
    chosen = np.array(sorted(split), dtype=int)
    plain = np.setdiff1d(np.arange(len(quads)), chosen)
    batches = [(plain, nets[plain])]
    if len(chosen):
        batches.append((chosen, np.stack([split[k] for k in chosen.tolist()])))
    for members, points in batches:
        line = knots[points.shape[1]]
        for side, (u, v) in enumerate(ways):
            (left, du), (right, dv) = (_basis(line, x) for x in (u, v))
            normal[members, side] = np.cross(
                np.einsum("qa,qb,fabd->fqd", du, right, points, optimize=True),
                np.einsum("qa,qb,fabd->fqd", left, dv, points, optimize=True),
            )
    normal /= np.maximum(np.linalg.norm(normal, axis=3, keepdims=True), 1e-300)
    normal = normal.reshape(-1, len(t), 3)
    order = np.argsort(topology.edge, kind="stable").reshape(-1, 2)
    one, other = normal[order[:, 0]], normal[order[:, 1], ::-1]
    sine = np.linalg.norm(np.cross(one, other), axis=2)
    return float(np.arctan2(sine, (one * other).sum(axis=2)).max(initial=0.0))


def _basis(knots: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and derivatives of all basis functions, (nx, n) each."""
    return tuple(bspline.basis_matrix(3, knots, x, order).toarray() for order in (0, 1))
