# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Branches of a graph between its ends and forks, without the spurious ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .collapse import SHEET, Graph

# A branch sticks out of the balls around the others by this much of the local radius, or of the way
# that the fire took from the rim of a sheet, or it is spurious.
STICKS_OUT = 1.2
# Shortened branches grow back while the radius stays above this share.
THINNEST = 0.75
# Forks nearer to each other than this share of the radius are one.
ONE_FORK = 0.6


@dataclass(frozen=True)
class Branches:
    """Polylines between nodes.

    Attributes
    ----------
    nodes : (k, 3) array
        Ends and forks, mm; one point on a loop without forks.
    ends : (b, 2) int array
        Nodes of each branch, the same twice for a loop.
    paths : tuple of (m, 3) arrays
        Points of each branch with both ends, mm.
    """

    nodes: np.ndarray
    ends: np.ndarray
    paths: tuple[np.ndarray, ...]


def branches_of(graph: Graph, points: np.ndarray, depth: np.ndarray, scale: np.ndarray) -> Branches:
    """Branches of a connected graph; one node alone where the graph is a point.

    Parameters
    ----------
    graph : Graph
    points : (n, 3) array
        mm.
    depth, scale : (n,) arrays
        Distance to the surface and half the local thickness, mm.
    """
    if not len(graph.edges):
        return Branches(points[[graph.point]], np.zeros((0, 2), dtype=np.int64), ())
    around: dict[int, dict[int, float]] = {}
    for (u, v), time in zip(graph.edges.tolist(), graph.time.tolist(), strict=True):
        around.setdefault(u, {})[v] = time
        around.setdefault(v, {})[u] = time
    _grow_back(around, graph.burnt, depth)
    _prune(around, points, depth, scale)
    return _one_fork(_polylines(around), points, depth)


def _grow_back(
    around: dict[int, dict[int, float]], burnt: dict[int, int], depth: np.ndarray
) -> None:
    """Give ends back what the fire took before it was stopped."""
    for end in [v for v, others in around.items() if len(others) == 1]:
        least = THINNEST * depth[end]
        here = end
        time = next(iter(around[end].values()))
        while here in burnt and burnt[here] not in around and depth[burnt[here]] >= least:
            there = burnt[here]
            around[here][there] = time
            around[there] = {here: time}
            here = there


def _prune(
    around: dict[int, dict[int, float]],
    points: np.ndarray,
    depth: np.ndarray,
    scale: np.ndarray,
) -> None:
    """Take off spurious branches, the least significant first."""
    branches: dict[int, tuple[float, list[int]]] = {}

    def judge(end: int) -> None:
        """Find the branch at an end, and how far it sticks out of the balls of all the rest."""
        path = [end]
        here = next(iter(around[end]))
        previous = end
        times = [around[end][here]]
        while len(around[here]) == 2:
            path.append(here)
            following = next(v for v in around[here] if v != previous)
            times.append(around[here][following])
            previous, here = here, following
        if len(around[here]) == 1:
            branches.pop(end, None)
            return
        rest = np.array(list(around.keys() - set(path)))
        far, near = cKDTree(points[rest]).query(points[path])
        out = far + depth[path] - depth[rest[near]]
        size = np.maximum(scale[path], SHEET * np.median(times))
        branches[end] = (float((out / size).max()), [*path, here])

    for end in [v for v, others in around.items() if len(others) == 1]:
        judge(end)
    while branches:
        end = min(branches, key=lambda v: (branches[v][0], v))
        judged = branches[end][0]
        if judged >= STICKS_OUT:
            break
        # what covered this branch may be gone
        judge(end)
        if end not in branches or branches[end][0] > judged * 1.001:
            continue
        _, path = branches.pop(end)
        for one, two in zip(path[:-1], path[1:], strict=True):
            del around[one][two], around[two][one]
        for v in path[:-1]:
            del around[v]
        # branches that ended in this fork may go on beyond it now
        fork = path[-1]
        for other in [v for v, (_, p) in branches.items() if p[-1] == fork]:
            judge(other)


def _polylines(around: dict[int, dict[int, float]]) -> list[list[int]]:
    """Vertex numbers along each branch."""
    paths = []
    used: set[tuple[int, int]] = set()

    def walk(start: int, there: int) -> list[int]:
        path = [start, there]
        while len(around[path[-1]]) == 2 and path[-1] != start:
            following = next(v for v in around[path[-1]] if v != path[-2])
            path.append(following)
        return path

    nodes = [v for v, others in around.items() if len(others) != 2]
    for node in nodes or [min(around)]:
        for there in around[node]:
            if (node, there) in used:
                continue
            path = walk(node, there)
            used.update(((path[0], path[1]), (path[-1], path[-2])))
            paths.append(path)
    return paths


def _one_fork(paths: list[list[int]], points: np.ndarray, depth: np.ndarray) -> Branches:
    """Unite forks that are close to each other."""
    degree: dict[int, int] = {}
    for path in paths:
        for node in (path[0], path[-1]):
            degree[node] = degree.get(node, 0) + 1
    one = {node: node for node in degree}

    def root(node: int) -> int:
        while one[node] != node:
            node = one[node]
        return node

    place = {node: points[node] for node in degree}
    kept = []
    lengths = [float(np.linalg.norm(np.diff(points[path], axis=0), axis=1).sum()) for path in paths]
    for k in np.argsort(lengths, kind="stable"):
        path = paths[k]
        a, b = root(path[0]), root(path[-1])
        inner = degree[path[0]] > 2 and degree[path[-1]] > 2
        if inner and a != b and lengths[k] < ONE_FORK * depth[path].mean():
            one[b] = a
            place[a] = 0.5 * (place[a] + place[b])
        else:
            kept.append(path)
    names = sorted({root(node) for node in degree})
    number = {node: k for k, node in enumerate(names)}
    ends = np.array([[number[root(p[0])], number[root(p[-1])]] for p in kept], dtype=np.int64)
    nodes = np.array([place[node] for node in names])
    lines = []
    for path, (a, b) in zip(kept, ends, strict=True):
        line = points[path].copy()
        line[0], line[-1] = nodes[a], nodes[b]
        lines.append(line)
    return Branches(nodes, ends.reshape(-1, 2), tuple(lines))
