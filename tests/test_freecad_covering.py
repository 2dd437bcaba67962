# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Solids with seams, poles and holes are covered with four-sided patches."""

import numpy as np
import pytest

from HybridVolume import errors
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.check import check_surface
from HybridVolume.core.covering.geometry import project
from HybridVolume.freecad_python import import_freecad
from HybridVolume.sources.covering import cover_solid
from HybridVolume.sources.exact_geometry import curves_of, surfaces_of
from HybridVolume.sources.faces import evaluate_face, random_parameters
from HybridVolume.sources.imprint import has_seam, imprint_seams
from HybridVolume.sources.outlines import outline_of

try:
    FreeCAD = import_freecad()
    import Part
except (errors.SetupError, ImportError) as reason:
    pytest.skip(f"FreeCAD: {reason}", allow_module_level=True)


def plate():
    """A plate with two holes, one of them blind, and a rounded edge."""
    box = Part.makeBox(40, 30, 10)
    box = box.makeFillet(
        3, [edge for edge in box.Edges if edge.BoundBox.XMax < 1 > edge.BoundBox.YMax]
    )
    through = Part.makeCylinder(4, 10, FreeCAD.Vector(12, 15, 0))
    blind = Part.makeCylinder(5, 6, FreeCAD.Vector(28, 15, 4))
    return box.cut(through).cut(blind).Solids[0]


def octant():
    """An eighth of a ball: the round face has three corners, one of them a pole."""
    return Part.makeSphere(10).common(Part.makeBox(10, 10, 10)).Solids[0]


@pytest.mark.parametrize(
    ("solid", "pieces"),
    [
        (Part.makeCylinder(5, 20), [4, 1, 1]),
        (Part.makeTorus(10, 3), [16]),
        (Part.makeSphere(10), [4]),
        # a cap at the tip and five rings; a tip that is cut open, in quarters too
        (Part.makeCone(6, 0, 15), [24, 1]),
        (Part.makeCone(6, 0, 15, FreeCAD.Vector(), FreeCAD.Vector(0, 0, 1), 270), [18, 1, 1, 1]),
        (Part.makeBox(1, 2, 3), [1] * 6),
    ],
)
def test_seams_are_cut_away(solid, pieces):
    cut = imprint_seams(solid)
    assert sorted(np.bincount(cut.origin).tolist(), reverse=True) == pieces
    assert cut.solid.isValid() and cut.solid.isClosed()
    assert cut.solid.Volume == pytest.approx(solid.Volume, rel=1e-9)
    assert not any(has_seam(face) for face in cut.solid.Faces)
    # general fuse keeps the numbers of faces apart: a piece's surface is that of its origin
    for piece, origin in zip(cut.solid.Faces, cut.origin.tolist(), strict=True):
        assert piece.Surface.TypeId == solid.Faces[origin].Surface.TypeId


def test_caps_at_tips_are_as_small_as_the_tolerance_asks():
    cone = Part.makeCone(6, 0, 15)
    tip = FreeCAD.Vector(0, 0, 15)
    for tolerance in (1e-2, 1e-3):
        cut = imprint_seams(cone, tolerance).solid
        away = sorted(tip.distanceToPoint(vertex.Point) for vertex in cut.Vertexes)
        # four vertices on every ring, each three times as far away as the one before
        rings = np.array(away[1:]).reshape(-1, 4)
        assert np.ptp(rings, axis=1).max() < 1e-9
        assert rings[1:-1, 0] / rings[:-2, 0] == pytest.approx(3.0)
        # a needle would have 20 times the tolerance; normals of this cone turn by 136 degrees
        flatness = np.cos(np.arctan2(6.0, 15.0))
        assert rings[0, 0] == pytest.approx(20.0 * tolerance / flatness, rel=1e-2)


def test_outlines_know_sides_and_corners():
    box = outline_of(Part.makeBox(1, 2, 3))
    assert box.face_count == 6 and box.length.sum() == pytest.approx(4 * (1 + 2 + 3))
    assert all(len(box.sides(face)) == 4 for face in range(6))
    assert np.degrees(box.corner) == pytest.approx(90.0)
    cylinder = outline_of(imprint_seams(Part.makeCylinder(5, 20)).solid)
    sides = [cylinder.sides(face) is not None for face in range(cylinder.face_count)]
    assert sum(sides) == 4  # the quarters of the wall; the discs have no corners
    assert cylinder.turning.sum() == pytest.approx(2 * 2 * np.pi, rel=1e-6)


def test_geometry_is_exact():
    solid = imprint_seams(plate()).solid
    for edge, curve in zip(solid.Edges, curves_of(solid), strict=True):
        t = np.linspace(*edge.ParameterRange, 7)
        points = np.array([tuple(edge.valueAt(float(x))) for x in t])
        assert np.abs(curve.evaluate(curve.project(points)) - points).max() < 1e-7
    for face, surface in zip(solid.Faces, surfaces_of(solid), strict=True):
        points = np.array([tuple(vertex.Point) for vertex in face.Vertexes])
        assert np.abs(project(surface, points)[1] - points).max() < 1e-9


@pytest.mark.parametrize(
    ("solid", "genus", "exact"),
    [(Part.makeCylinder(5, 20), 0, True), (octant(), 0, False), (plate(), 1, True)],
)
def test_covers_are_closed_and_near(solid, genus, exact, python, monkeypatch):
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", python)
    covered = cover_solid(solid)
    surface = build_surface(list(covered.faces))
    check_surface(surface)
    assert surface.genus == (genus,)
    # planes and whole rectangles of surfaces keep their geometry
    assert surface.volume() == pytest.approx(solid.Volume, rel=1e-12 if exact else 2e-4)
    assert sorted(set(covered.origin.tolist())) == list(range(len(solid.Faces)))
    allowed = (1e-12 if exact else 1e-4) * solid.BoundBox.DiagonalLength
    assert covered.deviation.max() <= allowed
    rng = np.random.default_rng(1)
    some = min(12, len(covered.faces))
    for k in rng.choice(len(covered.faces), some, replace=False).tolist():
        patch, face = covered.faces[k], solid.Faces[covered.origin[k]]
        assert patch.name == f"Face{covered.origin[k] + 1}"
        for point in evaluate_face(patch, *random_parameters(k, 3)):
            off = Part.Vertex(FreeCAD.Vector(*point)).distToShape(face)[0]
            assert off <= 1.5 * allowed + 1e-9


def test_a_hole_that_touches_the_outside_is_refused_by_name(python, monkeypatch):
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", python)
    hole = Part.makeCylinder(3, 10, FreeCAD.Vector(27, 10, 0))
    solid = Part.makeBox(30, 20, 10).cut(hole).Solids[0]
    with pytest.raises(errors.InputError, match="no thickness") as caught:
        cover_solid(solid)
    # the top and the bottom come to one point of the box's edge twice
    ends = [k + 1 for k, face in enumerate(solid.Faces) if face.BoundBox.ZLength < 1e-6]
    assert {f"Face{k}" for k in ends} <= set(caught.value.faces)
