# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A body of any faces becomes a closed surface of four-sided patches.

Edges get intervals, faces quads, quads bicubic patches through points of the CAD faces. What is
folded, or too far from the CAD face, gets more intervals, and all is made again.
"""

from __future__ import annotations

import logging
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ...errors import HybridVolumeError, InputError, SingularSurfaceError
from ..assembly import build_surface
from ..bezier import bernstein
from ..check import check_surface
from ..surface import SplineFace
from .coons import homogeneous_nets
from .geometry import SplineCurve, project
from .intervals import assign_intervals, lower_bounds
from .iso_faces import curves_of_sides, grid_parameters, on_grids, rectangle_faces
from .kinds import kinds_of
from .lattice import bicubic_nets
from .outline import Outline
from .patches import joined_patches
from .pillows import corner_angles, pillow_flat_corners
from .quad_mesh import Meshers, QuadCover, quad_cover
from .relaxing import relaxed
from .rims import Rims, rims_of, spread

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
    planar = np.array([is_planar(face) for face in surfaces])
    meshers = Meshers.available()
    failure: HybridVolumeError | None = None
    for number in range(ROUNDS):
        intervals, sides = assign_intervals(outline, fewest)
        cover = quad_cover(
            brep, outline, intervals, sides, size, curves, surfaces, planar, meshers
        )
        cover, grids, rims, own = _fitted(cover, outline, sides, curves, surfaces, planar)
        bicubic = bicubic_nets(cover, own, surfaces)
        nets = homogeneous_nets(cover, bicubic, rims, planar)
        deviation = _deviations(cover, nets, grids, surfaces)
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
            faces, origin = joined_patches(cover, nets, grids, surfaces)
            try:
                check_surface(build_surface(faces))
            except SingularSurfaceError as error:
                failure = error
                edges = _edges_near(cover, error)
            else:
                logger.info(
                    "%d quads in %d patches, %d rounds", len(cover.quads), len(faces), number + 1
                )
                kinds = kinds_of(outline, grids, rims, cover.rim_edge, planar, surfaces, deviation)
                return Cover(tuple(faces), origin, deviation, len(cover.quads), kinds)
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


def _deviations(
    cover: QuadCover,
    nets: Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]],
    grids: Container[int],
    surfaces: Sequence[SplineFace],
) -> np.ndarray:
    """Largest distance of the patches from each face, between the points they go through."""
    at = np.array([1 / 6, 1 / 2, 5 / 6])
    samples = np.empty((len(cover.quads), 9, 3))
    for (du, dv), (quads, points) in nets.items():
        x = np.einsum("ai,bj,kijd->kabd", bernstein(du, at), bernstein(dv, at), points)
        samples[quads] = (x[..., :3] / x[..., 3:]).reshape(-1, 9, 3)
    found = np.zeros(len(surfaces))
    for face in np.unique(cover.face).tolist():
        if face not in grids:
            points = samples[cover.face == face].reshape(-1, 3)
            feet = project(surfaces[face], points)[1]
            found[face] = np.linalg.norm(points - feet, axis=1).max()
    return found


def _fitted(
    cover: QuadCover,
    outline: Outline,
    sides: dict[int, list[np.ndarray]],
    curves: Sequence[SplineCurve | None],
    surfaces: Sequence[SplineFace],
    planar: np.ndarray,
) -> tuple[QuadCover, dict[int, tuple[np.ndarray, np.ndarray]], Rims, Sequence[SplineCurve | None]]:
    """Corners put to where faces and edges can be kept, and what can be kept.

    Returns
    -------
    cover : QuadCover
    grids : dict
        Corners and parameters of faces that are pieces of their surfaces.
    rims : Rims
    curves : sequence of SplineCurve
        Of edges, with the parameters of the faces that are kept.
    """
    rectangles = rectangle_faces(outline, sides, surfaces)
    curves, rectangles = curves_of_sides(outline, rectangles, curves, surfaces)
    beside = np.zeros(len(outline.edges), dtype=bool)
    beside[outline.edge[rectangles[outline.face]]] = True
    cover = pillow_flat_corners(spread(cover, curves, np.flatnonzero(beside)))
    grids = {}
    for face in np.flatnonzero(rectangles).tolist():
        found = grid_parameters(cover, face, surfaces[face])
        if found is not None:
            grids[face] = found
    kept = planar.copy()
    kept[list(grids)] = True
    wanted = np.zeros(len(outline.edges), dtype=bool)
    wanted[outline.edge[kept[outline.face]]] = True
    cover = relaxed(on_grids(cover, grids, surfaces), surfaces, np.isin(cover.face, list(grids)))
    rims = rims_of(cover, curves, wanted)
    return cover, grids, rims, curves


def is_planar(face: SplineFace) -> bool:
    """Whether a face is in a plane, as far as can be told."""
    points = face.control_points.reshape(-1, 3)
    away = points - points.mean(axis=0)
    return bool(np.linalg.svd(away, compute_uv=False)[2] <= 1e-12 * np.abs(away).max() * len(away))
