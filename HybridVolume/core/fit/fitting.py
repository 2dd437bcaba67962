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
from ..polygons import PolygonMesh
from ..surface import PatchSurface, SplineFace
from .corners import FlatCorner
from .fading import faded
from .measures import corner_angles, distances, widest_cone
from .padding import padded
from .patches import STIFFNESS, Sampled, fitted, sampled
from .reference import SHARP, Reference
from .snap import Snapped, aligned, snapped

logger = logging.getLogger(__name__)

TOLERANCE = 0.003
"""Share of the diagonal that is reached where nothing else is asked."""
ROUNDS = 10
PATIENCE = 3
"""Rounds after which both rings of a quad that is too far off get more spans."""
OPENING = 0.75
"""Share of the tolerance by which straight corners on features may be moved."""
WIDEST = 150.0
"""Degrees above which an opened corner has a ring of quads instead."""
MOST_SPANS = 4
"""Knot spans of a ring of quads."""
STIFFEST = 1e-1
"""Weight of fairness at which nothing is left to try."""


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
    corners : (patches, 4) array
        Angles between the sides at the patches' corners, degrees.
    cone : float
        Half the opening of the widest cone of normals of a knot span, degrees.
    opened : tuple of FlatCorner
        Straight corners on smooth features that were opened.
    """

    faces: tuple[SplineFace, ...]
    surface: PatchSurface
    distance: float
    mean_distance: float
    refined: int
    stiffened: int
    corners: np.ndarray
    cone: float
    opened: tuple[FlatCorner, ...]


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
    snap = faded(snapped(aligned(quads, goal), goal), goal)
    made = _laid_out(snap, goal, OPENING * tolerance)
    spans = np.ones(made.ring_count, dtype=int)
    stiffness = np.full(len(made.layout), STIFFNESS)
    best: Fit | None = None
    worst: list[str] = []
    late = [np.zeros((len(a), len(b)), dtype=int) for a, b in made.rings]
    folded: SingularSurfaceError | None = None
    for _ in range(ROUNDS):
        faces = fitted(made, spans, stiffness)
        surface = build_surface(faces)
        off, mean = distances(surface, made, goal)
        distance = float(max(grid.max() for grid in off))
        bad, error = _folds(surface)
        logger.info(
            "fit: %d control points, distance %.3g mm, %d folded patches",
            len(surface.control_points),
            distance,
            len(bad),
        )
        if not len(bad) and (best is None or distance < best.distance):
            found = (int((spans > 1).sum()), int((stiffness > STIFFNESS).sum()))
            angles, cone = corner_angles(surface), widest_cone(surface)
            best = Fit(tuple(faces), surface, distance, mean, *found, angles, cone, made.opened)
            worst = [faces[k].name for k, grid in enumerate(off) if grid.max() > tolerance]
        if best is not None and best.distance <= tolerance:
            return best
        folded = error or folded
        before = spans.copy(), stiffness.copy()
        stiffness[bad] = np.minimum(10.0 * stiffness[bad], STIFFEST)
        late = [count + (grid > tolerance) for count, grid in zip(late, off, strict=True)]
        more = _wanted(made, spans, off, late, tolerance)
        spans = np.minimum(spans + more, MOST_SPANS)
        if np.array_equal(before[0], spans) and np.array_equal(before[1], stiffness):
            break
    if best is None:
        raise folded
    raise InputError(
        f"the patches come no nearer than {best.distance:.3g} mm"
        f" ({best.distance / goal.diagonal:.2%} of the diagonal)",
        faces=worst,
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


def _wanted(
    made: Sampled,
    spans: np.ndarray,
    off: list[np.ndarray],
    late: list[np.ndarray],
    tolerance: float,
) -> np.ndarray:
    """Rings that get one more span, (rings,) of 0 and 1: few quads that mend the most.

    A quad that is too far off is mended by either of its rings, or by both where it has been so
    for `PATIENCE` rounds.
    """
    pairs, excess = [], []
    more = np.zeros(made.ring_count, dtype=int)
    size = np.zeros(made.ring_count)
    for (ring_u, ring_v), far, rounds in zip(made.rings, off, late, strict=True):
        np.add.at(size, ring_u, len(ring_v))
        np.add.at(size, ring_v, len(ring_u))
        i, j = np.nonzero(far > tolerance)
        pairs.append(np.column_stack([ring_u[i], ring_v[j]]))
        excess.append(far[i, j] / tolerance - 1.0)
        i, j = np.nonzero((far > tolerance) & (rounds >= PATIENCE))
        more[ring_u[i]] = more[ring_v[j]] = 1
    pair, left = np.concatenate(pairs), np.concatenate(excess)
    left[more[pair].any(axis=1)] = 0.0
    price = np.sqrt(size) * spans
    while left.any():
        gain = sum(np.bincount(pair[:, axis], left, made.ring_count) for axis in (0, 1))
        ring = int((gain / price).argmax())
        more[ring] = 1
        left[(pair == ring).any(axis=1)] = 0.0
    return more
