# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Distances from CAD surfaces with poles, tips and seams are those that OCC finds."""

import numpy as np
import pytest

from HybridVolume.errors import SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Part
from FreeCAD import Vector

from HybridVolume.sources.distances import surface_distances
from HybridVolume.sources.imprint import imprint_seams


def ring() -> Part.Face:
    """A bicubic ring, periodic both ways."""
    a, b = (np.linspace(0.0, 2.0 * np.pi, n, endpoint=False) for n in (10, 8))
    r = 7.0 + 2.0 * np.cos(b)
    points = [
        [Vector(x * np.cos(s), x * np.sin(s), 2.0 * np.sin(t)) for x, t in zip(r, b, strict=True)]
        for s in a
    ]
    surface = Part.BSplineSurface()
    knots = list(range(11)), list(range(9))
    surface.buildFromPolesMultsKnots(points, [1] * 11, [1] * 9, *knots, True, True, 3, 3)
    return surface.toShape()


def ellipsoid() -> Part.Face:
    scale = FreeCAD.Matrix()
    scale.A11, scale.A22, scale.A33 = 30.0, 20.0, 12.0
    return Part.makeSphere(1.0).transformGeometry(scale).Faces[0]


def revolved(angle: float, *profile: tuple[float, float]) -> Part.Face:
    line = Part.BSplineCurve()
    line.interpolate([Vector(r, 0.0, z) for r, z in profile])
    return line.toShape().revolve(Vector(), Vector(0.0, 0.0, 1.0), angle).Faces[0]


@pytest.mark.parametrize(
    "face",
    [
        ring(),
        ellipsoid(),
        revolved(360.0, (0, 0), (5, 8), (8, 15), (0, 25)),
        revolved(200.0, (3, 0), (5, 8), (1, 15), (7, 25)),
    ],
    ids=["ring", "ellipsoid", "tips", "vase"],
)
def test_distances_from_surfaces_with_poles_and_seams(face):
    face = face.copy()
    face.rotate(Vector(), Vector(1.0, 2.0, 3.0), 40.0)
    face.translate(Vector(100.0, -20.0, 7.0))
    rng = np.random.default_rng(1)
    u0, u1, v0, v1 = face.ParameterRange
    places = rng.uniform([u0, v0], [u1, v1], (60, 2))
    places[:15, 1] = v0 + 1e-3 * (places[:15, 1] - v0)
    places[15:25, 0] = u1
    points = np.array([tuple(face.valueAt(*place)) for place in places.tolist()])
    size = face.BoundBox.DiagonalLength * rng.choice([1e-4, 1e-2], (60, 1))
    points += rng.normal(size=points.shape) * size
    found = surface_distances(face, points)
    occ = [Part.Vertex(*point).distToShape(face)[0] for point in points.tolist()]
    # now and then OCC's search ends beside the foot, so ours may be nearer
    assert (found - occ).max() < 1e-9
    assert (np.abs(found - occ) < 1e-9).mean() > 0.95


def test_pieces_of_a_turned_spindle_are_told_apart():
    line = Part.BSplineCurve()
    line.interpolate([Vector(r, 0.0, z) for r, z in ((0, 0), (5, 8), (8, 15), (0, 25))])
    axis = Part.makeLine(Vector(0.0, 0.0, 25.0), Vector())
    profile = Part.Face(Part.Wire([line.toShape(), axis]))
    spindle = profile.revolve(Vector(), Vector(0.0, 0.0, 1.0), 360.0).Solids[0]
    spindle.rotate(Vector(), Vector(1.0, 2.0, 3.0), 37.0)
    spindle.translate(Vector(200.0, -50.0, 80.0))
    cut = imprint_seams(spindle)
    # OCC's box does not hold all of its only face
    assert len(cut.origin) == len(cut.solid.Faces) > 8
    assert not cut.origin.any()
    assert cut.solid.isValid()
