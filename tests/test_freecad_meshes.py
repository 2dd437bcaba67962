# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Mesh files become bodies that FreeCAD has as solids of untrimmed faces."""

import json

import numpy as np
import pytest

from HybridVolume.__main__ import main
from HybridVolume.core.assembly import build_surface
from HybridVolume.errors import InputError, OpenBodyError, SetupError
from HybridVolume.sources.meshes import Surfacing, read_mesh

try:
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

CUBE = "".join(
    f"v {x} {y} {z}\n" for z in (0, 2) for y in (0, 2) for x in (0, 2)
) + "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n"  # fmt: skip


def written(tmp_path, text):
    path = tmp_path / "cage.obj"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("surfacing", "patches", "low", "high"),
    [
        (Surfacing(), 6, 8.0, 8.0),
        (Surfacing("smooth"), 6, 2.0, 3.0),
        # the limit surface of a cube has .327 of its volume
        (Surfacing("catmull-clark", 2), 6, 2.60, 2.63),
        (Surfacing("catmull-clark", sharp_angle=60.0), 6, 8.0, 8.0),
    ],
)
def test_a_cube_by_every_scheme(tmp_path, surfacing, patches, low, high):
    (one,) = read_mesh(written(tmp_path, CUBE), surfacing)
    assert one.error is None
    assert one.name == "cage"
    assert one.shape.isValid()
    assert len(one.shape.Faces) == len(one.faces) == patches
    surface = build_surface(list(one.faces))
    assert low - 1e-9 <= surface.volume() <= high + 1e-9


def test_the_file_decides_where_nothing_is_asked(tmp_path):
    creased = CUBE + "t crease 2/1/0 0 1 10\n"
    (one,) = read_mesh(written(tmp_path, creased))
    assert one.origin["mesh"]["scheme"] == "catmull-clark"
    halved = CUBE.replace("f 1 3 4 2\n", "f 1 3 4\nf 1 4 2\n")
    (one,) = read_mesh(written(tmp_path, halved))
    assert one.origin["mesh"]["scheme"] == "catmull-clark"
    assert one.origin["mesh"]["quads"] == 5 * 4 + 2 * 3
    with pytest.raises(InputError, match="faces 1 and 2 have not four corners"):
        read_mesh(written(tmp_path, halved), Surfacing("bilinear"))


def test_several_bodies_and_mended_ones(tmp_path):
    shifted = "".join(f"v {x} {y} {z}\n" for z in (0, 2) for y in (0, 2) for x in (5, 7))
    second = (
        "f 9 11 12 10\nf 13 14 16 15\nf 9 10 14 13\nf 15 11 12 16\nf 9 13 15 11\nf 10 12 16 14\n"
    )
    found = read_mesh(written(tmp_path, CUBE + shifted + second))
    assert [one.name for one in found] == ["cage_1", "cage_2"]
    assert all(np.isclose(one.shape.Volume, 8.0) for one in found)
    assert any(
        "turned as their neighbours" in note
        for one in found
        for note in one.origin["mesh"]["notes"]
    )


def test_bad_requests_are_refused(tmp_path):
    with pytest.raises(OpenBodyError, match="edges 1-2, 1-3, 2-4 and 3-4"):
        read_mesh(written(tmp_path, CUBE.replace("f 1 3 4 2\n", "")))
    for wrong in (
        {"scheme": "loop"},
        {"steps": 9},
        {"sharp_angle": 200.0},
        {"scheme": "smooth", "sharp_angle": 30.0},
    ):
        with pytest.raises(InputError):
            Surfacing(**wrong)
    with pytest.raises(InputError, match="subdivisions of bilinear"):
        read_mesh(written(tmp_path, CUBE), Surfacing("bilinear", 2))


def test_the_command_line_takes_a_mesh(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path, CUBE.replace("f 2 4 8 6", "f 6 8 4 2"))
    assert main([str(path), "--scheme", "smooth", "--steps", "1", "--w0", "0.3"]) == 0
    said = capsys.readouterr().out
    assert "face 6: turned as their neighbours" in said
    assert "cage: smooth, 24 quads in 6 patches" in said
    report = json.loads((tmp_path / "cage" / "report.json").read_text())
    assert report["input"]["mesh"]["scheme"] == "smooth"
    assert report["input"]["mesh"]["normal_jump"] < 1e-9
    assert report["input"]["faces"] == 6
    assert report["shell"]["invalid"] == report["shell"]["undecided"] == 0
    doc = import_freecad().openDocument(str(tmp_path / "cage" / "cage.FCStd"), hidden=True)
    try:
        # the document has the mesh as well
        body = doc.HybridVolume.Source
        assert (body.Scheme, body.Steps, body.MeshFile) == ("smooth", 1, "cage.obj")
        body.Scheme = "bilinear"
        doc.recompute()
        assert np.isclose(body.Shape.Volume, 8.0)
    finally:
        import_freecad().closeDocument(doc.Name)
    assert main(["body.step", "--scheme", "smooth"]) == 2
    assert "is no mesh" in capsys.readouterr().err
