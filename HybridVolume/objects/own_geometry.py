# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Points, wires and faces of the user's as facets of a midstructure."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import Part
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from HybridVolume.errors import InputError
from HybridVolume.sources import global_shape
from HybridVolume.sources.fingerprint import fingerprint
from HybridVolume.sources.step import read_any_shape

DEFLECTION = 2e-3
"""Farthest that a facet or line may stand off its curve or surface, as a share of the diagonal."""

_SAME = 1e-9
"""Points closer than this share of the diagonal are one."""

_REMEDY = "give points, wires or faces"


def tessellate(objects: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Facets of document objects or shapes, in global coordinates.

    Faces (also those of shells and solids) give triangles, edges without a face lines, and
    vertices without an edge points.

    Parameters
    ----------
    objects : sequence of App.DocumentObject or Part.Shape

    Returns
    -------
    vertices : (m, 3) array
        mm.
    facets : (f, 3) int array
        A line has its second corner twice, a point one corner three times.

    Raises
    ------
    InputError
        There is nothing to take.
    """
    # copies without triangulation: what the window has drawn must not decide about our facets
    shapes = [_shape(one).copy(True, False) for one in objects]
    box = Part.makeCompound(shapes).BoundBox
    size = box.DiagonalLength if box.isValid() else 0.0
    parts = [part for shape in shapes for part in _parts(shape, DEFLECTION * size)]
    if not parts:
        raise InputError("there is no point, wire or face", remedy=_REMEDY)
    start = np.cumsum([0, *(len(points) for points, _ in parts[:-1])])
    vertices = np.concatenate([points for points, _ in parts])
    facets = np.concatenate([facets + k for (_, facets), k in zip(parts, start, strict=True)])
    return _welded(vertices, facets, _SAME * size)


def read_geometry(path: str | os.PathLike) -> Any:
    """Read points, wires or faces of a STEP or BREP file as one Part.Shape.

    Raises
    ------
    InputError
        The file cannot be read, or holds none of them.
    """
    shape = read_any_shape(path)
    if shape.isNull() or not (shape.Vertexes or shape.Faces):
        raise InputError(f"{Path(path).name} holds no point, wire or face", remedy=_REMEDY)
    return shape


def parts_inside(shape: Any, solid: Any) -> Any | None:
    """The faces, loose edges and loose vertices of a shape that begin inside a solid.

    Parameters
    ----------
    shape : Part.Shape
    solid : Part.Solid

    Returns
    -------
    Part.Compound or None
        None where there are none.
    """
    pieces = [*shape.Faces, *loose_edges(shape), *loose_vertices(shape)]
    inside = [
        piece
        for piece in pieces
        if any(solid.isInside(vertex.Point, 0.0, False) for vertex in piece.Vertexes)
    ]
    return Part.makeCompound(inside) if inside else None


def geometry_fingerprint(objects: Sequence[Any]) -> str:
    """Fingerprint of the geometry of document objects; "none" without any."""
    shapes = []
    for one in objects:
        try:
            shapes.append(_shape(one))
        except InputError:
            continue
    return fingerprint(Part.makeCompound(shapes)) if shapes else "none"


def _shape(one: Any) -> Any:
    is_object = hasattr(one, "Document")
    shape = global_shape(one) if is_object else one
    if shape is None or shape.isNull():
        name = one.Label if is_object else "the geometry"
        raise InputError(f"{name} has no shape", remedy=_REMEDY)
    return shape


def _parts(shape: Any, deflection: float) -> list[tuple[np.ndarray, np.ndarray]]:
    parts = []
    if shape.Faces:
        points, facets = Part.makeCompound(shape.Faces).tessellate(deflection)
        parts.append((_array(points), np.array(facets, dtype=np.int64).reshape(-1, 3)))
    for edge in loose_edges(shape):
        points = _array(edge.discretize(QuasiDeflection=deflection))
        first = np.arange(len(points) - 1)
        parts.append((points, np.column_stack([first, first + 1, first + 1])))
    points = [vertex.Point for vertex in loose_vertices(shape)]
    if points:
        parts.append((_array(points), np.repeat(np.arange(len(points))[:, None], 3, axis=1)))
    return parts


def loose_edges(shape: Any) -> list:
    """Edges of a shape that belong to no face, and have a length."""
    taken = _Members(edge for face in shape.Faces for edge in face.Edges)
    return [
        edge
        for edge in shape.Edges
        if edge not in taken and not edge.Degenerated and edge.Length > 0.0
    ]


def loose_vertices(shape: Any) -> list:
    """Vertices of a shape that belong to no edge."""
    taken = _Members(vertex for edge in shape.Edges for vertex in edge.Vertexes)
    return [vertex for vertex in shape.Vertexes if vertex not in taken]


class _Members:
    """Shapes that can be asked for; two shapes may have the same hash."""

    def __init__(self, shapes: Iterable[Any]) -> None:
        self._buckets: dict[int, list] = {}
        for shape in shapes:
            self._buckets.setdefault(shape.hashCode(), []).append(shape)

    def __contains__(self, shape: Any) -> bool:
        return any(one.isSame(shape) for one in self._buckets.get(shape.hashCode(), ()))


def _array(points: Any) -> np.ndarray:
    return np.array([tuple(point) for point in points], dtype=float).reshape(-1, 3)


def _welded(
    vertices: np.ndarray, facets: np.ndarray, distance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Make one of points closer than a distance; what loses its area or length by it is left out.

    What is a line or a point already stays one.
    """
    pairs = cKDTree(vertices).query_pairs(max(distance, 1e-300), output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(vertices),) * 2)
    _, group = connected_components(graph, directed=False)
    label = np.unique(group, return_index=True)[1][group]
    before, after = _corners(facets), _corners(label[facets])
    facets = label[facets][before == after]
    used, facets = np.unique(facets, return_inverse=True)
    return vertices[used], facets.reshape(-1, 3)


def _corners(facets: np.ndarray) -> np.ndarray:
    """Number of different corners of each facet."""
    ordered = np.sort(facets, axis=1)
    return 1 + (np.diff(ordered, axis=1) > 0).sum(axis=1)
