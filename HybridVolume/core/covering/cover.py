# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A body of any faces becomes a closed surface of four-sided patches.

Edges get intervals, faces quads, quads bicubic patches through points of the CAD faces. What is
folded, or too far from the CAD face, gets more intervals, and all is made again.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ...errors import (
    FaultError,
    GapError,
    HybridVolumeError,
    InputError,
    OpenBodyError,
    OrientationError,
    SingularSurfaceError,
    TJunctionError,
)
from ..assembly import build_surface
from ..check import check_surface
from ..surface import SplineFace
from .coons import homogeneous_nets
from .cusps import cusps_of, with_directions
from .effort import Effort
from .extent import control_points
from .geometry import SplineCurve
from .intervals import assign_intervals, lower_bounds
from .iso_sides import order_rows
from .kept import Geometry, Kept, kept
from .kinds import border_gaps, deviations, kinds_of, piece_errors
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
SAFE = 0.85
"""Share of the tolerance that samples must keep to: between them patches may be farther away."""
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
        No round begins that would probably end later; of the processor.
    progress : callable, optional
        Told the share that is done and what comes next.
    meshers : Meshers, optional
        All that are installed by default.

    Raises
    ------
    InputError
        No cover without folds, or none within the tolerance, was found; faces are named.
    FaultError
        Patches do not fit each other.
    """
    search = _Search(outline, curves, surfaces, tolerance, turn, share)
    meshers = meshers or Meshers.available()
    effort = Effort()
    for number in range(ROUNDS):
        search.stop_if_late(number, effort.seconds(), seconds)
        if progress is not None:
            progress(number / ROUNDS, f"round {number + 1}: {search.words}")
        intervals, sides = search.intervals()
        try:
            meshed = quad_cover(
                brep,
                outline,
                intervals,
                sides,
                search.size,
                search.geometry.curves,
                surfaces,
                search.geometry.planar,
                meshers,
            )
        except UnmeshedError as error:
            search.add_intervals_around(error, intervals)
        else:
            trial = search.patches_on(meshed)
            search.judge(trial)
            if not np.any(trial.factor > 1.0):
                cover = search.joined(trial)
                if cover is not None:
                    logger.info(
                        "%d quads in %d patches, %d rounds",
                        *(cover.quads, len(cover.faces), number + 1),
                    )
                    return cover
            search.add_intervals(trial, intervals, shrink=bool(number % 2))
        logger.info("round %d: %s (%s)", number + 1, search.words, search.told)
    raise search.failed()


@dataclass
class _Trial:
    """Quads of a round with their patches, and what is wrong with them.

    Attributes
    ----------
    found : Kept
    bicubic : (m, 4, 4, 3) array
        Patches through points of the faces,
    nets : list
        and the homogeneous nets that they become.
    factor : (m,) array
        So many times smaller quads must be; 1 where they are good.
    bent : (m, 2) array
        How far they bend along their sides.
    deviation : (nf,) array
        Largest distance of each face's patches, mm.
    """

    found: Kept
    bicubic: np.ndarray
    nets: list
    factor: np.ndarray
    bent: np.ndarray
    deviation: np.ndarray

    @property
    def cover(self) -> QuadCover:
        """The quads."""
        return self.found.cover


class _Search:
    """Ever finer quads on one body: what rounds hand on to the next.

    Attributes
    ----------
    geometry : Geometry
    size : float
        Largest quads inside faces, mm.
    words : str
        What comes next.
    """

    def __init__(
        self,
        outline: Outline,
        curves: Sequence[SplineCurve | None],
        surfaces: Sequence[SplineFace],
        tolerance: float,
        turn: float,
        share: float,
    ) -> None:
        self.outline, self.curves, self.surfaces = outline, curves, surfaces
        self.tolerance = tolerance
        self.size = float(np.linalg.norm(np.ptp(outline.vertices, axis=0))) / share
        self.geometry = Geometry.of(outline, curves, surfaces, tolerance)
        self.words = "quads on all faces"
        self._cusps = cusps_of(outline, self.geometry.curves)
        self._rows = order_rows(self.geometry.strict, len(outline.edges))
        self._fewest = lower_bounds(outline, np.radians(turn), self.size)
        self._failure: HybridVolumeError | None = None
        self._unmeshed = 0
        self._worst: list[float] = []

    @property
    def told(self) -> str:
        """Why there has to be another round."""
        return self._failure.message if self._failure else ""

    def failed(self, why: str = "") -> HybridVolumeError:
        """The failure that is not tried to be mended any longer."""
        failure = self._failure
        if failure is None:
            return FaultError("no cover, and no reason", remedy="please report this body")
        if why:
            failure.message += f" {why}"
            failure.args = (failure.message,)
        return failure

    def stop_if_late(self, number: int, past: float, seconds: float) -> None:
        """Raise the failure where another round would probably take too long."""
        if self._failure is not None and past * (1.0 + 2.0 / number) > seconds:
            raise self.failed(f"after {past:.0f} s")

    def intervals(self) -> tuple[np.ndarray, dict[int, list[np.ndarray]]]:
        """Intervals of the edges, and the sides of four-sided faces."""
        found, sides = assign_intervals(self.outline, self._fewest, self.geometry.iso, self._rows)
        if self._failure is not None and found.sum() > MOST_INTERVALS:
            raise self.failed(f"with {found.sum()} intervals of edges")
        return found, sides

    def add_intervals_around(self, error: UnmeshedError, intervals: np.ndarray) -> None:
        """More intervals around faces that no mesher meshes.

        As polygons, edges of a face that are cut coarsely may cross each other.
        """
        self._failure = error
        self._unmeshed += 1
        if self._unmeshed == MOST_UNMESHED:
            raise error
        self.words = f"{len(error.missing)} faces not meshed"
        edges = np.unique(self.outline.edge[np.isin(self.outline.face, error.missing)])
        more = np.ceil(FINER * intervals[edges] + 0.1)
        self._fewest[edges] = np.maximum(self._fewest[edges], more)

    def patches_on(self, meshed: QuadCover) -> _Trial:
        """Patches on quads; with simple edges only, where exact ones cost too much."""
        trial, points = self._patches(meshed)
        if points.mean() > MANY_POINTS and not self.geometry.simple:
            logger.info("%.0f control points a quad: only simple edges exact", points.mean())
            self.geometry = replace(self.geometry, simple=True)
            trial, points = self._patches(meshed)
        if points.sum() > MOST_POINTS:
            most = np.zeros(len(self.surfaces))
            np.maximum.at(most, trial.cover.face, points)
            raise InputError(
                f"joined patches would need {points.sum():.0f} control points",
                faces=_names(np.argsort(-most)[:8]),
                figure=float(points.sum()),
                remedy="rebuild these faces with a lower degree or fewer knots",
            )
        return trial

    def _patches(self, meshed: QuadCover) -> tuple[_Trial, np.ndarray]:
        """Patches on quads, and how many control points each quad costs."""
        geometry = self.geometry
        found = kept(meshed, self.outline, geometry)
        # faces that keep their parameters keep their edges
        fixed = self.outline.edge[np.isin(self.outline.face, list(found.grids))]
        rims = with_directions(found.rims, found.cover, self._cusps, set(fixed.tolist()))
        found = replace(found, rims=rims)
        bicubic = bicubic_nets(found.cover, geometry.curves, self.surfaces, self._cusps)
        nets = homogeneous_nets(found.cover, bicubic, found.rims, geometry.planar)
        factor, deviation = np.ones(len(found.cover.quads)), np.zeros(len(self.surfaces))
        trial = _Trial(found, bicubic, nets, factor, bending(bicubic), deviation)
        return trial, control_points(found.cover, nets)

    def judge(self, trial: _Trial) -> None:
        """Find quads that are too far away, and slivers."""
        cover = trial.cover
        off = deviations(trial.found, trial.nets, self.geometry, self.curves)
        np.maximum.at(trial.deviation, cover.face, off)
        aim = SAFE * self.tolerance
        trial.factor = np.where(off > aim, growth(off, aim), 1.0)
        self._worst.append(float(off.max()))
        if self._worst[-1] > aim:
            self._failure = InputError(
                f"patches miss faces by up to {self._worst[-1]:.2g} mm, {aim:.2g} mm are allowed",
                faces=_names(np.flatnonzero(trial.deviation > aim)),
                figure=self._worst[-1],
                remedy="allow a larger deviation, or simplify these faces in the CAD program",
            )
        slivers = _slivers(cover, self.outline)
        if len(slivers):
            trial.factor[slivers] = np.maximum(trial.factor[slivers], FINER)
            trial.bent[slivers] = 1.0
            self._failure = InputError(
                f"{len(slivers)} quads are slivers",
                faces=_names(np.unique(cover.face[slivers])),
                figure=float(len(slivers)),
                remedy="merge narrow faces with their neighbours in the CAD program",
            )

    def joined(self, trial: _Trial) -> Cover | None:
        """Joined patches, proved to be sound; None where quads must become smaller for that.

        Raises
        ------
        FaultError
            The patches, which share the curves of their sides, do not fit each other.
        """
        joined = joined_patches(trial.cover, trial.nets, trial.found.grids, self.surfaces)
        try:
            surface = build_surface(list(joined.faces))
            check_surface(surface)
        except SingularSurfaceError as error:
            self._failure = error
            near = _quads_near(trial.cover, error)
            trial.factor[near], trial.bent[near] = FINER, 1.0
            return None
        except (GapError, OpenBodyError, OrientationError, TJunctionError) as error:
            raise FaultError(
                f"the patches do not fit each other: {error.message}",
                faces=error.faces,
                figure=error.figure,
                remedy="please report this body",
            ) from error
        moved = np.zeros(len(self.surfaces))
        np.maximum.at(moved, joined.origin, surface.moved)
        deviation = np.maximum(trial.deviation, piece_errors(joined, self.surfaces))
        gaps = border_gaps(self.outline, trial.found, self.geometry, self.curves)
        deviation = np.maximum(deviation, gaps)
        kinds = kinds_of(self.outline, trial.found, self.geometry, deviation, moved)
        return Cover(
            joined.faces,
            joined.origin,
            np.maximum(deviation, moved),
            len(trial.cover.quads),
            kinds,
        )

    def add_intervals(self, trial: _Trial, intervals: np.ndarray, shrink: bool) -> None:
        """More intervals where quads are bad; ``shrink``: smaller quads inside faces, too."""
        worst = self._worst
        # a finer mesh may be worse somewhere else: three in a row may not
        if len(worst) > 5 and min(worst[-3:]) > max(SAFE * self.tolerance, 0.9 * min(worst[:-3])):
            raise self.failed("and finer quads come no nearer")
        cover = trial.cover
        bad = np.unique(cover.face[trial.factor > 1.0])
        self.words = f"{len(cover.quads)} quads, smaller ones on {len(bad)} faces"
        logger.info("bad quads on %s", ", ".join(_names(bad[:12])))
        more = more_intervals(cover, self.outline, intervals, trial.factor, trial.bent)
        self._fewest = np.maximum(self._fewest, more)
        if shrink:
            self.size *= 0.75


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
