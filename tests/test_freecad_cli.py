# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The command line as a process: what it writes, and what it leaves behind."""

import json
import os
import re
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

import HybridVolume
from HybridVolume import completion, job, report
from HybridVolume.core import hybrid
from HybridVolume.errors import FaultError, InputError, SeamError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Part
from command_line import box, command, leftovers, run, tree, write_step

PROJECT = Path(__file__).resolve().parent.parent


# -------------------------------------------------------------------------------- results

FILES = ["box.FCStd", "box.inp", "box.png", "box.vtu", "report.json"]


@pytest.fixture(scope="session")
def completed(tmp_path_factory, python):
    """A box, completed into a folder that holds an old file and one of the user's."""
    place = tmp_path_factory.mktemp("completed") / "here"
    place.mkdir()
    (place.parent / "temporary").mkdir()
    write_step(box(), place / "box.step")
    out = place / "out"
    out.mkdir()
    (out / "box.vtu").write_text("old")
    (out / "mine").write_text("kept")
    answer = run(place, "box.step", "-o", "out", "--w0", "0.4")
    assert answer.returncode == 0, answer.stderr
    assert answer.stderr == ""
    assert tree(place) == sorted(["box.step", "out", "out/mine", *(f"out/{f}" for f in FILES)])
    assert leftovers(place) == []
    return out, answer


def test_all_files_arrive(completed):
    out, answer = completed
    assert (out / "mine").read_text() == "kept"
    assert (out / "box.vtu").read_bytes()[:200].find(b"VTKFile") >= 0
    assert (out / "box.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert "*ELEMENT, TYPE=C3D15" in (out / "box.inp").read_text()
    lines = answer.stdout.splitlines()
    assert re.match(r"box \[ *\d+ %\] surface: ", lines[0])
    assert lines[-1].startswith("out: box.FCStd, box.inp, box.png, box.vtu, report.json (")


def test_report(completed):
    found = json.loads((completed[0] / "report.json").read_text())
    assert found["version"] == 2
    given = found["input"]
    assert given["file"] == "box.step" and given["bodies"] == 1 and given["closed"] is True
    assert given["faces"] == given["patches"] == 6
    assert given["genus"] == [0] and given["shells"] == 1
    assert given["volume"] == pytest.approx(6.0, rel=1e-12)
    assert given["area"] == pytest.approx(22.0, rel=1e-12)
    assert given["faces_bit"] + given["faces_exact"] + given["faces_tolerance"] == 6
    assert given["max_deviation"] < 1e-12
    assert found["evening"]["before"] == found["evening"]["after"]
    assert found["evening"]["after"]["spans"] == 6 and found["evening"]["sentence"] == ""
    shell = found["shell"]
    assert shell["elements"] == shell["valid"] > 0
    assert shell["undecided"] == shell["invalid"] == 0 and shell["embedded"] is True
    assert shell["min_bernstein"] > 0 and shell["min_scaled_jacobian"] > 0
    assert shell["boundary_deviation"] <= 1e-14
    assert shell["w0_asked"] == 0.4 and 0 < shell["w0"] <= 0.5
    thickness = shell["thickness"]
    assert 0 < thickness["min"] <= thickness["mean"] <= thickness["max"]
    total = shell["volume"] + found["interior"]["volume"] + found["interface"]["gap_volume"]
    assert total == pytest.approx(6.0, rel=1e-9)
    fem = found["fem"]
    assert fem["volume"] == pytest.approx(6.0, rel=1e-9) and fem["faces_covered"] == 6
    quality = fem["quality"]["groups"]
    assert quality["core"]["elements"] == fem["tet10"]
    assert quality["shell"]["elements"] == sum(quality["shell"]["histogram"]) == fem["penta15"]
    assert quality["all"]["scaled_jacobian"]["min"] == fem["min_scaled_jacobian"] > 0
    parts = quality["shell"]["total_volume"] + quality["core"]["total_volume"]
    assert parts == pytest.approx(quality["all"]["total_volume"]) == pytest.approx(6.0)
    repairs = {"straightened", "untangled", "flipped", "refined", "withdrawn"}
    assert set(fem["repairs"]) == repairs
    assert fem["tet10"] == found["interior"]["tets"] and found["interior"]["boundary_exact"]
    assert found["midstructure"]["area"] > 0 and found["field"]["tets"] > 0
    seconds = found["seconds"]
    assert sum(s for name, s in seconds.items() if name != "total") <= seconds["total"]
    assert 50 < found["peak_memory_mb"] < 2000
    assert {"python", "numpy", "scipy", "FreeCAD", "HybridVolume"} <= set(found["versions"])


def test_every_key_of_the_report_is_described(completed):
    found = json.loads((completed[0] / "report.json").read_text())
    text = (PROJECT / "docs" / "report.md").read_text()
    keys = {key for part in found.values() if isinstance(part, dict) for key in part}
    keys -= {*found["seconds"], *found["versions"]}
    geometry = found["input"]["geometry"]
    keys |= {*geometry, *geometry["counts"], *geometry["faces"][0]}
    keys |= {*found, *found["fem"]["quality"], *found["fem"]["quality"]["groups"]["all"]}
    keys |= {
        *found["fem"]["density"],
        *found["fem"]["repairs"],
        *found["fem"]["quality"]["worst"][0],
    }
    assert [key for key in sorted(keys) if f"`{key}`" not in text] == []


def test_document(completed):
    out = completed[0]
    found = json.loads((out / "report.json").read_text())
    doc = FreeCAD.openDocument(str(out / "box.FCStd"), hidden=True)
    try:
        names = {obj.Name for obj in doc.Objects}
        parts = {"Midstructure", "Shell", "InnerBoundary", "Core", "FemMesh"}
        assert names == {"Body", "HybridVolume", *parts}
        volume, mesh = doc.HybridVolume, doc.FemMesh.FemMesh
        assert volume.Status == "Up to date" and doc.FemMesh.Shape is doc.Body
        assert doc.Body.Shape.Volume == pytest.approx(6.0)
        assert mesh.NodeCount == found["fem"]["nodes"]
        groups = {mesh.getGroupName(g): len(mesh.getGroupElements(g)) for g in mesh.Groups}
        assert groups["Shell"] == found["fem"]["penta15"] == doc.Shell.FemMesh.VolumeCount
        assert groups["Core"] == found["fem"]["tet10"] == doc.Core.FemMesh.VolumeCount
        assert {f"Face{i}" for i in range(1, 7)} <= set(groups)
        for number, face in enumerate(doc.Body.Shape.Faces, start=1):
            nodes = set(mesh.getNodesByFace(face))
            (group,) = [g for g in mesh.Groups if mesh.getGroupName(g) == f"Face{number}"]
            used = {n for e in mesh.getGroupElements(group) for n in mesh.getElementNodes(e)}
            assert nodes == used
        from HybridVolume.core.hybrid import HybridVolume

        stored = HybridVolume.load(volume.Result)
        points = np.array([tuple(p) for p in mesh.Nodes.values()])
        assert np.array_equal(np.unique(points, axis=0), np.unique(stored.fem.nodes, axis=0))
        assert float(volume.Report["shell.w0"]) == pytest.approx(found["shell"]["w0"], rel=1e-4)
    finally:
        FreeCAD.closeDocument(doc.Name)


def test_several_bodies_one_refused(place, python):
    bodies = [box(), Part.makeCylinder(0.5, 1, FreeCAD.Vector(6, 0, 0))]
    write_step(Part.makeCompound(bodies), place / "two.step")
    decisions = ("--keep-sheet", "Face5+Face4", "--remove-sheet", "Face1+Face3")
    mesh = ("--order", "1", "--fem-layers", "3", "--layer-growth", "2")
    files = ("--export", "msh,vtu,step", "--export", "mfem,gismo")
    answer = run(place, "two.step", "--no-cover", "--layers", "1", *mesh, *files, *decisions)
    assert answer.returncode == 2
    (line,) = answer.stderr.splitlines()
    assert line.startswith("error: two_2: Face") and "seam" in line
    names = [f"two_1.{export}" for export in ("inp", "msh", "png", "vtu")]
    names += ["two_1_fem.vtu", "two_1_surface.step", "two_1.mesh", "two_1.xml", "two_1_core.msh"]
    names += ["two_1_interface.csv", "two_1_interface_triangles.csv"]
    assert tree(place / "two") == sorted([*names, "report.json", "two.FCStd"])
    found = json.loads((place / "two" / "report.json").read_text())
    (one,) = found["volumes"]
    assert one["shell"]["layers"] == 1 and one["fem"]["penta6"] > 0 == one["fem"]["penta15"]
    density = one["fem"]["density"]
    assert one["fem"]["layers"] == density["layers"] == 3 and density["growth"] == 2.0
    assert (place / "two" / "two_1.msh").read_bytes()[:15] == b"$MeshFormat\n4.1"
    core = one["fem"]["solver_core"]
    assert core["degree"] == 1 and core["tets"] >= one["interior"]["tets"]
    shell = (place / "two" / "two_1.mesh").read_text()
    assert shell.startswith("MFEM NURBS mesh v1.0") and "# 6 Face6\n# 7 Interface\n" in shell
    rows = (place / "two" / "two_1_interface.csv").read_text().splitlines()
    assert rows[0] == "node,patch,t1,t2,t3,x,y,z" and len(rows) > 8
    surface = Part.Shape()
    surface.read(str(place / "two" / "two_1_surface.step"))
    assert len(surface.Solids) == 1 and surface.Volume == pytest.approx(6.0, rel=1e-9)
    (refused,) = found["refused"]
    assert refused["name"] == "two_2" and refused["code"] == "seam"
    # the sheet in the middle, (3 - 1) (2 - 1), and the thick part of one of an edge of length 3,
    # between the insets by 0.25 and by 0.5, at 45 degrees
    sheets = one["midstructure"]
    assert sheets["area"] == pytest.approx(2.0 + 2.25 * 0.25 * 2**0.5, rel=0.03)
    assert sheets["decided"] == ["keep Face5+Face4", "remove Face1+Face3"]
    kept = [set(sheet["faces"]) for sheet in sheets["decisions"] if sheet["kept"]]
    assert kept == [{"Face5", "Face6"}, {"Face4", "Face5"}] and sheets["kept"] == 2
    doc = FreeCAD.openDocument(str(place / "two" / "two.FCStd"), hidden=True)
    try:
        assert doc.Midstructure.Decisions == sheets["decided"]
        assert doc.FemMesh.Layers == 3 and doc.FemMesh.Growth == 2.0
        assert doc.Midstructure.Kept.count(True) == 2 and doc.HybridVolume.Status == "Up to date"
    finally:
        FreeCAD.closeDocument(doc.Name)


def test_covered_bodies_beside_a_refused_one(place, python):
    """A ball, which has a seam and poles, and a box without a lid, in one file."""
    open_box = Part.Solid(Part.Shell(box(at=(20, 0, 0)).Faces[:5]))
    Part.makeCompound([Part.makeSphere(5), open_box]).exportBrep(str(place / "two.brep"))
    wanted = ("--thickness", "1 mm", "--face-factor", "Face1=0.5", "--cover-tolerance", "0.02 mm")
    answer = run(place, "two.brep", *wanted, "--order", "1", "--export", "step")
    assert answer.returncode == 2
    assert answer.stderr.startswith("error: two_2: ") and "the body is open" in answer.stderr
    said = "1 face: 1 exact; covered with 6 patches"
    lines = answer.stdout.splitlines()
    assert f"two_1: {said}" in lines
    found = json.loads((place / "two" / "report.json").read_text())
    (one,) = found["volumes"]
    given = one["input"]
    geometry = given["geometry"]
    assert geometry["tolerance"] == 0.02 and geometry["sentence"] == said == one["notes"][0]
    assert geometry["counts"] == {"bit": 0, "exact": 1, "tolerance": 0}
    assert geometry["area"] == {"bit": 0.0, "exact": 1.0, "tolerance": 0.0}
    (row,) = geometry["faces"]
    assert (row["name"], row["kind"], row["patches"]) == ("Face1", "exact", 6)
    assert row["area"] == pytest.approx(100 * np.pi, rel=1e-9)
    assert row["deviation"] == geometry["max_deviation"] <= 1e-13
    assert (given["faces"], given["faces_exact"], given["patches"]) == (1, 1, 6)
    assert given["volume"] == pytest.approx(500 / 3 * np.pi, rel=1e-12)
    assert one["fem"]["faces_covered"] == 1
    # the face's factor holds for all of its patches
    (thickness,) = one["shell"]["faces"]
    assert thickness["face"] == "Face1"
    assert thickness["thickness"]["mean"] == pytest.approx(0.5, rel=0.02)
    surface = Part.Shape()
    surface.read(str(place / "two" / "two_1_surface.step"))
    assert len(surface.Faces) == 6 and surface.isValid()
    doc = FreeCAD.openDocument(str(place / "two" / "two.FCStd"), hidden=True)
    try:
        assert doc.Body.Shape.Volume == pytest.approx(500 / 3 * np.pi, rel=1e-9)
        assert len(doc.Body.Shape.Faces) == 1 and doc.HybridVolume.Status == "Up to date"
        assert doc.HybridVolume.CoverTolerance.Value == 0.02
    finally:
        FreeCAD.closeDocument(doc.Name)


def test_a_file_with_the_midstructure(place, python):
    write_step(box(), place / "box.step")
    plane = Part.makePlane(1.8, 0.8, FreeCAD.Vector(0.6, 0.6, 0.5))
    write_step(plane, place / "plane.step")
    options = ("--midstructure", "plane.step", "--order", "1", "--degree", "2")
    shell = ("--thickness", "mean 0.3 mm", "--face-factor", "Face6=0.5", "--spacing", "ratio 1.5")
    answer = run(place, "box.step", *options, *shell, "--span-size", "0.9mm")
    assert answer.returncode == 0, answer.stderr
    found = json.loads((place / "box" / "report.json").read_text())
    assert found["midstructure"]["method"] == found["midstructure"]["asked"] == "own"
    assert found["midstructure"]["area"] == pytest.approx(1.44, rel=1e-9)
    assert found["shell"]["valid"] == found["shell"]["elements"] > 0
    asked = {"kind": "mean", "value": 0.3, "text": "mean 0.3 mm", "factors": {"Face6": 0.5}}
    assert found["shell"]["asked"] == asked and found["shell"]["spacing"] == "ratio 1.5"
    evening = found["evening"]
    assert evening["asked"] == {"size": 0.9, "aspect": 0.0, "turn": 0.0}
    assert evening["before"]["spans"] == 6 and evening["before"]["longest"] == pytest.approx(3.0)
    assert evening["after"]["spans"] >= 2 * (4 * 3 + 4 * 2 + 3 * 2)
    assert evening["after"]["longest"] <= 0.9 and "asked: to 0.9 mm" in evening["sentence"]
    assert f"box: {evening['sentence']}" in answer.stdout.splitlines()
    first, second = found["shell"]["layer_heights"]
    assert second / first == pytest.approx(1.5, rel=1e-6)
    rows = {row["face"]: row for row in found["shell"]["faces"]}
    assert rows["Face6"]["thickness"]["mean"] < 0.8 * rows["Face5"]["thickness"]["mean"]
    said = found["shell"]["sentence"]
    assert (f"box: {said}" in answer.stdout.splitlines()) == bool(said) == (said in found["notes"])
    doc = FreeCAD.openDocument(str(place / "box" / "box.FCStd"), hidden=True)
    try:
        (geometry,) = doc.Midstructure.Geometry
        assert geometry.Shape.Area == pytest.approx(1.44)
        doc.recompute(None, True)
        volume = doc.HybridVolume
        assert volume.Status == doc.Midstructure.Status == "Up to date"
        assert (volume.ThicknessKind, volume.Thickness.Value) == ("Mean", 0.3)
        assert (volume.Spacing, volume.LayerRatio) == ("Ratio", 1.5)
        assert (volume.SpanSize.Value, volume.SpanAspect, volume.SpanTurn) == (0.9, 0.0, 0.0)
        assert volume.FaceFactors == ["Face6 = 0.5"] and volume.Degree == 2
        assert set(volume.FaceThickness) == {f"Face{k}" for k in range(1, 7)}
        geometry.Placement.Base = FreeCAD.Vector(0.1, 0, 0)
        doc.recompute()
        assert doc.HybridVolume.Status == "Out of date: Midstructure.Geometry changed"
    finally:
        FreeCAD.closeDocument(doc.Name)


def test_a_decision_without_a_sheet_names_the_sheets(place, python):
    write_step(box(), place / "box.step")
    answer = run(place, "box.step", "--samples", "3000", "--keep-only", "Face5+Face5")
    assert answer.returncode == 2
    (line,) = answer.stderr.splitlines()
    assert line.startswith("error: only Face5+Face5: no such sheet; the largest sheets are Face")
    assert "Face5+Face6@" in line and " and " in line
    assert tree(place) == ["box.step"]


def test_a_decision_must_fit_one_of_several_bodies():
    def outcome(*unmatched):
        figures = {"decided": ["keep A+B"], "unmatched": unmatched, "decisions": [{"name": "C+D"}]}
        return completion.Outcome("body", {"midstructure": figures})

    completion.check_matched(["keep A+B"], [outcome("keep A+B"), outcome()])
    with pytest.raises(InputError, match=r"keep A\+B: no such sheet; the largest sheets are C\+D"):
        completion.check_matched(["keep A+B"], [outcome("keep A+B"), completion.Outcome("other")])


def test_sums_of_several_bodies(completed):
    one = json.loads((completed[0] / "report.json").read_text())
    sums = report.file_report([one, one], [], {"reading": 1.0}, 50.0)
    assert len(sums["volumes"]) == 2 and sums["refused"] == []
    assert sums["input"]["volume"] == pytest.approx(12.0)
    assert sums["shell"]["valid"] == 2 * one["shell"]["valid"] == sums["shell"]["elements"]
    assert sums["fem"]["nodes"] == 2 * one["fem"]["nodes"]
    assert sums["seconds"]["shell"] == pytest.approx(2 * one["seconds"]["shell"])
    assert sums["seconds"]["total"] == 50.0


def test_a_figure_that_was_never_computed_is_no_report(tmp_path):
    with pytest.raises(FaultError, match=r"shell\.w0, x\[1\]"):
        report.write({"shell": {"w0": float("nan")}, "x": [1.0, float("inf")]}, tmp_path / "r")
    assert tree(tmp_path) == []


def test_the_same_from_a_macro(place, python, monkeypatch):
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", python)
    (body,) = HybridVolume.read_step(write_step(box(), place / "box.step"))
    assert HybridVolume.medial_axis(body, samples=2000).area > 0.1
    news = []
    drawn = place / "drawn"
    volume = HybridVolume.complete(
        body,
        thickness=0.2,
        face_factors={"Face6": 1.5},
        layers=2,
        spacing="first 0.05 mm",
        degree=2,
        pictures=drawn,
        progress=news.append,
    )
    assert tree(drawn) == sorted(f"box_{picture}.png" for picture in job.PICTURES)
    assert volume.certificate.all_valid and volume.shell.layer_count == 2
    assert volume.report["asked"]["text"] == "0.2 mm" and len(volume.report["faces"]) == 6
    assert volume.report["layer_heights"][0] == pytest.approx(0.05, rel=0.1)
    assert [one.fraction for one in news] == sorted(one.fraction for one in news)
    doc = FreeCAD.newDocument("macro", hidden=True, temp=True)
    try:
        source = doc.addObject("Part::Feature", "Body")
        source.Shape = body.shape
        mesh = HybridVolume.to_fem(volume, doc, order=1, body=source)
        assert mesh.FemMesh.VolumeCount == len(volume.fem.wedges) + len(volume.fem.tets)
        made = HybridVolume.to_document(volume, doc, source)
        assert made.Status == "Up to date" and made.Layers == 2 and made.Degree == 2
        assert (made.ThicknessKind, made.Thickness.Value) == ("Even", 0.2)
        assert made.FaceFactors == ["Face6 = 1.5"] and made.FirstLayer.Value == 0.05
        doc.UndoMode = 1
        before = made.FemMesh.FemMesh.NodeCount
        again = HybridVolume.remesh(made, size=0.5, face_sizes={"Face6": 0.25})
        assert again is made.FemMesh and doc.UndoNames == ["Mesh again"]
        assert again.Size.Value == 0.5 and list(again.FaceSizes) == ["Face6 = 0.25 mm"]
        assert made.Status == "Up to date" and again.FemMesh.NodeCount > 2 * before
        fem = hybrid.load(made.Result).fem
        x = fem.nodes[fem.face_triangles("Face6")[:, :3]]
        # the size is that of the sides of a cell, whose diagonal is an edge too
        longest = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max()
        assert longest <= 0.25 * 2**0.5 * (1.0 + 1e-12)
        with pytest.raises(InputError, match="no such face"):
            HybridVolume.remesh(again, face_sizes={"Face7": 0.25})
        assert len(doc.UndoNames) == 1
    finally:
        FreeCAD.closeDocument(doc.Name)
    # a shape alone does as well; what the body is refused for arrives here
    with pytest.raises(SeamError, match="Face1"):
        HybridVolume.complete(Part.makeCylinder(1, 2), cover=False)


# ------------------------------------------------------------------- stopped on the way


def running():
    """Parent of each process that has not ended."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                state, parent = (entry / "stat").read_text().rsplit(")", 1)[1].split()[:2]
            except OSError:
                continue
            if state != "Z":
                parents[int(entry.name)] = int(parent)
    return parents


def children(pid):
    """All processes below one, parents first."""
    parents = running()
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found[1:]


def started(place, until):
    """A run that has got as far as a line of its progress."""
    write_step(box(), place / "box.step")
    options = ("--thickness", "0.2 mm", "--face-factor", "Face3=1.5", "--pictures")
    child = subprocess.Popen(**command(place, "box.step", "-o", "new/out", *options))
    for line in child.stdout:
        if until in line:
            return child
    pytest.fail(child.stderr.read())


def gone(pids, seconds=10.0):
    """Whether processes end in time; one that nobody has waited for yet has ended."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if not set(pids) & set(running()):
            return True
        time.sleep(0.05)
    return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize(
    ("number", "code", "stage"),
    [
        (signal.SIGINT, 130, "midstructure"),
        (signal.SIGTERM, 143, "shell"),
        (signal.SIGKILL, -9, "field"),
    ],
)
def test_stopped_on_the_way(place, python, number, code, stage):
    child = started(place, stage)
    below = children(child.pid)
    assert below
    child.send_signal(number)
    _, errors = child.communicate(timeout=20)
    assert child.returncode == code
    assert gone(below)
    if number != signal.SIGKILL:
        assert errors == "error: stopped; nothing was written\n"
        assert tree(place) == ["box.step"] and leftovers(place) == []


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_killed_worker(place, python):
    child = started(place, "field")
    worker, *rest = children(child.pid)
    os.kill(worker, signal.SIGKILL)
    _, errors = child.communicate(timeout=20)
    assert child.returncode == 1
    assert errors.startswith("error: the worker process was ended by SIGKILL")
    assert gone([worker, *rest])
    assert tree(place) == ["box.step"] and leftovers(place) == []
