# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The tetrahedra on which the harmonic function lives: surface outside, midstructure inside."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np
from scipy.spatial import cKDTree

from ..errors import FaultError, HybridVolumeError, MesherError
from .adaptive_triangulation import (
    AdaptiveTriangles,
    adaptive_triangulation,
    from_grid,
    split_triangles,
)
from .intersection import self_intersections
from .midstructure import Midstructure
from .midstructure.given import spread
from .midstructure.pieces import in_pieces
from .midstructure.resample import Complex, resample
from .surface import PatchSurface
from .tetmesh import CONFORMING, TetMesh, available_engines, fill
from .tetmesh.carve import carve
from .tetmesh.split import refine, separate_boundary

log = logging.getLogger(__name__)

# Radius of the balls where w = 1 around lines and points of the midstructure, in local radii.
BALL = 0.3


@dataclass(frozen=True)
class Domain:
    """Tetrahedra and the vertices of the midstructure.

    Attributes
    ----------
    mesh : TetMesh
        No tetrahedron has all four vertices on the boundary.
    inner : (n,) bool array
        Vertices where w = 1.
    embedded : bool
        Whether the midstructure's facets are faces of the tetrahedra.
    """

    mesh: TetMesh
    inner: np.ndarray
    embedded: bool


def build_domain(
    surface: PatchSurface,
    midstructure: Midstructure,
    *,
    tets: int = 40_000,
    engine: str = "auto",
    free: bool | None = None,
    time_limit: float = 15.0,
) -> Domain:
    """Tetrahedra of the triangulated surface with the kept facets inside (section 3.1).

    Parameters
    ----------
    surface : PatchSurface
    midstructure : Midstructure
    tets : int
        Aimed at.
    engine, free, time_limit
        As for :func:`HybridVolume.core.tetmesh.fill`.
    """
    _check_kept(midstructure)
    coarse = surface.triangulation(4)
    midstructure = in_pieces(midstructure, (coarse.vertices, coarse.triangles))
    engines = [engine]
    if engine == "auto":
        engines = [name for name in available_engines(free=free) if name in CONFORMING]
    # netgen's time goes with the number of triangles; the tetrahedra are refined afterwards
    size = _Size.fitted(surface, midstructure, tets if "gmsh" in engines else tets // 2)
    options = {"free": free, "time_limit": time_limit}
    prepared: list[tuple[AdaptiveTriangles, Complex]] = []
    quick = True
    if engine != "pytetwild":
        source = _boundaries(surface, size, tets // 4)
        for name, (boundary, complex_) in _attempts(
            engines,
            source,
            prepared,
            lambda outer: resample(midstructure, size.on_midstructure, outer),
        ):
            facets = complex_.triangles + len(boundary.vertices)
            vertices = np.vstack([boundary.vertices, complex_.vertices])
            given = {"facets": facets, "engine": name, "optimise": False, **options}
            started = time.perf_counter()
            try:
                mesh = fill(vertices, boundary.triangles, **given)
            except MesherError as error:
                log.info("the facets of the midstructure were refused: %s", error)
                quick &= time.perf_counter() - started < 0.5 * time_limit
                continue
            return _finish(mesh, facets, complex_, size.middle, tets, True)
    if prepared:
        boundary, engine = prepared[0][0], engine if quick and engines else "none"
    else:
        log.info("the triangulated surface cuts itself: pytetwild, midstructure by distance")
        boundary = adaptive_triangulation(surface, size.on_surface, max_triangles=tets // 2)
        engine = "pytetwild"
    return _by_distance(surface, boundary, midstructure, tets, engine, options)


def domain_within(
    outer: tuple[np.ndarray, np.ndarray],
    surface: PatchSurface,
    midstructure: Midstructure,
    *,
    tets: int = 40_000,
    free: bool | None = None,
    time_limit: float = 15.0,
) -> Domain:
    """Tetrahedra inside triangles that are given, such as a control net, with the kept facets.

    Parameters
    ----------
    outer : (vertices (n, 3), triangles (t, 3))
        Closed, oriented outward, free of crossings; mm.
    surface : PatchSurface
        Sizes go by it.
    midstructure : Midstructure
    tets : int
        Aimed at.
    free, time_limit
        As for :func:`HybridVolume.core.tetmesh.fill`.

    Raises
    ------
    MesherError
        No mesher could fill the triangles and keep the facets.
    FaultError
        No facet of the midstructure is kept.
    """
    _check_kept(midstructure)
    midstructure = in_pieces(midstructure, outer)
    engines = [name for name in available_engines(free=free) if name in CONFORMING]
    size = _Size.fitted(surface, midstructure, tets if "gmsh" in engines else tets // 2)
    complex_ = resample(midstructure, size.on_midstructure, outer)
    facets = complex_.triangles + len(outer[0])
    mesh = fill(
        np.vstack([outer[0], complex_.vertices]),
        outer[1],
        facets=facets,
        optimise=False,
        free=free,
        time_limit=time_limit,
    )
    return _finish(mesh, facets, complex_, size.middle, tets, True)


def _check_kept(midstructure: Midstructure) -> None:
    if not midstructure.kept.any():
        raise FaultError("no facet of the midstructure is kept", remedy="keep at least one sheet")


def _attempts(
    engines: Sequence[str],
    source: Iterator[AdaptiveTriangles],
    prepared: list[tuple[AdaptiveTriangles, Complex]],
    embed: Callable[[tuple[np.ndarray, np.ndarray]], Complex],
) -> Iterator[tuple[str, tuple[AdaptiveTriangles, Complex]]]:
    """Every mesher with every triangulation, which are made when they are asked for."""
    for name in engines or ["none"]:
        for k in count():
            if k == len(prepared):
                boundary = next(source, None)
                if boundary is None:
                    break
                prepared.append((boundary, embed((boundary.vertices, boundary.triangles))))
            if name != "none":
                yield name, prepared[k]
            elif k == 0:
                break


@dataclass(frozen=True)
class _Size:
    """Edge lengths in proportion to the distance between surface and midstructure.

    Attributes
    ----------
    middle : cKDTree
        Vertices of the midstructure.
    share : float
        Edge length in units of that distance.
    smallest, largest : float
        mm.
    on_sheets : float
        Edge length on the midstructure in units of the distance to the surface.
    """

    middle: cKDTree
    share: float
    smallest: float
    largest: float
    on_sheets: float

    @classmethod
    def fitted(cls, surface: PatchSurface, midstructure: Midstructure, tets: int) -> _Size:
        """Sizes that give about so many tetrahedra, for a midstructure in pieces."""
        middle = cKDTree(midstructure.vertices)
        coarse = surface.triangulation(2)
        x = coarse.vertices[coarse.triangles]
        area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
        distance, _ = middle.query(x.mean(axis=1))
        # a regular tetrahedron of edge h has the volume h³ / 8.5
        largest = (8.5 * surface.volume() / tets) ** (1.0 / 3.0)
        share = 0.4
        for _ in range(40):
            if (area / np.minimum(share * distance, largest) ** 2).sum() < 0.1 * tets:
                break
            share *= 1.1
        on_sheets = 0.68 * share * (40_000 / tets) ** (1.0 / 3.0)
        # a midstructure may come down to the surface
        smallest = max(0.5 * share * float(distance.min()), 0.02 * largest)
        return cls(middle, share, min(smallest, largest), largest, on_sheets)

    def on_surface(self, points: np.ndarray) -> np.ndarray:
        """Wanted edge lengths, mm, at (k, 3) points of the surface."""
        distance = self.middle.query(points)[0]
        return np.clip(self.share * distance, self.smallest, self.largest)

    def on_midstructure(self, radius: np.ndarray) -> np.ndarray:
        """Wanted edge lengths, mm, where the surface is ``radius`` away."""
        return np.clip(self.on_sheets * radius, self.smallest, self.largest)


def _boundaries(surface: PatchSurface, size: _Size, budget: int) -> Iterator[AdaptiveTriangles]:
    """Triangulations of the surface that do not cut themselves.

    Coarse triangles may cut each other where the surface does not: there they are split. An even
    grid is the other way, good for parametrisations that nearly fold.
    """
    mesh = adaptive_triangulation(surface, size.on_surface, max_triangles=budget)
    for _ in range(10):
        pairs = self_intersections(mesh.vertices, mesh.triangles)
        if not len(pairs):
            yield mesh
            break
        log.info("%d pairs of %d triangles cross", len(pairs), len(mesh.triangles))
        if len(pairs) > 0.1 * len(mesh.triangles) or len(mesh.triangles) > 4 * budget:
            break
        mesh = split_triangles(surface, mesh, np.unique(pairs))
    spans = surface.element_count
    even = max(2, round((budget / 4 / spans) ** 0.5))
    for cells in dict.fromkeys((even, 2 * even, 3, 2)):
        if 2 * spans * cells**2 > 4 * budget and cells > 2:
            continue
        grid = surface.triangulation(cells)
        if not len(self_intersections(grid.vertices, grid.triangles)):
            yield from_grid(grid)
            break


def _by_distance(
    surface: PatchSurface,
    boundary: AdaptiveTriangles,
    midstructure: Midstructure,
    tets: int,
    engine: str,
    options: dict,
) -> Domain:
    """The domain without facets: w = 1 within a share of the radius around the kept vertices.

    ``engine`` may be ``"none"``: the tetrahedra are carved out of a Delaunay triangulation.
    """
    points, radius = midstructure.vertices, midstructure.radius
    pick = spread(points, BALL * radius)
    rest = Complex(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), points[pick], radius[pick])
    mesh = None
    if engine != "none":
        # an envelope mesher is some ten times as slow
        patience = options["time_limit"] * (4.0 if engine == "pytetwild" else 1.0)
        options = {**options, "time_limit": patience, "engine": engine, "optimise": False}
        try:
            mesh = fill(boundary.vertices, boundary.triangles, **options)
        except HybridVolumeError as error:
            log.info("%s", error)
    if mesh is None:
        mesh = _carved(surface, boundary, points[pick])
    return _finish(mesh, rest.triangles, rest, cKDTree(points), tets, False)


def _carved(surface: PatchSurface, boundary: AdaptiveTriangles, inner: np.ndarray) -> TetMesh:
    """Delaunay tetrahedra of the surface's vertices; triangles that they miss are split."""
    mesh, missing = carve(boundary.vertices, boundary.triangles, inner)
    for _ in range(4):
        if len(missing) < 0.005 * len(boundary.triangles):
            break
        boundary = split_triangles(surface, boundary, missing)
        mesh, missing = carve(boundary.vertices, boundary.triangles, inner)
    log.info("carved out of the Delaunay tetrahedra: %d, %d faces missed", len(mesh), len(missing))
    return mesh


def _finish(
    mesh: TetMesh,
    facets: np.ndarray,
    complex_: Complex,
    middle: cKDTree,
    tets: int,
    embedded: bool,
) -> Domain:
    """Refine where the midstructure is a line or a point, separate boundary and midstructure."""
    rest, radius = complex_.rest, BALL * complex_.rest_radius
    if len(rest):
        tree = cKDTree(rest)

        def size(points: np.ndarray) -> np.ndarray:
            distance, nearest = tree.query(points)
            return np.maximum(0.8 * radius[nearest], 0.8 * (distance - radius[nearest]))

        mesh, facets = refine(mesh, size, facets, max_tets=max(2 * tets, len(mesh)))
    mesh, facets = separate_boundary(mesh, facets)
    mesh, facets = _filled_up(mesh, facets, middle, tets)
    inner = _inner(mesh, facets, rest, radius)
    if not inner.any():
        raise FaultError("no vertex of the tetrahedra belongs to the midstructure")
    return Domain(mesh, inner, embedded)


def _filled_up(
    mesh: TetMesh, facets: np.ndarray, middle: cKDTree, tets: int
) -> tuple[TetMesh, np.ndarray]:
    """Refine a coarse mesh to about so many tetrahedra, evenly in units of the local thickness."""
    if len(mesh) > 0.8 * tets:
        return mesh, facets
    outer = cKDTree(mesh.vertices[mesh.on_boundary])
    largest = 2.0 * (8.5 * mesh.volume / tets) ** (1.0 / 3.0)

    def thickness(points: np.ndarray) -> np.ndarray:
        return np.minimum(outer.query(points)[0] + middle.query(points)[0], 4.0 * largest)

    local = thickness(mesh.vertices[mesh.tets].mean(axis=1))
    need = float((mesh.volumes / local**3).sum())
    share = (8.5 * need / tets) ** (1.0 / 3.0)
    return refine(mesh, lambda points: share * thickness(points), facets, max_tets=tets)


def _inner(mesh: TetMesh, facets: np.ndarray, rest: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Vertices of the facets, and those within the balls around the rest."""
    inner = np.zeros(len(mesh.vertices), dtype=bool)
    inner[facets] = True
    if len(rest):
        free = np.flatnonzero(~mesh.on_boundary)
        distance, nearest = cKDTree(rest).query(mesh.vertices[free])
        inner[free[distance <= radius[nearest]]] = True
        # a ball between the vertices takes the nearest one
        far, vertex = cKDTree(mesh.vertices[free]).query(rest)
        empty = (far > radius) & (far < 2.0 * radius)
        inner[free[vertex[empty]]] = True
    return inner & ~mesh.on_boundary
