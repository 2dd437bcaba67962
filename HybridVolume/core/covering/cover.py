# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A body of any faces becomes a closed surface of four-sided patches.

Edges get intervals, faces quads, quads bicubic patches through points of the CAD faces. What is
folded, or too far from the CAD face, gets more intervals, and all is made again.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ...errors import HybridVolumeError, InputError, SingularSurfaceError
from ..assembly import build_surface
from ..bezier import bernstein
from ..check import check_surface
from ..merged_quads import merged_faces
from ..quad_layout import quad_layout
from ..surface import SplineFace
from .geometry import SplineCurve, project
from .intervals import assign_intervals, lower_bounds
from .lattice import bicubic_nets
from .outline import Outline
from .pillows import corner_angles, pillow_flat_corners
from .quad_mesh import QuadCover, quad_cover
from .relaxing import relaxed

logger = logging.getLogger(__name__)

ROUNDS = 7
"""So often more intervals are tried."""
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
    """

    faces: tuple[SplineFace, ...]
    origin: np.ndarray
    deviation: np.ndarray
    quads: int


def cover_body(
    brep: Path,
    outline: Outline,
    curves: Sequence[SplineCurve | None],
    surfaces: Sequence[SplineFace],
    tolerance: float,
    *,
    turn: float = 60.0,
    share: float = 5.0,
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

    Raises
    ------
    InputError
        No cover without folds, or none within the tolerance, was found; faces are named.
    """
    diagonal = float(np.linalg.norm(np.ptp(outline.vertices, axis=0)))
    size = diagonal / share
    fewest = lower_bounds(outline, np.radians(turn), size)
    failure: HybridVolumeError | None = None
    for number in range(ROUNDS):
        intervals, sides = assign_intervals(outline, fewest)
        cover = quad_cover(brep, outline, intervals, sides, size)
        cover, cut = pillow_flat_corners(cover)
        cover = relaxed(cover, surfaces)
        nets = bicubic_nets(cover, list(curves), list(surfaces))
        deviation = _deviations(cover, nets, surfaces)
        bad = np.flatnonzero(deviation > tolerance)
        if len(bad):
            failure = InputError(
                f"patches miss faces by up to {deviation.max():.2g} mm",
                faces=_names(bad),
                figure=float(deviation.max()),
                remedy="allow a larger deviation, or simplify these faces in the CAD program",
            )
        slivers = np.flatnonzero(corner_angles(cover.points[cover.quads]).min(axis=1) < SLIVER)
        if len(slivers):
            bad = np.union1d(bad, cover.face[slivers])
            failure = InputError(
                f"{len(slivers)} quads are slivers",
                faces=_names(np.unique(cover.face[slivers])),
                figure=float(len(slivers)),
                remedy="merge narrow faces with their neighbours in the CAD program",
            )
        if not len(bad):
            faces, origin = _patches(cover, nets, diagonal)
            try:
                check_surface(build_surface(faces))
            except SingularSurfaceError as error:
                failure = error
                edges = _edges_near(cover, error)
            else:
                logger.info(
                    "%d quads (%d cut at flat corners) in %d patches, %d rounds",
                    len(cover.quads), len(cut), len(faces), number + 1,
                )  # fmt: skip
                return Cover(tuple(faces), origin, deviation, len(cover.quads))
        if len(bad):
            edges = np.unique(outline.edge[np.isin(outline.face, bad)])
        words = ", ".join(_names(np.unique(outline.face[np.isin(outline.edge, edges)])))
        logger.info("round %d: more intervals on %d edges of %s", number + 1, len(edges), words)
        fewest[edges] = np.ceil(1.5 * intervals[edges] + 0.1).astype(int)
        if number % 2:
            size *= 0.75
    assert failure is not None  # there was a last round, and it was not good
    raise failure


def _names(faces: np.ndarray) -> list[str]:
    return [f"Face{face + 1}" for face in faces.tolist()]


def _patches(
    cover: QuadCover, nets: np.ndarray, diagonal: float
) -> tuple[list[SplineFace], np.ndarray]:
    """Quads joined to patches of many spans, none across an edge of the outline."""
    joined = merged_faces(cover.quads, nets, cover.rim, diagonal)
    origin = np.empty(len(joined), dtype=int)
    origin[quad_layout(cover.quads, cover.rim).patch] = cover.face
    place = np.zeros(len(joined), dtype=int)
    order = np.argsort(origin, kind="stable")
    _, start, count = np.unique(origin[order], return_index=True, return_counts=True)
    place[order] = np.arange(len(joined)) - np.repeat(start, count)
    named = [
        replace(face, name=f"Face{origin[k] + 1}.{place[k] + 1}", exact=False)
        for k, face in enumerate(joined)
    ]
    return named, origin


def _edges_near(cover: QuadCover, error: SingularSurfaceError) -> np.ndarray:
    """Edges of the outline within two quads of the places that an error names."""
    near = cKDTree(cover.points).query([place.point for place in error.places])[1]
    on = np.zeros(len(cover.points), dtype=bool)
    on[near] = True
    rim = np.zeros(0, dtype=int)
    for ring in range(8):
        on[cover.quads[on[cover.quads].any(axis=1)]] = True
        rim = cover.rim_edge[on[cover.rim].all(axis=1)]
        if ring and len(rim):
            break
    return np.unique(rim)


def _deviations(cover: QuadCover, nets: np.ndarray, surfaces: Sequence[SplineFace]) -> np.ndarray:
    """Largest distance of the patches from each face, between the points they go through."""
    table = bernstein(3, np.array([1 / 6, 1 / 2, 5 / 6]))
    samples = np.einsum("ai,bj,mijd->mabd", table, table, nets).reshape(len(nets), -1, 3)
    found = np.zeros(len(surfaces))
    for face in np.unique(cover.face).tolist():
        points = samples[cover.face == face].reshape(-1, 3)
        feet = project(surfaces[face], points)[1]
        found[face] = np.linalg.norm(points - feet, axis=1).max()
    return found
