# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce midstructure``: results, resuming, refusals; the bodies made for it."""

import json

import numpy as np
import pytest
from bodies import box
from variants import t_junction

from HybridVolume import job
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.midstructure import medial_axis
from HybridVolume.errors import SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

from part_bodies import write_step

from HybridVolume.reproduce import main, midstructure
from HybridVolume.reproduce.bodies import bracket_area, exact_bodies
from HybridVolume.reproduce.picture import inside
from HybridVolume.reproduce.table import as_markdown

# volume, genus and area by textbook formulas
KNOWN = {
    "box": (8.0, 0, 28.0),
    "box-small": (8e-9, 0, 28e-6),
    "box-large": (8e9, 0, 28e6),
    "box-turned": (8.0, 0, 28.0),
    "box-far": (8.0, 0, 28.0),
    "plate": (2500.0, 0, 5200.0),
    "bracket": (36.0, 0, 98.0),
    "wedge": (9.0 * np.tan(np.radians(20.0)), 0, None),
    "ring": (15.0 * np.pi, 1, 40.0 * np.pi),
    "cylinder": (6.0 * np.pi, 0, 14.0 * np.pi),
    "torus": (6.0 * np.pi**2, 1, 12.0 * np.pi**2),
    "sphere": (4.0 / 3.0 * np.pi, 0, 4.0 * np.pi),
}


def test_exact_bodies_are_what_they_are_called():
    for body in exact_bodies():
        volume, genus, area = KNOWN[body.name.removesuffix("-skeleton").removesuffix("-distance")]
        surface = build_surface(body.faces)
        assert surface.volume() == pytest.approx(volume, rel=1e-9), body.name
        assert surface.genus == (genus,), body.name
        if area:
            assert surface.area() == pytest.approx(area, rel=1e-9), body.name


def test_places_of_exact_midstructures():
    known = {body.name: body for body in exact_bodies()}
    points = {
        "box": [[2.0, 1.0, 0.5], [0.5, 0.5, 0.5]],
        "box-small": [[2e-3, 1e-3, 0.5e-3]],
        "box-far": [[3002.0, -1999.0, 1000.5]],
        # half-way in both legs, and on the diagonal, as far from the inner edge as from the faces
        "bracket": [[3.0, 0.5, 2.0], [0.5, 4.0, 1.0], [2 - 2**0.5, 2 - 2**0.5, 2.0]],
        "ring": [[2.5, 0.0, 1.5], [0.0, -2.5, 1.0]],
        "cylinder": [[0.0, 0.0, 3.0]],
        "torus": [[3.0, 0.0, 0.0], [0.0, 3.0, 0.0]],
        "sphere": [[0.0, 0.0, 0.0]],
        "box-distance": [[2.0, 1.0, 0.25], [0.25, 1.0, 0.5]],
    }
    for name, x in points.items():
        scale = 1e3 if name == "box-far" else 1.0
        assert np.abs(known[name].off(np.array(x))).max() < 1e-12 * scale, name
    assert known["box"].off(np.array([[2.0, 1.0, 0.75]]))[0] == pytest.approx(0.25)
    assert known["box-large"].off(np.array([[0.0, 0.0, 750.0]]))[0] == pytest.approx(250.0)


def test_area_of_a_bracket_tends_to_that_of_two_plates():
    # of thin walls only the mid planes count
    assert bracket_area(1e-6, 5.0, 4.0) == pytest.approx(40.0, rel=1e-5)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A box that is completed and one that is refused."""
    try:
        job.worker_python()
    except SetupError as missing:
        pytest.skip(missing.line)
    folder = tmp_path_factory.mktemp("bodies")
    write_step(box((4.0, 2.0, 1.0), (4, 2, 2)), folder / "block.step")
    write_step(t_junction(), folder / "split.step")
    (folder / "readme.txt").write_text("no body")
    return folder


def reproduce(folder, bodies, *more):
    return main(["midstructure", "-o", str(folder), "--bodies", str(bodies), "--parts", "bodies",
                 *more])  # fmt: skip


def test_a_folder_of_bodies(inputs, tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    assert reproduce(out, inputs) == 0
    found = json.loads((out / "block.json").read_text())
    assert found["state"] == "shell"
    assert found["midstructure"]["kept"] == 1
    assert found["midstructure"]["area"] == pytest.approx(3.0, rel=0.01)
    assert found["elements"]["proved"] == found["elements"]["all"] > 0
    assert found["w0"]["asked"] == 0.5
    assert 0.4 <= found["w0"]["reached"] <= found["w0"]["largest"] <= 0.99
    assert found["hints"]["pieces"] == 1
    assert found["hints"]["unreached"] == []
    # the middle of the large faces is half a mm from the sheet
    assert found["thickness"]["min"] == pytest.approx(0.25, rel=0.05)
    assert found["hints"]["thinnest"] == pytest.approx(0.25, rel=0.05)
    assert (out / "block.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    refused = json.loads((out / "split.json").read_text())
    assert refused["state"] == "refused"
    assert refused["error"]["code"] == "t-junction"
    assert not (out / "split.png").exists()
    both = json.loads((out / "midstructure.json").read_text())
    assert [one["name"] for one in both["bodies"]] == ["block", "split"]
    table = (out / "midstructure.md").read_text()
    assert "| block" in table
    assert "split (refused)" in table
    assert table in capsys.readouterr().out

    # what is finished is not done again, unless the question is another one
    def never(*_):
        raise AssertionError("done again")

    monkeypatch.setattr(midstructure.Maker, "_job", never)
    assert reproduce(out, inputs) == 0
    assert "finished before" in capsys.readouterr().out
    assert json.loads((out / "midstructure.json").read_text()) == both
    with pytest.raises(AssertionError):
        midstructure.Maker(out, 0.4, 100.0, False).figures(
            next(midstructure.read_entries([inputs / "block.step"]))
        )


def test_no_shell_in_time_is_told(inputs, tmp_path, capsys):
    out = tmp_path / "out"
    assert reproduce(out, inputs / "block.step", "--time-limit", "0.3") == 1
    found = json.loads((out / "block.json").read_text())
    assert found["state"] == "failed"
    assert "within 0.3 s" in found["error"]["message"]
    assert "without a shell: block" in capsys.readouterr().out
    # and is tried again the next time
    assert midstructure._finished(out / "block.json", found["key"]) is None


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["midstructure"], "-o"),
        (["fig0", "-o", "x"], "fig0"),
        (["midstructure", "-o", "x", "--bodies", "no-such-folder"], "no-such-folder"),
        (["midstructure", "-o", "x", "--w0", "1.5"], "w0"),
    ],
)
def test_wrong_words_end_with_2(words, part, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    try:
        code = main(words)
    except SystemExit as stop:
        code = stop.code
    assert code == 2
    error = capsys.readouterr().err
    assert part in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_pictures_of_sheets_lines_and_points():
    made = {body.name: build_surface(body.faces) for body in exact_bodies()}
    for name, size in (("box", (3.0, 1.0)), ("torus", (6.0, 6.0)), ("sphere", (0.08, 0.08))):
        scene = inside(made[name], medial_axis(made[name], 3000))
        solid = [skin.points for skin in scene.skins[1:]] + [
            wire.points.reshape(-1, 3) for wire in scene.wires[1:] if wire.width > 2.0
        ]
        extent = np.ptp(np.concatenate(solid), axis=0)
        assert extent[:2] == pytest.approx(size, rel=0.25), name
        assert scene.skins[0].opacity < 0.5


def test_an_empty_table():
    assert as_markdown({"bodies": [], "exact": []}) == ""
