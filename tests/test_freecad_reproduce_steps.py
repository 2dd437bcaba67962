# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce steps``: a body, a refusal and the limit of time, kept and told."""

import json

import pytest

from HybridVolume.errors import SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
    import Part
except (SetupError, ImportError) as missing:
    pytest.skip(f"FreeCAD: {missing}", allow_module_level=True)

from HybridVolume.reproduce import main
from HybridVolume.reproduce.steps import all_cases
from HybridVolume.reproduce.steps_bodies import BODIES
from HybridVolume.reproduce.steps_table import demands
from HybridVolume.reproduce.steps_volume import triangle_volume

APPROXIMATED = {"cam": 1e-4, "ellipsoid": 1e-3, "tee": 1e-5, "vase": 1e-5, "sweep": 1e-5}
"""Bodies whose volume OCC integrates coarsely, or whose swept face it approximates."""


def test_bodies_are_what_their_formulas_say():
    assert len({body.name for body in BODIES}) >= 25
    for body in BODIES:
        (solid,) = body.make().Solids
        assert solid.isValid() and solid.isClosed(), body.name
        assert len(solid.Shells) == len(body.genus), body.name
        if body.volume is not None:
            allowed = APPROXIMATED.get(body.name, 1e-12)
            assert solid.Volume == pytest.approx(body.volume, rel=allowed), body.name


def test_volume_by_triangles():
    volume, doubt = triangle_volume(Part.makeCone(6, 2, 15))
    exact = 3.141592653589793 * 15 * (36 + 12 + 4) / 3
    assert abs(volume - exact) < doubt < 1e-3 * exact


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A row of an open body, whose refusal is quick, and one of a body that takes too long."""
    folder = tmp_path_factory.mktemp("steps")
    box = Part.makeBox(1, 2, 3)
    Part.Shell(box.Faces[:5]).exportBrep(str(folder / "lidless.brep"))
    words = ["steps", "-o", str(folder), "--data", str(folder / "lidless.brep"), "--only"]
    assert main([*words, "lidless"]) == 0
    assert main([*words, "lidless", "tee", "--time-limit", "1"]) == 1
    return folder, words


def test_refusals_and_limits_are_rows(made):
    folder, _ = made
    found = json.loads((folder / "steps.json").read_text())
    (open_body,), (tee,) = found["files"], found["scripted"]
    assert open_body["state"] == "refused" and open_body["code"] == 2
    assert not open_body["left"] and "5 loose faces" in open_body["said"][0]
    assert tee["state"] == "stopped" and not tee["left"] and not tee["bodies"]
    met = {row["body"]: row["met"] for row in found["demands"]}
    assert met == {"lidless": True, "tee": False}
    text = (folder / "steps.md").read_text()
    assert open_body["said"][0] in text and "no end within the limit" in text


@pytest.mark.parametrize(("asked", "figure"), [(12, "12 of 12"), (9, "9 of 9 (3 not asked)")])
def test_faces_that_were_not_come_to_are_not_found(asked, figure):
    body = {
        "elements": 4, "proved": 4, "embedded": True, "nodes": 9,
        "diagonal": 10.0, "tolerance": 1e-3, "deviation": 1e-4, "off": 1e-4,
        "faces_to_ask": 12, "faces_asked": asked, "faces_found": asked, "faces_with_strangers": [],
    }  # fmt: skip
    case = {"name": "one", "case": "one.step", "error": None, "state": "made", "bodies": [body]}
    rows = demands({"scripted": [], "files": [case], "whole": False, "not_done": []})
    (row,) = (row for row in rows if "getNodesByFace" in row["demand"])
    assert row["figure"] == figure and row["met"] is (asked == 12)


def test_finished_rows_are_kept(made, capsys):
    folder, words = made
    row = folder / "cases" / "lidless.json"
    before = row.stat().st_mtime_ns
    assert main([*words, "lidless"]) == 0
    assert "1 of 1 cases finished before" in capsys.readouterr().out
    assert row.stat().st_mtime_ns == before


def test_an_unknown_body_is_refused(tmp_path, capsys):
    assert main(["steps", "-o", str(tmp_path), "--only", "teapot"]) == 2
    assert "teapot: no such part or case" in capsys.readouterr().err


@pytest.mark.shared
def test_files_are_found(shared_data, tmp_path):
    cases, missing = all_cases(tmp_path, [str(shared_data)], 240.0)
    assert not missing
    names = {case.name for case in cases if case.part == "files"}
    assert names == {
        "as1", "component8", "linkrods", "trimmed_cube", "tesla_t_junctions", "moebius_torus",
    }  # fmt: skip
    (assembly,) = (case for case in cases if case.name == "as1")
    assert assembly.task["seconds_limit"] == 18 * 240.0
