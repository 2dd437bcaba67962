# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Patch tests: what is straight passes, what is torn does not; the table tells both."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from shells import make_volume

from HybridVolume.core.elements import EDGES, jacobians, quadrature, reference
from HybridVolume.reproduce import fem_patch, fem_table
from HybridVolume.reproduce.fem_mesh import Meshed

needs_ccx = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is absent")


@pytest.mark.parametrize("kind", ["tet10", "penta15"])
def test_rules_integrate_what_they_should(kind):
    nodes = reference(kind).nodes
    for rule, degree in ((fem_patch.calculix_rule, 2), (fem_patch.exact_rule, 3)):
        points, weights = rule(kind)
        fine, fine_weights = quadrature(kind.rstrip("0123456789"), 6)
        for power in np.ndindex(4, 4, 4):
            if sum(power) <= degree:
                exact = fine_weights @ np.prod(fine**power, axis=1)
                assert weights @ np.prod(points**power, axis=1) == pytest.approx(exact, rel=1e-12)
        assert np.linalg.det(jacobians(kind, nodes[None], points)).min() > 0.0
    assert len(fem_patch.calculix_rule(kind)[1]) == {"tet10": 4, "penta15": 9}[kind]


def test_a_curved_mesh_conforms_and_a_torn_one_does_not():
    mesh = Meshed.of(make_volume("sphere").fem)
    assert fem_patch.unbalanced(mesh, fem_patch.exact_rule) < 1e-13
    # CalculiX's points do not see curved triangles exactly, but straight ones
    assert fem_patch.unbalanced(mesh, fem_patch.calculix_rule) > 1e-3
    straight = fem_patch.second_order(Meshed.of(make_volume("sphere", 1).fem))
    assert fem_patch.unbalanced(straight, fem_patch.calculix_rule) < 1e-13
    # one tet has its own copy of a mid node, a hair beside
    tets = mesh.elements[1][1].copy()
    tets[0, 4] = len(mesh.nodes)
    moved = mesh.nodes[mesh.elements[1][1][0, 4]] + 1e-3
    torn = Meshed(
        np.vstack([mesh.nodes, moved]), (mesh.elements[0], ("tet10", tets)), mesh.faces, ""
    )
    assert fem_patch.unbalanced(torn, fem_patch.exact_rule) > 1e-4


@needs_ccx
def test_curved_deviates_and_straight_does_not():
    mesh = Meshed.of(make_volume("sphere").fem)
    curved = fem_patch.patch_row("curved", mesh)
    assert 1e-3 < curved["max"] < 0.05
    assert set(curved["elements"]) == {"penta15", "tet10"}
    first = Meshed.of(make_volume("sphere", 1).fem)
    assert fem_patch.patch_row("first order", first)["max"] < 1e-11
    second = fem_patch.second_order(first)
    assert fem_patch.patch_row("straight", second)["max"] < 1e-11
    for kind, rows in second.elements:
        ends = np.array(EDGES[kind])
        middle = second.nodes[rows[:, ends]].mean(axis=2)
        assert np.abs(second.nodes[rows[:, reference(kind).corners :]] - middle).max() < 1e-15
    edges = {tuple(sorted(pair)) for kind, rows in first.elements
             for pair in rows[:, np.array(EDGES[kind])].reshape(-1, 2).tolist()}  # fmt: skip
    assert len(second.nodes) == len(first.nodes) + len(edges)


def case(**rows):
    made = [
        {"mesh": name, "nodes": 5, "elements": {"tet10": 2}, "max": value, "rms": value}
        for name, value in rows.items()
    ]
    return {"case": "ball", "error": None, "rows": made,
            "conforming": {"exact": 1e-16, "calculix": 2e-2}}  # fmt: skip


def found(**more):
    machine = {"processor": "some", "cores": 2, "python": "3"}
    empty = {"patch_tests": [], "load_sums": [], "accuracy": [], "pictures": [], "missing": [],
             "not_done": [], "machine": machine}  # fmt: skip
    values = {**empty, **more}
    values["demands"] = fem_table.demands(values)
    return values


def test_demands_follow_the_figures():
    loads = {
        "case": "ball", "error": None, "face": "Face1", "curved": 0.3,
        "rows": [
            {"load": "pressure", "exact": [3.0, 4.0, 0.0], "freecad_error": 9e-4,
             "ours_error": 1e-9, "freecad": [3.0, 4.0, 0.0], "ours": [3.0, 4.0, 0.0]},
            {"load": "weight", "exact": [0.0, 0.0, 1.0], "freecad_error": 2e-3, "freecad": []},
        ],
    }  # fmt: skip
    lost = {"case": "cube", "error": {"code": "worker", "message": "gone"}}
    values = found(
        patch_tests=[case(straight=9e-7, curved=2e-2), lost], load_sums=[loads], not_done=["a-b"]
    )
    met = {(row["case"], row["demand"].split(":")[0].split(" within")[0]): row["met"]
           for row in values["demands"]}  # fmt: skip
    assert met == {
        ("ball", "patch test, straight"): True,
        ("ball", "patch test, curved"): False,
        ("cube", "patch test"): False,
        ("ball", "sum of pressure"): True,
        ("ball", "sum of weight"): False,
    }
    text = fem_table.as_markdown(values)
    for words in ("2 of 5 demands are met", "2.0e-02", "| 5 ", "0.0900 %", "worker: gone", "a-b"):
        assert words in text
    assert max(len(line) for line in fem_table.INTRODUCTION.splitlines()) <= 100


def test_nothing_measured_is_no_table():
    text = fem_table.as_markdown(found())
    assert "Patch tests" not in text and "demanded" not in text


def test_an_element_that_is_not_proved_is_counted():
    fem = make_volume("sphere").fem
    turned = fem.tets.copy()
    turned[0] = turned[0][[1, 0, 2, 3, 4, 6, 5, 8, 7, 9]]
    assert fem_patch.unproved(Meshed.of(replace(fem, tets=turned))) == 1
