# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Rigid motions in a coupled space: what holds a body that nothing holds, and what is taken off.

The space is isoparametric: the coefficients of the map itself, control points and nodes, are known,
so a rigid motion has the coefficients that it gives to these points, exactly.
"""

from __future__ import annotations

import numpy as np

from .assembly import load
from .coupling import CollocationSpace, NitscheSpace


def coefficient_points(space: CollocationSpace | NitscheSpace) -> np.ndarray:
    """Coefficients of the map itself, (size, d), mm: control points of the shell, nodes."""
    nodes = space.tets.nodes
    if isinstance(space, CollocationSpace):
        nodes = nodes[space.free_nodes]
    return np.concatenate([space.spline.control_points, nodes])


def rigid_motions(points: np.ndarray) -> np.ndarray:
    """Infinitesimal rigid motions of points about their middle, (d (d + 1) / 2, n, d).

    Translations first, of length 1; then turns by 1 about the axes (in the plane one).
    """
    count, dim = points.shape
    about = points - points.mean(axis=0)
    moves = [np.broadcast_to(one, (count, dim)) for one in np.eye(dim)]
    pairs = ((1, 2), (2, 0), (0, 1)) if dim == 3 else ((0, 1),)
    for a, b in pairs:
        turn = np.zeros((count, dim))
        turn[:, a], turn[:, b] = -about[:, b], about[:, a]
        moves.append(turn)
    return np.array(moves)


def holding(space: CollocationSpace | NitscheSpace) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns that hold a free body at as many components as it has rigid motions.

    Three control points of the surface, far apart: all components of the first, those across the
    line to the second of that, and one across the plane of the third. Where loads balance, nothing
    acts on them.

    Returns
    -------
    unknown, component : (d (d + 1) / 2,) int arrays
    """
    outer = space.spline.outer
    x = space.spline.control_points[outer]
    first = int(np.argmax(np.linalg.norm(x - x.mean(axis=0), axis=1)))
    line = x - x[first]
    second = int(np.argmax(np.linalg.norm(line, axis=1)))
    along = line[second] / np.linalg.norm(line[second])
    dim = x.shape[1]
    across = np.delete(np.arange(dim), np.argmax(np.abs(along)))
    unknown = [outer[first]] * dim + [outer[second]] * (dim - 1)
    component = [*range(dim), *across]
    if dim == 3:
        lever = np.cross(along, line)
        third = int(np.argmax(np.linalg.norm(lever, axis=1)))
        unknown.append(outer[third])
        component.append(int(np.argmax(np.abs(lever[third]))))
    return np.array(unknown), np.array(component)


def free_motions(
    space: CollocationSpace | NitscheSpace, unknown: np.ndarray, component: np.ndarray
) -> int:
    """How many independent rigid motions given components of unknowns do not hinder.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
    unknown, component : (k,) int arrays
    """
    points = coefficient_points(space)
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    moves = rigid_motions(points)
    # turns by an angle that moves the body's ends by about its size, as translations do
    moves[space.dimension :] /= size
    held = np.zeros((len(moves), len(moves)))
    if len(unknown):
        there = moves[:, unknown, component]
        held = there @ there.T / len(unknown)
    return int((np.linalg.eigvalsh(held) < 1e-14).sum())


def without_motion(space: CollocationSpace | NitscheSpace, values: np.ndarray) -> np.ndarray:
    """Displacements (size, d) with the rigid motion off that is nearest to them in L2."""
    moves = rigid_motions(coefficient_points(space))
    spline, tets = space.spline, space.tets
    centre = coefficient_points(space).mean(axis=0)

    def moments(function) -> np.ndarray:
        return space.loaded(load(spline, function, spline.degree + 1), load(tets, function))

    # integrals of all functions times 1, x, y (and z): products with rigid motions follow exactly
    dim = space.dimension
    one = moments(lambda x: np.ones(len(x)))
    at = np.array([moments(lambda x, c=c: x[:, c] - centre[c]) for c in range(dim)])
    weights = np.zeros((len(moves), *values.shape))
    weights[:dim] = np.eye(dim)[:, None, :] * one[:, None]
    pairs = ((1, 2), (2, 0), (0, 1)) if dim == 3 else ((0, 1),)
    for number, (a, b) in enumerate(pairs, start=dim):
        weights[number, :, a], weights[number, :, b] = -at[b], at[a]
    matrix = np.einsum("iuc,juc->ij", weights, moves)
    amount = np.linalg.solve(matrix, np.einsum("iuc,uc->i", weights, values))
    return values - np.einsum("i,iuc->uc", amount, moves)
