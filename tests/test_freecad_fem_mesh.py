# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The FEM mesh of a document: found on faces, edges and vertices, kept by files, made again."""

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from HybridVolume.errors import FaultError, InputError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Fem
import ObjectsFem
from box_mesh import box_mesh
from made_by_hand import SIZE, face_names
from remeshed import meshed, shelled

import HybridVolume
from HybridVolume.core.density import Density
from HybridVolume.objects import density, document, node_search
from HybridVolume.objects.analysis import problems
from HybridVolume.objects.coverage import Places, cover
from HybridVolume.objects.fem_mesh import arrays_of, build, differences, element_numbers
from HybridVolume.objects.prepared_mesh import PreparedMesh
from HybridVolume.objects.volume import parameters_of, remesh_suffices, source_fingerprint
from HybridVolume.report import volume_report
from HybridVolume.sources import read_shape

BODIES = {
    "torus": {},
    "tiny torus": {"scale": 1e-3, "turn": 0.7},
    "huge torus far away": {"scale": 300.0, "turn": -2.0, "shift": (4e3, -3e3, 1e3)},
    "hollow sphere": {"turn": 1.0, "shift": (0.3, 20.0, -7.0)},
    "small box": {"scale": 1e-2, "turn": 0.2},
}


@cache
def everything():
    """Bodies by name, and their volumes with meshes."""
    bodies, volumes = {}, {}
    for name, transform in BODIES.items():
        (kind,) = [kind for kind in ("torus", "hollow sphere", "box") if kind in name]
        bodies[name], volume = shelled(kind, read=read_shape, **transform)
        volumes[name] = (volume, 1, 2)
    volumes["finer torus"] = (volumes["torus"][0], 2, 1)
    with tempfile.TemporaryDirectory() as folder:
        return bodies, meshed(volumes, Path(folder))


def made(name):
    """A body and its volume."""
    bodies, volumes = everything()
    return bodies[name], volumes[name]


@cache
def report_of(name):
    """The report of a volume."""
    return volume_report(made(name)[1], {"file": name}, {})


@pytest.fixture
def doc():
    doc = FreeCAD.newDocument("test", hidden=True, temp=True)
    doc.UndoMode = 1
    name = doc.Name
    yield doc
    if name in FreeCAD.listDocuments():
        FreeCAD.closeDocument(name)


def inserted(doc, folder, name="torus", placement=None):
    """A body with its hybrid volume in a document, and the volume itself.

    ``placement`` is that of a container; the body stands where it would stand without one.
    """
    body, volume = made(name)
    source = doc.addObject("Part::Feature", "Body")
    source.Shape = body.shape
    if placement is not None:
        container = doc.addObject("App::Part", "Container")
        container.Placement, source.Placement = placement, placement.inverse()
        container.addObject(source)
    volume.save(folder / "result.npz")
    one = document.Completed(
        body=body,
        solid=1,
        volume=volume,
        result=folder / "result.npz",
        report=report_of(name),
        parameters=parameters_of(volume),
        fingerprint=source_fingerprint(source),
    )
    doc.clearUndos()
    (obj,) = document.insert(doc, source, [document.Prepared(one)])
    return obj, volume


@pytest.mark.parametrize("name", ["huge torus far away", "hollow sphere", "small box"])
def test_every_node_is_measured_and_found(name):
    body, volume = made(name)
    arrays = arrays_of(volume.fem)
    known = {face: np.unique(rows) for face, (_, rows) in arrays.faces.items()}
    places = Places.of(volume.fem, volume.surface, body)
    found = cover(arrays, body.shape, places, seconds=60.0)
    assert found.copy is None and found.lost == () and found.faces == len(body.shape.Faces)
    assert found.edges == len(body.shape.Edges) and found.vertices == len(body.shape.Vertexes)
    assert found.nodes == found.measured == found.searched == sum(map(len, known.values()))
    assert found.distance <= min(1e-8, 1e-13 * np.abs(arrays.nodes).max())
    # the FEM workbench's own search in the whole mesh: neither more nor less, faces to vertices
    mesh, shape = build(arrays), body.shape
    face = shape.Faces[1]
    assert set(mesh.getNodesByFace(face)) == set((known["Face2"] + 1).tolist())
    corners = set()
    for edge in face.Edges:
        on_edge = set(mesh.getNodesByEdge(edge))
        other = next(
            number
            for number, one in enumerate(shape.Faces, start=1)
            if number != 2 and any(edge.isSame(e) for e in one.Edges)
        )
        shared = np.intersect1d(known["Face2"], known[f"Face{other}"])
        assert on_edge <= set((shared + 1).tolist())
        # corners, and mid nodes between them
        assert len(on_edge) % 2 == 1 and len(on_edge) >= 5
        corners |= {tuple(mesh.getNodesByVertex(vertex)) for vertex in edge.Vertexes}
    assert len(corners) == len(face.Vertexes) and all(len(nodes) == 1 for nodes in corners)


def test_what_the_search_of_freecad_misses_is_told():
    """On a body of some µm OCC's search fails at nodes that lie on the face."""
    body, volume = made("tiny torus")
    arrays = arrays_of(volume.fem)
    places = Places.of(volume.fem, volume.surface, body)
    found = cover(arrays, body.shape, places, seconds=60.0)
    assert found.distance <= 1e-16 and found.copy is None
    mesh, faces = build(arrays), body.shape.Faces
    missed = [
        name
        for name in ("Face1", "Face2", "Face3")
        if len(mesh.getNodesByFace(faces[int(name[4:]) - 1])) < len(volume.fem.face_nodes(name))
    ]
    assert [name for name in found.lost if name in ("Face1", "Face2", "Face3")] == missed
    assert found.faces == 16 - sum(name.startswith("Face") for name in found.lost)
    assert bool(found.notes) == bool(found.lost)
    if found.lost:
        assert found.lost[0] in found.notes[0]
        with pytest.raises(FaultError, match="beside the CAD faces"):
            cover(arrays, body.shape)  # where nothing else tells where they are


def test_a_node_beside_a_face_is_noticed_even_where_nobody_looked(monkeypatch):
    body, volume = made("torus")
    fem = volume.fem
    monkeypatch.setattr(node_search, "SAMPLED_NODES", 16 * 4)
    around = np.concatenate([fem.face_nodes(f) for f in fem.face_names if f != "Face5"])
    inside = np.setdiff1d(fem.face_nodes("Face5"), around)
    (node, *_) = np.setdiff1d(inside, node_search.spread_out(fem.face_nodes("Face5"), 4))

    def covered(off, places=True):
        nodes = fem.nodes.copy()
        # outward: away from the nearest point of the circle in the torus
        circle = np.array([3.0, 3.0, 0.0]) * nodes[node] / np.linalg.norm(nodes[node, :2])
        out = nodes[node] - circle
        nodes[node] += off * out / np.linalg.norm(out)
        moved = replace(fem, nodes=nodes)
        at = Places.of(moved, volume.surface, body) if places else None
        return cover(arrays_of(moved), body.shape, at, seconds=0.0)

    assert covered(1e-4, places=False).distance is None  # not in the sample
    assert covered(3e-8).copy is None
    found = covered(3e-6)
    assert found.distance == pytest.approx(3e-6, rel=1e-6)
    assert found.copy.getTolerance(1) >= found.distance and found.faces == 16
    assert body.shape.getTolerance(1) == pytest.approx(1e-7)
    with pytest.raises(FaultError, match="beside the CAD faces") as caught:
        covered(1e-3)
    assert caught.value.faces == ("Face5",)
    assert caught.value.figure == pytest.approx(1e-3, rel=1e-6)


def test_nodes_beside_all_faces(doc):
    box = doc.addObject("Part::Box", "Box")
    box.Length, box.Width, box.Height = SIZE
    doc.recompute()
    names = face_names(box.Shape)
    fem = box_mesh(SIZE, names)
    found = cover(arrays_of(fem), box.Shape)
    assert found.copy is None and (found.faces, found.edges, found.vertices) == (6, 12, 8)
    moved = fem.nodes.copy()
    moved[fem.face_nodes(names[5]), 2] += 2e-6
    found = cover(arrays_of(replace(fem, nodes=moved)), box.Shape)
    assert 4e-6 <= found.copy.getTolerance(1) < 5e-6 and found.lost == ()
    assert box.Shape.getTolerance(1) == pytest.approx(1e-7)
    moved[fem.face_nodes(names[5]), 2] += 1e-3
    with pytest.raises(FaultError, match="beside the CAD faces") as caught:
        cover(arrays_of(replace(fem, nodes=moved)), box.Shape)
    assert set(caught.value.faces) == set(names) - {names[4]}


def test_a_face_so_wide_that_it_takes_its_neighbours():
    body, volume = made("torus")
    wide = body.shape.copy()
    wide.fixTolerance(1.0)
    with pytest.raises(FaultError, match="elements of their neighbours"):
        cover(arrays_of(volume.fem), wide, seconds=60.0)


def test_of_many_faces_some_are_looked_at_and_all_are_measured(monkeypatch):
    body, volume = made("torus")
    monkeypatch.setattr(node_search, "SAMPLED_FACES", 5)
    monkeypatch.setattr(node_search, "SAMPLED_NODES", 16 * 4)
    fem = volume.fem
    places = Places.of(fem, volume.surface, body)
    found = cover(arrays_of(fem), body.shape, places, seconds=0.0)
    assert found.searched == 5 * 4 and found.measured == found.nodes
    assert (found.faces, found.edges, found.vertices) == (16, 32, 16) and found.lost == ()
    # without parameters of the nodes nothing else tells where they are: all faces are looked at
    assert cover(arrays_of(fem), body.shape, seconds=0.0).searched == 16 * 4
    # what is missed on one of the five is looked for on all
    search = node_search.Search(
        arrays := arrays_of(fem),
        {name: np.unique(rows) for name, (_, rows) in arrays.faces.items()},
        body.shape.translated(FreeCAD.Vector(0.0, 0.0, 1e-3)),
        0.0,
        spread=True,
    )
    assert search.result.searched == 16 * 4 and len(search.result.bad) == 16


def test_an_edge_without_nodes_is_told():
    body, volume = made("small box")
    search = node_search.Search(
        arrays := arrays_of(volume.fem),
        {name: np.unique(rows) for name, (_, rows) in arrays.faces.items()},
        body.shape.translated(FreeCAD.Vector(0.0, 0.0, 1e-4)),
        0.0,
    )
    assert len(search.result.lost) == 12 + 8 and search.result.edges == 0
    assert max(search.result.off.values()) == pytest.approx(1e-4, rel=1e-6)


def test_files_keep_every_bit(doc, tmp_path):
    obj, volume = inserted(doc, tmp_path, "huge torus far away")
    prepared = PreparedMesh(volume.fem, None)
    assert obj.Report["fem.face_nodes_measured"] == obj.Report["fem.face_nodes"]
    path = tmp_path / "saved.FCStd"
    doc.saveAs(str(path))
    FreeCAD.closeDocument(doc.Name)
    again = FreeCAD.openDocument(str(path), hidden=True)
    try:
        obj = again.HybridVolume
        assert prepared.differences(obj) == []
        mesh, numbers = obj.FemMesh.FemMesh, element_numbers(prepared.arrays)
        (core,) = [g for g in mesh.Groups if mesh.getGroupName(g) == "Core"]
        assert sorted(mesh.getGroupElements(core)) == list(numbers["Core"])
        again.recompute(None, True)
        assert obj.Status == obj.FemMesh.Status == "Up to date"
        # a mesh that is not the same is told from it
        nodes = volume.fem.nodes.copy()
        nodes[7, 1] = np.nextafter(nodes[7, 1], np.inf)
        other = replace(prepared.arrays, nodes=nodes)
        assert differences(mesh, other) == ["1 nodes elsewhere"]
        kind, rows = prepared.arrays.volumes["Core"]
        rows = rows.copy()
        rows[2, [4, 5]] = rows[2, [5, 4]]
        other = replace(prepared.arrays, volumes={**prepared.arrays.volumes, "Core": (kind, rows)})
        assert differences(mesh, other) == ["1 volumes of Core with other nodes"]
        lost = replace(prepared.arrays, node_groups={"Interface": np.arange(5)})
        assert differences(mesh, lost)[0].endswith("members of group Interface, not 5")
    finally:
        FreeCAD.closeDocument(again.Name)


@pytest.mark.parametrize("moved", [False, True], ids=["alone", "in a moved container"])
def test_the_fem_workbench_finds_nodes_for_loads(doc, tmp_path, moved):
    from femmesh.meshtools import get_femnodes_by_refshape

    placement = FreeCAD.Placement(FreeCAD.Vector(5.0, 0.0, 1.0), FreeCAD.Vector(1, 1, 0), 30.0)
    obj, volume = inserted(doc, tmp_path, "small box", placement if moved else None)
    fem, mesh, body = volume.fem, obj.FemMesh.FemMesh, obj.FemMesh.Shape
    assert (body is obj.AnalysisBody) == moved and (body is obj.Source) != moved
    if moved:
        with pytest.raises(InputError, match="a container moves Body"):
            document.insert_mesh(doc, fem, obj.Source)
    analysis = HybridVolume.make_analysis(obj)
    fixed = ObjectsFem.makeConstraintFixed(doc)
    analysis.addObject(fixed)
    for held, wrong in ((body, False), (obj.Source, moved)):
        fixed.References = [(held, "Face1")]
        told = [error.line for error in problems(analysis) if "was meshed" in error.line]
        assert bool(told) == wrong
    for number in (1, 4):
        found = get_femnodes_by_refshape(mesh, (body, [f"Face{number}"]))
        assert sorted(set(found)) == (fem.face_nodes(f"Face{number}") + 1).tolist()
    points = np.array([tuple(v.Point) for v in body.Shape.Vertexes])
    for number, edge in enumerate(body.Shape.Edges[:4], start=1):
        found = sorted(set(get_femnodes_by_refshape(mesh, (body, [f"Edge{number}"]))))
        # straight edges: their nodes are those between the ends
        a, b = (np.array(tuple(v.Point)) for v in edge.Vertexes)
        along = (fem.nodes - a) @ (b - a) / edge.Length**2
        off = np.linalg.norm(fem.nodes - a - along[:, None] * (b - a), axis=1)
        between = (along > -1e-9) & (along < 1.0 + 1e-9) & (off < 1e-9)
        assert found == (np.flatnonzero(between) + 1).tolist() and len(found) >= 5
    for number in (1, 8):
        found = set(get_femnodes_by_refshape(mesh, (body, [f"Vertex{number}"])))
        distance = np.linalg.norm(fem.nodes - points[number - 1], axis=1)
        assert found == {int(distance.argmin()) + 1} and distance.min() < 1e-12


def test_a_file_that_lost_something_is_no_success(doc, tmp_path, monkeypatch):
    body, volume = made("torus")
    volume.save(tmp_path / "result.npz")
    source = doc.addObject("Part::Feature", "Body")
    source.Shape = body.shape
    one = document.Prepared(
        document.Completed(
            body,
            1,
            volume,
            tmp_path / "result.npz",
            report_of("torus"),
            parameters_of(volume),
            source_fingerprint(source),
        )
    )
    document.save_new([one], tmp_path / "good.FCStd")
    open_document = FreeCAD.openDocument

    def forgetful(path, hidden):
        opened = open_document(path, hidden=hidden)
        mesh = Fem.FemMesh()
        for number, point in opened.FemMesh.FemMesh.Nodes.items():
            mesh.addNode(*point, number)
        opened.FemMesh.FemMesh = mesh
        return opened

    monkeypatch.setattr(document.FreeCAD, "openDocument", forgetful)
    with pytest.raises(FaultError, match="did not store the whole mesh: FemMesh: 0 faces, not"):
        document.save_new([one], tmp_path / "bad.FCStd")


def test_another_mesh_for_the_same_shell(doc, tmp_path):
    obj, volume = inserted(doc, tmp_path)
    analysis = HybridVolume.make_analysis(obj, materials_apart=True)
    mesh = obj.FemMesh
    before = mesh.FemMesh.NodeCount
    mesh.Subdivide, mesh.FaceSizes = 2, ["Face3 = 0.2 mm"]
    doc.recompute()
    assert obj.Status == "Out of date: FemMesh.FaceSizes, FemMesh.Subdivide changed"
    assert mesh.Status == obj.Status and remesh_suffices(obj)
    finer = everything()[1]["finer torus"]
    doc.clearUndos()
    assert document.replace_mesh(obj, finer) is mesh
    assert doc.UndoCount == 1 and mesh in analysis.Group
    assert obj.Status == mesh.Status == obj.Shell.Status == "Up to date"
    assert not remesh_suffices(obj)
    assert (mesh.Order, mesh.Subdivide, list(mesh.FaceSizes)) == ("First", 2, [])
    wedges = 4 * len(volume.fem.boundary) * (len(finer.fem.wedges) // len(finer.fem.boundary))
    assert mesh.FemMesh.VolumeCount == wedges + len(finer.fem.tets)
    assert obj.Shell.Elements == obj.Shell.FemMesh.VolumeCount == wedges
    assert obj.Core.Elements == len(finer.fem.tets)
    groups = {mesh.FemMesh.getGroupName(g): g for g in mesh.FemMesh.Groups}
    for part in ("Shell", "Core"):
        members = mesh.FemMesh.getGroupElements(groups[f"{part}Material_{part}"])
        assert members == mesh.FemMesh.getGroupElements(groups[part]) and members
    assert obj.Report["fem.nodes"] == str(len(finer.fem.nodes)) == str(mesh.FemMesh.NodeCount)
    assert obj.Report["fem.faces_covered"] == "16" and obj.Report["fem.penta15"] == "0"
    again = HybridVolume.core.hybrid.HybridVolume.load(obj.Result)
    assert np.array_equal(again.fem.nodes, finer.fem.nodes) and again.fem.order == 1
    assert again.fem.density == Density(subdivide=2)
    doc.undo()
    assert mesh.FemMesh.NodeCount == before and mesh.Order == "Second"
    assert obj.Status.startswith("Out of date") and list(mesh.FaceSizes) == ["Face3 = 0.2 mm"]
    doc.redo()
    assert mesh.FemMesh.VolumeCount == wedges + len(finer.fem.tets)


def test_meshes_that_do_not_belong_to_a_volume(doc, tmp_path):
    obj, volume = inserted(doc, tmp_path)
    layers = volume.shell.layers.copy()
    layers[-1, 0] *= 1.0 + 1e-12
    other = replace(volume, shell=replace(volume.shell, layers=layers))
    nodes = obj.FemMesh.FemMesh.NodeCount
    with pytest.raises(InputError, match="belongs to another shell"):
        document.replace_mesh(obj, other)
    obj.Source.Placement.move(FreeCAD.Vector(1.0, 0.0, 0.0))
    doc.recompute()
    with pytest.raises(InputError, match="out of date: the body changed"):
        document.replace_mesh(obj.FemMesh, volume)
    assert not remesh_suffices(obj) and obj.FemMesh.FemMesh.NodeCount == nodes
    obj.FemMesh.FaceSizes = ["Face3 is fine"]
    doc.recompute()
    assert obj.Status.startswith("Failed: 'Face3 is fine' is no size of elements at a face")
    with pytest.raises(InputError, match="Box has no hybrid volumes"):
        document.replace_mesh(doc.addObject("Part::Box", "Box"), volume)


def test_a_mesh_alone_tells_when_its_body_changed(doc):
    box = doc.addObject("Part::Box", "Box")
    box.Length, box.Width, box.Height = SIZE
    doc.recompute()
    mesh = document.insert_mesh(doc, box_mesh(SIZE, face_names(box.Shape)), box)
    doc.recompute()
    assert mesh.Status == "Up to date"
    box.Width = 2.5
    doc.recompute()
    assert mesh.Status == "Out of date: the body changed"
    with pytest.raises(InputError, match="out of date: the body changed"):
        HybridVolume.make_analysis(mesh)
    box.Width = 2.0
    doc.recompute()
    assert mesh.Status == "Up to date"
    mesh.Layers = 3
    doc.recompute()
    assert mesh.Status == "Out of date: FemMesh.Layers changed"


@pytest.mark.parametrize(
    "wanted",
    [
        Density(),
        Density("greville", subdivide=2, layers=4, growth=1.7),
        Density(size=0.125, face_sizes={"Face3": 0.1, "Face12": 1e-3}, gradation=0.2),
    ],
)
def test_density_in_the_property_editor(doc, wanted):
    values = density.density_parameters(wanted)
    assert density.density_of(values) == wanted
    mesh = doc.addObject("Fem::FemMeshObjectPython", "FemMesh")
    document.AnalysisMesh(mesh)
    density.set_values(mesh, values)
    assert density.density_of(density.values_of(mesh)) == wanted
    hidden = {n for n in density.DEFAULTS if "Hidden" in mesh.getEditorMode(n)}
    assert hidden == ({"Size", "FaceSizes", "Gradation"} if wanted.nodes == "greville" else set())
    told = density.relevant(values)
    assert ("Gradation" in told) == bool(wanted.face_sizes)
    assert ("Growth" in told) == (not wanted.plain)
