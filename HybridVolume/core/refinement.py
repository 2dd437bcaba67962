# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Exact refinement of a surface by knot insertion, along whole strips of patches (section 3.5)."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable

import numpy as np

from . import bspline
from .assembly import direction_strips
from .cones import most_inward
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
    label, turn, symmetric = direction_strips(surface.neighbour, surface.reversed)
    asked: list[list[np.ndarray]] = [[] for _ in symmetric]
    for (k, d), strip in np.ndenumerate(label):
        knots = np.asarray(wanted(k, d), dtype=float)
        if len(knots):
            knots = 1.0 - knots if turn[k, d] else knots
            asked[strip] += [knots, 1.0 - knots] if symmetric[strip] else [knots]
    points: list[np.ndarray] = []
    patches: list[Patch] = []
    touched = np.zeros(len(surface.patches), dtype=bool)
    for k, patch in enumerate(surface.patches):
        homogeneous = np.concatenate(
            [
                surface.control_points[patch.index] * patch.weights[..., None],
                patch.weights[..., None],
            ],
            axis=-1,
        )
        knots = list(patch.knots)
        for d in range(2):
            new = asked[label[k, d]]
            if not new:
                continue
            values = np.unique(np.concatenate(new).round(12))
            values = 1.0 - values if turn[k, d] else values
            known = np.unique(knots[d])
            far = np.abs(values[:, None] - known).min(axis=1) > bspline.KNOT_TOLERANCE
            finer = np.sort(np.concatenate([knots[d], values[far]]))
            matrix = bspline.insertion_matrix(patch.degrees[d], knots[d], finer)
            homogeneous = np.moveaxis(np.tensordot(matrix, homogeneous, ([1], [d])), 0, d)
            knots[d] = finer
            touched[k] = True
        weights = homogeneous[..., 3] if touched[k] else patch.weights
        points.append(
            homogeneous[..., :3] / homogeneous[..., 3:]
            if touched[k]
            else surface.control_points[patch.index]
        )
        patches.append(Patch(patch.face, patch.degrees, tuple(knots), patch.index, weights))
    if not touched.any():
        return surface
    grids, count = surface.shared_grid([p.weights.shape for p in patches])
    control_points, weights = np.zeros((count, 3)), np.ones(count)
    # the lowest untouched patch gives a shared point its bits, else the lowest one
    for k in sorted(range(len(patches)), key=lambda k: (not touched[k], k), reverse=True):
        control_points[grids[k]] = points[k]
        weights[grids[k]] = patches[k].weights
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
    share = np.arange(1, parts) / parts

    def wanted(k: int, d: int) -> np.ndarray:
        values = bspline.breakpoints(surface.patches[k].knots[d])
        return (values[:-1, None] + np.diff(values)[:, None] * share).ravel()

    return insert_knots(surface, wanted)


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

    def wanted(k: int, d: int) -> np.ndarray:
        values = bspline.breakpoints(surface.patches[k].knots[d])
        parts = -(-spans // (len(values) - 1))
        if not chosen[k] or parts == 1:
            return np.zeros(0)
        share = np.arange(1, parts) / parts
        return (values[:-1, None] + np.diff(values)[:, None] * share).ravel()

    return insert_knots(surface, wanted)


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
        new: dict[tuple[int, int], list[float]] = {}
        for group in surface.groups:
            middle = 0.5 * (group.low + group.high)
            for d in range(2):
                for row in np.flatnonzero(chosen[d][group.element]):
                    new.setdefault((group.patch[row], d), []).append(middle[row, d])
        before = surface.element_count
        surface = insert_knots(surface, lambda k, d, new=new: np.unique(new.get((k, d), [])))
        logger.info(
            "knot spans halved where normals turn: %d, were %d", surface.element_count, before
        )
    return surface
