# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Places where a triangle complex nearly touches itself without sharing a vertex there."""

from __future__ import annotations

import numpy as np

from .closest import Carrier, on_segments, on_triangles
from .remesh import Remesher

# Triangles that are looked at around each vertex.
_AROUND = 16


def join_contacts(mesh: Remesher, share: float) -> int:
    """Make vertices that nearly touch a triangle part of it; how many were joined.

    The triangle, or the triangles at its side, are split at the vertex; near a corner both become
    one vertex. That closes slits, and takes away folds and triangles without height.

    Parameters
    ----------
    mesh : Remesher
    share : float
        What is nearer is joined, in units of the wanted length.
    """
    done = 0
    for _ in range(8):
        found = _contacts(mesh, share)
        number = _join(mesh, *found) if len(found[0]) else 0
        if not number:
            break
        done += number
    return done


def _contacts(mesh: Remesher, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, and the triangle that each of them nearly touches, the nearest first."""
    x, t = mesh.x, mesh.t
    if len(t) < 2:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    carrier = Carrier(x[t], 0.7 * mesh.h[t].mean(axis=1))
    number = min(_AROUND, len(carrier.facet))
    near = carrier.facet[carrier.tree.query(x, k=number)[1].reshape(len(x), number)]
    vertex, triangle = np.repeat(np.arange(len(x)), number), near.ravel()
    apart = (t[triangle] != vertex[:, None]).all(axis=1)
    # where even the plane is far there is nothing to compute
    vertex, triangle = vertex[apart], triangle[apart]
    distance = np.linalg.norm(on_triangles(x[vertex], x[t[triangle]]) - x[vertex], axis=1)
    touch = np.flatnonzero(distance < share * mesh.h[vertex])
    touch = touch[np.argsort(distance[touch] / mesh.h[vertex[touch]], kind="stable")]
    return vertex[touch], triangle[touch]


def _join(mesh: Remesher, vertex: np.ndarray, triangle: np.ndarray) -> int:
    x, t = mesh.x, mesh.t
    patch = mesh.patches()
    start, around = mesh.stars()
    used = np.zeros(len(x), dtype=bool)
    keep = np.ones(len(t), dtype=bool)
    to = np.arange(len(x))
    added: list[list[int]] = []
    parent: list[int] = []
    done = 0
    for v, f in zip(vertex.tolist(), triangle.tolist(), strict=True):
        corners = t[f]
        if used[v] or used[corners].any():
            continue
        length = np.linalg.norm(x[corners] - x[v], axis=1)
        ends = np.stack([corners, corners[[1, 2, 0]]], axis=1)
        foot = on_segments(np.repeat(x[v][None], 3, axis=0), x[ends[:, 0]], x[ends[:, 1]])
        gap = np.linalg.norm(foot - x[v], axis=1)
        k = int(gap.argmin())
        if length.min() < 0.3 * mesh.h[v]:
            c = int(corners[length.argmin()])
            to[c if mesh.fixed[v] else v] = v if mesh.fixed[v] else c
            used[[v, *corners]] = True
            done += 1
            continue
        if gap[k] < 0.25 * mesh.h[v]:
            a, b = (int(i) for i in ends[k])
            star = around[start[a] : start[a + 1]]
            faces = star[(t[star] == b).any(axis=1)]
            others = t[faces]
            if used[others].any():
                continue
            used[others] = True
            for g in faces.tolist():
                keep[g] = False
                if v in t[g]:
                    continue
                for gone in (a, b):
                    added.append([v if i == gone else int(i) for i in t[g]])
                    parent.append(g)
        else:
            keep[f] = False
            used[corners] = True
            for gone in corners.tolist():
                added.append([v if i == gone else int(i) for i in corners])
                parent.append(f)
        used[v] = True
        done += 1
    if done:
        extra = np.array(parent, dtype=np.int64)
        t = np.vstack([t[keep], np.array(added, dtype=np.int64).reshape(-1, 3)])
        sheet = np.append(mesh.sheet[keep], mesh.sheet[extra])
        mesh.take(to[t], sheet, np.append(patch[keep], patch[extra]))
    return done
