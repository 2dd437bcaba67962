# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One CAD face to one untrimmed NURBS face, or the reason why not.

A face counts as untrimmed when its wire is the whole iso-parameter rectangle of its surface, and a
plane also when its wire is a convex quadrilateral with straight sides.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from ..core.surface import SplineFace

ISO_TOLERANCE = 1e-4
"""Edges that stay this close to an iso-parameter line, as a share of the range, lie on it."""

EXACT_TOLERANCE = 1e-9
"""Largest distance of an exactly converted face from the CAD face, as a share of the diagonal."""

_STRAIGHT = 1e-9
_FLAT_CORNER = np.radians(1.0)


@dataclass(frozen=True)
class Refusal:
    """Why a face is no untrimmed patch: ``pole``, ``seam``, ``trimmed`` or ``inexact``."""

    kind: str
    figure: float | None = None


@dataclass(frozen=True)
class FaceReading:
    """An untrimmed face as it was taken.

    Attributes
    ----------
    face : SplineFace
    domain : (u0, u1, v0, v1) or None
        Rectangle of the CAD face's own B-spline surface that the patch covers; None where the
        patch does not keep the surface's parameters.
    vertices : list
        Vertices in the middle of a side (each a possible T-junction), as OCC shapes.
    """

    face: SplineFace
    domain: tuple[float, float, float, float] | None = None
    vertices: list = field(default_factory=list)


def take_face(face: Any, name: str, diagonal: float) -> FaceReading | Refusal:
    """Read one face.

    Parameters
    ----------
    face : Part.Face
    name : str
    diagonal : float
        Diagonal of the body's box, mm.
    """
    edges = face_edges(face)
    if any(edge.Degenerated for edge in edges):
        return Refusal("pole")
    if seam_edges(face):
        return Refusal("seam")
    if len(face.Wires) != 1 or len(edges) < 4:
        return Refusal("trimmed")
    kind = face.Surface.TypeId
    if kind in ("Part::GeomBSplineSurface", "Part::GeomBezierSurface"):
        return _take_rectangle(face, face, edges, name, diagonal)
    nurbs = face.toNurbs().Faces
    if len(nurbs) == 1 and len(nurbs[0].Wires) == 1:
        reading = _take_rectangle(nurbs[0], face, face_edges(nurbs[0]), name, diagonal, edges)
        if isinstance(reading, FaceReading) or reading.kind != "trimmed":
            return reading
    if kind == "Part::GeomPlane":
        ordered = face.Wires[0].OrderedEdges
        if len(ordered) == len(edges):
            return _take_quadrilateral(ordered, name, diagonal)
    return Refusal("trimmed")


def face_edges(face: Any) -> list:
    """Edges of a face, degenerate ones included, a seam once."""
    # FreeCAD 0.20 lists a seam twice, 1.0 once
    edges: list = []
    known: dict[int, list] = {}
    for wire in face.Wires:
        for edge in wire.childShapes(True, True):
            alike = known.setdefault(edge.hashCode(), [])
            if not any(edge.isSame(other) for other in alike):
                alike.append(edge)
                edges.append(edge)
    return edges


def seam_edges(face: Any) -> list:
    """Edges that bound a face on both sides."""
    # isSeam is also true of the pieces beside a former seam, which have a curve each on one
    # surface; all edges of a wire are listed twice or once by the version of FreeCAD
    found = []
    for wire in face.Wires:
        known: dict[int, list] = {}
        for edge in wire.OrderedEdges:
            alike = known.setdefault(edge.hashCode(), [])
            if not edge.Degenerated and any(edge.isSame(other) for other in alike):
                found.append(edge)
            alike.append(edge)
    return found


def _take_rectangle(
    face: Any,
    original: Any,
    edges: list,
    name: str,
    diagonal: float,
    original_edges: list | None = None,
) -> FaceReading | Refusal:
    """Take a face with a NURBS surface whose wire is an iso-parameter rectangle."""
    found = _rectangle(face, edges)
    if found is None:
        return Refusal("trimmed")
    rectangle, sides = found
    bounds = _unbounded(face.Surface).bounds()
    own = face is original
    if _covers(face.Surface, rectangle, bounds, diagonal):
        rectangle = bounds
    patch = spline_face(face.Surface, name, rectangle, exact=not own)
    domain = rectangle if own else None
    if patch is None:
        return Refusal("trimmed")
    if patch.exact:
        deviation = distance_to_face(patch, original, domain)
        if deviation > EXACT_TOLERANCE * diagonal:
            return Refusal("inexact", deviation)
    vertices = _middle_vertices(original_edges or edges, sides)
    return FaceReading(patch, domain, vertices)


def _rectangle(face: Any, edges: list) -> tuple[tuple[float, ...], list[int]] | None:
    """The iso-parameter rectangle of a wire and the side of every edge, or None."""
    curves = []
    for edge in edges:
        found = face.curveOnSurface(edge)
        if found is None:
            return None
        curve, first, last = found
        points = [curve.value(t) for t in np.linspace(first, last, 7).tolist()]
        if edge.Orientation == "Reversed":
            points.reverse()
        curves.append([(p.x, p.y) for p in points])
    uv = np.array(curves)  # (edges, 7, 2)
    low, high = uv.min(axis=(0, 1)), uv.max(axis=(0, 1))
    size = high - low
    if np.any(size <= 0.0):
        return None
    # how far each edge is from u = low, u = high, v = low, v = high
    off = np.abs(np.stack([uv - low, uv - high], axis=-1)).max(axis=1) / size[:, None]
    off = off.reshape(-1, 4)
    sides = off.argmin(axis=1)
    if np.any(off.min(axis=1) > ISO_TOLERANCE):
        return None
    order = np.argsort(sides, kind="stable")
    start = np.searchsorted(sides[order], np.arange(4))
    if np.any(np.bincount(sides, minlength=4) == 0):
        return None
    at_u = (sides < 2)[order, None]
    runs = np.where(at_u, uv[order, :, 1], uv[order, :, 0])
    across = np.where(at_u, uv[order, :, 0], uv[order, :, 1])
    along = np.array([1, 1, 0, 0])
    first_end = np.minimum.reduceat(runs.min(axis=1), start) - low[along]
    last_end = high[along] - np.maximum.reduceat(runs.max(axis=1), start)
    length = np.add.reduceat(np.abs(runs[:, -1] - runs[:, 0]), start)
    slack = 4.0 * ISO_TOLERANCE * size[along]
    if np.any(np.maximum(first_end, last_end) > slack):
        return None
    if np.any(np.abs(length - size[along]) > slack):
        return None
    mean = np.add.reduceat(across.mean(axis=1), start) / np.bincount(sides)
    return tuple(mean.tolist()), sides.tolist()


def _middle_vertices(edges: list, sides: list[int]) -> list:
    """Vertices between two edges of one side."""
    return [
        vertex
        for i, j in combinations(range(len(edges)), 2)
        if sides[i] == sides[j]
        for vertex in edges[i].Vertexes
        if any(vertex.isSame(other) for other in edges[j].Vertexes)
    ]


def _unbounded(surface: Any) -> Any:
    """A copy of a NURBS surface that is a B-spline surface and not periodic."""
    if surface.TypeId == "Part::GeomBezierSurface":
        import Part

        poles = surface.getPoles()
        spline = Part.BSplineSurface()
        p, q = surface.UDegree, surface.VDegree
        spline.buildFromPolesMultsKnots(
            poles,
            [p + 1, p + 1],
            [q + 1, q + 1],
            [0.0, 1.0],
            [0.0, 1.0],
            False,
            False,
            p,
            q,
            surface.getWeights(),
        )
        return spline
    copy = surface.copy()
    if copy.isUPeriodic():
        copy.setUNotPeriodic()
    if copy.isVPeriodic():
        copy.setVNotPeriodic()
    return copy


def _covers(surface: Any, rectangle: tuple, bounds: tuple, diagonal: float) -> bool:
    """Whether a rectangle is the whole surface, but for less than can be told."""
    for side in range(4):
        low, high = bounds[side // 2 * 2], bounds[side // 2 * 2 + 1]
        off = abs(rectangle[side] - bounds[side])
        if off <= 1e-9 * (high - low):
            continue
        if off > ISO_TOLERANCE * (high - low):
            return False
        for t in np.linspace(0.0, 1.0, 5):
            if side < 2:
                v = bounds[2] + t * (bounds[3] - bounds[2])
                a, b = surface.value(rectangle[side], v), surface.value(bounds[side], v)
            else:
                u = bounds[0] + t * (bounds[1] - bounds[0])
                a, b = surface.value(u, rectangle[side]), surface.value(u, bounds[side])
            if a.distanceToPoint(b) > 1e-7 * diagonal:
                return False
    return True


def spline_face(
    surface: Any, name: str, rectangle: tuple[float, ...], *, exact: bool = False
) -> SplineFace | None:
    """Arrays of a NURBS surface, cut to a rectangle of its parameters if it reaches beyond.

    Returns None where the surface cannot be cut there.
    """
    import Part

    spline = _unbounded(surface)
    bounds = spline.bounds()
    if tuple(rectangle) != tuple(bounds) or not _clamped(spline):
        low = [bounds[0], bounds[0], bounds[2], bounds[2]]
        high = [bounds[1], bounds[1], bounds[3], bounds[3]]
        span = np.subtract(high, low)
        beyond = np.maximum(np.subtract(low, rectangle), np.subtract(rectangle, high))
        try:
            if np.all(beyond <= ISO_TOLERANCE * span):
                # bounds that overshoot the knots by rounding make OCC fail
                spline.segment(*np.clip(rectangle, low, high).tolist())
            else:
                # across the origin of a periodic surface
                spline = surface.copy()
                spline.segment(*rectangle)
                spline = _unbounded(spline)
        except (Part.OCCError, ValueError):
            return None
        exact = True
    return SplineFace(
        name,
        (spline.UDegree, spline.VDegree),
        (
            np.repeat(spline.getUKnots(), spline.getUMultiplicities()),
            np.repeat(spline.getVKnots(), spline.getVMultiplicities()),
        ),
        np.array([[(p.x, p.y, p.z) for p in row] for row in spline.getPoles()]),
        np.array(spline.getWeights(), dtype=float),
        exact,
    )


def _clamped(spline: Any) -> bool:
    u, v = spline.getUMultiplicities(), spline.getVMultiplicities()
    p, q = spline.UDegree + 1, spline.VDegree + 1
    return (u[0], u[-1], v[0], v[-1]) == (p, p, q, q)


def _take_quadrilateral(edges: list, name: str, diagonal: float) -> FaceReading | Refusal:
    """Take a plane face with four straight sides as a bilinear patch."""
    points = []
    for edge in edges:
        first, last = edge.ParameterRange
        line = np.array([tuple(edge.valueAt(t)) for t in np.linspace(first, last, 7)])
        chord = line[-1] - line[0]
        length = np.linalg.norm(chord)
        if length <= _STRAIGHT * diagonal:
            return Refusal("trimmed")
        run = (line - line[0]) @ chord / length
        off = np.linalg.norm(line - line[0] - run[:, None] * chord / length, axis=1).max()
        # a patch runs along its sides at constant speed
        uneven = np.abs(run / length - np.linspace(0.0, 1.0, 7)).max()
        if off > _STRAIGHT * diagonal or uneven > _STRAIGHT:
            return Refusal("trimmed")
        points.append(line[-1] if edge.Orientation == "Reversed" else line[0])
    corners = np.array(points)
    step = np.roll(corners, -1, axis=0) - corners
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    before = np.roll(step, 1, axis=0)
    turn = np.cross(before, step)
    angle = np.arctan2(np.linalg.norm(turn, axis=1), np.einsum("ij,ij->i", before, step))
    is_corner = angle > _FLAT_CORNER
    if is_corner.sum() != 4 or np.any(angle > np.pi - _FLAT_CORNER):
        return Refusal("trimmed")
    normals = turn[is_corner]
    if np.any(normals @ normals[0] <= 0.0):
        return Refusal("trimmed")
    if np.any(angle[~is_corner] > 1e-6):
        return Refusal("trimmed")
    side = np.cumsum(is_corner) % 4
    a, b, c, d = corners[is_corner]
    line = np.array([0.0, 0.0, 1.0, 1.0])
    patch = SplineFace(
        name,
        (1, 1),
        (line, line.copy()),
        np.array([[a, d], [b, c]]),
        np.ones((2, 2)),
        True,
    )
    return FaceReading(patch, None, _middle_vertices(edges, side.tolist()))


def evaluate_face(face: SplineFace, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Points of a face at m pairs of parameters, each in [0, 1] of its range, (m, 3)."""
    from ..core import bspline

    rows = []
    for degree, knots, x in zip(face.degrees, face.knots, (u, v), strict=True):
        at = knots[0] + (knots[-1] - knots[0]) * np.asarray(x)
        rows.append(bspline.basis_matrix(degree, knots, at).toarray())
    w = np.einsum("ma,mb,ab->m", *rows, face.weights)
    x = np.einsum("ma,mb,abd->md", *rows, face.control_points * face.weights[..., None])
    return x / w[:, None]


def random_parameters(seed: int, count: int = 25) -> tuple[np.ndarray, np.ndarray]:
    """Reproducible pairs of parameters inside the unit square."""
    return tuple(np.random.default_rng(seed).uniform(0.01, 0.99, (2, count)))


def distance_to_face(patch: SplineFace, face: Any, domain: tuple | None) -> float:
    """Largest distance of 25 random points of a patch from the CAD face, mm."""
    u, v = random_parameters(0)
    return distance_of_points(evaluate_face(patch, u, v), u, v, face, domain)


def distance_of_points(
    points: np.ndarray, u: np.ndarray, v: np.ndarray, face: Any, domain: tuple | None
) -> float:
    """Largest distance of points from a CAD face, mm.

    Parameters
    ----------
    points : (m, 3) array
    u, v : (m,) arrays
        Where the points should lie in the rectangle ``domain`` of the face's surface.
    face : Part.Face
    domain : (u0, u1, v0, v1) or None
        None: the nearest points of the face count, whatever their parameters.
    """
    import FreeCAD

    surface = face.Surface
    if domain is not None:
        at = zip(
            domain[0] + (domain[1] - domain[0]) * u,
            domain[2] + (domain[3] - domain[2]) * v,
            strict=True,
        )
        true = np.array([tuple(surface.value(float(s), float(t))) for s, t in at])
        return float(np.linalg.norm(points - true, axis=1).max())
    return max(distance_of_point(FreeCAD.Vector(*point), face) for point in points)


def distance_of_point(point: Any, face: Any) -> float:
    """Distance of a point from a face, mm."""
    import Part

    # distToShape misses feet on periodic surfaces whose face does not start at zero: project first
    surface, limits = face.Surface, face.ParameterRange
    foot = list(surface.parameter(point))
    for k, periodic in enumerate((surface.isUPeriodic(), surface.isVPeriodic())):
        if periodic:
            period = surface.UPeriod() if k == 0 else surface.VPeriod()
            middle = 0.5 * (limits[2 * k] + limits[2 * k + 1])
            foot[k] -= period * round((foot[k] - middle) / period)
    if face.isPartOfDomain(*foot):
        projected = surface.value(*foot).distanceToPoint(point)
        if projected <= 1e-12 * face.BoundBox.DiagonalLength:
            return projected
    else:
        projected = np.inf
    return min(projected, Part.Vertex(point).distToShape(face)[0])
