# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The automatic midstructure: the medial axis without the sheets that run into convex edges."""

from __future__ import annotations

import logging

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ...errors import FaultError
from ..surface import PatchSurface
from .samples import Samples, sample_surface
from .sheets import Midstructure, Sheet
from .smooth_groups import SmoothGroups, smooth_groups
from .voronoi import VoronoiFacets, interior_facets

log = logging.getLogger(__name__)

# Facets whose feet see each other under less than this are noise, degrees.
NOISE_ANGLE = 60.0
# Share of the largest radius from which on the sheet of an acute edge is kept.
ACUTE_SHARE = 0.5
# A facet is a ridge when no neighbour within half its radius is larger than by this factor.
RIDGE = 1.12

BETWEEN = "between opposite faces"
ACUTE = "inside an acute edge, its thick part"
RIDGE_OF = "ridge of a part without another sheet"
EDGE = "runs into a convex edge"
NARROW = "its faces do not lie opposite each other"
SMALL = "too small"


def medial_axis(
    surface: PatchSurface,
    samples: int = 16000,
    *,
    angle: float = 125.0,
    minimum_length: float = 1.2,
    seed: int = 0,
) -> Midstructure:
    """Medial axis of a body as facets, simplified for the harmonic field (section 3.1).

    Interior Voronoi facets of surface samples. A facet is kept when its two feet lie opposite each
    other and it does not belong to the wedge of a convex sharp edge; acute wedges keep their thick
    part. Parts that would be left without any midstructure (cylinders, square bars, prisms,
    spheres) keep the ridge of the largest inner balls.

    Parameters
    ----------
    surface : PatchSurface
    samples : int
        Surface samples aimed at.
    angle : float
        Smallest object angle of a kept facet, degrees.
    minimum_length : float
        Smallest distance of the feet, in units of the local sample spacing.
    seed : int
        Of the samples' jitter; the result is always the same for the same seed.

    Returns
    -------
    Midstructure
        Never without kept facets.

    Raises
    ------
    FaultError
        The samples show no interior at all.
    """
    groups = smooth_groups(surface)
    drawn = sample_surface(surface, samples, groups.of_patch, seed)
    raw = interior_facets(drawn, 0.7 * NOISE_ANGLE, seed)
    facets = _Facets(raw, drawn, groups)
    candidate = facets.candidates(minimum_length)
    if not candidate.any():
        raise FaultError("no inner Voronoi facet was found", remedy="use more samples")
    reason = _classify(facets, candidate, angle)
    result = _build(surface, facets, candidate, reason)
    if not result.kept.any():
        raise FaultError("the medial axis is empty", remedy="use more samples")
    log.info(
        "medial axis: %d samples, %d sheets, %d kept, area %.6g mm²",
        len(drawn.points),
        len(result.sheets),
        result.kept_sheets,
        result.area,
    )
    return result


class _Facets:
    """Figures of every raw facet."""

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
        self.noise = (seen < NOISE_ANGLE) | (facing < NOISE_ANGLE)
        self.spacing = samples.spacing[raw.feet].max(axis=1)
        self.pair = np.sort(groups.of_patch[samples.patch[raw.feet]], axis=1)
        following = np.arange(len(owner)) + 1
        ends = raw.start[1:][count > 0] - 1
        following[ends] = raw.start[:-1][count > 0]
        a, b = corner - self.centre[owner], corner[following] - self.centre[owner]
        pieces = 0.5 * np.linalg.norm(np.cross(a, b), axis=1)
        self.area = np.bincount(owner, pieces, len(count))

    def candidates(self, minimum_length: float) -> np.ndarray:
        """Facets that are no noise of the sampling."""
        good = ~self.noise & (self.length > minimum_length * self.spacing)
        short = good & (self.length < 3.0 * self.spacing)
        distance = self._to_edges(short, np.ones(self.groups.edge_convex.shape, dtype=bool))
        # short and not between parallel faces: a sharp edge, or one rounded too finely to be seen
        rounded = (self.pair[:, 0] == self.pair[:, 1]) & (self.facing < 150.0)
        return good & ~(short & ((distance < 3.0 * self.spacing) | rounded))

    def _to_edges(self, use: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Distance of the nearer foot to the sharp edges between the two groups of each facet.

        Parameters
        ----------
        use : (f,) bool array
            The facets asked for; infinite for the others.
        which : (e, k) bool array
            The edge points that count.
        """
        groups, n = self.groups, len(self.groups.of_patch)
        result = np.full(len(self.pair), np.inf)
        key = self.pair[:, 0] * n + self.pair[:, 1]
        edge_key = groups.edge_pair[:, 0] * n + groups.edge_pair[:, 1]
        for value in np.intersect1d(key[use], edge_key):
            sides = edge_key == value
            points = groups.edge_points[sides][which[sides]]
            if not len(points):
                continue
            members = np.flatnonzero(use & (key == value))
            feet = self.samples.points[self.raw.feet[members]].reshape(-1, 3)
            result[members] = cKDTree(points).query(feet)[0].reshape(-1, 2).min(axis=1)
        return result

    def in_wedge(self, candidate: np.ndarray) -> np.ndarray:
        """Facets that lie in the wedge of a convex sharp edge of their own two groups.

        In a plane wedge the feet are R tan(angle / 2) from the edge. Where the faces run parallel
        that length is far beyond the edge, and the facet is none of the edge's.
        """
        reach = self.radius * np.tan(np.radians(np.minimum(self.angle, 179.9)) / 2.0)
        distance = self._to_edges(candidate, self.groups.edge_convex)
        return np.isfinite(distance) & (distance > 0.7 * reach)

    def components(
        self, use: np.ndarray, label: np.ndarray, *, manifold: bool = True
    ) -> np.ndarray:
        """Connected facets of equal label over Voronoi edges (with just two of the used facets)."""
        raw = self.raw
        both = use[raw.edges].all(axis=1)
        pairs, edge = raw.edges[both], raw.edge[both]
        lonely = np.ones(len(edge), dtype=bool)
        if manifold and len(edge):
            lonely = np.bincount(edge)[edge] == 1
        same = label[pairs[:, 0]] == label[pairs[:, 1]]
        pairs = pairs[lonely & same]
        n = len(use)
        graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(n, n))
        return connected_components(graph, directed=False)[1]


def _classify(facets: _Facets, candidate: np.ndarray, angle: float) -> np.ndarray:
    """Reason of every candidate facet: why it is kept or not."""
    wedge = facets.in_wedge(candidate)
    wide = candidate & (facets.angle > angle)
    reason = np.full(len(candidate), "", dtype=object)
    reason[candidate] = NARROW
    reason[candidate & wedge] = EDGE
    reason[wide & ~wedge] = BETWEEN
    pair = facets.pair[:, 0] * len(facets.groups.of_patch) + facets.pair[:, 1]

    acute = wide & wedge
    part = facets.components(acute, pair)
    largest = np.zeros(len(part))
    np.maximum.at(largest, part[acute], facets.radius[acute])
    big = _large(facets, part, acute)
    thick = acute & big & (facets.radius > ACUTE_SHARE * largest[part])
    reason[thick] = ACUTE

    kept = (reason == BETWEEN) | thick
    part = facets.components(kept, pair)
    small = kept & ~_large(facets, part, kept)
    small |= kept & ~small & _slight(facets, kept & ~small)
    reason[small] = SMALL
    kept &= ~small
    ridge = _lonely_ridges(facets, candidate, kept) & ~(acute & big)
    reason[ridge] = RIDGE_OF
    return reason


def _large(facets: _Facets, part: np.ndarray, use: np.ndarray) -> np.ndarray:
    """Whether each facet belongs to a component of more than a few sample spacings."""
    area = np.bincount(part[use], facets.area[use], len(part))
    cell = np.bincount(part[use], facets.spacing[use] ** 2, len(part))
    number = np.maximum(np.bincount(part[use], minlength=len(part)), 1)
    return (area > 4.0 * cell / number)[part]


def _slight(facets: _Facets, use: np.ndarray) -> np.ndarray:
    """Facets of connected parts that are smaller than their own distance from the surface.

    Such a part does not divide the body: it is what remains of an edge sheet near a corner. The
    measure is local, so a thin region keeps its sheet beside a thick one.
    """
    part = facets.components(use, np.zeros(len(use), dtype=int), manifold=False)
    area = np.bincount(part[use], facets.area[use], len(part))
    weighted = np.bincount(part[use], facets.area[use] * facets.radius[use], len(part))
    radius = weighted / np.maximum(area, 1e-300)
    return use & (area < radius**2)[part]


def _lonely_ridges(facets: _Facets, candidate: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Facets of the largest balls around, where no kept facet is within their radius."""
    some = np.flatnonzero(candidate & (facets.radius > 4.0 * facets.spacing))
    if not len(some):
        if kept.any():
            return np.zeros(len(candidate), dtype=bool)
        some = np.flatnonzero(candidate)
    centre, radius = facets.centre[some], facets.radius[some]
    # one representative, the largest ball, in every cell of a tenth of the radius
    level = np.floor(np.log2(radius)).astype(int)
    cell = np.floor(centre / (0.12 * 2.0**level)[:, None]).astype(np.int64)
    _, label = np.unique(np.column_stack([level, cell]), axis=0, return_inverse=True)
    label = label.ravel()
    order = np.lexsort([-radius, label])
    first = order[np.unique(label[order], return_index=True)[1]]
    tree = cKDTree(centre[first])
    around = tree.query_ball_point(centre[first], radius[first])
    size = np.array([len(a) for a in around])
    flat = np.concatenate([np.asarray(a, dtype=int) for a in around])
    summit = np.maximum.reduceat(radius[first][flat], np.concatenate([[0], np.cumsum(size)[:-1]]))
    ridge = RIDGE * radius > summit[label]
    if kept.any():
        distance, _ = cKDTree(facets.centre[kept]).query(centre)
        ridge &= distance > 0.3 * radius
    result = np.zeros(len(candidate), dtype=bool)
    result[some[ridge]] = True
    return result & ~kept


def _build(
    surface: PatchSurface, facets: _Facets, candidate: np.ndarray, reason: np.ndarray
) -> Midstructure:
    raw = facets.raw
    names, code = np.unique(reason.astype(str), return_inverse=True)
    n = len(facets.groups.of_patch)
    label = (facets.pair[:, 0] * n + facets.pair[:, 1]) * len(names) + code
    part = facets.components(candidate, label)
    keeping = np.isin(reason, (BETWEEN, ACUTE, RIDGE_OF)).astype(bool)
    show = candidate & (_large(facets, part, candidate) | keeping)
    # slivers of ridges are many and tiny: one sheet for all that belong to one pair
    ridge = show & (reason == RIDGE_OF)
    part = np.where(ridge, part.max() + 1 + label, part)
    members = np.flatnonzero(show)
    _, sheet = np.unique(part[members], return_inverse=True)

    vertices = _polished(facets, members)
    of_corner = np.isin(facets.owner, members)
    number = np.full(len(candidate), -1)
    number[members] = np.arange(len(members))
    triangles, owner = _fans(raw, facets.owner, of_corner)
    used, triangles = np.unique(triangles, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    x = vertices[used][triangles]
    area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    solid = area > 0.0
    owner = number[owner[solid]]
    sheets = _describe(surface, facets, members, sheet, reason, keeping)
    return Midstructure(
        vertices[used],
        triangles[solid],
        sheet[owner],
        keeping[members][owner],
        raw.radius[used],
        sheets,
    )


def _fans(raw: VoronoiFacets, owner: np.ndarray, use: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles from the first corner of every polygon, and the polygon of each."""
    place = np.arange(len(owner)) - raw.start[owner]
    size = np.diff(raw.start)[owner]
    second = np.flatnonzero(use & (place > 0) & (place < size - 1))
    triangles = np.column_stack(
        [raw.corners[raw.start[owner[second]]], raw.corners[second], raw.corners[second + 1]]
    )
    return triangles, owner[second]


def _polished(facets: _Facets, members: np.ndarray) -> np.ndarray:
    """Ball centres moved to equal distance of the tangent planes at the feet of their facets."""
    raw, samples = facets.raw, facets.samples
    use = np.zeros(len(raw.feet), dtype=bool)
    use[members] = True
    corner = np.flatnonzero(use[facets.owner])
    vertex, feet = raw.corners[corner], raw.feet[facets.owner[corner]]
    x = raw.vertices[vertex]
    gap = [
        np.einsum("ki,ki->k", samples.points[foot] - x, samples.normals[foot])
        for foot in (feet[:, 0], feet[:, 1])
    ]
    across = samples.normals[feet[:, 0]] - samples.normals[feet[:, 1]]
    length2 = np.einsum("ki,ki->k", across, across)
    step = (gap[0] - gap[1]) / np.maximum(length2, 0.25)
    limit = 0.3 * raw.radius[vertex] / np.sqrt(np.maximum(length2, 0.25))
    move = across * np.clip(step, -limit, limit)[:, None]
    count = np.maximum(np.bincount(vertex, minlength=len(raw.vertices)), 1)
    total = [np.bincount(vertex, move[:, i], len(raw.vertices)) for i in range(3)]
    return raw.vertices + np.column_stack(total) / count[:, None]


def _describe(
    surface: PatchSurface,
    facets: _Facets,
    members: np.ndarray,
    sheet: np.ndarray,
    reason: np.ndarray,
    keeping: np.ndarray,
) -> tuple[Sheet, ...]:
    names = [patch.face for patch in surface.patches]
    order = np.argsort(sheet, kind="stable")
    bounds = np.searchsorted(sheet[order], np.arange(sheet.max() + 2))
    result = []
    for low, high in zip(bounds[:-1], bounds[1:], strict=True):
        mine = members[order[low:high]]
        area = facets.area[mine]
        pairs = np.sort(facets.samples.patch[facets.raw.feet[mine]], axis=1)
        unique, label = np.unique(pairs, axis=0, return_inverse=True)
        a, b = unique[np.bincount(label.ravel(), area + 1e-300).argmax()]
        middle = np.average(facets.centre[mine], axis=0, weights=area + 1e-300)
        nearest = np.linalg.norm(facets.centre[mine] - middle, axis=1).argmin()
        seed = facets.centre[mine[nearest]]
        radius, angle = facets.radius[mine], facets.angle[mine]
        result.append(
            Sheet(
                (names[a], names[b]),
                float(area.sum()),
                (float(radius.min()), float(radius.max())),
                (float(angle.min()), float(angle.max())),
                bool(keeping[mine[0]]),
                str(reason[mine[0]]),
                (float(seed[0]), float(seed[1]), float(seed[2])),
            )
        )
    return tuple(result)
