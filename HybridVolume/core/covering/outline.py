# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What a covering of a body with quads must know of its edges and faces, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CORNER = np.radians(30.0)
"""Two edges of a face meet in a corner where the direction changes by more than this."""


@dataclass(frozen=True)
class Outline:
    """Edges and loops of a solid without seams.

    Attributes
    ----------
    vertices : (nv, 3) array
        mm
    edges : (ne, 2) int array
        First and last vertex of each edge.
    middle : (ne, 3) array
        Points halfway along the edges' parameters, mm.
    length : (ne,) array
        mm
    turning : (ne,) array
        How much the tangent turns along the edge, rad.
    face : (nc,) int array
        Coedges, loop after loop: their face,
    loop : (nc,) int array
        loop (numbered through the body),
    edge : (nc,) int array
        edge, and
    forward : (nc,) bool array
        whether it is run along from its first vertex.
    corner : (nc,) array
        Change of the direction at the end of each coedge, rad: positive where the face is convex.
    """

    vertices: np.ndarray
    edges: np.ndarray
    middle: np.ndarray
    length: np.ndarray
    turning: np.ndarray
    face: np.ndarray
    loop: np.ndarray
    edge: np.ndarray
    forward: np.ndarray
    corner: np.ndarray

    @property
    def face_count(self) -> int:
        """Number of faces."""
        return int(self.face.max()) + 1

    @property
    def following(self) -> np.ndarray:
        """(nc,) int array: the coedge that follows each in its loop."""
        last = np.append(np.flatnonzero(np.diff(self.loop)), len(self.loop) - 1)
        after = np.arange(1, len(self.loop) + 1)
        after[last] = np.append(0, last[:-1] + 1)
        return after

    def sides(self, face: int) -> list[np.ndarray] | None:
        """Edges of the four sides of a face in their order; None where it has not four.

        A face has four sides where it has one loop with exactly four corners, all convex.
        """
        own = np.flatnonzero(self.face == face)
        corners = np.flatnonzero(np.abs(self.corner[own]) > CORNER)
        if len(np.unique(self.loop[own])) != 1 or len(corners) != 4:
            return None
        if np.any(self.corner[own][corners] < 0.0):
            return None
        # a side begins behind a corner
        turned = np.roll(self.edge[own], -(corners[-1] + 1))
        ends = np.diff(np.concatenate([[corners[-1] - len(own)], corners]))
        return np.split(turned, np.cumsum(ends)[:-1])
