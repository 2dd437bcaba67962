# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What ``./run.sh reproduce rates3d`` measures: rates from one span a patch on, and tables."""

import json

import bodies
import numpy as np
import pytest
import shells

from HybridVolume import reproduce
from HybridVolume.core.analysis.elevation import elevated_shell
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.element_jacobians import volumes
from HybridVolume.reproduce import rates3d_table as tables
from HybridVolume.reproduce.fem_mesh import Meshed
from HybridVolume.reproduce.rates3d_case import made_space, rates
from HybridVolume.reproduce.rates3d_measure import tets_alone
from HybridVolume.reproduce.rates3d_problems import PROBLEMS


def torus():
    surface = build_surface(list(bodies.torus(spans=1).faces))
    shell = shells.shell_towards(surface, shells.BODIES["torus"][1], layers=1, degree=2)
    return shell, 6.0 * np.pi**2


def box():
    surface = build_surface(list(bodies.box((3.0, 2.0, 1.0), (1, 1, 1)).faces))
    middle = np.array([1.5, 1.0, 0.5])
    return shells.shell_towards(surface, lambda x: 0.5 * (x + middle), layers=1, degree=3), 6.0


@pytest.mark.parametrize(
    ("body", "degree", "coupling", "least"),
    [(torus, 2, "collocation", (2.8, 1.9)), (box, 3, "nitsche", (3.7, 2.6))],
)
def test_rates(body, degree, coupling, least):
    shell, volume = body()
    space = made_space(elevated_shell(shell, degree), degree, coupling)
    found = rates(space, "poisson", 3)
    assert found[-1]["l2_rate"] >= least[0]
    assert found[-1]["h1_rate"] >= least[1]
    # the elements are the body, as far as they fit without gaps
    assert found[-1]["volume"] == pytest.approx(volume, rel=1e-4)


@pytest.mark.parametrize("name", ["poisson", "elasticity", "lame"])
def test_solutions_solve_their_equations(name):
    faces = bodies.hollow_sphere(2.0, 1.0, spans=1).faces
    problem = PROBLEMS[name](build_surface(list(faces)))
    x = np.array([[1.2, 0.3, -0.4], [0.2, -1.1, 0.9], [-0.7, 0.8, 1.1]])
    step = 1e-4

    def derivative(field):
        ways = step * np.eye(3)
        return np.stack([(field(x + way) - field(x - way)) / (2.0 * step) for way in ways], -1)

    assert np.abs(problem.slope(x) - derivative(problem.exact)).max() < 1e-7

    def flux(at):
        slope = problem.slope(at)
        return slope if problem.components == 1 else problem.stress(slope)

    source = -np.trace(derivative(flux), axis1=-2, axis2=-1)
    wanted = problem.source(x) if problem.source else np.zeros_like(source)
    assert np.abs(source - wanted).max() < 1e-5
    if problem.pressed:
        # the pressure on the cavity, whose normal points to the middle
        normal = -x / np.linalg.norm(x, axis=1, keepdims=True)
        inside = -normal
        traction = np.einsum("mij,mj->mi", problem.stress(problem.slope(inside)), normal)
        assert np.abs(traction + problem.pressed * normal).max() < 1e-12


def test_curved_tets_alone_keep_their_volume():
    corners = np.vstack([np.zeros(3), np.eye(3)])
    pairs = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
    nodes = np.vstack([corners, [corners[list(pair)].mean(axis=0) for pair in pairs]])
    nodes[4:] += 0.05 * np.random.default_rng(1).standard_normal((6, 3))
    rows = np.arange(10)[None]
    faces = {"Face1": ("tri6", np.array([[0, 2, 1, 6, 5, 4]]))}
    space = tets_alone(Meshed(nodes, (("tet10", rows),), faces))
    found = sum(s.measure.sum() for s in space.samples())
    assert found == pytest.approx(volumes("tet10", nodes[rows]).sum(), rel=1e-12)


def case(name, p, unknowns, energy, **more):
    levels = [
        {"unknowns": n, "l2": e / 10.0, "h1": e, "energy": e, "solver": {}}
        for n, e in zip(unknowns, energy, strict=True)
    ]
    return {
        "name": name, "body": "torus", "problem": "poisson", "p": p, "k": 2, "w0": 0.5,
        "coupling": "collocation", "start": "own", "cuts": 1, "finer": 0, "error": None,
        "levels": levels, **more,
    }  # fmt: skip


def test_equal_unknowns():
    # errors of tets alone fall like n^(-2/3): 1 at 1000 unknowns
    alone = case("alone", 0, (1000, 8000, 64000), (1.0, 0.25, 0.0625))
    own = case("own", 2, (1000, 8000), (0.5, 0.125))
    # .125 is what they have at 8000 * 2^1.5 unknowns
    share = tables._share(own, alone, "energy")
    assert share == pytest.approx(2.0**-1.5)
    assert tables._at(alone["levels"], "energy", 8000) == pytest.approx(0.25)
    assert tables._at(alone["levels"], "energy", 500) is None
    found = {"cases": [own], "tets": [alone], "gaps": []}
    (row,) = [row for row in tables.demands(found) if "aim" in row["demand"]]
    assert row["met"] is False
    better = case("own", 3, (1000, 4000), (0.5, 0.125))
    found["cases"].append(better)
    (row,) = [row for row in tables.demands(found) if "aim" in row["demand"]]
    assert row["met"] is True
    assert row["figure"].startswith("0.18 (p = 3")


def test_demands_follow_the_last_rate():
    good = case("a", 2, (10, 80), (1.0, 0.2), l2_rate=3.0, h1_rate=2.0)
    bad = {**good, "h1_rate": 1.5}
    for rows, met in (([good], True), ([bad], False), ([bad, good], True), ([], None)):
        found = tables.demands({"cases": rows, "tets": [], "gaps": []})
        (row,) = [row for row in found if row["case"].startswith("torus, quadratic")]
        assert row["met"] is met


def test_tables_of_nothing(tmp_path, python):
    assert reproduce.main(["rates3d", "-o", str(tmp_path), "--small", "--gather"]) == 1
    found = json.loads((tmp_path / "rates3d.json").read_text(encoding="utf-8"))
    assert found["cases"] == []
    assert len(found["not_done"]) == 2
    assert "Not done yet" in (tmp_path / "rates3d.md").read_text(encoding="utf-8")
    assert reproduce.main(["rates3d", "-o", str(tmp_path), "--only", "nonsense"]) == 2
