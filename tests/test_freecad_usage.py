# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What the command line refuses: in one line, with code 2, and without a file."""

import os

import pytest

from HybridVolume.errors import SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Part
from command_line import box, leftovers, one_line, run, tree, write_step


def _wires(path):
    write_step(Part.makePolygon([FreeCAD.Vector(0, 0, 0), FreeCAD.Vector(1, 0, 0)]), path)


def _open(path):
    write_step(Part.makeShell(box().Faces[:5]), path)


def _truncated(path):
    write_step(box(), path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def _joined_at_an_edge(path):
    write_step(Part.makeCompound([box(), box(at=(3, 2, 0))]), path)


REFUSED = {
    "text.txt": (lambda path: path.write_text("hello"), "neither STEP nor BREP"),
    "text.step": (lambda path: path.write_text("hello"), "no STEP file"),
    "empty.step": (lambda path: path.write_text(""), "is empty"),
    "folder.step": (lambda path: path.mkdir(), "is a folder"),
    "missing.step": (lambda path: None, "does not exist"),
    "truncated.step": (_truncated, "truncated"),
    "wires.step": (_wires, "no solid"),
    "open.step": (_open, "no closed solid"),
    "cylinder.step": (lambda path: write_step(Part.makeCylinder(1, 2), path), "seam"),
    "hole.step": (
        lambda path: write_step(
            box().cut(Part.makeCylinder(0.3, 2, FreeCAD.Vector(1.5, 1, -0.5))), path
        ),
        "Face",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_line(place, python, name):
    make, told = REFUSED[name]
    make(place / name)
    before = tree(place)
    assert told in one_line(run(place, name, "--no-cover"), 2)
    assert tree(place) == before and leftovers(place) == []


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((), "required: BODY;"),
        (("bench",), "bench is no command"),
        (("fit", "x.step"), "the following arguments are required: --to"),
        (("box.step", "--w0", "2"), "--w0: '2' is no number between 0 and 1"),
        (("box.step", "--w0", "0.001"), "w0 is 0.001"),
        (("box.step", "--layers", "0"), "--layers: '0' is no count"),
        (("box.step", "--layers", "51"), "layers is 51; choose a value from 1 to 50"),
        (("box.step", "--degree", "9"), "degree is 9"),
        (("box.step", "--w0", "0.3", "--thickness", "2 mm"), "--thickness: not allowed with"),
        (("box.step", "--no-cover", "--cover-tolerance", "1"), "--cover-tolerance: not allowed"),
        (("box.step", "--thickness", "2 inch"), "--thickness: '2 inch' is no thickness; give"),
        (("box.step", "--thickness", "0 mm"), "the thickness is 0 mm; choose a length above"),
        (("box.step", "--thickness", "120 %"), "120 % of the local radius; choose a share"),
        (("box.step", "--face-factor", "Face9=2"), "Face9 = 2: no body has this face; name one"),
        (("box.step", "--face-factor", "Face1"), "'Face1' is no factor of a face; write it as"),
        (("box.step", "--face-factor", "Face1=99"), "the factor of Face1 is 99; choose a factor"),
        (("box.step", "--spacing", "thin"), "--spacing: 'thin' is no spacing of layers; give"),
        (("box.step", "--spacing", "ratio 9"), "grow by the factor 9; choose a factor from 0.125"),
        (("box.step", "--cover-tolerance", "0"), "'0' is no length above 0 mm"),
        (("box.step", "--cover-tolerance", "x"), "--cover-tolerance: 'x' is no number"),
        (("cage.obj", "--cover-tolerance", "1"), "cage.obj is a mesh: it needs no cover; leave"),
        (("box.step", "--order", "3"), "--order: invalid choice"),
        (("box.step", "--subdivide", "0"), "--subdivide: parts of a cell: 0; choose a value from"),
        (("box.step", "--size", "-1"), "--size: the size of elements is -1 mm; choose a length"),
        (("box.step", "--face-size", "Face1"), "'Face1' is no size of elements at a face; write"),
        (("box.step", "--face-size", "Face9=2"), "size Face9=2: no body has this face; name one"),
        (("box.step", "--size", "1", "--nodes", "greville"), "Greville abscissae have no size"),
        (("box.step", "--fem-layers", "2.5"), "--fem-layers: '2.5' is no count"),
        (("box.step", "--layer-growth", "9"), "growth of the layers: 9; choose a value from 1"),
        (("box.step", "--export", "msh,stl"), "--export: 'stl' is no format; choose some of unv"),
        (("box.step", "--elements", "hex20", "--order", "1"), "hex20 is of second order; leave"),
        (("box.step", "--midstructure", "magic"), "none of auto, medial-axis, skeleton, dist"),
        (("box.step", "--midstructure", "own"), "no STEP or BREP file"),
        (("box.step", "--midstructure", "nowhere.brep"), "nowhere.brep does not exist"),
        (("box.step", "--midstructure", "text.step"), "text.step is no STEP file"),
        (("box.step", "--midstructure", "distance", "--depth", "0"), "--depth: '0' is no depth"),
        (("box.step", "--samples", "many"), "--samples: 'many' is no number"),
        (("box.step", "--samples", "3"), "samples is 3; choose a number from 1000"),
        (("box.step", "--angle", "nan"), "--angle: 'nan' is no number"),
        (("box.step", "--angle", "20"), "angle is 20; choose a value from 60"),
        (("box.step", "--minimum-size", "-1"), "minimum size is -1"),
        (("box.step", "--remove-sheet", "Face3"), "--remove-sheet: 'Face3' names no sheet"),
        (("box.step", "--keep-sheet", "Face1+Face2@3,0"), "3,0 is no place on Face1"),
        (("box.step", "--keep-only", "Face1+Face9"), "only Face1+Face9: no body has these faces"),
        (("box.step", "-o", "box.step"), "box.step is no folder"),
        (("box.step", "-o", "box.step/below"), "cannot be written"),
    ],
)
def test_wrong_usage_in_one_line(place, python, arguments, told):
    write_step(box(), place / "box.step")
    (place / "text.step").write_text("hello")
    assert told in one_line(run(place, *arguments), 2)
    assert tree(place) == ["box.step", "text.step"]


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_write_permission(place, python):
    write_step(box(), place / "box.step")
    place.chmod(0o555)
    try:
        assert "cannot be written" in one_line(run(place, "box.step"), 2)
    finally:
        place.chmod(0o755)


def test_no_environment(place):
    write_step(box(), place / "box.step")
    nowhere = str(place / "nowhere")
    answer = run(place, "box.step", HYBRIDVOLUME_PYTHON="", HYBRIDVOLUME_ENVIRONMENT=nowhere)
    assert "run ./run.sh once" in one_line(answer, 1)
    assert tree(place) == ["box.step"]
