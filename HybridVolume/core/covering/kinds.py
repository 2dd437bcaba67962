# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What became of the faces of a covered body: kept bit for bit, exact, or within a tolerance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import bspline
from ..surface import SplineFace
from .coons import Nets, side_numbers
from .geometry import SplineCurve, evaluate, project
from .iso_sides import SAME
from .kept import Geometry, Kept
from .outline import Outline
from .patches import Joined

BIT, EXACT, TOLERANCE = KINDS = ("bit", "exact", "tolerance")
"""Own B-spline surface with its own parameters, as it is or cut along its parameter lines; the same
points but for rounding; anything else."""

ROUNDING = 1e-12
"""Largest distance of points that are the same, as a share of the diagonal."""

CONFUSION = 1e-7
"""Curves that are nearer to each other, mm, are the same for modelling kernels."""

_ALONG = 65
"""Places on an edge at which its curves are compared."""

_AT = np.array([0.0, 1.0, 3.0, 5.0, 6.0]) / 6.0


def deviations(
    found: Kept, nets: Sequence[Nets], geometry: Geometry, curves: Sequence[SplineCurve | None]
) -> np.ndarray:
    """Largest distance of the patch of each quad from its face and edges, at samples.

    The samples are between the points that the patches go through. Pieces of surfaces are left
    out, see :func:`piece_errors`.

    Parameters
    ----------
    found : Kept
    nets : sequence of Nets
        Patches of all quads.
    geometry : Geometry
    curves : sequence of SplineCurve
        Of the edges as they were given.

    Returns
    -------
    (m,) array
        mm
    """
    cover = found.cover
    samples = np.empty((len(cover.quads), 5, 5, 3))
    for group in nets:
        samples[group.quads] = group.at(_AT)
    inner = samples[:, 1:4, 1:4].reshape(-1, 9, 3)
    sides = np.stack(
        [samples[:, 1:4, 0], samples[:, 4, 1:4], samples[:, 1:4, 4], samples[:, 0, 1:4]], axis=1
    )
    number, _ = side_numbers(cover)
    loose = (number >= 0) & ~found.rims.exact[number]
    loose[np.isin(cover.face, list(found.grids))] = False
    off = np.zeros(len(cover.quads))
    edges = cover.rim_edge[number]
    for edge in np.unique(edges[loose]).tolist():
        quads, side = np.nonzero(loose & (edges == edge))
        points = sides[quads, side]
        feet = curves[edge].evaluate(curves[edge].project(points.reshape(-1, 3)))
        away = np.linalg.norm(points - feet.reshape(points.shape), axis=2).max(axis=1)
        np.maximum.at(off, quads, away)
    for face in np.unique(cover.face).tolist():
        if face in found.grids:
            continue
        own = np.flatnonzero(cover.face == face)
        away = _distances(geometry, face, inner[own].reshape(-1, 3)).reshape(-1, 9)
        off[own] = np.maximum(off[own], away.max(axis=1))
        rows, side = np.nonzero(number[own] >= 0)
        away = _distances(geometry, face, sides[own[rows], side].reshape(-1, 3)).reshape(-1, 3)
        np.maximum.at(off, own[rows], away.max(axis=1, initial=0.0))
    return off


def _distances(geometry: Geometry, face: int, points: np.ndarray) -> np.ndarray:
    surface = geometry.surfaces[face]
    if not geometry.planar[face]:
        return np.linalg.norm(points - project(surface, points)[1], axis=1)
    plane = surface.control_points.reshape(-1, 3)
    centre = plane.mean(axis=0)
    normal = np.linalg.svd(plane - centre)[2][2]
    return np.abs((points - centre) @ normal)


def piece_errors(joined: Joined, surfaces: Sequence[SplineFace]) -> np.ndarray:
    """Largest distance of pieces of surfaces from these at equal parameters, mm, (nf,).

    Parameters
    ----------
    joined : Joined
    surfaces : sequence of SplineFace
    """
    found = np.zeros(len(surfaces))
    for patch, corners in joined.places.items():
        face, number = joined.faces[patch], int(joined.origin[patch])
        x, y = (_samples(knots) for knots in face.knots)
        s, t = (
            (line - knots[0]) / (knots[-1] - knots[0])
            for line, knots in zip((x, y), face.knots, strict=True)
        )
        first, along, _, across = corners
        uv = first + s[:, None, None] * (along - first) + t[:, None] * (across - first)
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        off = evaluate(face, grid)[0] - evaluate(surfaces[number], uv.reshape(-1, 2))[0]
        found[number] = max(found[number], float(np.linalg.norm(off, axis=1).max()))
    return found


def border_gaps(
    outline: Outline, found: Kept, geometry: Geometry, curves: Sequence[SplineCurve | None]
) -> np.ndarray:
    """How far the borders of faces are from the edges as the file gives them, mm, (nf,).

    Where a face keeps its parameters, its surface's own sides are the curves of the edges, for the
    faces beside it too; the file's curves may miss them by as much as it allows. Faces that are
    pieces of their surfaces are left out: their borders are where the surface ends. So are gaps
    that are none for modelling kernels.

    Parameters
    ----------
    outline : Outline
    found : Kept
    geometry : Geometry
    curves : sequence of SplineCurve
        Of the edges as they were given.
    """
    gap = np.zeros(len(curves))
    share = np.linspace(0.0, 1.0, _ALONG)
    for edge, (own, given) in enumerate(zip(geometry.curves, curves, strict=True)):
        if own is None or own is given:
            continue
        points = own.evaluate(own.knots[0] + share * (own.knots[-1] - own.knots[0]))
        feet = given.evaluate(given.project(points))
        gap[edge] = np.linalg.norm(points - feet, axis=1).max()
    diagonal = float(np.linalg.norm(np.ptp(outline.vertices, axis=0)))
    gap[gap <= min(CONFUSION, 1e-8 * diagonal)] = 0.0
    gaps = np.zeros(len(geometry.surfaces))
    np.maximum.at(gaps, outline.face, gap[outline.edge])
    gaps[list(found.grids)] = 0.0
    return gaps


def _samples(knots: np.ndarray) -> np.ndarray:
    """Three places a span."""
    lines = bspline.breakpoints(knots)
    return (lines[:-1, None] + np.diff(lines)[:, None] * np.array([0.1, 0.5, 0.9])).ravel()


def kinds_of(
    outline: Outline,
    found: Kept,
    geometry: Geometry,
    deviation: np.ndarray,
    moved: np.ndarray,
) -> tuple[str, ...]:
    """Kind of every face of an outline.

    Parameters
    ----------
    outline : Outline
    found : Kept
    geometry : Geometry
    deviation : (nf,) array
        Measured distances, mm; nothing that is farther away than rounding is called exact.
    moved : (nf,) array
        What the sides were moved by where the file's faces do not agree themselves, mm; at most a
        share of 1e-9 of the diagonal, as in bodies without other faces.

    Returns
    -------
    tuple of str
        ``bit``, ``exact`` or ``tolerance``.
    """
    reach = float(np.abs(outline.vertices).max())
    diagonal = float(np.linalg.norm(np.ptp(outline.vertices, axis=0)))
    # coordinates far from the origin are rounded more coarsely than a small body is exact
    rounding = 8.0 * np.finfo(float).eps * reach
    near = (deviation <= ROUNDING * diagonal + rounding) & (moved <= SAME * diagonal + rounding)
    kinds = []
    for face, surface in enumerate(geometry.surfaces):
        grid = face in found.grids
        if not near[face] or not (grid or geometry.planar[face]):
            kinds.append(TOLERANCE)
        else:
            kinds.append(BIT if grid and not surface.exact else EXACT)
    return tuple(kinds)


def kinds_of_origins(kinds: Sequence[str], origin: np.ndarray) -> tuple[str, ...]:
    """Kinds of faces that were cut into pieces: those of their worst pieces.

    Parameters
    ----------
    kinds : sequence of str
        Of the pieces.
    origin : (n,) int array
        Face that each is a piece of.
    """
    worst = np.zeros(int(origin.max()) + 1, dtype=int)
    np.maximum.at(worst, origin, [KINDS.index(kind) for kind in kinds])
    return tuple(KINDS[k] for k in worst.tolist())
