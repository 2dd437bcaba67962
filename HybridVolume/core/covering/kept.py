# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What of a body's geometry a mesh of quads keeps, and its corners put to where that can be.

Faces that are the whole rectangle of their surface keep its parameters where the corners on
opposite sides can stand at the same ones; planes keep their points between exact edges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..surface import SplineFace
from .geometry import SplineCurve
from .iso_faces import grid_parameters, on_grids
from .iso_sides import IsoSides, agreeing, iso_sides
from .outline import Outline
from .pillows import pillow_flat_corners
from .places import edge_chains, places_on_knots, spread_places, wanted_places
from .quad_mesh import QuadCover
from .relaxing import relaxed
from .rims import Rims, rims_of

SIMPLE = 3
"""Curves of at most this degree, with as many knots inside, are simple."""


@dataclass(frozen=True)
class Geometry:
    """A body's edges and faces as they are to be kept.

    Attributes
    ----------
    curves : tuple of SplineCurve
        Of the edges; the sides of surfaces where such a face is beside them.
    surfaces : tuple of SplineFace
    planar : (nf,) bool array
    iso : dict
        Faces that are the whole rectangle of their surface.
    rank : (nf,) int array
        The higher, the sooner a face gives up its parameters.
    simple : bool
        Edges of planes are exact only where their curves are simple; surfaces keep theirs.
    """

    curves: tuple[SplineCurve | None, ...]
    surfaces: tuple[SplineFace, ...]
    planar: np.ndarray
    iso: Mapping[int, IsoSides]
    rank: np.ndarray
    simple: bool = False

    @classmethod
    def of(
        cls,
        outline: Outline,
        curves: Sequence[SplineCurve | None],
        surfaces: Sequence[SplineFace],
        tolerance: float,
    ) -> Geometry:
        """Look at a body's edges and faces.

        Parameters
        ----------
        outline : Outline
        curves, surfaces : sequences
            Of its edges and faces.
        tolerance : float
            What an edge may be moved by at most, mm.
        """
        planar = np.array([is_planar(face) for face in surfaces])
        converted = np.array([face.exact for face in surfaces])
        # a converted plane stays a plane with any parameters
        rank = converted + 1 * (converted & planar)
        found = iso_sides(outline, curves, surfaces, tolerance)
        iso, own = agreeing(found, outline, curves, rank)
        return cls(tuple(own), tuple(surfaces), planar, iso, rank)

    @property
    def strict(self) -> dict[int, IsoSides]:
        """Faces that are inexact without their parameters."""
        return {face: around for face, around in self.iso.items() if self.rank[face] < 2}


@dataclass(frozen=True)
class Kept:
    """A mesh of quads and what is kept on it.

    Attributes
    ----------
    cover : QuadCover
    grids : dict
        Corners and parameters of faces that are pieces of their surfaces.
    rims : Rims
    """

    cover: QuadCover
    grids: dict[int, tuple[np.ndarray, np.ndarray]]
    rims: Rims


def kept(cover: QuadCover, outline: Outline, geometry: Geometry) -> Kept:
    """Put the corners of quads to where faces and edges can be kept.

    Parameters
    ----------
    cover : QuadCover
    outline : Outline
    geometry : Geometry
    """
    curves, surfaces = geometry.curves, geometry.surfaces
    chains = edge_chains(cover, curves)
    counts = {edge: len(chain) - 1 for edge, chain in chains.items()}
    even = {
        edge: wanted_places(curves[edge], cover.points[chain]) for edge, chain in chains.items()
    }
    places, agreed = spread_places(geometry.iso, counts, even, geometry.rank)
    places |= places_on_knots(chains.keys() - places.keys(), curves, cover.points, chains)
    cover = _moved(cover, curves, chains, places)
    cover = pillow_flat_corners(cover, outline, np.isin(cover.face, sorted(agreed)))
    grids = {}
    for face in sorted(agreed):
        shares = _rim_shares(geometry.iso[face], chains, places)
        found = grid_parameters(cover, face, surfaces[face], *shares)
        if found is not None:
            grids[face] = found
    cover = relaxed(on_grids(cover, grids, surfaces), surfaces, np.isin(cover.face, list(grids)))
    wanted = _edges_of(outline, geometry.planar)
    if geometry.simple:
        wanted &= [curve is not None and _is_simple(curve) for curve in curves]
    while True:
        own = np.isin(np.arange(len(surfaces)), list(grids))
        needed = _edges_of(outline, own) + 1 * _edges_of(outline, own & ~geometry.planar)
        rims, torn = rims_of(cover, curves, chains, places, wanted, needed, geometry.simple)
        if not torn:
            return Kept(cover, grids, rims)
        beside = np.unique(outline.face[np.isin(outline.edge, torn)]).tolist()
        # a plane stays one without its parameters
        del grids[max(
            (face for face in beside if face in grids),
            key=lambda face: (geometry.planar[face], geometry.rank[face], face),
        )]  # fmt: skip


def _is_simple(curve: SplineCurve) -> bool:
    """Whether all patches of a strip can do with a curve's degree and knots."""
    return curve.degree <= SIMPLE and len(np.unique(curve.knots)) <= SIMPLE + 2


def _edges_of(outline: Outline, faces: np.ndarray) -> np.ndarray:
    found = np.zeros(len(outline.edges), dtype=bool)
    found[outline.edge[faces[outline.face]]] = True
    return found


def _moved(
    cover: QuadCover,
    curves: Sequence[SplineCurve | None],
    chains: Mapping[int, np.ndarray],
    places: Mapping[int, np.ndarray],
) -> QuadCover:
    """Corners on edges, ends included, at the given shares of the curves' ranges."""
    points = cover.points.copy()
    # vertices too: those of edges that are nobody's side follow the ones that are
    for edge in sorted(chains, key=lambda edge: edge in places):
        curve, chain = curves[edge], chains[edge]
        points[chain[[0, -1]]] = curve.control_points[[0, -1]]
        if edge in places:
            low, high = curve.knots[0], curve.knots[-1]
            inner = low + places[edge][1:-1] * (high - low)
            points[chain[1:-1]] = curve.evaluate(inner)
    return replace(cover, points=points)


def _rim_shares(
    around: IsoSides, chains: Mapping[int, np.ndarray], places: Mapping[int, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Corners on the sides of a face, and their shares of the surface's ranges, (k, 2)."""
    corners, shares = [], []
    for edge, side, (p, q) in zip(
        around.edge.tolist(), around.side.tolist(), around.ends.tolist(), strict=True
    ):
        axis, at = side // 2, float(side % 2)
        share = np.empty((len(chains[edge]), 2))
        share[:, axis], share[:, 1 - axis] = at, p + (q - p) * places[edge]
        corners.append(chains[edge])
        shares.append(share)
    found, first = np.unique(np.concatenate(corners), return_index=True)
    return found, np.concatenate(shares)[first]


def is_planar(face: SplineFace) -> bool:
    """Whether a face is in a plane, as far as can be told."""
    points = face.control_points.reshape(-1, 3)
    away = points - points.mean(axis=0)
    return bool(np.linalg.svd(away, compute_uv=False)[2] <= 1e-12 * np.abs(away).max() * len(away))
