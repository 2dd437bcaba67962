# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies that were covered with patches, in documents: loads and supports go on the CAD faces."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from HybridVolume.errors import FaultError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import ObjectsFem
import Part

import HybridVolume
from HybridVolume import sources
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.elements import from_order
from HybridVolume.core.finite_elements import FiniteElementMesh
from HybridVolume.core.midstructure import Midstructure, Sheet
from HybridVolume.core.nodal_forces import nodal_forces
from HybridVolume.core.recovery import Material
from HybridVolume.objects import document
from HybridVolume.objects.coverage import cover
from HybridVolume.objects.face_geometry import face_colours
from HybridVolume.objects.fem_mesh import MeshArrays, build
from HybridVolume.objects.node_places import Places
from HybridVolume.objects.volume import source_fingerprint
from HybridVolume.sources.covering import Covering
from HybridVolume.sources.distances import surface_distances

RADIUS = 5.0


def rod():
    """A round rod with an oblique end: two planes and a cylinder that is no rectangle."""
    body = Part.makeCylinder(RADIUS, 24.0)
    knife = Part.makeBox(60.0, 60.0, 60.0, FreeCAD.Vector(-30.0, -30.0, 0.0))
    knife.rotate(FreeCAD.Vector(), FreeCAD.Vector(1.0, 0.0, 0.0), 30.0)
    knife.translate(FreeCAD.Vector(0.0, 0.0, 16.0))
    return body.cut(knife).Solids[0]


def plane_face(solid, inclined):
    """Number, from 1, of the flat or of the oblique end of the rod."""
    return next(
        number
        for number, face in enumerate(solid.Faces, start=1)
        if face.Surface.TypeId == "Part::GeomPlane"
        and (abs(face.Surface.Axis.z) < 0.99) == inclined
    )


@pytest.fixture(scope="module")
def covered(python):
    (body,) = sources.read_shape(rod(), "Rod", python=python)
    return body, build_surface(list(body.faces))


def outside(body, surface, nodes=4):
    """A triangulation of the surface as the boundary of a mesh, and where its nodes are."""
    mesh = surface.triangulation(nodes)
    names = np.array([patch.face for patch in surface.patches])[mesh.triangle_patch]
    faces = {
        name: ("tri3", mesh.triangles[names == name])
        for name in dict.fromkeys(patch.face for patch in surface.patches)
    }
    places = Places(surface, body, mesh.vertex_patch, mesh.vertex_uv, body.cover.tolerance)
    return MeshArrays(mesh.vertices, {}, faces), places


@pytest.mark.parametrize(
    "face",
    [
        Part.makeCylinder(4.0, 9.0).Faces[0],
        Part.makeCone(5.0, 2.0, 9.0).Faces[0],
        Part.makeCone(0.0, 2.0, 9.0).Faces[0],
        Part.makeSphere(4.0).Faces[0],
        Part.makeTorus(7.0, 2.0).Faces[0],
        Part.makeBox(2.0, 3.0, 4.0).Faces[4],
        Part.makeSphere(4.0).toNurbs().Faces[0],
        Part.Wire(Part.makeCircle(3.0)).extrude(FreeCAD.Vector(1.0, 2.0, 6.0)).Faces[0],
    ],
    ids=lambda face: face.Surface.TypeId,
)
def test_distances_are_those_of_occ(face):
    face = face.copy()
    face.rotate(FreeCAD.Vector(), FreeCAD.Vector(1.0, 2.0, 3.0), 40.0)
    face.translate(FreeCAD.Vector(100.0, -20.0, 7.0))
    rng = np.random.default_rng(4)
    u0, u1, v0, v1 = face.ParameterRange
    share = rng.uniform(0.05, 0.95, (40, 2))
    points = np.array(
        [tuple(face.valueAt(u0 + s * (u1 - u0), v0 + t * (v1 - v0))) for s, t in share.tolist()]
    )
    points += rng.uniform(-0.05, 0.05, points.shape)
    found = surface_distances(face, points)
    for point, distance in zip(points.tolist(), found.tolist(), strict=True):
        assert distance == pytest.approx(Part.Vertex(*point).distToShape(face)[0], abs=1e-7)


def test_distances_beside_a_seam():
    line = Part.BSplineCurve()
    line.interpolate([FreeCAD.Vector(r, 0.0, z) for r, z in ((9, 0), (5, 8), (8, 15), (7, 25))])
    face = line.toShape().revolve(FreeCAD.Vector(), FreeCAD.Vector(0.0, 0.0, 1.0), 360.0).Faces[0]
    u0, u1, v0, v1 = face.ParameterRange
    u = u0 + (u1 - u0) * np.array([0.0, 1e-3, 0.02, 0.1, 0.9, 0.98, 0.999])
    points = [tuple(face.valueAt(s, t)) for s in u for t in np.linspace(v0, v1, 60)]
    assert surface_distances(face, np.array(points)).max() < 1e-12


def test_faces_within_a_tolerance_are_found_on_a_copy(covered):
    body, surface = covered
    arrays, places = outside(body, surface)
    known = {name: np.unique(rows) for name, (_, rows) in arrays.faces.items()}
    # on the body itself FreeCAD finds only a part of them
    wall = next(k for k, kind in enumerate(body.cover.kinds, start=1) if kind == "tolerance")
    mesh = build(arrays)
    assert len(mesh.getNodesByFace(body.shape.Faces[wall - 1])) < len(known[f"Face{wall}"])
    found = cover(arrays, body.shape, places)
    assert found.faces == 3 and found.lost == () and found.widened == (f"Face{wall}",)
    assert (found.edges, found.vertices) == (3, 2) and found.measured == found.nodes
    assert 1e-6 < found.distance <= body.cover.tolerance
    assert found.distance < found.tolerance <= 2.0 * found.distance
    assert body.shape.getTolerance(1) < 1e-6  # the body itself stays
    assert any(f"Face{wall}" in note and "copy" in note for note in found.notes)
    assert found.figures()["faces_widened"] == [f"Face{wall}"]
    for number, face in enumerate(found.copy.Faces, start=1):
        assert set(mesh.getNodesByFace(face)) == set((known[f"Face{number}"] + 1).tolist())
        # planes are exact, and are not made wider
        assert (face.Tolerance < 1e-6) == (number != wall)
    # the seam is no side of two faces: the line of nodes along it is found all the same
    lines = [len(mesh.getNodesByEdge(edge)) for edge in found.copy.Edges]
    assert min(lines) >= 6
    assert all(len(mesh.getNodesByVertex(one)) == 1 for one in found.copy.Vertexes)


def test_nodes_off_by_more_than_the_patches_were_allowed_are_a_fault(covered):
    body, surface = covered
    arrays, places = outside(body, surface)
    end = f"Face{plane_face(body.shape, inclined=True)}"
    moved = arrays.nodes.copy()
    moved[np.unique(arrays.faces[end][1])] += [0.0, 0.0, 2.0 * body.cover.tolerance]
    with pytest.raises(FaultError, match="beside the CAD faces") as caught:
        cover(MeshArrays(moved, {}, arrays.faces), body.shape, places)
    assert end in caught.value.faces
    assert caught.value.figure == pytest.approx(2.0 * body.cover.tolerance, rel=0.5)


def test_a_tolerance_wider_than_the_elements_is_told(covered):
    """Where the faces' tolerance takes nodes of the neighbours, loads would reach too far."""
    body, surface = covered
    arrays, places = outside(body, surface)
    wall = next(k for k, kind in enumerate(body.cover.kinds, start=1) if kind == "tolerance")
    # a node inside the body, a micrometre below the wall: as a very thin first layer has it
    (corner, *_), rows = np.unique(arrays.faces[f"Face{wall}"][1]), arrays.faces[f"Face{wall}"][1]
    row = next(row for row in rows if corner in row)
    middle = arrays.nodes[row].mean(axis=0)
    inward = np.array([middle[0], middle[1], 0.0]) / np.hypot(*middle[:2])
    below = arrays.nodes[row[0]] - 1e-6 * inward
    nodes = np.vstack([arrays.nodes, below])
    tet = np.array([[*row, len(arrays.nodes)]])
    found = cover(MeshArrays(nodes, {"Shell": ("tet4", tet)}, arrays.faces), body.shape, places)
    assert found.crowded == found.lost == (f"Face{wall}",) and found.faces == 2
    assert any("reach too far" in note for note in found.notes)


def star_mesh(body, surface, nodes):
    """A mesh of a body that its middle sees all of: wedges outside, tetrahedra to the middle."""
    mesh = surface.triangulation(nodes)
    count = len(mesh.vertices)
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    inner = middle + 0.7 * (mesh.vertices - middle)
    below = mesh.triangles + count
    names = tuple(dict.fromkeys(patch.face for patch in surface.patches))
    face = np.array([names.index(patch.face) for patch in surface.patches])
    ones = np.ones(len(below))
    return FiniteElementMesh(
        order=1,
        nodes=np.vstack([mesh.vertices, inner, middle]),
        wedges=np.hstack([below, mesh.triangles]),
        wedge_patch=mesh.triangle_patch,
        wedge_layer=np.zeros(len(below), dtype=int),
        tets=np.column_stack([below[:, ::-1], np.full(len(below), 2 * count)]),
        boundary=mesh.triangles,
        boundary_face=face[mesh.triangle_patch],
        boundary_wedge=np.arange(len(below)),
        interface=below,
        face_names=names,
        wedge_quality=ones,
        tet_quality=ones,
        wedge_bound=ones,
        tet_bound=ones,
        surface_nodes=np.arange(count),
        surface_patch=mesh.vertex_patch,
        surface_uv=mesh.vertex_uv,
    )


@pytest.fixture
def doc():
    doc = FreeCAD.newDocument("test", hidden=True, temp=True)
    doc.UndoMode = 1
    name = doc.Name
    yield doc
    if name in FreeCAD.listDocuments():
        FreeCAD.closeDocument(name)


@pytest.fixture
def volume(doc, covered, tmp_path, request):
    """The rod in a document, as if the worker had completed it; a parameter: how fine the mesh."""
    body, surface = covered
    source = doc.addObject("Part::Feature", "Rod")
    source.Shape = body.shape
    sheet = Sheet(("Face1", "Face1"), 2.0, (0.5, 0.5), (180.0, 180.0), True, "", (0.0, 0.0, 9.0))
    midstructure = Midstructure(
        vertices=np.array([[0.0, 0.0, 8.0], [1.0, 0.0, 8.0], [0.0, 1.0, 9.0]]),
        facets=np.array([[0, 1, 2]]),
        sheet=np.array([0]),
        kept=np.array([True]),
        radius=np.full(3, 4.0),
        sheets=(sheet,),
    )
    result = tmp_path / "result.npz"
    np.savez(result, stored=np.arange(5.0))
    fem = star_mesh(body, surface, getattr(request, "param", 4))
    completed = document.Completed(
        body=body,
        solid=1,
        volume=SimpleNamespace(fem=fem, midstructure=midstructure, surface=surface),
        result=result,
        report={
            "input": {"file": "rod.step", **body.origin},
            "shell": {"w0": 0.3, "elements": len(fem.wedges), "min_scaled_jacobian": 0.5},
            "fem": {"nodes": len(fem.nodes)},
        },
        parameters={"FemMesh.Order": "First", "Midstructure.Method": "auto"},
        fingerprint=source_fingerprint(source),
    )
    (obj,) = document.insert(doc, source, [document.Prepared(completed)])
    return obj


def found_on_faces(mesh, shape):
    """Faces on which FreeCAD finds exactly the nodes of the mesh's group of the face."""
    found = []
    for group in mesh.Groups:
        name = mesh.getGroupName(group)
        if name.startswith("Face"):
            own = {n for e in mesh.getGroupElements(group) for n in mesh.getElementNodes(e)}
            if set(mesh.getNodesByFace(shape.Faces[int(name[4:]) - 1])) == own:
                found.append(name)
    return found


def test_the_document_says_what_became_of_each_face(volume, covered, tmp_path):
    body, surface = covered
    doc = volume.Document
    assert volume.Status == "Up to date"
    assert (volume.FacesBit, volume.FacesExact, volume.FacesTolerance) == (0, 2, 1)
    assert volume.Patches == len(surface.patches) and "2 exact" in volume.FacesKept
    assert volume.FaceDeviation.Value == pytest.approx(body.cover.deviation.max(), rel=1e-6)
    colours = face_colours(volume)
    # a kind of property that FreeCAD's property editor shows
    assert volume.getTypeIdOfProperty("FaceGeometry") == "App::PropertyStringList"
    assert [line.split(" = ")[0] for line in volume.FaceGeometry] == ["Face1", "Face2", "Face3"]
    assert list(colours) == ["Face1", "Face2", "Face3"]
    assert [one.kind for one in colours.values()] == list(body.cover.kinds)
    assert [one.patches for one in colours.values()] == np.bincount(body.cover.origin).tolist()
    worst = max(one.deviation for one in colours.values())
    assert worst == pytest.approx(body.cover.deviation.max(), rel=0.01)
    assert "input.geometry.sentence" in volume.Report
    # loads go on a copy, on which all is found; the body is no place for them
    assert volume.FemMesh.Shape == volume.AnalysisBody != volume.Source
    assert 0.0 < volume.FemMesh.FaceTolerance.Value <= 2.0 * body.cover.tolerance
    analysis = HybridVolume.make_analysis(volume)
    assert analysis.LoadsOn.startswith(volume.AnalysisBody.Label)
    assert "tolerances of up to" in analysis.LoadsOn
    # another tolerance is another cover
    volume.CoverTolerance = 0.5
    doc.recompute()
    assert volume.Status == volume.FemMesh.Status == "Out of date: CoverTolerance changed"
    volume.CoverTolerance = 0.0
    doc.recompute()
    assert volume.Status == "Up to date"
    doc.saveAs(str(tmp_path / "rod.FCStd"))
    FreeCAD.closeDocument(doc.Name)
    again = FreeCAD.openDocument(str(tmp_path / "rod.FCStd"), hidden=True)
    try:
        volume = again.HybridVolume
        again.recompute(None, True)
        assert volume.Status == volume.FemMesh.Status == "Up to date"
        assert face_colours(volume) == colours
        shape = volume.FemMesh.Shape.Shape
        assert len(found_on_faces(volume.FemMesh.FemMesh, shape)) == 3
    finally:
        FreeCAD.closeDocument(again.Name)


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is absent")
@pytest.mark.parametrize("volume", [2], indirect=True)
def test_a_pressure_on_a_cad_face_is_area_times_pressure(volume, tmp_path):
    doc, body = volume.Document, volume.FemMesh.Shape
    analysis = HybridVolume.make_analysis(volume)
    assert analysis.LoadsOn.startswith(body.Label)
    pressed = plane_face(body.Shape, inclined=True)
    held = plane_face(body.Shape, inclined=False)
    fixed = ObjectsFem.makeConstraintFixed(doc)
    fixed.References = [(body, f"Face{held}")]
    pressure = ObjectsFem.makeConstraintPressure(doc)
    pressure.References = [(body, f"Face{pressed}")]
    pressure.Pressure = 2.0 if FreeCAD.Version()[0] == "0" else "2.0 MPa"
    analysis.addObjects([fixed, pressure])
    doc.recompute()
    HybridVolume.solve(analysis, tmp_path / "ccx")
    result = doc.HybridVolume_Results
    mesh = volume.FemMesh.FemMesh
    nodes = np.array([tuple(mesh.Nodes[n]) for n in sorted(mesh.Nodes)])
    order = np.argsort(result.NodeNumbers)
    moved = np.array([tuple(vector) for vector in result.DisplacementVectors])[order]
    rows = [mesh.getElementNodes(element) for element in mesh.Volumes]
    elements = [
        (kind, from_order("freecad", kind, np.array([row for row in rows if len(row) == size]) - 1))
        for kind, size in (("penta6", 6), ("tet4", 4))
    ]
    force = nodal_forces(nodes, elements, moved, Material(210000.0, 0.3).stress).force
    on = np.array(mesh.getNodesByFace(body.Shape.Faces[pressed - 1])) - 1
    # an ellipse: the circle's area over the cosine; the triangles cut its rim off
    area = np.pi * RADIUS**2 / np.cos(np.radians(30.0))
    normal = np.array([0.0, -np.sin(np.radians(30.0)), np.cos(np.radians(30.0))])
    assert force[on].sum(axis=0) == pytest.approx(-2.0 * area * normal, abs=0.02 * 2.0 * area)
    other = np.array(mesh.getNodesByFace(body.Shape.Faces[held - 1])) - 1
    assert force[other].sum(axis=0) == pytest.approx(2.0 * area * normal, abs=0.02 * 2.0 * area)
    assert any(text.startswith(f"Face{pressed}: pressure") for text in result.FaceLoads)


def test_meshing_again_takes_the_patches_that_are_there(doc, python, tmp_path, monkeypatch):
    source = doc.addObject("Part::Sphere", "Ball")
    source.Radius = 3.0
    doc.recompute()
    (volume,) = HybridVolume.edit_volume(source).complete(thickness="0.3", layers=1, python=python)
    assert volume.FacesKept.startswith("1 face: 1 exact") and volume.Patches == 6
    before = volume.FemMesh.FemMesh.NodeCount
    path = tmp_path / "ball.FCStd"
    doc.saveAs(str(path))
    FreeCAD.closeDocument(doc.Name)
    again = FreeCAD.openDocument(str(path), hidden=True)
    try:
        volume = again.HybridVolume
        assert volume.Status == "Up to date"
        monkeypatch.setattr(Covering, "start", lambda *_, **__: pytest.fail("covered again"))
        HybridVolume.remesh(volume, subdivide=2, python=python)
        assert volume.Status == volume.FemMesh.Status == "Up to date"
        assert volume.FemMesh.FemMesh.NodeCount > 1.5 * before
        assert volume.FacesKept.startswith("1 face: 1 exact")
        assert found_on_faces(volume.FemMesh.FemMesh, again.Ball.Shape) == ["Face1"]
        volume.CoverTolerance = 0.01
        again.recompute()
        assert volume.Status == "Out of date: CoverTolerance changed"
    finally:
        FreeCAD.closeDocument(again.Name)
