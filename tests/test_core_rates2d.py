# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Studies in the plane: rates of section 4 and higher ones, small; what they solve, and tables."""

import json

import numpy as np
import pytest

from HybridVolume.errors import SetupError
from HybridVolume.job import worker_python
from HybridVolume.reproduce import depth, fig7, main, rates2d
from HybridVolume.reproduce.plane_problems import BODIES, RUBBER, drum, shear_waves, wave
from HybridVolume.reproduce.plane_study import against, studied


@pytest.mark.parametrize("name", BODIES)
def test_problems_are_what_they_say(name):
    curve = BODIES[name][0]()
    middle = curve.points[:, :2].mean(axis=0)
    x = middle + 0.2 * np.random.default_rng(0).standard_normal((20, 2))
    step = 1e-4
    moves = step * np.eye(2)
    for problem in (drum(), wave(curve), shear_waves(curve)):
        slope = np.stack(
            [(problem.exact(x + m) - problem.exact(x - m)) / (2.0 * step) for m in moves], axis=-1
        )
        assert np.abs(problem.slope(x) - slope).max() < 1e-6 * np.abs(slope).max()
        if problem.components == 1:
            divergence = sum(
                (problem.slope(x + m)[:, c] - problem.slope(x - m)[:, c]) / (2.0 * step)
                for c, m in enumerate(moves)
            )
        else:
            divergence = sum(
                (_stress(problem.slope(x + m))[:, :, c] - _stress(problem.slope(x - m))[:, :, c])
                / (2.0 * step)
                for c, m in enumerate(moves)
            )
        assert np.abs(problem.source(x) + divergence).max() < 1e-5 * np.abs(divergence).max()


def _stress(slope):
    strain = 0.5 * (slope + np.swapaxes(slope, 1, 2))
    trace = np.trace(strain, axis1=1, axis2=2)[:, None, None]
    return RUBBER.lame * trace * np.eye(2) + 2.0 * RUBBER.shear * strain


def test_rates_of_the_small_run():
    cases = [studied(family) for family in rates2d.SMALL]
    rates2d.compare(cases)
    assert [case["error"] for case in cases] == [None] * len(cases)
    rows = rates2d.demands(cases)
    assert len(rows) == 8
    assert [row["figure"] for row in rows if not row["met"]] == []
    by_name = {case["name"]: case for case in cases}
    paper = by_name[rates2d.paper_mode(0.15).name]
    # a share is the error over that of as many triangles' unknowns, whose error is C / n
    alone = cases[0]
    row, other = paper["levels"][1], alone["levels"][2]
    share = row["l2"] * row["unknowns"] / (other["l2"] * other["unknowns"])
    assert row["l2_share"] == pytest.approx(share, rel=0.05)
    assert against(alone, alone) == pytest.approx([1.0] * 4)
    text = "\n".join(rates2d.paragraphs({"cases": cases, "demands": rows}))
    assert "8 of 8 demands are met" in text
    assert f"| {paper['unknowns']} " in text


def test_demands_see_wrong_rates():
    row = {"unknowns": 10, "l2": 1.0, "h1": 1.0, "l2_share": 2.0, "l2_rate": None, "h1_rate": None}
    slow = [row, {**row, "l2_rate": 1.0, "h1_rate": 0.5}, {**row, "l2_rate": 1.5, "h1_rate": 0.7}]
    case = {"name": rates2d.paper_mode(0.3).name, "levels": slow}
    assert [one["met"] for one in rates2d.paper_demands([case], 0.3)] == [False, False, False]
    assert [one["met"] for one in rates2d.paper_demands([], 0.3)] == [None, None, None]


def test_a_deeper_ring_is_better():
    cases = depth.made(small=True)
    found = {(case["depth"], case["layers"]): case["l2_share"] for case in cases if case["p"]}
    assert all(case["error"] is None for case in cases)
    # section 4's functions have most of their energy near the boundary
    assert found[0.5, 2] < found[0.3, 2] < found[0.1, 2]
    # one layer is too coarse for a deep ring
    assert found[0.5, 1] > 2.0 * found[0.5, 2]


def test_reliefs_are_the_solution():
    family = rates2d.paper_mode(0.3)
    problem = family.problem()
    scene = fig7.relief(next(iter(family.spaces())), problem)
    core, ring = (skin.points for skin in scene.skins)
    exact = problem.exact(ring[:, :2])
    scale = fig7.HEIGHT / np.abs(core[:, 2]).max()
    assert scale > 0.0
    # heights of the ring are those of the exact function, all with one factor
    factor = (ring[:, 2] @ exact) / (exact @ exact)
    assert np.abs(ring[:, 2] - factor * exact).max() < 0.15 * fig7.HEIGHT
    assert np.hypot(*ring[:, :2].T).min() == pytest.approx(0.7, abs=0.02)


def test_the_command_writes_its_files(tmp_path):
    try:
        worker_python()
    except SetupError as missing:
        pytest.skip(missing.message)
    assert main(["fig7", "--small", "-o", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "fig7.json").read_text(encoding="utf-8"))
    assert {"name", "p", "k", "coupling", "unknowns", "l2", "h1", "l2_rate", "h1_rate"} <= set(
        found["cases"][0]
    )
    text = (tmp_path / "fig7.md").read_text(encoding="utf-8")
    assert text.startswith("## Fig. 7") and "./run.sh reproduce fig7" in text
    drawn = [name for name, _ in found["pictures"]]
    assert len(drawn) == 3
    for name in drawn:
        assert f"pictures/{name}" in text
        assert (tmp_path / "pictures" / name).read_bytes().startswith(b"\x89PNG")
