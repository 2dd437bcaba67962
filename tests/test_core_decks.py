# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Decks of wedges and of hexahedra as CalculiX reads them: elements, volumes, sets, equations."""

import os
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from bodies import box
from shells import exact_volume, make_volume, shell_towards

from HybridVolume.core import element_jacobians as ej
from HybridVolume.core import hexahedra
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.elements import jacobians, quadrature, reference, shape_functions
from HybridVolume.core.finite_elements import build_finite_elements
from HybridVolume.core.hex_jacobians import bezier_hexahedra
from HybridVolume.core.hexahedra import hexahedral_mesh
from HybridVolume.errors import FaultError, InputError
from HybridVolume.exports.inp import Material, deck_of, nodal_forces, set_names, write_inp

GRADIENT = np.array([[1.0, 0.2, 0.3], [-0.1, 0.8, 0.4], [0.25, -0.3, 1.2]]) * 1e-3


def hexahedral(name):
    volume = make_volume(name)
    return hexahedral_mesh(volume.fem, volume.interface)


def mixed(name):
    """A mesh in which a third of the columns stay wedges, or more."""
    volume = make_volume(name)
    builder = hexahedra._Builder(volume.fem, volume.interface)
    builder.level[::3] = len(hexahedra._CURVED)
    builder.choose()
    return builder.result()


MESHES = {
    "wedges": lambda name: make_volume(name).fem,
    "hexahedra": hexahedral,
    "both": mixed,
}


def run(folder, text):
    """Run CalculiX on a deck; what it printed into its table."""
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not installed")
    (folder / "job.inp").write_text(text)
    answer = subprocess.run(
        ["ccx", "-i", "job"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert answer.returncode == 0 and "*ERROR" not in answer.stdout, answer.stdout[-2000:]
    return (folder / "job.dat").read_text()


def model(path, mesh, **arguments):
    """A deck without its step."""
    write_inp(path / "model.inp", mesh, **arguments)
    text = (path / "model.inp").read_text()
    return text[: text.index("*STEP")]


def prescribed(mesh, nodes):
    rows = ["*STEP", "*STATIC", "*BOUNDARY"]
    for node, move in zip(nodes, mesh.nodes[nodes] @ GRADIENT.T, strict=True):
        rows += [f"{node + 1},{axis},{axis},{value:.13e}" for axis, value in enumerate(move, 1)]
    return "\n".join(rows) + "\n"


def outer(mesh):
    deck = deck_of(mesh)
    return np.unique(np.concatenate([r.ravel() for f in deck.faces.values() for _, r, _ in f]))


def stress_of(gradient, material):
    strain = 0.5 * (gradient + gradient.T)
    shear = material.young / 2.0 / (1.0 + material.poisson)
    lame = material.young * material.poisson
    lame /= (1.0 + material.poisson) * (1.0 - 2.0 * material.poisson)
    s = 2.0 * shear * strain + lame * np.trace(strain) * np.eye(3)
    return s[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def stress_error(folder, mesh, text):
    """Largest and mean deviation of a linear field's stress, with free nodes inside."""
    sets = dict.fromkeys(re.findall(r"^\*ELEMENT.*ELSET=(\w+)", text, re.M))
    prints = "".join(f"*EL PRINT, ELSET={name}\nS\n" for name in sets)
    table = run(folder, text + prescribed(mesh, outer(mesh)) + prints + "*END STEP\n")
    found = re.findall(r"^\s+(\d+)\s+(\d+)((?:\s+[-+.\dE]+){6})\s*$", table, re.M)
    elements = {int(element) for element, _, _ in found}
    assert len(elements) == sum(len(rows) for _, _, rows in deck_of(mesh).parts)
    stress = np.array([[float(x) for x in row.split()] for _, _, row in found])
    exact = stress_of(GRADIENT, Material())
    off = np.abs(stress - exact) / np.linalg.norm(exact)
    return off.max(), np.sqrt((off**2).mean())


def skewed_box():
    """A box whose core's sides are flat, with cells of any shape."""

    def inwards(points):
        t = points / [1.5, 1.0, 0.5] - 1.0
        a, b, c = t.T, np.roll(t, -1, axis=1).T, np.roll(t, -2, axis=1).T
        skewed = a + 0.15 * (1.0 - a**2) * (b + 0.5 * c + 0.3 * b * c)
        return (1.0 + 0.5 * skewed.T) * [1.5, 1.0, 0.5]

    surface = build_surface(list(box((3.0, 2.0, 1.0), (4, 3, 2), degree=1).faces))
    shell = shell_towards(surface, inwards)
    interface, _, fem = build_finite_elements(shell)
    return hexahedral_mesh(fem, interface)


def test_shares_follow_the_shape_of_the_sides(tmp_path):
    mesh = skewed_box()
    assert not len(mesh.wedges)
    assert np.ptp(mesh.shares[:, :4]) > 0.02 and np.allclose(mesh.shares.sum(axis=1), 1.0)
    assert mesh.volume == pytest.approx(6.0, rel=1e-13)
    assert stress_error(tmp_path, mesh, model(tmp_path, mesh))[0] < 1e-6
    # the shape functions at the middle are right on parallelograms only
    usual = np.array([-0.25] * 4 + [0.5] * 4)
    nodes = mesh.nodes.copy()
    nodes[mesh.centres] = np.einsum("k,ekc->ec", usual, nodes[mesh.followed])
    other = replace(mesh, nodes=nodes, shares=np.tile(usual, (len(mesh.centres), 1)))
    assert stress_error(tmp_path, other, model(tmp_path, other))[0] > 3e-3
    assert np.allclose(hexahedral("box").shares, usual, atol=1e-13)


@pytest.mark.parametrize("kind", MESHES)
def test_a_linear_field_is_exact_where_the_interface_is_flat(tmp_path, kind):
    mesh = MESHES[kind]("box")
    text = model(tmp_path, mesh)
    assert stress_error(tmp_path, mesh, text)[0] < 1e-6
    if kind == "hexahedra":
        # nodes that are only shared: the equations are what makes it right
        bare = re.sub(r"\*EQUATION\n(?:[-\d.,]+\n)+", "", text)
        assert "*EQUATION" in text and "*EQUATION" not in bare
        assert stress_error(tmp_path, mesh, bare)[0] > 0.1


def test_hexahedra_on_a_curved_interface_are_as_good_as_wedges(tmp_path):
    # CalculiX integrates curved wedges and tets with too few points for an exact answer
    errors = {}
    for kind in MESHES:
        mesh = MESHES[kind]("torus")
        errors[kind] = stress_error(tmp_path, mesh, model(tmp_path, mesh))
    assert errors["wedges"][1] < 0.02 and errors["both"][1] < 0.02
    assert errors["hexahedra"][1] < 0.2 * errors["wedges"][1]
    assert errors["hexahedra"][0] < 0.5 * errors["wedges"][0]


@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize("name", ["box", "torus"])
def test_ccx_has_the_same_volumes_and_surfaces(tmp_path, name, kind):
    mesh = MESHES[kind](name)
    deck = deck_of(mesh)
    names = set_names(mesh.face_names)
    surfaces = [*names.values(), "INTERFACE"]
    asked = "".join(f"*EL PRINT, ELSET={p}, TOTALS=ONLY\nEVOL\n" for p in ("SHELL", "CORE"))
    asked += "".join(f"*SECTION PRINT, SURFACE=S_{s}, NAME={s}\nSOF\n" for s in surfaces)
    held = prescribed(mesh, np.unique(np.concatenate([c.ravel() for _, _, c in deck.parts])))
    # a node that follows others is not held itself
    text = re.sub(r"\*EQUATION\n(?:[-\d.,]+\n)+", "", model(tmp_path, mesh))
    table = run(tmp_path, text + held + asked + "*END STEP\n")
    printed = re.findall(r"total volume .*\n\s*\n\s*(\S+)", table)
    for part, found in zip(("Shell", "Core"), printed, strict=True):
        own = [ej.volumes(k, mesh.nodes[c]).sum() for p, k, c in deck.parts if p == part]
        # six digits are printed; few points integrate a curved wedge's volume
        assert float(found) == pytest.approx(sum(own), rel=1e-5 if name == "box" else 2e-3)
    places = [m.start() for m in re.finditer("statistics for surface set", table)]
    parts = [table[a:b] for a, b in zip(places, [*places[1:], None], strict=True)]
    assert len(parts) == len(surfaces)
    for surface, part in zip(surfaces, parts, strict=True):
        assert f"S_{surface}" in part.splitlines()[0]
        numbers = re.search(r"area, *normal force.*\n\s*\n(.*)", part)[1].split()
        normal = re.search(r"center of gravity and mean normal\s*\n\s*\n(.*)", part)[1].split()
        area, vector = _area(mesh, deck, surface, names)
        assert float(numbers[0]) == pytest.approx(area, rel=1e-5 if name == "box" else 5e-3)
        if surface != "INTERFACE":
            direction = np.array(normal[3:], dtype=float)
            size = np.linalg.norm(vector) * np.linalg.norm(direction)
            assert direction @ vector > 0.999 * size


def _area(mesh, deck, surface, names):
    if surface == "INTERFACE":
        blocks = [("tri6", mesh.interface)]
    else:
        face = {v: k for k, v in names.items()}[surface]
        blocks = [(kind, rows) for kind, rows, _ in deck.faces[face]]
    area, vector = 0.0, np.zeros(3)
    for kind, rows in blocks:
        points, weights = quadrature(kind.rstrip("0123456789"), 5)
        j = jacobians(kind, mesh.nodes[rows], points)
        normal = np.cross(j[..., 0], j[..., 1])
        area += (np.linalg.norm(normal, axis=2) @ weights).sum()
        vector += np.einsum("eqc,q->c", normal, weights)
    return area, vector


@pytest.mark.parametrize("kind", ["hexahedra", "both"])
def test_loads_and_supports_on_faces_of_hexahedra(tmp_path, kind):
    mesh = MESHES[kind]("box")
    middle = {f: mesh.nodes[np.unique(_nodes(mesh, f))].mean(axis=0) for f in mesh.face_names}
    left = min(middle, key=lambda f: middle[f][0])
    right = max(middle, key=lambda f: middle[f][0])
    force = np.array([100.0, -30.0, 20.0])
    nodes, loads = nodal_forces(mesh, right, force)
    assert np.allclose(loads.sum(axis=0), force)
    assert np.allclose(
        np.cross(mesh.nodes[nodes], loads).sum(axis=0), np.cross([3.0, 1.0, 0.5], force)
    )
    write_inp(tmp_path / "a.inp", mesh, fixed=[left], force={right: force})
    total = f"*NODE PRINT, NSET=N_{set_names(mesh.face_names)[left]}, TOTALS=ONLY\nRF\n"
    text = (tmp_path / "a.inp").read_text().replace("*END STEP", total + "*END STEP")
    numbers = re.findall(r"[-+]?\d\.\d+E[-+]\d+", run(tmp_path, text))
    assert np.allclose([float(x) for x in numbers[-3:]], -force, rtol=1e-4)
    # without loads: one pressure everywhere, exact
    write_inp(tmp_path / "a.inp", mesh)
    prints = "*EL PRINT, ELSET=SHELL\nS\n*EL PRINT, ELSET=CORE\nS\n"
    table = run(tmp_path, (tmp_path / "a.inp").read_text().replace("*END", prints + "*END"))
    found = re.findall(r"^\s+\d+\s+\d+((?:\s+[-+.\dE]+){6})\s*$", table, re.M)
    stress = np.array([[float(x) for x in row.split()] for row in found])
    assert len(stress) and np.abs(stress + [1, 1, 1, 0, 0, 0]).max() < 1e-6


def _nodes(mesh, face):
    return np.concatenate([rows.ravel() for _, rows, _ in deck_of(mesh).faces[face]])


def test_a_material_for_the_shell_and_one_for_the_core(tmp_path):
    mesh = make_volume("box").fem
    two = {"Shell": Material("STEEL"), "Core": Material("FOAM", 210.0, 0.1, 1e-10)}
    text = model(tmp_path, mesh, material=two)
    deck = deck_of(mesh)
    held = prescribed(mesh, np.unique(np.concatenate([c.ravel() for _, _, c in deck.parts])))
    for part, material in two.items():
        prints = f"*EL PRINT, ELSET={part.upper()}\nS\n*END STEP\n"
        table = run(tmp_path, text + held + prints)
        found = re.findall(r"^\s+\d+\s+\d+((?:\s+[-+.\dE]+){6})\s*$", table, re.M)
        stress = np.array([[float(x) for x in row.split()] for row in found])
        exact = stress_of(GRADIENT, material)
        assert len(stress) and np.abs(stress - exact).max() < 1e-6 * np.linalg.norm(exact)
    with pytest.raises(InputError, match="Core has no material"):
        write_inp(tmp_path / "b.inp", mesh, material={"Shell": Material()})
    with pytest.raises(InputError, match="two materials are named"):
        write_inp(
            tmp_path / "b.inp", mesh, material={"Shell": Material(), "Core": Material(young=1.0)}
        )
    assert not (tmp_path / "b.inp").exists()


def test_faces_named_like_sets_of_the_deck():
    names = set_names(["Face1", "Interface", "all"])
    assert names == {"Face1": "FACE1", "Interface": "INTERFACE_2", "all": "ALL_2"}


# ----------------------------------------------------------------------------------- hexahedra


@pytest.mark.parametrize("name", ["box", "torus", "sphere"])
def test_hexahedra_fill_the_body(name):
    volume = make_volume(name)
    fem, mesh = volume.fem, hexahedral(name)
    cells = len(volume.interface.triangles) // 2
    assert len(mesh.hexes) == cells * volume.shell.layer_count and not len(mesh.wedges)
    assert len(mesh.centres) == cells and mesh.figures()["equations"] == 3 * cells
    assert mesh.figures()["nodes"] == len(mesh.nodes) < len(fem.nodes)
    assert mesh.volume == pytest.approx(mesh.boundary_volume, rel=1e-12)
    off = abs(mesh.volume - exact_volume(name)) / exact_volume(name)
    assert off < {"box": 1e-13, "torus": 8e-3, "sphere": 2e-2}[name]
    # nodes on the CAD faces are those of the wedges
    for face in mesh.face_names:
        known = {tuple(x) for x in fem.nodes[fem.face_nodes(face)]}
        own = {tuple(x) for x in mesh.nodes[np.unique(_nodes(mesh, face))]}
        assert own < known and len(known) - len(own) == len(fem.face_triangles(face)) // 2
    # a linear displacement of the side's nodes is one of the node in the middle
    sides = mesh.nodes[mesh.followed]
    assert np.allclose(np.einsum("ek,ekc->ec", mesh.shares, sides), mesh.nodes[mesh.centres])
    assert np.allclose(mesh.shares.sum(axis=1), 1.0, atol=1e-13)
    used = np.concatenate([mesh.hexes.ravel(), mesh.wedges.ravel()])
    assert not np.isin(mesh.centres, used).any() and np.isin(mesh.centres, mesh.tets).all()
    assert mesh.min_scaled_jacobian > 0.01


def test_bezier_form_of_hexahedra():
    rng = np.random.default_rng(3)
    nodes = reference("hex20").nodes
    many = nodes + rng.normal(size=(40, 20, 3)) * np.repeat([0.04, 0.2], 20)[:, None, None]
    elements = bezier_hexahedra(many)
    line = rng.random(3)
    bernstein = np.stack([(1 - line) ** 2, 2 * line * (1 - line), line**2], axis=1)
    found = np.einsum("pi,pj,pk,eijkc->epc", bernstein, bernstein, bernstein,
                      elements.control_points)  # fmt: skip
    points = np.column_stack([line, line, line])
    exact = np.einsum("pn,enc->epc", shape_functions("hex20", points), many - many[:, :1])
    assert np.allclose(found, exact, atol=1e-13)
    # what is proved has no folded sample; samples find some that are not proved
    lattice = np.concatenate([quadrature("hex", 7)[0], nodes])
    least = np.linalg.det(jacobians("hex20", many, lattice)).min(axis=1)
    proof = ej.prove_positive("hex20", many)
    assert (least[proof.proved] >= proof.lower_bound[proof.proved]).all()
    assert (proof.lower_bound[proof.proved] > 0.0).all()
    assert (proof.status[least < 0.0] == ej.INVALID).all()
    assert np.count_nonzero(proof.proved) >= 15
    assert np.count_nonzero(proof.status == ej.INVALID) >= 10
    # volume by another rule; a box has every figure exactly
    points, weights = quadrature("hex", 5)
    by_more = np.linalg.det(jacobians("hex20", many, points)) @ weights
    assert np.allclose(ej.volumes("hex20", many), by_more, rtol=1e-12)
    box_nodes = nodes[None] * [3.0, 2.0, 1e-3] + 1e4
    bound = ej.prove_positive("hex20", box_nodes).lower_bound
    assert bound == pytest.approx(6e-3, rel=1e-6) and ej.scaled_jacobian("hex20", box_nodes) > 0.999
    assert ej.relative_bound("hex20", box_nodes, bound) == pytest.approx(1.0, rel=1e-6)
    with pytest.raises(ValueError, match="hex8"):
        ej.prove_positive("hex8", box_nodes[:, :8])


def test_columns_beside_elements_that_would_fold_stay_wedges():
    volume = make_volume("torus")
    fem = volume.fem
    builder = hexahedra._Builder(fem, volume.interface)
    builder.choose()
    assert builder.taken.all()
    # a corner is moved into the core, so that the side is as warped as it is long
    below, above = builder.hexes[0, 5, [0, 4]]
    nodes = fem.nodes.copy()
    nodes[below] += 0.6 * (nodes[below] - nodes[above])
    mesh = hexahedral_mesh(replace(fem, nodes=nodes), volume.interface)
    gone = len(mesh.wedges) // (2 * volume.shell.layer_count)
    assert 0 < gone < 24 and len(mesh.centres) == len(builder.first) - gone
    assert mesh.volume == pytest.approx(mesh.boundary_volume, rel=1e-12)


def test_what_no_hexahedra_can_be_made_of_is_refused():
    volume = make_volume("box")
    with pytest.raises(InputError, match="second order"):
        hexahedral_mesh(make_volume("box", 1).fem, volume.interface)
    with pytest.raises(FaultError, match="columns"):
        hexahedral_mesh(replace(volume.fem, wedges=volume.fem.wedges[1:]), volume.interface)
