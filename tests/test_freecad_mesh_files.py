# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Files of the conforming mesh, read by FreeCAD; its MED file by Gmsh too."""

import json
import os
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from box_mesh import box_mesh

from HybridVolume.errors import FaultError, InputError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Fem

import HybridVolume
from HybridVolume.core.element_jacobians import scaled_jacobian, volumes
from HybridVolume.core.elements import from_order
from HybridVolume.core.hexahedra import hexahedral_mesh
from HybridVolume.core.hybrid import HybridVolume as HV
from HybridVolume.environment import interpreter
from HybridVolume.exports import med
from HybridVolume.exports.blocks import blocks_of
from HybridVolume.exports.inp import write_inp
from HybridVolume.exports.mesh_file import write_mesh
from HybridVolume.objects.fem_mesh import AnalysisMesh, arrays_of, build, make_mesh_object
from HybridVolume.objects.stored_mesh import read_mesh
from HybridVolume.objects.volume import make_volume

SIDES = ("Face1", "Face2", "Face3", "Fläche 4", "Face5", "Face6")


def bent_mesh(order):
    """A box whose inner and outer edges are bent, so that mid nodes count."""
    mesh = box_mesh((3.0, 2.0, 1.0), SIDES, order)
    x, y, z = mesh.nodes.T
    nodes = np.column_stack([x + 0.05 * y**2, y - 0.06 * x**2 + 0.1 * z, z + 0.07 * np.sin(x + y)])
    return replace(mesh, nodes=nodes)


def volumes_of(found):
    """Volume of each element of a FreeCAD mesh, by its number."""
    kinds = {4: "tet4", 6: "penta6", 10: "tet10", 15: "penta15", 20: "hex20"}
    nodes = found.Nodes
    rows = {element: found.getElementNodes(element) for element in found.Volumes}
    sizes = {}
    for element, row in rows.items():
        kind = kinds[len(row)]
        x = np.array([tuple(nodes[node]) for node in row])
        x = x[from_order("freecad", kind, np.arange(len(row))[None])[0]]
        sizes[element] = float(volumes(kind, x[None])[0])
    return sizes


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("suffix", ["unv", "med", "inp"])
def test_freecad_reads_the_same_mesh(tmp_path, suffix, order):
    mesh = bent_mesh(order)
    path = tmp_path / f"body.{suffix}"
    write_mesh(path, mesh)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    found = Fem.read(str(path))
    table = found.Nodes
    nodes = np.array([tuple(table[number]) for number in sorted(table)])
    # decks have 14 digits of small numbers
    off = np.abs(nodes - mesh.nodes)
    assert (off <= (1e-13 * np.abs(mesh.nodes) if suffix == "inp" else 0.0)).all()
    blocks = blocks_of(mesh)
    solids = blocks[:2]
    expected = np.concatenate([volumes(b.kind, mesh.nodes[b.connectivity]) for b in solids])
    assert expected.min() > 0.0
    sizes = volumes_of(found)
    got = np.array([sizes[element] for element in sorted(sizes)])
    if suffix == "med":
        # numbers go by kind there
        expected, got = np.sort(expected), np.sort(got)
    assert np.allclose(got, expected, rtol=1e-10)
    if suffix == "inp":
        return
    groups = {found.getGroupName(g): found.getGroupElements(g) for g in found.Groups}
    names = [block.group.replace("ä", "_").replace(" ", "_") for block in blocks]
    assert sorted(groups) == sorted(names)
    for name, block in zip(names, blocks, strict=True):
        wanted = {frozenset(row) for row in (block.connectivity + 1).tolist()}
        assert {frozenset(found.getElementNodes(e)) for e in groups[name]} == wanted
        if block.dimension == 3:
            total = volumes(block.kind, mesh.nodes[block.connectivity]).sum()
            assert sum(sizes[e] for e in groups[name]) == pytest.approx(total, rel=1e-12)
            continue
        # normals as they were: the first three nodes in the same sense
        corners = {frozenset(row): row[:3] for row in (block.connectivity + 1).tolist()}
        for element in groups[name]:
            row = found.getElementNodes(element)
            own = corners[frozenset(row)]
            start = own.index(row[0])
            assert list(row[:3]) == own[start:] + own[:start]


GMSH = """
import json, sys
import gmsh
gmsh.initialize(["gmsh", "-v", "0"])
gmsh.open(sys.argv[1])
found = {"errors": gmsh.logger.getLastError(), "nodes": len(gmsh.model.mesh.getNodes()[0])}
for dimension, tag in gmsh.model.getPhysicalGroups():
    total, least, count = 0.0, 1e300, 0
    for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
        kinds, elements, _ = gmsh.model.mesh.getElements(dimension, entity)
        for kind, members in zip(kinds, elements):
            points, weights = gmsh.model.mesh.getIntegrationPoints(kind, "Gauss8")
            _, det, _ = gmsh.model.mesh.getJacobians(kind, points, entity)
            total += float((det.reshape(-1, len(weights)) @ weights).sum())
            least, count = min(least, float(det.min())), count + len(members)
    found[gmsh.model.getPhysicalName(dimension, tag)] = [dimension, count, total, least]
gmsh.finalize()
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def gmsh_python():
    python = os.environ.get("HYBRIDVOLUME_PYTHON") or str(interpreter())
    answer = subprocess.run([python, "-c", "import gmsh"], capture_output=True)
    if answer.returncode:
        pytest.skip("the worker's Python has no gmsh")
    return python


@pytest.fixture(scope="module")
def stored(tmp_path_factory, gmsh_python):
    """A hybrid volume's file, made by the worker's Python."""
    path = tmp_path_factory.mktemp("stored") / "result.npz"
    code = "import sys; from shells import make_volume; make_volume('box').save(sys.argv[1])"
    here = Path(__file__).resolve().parent
    places = os.pathsep.join([str(here.parent), str(here)])
    subprocess.run(
        [gmsh_python, "-c", code, str(path)], check=True, env={**os.environ, "PYTHONPATH": places}
    )
    return path


def test_freecad_reads_the_deck_of_hexahedra(tmp_path, stored):
    volume = HV.load(stored)
    mesh = hexahedral_mesh(volume.fem, volume.interface)
    assert len(mesh.hexes) and not len(mesh.wedges)
    write_inp(tmp_path / "body.inp", mesh)
    found = Fem.read(str(tmp_path / "body.inp"))
    assert (found.NodeCount, found.VolumeCount) == (
        len(mesh.nodes),
        len(mesh.hexes) + len(mesh.tets),
    )
    sizes = list(volumes_of(found).values())
    assert min(sizes) > 0.0 and sum(sizes) == pytest.approx(6.0, rel=1e-12)


def test_objects_and_volumes_are_exported(tmp_path, stored):
    doc = FreeCAD.newDocument("export", hidden=True, temp=True)
    try:
        body = doc.addObject("Part::Box", "Box")
        obj = make_volume(doc)
        obj.Source = body
        with pytest.raises(InputError, match="no result yet"):
            HybridVolume.export_mesh(obj, tmp_path / "a.unv")
        obj.Result = str(stored)
        obj.FemMesh = make_mesh_object(doc, "FemMesh", AnalysisMesh)
        volume = HV.load(stored)
        HybridVolume.export_mesh(volume, tmp_path / "volume.unv")
        HybridVolume.export_mesh(volume.fem, tmp_path / "mesh.unv")
        wanted = (tmp_path / "volume.unv").read_bytes()
        assert (tmp_path / "mesh.unv").read_bytes() == wanted
        for number, one in enumerate((obj, obj.FemMesh, body)):
            path = tmp_path / f"{number}.unv"
            HybridVolume.export_mesh(one, path)
            assert path.read_bytes() == wanted
        other = doc.addObject("Part::Box", "Other")
        with pytest.raises(InputError, match="Other has no hybrid volumes"):
            HybridVolume.export_mesh(other, tmp_path / "other.unv")
        with pytest.raises(InputError, match=r"\.stp"):
            HybridVolume.export_mesh(obj, tmp_path / "other.stp")
        assert not list(tmp_path.glob("other*"))
    finally:
        FreeCAD.closeDocument(doc.Name)


def test_layers_of_a_mesh_alone(stored):
    fem = HV.load(stored).fem
    found = read_mesh(build(arrays_of(fem)), "Mesh")
    assert fem.wedge_layer.max() == 1
    for name in ("nodes", "wedges", "wedge_layer", "tets", "boundary", "boundary_wedge"):
        assert np.array_equal(getattr(found, name), getattr(fem, name))
    assert np.array_equal(found.interface, fem.interface) and found.face_names == fem.face_names
    assert np.allclose(found.wedge_bound, fem.wedge_bound, rtol=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_a_mesh_alone_is_exported(tmp_path, order):
    mesh = bent_mesh(order)
    # what is not among elements and groups is not in a document's mesh either
    mesh = replace(
        mesh,
        wedge_quality=scaled_jacobian(mesh.wedge_kind, mesh.nodes[mesh.wedges]),
        tet_quality=scaled_jacobian(mesh.tet_kind, mesh.nodes[mesh.tets]),
    )
    doc = FreeCAD.newDocument("export", hidden=True, temp=True)
    try:
        obj = make_mesh_object(doc, "FemMesh", AnalysisMesh)
        obj.FemMesh = build(arrays_of(mesh))
        for suffix in ("inp", "unv", "msh"):
            write_mesh(tmp_path / f"given.{suffix}", mesh)
            HybridVolume.export_mesh(obj, tmp_path / f"stored.{suffix}")
            given, stored = (tmp_path / f"{n}.{suffix}" for n in ("given", "stored"))
            assert stored.read_bytes() == given.read_bytes()
        found = read_mesh(obj.FemMesh, "Mesh")
        assert np.array_equal(found.wedge_layer, mesh.wedge_layer)
        assert np.array_equal(found.wedge_quality, mesh.wedge_quality)
        assert min(found.wedge_bound.min(), found.tet_bound.min()) > 0.0
        # a mesh that somebody added an element to is not ours
        other = obj.FemMesh.copy()
        other.addVolume([1, 2, 3, 4])
        obj.FemMesh = other
        with pytest.raises(InputError, match="not a mesh of shell and core"):
            HybridVolume.export_mesh(obj, tmp_path / "other.msh")
        assert not (tmp_path / "other.msh").exists()
    finally:
        FreeCAD.closeDocument(doc.Name)


@pytest.mark.parametrize("order", [1, 2])
def test_gmsh_reads_the_med_file(tmp_path, gmsh_python, order):
    mesh = bent_mesh(order)
    write_mesh(tmp_path / "body.med", mesh)
    answer = subprocess.run(
        [gmsh_python, "-c", GMSH, str(tmp_path / "body.med")],
        capture_output=True,
        text=True,
        check=True,
        env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
    )
    found = json.loads(answer.stdout.splitlines()[-1])
    assert found.pop("errors") == "" and found.pop("nodes") == len(mesh.nodes)
    blocks = blocks_of(mesh)
    assert len(found) == len(blocks)
    for block in blocks:
        name = block.group.replace("ä", "_").replace(" ", "_")
        dimension, count, total, least = found[name]
        assert (dimension, count) == (block.dimension, len(block.connectivity)) and least > 0.0
        if dimension == 3:
            exact = volumes(block.kind, mesh.nodes[block.connectivity]).sum()
            assert total == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize("stem", ["a b", "Fläche 2", "part.v2", "x" * 70, "ü" * 40])
def test_med_files_of_any_name(tmp_path, stem):
    path = tmp_path / f"{stem}.med"
    write_mesh(path, bent_mesh(1))
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    # of longer names than MED's FreeCAD itself reads nothing, whoever wrote them
    if len(stem.encode()) <= 64:
        assert Fem.read(str(path)).VolumeCount == 24


def test_a_med_file_that_is_not_the_mesh_is_a_fault(tmp_path, monkeypatch):
    path = tmp_path / "body.med"
    path.write_bytes(b"old")
    whole = med._freecad_mesh

    def lossy(made, nodes, blocks):
        return whole(made, nodes, [b for b in blocks if b.group != "Core"])

    monkeypatch.setattr(med, "_freecad_mesh", lossy)
    with pytest.raises(FaultError, match="Core"):
        write_mesh(path, bent_mesh(2))
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
