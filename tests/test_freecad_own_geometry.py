# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Points, wires and faces of a document as the midstructure."""

import math

import numpy as np
import pytest

import HybridVolume
from HybridVolume import job
from HybridVolume.errors import InputError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Part

from HybridVolume.objects import own_geometry
from HybridVolume.objects import volume as volumes
from HybridVolume.objects.midstructure import chosen


@pytest.fixture
def doc():
    doc = FreeCAD.newDocument("own", hidden=True, temp=True)
    yield doc
    FreeCAD.closeDocument(doc.Name)


@pytest.fixture
def volume(doc):
    """Volume of a box that was started, where there is a worker."""
    try:
        job.worker_python()
    except SetupError as missing:
        pytest.skip(missing.line)
    box = doc.addObject("Part::Box", "Box")
    box.Length, box.Width, box.Height = 4, 2, 1
    doc.recompute()
    return volumes.start(doc, box)


def area(obj):
    return chosen(obj).area


def state(obj):
    names = ("Decisions", "Kept", "Unmatched", "Method", "FoundFrom", "Status")
    return {name: getattr(obj, name) for name in names}


def test_points_wires_and_faces_are_facets(doc):
    point = doc.addObject("Part::Feature", "Point")
    point.Shape = Part.Vertex(1, 2, 3)
    wire = doc.addObject("Part::Feature", "Wire")
    circle = Part.Circle(FreeCAD.Vector(0, 0, 0), FreeCAD.Vector(0, 0, 1), 2.0)
    wire.Shape = Part.Wire([circle.toShape()])
    wire.Placement.Base = FreeCAD.Vector(10, 0, 0)
    sphere = doc.addObject("Part::Sphere", "Sphere")
    sphere.Radius = 3
    doc.recompute()
    vertices, facets = own_geometry.tessellate([point, wire, sphere])
    corners = np.array([len(set(row)) for row in facets.tolist()])
    (alone,) = facets[corners == 1]
    assert np.allclose(vertices[alone], [1, 2, 3])
    lines = facets[corners == 2]
    assert (lines[:, 1] == lines[:, 2]).all()
    ends = vertices[lines[:, :2]]
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum() == pytest.approx(
        4.0 * math.pi, rel=0.02
    )
    assert np.allclose(np.linalg.norm(ends - (10, 0, 0), axis=2), 2.0)
    # a closed surface without a gap: every side of a triangle is another's
    triangles = facets[corners == 3]
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()
    x = vertices[triangles]
    size = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum()
    assert size == pytest.approx(36.0 * math.pi, rel=0.03)


def test_what_has_no_shape_is_no_geometry(doc):
    group = doc.addObject("App::FeaturePython", "Nothing")
    with pytest.raises(InputError, match="Nothing has no shape; give points, wires or faces"):
        own_geometry.tessellate([group])


PIECES = {
    "point": (lambda: Part.Vertex(2, 1, 0.5), 0.0),
    "wire": (lambda: Part.makePolygon([FreeCAD.Vector(x, 1, 0.5) for x in (1, 2, 3)]), 0.0),
    "face": (lambda: Part.makePlane(2, 1, FreeCAD.Vector(1, 0.5, 0.5)), 2.0),
}


@pytest.mark.parametrize("name", PIECES)
def test_own_geometry_is_found(doc, volume, name):
    make, wanted = PIECES[name]
    piece = doc.addObject("Part::Feature", "Piece")
    piece.Shape = make()
    doc.recompute()
    mid = HybridVolume.edit_midstructure(volume)
    mid.set(method="own", geometry=[piece])
    mid.find()
    assert mid.object.Status == "Up to date" and mid.object.MethodUsed == "own"
    assert area(mid.object) == pytest.approx(wanted, rel=1e-6)
    assert np.allclose(chosen(mid.object).vertices[:, 2], 0.5)
    piece.Placement.Base = FreeCAD.Vector(0.1, 0, 0)
    doc.recompute()
    assert mid.object.Status == "Out of date: Geometry changed"
    if name != "point":
        return
    piece.Placement.Base = FreeCAD.Vector(20, 0, 0)
    doc.recompute()
    before = state(mid.object)
    with pytest.raises(InputError, match="outside|inside"):
        mid.find()
    assert state(mid.object) == before


def test_own_without_geometry_is_refused(volume):
    mid = HybridVolume.edit_midstructure(volume)
    mid.set(method="own")
    with pytest.raises(InputError, match="no geometry is given"):
        mid.find()
