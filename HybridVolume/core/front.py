# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The front: how far each control point moves to reach the level w = w0 (section 3.2).

The paper traces paths along the gradient. Near a convex edge of angle a the exact gradient flow
takes the parameter s to s**(pi / a), so the map has no Jacobian there. The front is therefore
solved: displacements of the Greville points are as smooth as the net allows (graph Laplacian) and
are pulled softly to the level along the gradient; points where the field says nothing follow their
neighbours.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from .. import errors
from .bspline import greville
from .cones import most_inward
from .harmonic import HarmonicField
from .singular import normals_around
from .surface import PatchSurface

logger = logging.getLogger(__name__)

LEVELS = 6
ITERATIONS = 4
STEADY = 0.02
"""Pull towards the most inward line of each node, as a share of the smoothing: without it a coarse
net may drift as a whole, since the level only holds it along the gradient."""
LAGGING = 0.5
"""Share of the level below which a node counts as held back."""
RAY_PULL = 30.0
"""How much more strongly such a node is drawn, straight along its most inward direction."""


@dataclass(frozen=True)
class ColumnFrame:
    """What a column at each control point has to respect.

    Attributes
    ----------
    nodes : (n, 3) array
        Surface points at the Greville abscissae, s(t_l).
    normals : (m, 3) array
        Inward unit normals of all patches that meet at the nodes.
    normal_node : (m,) int array
        Node of each normal.
    direction : (n, 3) array
        Unit direction that is most inward for all normals of the node.
    margin : (n,) array
        Smallest n . d of that direction.
    edges : (ne, 2) int array
        Edges of the control net.
    conductance : (ne,) array
        Dual length over length of each edge.
    area : (n,) array
        Dual area of each node, mm².
    spacing : (n,) array
        Length of the shortest net edge at each node, mm.
    """

    nodes: np.ndarray
    normals: np.ndarray
    normal_node: np.ndarray
    direction: np.ndarray
    margin: np.ndarray
    edges: np.ndarray
    conductance: np.ndarray
    area: np.ndarray
    spacing: np.ndarray

    def least_cosine(self, displacement: np.ndarray) -> np.ndarray:
        """Smallest n . D over the normals of each node, (n,)."""
        along = np.einsum("mi,mi->m", self.normals, displacement[self.normal_node])
        found = np.full(len(self.nodes), np.inf)
        np.minimum.at(found, self.normal_node, along)
        return found

    def mean_normal_length(self, displacement: np.ndarray) -> np.ndarray:
        """Mean of n . D over the normals of each node, (n,)."""
        along = np.einsum("mi,mi->m", self.normals, displacement[self.normal_node])
        count = np.bincount(self.normal_node, minlength=len(self.nodes))
        return np.bincount(self.normal_node, along, len(self.nodes)) / count

    def laplacian(self) -> sparse.csr_matrix:
        """Graph Laplacian of the net, (n, n)."""
        n = len(self.nodes)
        a, b = self.edges.T
        adjacency = sparse.coo_matrix((self.conductance, (a, b)), shape=(n, n))
        adjacency = (adjacency + adjacency.T).tocsr()
        return sparse.diags(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency

    def smooth(self, values: np.ndarray, sweeps: int, *, least: bool = False) -> np.ndarray:
        """Average (or take the least) of node values over neighbours, some sweeps."""
        a, b = self.edges.T
        for _ in range(sweeps):
            if least:
                fresh = values.copy()
                np.minimum.at(fresh, a, values[b])
                np.minimum.at(fresh, b, values[a])
            else:
                count = np.bincount(self.edges.ravel(), minlength=len(values))
                total = np.bincount(a, values[b], len(values)) + np.bincount(
                    b, values[a], len(values)
                )
                fresh = 0.5 * (values + total / np.maximum(count, 1))
            values = fresh
        return values


def column_frame(surface: PatchSurface) -> ColumnFrame:
    """Nodes, normals, net edges and most inward directions of all control points."""
    mesh = surface.triangulation("greville")
    nodes = mesh.vertices
    n = len(nodes)
    normals, owners, edges, conductance = [], [], [], []
    area = np.zeros(n)
    for stack in surface.stacks:
        grid = stack.index
        lines = [greville(p, t) for p, t in zip(stack.degrees, stack.knots, strict=True)]
        u, v = (a.ravel() for a in np.meshgrid(*lines, indexing="ij"))
        patch = np.repeat(stack.members, len(u))
        times = len(stack.members)
        _, x_u, x_v = surface.evaluate_at(patch, np.tile(u, times), np.tile(v, times), 1)
        normal = -np.cross(x_u, x_v).reshape(times, -1, 3)
        normals.append(normal.reshape(-1, 3))
        owners.append(grid.ravel())
        # where the normal is zero those around it count: a column must be inward for all of them
        size = np.linalg.norm(normal, axis=2)
        zero = size < 1e-9 * size.max(axis=1, keepdims=True)
        for place in np.flatnonzero(zero.any(axis=1)):
            rows = zero[place]
            around = normals_around(surface, stack.members[place], u[rows], v[rows])
            normals.append(around.reshape(-1, 3))
            owners.append(np.tile(grid[place].ravel()[rows], len(around)))
        x = nodes[grid]
        du = np.linalg.norm(np.diff(x, axis=1), axis=3)
        dv = np.linalg.norm(np.diff(x, axis=2), axis=3)
        across_u = 0.5 * (dv[:, :-1] + dv[:, 1:])  # mean length across a cell, (m, nu-1, nv-1)
        across_v = 0.5 * (du[:, :, :-1] + du[:, :, 1:])
        low, high, none = (1, 0), (0, 1), (0, 0)
        dual_u = 0.5 * (np.pad(across_u, (none, none, high)) + np.pad(across_u, (none, none, low)))
        dual_v = 0.5 * (np.pad(across_v, (none, high, none)) + np.pad(across_v, (none, low, none)))
        for ends, dual, length in (
            ((grid[:, :-1], grid[:, 1:]), dual_u, du),
            ((grid[:, :, :-1], grid[:, :, 1:]), dual_v, dv),
        ):
            edges.append(np.column_stack([ends[0].ravel(), ends[1].ravel()]))
            floor = 1e-3 * np.median(length, axis=(1, 2), keepdims=True)
            conductance.append((dual / np.maximum(length, floor)).ravel())
        cell = across_u * across_v / 4.0
        for rows in (slice(None, -1), slice(1, None)):
            for columns in (slice(None, -1), slice(1, None)):
                area += np.bincount(grid[:, rows, columns].ravel(), cell.ravel(), n)
    normals, owners = np.concatenate(normals), np.concatenate(owners)
    edges, conductance = np.concatenate(edges), np.concatenate(conductance)
    size = np.linalg.norm(normals, axis=1)
    regular = size > 1e-9 * np.median(size)
    normals, owners = normals[regular] / size[regular, None], owners[regular]
    lengths = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    spacing = np.full(n, np.inf)
    np.minimum.at(spacing, edges[:, 0], lengths)
    np.minimum.at(spacing, edges[:, 1], lengths)
    direction = _directions(n, normals, owners)
    frame = ColumnFrame(
        nodes, normals, owners, direction, np.zeros(n), edges, conductance, area, spacing
    )
    return ColumnFrame(
        nodes,
        normals,
        owners,
        direction,
        frame.least_cosine(direction),
        edges,
        conductance,
        area,
        spacing,
    )


def _directions(n: int, normals: np.ndarray, owners: np.ndarray) -> np.ndarray:
    order = np.argsort(owners, kind="stable")
    counts = np.bincount(owners, minlength=n)
    start = np.concatenate([[0], np.cumsum(counts)[:-1]])
    direction = np.zeros((n, 3))
    for count in np.unique(counts[counts > 0]):
        members = np.flatnonzero(counts == count)
        rows = order[start[members][:, None] + np.arange(count)]
        if count == 1:
            direction[members] = normals[rows[:, 0]]
        else:
            direction[members] = most_inward(normals[rows], np.ones(rows.shape, dtype=bool))
    return direction


def solve_front(
    surface: PatchSurface, frame: ColumnFrame, field: HarmonicField, goal: np.ndarray
) -> np.ndarray:
    """Displacements that take the surface to given levels.

    Parameters
    ----------
    surface : PatchSurface
    frame : ColumnFrame
    field : HarmonicField
    goal : (n,) array
        Level at every control point.

    Returns
    -------
    (n, 3) array
        One displacement a control point, mm.
    """
    n = len(frame.nodes)
    diagonal = surface.diagonal
    stiffness = frame.laplacian()
    degree = stiffness.diagonal()
    pull = 3.0 * degree + frame.area / (0.01 * diagonal) ** 2
    blocks = sparse.kron(stiffness, sparse.eye(3), format="csr")
    across = np.eye(3) - frame.direction[:, :, None] * frame.direction[:, None, :]
    across = STEADY * degree[:, None, None] * across
    displacement = 1e-3 * diagonal * frame.direction
    displacement *= np.minimum(1.0, 0.5 * frame.spacing / (1e-3 * diagonal))[:, None]
    rows = 3 * np.arange(n)[:, None, None] + np.arange(3)[:, None] + np.zeros(3, dtype=int)
    columns = np.swapaxes(rows, 1, 2)

    def solve(normal: np.ndarray, length: np.ndarray, rho: np.ndarray) -> np.ndarray:
        """Smoothest displacements with n . D drawn to a length with weight rho."""
        outer = across + rho[:, None, None] * normal[:, :, None] * normal[:, None, :]
        matrix = blocks + sparse.csr_matrix(
            (outer.ravel(), (rows.ravel(), columns.ravel())), shape=(3 * n, 3 * n)
        )
        right = (rho * length)[:, None] * normal
        return _solve_blocks(matrix, outer, degree, right, displacement)

    lengths = np.full(n, np.nan)
    for step in range(1, LEVELS + 2):
        level = goal * min(step, LEVELS) / LEVELS
        if step > LEVELS:
            # where the net is coarse a corner far from the level is held back by its neighbours,
            # and a node may have been pushed out of the body
            w, _, inside = field.evaluate(frame.nodes + displacement)
            behind = ~inside | (w < LAGGING * goal)
            if not behind.any():
                break
            lengths[behind] = _ray_lengths(
                field, frame, behind, goal[behind], diagonal, highest=bool(behind.all())
            )
        ray = np.isfinite(lengths)
        for _ in range(ITERATIONS + 6 if step == LEVELS else ITERATIONS):
            w, gradient, inside = field.evaluate(frame.nodes + displacement)
            steepness = np.linalg.norm(gradient, axis=1)
            median = np.median(steepness[inside]) if inside.any() else 1.0
            normal = gradient / np.maximum(steepness, 1e-300)[:, None]
            # on edges and on the midstructure the gradient vanishes: the cone says the way
            flat = ray | (steepness < 0.1 * median)
            normal[flat] = frame.direction[flat]
            along = np.einsum("li,li->l", normal, displacement)
            way = np.clip(
                (level - w) / np.maximum(steepness, 0.15 * median),
                -0.015 * diagonal,
                0.015 * diagonal,
            )
            free = ~inside | (np.einsum("li,li->l", normal, frame.direction) < 0.05)
            rho = np.where(free, 0.0, pull)
            if free.all():
                rho = pull
            length = np.where(ray, lengths, along + way)
            rho = np.where(ray, RAY_PULL * pull, rho)
            displacement = solve(normal, length, rho)
    return displacement


def _ray_lengths(
    field: HarmonicField,
    frame: ColumnFrame,
    chosen: np.ndarray,
    level: np.ndarray,
    diagonal: float,
    *,
    highest: bool,
) -> np.ndarray:
    """Distance from nodes along their inward directions to their levels; nan if not met.

    With ``highest`` to the highest place on the way instead: where all nodes are corners far from
    the midstructure, there is no other node to follow.
    """
    nodes, direction = frame.nodes[chosen], frame.direction[chosen]
    shares = np.geomspace(1e-3, 1.0, 80) * diagonal
    places = nodes[:, None] + shares[:, None] * direction[:, None]
    w, _, inside = field.evaluate(places.reshape(-1, 3))
    w, inside = w.reshape(len(nodes), -1), inside.reshape(len(nodes), -1)
    reached = w >= level[:, None]
    first = reached.argmax(axis=1)
    ok = reached.any(axis=1) & (first > 0)
    # the whole way must run inside the body
    step = np.arange(len(shares))
    ok &= (inside | (step > first[:, None])).all(axis=1)
    index = np.arange(len(nodes))
    before = np.maximum(first - 1, 0)
    low, high = w[index, before], w[index, first]
    share = np.clip((level - low) / np.maximum(high - low, 1e-12), 0.0, 1.0)
    length = shares[before] + share * (shares[first] - shares[before])
    if highest:
        run = np.logical_and.accumulate(inside, axis=1)
        best = shares[np.where(run, w, -np.inf).argmax(axis=1)]
        return np.where(ok, length, np.where(run[:, 0], best, np.nan))
    return np.where(ok, length, np.nan)


def _solve_blocks(
    matrix: sparse.csr_matrix,
    outer: np.ndarray,
    degree: np.ndarray,
    right: np.ndarray,
    start: np.ndarray,
) -> np.ndarray:
    inverse = np.linalg.inv(outer + degree[:, None, None] * np.eye(3))
    size = matrix.shape[0]

    def precondition(x: np.ndarray) -> np.ndarray:
        return np.einsum("lij,lj->li", inverse, x.reshape(-1, 3)).ravel()

    operator = LinearOperator((size, size), matvec=precondition)
    target = right.ravel()
    # the relative tolerance is called tol up to scipy 1.11 and rtol later: use the absolute one
    scale = float(np.linalg.norm(target)) or 1.0
    solution, failed = cg(matrix, target, x0=start.ravel(), atol=1e-5 * scale, M=operator)
    if failed < 0:
        raise errors.FaultError("the front's linear system broke down", remedy="report this body")
    return solution.reshape(-1, 3)
