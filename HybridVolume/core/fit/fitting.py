# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""From a quad mesh and a reference to a closed surface of splines within a tolerance."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from ...errors import InputError, SingularSurfaceError
from ..assembly import build_surface
from ..check import check_surface
from ..midstructure.distances import SurfaceDistance
from ..polygons import PolygonMesh
from ..surface import PatchSurface, SplineFace
from .padding import padded
from .patches import STIFFNESS, Sampled, fitted, sampled
from .reference import SHARP, Reference
from .snap import Snapped, aligned, snapped

logger = logging.getLogger(__name__)

TOLERANCE = 0.003
"""Share of the diagonal that is reached where nothing else is asked."""
ROUNDS = 8
OPENING = 0.75
"""Share of the tolerance by which straight corners on features may be moved."""
WIDEST = 150.0
"""Degrees above which an opened corner has a ring of quads instead."""
MOST_SPANS = 4
"""Knot spans of a ring of quads."""
STIFFEST = 1e-1
"""Weight of fairness at which nothing is left to try."""
_LINE = (np.arange(12) + 0.5) / 12
"""Where patches are compared with the reference, a quad."""


@dataclass(frozen=True)
class Fit:
    """A fitted surface.

    Attributes
    ----------
    faces : tuple of SplineFace
    surface : PatchSurface
    distance : float
        Largest distance between surface and reference, either way, mm.
    mean_distance : float
        Mean distance of the surface from the reference, mm.
    refined, stiffened : int
        Rings of quads with more than one span, and patches with more fairness than others.
    """

    faces: tuple[SplineFace, ...]
    surface: PatchSurface
    distance: float
    mean_distance: float
    refined: int
    stiffened: int


def fit(
    quads: PolygonMesh,
    reference: PolygonMesh,
    tolerance: float | None = None,
    *,
    sharp: float = SHARP,
) -> Fit:
    """Fit bicubic spline patches over the layout of a quad mesh to a triangulated surface.

    Parameters
    ----------
    quads : PolygonMesh
        Mended; brought into the reference's frame first.
    reference : PolygonMesh
        Mended.
    tolerance : float, optional
        Largest distance, mm; `TOLERANCE` of the diagonal by default.
    sharp : float
        Degrees by which triangles turn at features.

    Raises
    ------
    InputError
        The quads do not look like the reference, or the tolerance cannot be reached; the error
        names patches and the distance that was.
    SingularSurfaceError
        Patches stay folded.
    """
    goal = Reference(reference, sharp)
    tolerance = tolerance or TOLERANCE * goal.diagonal
    made = _laid_out(snapped(aligned(quads, goal), goal), goal, OPENING * tolerance)
    spans = np.ones(made.ring_count, dtype=int)
    stiffness = np.full(len(made.layout), STIFFNESS)
    best: Fit | None = None
    folded: SingularSurfaceError | None = None
    for _ in range(ROUNDS):
        faces = fitted(made, spans, stiffness)
        surface = build_surface(faces)
        off, mean = _distances(surface, made, goal)
        distance = float(max(grid.max() for grid in off))
        bad = _folds(surface)
        logger.info(
            "fit: %d control points, distance %.3g mm, %d folded patches",
            len(surface.control_points),
            distance,
            len(bad[0]),
        )
        if not len(bad[0]) and (best is None or distance < best.distance):
            found = (int((spans > 1).sum()), int((stiffness > STIFFNESS).sum()))
            best = Fit(tuple(faces), surface, distance, mean, *found)
        if best is not None and best.distance <= tolerance:
            return best
        folded = bad[1] or folded
        before = spans.copy(), stiffness.copy()
        stiffness[bad[0]] = np.minimum(10.0 * stiffness[bad[0]], STIFFEST)
        for pair, grid in zip(made.rings, off, strict=True):
            for axis in (0, 1):
                spans[pair[axis][grid.max(axis=1 - axis) > tolerance]] += 1
        spans = np.minimum(spans, MOST_SPANS)
        if np.array_equal(before[0], spans) and np.array_equal(before[1], stiffness):
            break
    if best is None:
        raise folded
    worst = [k for k, grid in enumerate(off) if grid.max() > tolerance]
    raise InputError(
        f"the patches come no nearer than {best.distance:.3g} mm"
        f" ({best.distance / goal.diagonal:.2%} of the diagonal)",
        faces=[faces[k].name for k in worst],
        figure=best.distance,
        remedy="allow that, or give quads that follow the reference's features",
    )


def _laid_out(snap: Snapped, goal: Reference, reach: float) -> Sampled:
    """Samples of a layout without straight corners, as far as these can be avoided."""
    made = sampled(snap, goal, reach)
    wide = np.array([corner.quad for corner in made.opened if corner.after > WIDEST], dtype=int)
    if len(wide):
        snap, rings = padded(snap, goal, wide)
        if rings:
            logger.info("fit: rings of quads at %d straight corners", len(rings))
            made = sampled(snap, goal, reach)
    for corner in made.opened:
        logger.info(
            "fit: straight corner at vertex %d opened from %.0f to %.0f degrees by %.3g mm",
            corner.vertex + 1,
            corner.before,
            corner.after,
            corner.move,
        )
    return made


def _folds(surface: PatchSurface) -> tuple[np.ndarray, SingularSurfaceError | None]:
    """Patches that are folded, and what is said about them."""
    try:
        check_surface(surface)
    except SingularSurfaceError as error:
        names = set(error.faces)
        rows = [k for k, patch in enumerate(surface.patches) if patch.face in names]
        return np.array(rows, dtype=int), error
    return np.zeros(0, dtype=int), None


def _distances(
    surface: PatchSurface, made: Sampled, goal: Reference
) -> tuple[list[np.ndarray], float]:
    """Largest distance at each quad of each patch, (m, n), mm, and the mean."""
    off, total, count = [], 0.0, 0
    for k, lines in enumerate(made.lines):
        at = [(a[:-1, None] + np.diff(a)[:, None] * _LINE).ravel() / a[-1] for a in lines]
        u, v = (a.ravel() for a in np.meshgrid(*at, indexing="ij"))
        patch = surface.patches[k]
        u, v = (t[0] + s * (t[-1] - t[0]) for t, s in zip(patch.knots, (u, v), strict=True))
        points = surface.evaluate_at(np.full(len(u), k), u, v)
        away = np.linalg.norm(points - goal.nearest(points)[0], axis=1)
        total, count = total + float(away.sum()), count + len(away)
        shape = (len(lines[0]) - 1, len(_LINE), len(lines[1]) - 1, len(_LINE))
        off.append(away.reshape(shape).max(axis=(1, 3)))
    # the other way: nothing of the reference may be left out
    feet = SurfaceDistance(surface).nearest(goal.vertices)
    for k, lines in enumerate(made.lines):
        rows = np.flatnonzero(feet.patch == k)
        cell = [
            np.clip(np.searchsorted(a / a[-1], feet.uv[rows, axis], "right") - 1, 0, len(a) - 2)
            for axis, a in enumerate(lines)
        ]
        np.maximum.at(off[k], tuple(cell), feet.distance[rows])
    return off, total / count
