# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One conforming mesh of quads over the whole boundary of a body, by Gmsh.

Four-sided faces get regular grids, the others unstructured quads; then every quad is cut in four,
which turns the triangles that are left over into quads. Gmsh crashes on some bodies, so this runs
in a process of its own.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ...errors import InputError
from .outline import Outline

logger = logging.getLogger(__name__)

MATCH = 1e-5
"""Edges are told apart by their ends and middles to this share of the diagonal."""


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


def quad_cover(
    brep: Path,
    outline: Outline,
    intervals: np.ndarray,
    sides: dict[int, list[np.ndarray]],
    size: float,
) -> QuadCover:
    """Mesh a body with quads.

    Parameters
    ----------
    brep : Path
        The solid that the outline is of.
    outline : Outline
    intervals : (ne,) int array
        Parts of each edge before every quad is cut in four.
    sides : dict
        Edges of the sides of the faces that get regular grids.
    size : float
        Largest edge inside the other faces, mm.

    Raises
    ------
    InputError
        Gmsh fails; what it said is in the message.
    """
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.AbortOnError", 0)
        for name, value in (
            ("Mesh.RecombineAll", 1),
            ("Mesh.RecombinationAlgorithm", 1),
            ("Mesh.SubdivisionAlgorithm", 1),
            ("Mesh.MinimumCurveNodes", 3),
            ("Mesh.MeshSizeMax", size),
            ("Mesh.ElementOrder", 1),
        ):
            gmsh.option.setNumber(name, value)
        gmsh.model.occ.importShapes(str(brep))
        gmsh.model.occ.synchronize()
        curve, surface = _tags(gmsh, outline)
        _prescribe(gmsh, outline, intervals, sides, curve, surface)
        gmsh.model.mesh.generate(2)
        return _read(gmsh, curve, surface, outline)
    except Exception as error:
        if isinstance(error, InputError):
            raise
        # gmsh raises plain exceptions
        raise InputError(
            f"Gmsh cannot mesh the faces ({str(error).strip() or type(error).__name__})",
            remedy="simplify the body in the CAD program",
        ) from error
    finally:
        gmsh.finalize()


def _tags(gmsh: object, outline: Outline) -> tuple[np.ndarray, np.ndarray]:
    """Gmsh's numbers of the outline's edges and faces, by ends and middles, and by edges."""
    model = gmsh.model
    tags = [tag for _, tag in model.getEntities(1)]
    middle, ends = [], []
    for tag in tags:
        (first,), (last,) = model.getParametrizationBounds(1, tag)
        at = model.getValue(1, tag, [first, 0.5 * (first + last), last])
        points = np.reshape(at, (3, 3))
        middle.append(points[1])
        ends.append(points[0] + points[2])
    diagonal = float(np.linalg.norm(np.ptp(outline.vertices, axis=0)))
    used = np.unique(outline.edge)
    own = np.hstack([outline.middle, outline.vertices[outline.edges].sum(axis=1)])[used]
    distance, nearest = cKDTree(np.hstack([middle, ends])).query(own)
    if distance.max() > MATCH * diagonal or len(np.unique(nearest)) != len(nearest):
        raise InputError("Gmsh reads other edges than FreeCAD", remedy="export the body again")
    curve = np.zeros(len(outline.edges), dtype=int)
    curve[used] = np.array(tags)[nearest]
    known: dict[frozenset, list[int]] = {}
    regular = set(curve[used].tolist())  # degenerate edges at poles are no edges of the outline
    for _, tag in model.getEntities(2):
        around = model.getBoundary([(2, tag)], combined=False, oriented=False)
        known.setdefault(frozenset(abs(t) for _, t in around) & regular, []).append(tag)
    surface = np.zeros(outline.face_count, dtype=int)
    for face in range(outline.face_count):
        found = known.get(frozenset(curve[outline.edge[outline.face == face]].tolist()))
        if not found:
            raise InputError("Gmsh reads other faces than FreeCAD", remedy="export the body again")
        surface[face] = found.pop()
    return curve, surface


def _prescribe(
    gmsh: object,
    outline: Outline,
    intervals: np.ndarray,
    sides: dict[int, list[np.ndarray]],
    curve: np.ndarray,
    surface: np.ndarray,
) -> None:
    mesh, model = gmsh.model.mesh, gmsh.model
    for edge in np.unique(outline.edge).tolist():
        mesh.setTransfiniteCurve(int(curve[edge]), int(intervals[edge]) + 1)
    for face, found in sides.items():
        corners = [_shared(outline, found[k - 1], found[k]) for k in range(4)]
        if len(set(corners)) != 4:
            continue
        points = []
        for vertex in outline.vertices[corners]:
            near = [
                (np.linalg.norm(np.array(model.getValue(0, tag, [])) - vertex), tag)
                for _, tag in model.getBoundary([(2, int(surface[face]))], recursive=True)
            ]
            points.append(min(near)[1])
        mesh.setTransfiniteSurface(int(surface[face]), cornerTags=points)


def _shared(outline: Outline, before: np.ndarray, after: np.ndarray) -> int:
    """The vertex where one side of a face ends and the next begins."""
    return int(np.intersect1d(outline.edges[before[-1]], outline.edges[after[0]])[0])


def _read(gmsh: object, curve: np.ndarray, surface: np.ndarray, outline: Outline) -> QuadCover:
    mesh = gmsh.model.mesh
    tags, coordinates, _ = mesh.getNodes()
    order = np.argsort(tags)
    tags, points = np.asarray(tags)[order], np.reshape(coordinates, (-1, 3))[order]

    def elements(dimension: int, tag: int, corners: int, what: str) -> np.ndarray:
        kinds, _, nodes = mesh.getElements(dimension, tag)
        if len(kinds) != 1 or mesh.getElementProperties(kinds[0])[3] != corners:
            raise InputError(
                f"Gmsh leaves {what} without quads", remedy="simplify it in the CAD program"
            )
        return np.searchsorted(tags, np.reshape(nodes[0], (-1, corners)))

    quads, faces, rim, rim_edge = [], [], [], []
    for face, tag in enumerate(surface.tolist()):
        found = elements(2, tag, 4, f"Face{face + 1}")
        quads.append(found)
        faces.append(np.full(len(found), face))
    for edge in np.unique(outline.edge).tolist():
        found = elements(1, int(curve[edge]), 2, f"Edge{edge + 1}")
        rim.append(np.sort(found, axis=1))
        rim_edge.append(np.full(len(found), edge))
    corners, inverse = np.unique(np.concatenate(quads), return_inverse=True)
    lines = np.searchsorted(corners, np.concatenate(rim))
    order = np.lexsort(lines.T[::-1])
    return QuadCover(
        points[corners],
        inverse.reshape(-1, 4),
        np.concatenate(faces),
        lines[order],
        np.concatenate(rim_edge)[order],
    )
