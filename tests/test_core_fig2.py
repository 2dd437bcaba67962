# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The dropped disk of the paper's Fig. 2: what counts as flipped, and what the layers prevent."""

import numpy as np
import pytest

from HybridVolume.reproduce import main
from HybridVolume.reproduce.fig2 import SHOWN, SMALL, all_cases
from HybridVolume.reproduce.fig2_drop import (
    AGAINST,
    BODIES,
    Drop,
    circle,
    deformed_ring,
    disk,
    dropped,
    flipped,
    height,
)
from HybridVolume.reproduce.fig2_table import as_markdown, demands, safe_from

SMALL_DROP = Drop(SHOWN, **SMALL)


@pytest.fixture(scope="module")
def spaces():
    """The four representations, coarse."""
    return {body.name: disk(body, SMALL_DROP) for body in BODIES}


@pytest.fixture(scope="module")
def drops():
    """Triangles alone and three layers, dropped."""
    return {body.name: dropped(body, SMALL_DROP) for body in (BODIES[0], BODIES[3])}


def _reference(space):
    """Coefficients of the body's own points."""
    nodes = space.tets.nodes[space.free_nodes]
    return np.concatenate([space.spline.control_points, nodes])


def test_circle_has_the_disk_s_area_and_is_round():
    curve = circle(50.0, 16, turn=11.0)
    assert curve.area == pytest.approx(np.pi * 50.0**2, rel=1e-12)
    u = np.linspace(0.0, 1.0, 200)
    radius = np.linalg.norm(curve.evaluate(np.zeros(200, dtype=int), u), axis=1)
    assert np.ptp(radius) < 2e-3 * 50.0


def test_about_equal_unknowns(spaces):
    sizes = np.array([space.size for space in spaces.values()])
    assert np.abs(sizes / SMALL_DROP.unknowns - 1.0).max() <= AGAINST
    # thicker layers leave fewer triangles
    triangles = [len(space.tets.elements) for space in spaces.values()]
    assert triangles == sorted(triangles, reverse=True)


@pytest.mark.parametrize("name", [body.name for body in BODIES])
def test_mirrored_bodies_are_flipped_everywhere_and_turned_ones_nowhere(spaces, name):
    space = spaces[name]
    at = _reference(space)
    mirrored = flipped(space, at * [0.0, -2.0])
    assert mirrored.triangles == len(space.tets.elements)
    ring = deformed_ring(space, at * 0.0)
    assert mirrored.ring == (0 if ring is None else ring.jacobian_bounds.size)
    assert mirrored.area == pytest.approx(1.0, abs=1e-12)
    angle = 2.1
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = flipped(space, at @ turn.T - at + [3.0, -7.0])
    assert (turned.elements, turned.area) == (0, 0.0)


def test_a_node_pulled_across_its_neighbours_flips_what_shoelaces_say(spaces):
    space = spaces["three-layers"]
    pulled = np.zeros((space.size, 2))
    pulled[-1] = [0.0, 30.0]
    x = space.tets.nodes.copy()
    x[space.free_nodes[-1]] += pulled[-1]
    a, b, c = np.swapaxes(x[space.tets.elements], 0, 1)
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    found = flipped(space, pulled)
    assert found.triangles == (area < 0.0).sum() > 0
    assert found.ring == 0
    # a control point of the second row, beyond the inner curve, folds layers only
    pulled = np.zeros((space.size, 2))
    column = space.spline.columns
    pulled[column] = -1.2 * space.spline.control_points[column]
    found = flipped(space, pulled)
    assert found.triangles == 0 and found.ring > 0 and 0.0 < found.area < 0.2


def test_the_touch_has_the_energy_of_the_fall_and_rest_carries_the_weight(drops):
    weight = SMALL_DROP.density * np.pi * SMALL_DROP.radius**2 * SMALL_DROP.gravity
    for drop in drops.values():
        touch = drop["energies"][0]
        # a polygon lacks a little of the disk's area
        assert touch["kinetic"] == pytest.approx(weight * SMALL_DROP.height, rel=1.2e-2)
        assert touch["elastic"] == touch["gravity"] == touch["contact"] == 0.0
        assert drop["rest"]["forces_left"] <= 1e-3
        # contact lasts longer than a wave needs to the top and back
        speed = np.sqrt(SMALL_DROP.young / SMALL_DROP.density)
        assert SMALL_DROP.radius / speed < drop["impact"]["time"] < 0.06
        pressed, still = (height(drop[when]["outline"]) for when in ("impact", "rest"))
        assert SMALL_DROP.radius < pressed < still < 2.0 * SMALL_DROP.radius
        assert drop["drift"] < 1e-7
        heat = [row["dissipated"] for row in drop["energies"]]
        assert (np.diff(heat) >= -1e-12).all()


def test_triangles_stay_flipped_and_three_layers_do_not(drops):
    alone, layers = drops["triangles"], drops["three-layers"]
    assert alone["rest"]["triangles"] > 0 and alone["rest"]["area"] > 0.01
    assert layers["rest"]["flipped"] == 0 and layers["rest"]["area"] == 0.0
    x = np.array(alone["rest"]["outline"]["vertices"])[alone["rest"]["outline"]["triangles"]]
    turned = np.linalg.det(x[:, 1:] - x[:, :1]) < 0.0
    assert np.flatnonzero(turned).tolist() == alone["rest"]["outline"]["turned"]


def test_table_tells_what_is_met(drops):
    cases = [
        {"name": name, "part": "scan", "case": name, "error": None, **drop}
        for name, drop in drops.items()
    ]
    for case in cases:
        case["rest"] = {**case["rest"], "height": height(case["rest"]["outline"])}
    rows = demands(cases, SHOWN)
    assert len(rows) == 5 and all(row["met"] for row in rows)
    swapped = [{**case, "rest": drops["three-layers"]["rest"]} for case in cases]
    assert [row["met"] for row in demands(swapped, SHOWN)] == [True, True, True, False, True]
    softer = {**cases[1], "drop": {**cases[1]["drop"], "young": 0.01},
              "rest": cases[0]["rest"]}  # fmt: skip
    assert safe_from([*cases, softer], "three-layers") == SHOWN
    assert safe_from(cases, "triangles") is None
    text = as_markdown(
        {"command": "c", "cases": cases, "demands": rows, "shown": SHOWN, "pictures": [],
         "missing": [], "not_done": [],
         "machine": {"processor": "p", "cores": 2, "python": "3"}}
    )  # fmt: skip
    assert "5 of 5 demands are met" in text and "three layers" in text


def test_cases_differ_in_name_and_key_and_unknown_ones_are_refused(tmp_path, capsys):
    cases = all_cases()
    assert len({case.name for case in cases}) == len({case.key() for case in cases}) == len(cases)
    assert main(["fig2", "-o", str(tmp_path / "out"), "--only", "four-layers"]) == 2
    assert "four-layers: no such part or case" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
