# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""CalculiX from arrays to arrays: exact answers, and nothing wrong that looks like one."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from box_mesh import box_mesh

from HybridVolume.core.recovery import Material
from HybridVolume.errors import FaultError, InputError, SetupError, WorkerError
from HybridVolume.reproduce import calculix, fem_patch
from HybridVolume.reproduce.fem_mesh import Meshed

needs_ccx = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is absent")
SIZE = np.array([3.0, 2.0, 1.0])
NAMES = ("left", "right", "front", "back", "bottom", "top")
STEEL = Material(210_000.0, 0.3)


def box(order=2):
    """Box whose inner corners are moved at random, edges straight."""
    fem = box_mesh(SIZE, NAMES, 1)
    nodes = fem.nodes.copy()
    inner = np.arange(8, 17)
    nodes[inner] += 0.06 * np.random.default_rng(1).normal(size=(9, 3))
    mesh = Meshed.of(replace(fem, nodes=nodes))
    return fem_patch.second_order(mesh) if order == 2 else mesh


def held(mesh, faces=("left", "front", "bottom")):
    """Symmetry on three faces: none may leave its plane."""
    prescribed = np.full_like(mesh.nodes, np.nan)
    for face, axis in zip(faces, range(3), strict=True):
        prescribed[mesh.face_nodes(face), axis] = 0.0
    return prescribed


@needs_ccx
@pytest.mark.parametrize("order", [1, 2])
def test_a_linear_field_has_all_digits(order):
    row = fem_patch.patch_row("box", box(order))
    # .frd has six digits, .dat seven: 1e-12 can only be double precision
    assert row["max"] < 1e-12 and row["displacement"] < 1e-12
    assert row["unproved"] == 0 and not row["warnings"]


@needs_ccx
def test_a_pulled_bar():
    mesh = box()
    traction = 5.0
    found = calculix.solve(
        mesh.nodes,
        mesh.elements,
        STEEL,
        held(mesh),
        pressures=[(mesh.faces["right"][1][:, :3], -traction)],
    )
    strain = traction / STEEL.young
    exact = mesh.nodes * strain * [1.0, -STEEL.poisson, -STEEL.poisson]
    assert found.displacement == pytest.approx(exact, abs=1e-12 * strain)
    for values in found.gauss_stress:
        assert values == pytest.approx(
            np.broadcast_to([traction, 0, 0, 0, 0, 0], values.shape), abs=1e-10
        )
    assert found.stress[:, 0] == pytest.approx(np.full(len(mesh.nodes), traction), rel=1e-5)
    assert found.volume == pytest.approx(SIZE.prod(), rel=1e-6)
    pulled = found.force[mesh.face_nodes("right")].sum(axis=0)
    assert pulled[0] == pytest.approx(traction * SIZE[1] * SIZE[2], rel=1e-5)
    assert [len(values[0]) for values in found.gauss_stress] == [9, 4]


@needs_ccx
def test_weight_and_forces_add_up():
    mesh = box()
    forces = np.zeros_like(mesh.nodes)
    forces[mesh.face_nodes("top")[0]] = [1.0, 2.0, 3.0]
    prescribed = np.full_like(mesh.nodes, np.nan)
    prescribed[mesh.face_nodes("bottom")] = 0.0
    found = calculix.solve(
        mesh.nodes, mesh.elements, STEEL, prescribed,
        forces=forces, density=2.0, gravity=(0.0, 0.0, -10.0),
    )  # fmt: skip
    assert np.abs(found.force.sum(axis=0)).max() < 1e-3
    above = np.setdiff1d(np.arange(len(mesh.nodes)), mesh.face_nodes("bottom"))
    down = found.force[above].sum(axis=0) - [1.0, 2.0, 3.0]
    assert np.abs(down[:2]).max() < 1e-3
    assert -2.0 * 10.0 * SIZE.prod() < down[2] < -0.8 * 2.0 * 10.0 * SIZE.prod()


@needs_ccx
def test_equations_bind_nodes():
    mesh = box()
    first, second = mesh.face_nodes("right")[:2]
    prescribed = np.full_like(mesh.nodes, np.nan)
    prescribed[mesh.face_nodes("left")] = 0.0
    forces = np.zeros_like(mesh.nodes)
    forces[first] = [0.0, 0.0, 1.0]
    bound = [[(int(first), axis, 1.0), (int(second), axis, -1.0)] for axis in range(3)]
    found = calculix.solve(
        mesh.nodes, mesh.elements, STEEL, prescribed, forces=forces, equations=bound
    )
    assert found.displacement[first] == pytest.approx(found.displacement[second], rel=1e-9)
    assert found.displacement[first, 2] > 0.0


@needs_ccx
def test_what_calculix_refuses_is_an_error(tmp_path):
    mesh = box()
    wedges, (kind, tets) = mesh.elements
    inverted = tets[:, [1, 0, 2, 3, 4, 6, 5, 8, 7, 9]]
    with pytest.raises(WorkerError, match="nonpositive jacobian"):
        calculix.solve(mesh.nodes, [wedges, (kind, inverted)], STEEL, held(mesh), folder=tmp_path)
    assert (tmp_path / "case.inp").is_file() and not (tmp_path / "case.rout").exists()
    with pytest.raises(WorkerError, match=r"within 0\.001 s"):
        calculix.solve(mesh.nodes, mesh.elements, STEEL, held(mesh), time_limit=0.001)


def test_what_cannot_be_solved_is_refused(monkeypatch):
    mesh = box()
    free = np.full_like(mesh.nodes, np.nan)
    sliding = held(mesh)
    sliding[:, 2] = np.nan
    monkeypatch.setattr(shutil, "which", lambda name: "/bin/true")
    for prescribed in (free, sliding):
        with pytest.raises(InputError, match="do not hold the body"):
            calculix.solve(mesh.nodes, mesh.elements, STEEL, prescribed)
    with pytest.raises(InputError, match="do not belong"):
        calculix.solve(mesh.nodes, mesh.elements, STEEL, free[1:])
    with pytest.raises(InputError, match="no hex9"):
        calculix.solve(mesh.nodes, [("hex9", np.zeros((1, 9), int))], STEEL, free)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(SetupError, match="not installed"):
        calculix.solve(mesh.nodes, mesh.elements, STEEL, held(mesh))


def test_pressure_finds_the_sides_of_elements():
    mesh = box()
    ((owner, side, value),) = calculix.element_loads(
        mesh.elements, [(mesh.faces["top"][1][:, [2, 0, 1]], np.array([1.0, 2.0]))]
    )
    # wedges stand on the core: their outer side is CalculiX's second
    assert side.tolist() == [2, 2] and value.tolist() == [1.0, 2.0]
    wedges = mesh.elements[0][1]
    for element, triangle in zip(owner, mesh.faces["top"][1], strict=True):
        assert set(triangle[:3]) <= set(wedges[element - 1])
    inside = mesh.elements[0][1][:, [0, 1, 2]]
    with pytest.raises(InputError, match="12 faces that are no outer faces"):
        calculix.element_loads(mesh.elements, [(inside, 1.0)])


def test_numbers_with_long_exponents_are_read():
    head = " -4  DISP        4    1\n -5  D1          1    2    1    0\n"
    short = " -1         7 1.00000E+00-2.00000E-03 3.00000E+10\n"
    long = " -1         9-1.00000E-100 2.00000E+00-3.00000E-101\n"
    for rows, wanted in (
        (short, [[1.0, -2e-3, 3e10]]),
        (short + long, [[1.0, -2e-3, 3e10], [-1e-100, 2.0, -3e-101]]),
    ):
        numbers, values = calculix.frd_block((head + rows + " -3\n").encode(), "DISP", 3)
        assert numbers.tolist() == [7, 9][: len(wanted)]
        assert values == pytest.approx(np.array(wanted), rel=1e-15)
    with pytest.raises(FaultError, match="0 blocks of STRESS"):
        calculix.frd_block(head.encode(), "STRESS", 6)


def test_a_restart_file_that_is_cut_off_is_a_fault(tmp_path):
    path = tmp_path / "case.rout"
    path.write_bytes(b"\x08\x00\x00\x00" + b"12345678" + b"\x08\x00\x00\x00" + b"\x10\x00\x00\x00")
    with pytest.raises(FaultError, match="ends too early"):
        list(calculix._records(path))
