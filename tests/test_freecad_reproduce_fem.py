# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``reproduce fem``: sums of loads of a box whose answers are plain, names, cases and resuming."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from HybridVolume.errors import SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Part
from box_mesh import box_mesh
from made_by_hand import SIZE, face_names

from HybridVolume import sources
from HybridVolume.core.assembly import build_surface
from HybridVolume.reproduce import fem, fem_loads, main

needs_ccx = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is absent")


@pytest.fixture
def box(tmp_path):
    """A box as a file, and what the bench needs of its volume."""
    path = tmp_path / "box.brep"
    Part.makeBox(*SIZE).exportBrep(str(path))
    (body,) = sources.read_file(path)
    mesh = box_mesh(SIZE, face_names(body.shape))
    return path, SimpleNamespace(fem=mesh, surface=build_surface(list(body.faces)))


@needs_ccx
def test_loads_on_a_box_are_exact(box, tmp_path):
    path, volume = box
    told = []
    found = fem_loads.make(volume, path, tmp_path, lambda share, text: told.append(text))
    assert told == ["force", "pressure", "weight"]
    rows = {row["load"]: row for row in found["rows"]}
    assert found["curved"] == pytest.approx(0.0, abs=1e-12)
    number = volume.fem.face_names.index(found["face"])
    normal = np.zeros(3)
    normal[number // 2] = 2.0 * (number % 2) - 1.0
    area = np.prod(SIZE) / SIZE[number // 2]
    assert found["area"] == pytest.approx(area)
    assert rows["force"]["freecad"] == pytest.approx(-1000.0 * normal, abs=1e-6)
    assert rows["pressure"]["exact"] == pytest.approx(-area * normal)
    # 7900 kg/m³ and 9.81 m/s², in t, mm, s
    weight = 7.9e-9 * rows["weight"]["acceleration"] * np.prod(SIZE)
    assert rows["weight"]["acceleration"] == pytest.approx(9810.0, rel=1e-3)
    assert rows["weight"]["exact"] == pytest.approx([0.0, 0.0, -weight])
    for row in rows.values():
        errors = [value for name, value in row.items() if name.endswith(("_error", "_off"))]
        assert len(errors) >= 2 and max(errors) < 1e-5
    assert not FreeCAD.listDocuments()


def test_integrals_over_a_curved_face(tmp_path):
    path = tmp_path / "ball.brep"
    from HybridVolume.exports.step import write_solid
    from HybridVolume.reproduce.bodies import sphere

    write_solid(path, build_surface(list(sphere(2.0))))
    (body,) = sources.read_file(path)
    surface = build_surface(list(body.faces))
    faces = [fem_loads.face_integrals(surface, face.name) for face in body.faces]
    assert sum(face.area for face in faces) == pytest.approx(16.0 * np.pi, rel=1e-12)
    assert np.abs(sum(face.vector for face in faces)).max() < 1e-10
    # the sixth of a sphere over a face of the inscribed cube
    assert all(face.area == pytest.approx(16.0 * np.pi / 6.0, rel=1e-12) for face in faces)
    name, best = fem_loads.curved_face(surface)
    assert name in {face.name for face in body.faces} and 0.1 < best.curved < 0.3


def test_a_deck_keeps_its_model_and_its_loads():
    deck = "\n".join(
        [
            "** a comment", "*Node, NSET=Nall", "1, 0, 0, 0", "2, 1, 0, 0", "",
            "*BOUNDARY", "1,1", "*MATERIAL, NAME=M", "*STEP", "*STATIC", "*BOUNDARY", "2,2",
            "*CLOAD", "1,3,2.5", "2,3,-1.0", "*CLOAD", "1,3,0.5", "*DLOAD", "Eall,GRAV,9810,0,0,-1",
            "*NODE FILE", "U", "*END STEP",
        ]
    )  # fmt: skip
    lines = fem_loads.with_support(deck, [(1, 0)]).splitlines()
    step = lines.index("*STEP")
    assert lines[:step] == ["*Node, NSET=Nall", "1, 0, 0, 0", "2, 1, 0, 0", "*MATERIAL, NAME=M"]
    assert lines[step + 1 : step + 4] == ["*STATIC", "*BOUNDARY", "2,1,1"]
    assert lines[step + 4 :] == [
        "*CLOAD", "1,3,2.5", "2,3,-1.0", "*CLOAD", "1,3,0.5", "*DLOAD", "Eall,GRAV,9810,0,0,-1",
        "*NODE FILE", "RF", "*END STEP",
    ]  # fmt: skip
    assert fem_loads.concentrated(deck, 2).tolist() == [[0, 0, 3.0], [0, 0, -1.0]]


def test_wrong_names_are_refused_and_nothing_done_is_no_success(tmp_path, capsys):
    assert main(["fem", "-o", str(tmp_path / "a"), "--only", "patches"]) == 2
    assert "no such part or case" in capsys.readouterr().err
    assert main(["fem", "-o", str(tmp_path / "a"), "--body", "nobody"]) == 2
    assert "nobody: no such body" in capsys.readouterr().err
    code = main(
        ["fem", "-o", str(tmp_path / "b"), "--body", "torus", "--only", "loads", "--gather"]
    )
    assert code == 1
    found = json.loads((tmp_path / "b" / "fem.json").read_text())
    assert found["not_done"] == ["volume-torus", "loads-torus"] and found["load_sums"] == []
    assert (tmp_path / "b" / "fem.md").read_text().count("Not done yet") == 1


@pytest.fixture
def runner(tmp_path, monkeypatch):
    """A runner whose processes are plain functions."""
    started = []
    (tmp_path / "cases").mkdir()
    runner = fem.Runner(tmp_path, 5.0, again=False)

    def start(case):
        started.append(case.name)
        error = {"code": "mesher", "message": "lost"} if case.case == "lost" else None
        values = {"name": case.name, "part": case.part, "case": case.case, "key": case.key(),
                  "error": error, "seconds_cpu": 1.0}  # fmt: skip
        (runner.cases / f"{case.name}.json").write_text(json.dumps(values))
        job = SimpleNamespace(poll=lambda wait: [], error=None, state="done", close=lambda: None)
        return job, case, 0.0

    monkeypatch.setattr(runner, "_start", start)
    return runner, started


def cases_of(name, folder, **task):
    stored = {"volume": str(folder / f"{name}.npz"), "words": "", **task}
    volume = fem.Case(f"volume-{name}", "volume", name, stored)
    return [volume, fem.Case(f"patch-{name}", "patch", name, stored, after=volume)]


def test_finished_cases_are_not_done_again_unless_something_changed(runner, tmp_path):
    runner, started = runner
    cases = cases_of("ball", tmp_path)
    runner.run(cases)
    assert started == ["volume-ball", "patch-ball"]
    assert runner.collected(cases)["not_done"] == []
    (tmp_path / "ball.npz").write_bytes(b"stored")
    again = fem.Runner(tmp_path, 5.0, again=False)
    again._start = runner._start
    again.run(cases)
    assert len(started) == 2
    # other options of the volume: what is made of it is made again
    changed = cases_of("ball", tmp_path, split=2)
    assert again.collected(changed)["not_done"] == ["volume-ball", "patch-ball"]
    again.run(changed)
    assert started[2:] == ["volume-ball", "patch-ball"]


def test_what_needs_a_lost_volume_has_its_error(runner, tmp_path):
    runner, started = runner
    cases = [*cases_of("lost", tmp_path), *cases_of("ball", tmp_path)]
    runner.run(cases)
    assert set(started) == {"volume-lost", "volume-ball", "patch-ball"}
    found = runner.collected(cases)
    lost, made = found["patch_tests"]
    assert lost["error"]["message"] == "lost" and made["error"] is None
