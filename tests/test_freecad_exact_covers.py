# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What a cover keeps of a body: bit for bit, exactly, or within a tolerance."""

import numpy as np
import pytest

from HybridVolume import errors
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.check import check_surface
from HybridVolume.freecad_python import import_freecad
from HybridVolume.sources.covering import cover_solid
from HybridVolume.sources.faces import evaluate_face

try:
    FreeCAD = import_freecad()
    import Part
except (errors.SetupError, ImportError) as reason:
    pytest.skip(f"FreeCAD: {reason}", allow_module_level=True)

INNER, OUTER, HEIGHT = 6.0, 10.0, 5.0


@pytest.fixture(autouse=True)
def _worker(python, monkeypatch):
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", python)


def vector(radius, degrees, z):
    angle = np.radians(degrees)
    return FreeCAD.Vector(radius * np.cos(angle), radius * np.sin(angle), z)


def quarter_tube(weight=1.0):
    """A quarter of a tube of B-spline faces; the outer one has weights 1, .7 w, w²."""
    tube = Part.makeCylinder(OUTER, HEIGHT, FreeCAD.Vector(), FreeCAD.Vector(0, 0, 1), 90)
    tube = tube.cut(Part.makeCylinder(INNER, HEIGHT)).toNurbs()
    faces = []
    for face in tube.Faces:
        surface = face.Surface
        if face.BoundBox.DiagonalLength > 14 and surface.isURational() | surface.isVRational():
            weights = np.array(surface.getWeights())
            axis = int(np.ptp(weights, axis=1).max() > 0)
            for i, j in np.ndindex(*weights.shape):
                surface.setWeight(i + 1, j + 1, weights[i, j] * weight ** ((i, j)[axis]))
            face = surface.toShape()
        faces.append(face)
    shell = Part.Compound(faces)
    shell.sewShape(1e-7)
    return Part.Solid(shell.Shells[0])


def exact_volume(removed=0.0):
    return 0.25 * np.pi * (OUTER**2 - INNER**2) * HEIGHT - removed


def checked(covered):
    surface = build_surface(list(covered.faces))
    check_surface(surface)
    return surface


def affine_error(covered, solid, number):
    """How far patches are from OCC's surface, and its parameters from a linear map of theirs."""
    face = solid.Faces[number].Surface
    s, t = np.random.default_rng(number).uniform(0.02, 0.98, (2, 12))
    rows = np.column_stack([np.ones_like(s), s, t])
    off = bent = 0.0
    for k in np.flatnonzero(covered.origin == number).tolist():
        points = evaluate_face(covered.faces[k], s, t)
        uv = np.array([face.parameter(FreeCAD.Vector(*point)) for point in points])
        true = np.array([tuple(face.value(*pair)) for pair in uv])
        off = max(off, np.abs(true - points).max())
        left = uv - rows @ np.linalg.lstsq(rows, uv, rcond=None)[0]
        bent = max(bent, np.abs(left).max())
    return off, bent


def curved(solid):
    return [k for k, face in enumerate(solid.Faces) if not face.Surface.isPlanar()]


def test_vertices_in_sides_split_curved_faces_along_their_parameters():
    # each curved face has a vertex at 30 degrees above and one at 50 (and 70) degrees below
    lines = [
        Part.makeLine(vector(INNER, degrees, z), vector(OUTER, degrees, z))
        for degrees, z in ((30, HEIGHT), (50, 0.0), (70, 0.0))
    ]
    solid = quarter_tube().generalFuse(lines, 0.0)[0].Solids[0]
    assert len(solid.Faces) == 9
    covered = cover_solid(solid)
    walls = curved(solid)
    assert [covered.kinds[k] for k in walls] == ["bit", "bit"]
    assert set(covered.kinds) <= {"bit", "exact"}
    assert checked(covered).volume() == pytest.approx(exact_volume(), rel=1e-13)
    for k in walls:
        off, bent = affine_error(covered, solid, k)
        assert off < 1e-12 and bent < 1e-9


@pytest.mark.parametrize("weight", [1.0, 2.0])
def test_clean_faces_stay_bit_for_bit_beside_a_hole(weight):
    hole = Part.makeCylinder(1, HEIGHT, vector(8, 45, 0))
    solid = quarter_tube(weight).cut(hole).Solids[0]
    covered = cover_solid(solid)
    # the outer face's weights are 1, 1.4, 4: neighbours take them over
    walls = [k for k in curved(solid) if solid.Faces[k].BoundBox.DiagonalLength > 8]
    assert [covered.kinds[k] for k in walls] == ["bit", "bit"]
    assert "tolerance" not in covered.kinds
    assert covered.deviation.max() < 1e-12
    surface = checked(covered)
    assert surface.genus == (1,)
    assert surface.volume() == pytest.approx(exact_volume(np.pi * HEIGHT), rel=1e-12)
    for k in walls:
        off, bent = affine_error(covered, solid, k)
        assert off < 1e-12 and bent < 1e-9


def test_sides_with_many_knots_are_exact_with_few_quads():
    points = [FreeCAD.Vector(x, 4 + 0.4 * np.sin(1.3 * x), 0) for x in np.linspace(0, 12, 15)]
    wave = Part.BSplineCurve()
    wave.interpolate(points)
    assert len(wave.getKnots()) > 12
    first, last = points[0], points[-1]
    below = [FreeCAD.Vector(last.x, 0, 0), FreeCAD.Vector(0, 0, 0)]
    sides = Part.makePolygon([last, *below, first]).Edges
    wire = Part.Wire([wave.toShape(), *sides])
    solid = Part.Face(wire).extrude(FreeCAD.Vector(0, 0, 3))
    solid = solid.cut(Part.makeCylinder(1, 3, FreeCAD.Vector(6, 2, 0))).Solids[0]
    covered = cover_solid(solid)
    assert set(covered.kinds) == {"exact"}
    # the area below the interpolating cubic y(x), by Gauss points on its spans
    x, weights = np.polynomial.legendre.leggauss(4)
    area = 0.0
    for a, b in zip(wave.getKnots(), wave.getKnots()[1:], strict=False):
        t = 0.5 * (a + b) + 0.5 * (b - a) * x
        step = [wave.getDN(float(v), 1).x * wave.value(float(v)).y for v in t]
        area += 0.5 * (b - a) * float(weights @ step)
    assert checked(covered).volume() == pytest.approx(3 * (area - np.pi), rel=1e-12)


def test_what_is_within_a_tolerance_says_so():
    ball = Part.makeSphere(5, FreeCAD.Vector(0, 0, 0))
    solid = ball.cut(Part.makeCylinder(2, 20, FreeCAD.Vector(0, 0, -10))).Solids[0]
    covered = cover_solid(solid)
    wall = [k for k, face in enumerate(solid.Faces) if "Cylinder" in face.Surface.TypeId]
    assert [covered.kinds[k] for k in wall] == ["exact"]
    off = np.array([covered.deviation[k] for k in range(len(solid.Faces))])
    loose = np.array(covered.kinds) == "tolerance"
    diagonal = solid.BoundBox.DiagonalLength
    assert np.all(off[~loose] <= 1e-12 * diagonal) and np.all(off[loose] > 1e-12 * diagonal)
    assert off.max() <= 1e-4 * diagonal
    # napkin ring: its volume is that of a ball as high as the ring
    height = 2.0 * np.sqrt(21.0)
    assert checked(covered).volume() == pytest.approx(np.pi * height**3 / 6.0, rel=1e-4)
