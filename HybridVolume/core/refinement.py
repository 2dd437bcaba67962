# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Exact refinement of a surface by knot insertion, along whole strips of patches (section 3.5)."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable

import numpy as np

from . import bspline
from .cones import most_inward
from .spans import alike
from .strips import SpanIntervals, Strips, span_intervals, strips
from .surface import Patch, PatchSurface

logger = logging.getLogger(__name__)

TURN = np.cos(np.radians(40.0))
"""Least cosine between the normals of a knot span and the best common direction."""


def insert_knots(surface: PatchSurface, wanted: Callable[[int, int], np.ndarray]) -> PatchSurface:
    """Insert knots along strips; sides that meet stay conforming.

    Parameters
    ----------
    surface : PatchSurface
    wanted : callable
        ``wanted(patch, direction)`` gives the new knots that a patch asks for; every patch of its
        strip gets them.

    Returns
    -------
    PatchSurface
        The same surface, point for point; patches that got no knot keep their bits.
    """
    found = strips(surface)
    asked: list[list[np.ndarray]] = [[] for _ in range(len(found))]
    for (k, d), strip in np.ndenumerate(found.number):
        knots = np.asarray(wanted(k, d), dtype=float)
        if len(knots):
            knots = 1.0 - knots if found.turned[k, d] else knots
            asked[strip] += [knots, 1.0 - knots] if found.twisted[strip] else [knots]
    return _insert(surface, found, [np.concatenate(a) if a else np.zeros(0) for a in asked])


def cut_spans(
    surface: PatchSurface, parts: np.ndarray, intervals: SpanIntervals | None = None
) -> PatchSurface:
    """Cut knot spans into equal parts, and those beside them along the strips.

    Parameters
    ----------
    surface : PatchSurface
    parts : (ne, 2) or (ni,) int array
        Parts of each span along u and along v, or of each interval.
    intervals : SpanIntervals, optional
        Those of the surface.

    Returns
    -------
    PatchSurface
        The same surface, point for point; patches that got no knot keep their bits.
    """
    intervals = intervals or span_intervals(surface)
    parts = np.asarray(parts)
    if parts.ndim == 2:
        parts = intervals.largest(parts)
    parts = parts.astype(int)
    if parts.max(initial=1) <= 1:
        return surface
    found = intervals.strips
    # a patch of each strip, whose knots are those of all of them
    _, member = np.unique(found.number, return_index=True)
    asked = []
    for strip, where in enumerate(member.tolist()):
        count = parts[intervals.first[strip] : intervals.first[strip + 1]]
        if (count <= 1).all():
            asked.append(np.zeros(0))
            continue
        k, d = divmod(where, 2)
        values = bspline.breakpoints(surface.patches[k].knots[d])
        values = 1.0 - values[::-1] if found.turned[k, d] else values
        number = np.repeat(np.arange(len(count)), count - 1)
        before = np.cumsum(count - 1) - (count - 1)
        share = np.arange(1, len(number) + 1) - before[number]
        asked.append(values[number] + np.diff(values)[number] * share / count[number])
    return _insert(surface, found, asked)


def _insert(surface: PatchSurface, found: Strips, asked: list[np.ndarray]) -> PatchSurface:
    """Insert the knots that strips ask for; patches with the same knots are done together."""
    values = [np.unique(new.round(12)) for new in asked]
    plenty = np.array([len(new) for new in values])
    touched = (plenty[found.number] > 0).any(axis=1)
    if not touched.any():
        return surface
    # a name for each set of values: strips of quads all ask for the same
    names: dict[bytes, int] = {}
    name = np.array([names.setdefault(new.tobytes(), len(names)) for new in values])
    sets = [np.frombuffer(new) for new in names]
    # patches of a degree and knots that ask for the same have the same finer knots
    kind = np.empty(len(surface.patches), dtype=int)
    for number, members in enumerate(alike(surface.patches)):
        kind[members] = number
    key = np.column_stack([kind, name[found.number], found.turned])
    distinct, group_of = np.unique(key, axis=0, return_inverse=True)
    patches = list(surface.patches)
    points: list[np.ndarray] = [np.zeros(0)] * len(patches)
    for group, (_, *new, turn_u, turn_v) in enumerate(distinct.tolist()):
        members = np.flatnonzero(group_of.ravel() == group)
        model = surface.patches[members[0]]
        if not touched[members[0]]:
            for k in members:
                points[k] = surface.control_points[patches[k].index]
            continue
        knots = list(model.knots)
        matrix: list[np.ndarray | None] = [None, None]
        for d, turned in enumerate((turn_u, turn_v)):
            inner = 1.0 - sets[new[d]] if turned else sets[new[d]]
            known = np.unique(knots[d])
            far = np.abs(inner[:, None] - known).min(axis=1) > bspline.KNOT_TOLERANCE
            if far.any():
                finer = np.sort(np.concatenate([knots[d], inner[far]]))
                matrix[d] = bspline.insertion_matrix(model.degrees[d], knots[d], finer)
                knots[d] = finer
        weights = np.stack([patches[k].weights for k in members])[..., None]
        index = np.stack([patches[k].index for k in members])
        even = np.ptp(weights, axis=(1, 2)).ravel() == 0.0
        homogeneous = np.concatenate([surface.control_points[index] * weights, weights], axis=-1)
        for d, one in enumerate(matrix):
            if one is not None:
                homogeneous = np.moveaxis(np.tensordot(one, homogeneous, ([1], [d + 1])), 0, d + 1)
        new_weights = homogeneous[..., 3]
        # polynomial patches stay so: sums of equal weights may miss them by a rounding
        new_weights[even] = weights[even, :1, :1, 0]
        x = homogeneous[..., :3] / new_weights[..., None]
        for row, k in enumerate(members.tolist()):
            patch = patches[k]
            points[k] = x[row]
            patches[k] = Patch(
                patch.face, patch.degrees, tuple(knots), patch.index, new_weights[row]
            )
    return _welded(surface, patches, points, touched)


def _welded(
    surface: PatchSurface, patches: list[Patch], points: list[np.ndarray], touched: np.ndarray
) -> PatchSurface:
    """A surface of finer patches, whose points on shared sides are one."""
    grids, count = surface.shared_grid([p.weights.shape for p in patches])
    control_points, weights = np.zeros((count, 3)), np.ones(count)
    # the lowest untouched patch gives a shared point its bits, else the lowest one: it comes last
    order = np.lexsort((np.arange(len(patches)), touched))[::-1]
    place = np.concatenate([grids[k].ravel() for k in order])
    control_points[place] = np.concatenate([points[k].reshape(-1, 3) for k in order])
    weights[place] = np.concatenate([patches[k].weights.ravel() for k in order])
    patches = [
        Patch(p.face, p.degrees, p.knots, grid, weights[grid])
        for p, grid in zip(patches, grids, strict=True)
    ]
    return PatchSurface(
        control_points,
        tuple(patches),
        surface.neighbour,
        surface.reversed,
        surface.shell_of_patch,
        surface.moved,
        surface.exact | touched,
        surface.turned,
    )


def split_spans(surface: PatchSurface, parts: int = 2) -> PatchSurface:
    """Cut every knot span into equal parts in both directions."""
    return cut_spans(surface, np.full((surface.element_count, 2), parts))


def divide_faces(surface: PatchSurface, faces: Iterable[str], spans: int = 4) -> PatchSurface:
    """Cut patches of faces, and those beside them, into some knot spans at least.

    A face without inner control points can have no thickness of its own: all columns stand on
    edges, which its neighbours share.

    Parameters
    ----------
    surface : PatchSurface
    faces : iterable of str
    spans : int
        In each direction.
    """
    named = set(faces)
    chosen = np.array([patch.face in named for patch in surface.patches], dtype=bool)
    beside = surface.neighbour[chosen, :, 0]
    chosen[beside[beside >= 0]] = True
    if not chosen.any():
        return surface
    intervals = span_intervals(surface)
    there = np.diff(intervals.first)[intervals.strips.number]
    parts = np.where(chosen[:, None], -(-spans // there), 1)
    return cut_spans(surface, parts[surface.element_patch], intervals)


def flatten_spans(surface: PatchSurface, rounds: int = 4) -> PatchSurface:
    """Halve knot spans in which the normal turns by more than about 80 degrees.

    A column is straight, so one knot span can only carry a shell where its normals have a common
    inward direction. Spans whose normals do not come together (a fold, a vanishing derivative) are
    left to the check of the surface.

    Parameters
    ----------
    surface : PatchSurface
    rounds : int
        Most halvings.
    """
    x = np.linspace(0.0, 1.0, 7)
    for _ in range(rounds):
        samples = surface.element_samples(x, x)
        _, x_u, x_v = samples.surface(surface.control_points)
        normals = np.cross(x_u, x_v).reshape(-1, len(x), len(x), 3)
        size = np.linalg.norm(normals, axis=3, keepdims=True)
        sound = (size > 1e-6 * size.max(axis=(1, 2), keepdims=True)).all(axis=(1, 2, 3))
        unit = normals / np.maximum(size, 1e-300)
        flat = unit.reshape(len(unit), -1, 3)
        mean = flat.mean(axis=1)
        mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
        margin = np.einsum("eki,ei->ek", flat, mean).min(axis=1)
        doubtful = np.flatnonzero(sound & (margin < TURN))
        if len(doubtful):
            best = most_inward(flat[doubtful], np.ones((len(doubtful), flat.shape[1]), dtype=bool))
            margin[doubtful] = np.einsum("eki,ei->ek", flat[doubtful], best).min(axis=1)
        steep = sound & (margin < TURN)
        if not steep.any():
            break
        along = [
            np.einsum("eabi,eabi->eab", unit[:, :-1], unit[:, 1:]),
            np.einsum("eabi,eabi->eab", unit[:, :, :-1], unit[:, :, 1:]),
        ]
        angle = [np.arccos(np.clip(c, -1.0, 1.0)) for c in along]
        turn = np.stack([angle[0].sum(axis=1).max(axis=1), angle[1].sum(axis=2).max(axis=1)])
        chosen = steep & (turn >= 0.5 * turn.max(axis=0))
        before = surface.element_count
        surface = cut_spans(surface, 1 + chosen.T)
        logger.info(
            "knot spans halved where normals turn: %d, were %d", surface.element_count, before
        )
    return surface
