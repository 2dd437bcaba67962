# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Faces narrower than the tolerance, and narrow pieces of one surface, join their neighbours."""

import numpy as np
import pytest

from HybridVolume import errors, sources
from HybridVolume.freecad_python import import_freecad
from HybridVolume.sources.imprint import imprint_seams
from HybridVolume.sources.slivers import without_slivers

try:
    FreeCAD = import_freecad()
    import Part
    from FreeCAD import Vector
except (errors.SetupError, ImportError) as reason:
    pytest.skip(f"FreeCAD: {reason}", allow_module_level=True)

SIZE = 51.0  # diagonal of 40 x 30 x 10, mm
TOLERANCE = 1e-4 * SIZE


def prism(*corners, scale=1.0):
    points = [Vector(x * scale, y * scale, 0) for x, y in (*corners, corners[0])]
    return Part.Face(Part.makePolygon(points)).extrude(Vector(0, 0, 10 * scale))


def bevelled(share, scale=1.0):
    """A box with a corner cut off: 1.118 share of the diagonal wide."""
    cut = share * SIZE
    return prism((0, 0), (40, 0), (40, 30), (cut, 30), (0, 30 - cut / 2), scale=scale)


def divided(*cuts):
    """A box with lines across its top at these places along it."""
    box = Part.makeBox(40, 30, 10)
    lines = [Part.makeLine(Vector(x, 0, 10), Vector(x, 30, 10)) for x in cuts]
    return box.generalFuse(lines, 0.0)[0].Solids[0]


@pytest.mark.parametrize(("share", "scale"), [(5e-5, 1e-3), (1e-5, 1.0), (5e-5, 1e3)])
def test_a_narrow_bevel_is_taken_away(share, scale):
    solid = bevelled(share, scale)
    solid.rotate(Vector(), Vector(1, 2, 3), 37)
    solid.translate(Vector(100, -50, 20) * scale)
    found = without_slivers(solid, TOLERANCE * scale)
    assert found.solid.isValid() and found.solid.isClosed() and len(found.solid.Faces) == 6
    assert found.solid.Volume == pytest.approx(12000.0 * scale**3, rel=1e-9)
    assert list(found.into) == [3] and found.into[3] in (2, 4)
    # faces keep their numbers: planes with their normals
    for number, face in zip(found.numbers.tolist(), found.solid.Faces, strict=True):
        before = solid.Faces[number]
        assert before.normalAt(0, 0).dot(face.normalAt(0, 0)) == pytest.approx(1.0)
    # the corner that is there again is as far from the bevel as this right triangle is high
    height = share * SIZE * scale / np.sqrt(5.0)
    assert set(found.moved) == {2, 4, 5, 6}
    assert max(found.moved.values()) == pytest.approx(height, rel=1e-3, abs=2e-7)


@pytest.mark.parametrize("share", [2e-4, 1e-3])
def test_wider_faces_stay(share):
    solid = bevelled(share)
    found = without_slivers(solid, TOLERANCE)
    assert found.solid.isSame(solid) and not found.into and not found.moved


@pytest.mark.parametrize("width", [1e-5, 1e-4, 5e-4])
def test_a_narrow_piece_of_a_plane_joins_the_next(width):
    found = without_slivers(divided(15.0, 15.0 + width * SIZE), TOLERANCE)
    assert found.solid.isValid() and found.solid.isClosed()
    # what was divided on purpose stays divided: two pieces of the top, not one, and nothing moved
    assert len(found.solid.Faces) == 7 and len(found.into) == 1 and not found.moved
    tops = [face.Area for face in found.solid.Faces if face.BoundBox.ZMin > 9.99]
    assert sum(tops) == pytest.approx(1200.0, rel=1e-12)
    assert min(tops) == pytest.approx(450.0, rel=2e-3)
    wide = divided(15.0, 17.0)
    assert without_slivers(wide, TOLERANCE).solid.isSame(wide)


def test_a_step_that_cannot_be_taken_away_stays():
    low, high = Part.makeBox(20, 30, 10), Part.makeBox(20, 30, 10.004, Vector(20, 0, 0))
    step = low.fuse(high).Solids[0]
    found = without_slivers(step, TOLERANCE)
    assert found.solid.isSame(step) and not found.into


def test_merged_faces_are_told():
    """A box again: six untrimmed patches, and the report says where the seventh face is."""
    (body,) = sources.read_shape(Part.Compound([divided(15.0, 15.001)]), "strip")
    narrow, into = next(iter(body.cover.merged.items()))
    assert body.shape.Faces[narrow].Area == pytest.approx(0.03)
    geometry = body.origin["geometry"]
    assert geometry["merged"] == {f"Face{narrow + 1}": f"Face{into + 1}"}
    assert geometry["inside"] == [] and len(geometry["faces"]) == 7
    assert f"Face{narrow + 1} is part of Face{into + 1} now" in geometry["sentence"]
    (body,) = sources.read_shape(bevelled(5e-5), "bevel")
    assert len(body.faces) == 6 and body.cover.merged.keys() == {3}
    off = body.cover.deviation
    assert off[[2, 4, 5, 6]] == pytest.approx(5e-5 * SIZE / np.sqrt(5.0), rel=1e-3)
    assert [body.cover.kinds[k] for k in (2, 4, 5, 6)] == ["tolerance"] * 4


def test_pieces_of_narrow_rings_keep_their_face():
    """A ring of .004 mm that no grid of points meets, cut at quarters with its seam beside it."""
    plate = Part.makeBox(40, 30, 10).cut(Part.makeCylinder(5, 10, Vector(20, 15, 0)))
    bored = plate.cut(Part.makeCylinder(5.004, 4, Vector(20, 15, 6))).Solids[0]
    cut = imprint_seams(bored)
    area = np.zeros(len(bored.Faces))
    np.add.at(area, cut.origin, [face.Area for face in cut.solid.Faces])
    assert area == pytest.approx([face.Area for face in bored.Faces], rel=1e-6)
