# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The medial axis: its sheets, and the figures that every choice among them needs."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ...errors import FaultError
from ..surface import PatchSurface
from .cells import NOISE_ANGLE, Cells
from .choice import NARROW
from .samples import probes, sample_surface
from .sheets import Figures, Midstructure, Sheet, face_places
from .smooth_groups import smooth_groups
from .voronoi import VoronoiFacets, interior_facets

log = logging.getLogger(__name__)

# A sheet with more than this share of its area in the wedge of an edge reaches the surface there.
EDGE_SHARE = 0.05
# Share of a sheet's area that is left out at both ends of its object angles.
STRAY_SHARE = 0.05
# A ball touches a face's plane within so many sample spacings of the sample.
TANGENT = 1.5
# A sliver of a ridge has so many cells of ridges within its radius, itself included.
COMPANY = 8
# Share of the surface where the body may be thinner than the samples without a word.
UNSEEN_SHARE = 0.1
PROBES = ("probe_points", "probe_radius", "probe_patch")


def medial_axis(surface: PatchSurface, samples: int = 0, *, seed: int = 0) -> Midstructure:
    """Medial axis of a body as sheets of facets, with the automatic choice of what is kept.

    Inner Voronoi facets of surface samples (section 3.1). Its sheets are connected facets between
    the same two smooth groups of faces; what is left over of a pair, in pieces that are too small
    for a sheet, is one sheet of fragments where the balls are the largest around: the axis of a
    cylinder, the centre of a sphere.

    Parameters
    ----------
    surface : PatchSurface
    samples : int
        Surface samples aimed at; 0 chooses by the body.
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
    cells = Cells(interior_facets(drawn, 0.7 * NOISE_ANGLE, seed), drawn, groups)
    if not cells.candidate.any():
        raise FaultError("no inner Voronoi facet was found", remedy="use more samples")
    found = probes(surface, samples=drawn, group=groups.of_patch)
    unseen = float((found[1] < 0.5 * np.median(drawn.spacing)).mean())
    if unseen > UNSEEN_SHARE:
        log.warning(
            "%.0f %% of the surface is thinner than %d samples can tell: sheets may be missing"
            " there; use more samples",
            100.0 * unseen,
            len(drawn.points),
        )
    places = dict(zip(PROBES, found, strict=True))
    result = replace(_build(surface, cells), **places).choose()
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


def _build(surface: PatchSurface, cells: Cells) -> Midstructure:
    """All sheets, with nothing chosen yet."""
    raw, samples = cells.raw, cells.samples
    wedge, ridge = cells.in_wedge(), cells.ridges()
    part = _partition(cells, ridge)
    of_corner = (part >= 0)[cells.owner]
    triangles, owner = _fans(raw, cells.owner, of_corner)
    vertices = _polished(cells, of_corner)
    x = vertices[triangles]
    area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    solid = area > 0.0
    triangles, owner, area = triangles[solid], owner[solid], 0.5 * area[solid]
    members = np.unique(owner)
    number = np.full(len(part), -1)
    number[members] = np.arange(len(members))

    both = (number[raw.edges] >= 0).all(axis=1)
    _, edge = np.unique(raw.edge[both], return_inverse=True)
    feet = cells.feet[members]
    _, group = np.unique(cells.group[members], return_inverse=True)
    faces = tuple(patch.face for patch in surface.patches)
    figures = Figures(
        number[owner],
        samples.patch[feet],
        face_places(faces, samples.patch[feet], samples.uv[feet]),
        cells.centre[members],
        cells.radius[members],
        cells.length[members],
        cells.angle[members],
        np.bincount(number[owner], area),
        cells.spacing[members],
        wedge[members],
        ridge[members],
        group.ravel(),
        number[raw.edges[both]],
        edge.ravel(),
    )
    sheet, sheets = _describe(figures, part[members], feet, faces)
    used, triangles = np.unique(triangles, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    return Midstructure(
        vertices[used],
        triangles,
        sheet[figures.of_facet],
        np.zeros(len(triangles), dtype=bool),
        raw.radius[used],
        sheets,
        faces=faces,
        figures=figures,
    )


def _partition(cells: Cells, ridge: np.ndarray) -> np.ndarray:
    """Sheet of every cell, -1 for noise."""
    part = cells.parts()
    # slivers of ridges are many and tiny: one sheet for all that belong to one pair
    sliver = np.flatnonzero(ridge & (part < 0))
    if (part >= 0).any() and len(sliver):
        # a few alone are noise of a rounded edge
        every = np.flatnonzero(ridge)
        number = min(COMPANY, len(every))
        away = cKDTree(cells.centre[every]).query(cells.centre[sliver], k=[number])[0][:, 0]
        sliver = sliver[(away < cells.radius[sliver]) & (number == COMPANY)]
    part[sliver] = len(part) + cells.group[sliver]
    return part


def _fans(raw: VoronoiFacets, owner: np.ndarray, use: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles from the first corner of every polygon, and the polygon of each."""
    place = np.arange(len(owner)) - raw.start[owner]
    size = np.diff(raw.start)[owner]
    second = np.flatnonzero(use & (place > 0) & (place < size - 1))
    triangles = np.column_stack(
        [raw.corners[raw.start[owner[second]]], raw.corners[second], raw.corners[second + 1]]
    )
    return triangles, owner[second]


def _polished(cells: Cells, of_corner: np.ndarray) -> np.ndarray:
    """Ball centres moved to equal distance of the tangent planes at the feet of their cells."""
    raw, samples = cells.raw, cells.samples
    corner = np.flatnonzero(of_corner)
    vertex, feet = raw.corners[corner], raw.feet[cells.owner[corner]]
    x = raw.vertices[vertex]
    gap, tangent = [], np.ones(len(x), dtype=bool)
    for side in (0, 1):
        offset, normal = samples.points[feet[:, side]] - x, samples.normals[feet[:, side]]
        gap.append(np.einsum("ki,ki->k", offset, normal))
        # a ball at a concave edge does not touch the faces' planes
        away = np.linalg.norm(offset - gap[side][:, None] * normal, axis=1)
        tangent &= away < TANGENT * samples.spacing[feet[:, side]]
    across = samples.normals[feet[:, 0]] - samples.normals[feet[:, 1]]
    length2 = np.einsum("ki,ki->k", across, across)
    step = (gap[0] - gap[1]) / np.maximum(length2, 0.25)
    limit = 0.3 * raw.radius[vertex] / np.sqrt(np.maximum(length2, 0.25))
    move = across * np.where(tangent, np.clip(step, -limit, limit), 0.0)[:, None]
    count = np.maximum(np.bincount(vertex, minlength=len(raw.vertices)), 1)
    total = [np.bincount(vertex, move[:, i], len(raw.vertices)) for i in range(3)]
    return raw.vertices + np.column_stack(total) / count[:, None]


def _describe(
    figures: Figures, part: np.ndarray, feet: np.ndarray, faces: tuple[str, ...]
) -> tuple[np.ndarray, tuple[Sheet, ...]]:
    """Sheets, the largest first, and the sheet of each cell."""
    names, label = np.unique(part, return_inverse=True)
    label = label.ravel()
    area = np.bincount(label, figures.area)
    order = np.lexsort([names, -area])
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    sheet = rank[label]

    face, number = np.unique(np.asarray(faces), return_inverse=True)
    ends = number.ravel()[figures.patch]
    pair = np.sort(ends, axis=1) @ [len(face), 1]
    own = _own_feet(figures, ends, pair, feet, sheet)
    order = np.argsort(sheet, kind="stable")
    bounds = np.searchsorted(sheet[order], np.arange(len(names) + 1))
    sheets = tuple(
        _sheet(figures, order[low:high], face, ends, pair, own)
        for low, high in zip(bounds[:-1], bounds[1:], strict=True)
    )
    return sheet, sheets


def _own_feet(
    figures: Figures, ends: np.ndarray, pair: np.ndarray, feet: np.ndarray, sheet: np.ndarray
) -> np.ndarray:
    """Whether the sample under each foot belongs to no sheet before, among those of its pair."""
    key = np.column_stack([np.repeat(pair, 2), feet.ravel()])
    _, label = np.unique(key, axis=0, return_inverse=True)
    label = label.ravel()
    lowest = np.full(label.max() + 1, len(sheet))
    np.minimum.at(lowest, label, np.repeat(sheet, 2))
    return (lowest[label] == np.repeat(sheet, 2)).reshape(-1, 2)


def _sheet(
    figures: Figures,
    mine: np.ndarray,
    face: np.ndarray,
    ends: np.ndarray,
    pair: np.ndarray,
    own: np.ndarray,
) -> Sheet:
    """Describe the sheet of some cells."""
    weight = figures.area[mine] + np.finfo(float).tiny
    total = weight.sum()
    unique, label = np.unique(pair[mine], return_inverse=True)
    first, second = divmod(int(unique[np.bincount(label.ravel(), weight).argmax()]), len(face))
    among = mine[pair[mine] == first * len(face) + second]
    side = np.where(ends[among, 0] == first, 0, 1)
    if not own[among, side].any():
        first, second, side = second, first, 1 - side
    named = own[among, side]
    if named.any():
        among, side = among[named], side[named]
    middle = weight @ figures.centre[mine] / total
    nearest = np.linalg.norm(figures.centre[among] - middle, axis=1).argmin()
    seed, foot = figures.centre[among[nearest]], figures.foot[among[nearest], side[nearest]]
    radius = figures.radius[mine]
    # a few cells at a rim see other samples than those opposite
    by_angle = np.argsort(figures.angle[mine], kind="stable")
    share = np.cumsum(weight[by_angle]) / total
    ends_of_angle = np.searchsorted(share, (STRAY_SHARE, 1.0 - STRAY_SHARE))
    low, high = figures.angle[mine[by_angle[np.minimum(ends_of_angle, len(mine) - 1)]]]
    return Sheet(
        (str(face[first]), str(face[second])),
        float(figures.area[mine].sum()),
        (float(radius.min()), float(radius.max())),
        (float(low), float(high)),
        False,
        NARROW,
        (float(seed[0]), float(seed[1]), float(seed[2])),
        (float(foot[0]), float(foot[1])),
        bool(weight[figures.wedge[mine]].sum() > EDGE_SHARE * total),
    )
