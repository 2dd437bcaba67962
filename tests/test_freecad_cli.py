# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The command line as a process: what it writes, what it refuses, what it leaves behind."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import HybridVolume
from HybridVolume import job
from HybridVolume.errors import SeamError, SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Part

PROJECT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def python():
    try:
        return job.worker_python()
    except SetupError as missing:
        pytest.skip(missing.line)


@pytest.fixture
def place(tmp_path):
    """An empty working folder, and beside it one for temporary files that must end empty."""
    (tmp_path / "here").mkdir()
    (tmp_path / "temporary").mkdir()
    return tmp_path / "here"


def command(place, *arguments, **variables):
    environment = {
        **os.environ,
        "PYTHONPATH": str(PROJECT),
        "TMPDIR": str(place.parent / "temporary"),
        **variables,
    }
    return {
        "args": [sys.executable, "-P", "-m", "HybridVolume", *map(str, arguments)],
        "cwd": place,
        "env": environment,
        "stdin": subprocess.DEVNULL,
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "text": True,
    }


def run(place, *arguments, **variables):
    return subprocess.run(**command(place, *arguments, **variables), timeout=120)


def tree(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def leftovers(place):
    """Job folders and the like (FreeCAD's own lock files are not ours)."""
    return [name for name in tree(place.parent / "temporary") if "ybrid" in name]


def one_line(answer, code):
    assert answer.returncode == code, answer.stderr
    assert answer.stdout == ""
    lines = answer.stderr.splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: "), answer.stderr
    return lines[0]


def box(length=3.0, width=2.0, height=1.0, at=(0, 0, 0)):
    return Part.makeBox(length, width, height, FreeCAD.Vector(*at))


def write_step(shape, path):
    shape.exportStep(str(path))
    return path


# ------------------------------------------------------------------------------- refusals


def _wires(path):
    write_step(Part.makePolygon([FreeCAD.Vector(0, 0, 0), FreeCAD.Vector(1, 0, 0)]), path)


def _open(path):
    write_step(Part.makeShell(box().Faces[:5]), path)


def _truncated(path):
    write_step(box(), path)
    path.write_bytes(path.read_bytes()[:9000])


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
    assert told in one_line(run(place, name), 2)
    assert tree(place) == before and leftovers(place) == []


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((), "required: BODY.step"),
        (("bench",), "bench is no command"),
        (("fit", "x.step"), "unrecognized arguments"),
        (("reproduce",), "reproduce is no command"),
        (("box.step", "--w0", "2"), "--w0: '2' is no number between 0 and 1"),
        (("box.step", "--w0", "0.001"), "w0 is 0.001"),
        (("box.step", "--layers", "0"), "--layers: '0' is no count"),
        (("box.step", "--degree", "9"), "degree is 9"),
        (("box.step", "--order", "3"), "--order: invalid choice"),
        (("box.step", "-o", "box.step"), "box.step is no folder"),
        (("box.step", "-o", "box.step/below"), "cannot be written"),
    ],
)
def test_wrong_usage_in_one_line(place, python, arguments, told):
    write_step(box(), place / "box.step")
    assert told in one_line(run(place, *arguments), 2)
    assert tree(place) == ["box.step"]


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
    report = json.loads((completed[0] / "report.json").read_text())
    assert report["version"] == 1
    given = report["input"]
    assert given["file"] == "box.step" and given["bodies"] == 1 and given["closed"] is True
    assert given["faces"] == given["patches"] == 6
    assert given["genus"] == [0] and given["shells"] == 1
    assert given["volume"] == pytest.approx(6.0, rel=1e-12)
    assert given["area"] == pytest.approx(22.0, rel=1e-12)
    assert given["faces_bit"] + given["faces_exact"] + given["faces_tolerance"] == 6
    assert given["max_deviation"] < 1e-12
    shell = report["shell"]
    assert shell["elements"] == shell["valid"] > 0
    assert shell["undecided"] == shell["invalid"] == 0 and shell["embedded"] is True
    assert shell["min_bernstein"] > 0 and shell["min_scaled_jacobian"] > 0
    assert shell["boundary_deviation"] <= 1e-14
    assert shell["w0_asked"] == 0.4 and 0 < shell["w0"] <= 0.5
    thickness = shell["thickness"]
    assert 0 < thickness["min"] <= thickness["mean"] <= thickness["max"]
    total = shell["volume"] + report["interior"]["volume"] + report["interface"]["gap_volume"]
    assert total == pytest.approx(6.0, rel=1e-9)
    fem = report["fem"]
    assert fem["volume"] == pytest.approx(6.0, rel=1e-9) and fem["faces_covered"] == 6
    assert fem["tet10"] == report["interior"]["tets"] and report["interior"]["boundary_exact"]
    assert report["midstructure"]["area"] > 0 and report["field"]["tets"] > 0
    seconds = report["seconds"]
    assert sum(s for name, s in seconds.items() if name != "total") <= seconds["total"]
    assert 50 < report["peak_memory_mb"] < 2000
    assert {"python", "numpy", "scipy", "FreeCAD", "HybridVolume"} <= set(report["versions"])


def test_document(completed):
    out = completed[0]
    report = json.loads((out / "report.json").read_text())
    doc = FreeCAD.openDocument(str(out / "box.FCStd"), hidden=True)
    try:
        names = {obj.Name for obj in doc.Objects}
        assert names == {"Body", "HybridVolume", "Midstructure", "Shell", "Core", "FemMesh"}
        volume, mesh = doc.HybridVolume, doc.FemMesh.FemMesh
        assert volume.Status == "Up to date" and doc.FemMesh.Shape is doc.Body
        assert doc.Body.Shape.Volume == pytest.approx(6.0)
        assert mesh.NodeCount == report["fem"]["nodes"]
        groups = {mesh.getGroupName(g): len(mesh.getGroupElements(g)) for g in mesh.Groups}
        assert groups["Shell"] == report["fem"]["penta15"] == doc.Shell.FemMesh.VolumeCount
        assert groups["Core"] == report["fem"]["tet10"] == doc.Core.FemMesh.VolumeCount
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
        assert float(volume.Report["shell.w0"]) == pytest.approx(report["shell"]["w0"], rel=1e-4)
    finally:
        FreeCAD.closeDocument(doc.Name)


def test_several_bodies_one_refused(place, python):
    bodies = [box(), Part.makeCylinder(0.5, 1, FreeCAD.Vector(6, 0, 0)), box(at=(9, 0, 0))]
    write_step(Part.makeCompound(bodies), place / "three.step")
    answer = run(place, "three.step", "--order", "1", "--layers", "1")
    assert answer.returncode == 2
    (line,) = answer.stderr.splitlines()
    assert line.startswith("error: three_2: Face") and "seam" in line
    names = [f"three_{i}.{e}" for i in (1, 3) for e in ("inp", "png", "vtu")]
    assert tree(place / "three") == sorted([*names, "report.json", "three.FCStd"])
    report = json.loads((place / "three" / "report.json").read_text())
    assert [one["shell"]["layers"] for one in report["volumes"]] == [1, 1]
    assert report["input"]["volume"] == pytest.approx(12.0)
    assert report["shell"]["valid"] == sum(one["shell"]["valid"] for one in report["volumes"])
    assert all(one["fem"]["penta6"] > 0 == one["fem"]["penta15"] for one in report["volumes"])
    (refused,) = report["refused"]
    assert refused["name"] == "three_2" and refused["code"] == "seam"


def test_the_same_from_a_macro(place, python, monkeypatch):
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", python)
    (body,) = HybridVolume.read_step(write_step(box(), place / "box.step"))
    assert HybridVolume.medial_axis(body, samples=2000).area > 0.1
    news = []
    volume = HybridVolume.complete(body, w0=0.3, layers=1, progress=news.append)
    assert volume.certificate.all_valid and volume.shell.layer_count == 1
    assert [one.fraction for one in news] == sorted(one.fraction for one in news)
    doc = FreeCAD.newDocument("macro", hidden=True, temp=True)
    try:
        source = doc.addObject("Part::Feature", "Body")
        source.Shape = body.shape
        mesh = HybridVolume.to_fem(volume, doc, order=1, body=source)
        assert mesh.FemMesh.VolumeCount == len(volume.fem.wedges) + len(volume.fem.tets)
        made = HybridVolume.to_document(volume, doc, source)
        assert made.Status == "Up to date" and made.W0 == 0.3 and made.Layers == 1
    finally:
        FreeCAD.closeDocument(doc.Name)
    # a shape alone does as well; what the body is refused for arrives here
    with pytest.raises(SeamError, match="Face1"):
        HybridVolume.complete(Part.makeCylinder(1, 2))


# ------------------------------------------------------------------- stopped on the way


def children(pid):
    """All processes below one."""
    table = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                state, parent = (entry / "stat").read_text().rsplit(")", 1)[1].split()[:2]
            except OSError:
                continue
            if state != "Z":
                table.setdefault(int(parent), []).append(int(entry.name))
    found, queue = [], [pid]
    while queue:
        below = table.get(queue.pop(), [])
        found += below
        queue += below
    return found


def started(place, until):
    """A run that has got as far as a line of its progress."""
    write_step(box(), place / "box.step")
    child = subprocess.Popen(**command(place, "box.step", "-o", "new/out"))
    for line in child.stdout:
        if until in line:
            return child
    pytest.fail(child.stderr.read())


def gone(pids, seconds=10.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if not any(Path(f"/proc/{pid}").exists() for pid in pids):
            return True
        time.sleep(0.05)
    return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)]
)
def test_stopped_on_the_way(place, python, number, code):
    child = started(place, "field")
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
