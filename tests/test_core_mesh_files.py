# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Files of the conforming mesh, read by Gmsh and VTK: every element, its volume and its group."""

import json
import subprocess
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from shells import make_volume

from HybridVolume.core import atomic
from HybridVolume.core.elements import quadrature, shape_gradients
from HybridVolume.errors import InputError
from HybridVolume.exports.blocks import blocks_of, plain_names
from HybridVolume.exports.mesh_file import FORMATS, NEED_FREECAD, check_format, write_mesh

MESHES = {
    "torus": lambda: make_volume("torus").fem,
    "linear hollow sphere": lambda: make_volume("hollow sphere", 1).fem,
    "odd names": lambda: replace(
        make_volume("box").fem,
        face_names=("Shell", "Interface", "Face3", "Core", "Fläche 5", "Interface_2"),
    ),
    "tiny and far away": lambda: _moved(make_volume("box").fem, 1e-3, [900.0, -700.0, 1e-5]),
}


def _moved(mesh, size, offset):
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    return replace(mesh, nodes=size * mesh.nodes @ turn + offset)


@cache
def mesh_named(name):
    """One of `MESHES`, and the size (area or volume) of each of its groups."""
    mesh = MESHES[name]()
    sizes = {}
    for block in blocks_of(mesh):
        shape = block.kind.rstrip("0123456789")
        points, weights = quadrature(shape, 5)
        # from the first node on, so that a small mesh far away has figures as exact as any
        x = mesh.nodes[block.connectivity]
        x = x - x[:, :1]
        j = np.einsum("enc,mnd->emcd", x, shape_gradients(block.kind, points))
        sizes[block.group] = float((_measure(j) @ weights).sum())
    return mesh, sizes


def _measure(j):
    """Volume or area that Jacobians (..., 3, dim) stand for."""
    if j.shape[-1] == 3:
        return np.linalg.det(j)
    return np.linalg.norm(np.cross(j[..., 0], j[..., 1]), axis=-1)


# in a process of its own: Gmsh keeps state, and takes over signals
GMSH = """
import json, sys
import gmsh
import numpy as np
gmsh.initialize(["gmsh", "-v", "0"])
gmsh.open(sys.argv[1])
found = {"groups": [], "errors": gmsh.logger.getLastError()}
numbers, places, _ = gmsh.model.mesh.getNodes()
found["nodes"] = places.reshape(-1, 3)[np.argsort(numbers)].tolist()
for dimension, tag in gmsh.model.getPhysicalGroups():
    group = {"dimension": dimension, "number": tag, "count": 0, "size": 0.0, "least": 1e300}
    group["name"] = gmsh.model.getPhysicalName(dimension, tag)
    group["normal"] = [0.0, 0.0, 0.0]
    for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
        kinds, elements, _ = gmsh.model.mesh.getElements(dimension, entity)
        for kind, numbers in zip(kinds, elements):
            points, weights = gmsh.model.mesh.getIntegrationPoints(kind, "Gauss8")
            j, det, _ = gmsh.model.mesh.getJacobians(kind, points, entity)
            group["count"] += len(numbers)
            group["size"] += float((det.reshape(-1, len(weights)) @ weights).sum())
            group["least"] = min(group["least"], float(det.min()))
            # the third column of a face's Jacobian is its normal of length one
            normal = j.reshape(-1, len(weights), 3, 3)[:, :, 2] * det.reshape(-1, len(weights), 1)
            group["normal"] = (group["normal"] + np.einsum("eqc,q->c", normal, weights)).tolist()
    found["groups"].append(group)
gmsh.finalize()
print(json.dumps(found))
"""


def vector_area(mesh, block):
    """Integral of the normal over the triangles of a block."""
    points, weights = quadrature("tri", 4)
    x = mesh.nodes[block.connectivity]
    j = np.einsum("enc,mnd->emcd", x - x[:, :1], shape_gradients(block.kind, points))
    return np.einsum("emc,m->c", np.cross(j[..., 0], j[..., 1]), weights)


@pytest.mark.parametrize("suffix", ["msh", "unv"])
@pytest.mark.parametrize("name", MESHES)
def test_gmsh_reads_the_same_mesh(tmp_path, name, suffix):
    pytest.importorskip("gmsh")
    mesh, sizes = mesh_named(name)
    path = tmp_path / f"body.{suffix}"
    write_mesh(path, mesh)
    answer = subprocess.run(
        [sys.executable, "-c", GMSH, str(path)], capture_output=True, text=True, check=True
    )
    found = json.loads(answer.stdout.splitlines()[-1])
    assert found["errors"] == ""
    # every double as it was
    assert np.array_equal(found["nodes"], mesh.nodes)
    blocks = blocks_of(mesh)
    numbers = {"msh": _of_dimension(blocks), "unv": range(1, len(blocks) + 1)}[suffix]
    groups = {(g["dimension"], g["number"]): g for g in found["groups"]}
    assert len(groups) == len(blocks)
    for number, block in zip(numbers, blocks, strict=True):
        group = groups[block.dimension, number]
        # Gmsh forgets the names of groups in this format
        assert group["name"] == (block.group if suffix == "msh" else "")
        assert group["count"] == len(block.connectivity)
        assert group["size"] == pytest.approx(sizes[block.group], rel=1e-7)
        # orientation and order of nodes: another one would fold elements
        assert group["least"] > 0.0
        if block.dimension == 2:
            off = np.array(group["normal"]) - vector_area(mesh, block)
            assert np.abs(off).max() < 1e-7 * group["size"]


def _of_dimension(blocks):
    counts = {2: 0, 3: 0}
    for block in blocks:
        counts[block.dimension] += 1
        yield counts[block.dimension]


@pytest.mark.parametrize("name", MESHES)
def test_vtk_reads_the_same_mesh(tmp_path, name):
    vtk = pytest.importorskip("vtk")
    from vtk.util.numpy_support import vtk_to_numpy

    mesh, sizes = mesh_named(name)
    path = tmp_path / "body.vtu"
    write_mesh(path, mesh)
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    assert reader.GetErrorCode() == 0
    grid = reader.GetOutput()
    nodes = vtk_to_numpy(grid.GetPoints().GetData())
    assert nodes.dtype == np.float64 and np.array_equal(nodes, mesh.nodes)
    data = {
        grid.GetCellData().GetArrayName(i): vtk_to_numpy(grid.GetCellData().GetArray(i))
        for i in range(grid.GetCellData().GetNumberOfArrays())
    }
    names = grid.GetFieldData().GetAbstractArray("group_names")
    names = [names.GetValue(i) for i in range(names.GetNumberOfValues())]
    types = np.array([grid.GetCellType(c) for c in range(grid.GetNumberOfCells())])
    cells = vtk_to_numpy(grid.GetCells().GetConnectivityArray())
    starts = vtk_to_numpy(grid.GetCells().GetOffsetsArray())
    blocks = blocks_of(mesh)
    assert names == [block.group for block in blocks]
    for number, block in enumerate(blocks):
        members = np.flatnonzero(data["group"] == number)
        assert len(members) == len(block.connectivity)
        (kind,) = set(types[members].tolist())
        cell = vtk.vtkGenericCell.InstantiateCell(kind)
        assert cell.GetCellDimension() == block.dimension
        count = cell.GetNumberOfPoints()
        rows = cells[starts[members][:, None] + np.arange(count)]
        # their shape functions on what they read
        points, weights = quadrature(block.kind.rstrip("0123456789"), 5)
        slopes = np.empty((len(points), block.dimension, count))
        for point, slope in zip(points, slopes, strict=True):
            theirs = [0.0] * (block.dimension * count)
            cell.InterpolateDerivs([*point, 0.0][:3], theirs)
            slope[:] = np.reshape(theirs, (block.dimension, count))
        x = nodes[rows] - nodes[rows[:, :1]]
        j = np.einsum("enc,mdn->emcd", x, slopes)
        assert _measure(j).min() > 0.0
        assert (_measure(j) @ weights).sum() == pytest.approx(sizes[block.group], rel=1e-9)
        if block.dimension == 3:
            quality = mesh.wedge_quality if number == 0 else mesh.tet_quality
            assert np.array_equal(data["scaled_jacobian"][members], quality)
    layers = data["layer"][: len(mesh.wedges)]
    assert np.array_equal(layers, mesh.wedge_layer)
    # triangles have the colour of the wedge that they are a side of: here by its own corners
    corners = {}
    for row, value in zip(mesh.wedges, mesh.wedge_quality, strict=True):
        corners[frozenset(row[:3])] = corners[frozenset(row[3:6])] = value
    for number, block in enumerate(blocks[2:], 2):
        found = data["scaled_jacobian"][data["group"] == number]
        owners = [frozenset(row[:3]) for row in block.connectivity]
        if block.group == "Interface":
            assert found.tolist() == [_below(mesh, key) for key in owners]
        else:
            assert found.tolist() == [corners[key] for key in owners]


def _below(mesh, key):
    (row,) = [w for w, nodes in enumerate(mesh.wedges[:, :3]) if frozenset(nodes) == key]
    return mesh.wedge_quality[row]


def test_names_in_formats_with_few_letters():
    names = ["Face1", "Fläche 2", "Fl_che 2", "", "face1"]
    assert list(plain_names(names).values()) == [
        "Face1",
        "Fl_che_2",
        "Fl_che_2_2",
        "FACE",
        "face1",
    ]
    assert list(plain_names(names, capitals=True).values())[-1] == "FACE1_2"


def test_an_unknown_ending_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"\.stl") as caught:
        write_mesh(tmp_path / "a.stl", make_volume("box").fem)
    assert all(suffix in caught.value.remedy for suffix in FORMATS)
    assert list(tmp_path.iterdir()) == []
    assert check_format("A.MED") in NEED_FREECAD


@pytest.mark.parametrize("suffix", sorted(set(FORMATS) - set(NEED_FREECAD)))
def test_a_writer_that_fails_leaves_the_old_file(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"body{suffix}"
    path.write_bytes(b"old")

    def fail(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atomic.os, "fsync", fail)
    with pytest.raises(OSError, match="No space"):
        write_mesh(path, make_volume("box").fem)
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
