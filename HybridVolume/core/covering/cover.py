# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A body of any faces becomes a closed surface of four-sided patches.

Edges get intervals, faces quads, quads bicubic patches through points of the CAD faces. What is
folded, or too far from the CAD face, gets more intervals, and all is made again.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ...errors import HybridVolumeError, InputError, SingularSurfaceError
from ..assembly import build_surface
from ..check import check_surface
from ..surface import SplineFace
from .coons import homogeneous_nets
from .extent import control_points
from .geometry import SplineCurve
from .intervals import assign_intervals, lower_bounds
from .iso_sides import order_rows
from .kept import Geometry, kept
from .kinds import deviations, kinds_of, piece_errors
from .lattice import bicubic_nets
from .outline import Outline
from .patches import joined_patches
from .pillows import corner_angles
from .quad_mesh import Meshers, QuadCover, UnmeshedError, quad_cover
from .refining import bending, growth, more_intervals

logger = logging.getLogger(__name__)

ROUNDS = 9
"""So often more intervals are tried."""
MOST_UNMESHED = 3
"""So often a mesher may leave faces out."""
FINER = 1.5
"""Quads that are folded or slivers become so many times smaller."""
MANY_POINTS = 100
"""More control points a quad, on average, than this (a bicubic patch has 16) are too many for the
shell: then only edges with simple curves are exact."""
MOST_POINTS = 3_000_000
"""More control points are refused."""
MOST_INTERVALS = 8_000
"""More on all edges are not tried: a cover of some ten thousand quads is of no use."""
SLIVER = np.radians(1.0)
"""Quads with a smaller angle are made again."""


@dataclass(frozen=True)
class Cover:
    """Four-sided patches all over a body.

    Attributes
    ----------
    faces : tuple of SplineFace
        Named after the outline's faces: ``Face3.1``, ``Face3.2``, ...
    origin : (n,) int array
        Face of the outline that each is on.
    deviation : (nf,) array
        Largest distance of the patches of each face of the outline from it, mm, at samples.
    quads : int
        Quads that the patches were joined from.
    kinds : tuple of str
        ``bit``, ``exact`` or ``tolerance`` for each face of the outline, see :mod:`.kinds`.
    """

    faces: tuple[SplineFace, ...]
    origin: np.ndarray
    deviation: np.ndarray
    quads: int
    kinds: tuple[str, ...]


def cover_body(
    brep: Path,
    outline: Outline,
    curves: Sequence[SplineCurve | None],
    surfaces: Sequence[SplineFace],
    tolerance: float,
    *,
    turn: float = 60.0,
    share: float = 5.0,
    seconds: float = np.inf,
    progress: Callable[[float, str], None] | None = None,
    meshers: Meshers | None = None,
) -> Cover:
    """Cover a body.

    Parameters
    ----------
    brep : Path
        The solid as a file, for the mesher.
    outline : Outline
    curves, surfaces : sequences
        Of its edges and faces.
    tolerance : float
        Largest distance from the faces, mm.
    turn : float
        Most that an edge turns in an interval at first, degrees; quads are half as long.
    share : float
        Intervals are at most the diagonal by this long at first.
    seconds : float
        No round begins that would probably end later.
    progress : callable, optional
        Told the share that is done and what comes next.
    meshers : Meshers, optional
        All that are installed by default.

    Raises
    ------
    InputError
        No cover without folds, or none within the tolerance, was found; faces are named.
    """
    diagonal = float(np.linalg.norm(np.ptp(outline.vertices, axis=0)))
    size = diagonal / share
    fewest = lower_bounds(outline, np.radians(turn), size)
    geometry = Geometry.of(outline, curves, surfaces, tolerance)
    rows = order_rows(geometry.strict, len(outline.edges))
    meshers = meshers or Meshers.available()
    failure: HybridVolumeError | None = None
    began, words, worst = time.monotonic(), "quads on all faces", []
    unmeshed = 0
    for number in range(ROUNDS):
        past = time.monotonic() - began
        if failure is not None and past * (1.0 + 2.0 / number) > seconds:
            raise _stopped(failure, f"after {past:.0f} s")
        if progress is not None:
            progress(number / ROUNDS, f"round {number + 1}: {words}")
        intervals, sides = assign_intervals(outline, fewest, geometry.iso, rows)
        if failure is not None and intervals.sum() > MOST_INTERVALS:
            raise _stopped(failure, f"with {intervals.sum()} intervals of edges")
        try:
            meshed = quad_cover(
                brep,
                outline,
                intervals,
                sides,
                size,
                geometry.curves,
                surfaces,
                geometry.planar,
                meshers,
            )
        except UnmeshedError as error:
            # too few intervals: as polygons, edges of a face may cross each other
            failure, words = error, f"{len(error.missing)} faces not meshed"
            unmeshed += 1
            if unmeshed == MOST_UNMESHED:
                raise
            logger.info("round %d: %s", number + 1, error.line)
            edges = np.unique(outline.edge[np.isin(outline.face, error.missing)])
            fewest[edges] = np.maximum(fewest[edges], np.ceil(FINER * intervals[edges] + 0.1))
            continue
        found = kept(meshed, outline, geometry)
        cover = found.cover
        bicubic = bicubic_nets(cover, geometry.curves, surfaces)
        nets = homogeneous_nets(cover, bicubic, found.rims, geometry.planar)
        points = control_points(cover, nets)
        if points.mean() > MANY_POINTS:
            if not geometry.simple:
                logger.info("%.0f control points a quad: only simple edges exact", points.mean())
                geometry = replace(geometry, simple=True)
                found = kept(meshed, outline, geometry)
                cover = found.cover
                bicubic = bicubic_nets(cover, geometry.curves, surfaces)
                nets = homogeneous_nets(cover, bicubic, found.rims, geometry.planar)
                points = control_points(cover, nets)
            if points.sum() > MOST_POINTS:
                most = np.zeros(len(surfaces))
                np.maximum.at(most, cover.face, points)
                raise InputError(
                    f"joined patches would need {points.sum():.0f} control points",
                    faces=_names(np.argsort(-most)[:8]),
                    figure=float(points.sum()),
                    remedy="rebuild these faces with a lower degree or fewer knots",
                )
        off = deviations(found, nets, geometry, curves)
        deviation = np.zeros(len(surfaces))
        np.maximum.at(deviation, cover.face, off)
        factor = np.where(off > tolerance, growth(off, tolerance), 1.0)
        worst.append(float(off.max()))
        if worst[-1] > tolerance:
            failure = InputError(
                f"patches miss faces by up to {worst[-1]:.2g} mm",
                faces=_names(np.flatnonzero(deviation > tolerance)),
                figure=worst[-1],
                remedy="allow a larger deviation, or simplify these faces in the CAD program",
            )
        slivers = _slivers(cover, outline)
        if len(slivers):
            factor[slivers] = np.maximum(factor[slivers], FINER)
            failure = InputError(
                f"{len(slivers)} quads are slivers",
                faces=_names(np.unique(cover.face[slivers])),
                figure=float(len(slivers)),
                remedy="merge narrow faces with their neighbours in the CAD program",
            )
        bent = bending(bicubic)
        bent[slivers] = 1.0
        if not np.any(factor > 1.0):
            joined = joined_patches(cover, nets, found.grids, surfaces)
            try:
                surface = build_surface(list(joined.faces))
                check_surface(surface)
            except SingularSurfaceError as error:
                failure = error
                near = _quads_near(cover, error)
                factor[near], bent[near] = FINER, 1.0
            else:
                logger.info(
                    "%d quads in %d patches, %d rounds",
                    *(len(cover.quads), len(joined.faces), number + 1),
                )
                moved = np.zeros(len(surfaces))
                np.maximum.at(moved, joined.origin, surface.moved)
                deviation = np.maximum(deviation, piece_errors(joined, surfaces))
                kinds = kinds_of(outline, found, geometry, deviation, moved)
                deviation = np.maximum(deviation, moved)
                return Cover(joined.faces, joined.origin, deviation, len(cover.quads), kinds)
        # a finer mesh may be worse somewhere else: three in a row may not
        if len(worst) > 5 and min(worst[-3:]) > max(tolerance, 0.9 * min(worst[:-3])):
            raise _stopped(failure, "and finer quads come no nearer")
        bad = np.unique(cover.face[factor > 1.0])
        words = f"{len(cover.quads)} quads, smaller ones on {len(bad)} faces"
        logger.info(
            "round %d: %s (%s), %s",
            *(number + 1, words, ", ".join(_names(bad[:12])), failure.message if failure else ""),
        )
        fewest = np.maximum(fewest, more_intervals(cover, outline, intervals, factor, bent))
        if number % 2:
            size *= 0.75
    assert failure is not None  # there was a last round, and it was not good
    raise failure


def _stopped(failure: HybridVolumeError, why: str) -> HybridVolumeError:
    """A failure that is not tried to be mended any longer."""
    failure.message += f" {why}"
    failure.args = (failure.message,)
    return failure


def _slivers(cover: QuadCover, outline: Outline) -> np.ndarray:
    """Quads with nearly closed corners, but for those in corners of faces that are no wider."""
    small = corner_angles(cover.points[cover.quads]) < SLIVER
    quads = np.flatnonzero(small.any(axis=1))
    if len(quads):
        sharp = np.flatnonzero(np.abs(outline.corner) > np.pi - 3.0 * SLIVER)
        forward = outline.forward[sharp].astype(int)
        vertices = outline.vertices[outline.edges[outline.edge[sharp], forward]]
        if len(vertices):
            away = cKDTree(vertices).query(cover.points[cover.quads[quads]])[0]
            size = float(np.ptp(outline.vertices, axis=0).max())
            small[quads] &= away > 1e-7 * size
    return np.flatnonzero(small.any(axis=1))


def _names(faces: np.ndarray) -> list[str]:
    return [f"Face{face + 1}" for face in faces.tolist()]


def _quads_near(cover: QuadCover, error: SingularSurfaceError) -> np.ndarray:
    """Quads that touch those around the places that an error names."""
    near = cKDTree(cover.points).query([place.point for place in error.places])[1]
    on = np.zeros(len(cover.points), dtype=bool)
    on[near] = True
    on[cover.quads[on[cover.quads].any(axis=1)]] = True
    return np.flatnonzero(on[cover.quads].any(axis=1))
