# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One conforming mesh of quads over the whole boundary of a body.

Edges are cut first, and never by a mesher. Four-sided faces get regular grids between these points;
Gmsh or Netgen mesh the others, and of a face that one of them cannot do well the other's quads are
taken: all fit together, as their points on edges are the same. Every triangle and quad is cut at
the middles of its sides, so that only quads are left.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...errors import FaultError, InputError, MesherError, SetupError
from ..surface import SplineFace
from ..tetmesh.door import available_engines
from .edge_points import EdgePoints, edge_points
from .face_checks import check_cover
from .face_quads import FaceQuads, faces_of_answer, grid_of_face
from .geometry import SplineCurve
from .mesh_runs import run_mesher
from .mesher import ADAPTERS, Request
from .outline import Outline

logger = logging.getLogger(__name__)

GOOD = 0.1
"""Another mesher is asked where the sine of a corner is below this."""
GRID_GOOD = 0.03
"""Four-sided faces whose grid is worse get quads of a mesher."""
SECONDS = 60.0
"""Longest time of a mesher."""


class UnmeshedError(InputError):
    """No mesher can mesh some faces; ``missing`` are their numbers, which are not handed on."""

    code = "unmeshed"
    missing: Sequence[int] = ()


@dataclass(frozen=True)
class QuadCover:
    """Quads over all faces of a body.

    Attributes
    ----------
    points : (n, 3) array
        Corners of quads, mm; on the faces.
    quads : (m, 4) int array
        Corners, counterclockwise seen from outside.
    face : (m,) int array
        Face of the outline.
    rim : (k, 2) int array
        Sides of quads that lie on edges of the outline, smaller corner first, sorted.
    rim_edge : (k,) int array
        These edges.
    """

    points: np.ndarray
    quads: np.ndarray
    face: np.ndarray
    rim: np.ndarray
    rim_edge: np.ndarray


@dataclass(frozen=True)
class Way:
    """One way to mesh faces: the mesher, its algorithm, quads or triangles first."""

    engine: str
    algorithm: int = 0
    quads: bool = True


WAYS = (
    Way("gmsh", 6),  # frontal Delaunay
    Way("netgen"),
    Way("gmsh", 1),  # adapts a mesh to the curved face: slower, sturdy
    Way("netgen", quads=False),
    Way("gmsh", 5, quads=False),
)
"""In this order; ways after the first two only for faces that nobody has meshed yet."""


@dataclass
class Meshers:
    """The meshers that may be used for a body, and what became of them.

    Attributes
    ----------
    ways : list of Way
        Those that crashed or did not end come last.
    seconds : float
        Longest time of each.
    reasons : list of str
        Why they failed.
    """

    ways: list[Way] = field(default_factory=list)
    seconds: float = SECONDS
    reasons: list[str] = field(default_factory=list)

    @classmethod
    def available(
        cls, first: str = "", *, free: bool | None = None, seconds: float = SECONDS
    ) -> Meshers:
        """All that are installed.

        Parameters
        ----------
        first : str
            The one that is asked first, if it is there.
        free : bool, optional
            Nothing under the GPL; by default as the environment says.
        seconds : float
            Longest time of each.

        Raises
        ------
        SetupError
            There are none.
        """
        engines = [name for name in available_engines(free=free) if name in ADAPTERS]
        if not engines:
            raise SetupError(
                "no mesher of faces is installed or allowed",
                remedy="make the environment again, or install netgen-mesher",
            )
        ways = [way for way in WAYS if way.engine in engines]
        return cls(sorted(ways, key=lambda way: way.engine != first), seconds)

    def failed(self, way: Way, error: MesherError) -> None:
        """Keep why a way failed; it is the last that is tried from now on."""
        logger.info("%s", error.message)
        self.reasons.append(error.message)
        self.ways.remove(way)
        self.ways.append(way)


def quad_cover(
    brep: Path,
    outline: Outline,
    intervals: np.ndarray,
    sides: dict[int, list[np.ndarray]],
    size: float,
    curves: Sequence[SplineCurve | None],
    surfaces: Sequence[SplineFace],
    planar: np.ndarray,
    meshers: Meshers | None = None,
) -> QuadCover:
    """Mesh a body with quads.

    Parameters
    ----------
    brep : Path
        The solid that the outline is of.
    outline : Outline
    intervals : (ne,) int array
        Parts of each edge before every element is cut at its middles.
    sides : dict
        Edges of the sides of the faces that get regular grids.
    size : float
        Largest edge inside the other faces, mm.
    curves, surfaces : sequences
        Of its edges and faces.
    planar : (nf,) bool array
        Faces in a plane.
    meshers : Meshers, optional
        All that are installed by default.

    Raises
    ------
    UnmeshedError
        No mesher does all faces; they are named, and what the meshers said is in the message.
    FaultError
        The quads do not close the body.
    SetupError
        There is no mesher.
    """
    rims = edge_points(outline, curves, intervals)
    done: dict[int, FaceQuads] = {}
    for face, found in sides.items():
        grid = grid_of_face(face, found, outline, rims, surfaces[face], bool(planar[face]))
        if grid is not None:
            done[face] = grid
    bad = [
        face
        for face in range(outline.face_count)
        if face not in done or done[face].worst < GRID_GOOD
    ]
    if bad:
        meshers = meshers or Meshers.available()
        used = np.unique(outline.edge)
        request = _request(brep, outline, intervals, rims, size, used)
        _mesh(request, bad, done, meshers, (outline, rims, surfaces, planar))
        missing = [face for face in bad if face not in done]
        if missing:
            words = "; ".join(dict.fromkeys(meshers.reasons[-len(WAYS) :]))
            error = UnmeshedError(
                "no mesher can mesh these faces" + (f" ({words})" if words else ""),
                faces=[f"Face{face + 1}" for face in missing],
                figure=float(len(missing)),
                remedy="merge narrow faces with their neighbours, or split faces that close upon"
                " themselves, in the CAD program",
            )
            error.missing = missing
            raise error
    return _joined(done, outline, intervals, rims)


def _request(
    brep: Path,
    outline: Outline,
    intervals: np.ndarray,
    rims: EdgePoints,
    size: float,
    used: np.ndarray,
) -> Request:
    there = np.zeros(len(intervals), dtype=int)
    there[used] = intervals[used] + 1
    first = np.concatenate([[0], np.cumsum(there)])
    points = [rims.points[rims.along(edge)[::2]] for edge in used.tolist()]
    return Request(
        str(brep),
        np.zeros(0, dtype=int),
        outline.face,
        outline.edge,
        intervals,
        first,
        np.concatenate(points),
        outline.middle,
        outline.vertices[outline.edges].sum(axis=1),
        size,
        True,
        0,
    )


def _mesh(
    request: Request, bad: list[int], done: dict[int, FaceQuads], meshers: Meshers, geometry: tuple
) -> None:
    """Put quads on faces: of each the best that the meshers give."""
    for number, way in enumerate(tuple(meshers.ways)):
        # a poor face is given to one other mesher, a face without any quads to all
        limit = GOOD if number < 2 else -np.inf
        wanted = [face for face in bad if face not in done or done[face].worst < limit]
        if not wanted:
            return
        asked = replace(request, faces=np.array(wanted), quads=way.quads, algorithm=way.algorithm)
        try:
            answer = run_mesher(way.engine, asked, meshers.seconds)
        except MesherError as error:
            meshers.failed(way, error)
            continue
        found = faces_of_answer(answer, *geometry)
        lost = set(wanted) - set(found)
        if lost:
            logger.info("%s meshes %d of %d faces", way.engine, len(found), len(wanted))
        for face, quads in found.items():
            if face not in done or quads.worst > done[face].worst:
                done[face] = quads


def _joined(
    done: dict[int, FaceQuads], outline: Outline, intervals: np.ndarray, rims: EdgePoints
) -> QuadCover:
    """All faces in one mesh, checked."""
    base = len(rims.points)
    quads, face, points = [], [], [rims.points]
    count = base
    for number in sorted(done):
        own = done[number]
        quads.append(np.where(own.quads >= base, own.quads - base + count, own.quads))
        face.append(np.full(len(own.quads), number))
        points.append(own.points)
        count += len(own.points)
    corners, inverse = np.unique(np.concatenate(quads), return_inverse=True)
    lines, rim_edge = rims.segments
    place = np.searchsorted(corners, lines)
    if np.any(corners[np.minimum(place, len(corners) - 1)] != lines):
        raise FaultError("points of edges are in no quad", remedy="please report this body")
    rim = np.sort(place, axis=1)
    order = np.lexsort(rim.T[::-1])
    cover = QuadCover(
        np.concatenate(points)[corners],
        inverse.reshape(-1, 4),
        np.concatenate(face),
        rim[order],
        rim_edge[order],
    )
    check_cover(cover.quads, cover.face, cover.rim, cover.rim_edge, outline, 2 * intervals)
    return cover
