# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Figures of the cells of a raw medial axis: object angle, noise, wedges of edges, ridges."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

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
# A part of fewer squares of the sample spacing is none.
NOISE_SQUARES = 4.0
# Nor is one of a smaller share of the whole area, unless it lies between opposite faces.
SPECK = 1e-3
# Smallest object angle between opposite faces, degrees.
OPPOSITE = 125.0
# A smaller ball, in sample spacings, is no reason to keep anything.
RESOLVED = 2.5
# A cell is a ridge when no ball within so many of its radii is larger both by this factor and by
# this slope; the sheet of a convex right angle rises by 0.7.
AROUND = 1.5
NEAR = 0.5
RIDGE = 1.12
SLOPE = 0.3
# A sample is beside an edge within so many sample spacings; it has one behind the edge among so
# many neighbours; the edge's points are made denser by a factor.
BESIDE = 1.5
NEIGHBOURS = 24
FINER = 8
# Side of the cubes in which balls are looked for, in radii.
CUBE = 0.16
# Balls whose neighbours are looked for at a time.
ASKED = 256
# Neighbours that are looked at first.
FEW = 24
# Four whole numbers as one, which wraps around.
HASH = np.array([0x9E3779B97F4A7C1, 0xC2B2AE3D27D4EB4, 0x165667B19E3779F, 0x27D4EB2F165667C])


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
    feet : (c, 2) int array
        Samples that stand for the feet: one on a concave edge counts for the face opposite.
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
        self.feet = _named_feet(raw.feet, samples, groups)
        self.pair = np.sort(groups.of_patch[samples.patch[self.feet]], axis=1)
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
        """Candidates of the largest balls around; the balls of noise count for that as well."""
        some = np.flatnonzero(self.candidate & (self.radius > RESOLVED * self.spacing))
        if not len(some):
            some = np.flatnonzero(self.candidate)
        raw = self.raw
        centre = np.concatenate([self.centre[some], raw.balls])
        radius = np.concatenate([self.radius[some], raw.ball_radius])
        label, first = _largest(centre, radius, CUBE)
        asked = np.unique(label[: len(some)])
        summit = np.zeros(len(first))
        # far away the largest balls of larger cubes are enough; near by all count, but only for
        # those that are not outdone yet, most of them by one of a few neighbours
        coarse = _largest(centre, radius, 3.0 * CUBE)[1]
        for rivals, reach, neighbours in (
            (coarse, AROUND, _some_near),
            (coarse, AROUND, _all_near),
            (first, NEAR, _all_near),
        ):
            asked = asked[radius[first[asked]] >= summit[asked]]
            if not len(asked):
                break
            ask, size = centre[first[asked]], radius[first[asked]]
            rivals = rivals[radius[rivals] > size.min()]
            if not len(rivals):  # a ball: all are as large as each other
                continue
            for owner, found, away in neighbours(centre[rivals], ask, reach * size):
                rival = radius[rivals[found]]
                # a tapered bar has its ridge all along
                larger = np.minimum(rival / RIDGE, rival - SLOPE * away)
                np.maximum.at(summit, asked[owner], larger)
        result = np.zeros(len(self.candidate), dtype=bool)
        result[some[self.radius[some] >= summit[label[: len(some)]]]] = True
        return result

    def parts(self) -> np.ndarray:
        """Connected candidates of one pair, over Voronoi edges where just two of all meet.

        Parts that are too small for a sheet go to the neighbour of their pair with which they
        share most edges, if they have one that is large enough.

        Returns
        -------
        (c,) int array
            The parts that are large enough for a sheet; -1 elsewhere.
        """
        raw, use = self.raw, self.candidate
        pairs, edge = raw.edges, raw.edge
        both = use[pairs].all(axis=1)
        pairs, edge = pairs[both], edge[both]
        lonely = np.bincount(edge, minlength=1)[edge] == 1
        same = self.group[pairs[:, 0]] == self.group[pairs[:, 1]]
        n = len(use)
        joined = pairs[lonely & same]
        graph = coo_matrix((np.ones(len(joined), dtype=np.int8), joined.T), shape=(n, n))
        part = connected_components(graph, directed=False)[1]
        cells = self.area / self.spacing**2
        opposite = use & (self.angle > OPPOSITE)
        squares, facing = (np.bincount(part[a], cells[a], len(part)) for a in (use, opposite))
        area = np.bincount(part[use], self.area[use], len(part))
        # parts of edges are many; those between opposite faces count however small they are
        large = (squares > NOISE_SQUARES) & (area > SPECK * area.sum()) | (facing > NOISE_SQUARES)
        result = np.where(use & large[part], part, -1)
        pairs = pairs[same]
        pairs = np.concatenate([pairs, pairs[:, ::-1]])
        while True:
            a, b = pairs.T
            open_ = (result[a] < 0) & (result[b] >= 0)
            if not open_.any():
                return result
            links, number = np.unique(
                np.column_stack([part[a[open_]], result[b[open_]]]), axis=0, return_counts=True
            )
            links = links[np.lexsort([-number, links[:, 0]])]
            small, first = np.unique(links[:, 0], return_index=True)
            goes = np.full(len(part), -1)
            goes[small] = links[first, 1]
            result = np.where(result < 0, goes[part], result)


Neighbours = Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Numbers of places asked and of points near them, and their distances, in portions."""


def _some_near(points: np.ndarray, ask: np.ndarray, reach: np.ndarray) -> Neighbours:
    """At most a few of the points within reach of each place."""
    number = min(FEW, len(points))
    away, found = cKDTree(points).query(ask, k=number, workers=-1)
    away, found = away.reshape(len(ask), number), found.reshape(len(ask), number)
    owner, place = np.nonzero(away <= reach[:, None])
    yield owner, found[owner, place], away[owner, place]


def _all_near(points: np.ndarray, ask: np.ndarray, reach: np.ndarray) -> Neighbours:
    """All points within reach of each place."""
    tree = cKDTree(points)
    # a few at a time: the lists of all neighbours would take gigabytes
    for low in range(0, len(ask), ASKED):
        part = slice(low, low + ASKED)
        around = tree.query_ball_point(ask[part], reach[part], return_sorted=False, workers=-1)
        count = np.array([len(a) for a in around])
        owner = low + np.repeat(np.arange(len(count)), count)
        found = np.fromiter(chain.from_iterable(around), np.int64, count.sum())
        yield owner, found, np.linalg.norm(points[found] - ask[owner], axis=1)


def _largest(centre: np.ndarray, radius: np.ndarray, cube: float) -> tuple[np.ndarray, np.ndarray]:
    """Cube of every ball, whose side is a part of the radius, and the largest ball in each."""
    level = np.floor(np.log2(np.maximum(radius, np.finfo(float).tiny)))
    place = np.floor((centre - centre.mean(axis=0)) / (cube * 2.0**level)[:, None])
    key = np.column_stack([level, place]).astype(np.int64) @ HASH
    _, label = np.unique(key, return_inverse=True)
    order = np.lexsort([-radius, label])
    return label, order[np.unique(label[order], return_index=True)[1]]


def _named_feet(feet: np.ndarray, samples: Samples, groups: SmoothGroups) -> np.ndarray:
    """Feet, but those on a concave edge on that of its two faces that lies more opposite.

    A ball that touches a concave edge touches both of its faces; which of them has the nearest
    sample is chance.
    """
    beside = _beside_concave(samples, groups)
    result = feet.copy()
    for side in (0, 1):
        mine, across = feet[:, side], samples.normals[feet[:, 1 - side]]
        other = beside[mine]
        cosine = np.einsum("ci,ci->c", samples.normals[mine], across)
        swapped = np.einsum("ci,ci->c", samples.normals[other], across)
        better = (other >= 0) & (swapped < cosine - 0.05)
        result[better, side] = other[better]
    return result


def _beside_concave(samples: Samples, groups: SmoothGroups) -> np.ndarray:
    """For samples near a concave edge of their group a near sample behind that edge, else -1."""
    result = np.full(len(samples.points), -1)
    concave = np.flatnonzero((~groups.edge_convex).mean(axis=1) > 0.5)
    if not len(concave):
        return result
    points = groups.edge_points[concave]
    share = (np.arange(FINER) / FINER)[:, None]
    between = points[:, :-1, None] * (1.0 - share) + points[:, 1:, None] * share
    count = between.shape[1] * FINER
    distance, nearest = cKDTree(between.reshape(-1, 3)).query(samples.points)
    group = groups.of_patch[samples.patch]
    pair = groups.edge_pair[concave[nearest // count]]
    near = np.flatnonzero((distance < BESIDE * samples.spacing) & (pair == group[:, None]).any(1))
    if not len(near):
        return result
    wanted = pair[near].sum(axis=1) - group[near]
    number = min(NEIGHBOURS, len(samples.points))
    around = cKDTree(samples.points).query(samples.points[near], k=number)[1]
    fits = group[around] == wanted[:, None]
    found = fits.any(axis=1) & (wanted != group[near])
    result[near[found]] = around[found, fits[found].argmax(axis=1)]
    return result
