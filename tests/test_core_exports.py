# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Exports, read by programs that are not ours: VTK, CalculiX, a PNG reader."""

import os
import re
import shutil
import subprocess

import numpy as np
import pytest
from shells import make_volume

from HybridVolume.core import atomic
from HybridVolume.core.element_jacobians import volumes
from HybridVolume.core.elements import CALCULIX_NAMES, reference, to_order
from HybridVolume.core.finite_elements import FiniteElementMesh
from HybridVolume.errors import InputError, SetupError
from HybridVolume.exports import picture
from HybridVolume.exports.inp import Material, nodal_forces, set_names, support, write_inp
from HybridVolume.exports.picture import write_picture
from HybridVolume.exports.vtu import BEZIER_HEXAHEDRON, bezier_order, write_vtu

# ------------------------------------------------------------------------------------------ VTK


@pytest.fixture(scope="module")
def vtk():
    return pytest.importorskip("vtk")


def read_grid(vtk, path):
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    assert reader.GetErrorCode() == 0
    return reader.GetOutput()


@pytest.mark.parametrize("degrees", [(1, 1, 1), (2, 2, 2), (2, 1, 3), (3, 3, 3), (4, 2, 3)])
def test_order_of_bezier_hexahedra_is_that_of_vtk(vtk, degrees):
    order = bezier_order(degrees)
    shape = tuple(d + 1 for d in degrees)
    for place, flat in enumerate(order):
        i, j, k = (int(x) for x in np.unravel_index(flat, shape))
        theirs = vtk.vtkHigherOrderHexahedron.PointIndexFromIJK(i, j, k, list(degrees))
        assert theirs == place


@pytest.mark.parametrize("name, order", [("torus", 2), ("hollow sphere", 1)])
def test_vtk_evaluates_the_cells_on_the_exact_patches(vtk, tmp_path, name, order):
    volume = make_volume(name, order)
    path = tmp_path / "body.vtu"
    write_vtu(path, volume)
    grid = read_grid(vtk, path)
    shell, fem = volume.shell, volume.fem
    assert grid.GetNumberOfCells() == shell.element_count + len(fem.tets)
    data = {
        grid.GetCellData().GetArrayName(i): grid.GetCellData().GetArray(i)
        for i in range(grid.GetCellData().GetNumberOfArrays())
    }
    rng = np.random.default_rng(0)
    worst_outer = worst_inner = 0.0
    surface, inner = shell.surface, shell.inner_surface()
    cell = 0
    for batch in shell.bezier_elements():
        for position in range(len(batch)):
            if grid.GetCellType(cell) != BEZIER_HEXAHEDRON:
                raise AssertionError("a shell element is no Bézier hexahedron")
            layer = batch.element[position] % shell.layer_count
            assert data["layer"].GetValue(cell) == layer
            assert data["patch"].GetValue(cell) == batch.patch[position]
            if position % 5 == 0 and layer in (0, shell.layer_count - 1):
                v, u = rng.random(2)
                point, weights = [0.0] * 3, [0.0] * grid.GetCell(cell).GetNumberOfPoints()
                at = [v, u, float(layer > 0)]
                grid.GetCell(cell).EvaluateLocation(vtk.reference(0), at, point, weights)
                patch = surface.patches[batch.patch[position]]
                span = batch.element[position] // shell.layer_count
                group = next(g for g in surface.groups if span in g.element)
                row = int(np.flatnonzero(group.element == span)[0])
                low, high = group.low[row], group.high[row]
                assert patch.face == fem.face_names[data["face"].GetValue(cell)]
                where = low + (high - low) * [u, v]
                exact = (inner if layer else surface).evaluate(
                    int(batch.patch[position]), where[:1], where[1:]
                )[0]
                off = np.abs(exact - point).max()
                if layer:
                    worst_inner = max(worst_inner, off)
                else:
                    worst_outer = max(worst_outer, off)
                    # and on the analytic body
                    x, y, z = point
                    if name == "torus":
                        assert abs((np.hypot(x, y) - 3.0) ** 2 + z**2 - 1.0) < 1e-12
                    else:
                        assert min(abs(np.linalg.norm(point) - r) for r in (1.0, 2.0)) < 1e-12
            cell += 1
    assert worst_outer < 1e-12 and worst_inner < 1e-12
    kinds = {grid.GetCellType(c) for c in range(cell, grid.GetNumberOfCells())}
    assert kinds == {24 if order == 2 else 10}
    assert [data["part"].GetValue(c) for c in (0, cell - 1, cell)] == [0, 0, 1]
    bounds = [data["min_bernstein"].GetValue(c) for c in range(grid.GetNumberOfCells())]
    assert min(bounds[cell:]) == fem.tet_bound.min()
    names = grid.GetFieldData().GetAbstractArray("face_names")
    assert [names.GetValue(i) for i in range(names.GetNumberOfValues())] == list(fem.face_names)


def test_neighbours_share_points_in_the_vtu(vtk, tmp_path):
    volume = make_volume("torus")
    write_vtu(tmp_path / "body.vtu", volume)
    grid = read_grid(vtk, tmp_path / "body.vtu")
    skin = vtk.vtkDataSetSurfaceFilter()
    skin.SetInputData(grid)
    skin.SetNonlinearSubdivisionLevel(0)
    skin.Update()
    # outside, inside and the core's own boundary; no face between elements of the shell
    spans = volume.shell.surface.element_count
    assert skin.GetOutput().GetNumberOfCells() == 2 * spans + len(volume.interface.triangles)
    sizes = vtk.vtkCellSizeFilter()
    sizes.SetInputData(grid)
    sizes.Update()
    found = sizes.GetOutput().GetCellData().GetArray("Volume")
    # VTK's figures for these cells are coarse; their sign says whether a cell is right-handed
    assert min(found.GetValue(c) for c in range(grid.GetNumberOfCells())) > 0.0


# ------------------------------------------------------------------------------------- CalculiX


@pytest.fixture(scope="module")
def ccx():
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not installed")

    def run(folder):
        answer = subprocess.run(
            ["ccx", "-i", "job"],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=120,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        return answer.returncode, answer.stdout

    return run


PRINTS = "*EL PRINT, ELSET={0}\nS\n"


def stresses(folder):
    """Rows of element, point, six stresses."""
    text = (folder / "job.dat").read_text()
    found = re.findall(r"^\s+(\d+)\s+(\d+)((?:\s+[-+.\dE]+){6})\s*$", text, re.M)
    return np.array([[float(e), float(p), *map(float, s.split())] for e, p, s in found])


def single(kind):
    """A mesh of one distorted element; mid nodes are a little off the middle."""
    nodes = reference(kind).nodes.copy()
    rng = np.random.default_rng(7)
    nodes = nodes @ np.array([[2.0, 0.3, 0.1], [0.0, 1.5, 0.2], [0.1, 0.0, 1.0]]).T
    nodes += 0.02 * rng.normal(size=nodes.shape)
    row = np.arange(len(nodes))[None]
    none = np.zeros((0, len(nodes)), dtype=int)
    wedge, order = kind.startswith("penta"), 1 if kind in ("tet4", "penta6") else 2
    face = np.zeros((0, 3 * order), dtype=int)
    empty = np.zeros(0, dtype=int)
    return FiniteElementMesh(
        order, nodes, row if wedge else none, empty, empty, none if wedge else row,
        face, empty, empty, face, (), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0),
    )  # fmt: skip


GRADIENT = np.array([[1.0, 0.2, 0.3], [-0.1, 0.8, 0.4], [0.25, -0.3, 1.2]]) * 1e-3


def exact_stress(material):
    strain = 0.5 * (GRADIENT + GRADIENT.T)
    shear = material.young / 2.0 / (1.0 + material.poisson)
    lame = material.young * material.poisson
    lame /= (1.0 + material.poisson) * (1.0 - 2.0 * material.poisson)
    s = 2.0 * shear * strain + lame * np.trace(strain) * np.eye(3)
    return s[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def prescribe(folder, mesh, nodes):
    """Replace the step by one with a linear displacement of some nodes."""
    text = (folder / "job.inp").read_text()
    moves = mesh.nodes[nodes] @ GRADIENT.T
    rows = [
        f"{node + 1},{axis + 1},{axis + 1},{value:.13e}"
        for node, row in zip(nodes, moves, strict=True)
        for axis, value in enumerate(row)
    ]
    sets = re.findall(r"^\*ELEMENT.*ELSET=(\w+)", text, re.M)
    prints = "".join(PRINTS.format(name) for name in sets)
    step = "*STEP\n*STATIC\n*BOUNDARY\n" + "\n".join(rows) + "\n" + prints + "*END STEP\n"
    (folder / "job.inp").write_text(text[: text.index("*STEP")] + step)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "penta6", "penta15"])
def test_ccx_takes_each_element_and_not_its_mirror_image(ccx, tmp_path, kind):
    mesh = single(kind)
    connectivity = mesh.wedges if kind.startswith("penta") else mesh.tets
    assert volumes(kind, mesh.nodes[connectivity])[0] > 0.0
    write_inp(tmp_path / "job.inp", mesh, pressure={}, title="one element")
    prescribe(tmp_path, mesh, np.arange(len(mesh.nodes)))
    code, said = ccx(tmp_path)
    assert code == 0, said[-2000:]
    found = stresses(tmp_path)
    exact = exact_stress(Material())
    assert len(found) and np.abs(found[:, 2:] - exact).max() < 1e-6 * np.linalg.norm(exact)
    text = (tmp_path / "job.inp").read_text()
    assert CALCULIX_NAMES[kind] in text
    # FreeCAD's list is the mirror image of ours
    row = ",".join(str(n + 1) for n in connectivity[0])
    mirror = ",".join(str(n + 1) for n in to_order("freecad", kind, connectivity)[0])
    assert f"1,{row}\n" in text
    (tmp_path / "job.inp").write_text(text.replace(f"1,{row}\n", f"1,{mirror}\n"))
    code, said = ccx(tmp_path)
    assert "nonpositive jacobian" in said and code != 0


@pytest.mark.parametrize(
    "name, order, free",
    [("box", 2, True), ("box", 1, True), ("hollow sphere", 1, True), ("sphere", 2, False)],
)
def test_a_linear_field_is_exact_in_ccx(ccx, tmp_path, name, order, free):
    # CalculiX integrates curved elements with too few points for an exact free patch test: there
    # all nodes are prescribed, which still tests every order and Jacobian.
    mesh = make_volume(name, order).fem
    write_inp(tmp_path / "job.inp", mesh)
    prescribe(tmp_path, mesh, np.unique(mesh.boundary) if free else np.arange(len(mesh.nodes)))
    code, said = ccx(tmp_path)
    assert code == 0, said[-2000:]
    found, exact = stresses(tmp_path), exact_stress(Material())
    elements = len(mesh.wedges) + len(mesh.tets)
    assert len(np.unique(found[:, 0])) == elements
    assert np.abs(found[:, 2:] - exact).max() < 1e-6 * np.linalg.norm(exact)


@pytest.mark.parametrize("name, tolerance", [("box", 1e-6), ("sphere", 0.05)])
def test_the_default_deck_gives_even_pressure(ccx, tmp_path, name, tolerance):
    mesh = make_volume(name).fem
    write_inp(tmp_path / "job.inp", mesh)
    text = (tmp_path / "job.inp").read_text()
    prints = PRINTS.format("SHELL") + PRINTS.format("CORE")
    (tmp_path / "job.inp").write_text(text.replace("*END STEP", prints + "*END STEP"))
    code, said = ccx(tmp_path)
    assert code == 0 and "ERROR" not in said
    off = np.abs(stresses(tmp_path)[:, 2:] + [1, 1, 1, 0, 0, 0])
    assert off.max() < tolerance
    assert np.sqrt((off**2).mean()) < 0.2 * tolerance


def test_a_force_on_a_face_arrives_at_the_fixed_face(ccx, tmp_path):
    mesh = make_volume("box").fem
    middle = [mesh.nodes[mesh.face_nodes(f)].mean(axis=0) for f in mesh.face_names]
    left = mesh.face_names[int(np.argmin([m[0] for m in middle]))]
    right = mesh.face_names[int(np.argmax([m[0] for m in middle]))]
    force = (100.0, -30.0, 20.0)
    nodes, loads = nodal_forces(mesh, right, force)
    assert np.allclose(loads.sum(axis=0), force)
    moment = np.cross(mesh.nodes[nodes], loads).sum(axis=0)
    assert np.allclose(moment, np.cross([3.0, 1.0, 0.5], force))
    write_inp(tmp_path / "job.inp", mesh, fixed=[left], force={right: force})
    text = (tmp_path / "job.inp").read_text()
    name = set_names(mesh.face_names)[left]
    total = f"*NODE PRINT, NSET=N_{name}, TOTALS=ONLY\nRF\n"
    (tmp_path / "job.inp").write_text(text.replace("*END STEP", total + "*END STEP"))
    code, said = ccx(tmp_path)
    assert code == 0, said[-2000:]
    numbers = re.findall(r"[-+]?\d\.\d+E[-+]\d+", (tmp_path / "job.dat").read_text())
    assert np.allclose([float(x) for x in numbers[-3:]], np.negative(force), rtol=1e-4)


def test_ccx_reads_back_the_same_coordinates(tmp_path):
    mesh = make_volume("sphere").fem
    write_inp(tmp_path / "a.inp", mesh)
    text = (tmp_path / "a.inp").read_text().split("*ELEMENT")[0]
    rows = [line.split(",") for line in text.splitlines() if line[0].isdigit()]
    assert all(len(x) <= 20 for row in rows for x in row)
    found = np.array([[float(x) for x in row[1:]] for row in rows])
    # every double as it was, but where 20 characters do not hold it
    off, size = np.abs(found - mesh.nodes), np.abs(mesh.nodes)
    assert (off[size >= 0.01] == 0.0).all() and (off <= 1e-13 * size).all()


def test_unknown_faces_and_odd_names(tmp_path):
    mesh = make_volume("box").fem
    with pytest.raises(InputError) as caught:
        write_inp(tmp_path / "a.inp", mesh, fixed=["Face99"])
    assert caught.value.faces == ("Face99",)
    assert list(tmp_path.iterdir()) == []
    assert set_names(["Face1", "face1", "Fläche 2"]) == {
        "Face1": "FACE1",
        "face1": "FACE1_2",
        "Fläche 2": "FL_CHE_2",
    }


def test_the_support_blocks_all_six_rigid_motions():
    for name in ("box", "torus", "sphere"):
        mesh = make_volume(name).fem
        rows = []
        for node, axis in support(mesh):
            unit = np.eye(3)[axis]
            rows.append([*unit, *np.cross(mesh.nodes[node], unit)])
        assert len(rows) == 6 and np.linalg.svd(rows)[1].min() > 0.05


# -------------------------------------------------------------------------------------- picture


def test_the_picture_shows_red_green_and_gray(tmp_path):
    pytest.importorskip("pyvista")
    image = pytest.importorskip("PIL.Image")
    path = tmp_path / "body.png"
    write_picture(path, make_volume("torus"), size=(640, 480))
    assert [p.name for p in tmp_path.iterdir()] == ["body.png"]
    pixels = np.asarray(image.open(path).convert("RGB")).astype(int)
    assert pixels.shape == (480, 640, 3)
    red, green, blue = (pixels[..., i] for i in range(3))
    white = (pixels > 250).all(axis=2)
    shown = {
        "outer": (red > 2 * green) & (red > 2 * blue) & (red > 80),
        "inner": (green > 1.5 * red) & (green > 1.5 * blue) & (green > 80),
        "core": (np.ptp(pixels, axis=2) < 16) & (red > 70) & ~white,
    }
    shares = {name: mask.mean() for name, mask in shown.items()}
    assert 0.3 < white.mean() < 0.9
    assert shares["outer"] > 0.1 and shares["inner"] > 0.02 and shares["core"] > 0.005
    # the body fills the picture and keeps off its rim
    rows, columns = np.flatnonzero(~white.all(axis=1)), np.flatnonzero(~white.all(axis=0))
    assert rows[0] > 0 and columns[0] > 0 and rows[-1] < 479 and columns[-1] < 639
    assert max(np.ptp(rows) / 480, np.ptp(columns) / 640) > 0.8


def test_no_way_to_draw_is_said_and_leaves_nothing(tmp_path, monkeypatch):
    pytest.importorskip("pyvista")
    monkeypatch.setattr(picture, "_ways", lambda: [({"PYTHONHOME": "/nowhere"}, [])])
    with pytest.raises(SetupError, match="nothing on this system can draw"):
        write_picture(tmp_path / "body.png", make_volume("box"), size=(64, 48))
    assert list(tmp_path.iterdir()) == []


# ----------------------------------------------------------------------------------- whole files


@pytest.mark.parametrize("write", [write_vtu, lambda p, v: write_inp(p, v.fem)], ids=["vtu", "inp"])
def test_a_writer_that_fails_leaves_the_old_file(tmp_path, monkeypatch, write):
    path = tmp_path / "body.out"
    path.write_bytes(b"old")

    def fail(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atomic.os, "fsync", fail)
    with pytest.raises(OSError, match="No space"):
        write(path, make_volume("box"))
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
    monkeypatch.undo()
    write(path, make_volume("box"))
    assert path.stat().st_size > 1000 and list(tmp_path.iterdir()) == [path]


def test_a_place_that_does_not_exist_is_said(tmp_path):
    with pytest.raises(OSError):
        write_vtu(tmp_path / "nowhere" / "body.vtu", make_volume("box"))
