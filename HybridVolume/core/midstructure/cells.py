# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Figures of the cells of a raw medial axis: object angle, noise, wedges of edges, ridges."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .samples import Samples
from .smooth_groups import SmoothGroups
from .voronoi import VoronoiFacets

# Cells whose feet see each other under less than this are noise, degrees.
NOISE_ANGLE = 60.0
# So are those whose feet are nearer than this, in units of the sample spacing.
NOISE_LENGTH = 1.2
# A cell is a ridge when no neighbour within its radius is larger than by this factor.
RIDGE = 1.12


class Cells:
    """Cells of the medial axis with their figures.

    Attributes
    ----------
    owner : (s,) int array
        Cell of every polygon corner.
    centre : (c, 3) array
    length, radius, angle, facing, spacing, area : (c,) arrays
        Distance of the feet, distance to the surface, object angle, angle of the normals at the
        feet, distance of the samples, area; mm, mm², degrees.
    pair : (c, 2) int array
        Smooth groups of the feet, the lower number first.
    group : (c,) int array
        The same as one number.
    candidate : (c,) bool array
        Not noise of the sampling.
    """

    def __init__(self, raw: VoronoiFacets, samples: Samples, groups: SmoothGroups) -> None:
        self.raw, self.samples, self.groups = raw, samples, groups
        count = np.diff(raw.start)
        owner = np.repeat(np.arange(len(count)), count)
        corner = raw.vertices[raw.corners]
        self.owner = owner
        self.centre = np.column_stack(
            [np.bincount(owner, corner[:, i], len(count)) for i in range(3)]
        ) / np.maximum(count, 1)[:, None]  # fmt: skip
        p, q = samples.points[raw.feet[:, 0]], samples.points[raw.feet[:, 1]]
        self.length = np.linalg.norm(q - p, axis=1)
        self.radius = np.linalg.norm(self.centre - p, axis=1)
        seen = np.degrees(2.0 * np.arcsin(np.clip(0.5 * self.length / self.radius, 0.0, 1.0)))
        normals = samples.normals[raw.feet]
        cosine = np.einsum("fi,fi->f", normals[:, 0], normals[:, 1])
        facing = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        # the normals tell the object angle without noise, except at feet on concave edges
        self.angle = np.where(np.abs(seen - facing) < 15.0, facing, seen)
        self.facing = facing
        self.spacing = samples.spacing[raw.feet].max(axis=1)
        self.pair = np.sort(groups.of_patch[samples.patch[raw.feet]], axis=1)
        self.group = self.pair[:, 0] * len(groups.of_patch) + self.pair[:, 1]
        following = np.arange(len(owner)) + 1
        ends = raw.start[1:][count > 0] - 1
        following[ends] = raw.start[:-1][count > 0]
        a, b = corner - self.centre[owner], corner[following] - self.centre[owner]
        pieces = 0.5 * np.linalg.norm(np.cross(a, b), axis=1)
        self.area = np.bincount(owner, pieces, len(count))
        noise = (seen < NOISE_ANGLE) | (facing < NOISE_ANGLE)
        self.candidate = self._candidates(~noise & (self.length > NOISE_LENGTH * self.spacing))

    def _candidates(self, good: np.ndarray) -> np.ndarray:
        """Cells that are no noise beside an edge."""
        short = good & (self.length < 3.0 * self.spacing)
        distance = self._to_edges(short, np.ones(self.groups.edge_convex.shape, dtype=bool))
        # short and not between parallel faces: a sharp edge, or one rounded too finely to be seen
        rounded = (self.pair[:, 0] == self.pair[:, 1]) & (self.facing < 150.0)
        return good & ~(short & ((distance < 3.0 * self.spacing) | rounded))

    def _to_edges(self, use: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Distance of the nearer foot to the sharp edges between the two groups of each cell.

        Parameters
        ----------
        use : (c,) bool array
            The cells asked for; infinite for the others.
        which : (e, k) bool array
            The edge points that count.
        """
        groups, n = self.groups, len(self.groups.of_patch)
        result = np.full(len(self.pair), np.inf)
        edge_key = groups.edge_pair[:, 0] * n + groups.edge_pair[:, 1]
        for value in np.intersect1d(self.group[use], edge_key):
            sides = edge_key == value
            points = groups.edge_points[sides][which[sides]]
            if not len(points):
                continue
            members = np.flatnonzero(use & (self.group == value))
            feet = self.samples.points[self.raw.feet[members]].reshape(-1, 3)
            result[members] = cKDTree(points).query(feet)[0].reshape(-1, 2).min(axis=1)
        return result

    def in_wedge(self) -> np.ndarray:
        """Cells that lie in the wedge of a convex sharp edge of their own two groups.

        In a plane wedge the feet are R tan(angle / 2) from the edge. Where the faces run parallel
        that length is far beyond the edge, and the cell is none of the edge's.
        """
        reach = self.radius * np.tan(np.radians(np.minimum(self.angle, 179.9)) / 2.0)
        distance = self._to_edges(self.candidate, self.groups.edge_convex)
        return np.isfinite(distance) & (distance > 0.7 * reach)

    def ridges(self) -> np.ndarray:
        """Candidates of the largest balls around."""
        some = np.flatnonzero(self.candidate & (self.radius > 4.0 * self.spacing))
        if not len(some):
            some = np.flatnonzero(self.candidate)
        centre, radius = self.centre[some], self.radius[some]
        # one representative, the largest ball, in every cell of a tenth of the radius
        level = np.floor(np.log2(radius)).astype(int)
        place = np.floor(centre / (0.12 * 2.0**level)[:, None]).astype(np.int64)
        _, label = np.unique(np.column_stack([level, place]), axis=0, return_inverse=True)
        label = label.ravel()
        order = np.lexsort([-radius, label])
        first = order[np.unique(label[order], return_index=True)[1]]
        tree = cKDTree(centre[first])
        around = tree.query_ball_point(centre[first], radius[first])
        size = np.array([len(a) for a in around])
        flat = np.concatenate([np.asarray(a, dtype=int) for a in around])
        start = np.concatenate([[0], np.cumsum(size)[:-1]])
        summit = np.maximum.reduceat(radius[first][flat], start)
        result = np.zeros(len(self.candidate), dtype=bool)
        result[some[RIDGE * radius > summit[label]]] = True
        return result

    def parts(self) -> np.ndarray:
        """Connected candidates of one pair, over Voronoi edges where just two of all meet."""
        raw = self.raw
        both = self.candidate[raw.edges].all(axis=1)
        pairs, edge = raw.edges[both], raw.edge[both]
        lonely = np.bincount(edge, minlength=1)[edge] == 1
        same = self.group[pairs[:, 0]] == self.group[pairs[:, 1]]
        pairs = pairs[lonely & same]
        n = len(self.candidate)
        graph = coo_matrix((np.ones(len(pairs), dtype=np.int8), pairs.T), shape=(n, n))
        return connected_components(graph, directed=False)[1]
