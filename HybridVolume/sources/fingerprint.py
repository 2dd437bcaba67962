# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Whether a body is still the one that a result was computed from."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

_STEP = 1e-9
_OFFSET = 0.3819660112501051
_GRID = np.linspace(0.0, 1.0, 5)
_KEPT = 4

# A body is asked for many times while a result goes into a document. Geometry that is held here
# is not given up, so that another one cannot have its place.
_known: list[tuple[Any, tuple[float, ...], str]] = []


def fingerprint(shape: Any) -> str:
    """Return a hash of a shape's geometry, the same after saving and reopening.

    Control points and weights of B-spline faces count, 5 x 5 points of any other face, 17 points of
    an edge and the vertices where there are no solids, all rounded to 1e-9 of the diagonal;
    triangulations and names do not.

    Parameters
    ----------
    shape : Part.Shape
    """
    place = (*shape.Placement.toMatrix().A, float(shape.Orientation == "Reversed"))
    for known, where, text in _known:
        if where == place and known.isPartner(shape):
            return text
    _known.append((shape, place, _fingerprint(shape)))
    del _known[:-_KEPT]
    return _known[-1][2]


def _fingerprint(shape: Any) -> str:
    digest = hashlib.sha256(f"{shape.ShapeType} {len(shape.Faces)}".encode())
    # A power of two: a diagonal that differs in its last digit must not change the rounding.
    box = shape.BoundBox
    far = max(map(abs, (box.XMin, box.XMax, box.YMin, box.YMax, box.ZMin, box.ZMax)))
    # single points have no diagonal
    step = _STEP * 2.0 ** round(np.log2(max(box.DiagonalLength, 1e-6 * far, 1e-12)))
    for face in shape.Faces:
        surface = face.Surface
        digest.update(f"{surface.TypeId} {face.Orientation}".encode())
        if surface.TypeId == "Part::GeomBSplineSurface":
            points = np.array(surface.getPoles(), dtype=float)
            digest.update(np.round(np.array(surface.getWeights()), 9).tobytes())
            knots = [*surface.getUKnots(), *surface.getVKnots()]
            digest.update(np.round(np.array(knots), 9).tobytes())
        else:
            u0, u1, v0, v1 = face.ParameterRange
            points = np.array(
                [face.valueAt(u0 + (u1 - u0) * s, v0 + (v1 - v0) * t) for s in _GRID for t in _GRID]
            )
        digest.update(_rounded(points, step))
    if not shape.Solids:
        for edge in shape.Edges:
            if not edge.Degenerated:
                first, last = edge.ParameterRange
                places = np.linspace(first, last, 17)
                points = [tuple(edge.valueAt(place)) for place in places.tolist()]
                digest.update(_rounded(np.array(points), step))
        digest.update(_rounded(np.array([tuple(v.Point) for v in shape.Vertexes]), step))
    return digest.hexdigest()[:32]


def _rounded(points: np.ndarray, step: float) -> bytes:
    # The odd offset keeps plain figures, which bodies are full of, off the rounding's edges.
    return np.floor(points / step + _OFFSET).astype(np.int64).tobytes()
