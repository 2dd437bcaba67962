# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce shell``: its bodies, what it demands, and one run of a small body."""

import json

import numpy as np
import pytest

from HybridVolume import job
from HybridVolume.core.assembly import build_surface
from HybridVolume.errors import SetupError, SingularSurfaceError

try:
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

from part_bodies import write_step

from HybridVolume.reproduce import cases, main, shell
from HybridVolume.reproduce.shell_bodies import DEMANDS, made_bodies
from HybridVolume.reproduce.shell_demands import demands
from HybridVolume.reproduce.shell_pictures import distribution
from HybridVolume.reproduce.shell_table import as_markdown

# volume and genus by textbook formulas
KNOWN = {
    "box": (6.0, 0),
    "box_coarse": (6.0, 0),
    "L": (3.0, 0),
    "plate": (400.0, 0),
    "plate_50": (2500.0, 0),
    "wedge_30": (9.0 * np.tan(np.radians(30.0)), 0),
    "sphere": (4.0 / 3.0 * np.pi, 0),
    "torus": (6.0 * np.pi**2, 1),
    "cylinder": (6.0 * np.pi, 0),
    "ring": (15.0 * np.pi, 1),
}


def test_bodies_are_what_they_are_called():
    made = made_bodies()
    assert [body.name for body in made] == list(KNOWN)
    for body in made:
        surface = build_surface(body.faces())
        volume, genus = KNOWN[body.name]
        assert surface.volume() == pytest.approx(volume, rel=1e-9), body.name
        assert surface.genus == (genus,), body.name
        assert body.name in DEMANDS


def case(body, asked, reached=None, **more):
    """A sound case, unless told otherwise."""
    found = {
        "body": body, "kind": "shell", "group": "table", "w0_asked": asked,
        "w0": asked if reached is None else reached, "w0_rms": 0.01, "elements": 8, "valid": 8,
        "undecided": 0, "invalid": 0, "embedded": True, "min_scaled_jacobian": 0.5, "bound": 0.57,
        "scaled_jacobian": {"q01": 0.5, "q05": 0.5, "median": 0.8, "mean": 0.8,
                            "histogram": [0] * 10 + [2] + [0] * 5 + [6] + [0] * 3},
        "thickness": {"min": 0.1, "mean": 0.2, "max": 0.3}, "seconds": 2.0, "seconds_cpu": 1.0,
        "genus": [0], "patches": 6, "spans": 4, "rational": False, "notes": [],
        "options": {},
    }  # fmt: skip
    return {**found, **more}


def found(*cases, **more):
    parts = dict.fromkeys(("shape_first", "layers", "paper", "rivals", "free", "pictures"), [])
    machine = {"processor": "any", "cores": 2, "system": "any", "python": "3"}
    everything = {
        "cases": list(cases),
        "machine": machine,
        "missing": ["pole"],
        "not_done": [],
        **parts,
        **more,
    }
    return {**everything, "demands": demands(everything)}


def met(rows, body, part):
    (row,) = [row for row in rows if row["body"] == body and part in row["demand"]]
    return row["met"]


def test_demands_follow_from_the_figures():
    good = found(case("box", 0.1), case("box", 0.5), case("box", 0.9, 0.6))["demands"]
    assert all(row["met"] for row in good) and len(good) == 4
    thin = found(case("box", 0.5, 0.44), case("box", 0.9, 0.5))["demands"]
    assert met(thin, "box", "within 10 %") is False
    assert met(thin, "box", "60 %") is False
    assert met(thin, "box", "proved") and met(thin, "box", "scaled Jacobian")
    # one element too few, a crossing, and no shell at all
    for wrong in ({"valid": 7}, {"embedded": False}, {"elements": 0, "valid": 0, "w0": None}):
        rows = found(case("box", 0.3), case("box", 0.5, **wrong))["demands"]
        assert met(rows, "box", "proved") is False
    lost = found(case("box", 0.5, w0=None, min_scaled_jacobian=None, elements=0, valid=0))
    assert [row["met"] for row in lost["demands"]] == [False] * 3
    # a share of the bound, and a level above the one asked that is no fault there
    part = found(case("fandisk", 0.5, 0.8, min_scaled_jacobian=0.3, bound=0.5, mesher="x"))
    assert met(part["demands"], "fandisk", "bound") is True
    assert met(part["demands"], "fandisk", "at least 0.8") is True
    flat = found(case("fandisk", 0.5, min_scaled_jacobian=0.29, bound=0.5, mesher="x"))
    assert met(flat["demands"], "fandisk", "bound") is False


def test_a_refusal_counts_only_with_its_places():
    error = SingularSurfaceError("folded", faces=["Face2"]).to_dict()
    bare = case("g_shape", 0.5, w0=None, elements=0, valid=0, error=error)
    assert met(found(bare)["demands"], "g_shape", "refused") is False
    place = {"face": "Face2", "u": 0.5, "v": 0.25, "point": [0, 0, 0], "what": "folded"}
    named = {**bare, "error": {**error, "places": [place]}}
    assert met(found(named)["demands"], "g_shape", "refused") is True
    text = as_markdown(found(named))
    assert (
        "g_shape has no shell at 0.5: Face2: folded; the first places: Face2 at (0.50, 0.25)"
        in text
    )
    other = {**named, "error": {**named["error"], "code": "fault"}}
    assert met(found(other)["demands"], "g_shape", "refused") is False


def test_nothing_is_demanded_of_what_the_reader_refuses():
    error = SingularSurfaceError("no").to_dict()
    lost = case("moebius_torus", 0.5, w0=None, elements=0, valid=0, error=error)
    assert [row["met"] for row in found(lost)["demands"]] == [False] * 3
    del lost["patches"]
    (row,) = found(lost)["demands"]
    assert row["met"] is None and "singular-surface" in row["figure"]
    assert "0 of 0 demands are met" in as_markdown(found(lost))


def test_one_random_body_may_stay_without_a_shell():
    bodies = [case(f"random-{k}", 0.5, group="random") for k in range(5)]
    assert found(*bodies)["demands"][0]["met"] is True
    bodies[1]["valid"] = 7
    rows = found(*bodies)["demands"]
    assert rows[0]["met"] is True and "4 of 5; not random-1" in rows[0]["figure"]
    bodies[3]["embedded"] = False
    assert found(*bodies)["demands"][0]["met"] is False
    chart = distribution(found(*bodies)["cases"])
    assert chart.counts.sum() == 3 * 8 and "of 3 random" in chart.title


def test_the_text_tells_what_is_not_reached():
    error = SingularSurfaceError("no way", faces=["Face1"]).to_dict()
    text = as_markdown(
        found(case("box", 0.5, 0.3, notes=["thin"]), case("L", 0.5, error=error, w0=None))
    )
    assert "**not met**" in text and "not measured, since" not in text
    assert "Not measured" in text and "pole" in text
    assert "- box at 0.5: thin" in text
    assert "- L has no shell at 0.5: Face1: no way" in text
    row = next(line for line in text.splitlines() if line.startswith("| box: 6 patches"))
    assert [cell.strip() for cell in row.split("|")][3:5] == ["0.300 (0.010)", "all 8"]


# ------------------------------------------------------------------------------- one run


@pytest.fixture(scope="module")
def python():
    try:
        return job.worker_python()
    except SetupError as missing:
        pytest.skip(missing.line)


def test_a_body_is_made_once(python, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(shell, "program_digest", lambda: "one")
    monkeypatch.setattr(shell, "PAPER_LEVELS", (0.5,))
    monkeypatch.setattr(shell, "RIVAL_LEVELS", ())
    from bodies import box

    write_step(box((3.0, 2.0, 1.0), (3, 2, 1)), tmp_path / "block.step")
    words = ["shell", "-o", str(tmp_path / "out"), "--data", str(tmp_path / "block.step"),
             "--body", "block", "--w0", "0.5"]  # fmt: skip
    assert main(words) == 0
    written = json.loads((tmp_path / "out" / "shell.json").read_text())
    (one,) = written["cases"]
    assert one["body"] == "block" and one["w0_asked"] == 0.5 and one["group"] == "other"
    assert one["elements"] == one["valid"] == 2 * one["spans"] > 0 and one["embedded"] is True
    assert 0.45 <= one["w0"] <= 0.55
    assert 0 < one["min_scaled_jacobian"] <= one["bound"] + 1e-9 <= 3**-0.5 + 1e-6
    assert sum(one["scaled_jacobian"]["histogram"]) == one["elements"]
    assert one["genus"] == [0] and one["rational"] is False and one["seconds"] > 0
    assert 0 < one["thickness"]["min"] <= 0.5
    assert written["paper"][0]["paper"]["elements"] == one["elements"]
    text = (tmp_path / "out" / "shell.md").read_text()
    assert "block: 6 patches" in text and text in capsys.readouterr().out

    # what is finished is not done again, unless the program has changed
    def never(*_):
        raise AssertionError("done again")

    monkeypatch.setattr(shell.Runner, "_start", never)
    assert main(words) == 0
    assert json.loads((tmp_path / "out" / "shell.json").read_text())["cases"] == [one]
    monkeypatch.setattr(shell, "program_digest", lambda: "another")
    with pytest.raises(AssertionError):
        shell.run(_options(words))


def _options(words):
    from HybridVolume.reproduce import parser

    return parser().parse_args(words)


def test_a_body_that_is_not_done_in_time_is_told(python, tmp_path, capsys):
    words = ["shell", "-o", str(tmp_path / "out"), "--body", "box_coarse", "--w0", "0.5"]
    assert main([*words, "--time-limit", "0.2"]) == 1
    written = json.loads((tmp_path / "out" / "shell.json").read_text())
    (one,) = written["cases"]
    assert one["elements"] == 0 and one["embedded"] is False and one["w0"] is None
    assert "within 0.2 s" in one["error"]["message"]
    assert "within 0.2 s" in (tmp_path / "out" / "shell.md").read_text()
    # and is tried again the next time
    kept = json.loads((tmp_path / "out" / "cases" / "box_coarse@0.5.json").read_text())
    assert kept["key"] == ""


def test_a_fault_is_a_row_as_well():
    try:
        raise ZeroDivisionError("by\nzero")
    except ZeroDivisionError as fault:
        told = cases.told(fault)
    assert told.code == "fault" and "ZeroDivisionError" in told.message
    assert "\n" not in told.message


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["--body", "teapot"], "teapot"),
        (["--w0", "1.5"], "w0"),
        (["--data", "no-such-folder"], "no-such-folder"),
    ],
)
def test_wrong_words_end_with_2(words, part, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(shell, "BESIDE", tmp_path / "nothing")
    assert main(["shell", "-o", "x", *words]) == 2
    error = capsys.readouterr().err
    assert part in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())
