# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Kept facets in pieces that are small beside their distance to the surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .closest import Carrier
from .conform import conform
from .remesh import Remesher
from .sheets import Midstructure

# Longest pieces of lines, and longest edges of triangles, in units of the distance to the surface.
LINE, EDGE = 0.25, 0.6
# The same for the facets of a medial axis, whose vertices all know their distance.
AXIS_EDGE = 2.0
# Smallest distance that counts for triangles, in units of the largest.
LEAST = 0.05
# Pieces of one line at most.
MOST = 1000


def in_pieces(midstructure: Midstructure, boundary: tuple[np.ndarray, np.ndarray]) -> Midstructure:
    """The kept facets alone, cut where they cross and where they are large.

    A user's rectangle may be two triangles, and a user's wire one line: their corners say nothing
    about the distance to the surface in between.

    Parameters
    ----------
    midstructure : Midstructure
    boundary : (vertices (n, 3), triangles (t, 3))
        The surface, to measure distances to, mm.

    Returns
    -------
    Midstructure
        All of it kept. Points are still (a, a, a) and lines (a, b, b).
    """
    kept = midstructure.kept
    used, facets = np.unique(midstructure.facets[kept], return_inverse=True)
    facets, sheet = facets.reshape(-1, 3), midstructure.sheet[kept]
    x, radius = midstructure.vertices[used], midstructure.radius[used]
    outer = Carrier(boundary[0][boundary[1]], np.full(len(boundary[1]), np.inf))

    def distance(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(outer.closest(points)[0] - points, axis=1)

    flat = (facets == facets[:, [1, 2, 0]]).any(axis=1)
    lines, line_sheet = np.sort(facets[flat], axis=1)[:, [0, 2]], sheet[flat]
    facets, sheet = facets[~flat], sheet[~flat]
    drawn = midstructure.figures is None
    if drawn:
        # the medial axis does not cross itself, but what a user draws may
        x, facets, parent = conform(x, facets)
        sheet = sheet[parent]
        radius = np.append(radius, distance(x[len(radius) :]))
    least = LEAST * float(radius.max(initial=0.0))
    mesh = Remesher(
        x, facets, sheet, lambda p: np.maximum(distance(p), least), np.maximum(radius, least)
    )
    mesh.split(EDGE if drawn else AXIS_EDGE)
    x, radius = mesh.x, np.append(radius, distance(mesh.x[len(radius) :]))
    x, radius, lines, parent = _divided(x, radius, lines, distance)
    return replace(
        midstructure,
        vertices=x,
        facets=np.vstack([mesh.t, lines[:, [0, 1, 1]]]),
        sheet=np.append(mesh.sheet, line_sheet[parent]),
        kept=np.ones(len(mesh.t) + len(lines), dtype=bool),
        radius=radius,
    )


def _divided(
    x: np.ndarray,
    radius: np.ndarray,
    lines: np.ndarray,
    distance: Callable[[np.ndarray], np.ndarray],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Lines (k, 2) halved until they are short: vertices, radius, lines, the line each is of."""
    parent = np.arange(len(lines))
    done, owner = [np.zeros((0, 2), dtype=np.int64)], [parent[:0]]
    longest = np.linalg.norm(x[lines[:, 1]] - x[lines[:, 0]], axis=1) / MOST
    while len(lines):
        a, b = lines.T
        middle = 0.5 * (x[a] + x[b])
        length = np.linalg.norm(x[b] - x[a], axis=1)
        free = distance(middle)
        long = (length > LINE * np.minimum(free, np.minimum(radius[a], radius[b]))) & (
            length > longest
        )
        done.append(lines[~long])
        owner.append(parent[~long])
        new = len(x) + np.arange(long.sum())
        x, radius = np.vstack([x, middle[long]]), np.append(radius, free[long])
        lines = np.vstack([np.column_stack([a[long], new]), np.column_stack([new, b[long]])])
        parent, longest = np.tile(parent[long], 2), np.tile(longest[long], 2)
    return x, radius, np.concatenate(done), np.concatenate(owner)
