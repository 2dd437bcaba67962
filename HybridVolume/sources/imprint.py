# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Seams are cut away: closed faces get edges along their iso-parameter curves.

A face that closes upon itself (a cylinder, a torus, a closed B-spline) has an edge that bounds it
on both sides. Cut at quarters of the closed direction it becomes ordinary faces on the same
surface. OCC's general fuse does the cutting, so that neighbours get the new vertices too.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import errors
from .covered import TOLERANCE
from .faces import seam_edges
from .poles import pole_cuts
from .spheres import is_closed

logger = logging.getLogger(__name__)

QUARTERS = (0.25, 0.5, 0.75)
"""Where a closed face is cut: pieces turn by a quarter at most, a piece each side of the seam."""

VOLUME_TOLERANCE = 1e-4
"""Largest change of the volume by cutting, as a share of it; OCC's integration counts too."""

_DEFLECTIONS = (1e-3, 1e-4, 3e-5)
"""Of triangles by which volumes are compared, as shares of the diagonal."""


@dataclass(frozen=True)
class Imprinted:
    """A solid without seams.

    Attributes
    ----------
    solid : Part.Solid
    origin : (n,) int array
        Face of the solid as it was given that each face of it is a piece of, from 0.
    """

    solid: Any
    origin: np.ndarray


def has_seam(face: Any) -> bool:
    """Whether an edge bounds a face on both sides."""
    return bool(seam_edges(face))


def seam_cuts(face: Any) -> list:
    """Edges that cut a face with a seam at quarters of the directions in which it is closed.

    Parameters
    ----------
    face : Part.Face

    Returns
    -------
    list of Part.Edge
        None for a face without a seam.
    """
    if not has_seam(face):
        return []
    surface, limits = face.Surface, face.ParameterRange
    cuts = []
    for across in (0, 1):
        if not is_closed(face, across):
            continue
        low, high = limits[2 * across : 2 * across + 2]
        iso = surface.vIso if across else surface.uIso
        ends = limits[0:2] if across else limits[2:4]
        for quarter in QUARTERS:
            line = iso(low + quarter * (high - low)).toShape(*ends)
            # a trimmed face does not reach everywhere, and its neighbours must not be scratched
            cuts += line.common(face).Edges
    return cuts


def imprint_seams(solid: Any, tolerance: float | None = None) -> Imprinted:
    """Cut the faces of a solid that close upon themselves, and those with a tip about it.

    Parameters
    ----------
    solid : Part.Solid
    tolerance : float, optional
        Largest distance of patches from the faces, mm; 1e-4 of the diagonal by default.

    Returns
    -------
    Imprinted
        The solid itself where no face has a seam or a tip.

    Raises
    ------
    InputError
        OCC does not cut the faces into a closed, valid solid of the same volume without seams;
        the faces are named.
    """
    import Part

    if tolerance is None:
        tolerance = TOLERANCE * solid.BoundBox.DiagonalLength
    cuts, seamed = [], []
    for number, face in enumerate(solid.Faces):
        found = seam_cuts(face) + pole_cuts(face, tolerance)
        if found or has_seam(face):
            seamed.append(f"Face{number + 1}")
        cuts += found
    if not seamed:
        return Imprinted(solid, np.arange(len(solid.Faces)))
    try:
        # general fuse is symmetric: the edges are in the result only where they cut a face
        solids = solid.generalFuse(cuts, 0.0)[0].Solids if cuts else [solid]
    except Part.OCCError as error:
        raise _failed(f"OCC cannot cut the closed faces ({error})", seamed) from error
    if len(solids) != 1:
        raise _failed("the closed faces cannot be cut", seamed, float(len(solids)))
    (cut,) = solids
    left = sum(has_seam(face) for face in cut.Faces)
    if left:
        raise _failed(f"{left} faces still close upon themselves after cutting", seamed, left)
    if not cut.isClosed() or not cut.isValid():
        raise _failed("the solid is not closed and valid any more after cutting", seamed)
    change = abs(cut.Volume / solid.Volume - 1.0)
    for deflection in _DEFLECTIONS:
        if change <= VOLUME_TOLERANCE:
            break
        # OCC integrates over trimmed faces with few points: triangles tell what really changed,
        # once they are so fine that it does not matter where their corners are
        one, other = (_triangulated_volume(body, deflection) for body in (cut, solid))
        change = abs(one / other - 1.0)
    if not change <= VOLUME_TOLERANCE:
        raise _failed(f"cutting changes the volume by {change:.1e}", seamed, change)
    logger.info("%d closed faces cut: %d faces", len(seamed), len(cut.Faces))
    return Imprinted(cut, _origins(cut, solid))


def _triangulated_volume(solid: Any, deflection: float) -> float:
    """Volume between triangles, mm³, with a deflection that is a share of the diagonal."""
    box = solid.BoundBox
    factor = 100.0 / box.DiagonalLength
    # OCC does not come to an end on bodies of tenths of a millimetre
    sized = solid.copy()
    sized.translate(-box.Center)
    sized.scale(factor)
    points, triangles = sized.tessellate(100.0 * deflection)
    corners = np.array([tuple(point) for point in points])
    corners = (corners - corners.mean(axis=0))[np.array(triangles)]
    return float(np.linalg.det(corners).sum()) / 6.0 / factor**3


def _failed(what: str, faces: list[str], figure: float | None = None) -> errors.InputError:
    return errors.InputError(
        what,
        faces=faces,
        figure=figure,
        remedy="split these faces in the CAD program, and check the solid there",
    )


def _origins(cut: Any, solid: Any) -> np.ndarray:
    """Faces that pieces come from: those whose area a point inside the piece lies on."""
    faces = solid.Faces
    boxes = [face.BoundBox for face in faces]
    reach = 1e-6 * solid.BoundBox.DiagonalLength
    for box in boxes:
        box.enlarge(reach)
    whole: dict[int, list[tuple[Any, int]]] = {}
    for k, face in enumerate(faces):
        whole.setdefault(face.hashCode(), []).append((face, k))
    found = []
    for piece in cut.Faces:
        same = [k for face, k in whole.get(piece.hashCode(), ()) if face.isSame(piece)]
        if same:
            found.append(same[0])
            continue
        point = _inside(piece)
        near = [k for k, box in enumerate(boxes) if box.isInside(point)]
        off = [_distance(point, faces[k]) for k in near]
        if min(off, default=np.inf) > reach:
            # OCC's boxes may be too small for what turns about an axis
            near = range(len(faces))
            off = [_distance(point, face) for face in faces]
        found.append(near[int(np.argmin(off))])
    origin = np.array(found)
    if len(np.unique(origin)) != len(faces):
        raise _failed(
            "pieces of cut faces cannot be told apart",
            [f"Face{k + 1}" for k in np.setdiff1d(np.arange(len(faces)), origin)],
        )
    return origin


def _inside(face: Any) -> Any:
    """A point inside a face, away from its edges as far as a coarse grid tells."""
    import Part

    limits = face.ParameterRange
    enough = 1e-3 * face.BoundBox.DiagonalLength
    border = Part.Compound(face.Edges)
    best, farthest = face.CenterOfMass, -1.0
    for parts in (2, 3, 5, 9, 17, 33):
        share = (np.arange(1, parts)) / parts
        for s in share.tolist():
            for t in share.tolist():
                u = limits[0] + s * (limits[1] - limits[0])
                v = limits[2] + t * (limits[3] - limits[2])
                if face.isPartOfDomain(u, v):  # also where it is on an edge
                    point = face.Surface.value(u, v)
                    off = _distance(point, border)
                    if off > enough:
                        return point
                    if off > farthest:
                        best, farthest = point, off
    return best if farthest >= 0.0 else _inside_narrow(face)


def _inside_narrow(face: Any) -> Any:
    """A point of a face that no grid meets: half its width beside its longest edge."""
    edge = max(face.Edges, key=lambda edge: edge.Length)
    middle = 0.5 * sum(edge.ParameterRange)
    point = edge.valueAt(middle)
    normal = face.normalAt(*face.Surface.parameter(point))
    step = normal.cross(edge.tangentAt(middle)) * (face.Area / face.Length)
    for way in (1.0, -1.0):
        uv = face.Surface.parameter(point + step * way)
        if face.isPartOfDomain(*uv):
            return face.Surface.value(*uv)
    return point


def _distance(point: Any, shape: Any) -> float:
    import Part

    return Part.Vertex(point).distToShape(shape)[0]
