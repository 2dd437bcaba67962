# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Nodes of faces that reach out of the box in which FreeCAD looks for them are found on a copy."""

from types import SimpleNamespace

import numpy as np
import pytest

from HybridVolume.errors import SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Part

from HybridVolume.objects import node_search
from HybridVolume.objects.coverage import cover
from HybridVolume.objects.face_boxes import by_length
from HybridVolume.objects.fem_mesh import MeshArrays, build
from HybridVolume.sources.distances import surface_distances

POLES = ((20, 0), (9, 13), (-5, 15), (-12, 4), (-9, -12), (8, -11))
HEIGHT = 8.0
AROUND, UP = 60, 4


@pytest.fixture(params=[0.0, 37.0], ids=["as drawn", "turned"])
def cam(request):
    """A closed extruded spline with a mesh of triangles on it: wall, bottom, top."""
    curve = Part.BSplineCurve()
    poles = [FreeCAD.Vector(x, y, 0.0) for x, y in POLES]
    curve.buildFromPolesMultsKnots(poles, [1] * 7, list(range(7)), True, 3)
    solid = Part.Face(Part.Wire(curve.toShape())).extrude(FreeCAD.Vector(0.0, 0.0, HEIGHT))
    t = np.linspace(0.0, 6.0, AROUND, endpoint=False)
    ring = np.array([tuple(curve.value(x)) for x in t.tolist()])
    nodes = np.concatenate([ring + [0.0, 0.0, z] for z in np.linspace(0.0, HEIGHT, UP)])
    ends = ring.mean(axis=0) + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, HEIGHT]])
    number = np.arange(UP * AROUND).reshape(UP, AROUND)
    after = np.roll(number, -1, axis=1)
    low = np.stack([number[:-1], after[:-1], after[1:]], axis=2).reshape(-1, 3)
    high = np.stack([number[:-1], after[1:], number[1:]], axis=2).reshape(-1, 3)
    discs = [
        np.column_stack([number[row], after[row], np.full(AROUND, UP * AROUND + k)])
        for k, row in enumerate((0, -1))
    ]
    nodes = np.concatenate([nodes, ends])
    rows = {}
    for k, face in enumerate(solid.Faces, start=1):
        flat = face.Surface.TypeId == "Part::GeomPlane"
        own = discs[int(face.CenterOfMass.z > 1.0)] if flat else np.concatenate([low, high])
        rows[f"Face{k}"] = ("tri3", own)
    axis = FreeCAD.Vector(1.0, 2.0, 3.0)
    solid.rotate(FreeCAD.Vector(), axis, request.param)
    turn = FreeCAD.Rotation(axis, request.param)
    nodes = np.array([tuple(turn.multVec(FreeCAD.Vector(*point))) for point in nodes.tolist()])
    return solid, MeshArrays(nodes, {}, rows)


def test_nodes_at_the_rim_of_an_extruded_spline_are_found(cam):
    solid, arrays = cam
    wall = next(
        k for k, face in enumerate(solid.Faces, start=1) if "Extrusion" in face.Surface.TypeId
    )
    mesh = build(arrays)
    known = {name: set((np.unique(rows) + 1).tolist()) for name, (_, rows) in arrays.faces.items()}
    missed = known[f"Face{wall}"] - set(mesh.getNodesByFace(solid.Faces[wall - 1]))
    assert missed  # FreeCAD's own search on the body
    found = cover(arrays, solid)
    assert found.converted == (f"Face{wall}",) and found.lost == () and found.faces == 3
    assert any(f"Face{wall}" in note and "B-spline" in note for note in found.notes)
    for number, face in enumerate(found.copy.Faces, start=1):
        assert set(mesh.getNodesByFace(face)) == known[f"Face{number}"]
        assert face.CenterOfMass.distanceToPoint(solid.Faces[number - 1].CenterOfMass) < 1e-2
    assert found.copy.isValid() and found.copy.isClosed()
    # the plane ends stay planes, in which FreeCAD searches fast
    kinds = sorted(face.Surface.TypeId for face in found.copy.Faces)
    assert kinds == ["Part::GeomBSplineSurface", "Part::GeomPlane", "Part::GeomPlane"]
    for number, edge in enumerate(found.copy.Edges, start=1):
        other = solid.Edges[number - 1]
        assert len(mesh.getNodesByEdge(edge)) == len(mesh.getNodesByEdge(other)) > 1


def test_nodes_beside_the_border_of_a_plane_are_found(cam, monkeypatch):
    # distances from surfaces do not tell them, and a spread sample of nodes leaves them out
    solid, arrays = cam
    rim = (UP - 1) * AROUND + np.arange(AROUND)
    middle = arrays.nodes[rim].mean(axis=0)
    for node, off in ((rim[7], 5e-6), (rim[31], 2e-5)):
        away = arrays.nodes[node] - middle
        arrays.nodes[node] += off * away / np.linalg.norm(away)
    monkeypatch.setattr(node_search, "SAMPLED_NODES", 3 * 4)
    places = SimpleNamespace(
        body=SimpleNamespace(cover=SimpleNamespace(inside=())),
        tolerance=1e-3,
        distances=lambda known, nodes: {
            name: surface_distances(solid.Faces[int(name[4:]) - 1], nodes[own]).max()
            for name, own in known.items()
        },
    )
    found = cover(arrays, solid, places, seconds=0.0)
    mesh = build(arrays)
    for number, face in enumerate(found.copy.Faces, start=1):
        own = np.unique(arrays.faces[f"Face{number}"][1]) + 1
        assert set(own.tolist()) <= set(mesh.getNodesByFace(face))
    assert found.lost == () and 2e-5 < found.tolerance < 1e-4


def test_parameters_become_lengths_and_nothing_else_changes():
    quarter = Part.makeCylinder(5.0, 10.0, FreeCAD.Vector(), FreeCAD.Vector(0, 0, 1), 90.0)
    # the round face last: the others number the edges
    faces = sorted(quarter.Faces, key=lambda face: face.Surface.TypeId == "Part::GeomCylinder")
    solid = Part.Solid(Part.Shell(faces)).toNurbs().Solids[0]
    assert np.ptp(solid.Faces[4].ParameterRange[:2]) == pytest.approx(np.pi / 2)
    copy = by_length(solid, ["Face5"])
    low_u, high_u, low_v, high_v = copy.Faces[4].ParameterRange
    assert [high_u - low_u, high_v - low_v] == pytest.approx([2.5 * np.pi, 10.0], rel=1e-6)
    assert copy.isValid() and copy.Volume == pytest.approx(62.5 * np.pi, rel=1e-6)
    assert [len(copy.Faces), len(copy.Edges), len(copy.Vertexes)] == [5, 9, 6]
    # the body itself keeps its parameters
    assert np.ptp(solid.Faces[4].ParameterRange[:2]) == pytest.approx(np.pi / 2)
