# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What a shell has become beside what was asked, on shells whose thickness is known exactly."""

from __future__ import annotations

from dataclasses import replace

import bodies
import numpy as np
import pytest
from shells import make_shell, shell_towards

from HybridVolume import report
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.goals import Thickness
from HybridVolume.core.levels import Spacing
from HybridVolume.core.pipeline import Options, complete
from HybridVolume.core.reached import inner_figures, layer_heights, reached_figures
from HybridVolume.core.shell import Shell

SIZE = np.array([3.0, 2.0, 1.0])
SURFACE = build_surface(list(bodies.box(SIZE, (4, 4, 4), 1).faces))
TOP = next(
    p.face for p in SURFACE.patches if (SURFACE.control_points[p.index][..., 2] == SIZE[2]).all()
)


def offset_box(depth: float, top: float | None = None, layers: int = 2) -> Shell:
    """A shell whose inner boundary is a box, everywhere or but for the top equally deep."""
    low = np.full(3, depth)
    high = SIZE - [depth, depth, depth if top is None else top]
    n = len(SURFACE.control_points)
    shell = shell_towards(SURFACE, lambda x: low + x / SIZE * (high - low), layers)
    level = np.full(n, 0.4)
    return replace(shell, level=level, goal=np.full(n, 0.5), w0=0.4, w0_asked=0.5)


def test_distances_of_a_box_in_a_box_are_exact():
    found = reached_figures(offset_box(0.2), Thickness.parse("0.2 mm"))
    assert list(found["thickness"].values()) == pytest.approx([0.2] * 3, rel=1e-9)
    assert [row["face"] for row in found["faces"]] == [f"Face{k}" for k in range(1, 7)]
    assert [row["share"] for row in found["faces"]] == pytest.approx([1.0] * 6, rel=1e-9)
    assert found["sentence"] == ""
    assert found["asked"] == {"kind": "even", "value": 0.2, "text": "0.2 mm", "factors": {}}


def test_the_thinnest_face_is_named_first():
    shell = offset_box(0.2, top=0.1)
    found = reached_figures(shell, Thickness.parse("0.25 mm"))
    rows = {row["face"]: row for row in found["faces"]}
    # the inner side of the top is .1 below it, and its rim nowhere nearer to another face
    assert rows[TOP]["thickness"] == pytest.approx({"min": 0.1, "mean": 0.1, "max": 0.1})
    assert rows[TOP]["share"] == pytest.approx(0.4)
    # four sides of 1 x (3 + 3 + 2 + 2) go from .1 at the top to .2, the bottom has .2
    side = rows["Face1"]["thickness"]
    assert side["min"] == pytest.approx(0.1) and side["max"] == pytest.approx(0.2)
    said = found["sentence"]
    assert said.startswith("asked 0.25 mm, reached 0.1")
    assert f"; thinner than asked at {TOP} (40 %), Face" in said and "(0.1 to 0.2)" in said


def test_levels_are_averaged_over_the_faces():
    shell = offset_box(0.2)
    level = np.where(SURFACE.control_points[:, 2] == SIZE[2], 0.25, 0.5)
    found = reached_figures(replace(shell, level=level), Thickness("w0", 0.5))
    rows = {row["face"]: row for row in found["faces"]}
    assert rows[TOP]["w0"] == pytest.approx({"min": 0.25, "mean": 0.25, "max": 0.25})
    assert rows[TOP]["share"] == pytest.approx(0.5) and rows[TOP]["w0_asked"] == 0.5
    # at the sides the level falls to .25 over the uppermost of four rows: 1/8 of .25 is missing
    assert rows["Face1"]["w0"]["mean"] == pytest.approx(0.5 - 0.25 / 8)
    # the corners of a box are sharp: 55 degrees between a column and the normals
    assert rows[TOP]["reason"] == "sharp edge"
    whole = (6.0 * 0.25 + 6.0 * 0.5 + 10.0 * (0.5 - 0.25 / 8)) / 22.0
    assert f"asked w0 = 0.5, reached {whole:.3g} in the mean (0.25 to 0.5)" in found["sentence"]
    assert f"thinner than asked at {TOP} (50 %" in found["sentence"]


def test_heights_of_layers():
    assert layer_heights(offset_box(0.2, layers=4)) == pytest.approx([0.05] * 4)
    ball = make_shell("sphere")
    # control points drawn to .6 of their distance: .4 between both ends, whatever lies between
    assert sum(layer_heights(ball)) == pytest.approx(0.4, abs=0.04)


def test_the_inner_surface_carries_its_figures():
    shell = make_shell("torus")
    found = inner_figures(shell, 4)
    around = np.linalg.norm(found.vertices[:, :2], axis=1) - 3.0
    exact = 1.0 - np.hypot(around, found.vertices[:, 2])
    assert found.thickness == pytest.approx(exact, abs=1e-9)
    assert found.area.sum() == pytest.approx(4.0 * np.pi**2 * 3.0, rel=0.01)
    assert found.triangles.max() + 1 == len(found.vertices) == len(found.level) == len(found.goal)
    assert len(found.triangle_patch) == len(found.triangles)
    assert set(found.face_names) == {patch.face for patch in shell.surface.patches}


@pytest.mark.parametrize(
    ("text", "depth", "words"),
    [
        ("mean 0.2 mm", 0.1, "asked mean 0.2 mm, reached 0.1 mm in the mean"),
        ("min 0.2 mm", 0.1, "asked min 0.2 mm, reached 0.1 mm at the thinnest place"),
        ("40 %", 0.1, "asked 40 % of the local radius (0.2 mm in the mean), reached 0.1 mm"),
        ("0.1 mm", 0.2, "thicker at Face"),
    ],
)
def test_each_kind_has_its_sentence(text, depth, words):
    assert words in reached_figures(offset_box(depth), Thickness.parse(text))["sentence"]
    kind = Thickness.parse(text)
    right = offset_box(0.5 * kind.value if kind.kind == "share" else kind.value)
    right = replace(right, level=right.goal)
    assert reached_figures(right, kind)["sentence"] == ""


def test_another_genus_is_told_in_report_and_sentence():
    """A ring with a speck of midstructure: far in, its isosurfaces are no rings any more."""
    surface = build_surface(list(bodies.ring().faces))
    speck = np.array([[2.6, 0.0, 0.5], [2.45, 0.08, 0.5], [2.45, -0.08, 0.53]])
    options = Options(w0=0.95, layers=1, midstructure="own")
    volume = complete(surface, options, own=(speck, np.array([[0, 1, 2]])))
    told = report.volume_report(volume, {"file": "ring"}, {})
    found = told["shell"]["isosurface"]
    assert found["asked"] == 0.95 and found["body"] == [1] and found["genus"] != [1]
    assert 0.3 < found["largest_w0"] == found["w0_used"] < 0.95
    assert told["shell"]["w0"] <= found["w0_used"] + 0.005
    assert any("has another genus than the body" in note for note in told["notes"])
    assert told["notes"][0] == told["shell"]["sentence"]
    assert "isosurfaces farther in have another genus" in told["notes"][0]
    assert told["shell"]["spacing"] == Spacing().text == "volume"
    assert told["shell"]["layer_heights"] == layer_heights(volume.shell)
