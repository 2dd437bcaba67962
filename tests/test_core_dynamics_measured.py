# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What ``reproduce dynamics`` measures, on bodies of a few elements."""

import numpy as np
import pytest

from HybridVolume.core.analysis.coupling import NitscheSpace
from HybridVolume.core.recovery import Material
from HybridVolume.reproduce import dynamics_motion, dynamics_table
from HybridVolume.reproduce.bodies import box, torus
from HybridVolume.reproduce.rates3d_case import made_shell, made_space


@pytest.fixture(scope="module")
def block():
    shell = made_shell(box((3.0, 2.0, 1.0), (1, 1, 1)), 2, 0.5, True)
    return made_space(shell, 1, "collocation")


def nothing(share, text):
    pass


def test_a_drop_and_its_series(block, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    drop = dynamics_motion.Drop(
        up=(0.3, 0.2, 1.0), step=1e-3, steps=10, every=5, pictures=3, young=0.004
    )
    found = dynamics_motion.dropped(block, drop, tmp_path, "block", nothing)
    assert found["impacts"] >= 1
    assert found["most_elastic"] > 0.1
    assert found["drift"] < 1e-6
    # half m v² of 6 mm³ of 1e-9 t/mm³, but for what straight tets leave out under the shell
    assert 0.9 < found["kinetic"] / (0.5 * 6e-9 * drop.speed**2) < 1.0
    demands = dynamics_table.demands(
        {"drops": [{**found, "name": "block", "error": None}], "flights": [], "modes": [],
         "rest": []}
    )  # fmt: skip
    assert all(row["met"] for row in demands if "drift" in row["demand"])
    # ParaView's own reader finds the times, and a body that has fallen as one
    series = pyvista.get_reader(str(tmp_path / "block.pvd"))
    assert series.time_values == pytest.approx([0.0, 5e-3, 1e-2])
    series.set_active_time_point(2)
    (grid,) = series.read()
    moved = np.asarray(grid.point_data["displacement"])
    rows = {round(row["time"], 9): row for row in found["energies"]}
    up = np.array(drop.up) / np.linalg.norm(drop.up)
    assert (moved @ up).mean() == pytest.approx(rows[1e-2]["height"], abs=0.3)
    assert np.asarray(grid.point_data["von Mises stress"]).max() > 0.0
    with np.load(tmp_path / "block.npz") as file:
        assert file["points"].shape[0] == len(file["time"]) == 3
        assert np.isfinite(file["stress"]).all()


def test_a_flight(block):
    found = dynamics_motion.flown(block, "conserving", 3, nothing)
    assert max(found["linear"], found["angular"], found["energy"]) < 1e-10
    assert found["elastic"] > 0.02


def test_rigid_motions_on_a_curved_body():
    space = made_space(made_shell(torus(3.0, 1.0), 2, 0.5, True), 1, "collocation")
    nitsche = NitscheSpace(space.spline, space.tets)
    for coupled in (space, nitsche):
        found = dynamics_motion.at_rest(coupled)
        assert max(found["linear"], found["svk"]) < 1e-10


def test_frequencies_of_a_sphere():
    # omega R / c_s from the literature: 2.501 whatever Poisson's ratio is, 2.640 at 1/4, and the
    # breathing mode, which is 4.440 there
    found = {name: omega for name, omega, _ in dynamics_motion.sphere_frequencies(0.25)}
    assert found["T2"] == pytest.approx(2.5011, abs=1e-4)
    assert found["S2"] == pytest.approx(2.640, abs=1e-3)
    assert found["S0"] == pytest.approx(4.440, abs=1e-3)
    other = {name: omega for name, omega, _ in dynamics_motion.sphere_frequencies(0.3)}
    assert other["T2"] == pytest.approx(found["T2"], rel=1e-9)
    assert other["S2"] == pytest.approx(2.646, abs=1e-3)


def test_equivalent_stress_of_a_turned_and_pulled_bar():
    # pulled by 10 % along a turned axis: F = Q diag(1.1, 1, 1), nu = 0, so S = E e
    steel = Material(100.0, 0.0)
    angle = 0.7
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0, 0, 1]]
    )
    gradient = (turn @ np.diag([1.1, 1.0, 1.0]) - np.eye(3)).T[None]
    exact = 1.1**2 / 1.1 * 100.0 * 0.5 * (1.1**2 - 1.0)
    assert dynamics_motion.equivalent(gradient, steel) == pytest.approx([exact], rel=1e-12)
