# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Files for other solvers, as those read them: MFEM, G+Smo and Gmsh."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
import shells

from HybridVolume.core import bspline
from HybridVolume.core.analysis.hybrid_space import of_volume
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.solver_patches import solver_patches
from HybridVolume.core.surface import SplineFace
from HybridVolume.errors import InputError
from HybridVolume.exports.core_mesh import write_core
from HybridVolume.exports.gismo_xml import write_gismo
from HybridVolume.exports.mfem_mesh import write_mfem
from HybridVolume.exports.solver_files import write_solver_files
from HybridVolume.protocol import exported_files


def whole_circle():
    """Nine homogeneous control points of the unit circle."""
    corner = np.sqrt(0.5)
    x = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1], [1, 0.0]])
    return x, np.array([1, corner, 1, corner, 1, corner, 1, corner, 1])


def half_torus_shell():
    """A torus of two by two faces: two of them meet along two sides, with the same two ends."""
    x, weights = whole_circle()
    knots = np.array([0, 0, 0, 0.5, 0.5, 1, 1, 1])
    faces = []
    for a in (0, 4):
        for b in (0, 4):
            along, around = x[a : a + 5], x[b : b + 5]
            radius = 3.0 + around[:, 0]
            points = np.empty((5, 5, 3))
            points[..., :2] = along[:, None] * radius[None, :, None]
            points[..., 2] = around[:, 1]
            heavy = np.outer(weights[a : a + 5], weights[b : b + 5])
            faces.append(SplineFace(f"Face{len(faces) + 1}", (2, 2), (knots, knots), points, heavy))
    return shells.shell_towards(build_surface(faces), lambda x: x * [0.98, 0.98, 0.5])


def pillow_shell():
    """Two faces over the same four corners."""
    knots = np.array([0.0, 0, 0, 1, 1, 1])
    line = np.linspace(-1.0, 1.0, 3)
    x, y = np.meshgrid(line, line, indexing="ij")
    faces = []
    for name, sign in (("upper side", 1.0), ("lower <side>", -1.0)):
        z = np.zeros((3, 3))
        z[1, 1] = 2.0 * sign
        points = np.stack([x, y, z], axis=-1)
        faces.append(SplineFace(name, (2, 2), (knots, knots), points, np.ones((3, 3))))
    return shells.shell_towards(build_surface(faces), lambda x: 0.5 * x)


SHELLS = {
    "box": lambda: shells.make_shell("box"),
    "sphere": lambda: shells.make_shell("sphere"),
    "hollow sphere": lambda: shells.make_shell("hollow sphere"),
    "torus of four": half_torus_shell,
    "pillow": pillow_shell,
}


def mfem_volumes(mfem, path, order):
    """Volume of a mesh in MFEM, and the area of each attribute of its boundary."""
    mesh = mfem.Mesh(str(path), 1, 1)
    space = mfem.FiniteElementSpace(mesh, mfem.L2_FECollection(0, 3))
    one = mfem.ConstantCoefficient(1.0)
    integrator = mfem.DomainLFIntegrator(one)
    rule = mfem.IntRules.Get(mesh.GetElementBaseGeometry(0), order)
    integrator.SetIntRule(rule)
    form = mfem.LinearForm(space)
    form.AddDomainIntegrator(integrator)
    form.Assemble()
    areas = {}
    for k in range(mesh.GetNBE()):
        transformation = mesh.GetBdrElementTransformation(k)
        flat = mfem.IntRules.Get(mesh.GetBdrElementGeometry(k), 12)
        area = 0.0
        for q in range(flat.GetNPoints()):
            point = flat.IntPoint(q)
            transformation.SetIntPoint(point)
            area += point.weight * transformation.Weight()
        attribute = mesh.GetBdrAttribute(k)
        areas[attribute] = areas.get(attribute, 0.0) + area
    return float(np.sum(form.GetDataArray())), areas


def gismo_volume(patches, file, count):
    """Volume of G+Smo's patches by Gauss points between the file's knots."""
    x, weight = np.polynomial.legendre.leggauss(count)
    x, weight = 0.5 * (x + 1.0), 0.5 * weight
    volume = 0.0
    for k, geometry in enumerate(file.findall("Geometry")):
        lines = [np.unique(np.array(t.text.split(), dtype=float))
                 for t in geometry.iter("KnotVector")]  # fmt: skip
        places = [(t[:-1, None] + np.diff(t)[:, None] * x).ravel() for t in lines]
        weights = [(np.diff(t)[:, None] * weight).ravel() for t in lines]
        points = np.stack([p.ravel() for p in np.meshgrid(*places, indexing="ij")])
        jacobian = np.asarray(patches.patch(k).jacobian(points)).reshape(3, -1, 3)
        determinant = np.linalg.det(jacobian.transpose(1, 0, 2))
        volume += determinant @ np.einsum("a,b,c->abc", *weights).ravel()
    return volume


def interfaces(pygismo, patches, path):
    """Interfaces that G+Smo has, as sorted rows with the lower side first."""
    data = pygismo.io.gsFileData()
    data.add(patches)
    data.save(str(path))
    text = path.with_suffix(".xml").read_text()
    rows = re.search(r"<interfaces>(.*?)</interfaces>", text, re.DOTALL).group(1).split()
    found = []
    for row in np.array(rows, dtype=int).reshape(-1, 10):
        one, other, way, same = row[:2], row[2:4], row[4:7], row[7:]
        if tuple(one) > tuple(other):
            back = np.argsort(way)
            one, other, way, same = other, one, back, same[back]
        found.append((*one.tolist(), *other.tolist(), *way.tolist(), *same.tolist()))
    return sorted(found)


@pytest.mark.parametrize("name", ["box", "sphere", "hollow sphere", "torus of four", "pillow"])
def test_mfem_integrates_the_volume(tmp_path, name):
    mfem = pytest.importorskip("mfem.ser")
    shell = SHELLS[name]()
    patches = solver_patches(shell)
    write_mfem(tmp_path / "shell.mesh", patches)
    volume, areas = mfem_volumes(mfem, tmp_path / "shell.mesh", 28 if shell.surface.rational else 9)
    assert volume == pytest.approx(shell.volume(), rel=1e-10)
    # one attribute for each face and one for the interface
    assert sorted(areas) == list(range(1, len(patches.face_names) + 2))
    inner = areas.pop(len(patches.face_names) + 1)
    assert inner == pytest.approx(shell.inner_surface().area(), rel=1e-4)
    assert sum(areas.values()) == pytest.approx(shell.surface.area(), rel=1e-4)
    assert f"# 1 {patches.face_names[0]}\n" in (tmp_path / "shell.mesh").read_text()


@pytest.mark.parametrize("name", ["sphere", "torus of four", "pillow"])
def test_gismo_integrates_the_volume_and_finds_the_same_interfaces(tmp_path, name):
    pygismo = pytest.importorskip("pygismo")
    shell = SHELLS[name]()
    path = tmp_path / "shell.xml"
    write_gismo(path, solver_patches(shell))
    patches = pygismo.core.gsMultiPatch()
    pygismo.io.gsFileData(str(path)).getFirst(patches)
    file = ElementTree.parse(path).getroot()
    volume = gismo_volume(patches, file, 13 if shell.surface.rational else 5)
    assert volume == pytest.approx(shell.volume(), rel=1e-10)
    named = [one.get("name") for one in file.iter("boundary")]
    assert named == [*dict.fromkeys(p.face for p in shell.surface.patches), "Interface"]
    told = interfaces(pygismo, patches, tmp_path / "told")
    assert len(told) == 2 * patches.nPatches()
    # G+Smo's own search, by the places of corners
    patches.computeTopology(1e-6 * shell.surface.diagonal, False, False)
    assert interfaces(pygismo, patches, tmp_path / "found") == told


def test_patches_that_corners_tell_apart_keep_their_bits():
    shell = shells.make_shell("torus")
    patches = solver_patches(shell).patches
    assert len(patches) == len(shell.surface.patches)
    for made, given in zip(patches, shell.surface.patches, strict=True):
        net = shell.layers[:, given.index]
        assert np.array_equal(made.points, net.transpose(2, 1, 0, 3))
        assert np.array_equal(made.weights[..., 0], given.weights.T)
        assert np.linalg.det(np.array([
            made.points[-1, 0, 0] - made.points[0, 0, 0],
            made.points[0, -1, 0] - made.points[0, 0, 0],
            made.points[0, 0, -1] - made.points[0, 0, 0],
        ])) > 0.0  # fmt: skip


def test_cut_patches_are_the_same_volume_point_for_point():
    shell = half_torus_shell()
    made = solver_patches(shell)
    assert len(made.patches) > len(shell.surface.patches)
    random = np.random.default_rng(5)
    source = random.integers(4, size=300)
    uv, w = random.random((300, 2)), random.random(300)
    places = made.places(source, uv, w)
    assert np.array_equal(places[:, 1:], np.column_stack([uv[:, ::-1], w]))
    for k, patch in enumerate(made.patches):
        rows = np.flatnonzero(places[:, 0] == k)
        tables = [
            bspline.basis_matrix(patch.degrees[d], patch.knots[d], places[rows, d + 1]).toarray()
            for d in range(3)
        ]
        weight = np.einsum("ma,mb,mc,abc->m", *tables, patch.weights)
        x = np.einsum("ma,mb,mc,abcd->md", *tables, patch.points * patch.weights[..., None])
        assert (source[rows] == patch.source).all()
        exact = shell.evaluate(patch.source, *uv[rows].T, w[rows])
        assert np.abs(x / weight[:, None] - exact).max() < 1e-13


@pytest.mark.parametrize("degree", [1, 2])
def test_core_and_interface_beside_the_shell(tmp_path, degree):
    mfem = pytest.importorskip("mfem.ser")
    pygismo = pytest.importorskip("pygismo")
    volume = shells.make_volume("sphere")
    files = write_solver_files(tmp_path / "ball.xml", volume, degree)
    assert [f.name for f in files] == [
        *("ball.xml", "ball_core.msh", "ball_interface.csv", "ball_interface_triangles.csv")
    ]
    inside, areas = mfem_volumes(mfem, files[1], 6)
    # shell and core are the ball but for the gap between triangles and inner surface
    exact = 4.0 / 3.0 * np.pi
    gap = inside + volume.shell.volume() - exact
    assert abs(gap) < {1: 0.2, 2: 0.002}[degree] * exact
    assert list(areas) == [1]
    patches = pygismo.core.gsMultiPatch()
    pygismo.io.gsFileData(str(files[0])).getFirst(patches)
    rows = np.genfromtxt(files[2], delimiter=",", names=True)
    corners = np.genfromtxt(files[3], delimiter=",", names=True)
    x = np.column_stack([rows[c] for c in "xyz"])
    for k in np.unique(rows["patch"]).astype(int):
        mine = rows["patch"] == k
        at = np.stack([rows[t][mine] for t in ("t1", "t2", "t3")])
        assert np.abs(np.asarray(patches.patch(k).eval(at)).T - x[mine]).max() < 1e-13
    place = dict(zip(rows["node"].astype(int).tolist(), x, strict=True))
    for k in np.unique(corners["patch"]).astype(int):
        mine = corners[corners["patch"] == k]
        for c in "123":
            at = np.stack([mine[t + c] for t in "rst"])
            nodes = [place[n] for n in mine["n" + c].astype(int).tolist()]
            assert np.abs(np.asarray(patches.patch(k).eval(at)).T - nodes).max() < 1e-13


@pytest.mark.parametrize("degree", [2, 3])
def test_curved_tets_as_gmsh_reads_them(tmp_path, degree):
    gmsh = pytest.importorskip("gmsh")
    volume = shells.make_volume("box")
    core = of_volume(volume, degree=degree, coupling="nitsche").tets
    # bent, so that nodes in another order would be found
    core = replace(core, nodes=core.nodes + 0.02 * np.sin(3.0 * core.nodes[:, [1, 2, 0]]))
    write_core(tmp_path / "core.msh", core)
    gmsh.initialize(["", "-v", "1"])
    try:
        gmsh.open(str(tmp_path / "core.msh"))
        names = {gmsh.model.getPhysicalName(*group) for group in gmsh.model.getPhysicalGroups()}
        (kind,) = gmsh.model.mesh.getElementTypes(3)
        points, weights = gmsh.model.mesh.getIntegrationPoints(kind, "Gauss8")
        _, determinants, _ = gmsh.model.mesh.getJacobians(kind, points)
    finally:
        gmsh.finalize()
    assert names == {"Core", "Interface"}
    determinants = determinants.reshape(-1, len(weights))
    assert determinants.min() > 0.0 and len(determinants) == len(core.elements)
    own = sum(block.measure.sum() for block in core.samples(8))
    assert determinants.sum(axis=0) @ weights == pytest.approx(own, rel=1e-11)


def test_what_cannot_be_written_is_refused(tmp_path):
    volume = shells.make_volume("box")
    with pytest.raises(InputError, match="not written as .stl.*choose .mesh"):
        write_solver_files(tmp_path / "box.stl", volume)
    with pytest.raises(InputError, match="degree 4"):
        write_solver_files(tmp_path / "box.mesh", volume, 4)
    assert not list(tmp_path.iterdir())


def test_a_core_that_cannot_be_curved_is_straight_and_told(tmp_path, monkeypatch):
    from HybridVolume.exports import solver_files

    def folded(*_, **__):
        raise InputError("7 tetrahedra are folded", remedy="refine the shell")

    monkeypatch.setattr(solver_files, "hybrid_space", folded)
    volume = shells.make_volume("sphere")
    with pytest.raises(InputError, match="7 tetrahedra"):
        write_solver_files(tmp_path / "ball.mesh", volume)
    assert not list(tmp_path.iterdir())
    files, figures = solver_files.write_core_files(tmp_path, "ball", volume, straight=True)
    assert [file.name for file in files] == exported_files("ball", "core")
    assert figures["degree"] == 1 and figures["tets"] == len(volume.interior.mesh.tets)
    assert "straight: 7 tetrahedra are folded" in figures["notes"][0]
    assert files[0].read_text().count(" 4 2 2 2 ") == figures["tets"]
