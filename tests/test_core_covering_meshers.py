# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Meshers of faces: Gmsh and Netgen on a prism; meshers that crash, hang, grab memory or lie."""

import importlib.util
import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.check import check_surface
from HybridVolume.core.covering import exchange
from HybridVolume.core.covering.edge_points import edge_points
from HybridVolume.core.covering.effort import Effort
from HybridVolume.core.covering.exchange import (
    BREP,
    COVER,
    ERROR,
    read_cover,
    told_failure,
    write_body,
)
from HybridVolume.core.covering.face_checks import check_cover
from HybridVolume.core.covering.geometry import SplineCurve
from HybridVolume.core.covering.limits import ended, limit_memory
from HybridVolume.core.covering.mesh_runs import run_mesher
from HybridVolume.core.covering.mesher import Request
from HybridVolume.core.covering.outline import Outline
from HybridVolume.core.covering.quad_mesh import Meshers, UnmeshedError, Way, quad_cover
from HybridVolume.core.surface import SplineFace
from HybridVolume.errors import FaultError, InputError, LimitError, from_dict

PROJECT = Path(__file__).resolve().parents[1]
LINE = np.array([0.0, 0.0, 1.0, 1.0])
CORNERS = np.array([[0, 0], [30, 0], [0, 40]], dtype=float)
HEIGHT = 20.0
VOLUME, AREA = 12000.0, 2 * 600 + HEIGHT * (30 + 40 + 50)


def installed(name):
    return importlib.util.find_spec(name) is not None


needs_netgen = pytest.mark.skipif(not installed("netgen"), reason="Netgen makes the solid")


def prism():
    """A prism on a right triangle: Face1 and Face2 its ends, Face3 to Face5 its sides."""
    vertices = np.concatenate([np.column_stack([CORNERS, np.full(3, z)]) for z in (0.0, HEIGHT)])
    # edges 0-2 around the bottom, 3-5 around the top, 6-8 upwards
    edges = np.array([[0, 1], [1, 2], [2, 0], [3, 4], [4, 5], [5, 3], [0, 3], [1, 4], [2, 5]])
    loops = [[(2, False), (1, False), (0, False)], [(3, True), (4, True), (5, True)]]
    loops += [
        [(k, True), (6 + (k + 1) % 3, True), (3 + k, False), (6 + k, False)] for k in range(3)
    ]
    rows = np.array([(f, f, e, d) for f, loop in enumerate(loops) for e, d in loop])
    face, loop, edge, forward = rows.T
    ways = (vertices[edges[:, 1]] - vertices[edges[:, 0]])[edge] * np.where(forward, 1, -1)[:, None]
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    corner = np.empty(len(edge))
    for f in range(5):
        own = np.flatnonzero(face == f)
        corner[own] = np.arccos(np.sum(ways[own] * ways[np.roll(own, -1)], axis=1))
    outline = Outline(
        vertices, edges, vertices[edges].mean(axis=1),
        np.linalg.norm(np.diff(vertices[edges], axis=1)[:, 0], axis=1), np.zeros(9),
        face, loop, edge, forward.astype(bool), corner,
    )  # fmt: skip
    curves = [SplineCurve(1, LINE, vertices[edge], np.ones(2)) for edge in edges]
    box = [[[0, 0], [0, 40]], [[30, 0], [30, 40]]]
    ends = [np.dstack([np.array(box, dtype=float), np.full((2, 2), z)]) for z in (0.0, HEIGHT)]
    nets = [ends[0].transpose(1, 0, 2), ends[1]]
    for k in range(3):
        a, b = vertices[k], vertices[(k + 1) % 3]
        up = [0.0, 0.0, HEIGHT]
        nets.append(np.array([[a, a + up], [b, b + up]]))
    surfaces = [
        SplineFace(f"Face{k + 1}", (1, 1), (LINE, LINE), net, np.ones((2, 2)))
        for k, net in enumerate(nets)
    ]
    return outline, curves, surfaces


def write_prism(path):
    from netgen import occ

    plane = occ.WorkPlane(occ.Axes((0, 0, 0), n=occ.Z, h=occ.X))
    plane.MoveTo(0, 0).LineTo(30, 0).LineTo(0, 40).Close()
    plane.Face().Extrude(HEIGHT).WriteBrep(str(path))


def covered(folder, ways, intervals=3, seconds=60.0):
    outline, curves, surfaces = prism()
    count = np.full(9, intervals)
    sides = {face: outline.sides(face) for face in (2, 3, 4)}
    return outline, quad_cover(
        folder / BREP, outline, count, sides, 15.0, curves, surfaces, np.ones(5, dtype=bool),
        Meshers(list(ways), seconds),
    )  # fmt: skip


def fake_gmsh(folder, monkeypatch, text):
    """A module gmsh that does something else in the mesher's process."""
    away = folder / "fake"
    away.mkdir()
    (away / "gmsh.py").write_text(f"def initialize(*args, **keywords):\n    {text}\n")
    monkeypatch.setenv("PYTHONPATH", str(away))


@needs_netgen
@pytest.mark.parametrize(
    "way", [Way("gmsh", 6), Way("gmsh", 5, quads=False), Way("netgen"), Way("netgen", quads=False)]
)
def test_quads_close_the_prism(way, tmp_path):
    if not installed(way.engine):
        pytest.skip(f"{way.engine} is not installed")
    write_prism(tmp_path / BREP)
    outline, cover = covered(tmp_path, [way])
    x = cover.points[cover.quads]
    normal = 0.5 * np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
    assert np.linalg.norm(normal, axis=1).sum() == pytest.approx(AREA, rel=1e-12)
    # outward, flat quads: the divergence theorem with the middles of the faces' planes
    assert np.einsum("mi,mi->", normal, x.mean(axis=1)) / 3 == pytest.approx(VOLUME, rel=1e-12)
    assert np.bincount(cover.rim_edge).tolist() == [6] * 9
    assert np.bincount(cover.face)[2:].tolist() == [36] * 3
    with pytest.raises(FaultError, match="not cut"):
        check_cover(
            cover.quads, cover.face, cover.rim, cover.rim_edge, outline, np.array([6] * 8 + [8])
        )
    turned = cover.quads.copy()
    turned[7] = turned[7, ::-1]
    with pytest.raises(FaultError, match="do not close"):
        check_cover(turned, cover.face, cover.rim, cover.rim_edge, outline, np.full(9, 6))
    with pytest.raises(FaultError, match="do not close"):
        check_cover(
            cover.quads[1:], cover.face[1:], cover.rim, cover.rim_edge, outline, np.full(9, 6)
        )


GARBAGE = (
    "import os, numpy as np; np.savez('answer-000000.npz', points=np.full((4, 3), np.nan),"
    " elements=np.array([[0, 1, 2, 3]]), face=np.zeros(1, int), rim=np.zeros((1, 4), int),"
    " done=np.zeros(1, int)); os._exit(0)"
)
OTHERS = GARBAGE.replace("np.nan", "1.0").replace("[[0, 1, 2, 3]]", "[[0, 1, 2, 9]]")
BAD = {
    "crash": ("import os; os.kill(os.getpid(), 11)", "crashed .SIGSEGV"),
    "kill": ("import os; os.kill(os.getpid(), 9)", "crashed .SIGKILL"),
    "hang": ("import time; time.sleep(600)", "no answer in time"),
    "endless work": ("while True: pass", "no answer in time"),
    "complaint": ("raise RuntimeError('no ideas')", "no ideas"),
    "silence": ("import os; os._exit(0)", "ended with code 0"),
    "half a file": (
        "import os; open('answer-000000.npz', 'w').write('PK'); os._exit(0)",
        "damaged",
    ),
    "no numbers": (GARBAGE, "no numbers"),
    "other corners": (OTHERS, "corners that do not exist"),
    "a lie": (GARBAGE.replace("np.nan", "1.0"), "no mesher can"),
}


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("what", BAD)
def test_bad_meshers_end_in_a_named_refusal(what, tmp_path, monkeypatch):
    text, reason = BAD[what]
    fake_gmsh(tmp_path, monkeypatch, text)
    with pytest.raises(UnmeshedError, match=reason) as caught:
        covered(tmp_path, [Way("gmsh", 6)], seconds=0.5 if reason == "no answer in time" else 60.0)
    assert caught.value.faces == ("Face1", "Face2")
    assert isinstance(caught.value, InputError) and caught.value.remedy


@needs_netgen
def test_the_other_mesher_helps(tmp_path, monkeypatch):
    write_prism(tmp_path / BREP)
    fake_gmsh(tmp_path, monkeypatch, BAD["crash"][0])
    meshers = Meshers([Way("gmsh", 6), Way("netgen")])
    outline, curves, surfaces = prism()
    cover = quad_cover(
        tmp_path / BREP, outline, np.full(9, 2), {}, 15.0, curves, surfaces, np.ones(5, dtype=bool),
        meshers,
    )  # fmt: skip
    assert set(cover.face.tolist()) == set(range(5))
    assert [way.engine for way in meshers.ways] == ["netgen", "gmsh"]
    assert "SIGSEGV" in meshers.reasons[0]


def process(folder, task, wait=True, stdin=subprocess.DEVNULL):
    write_body(folder, *prism(), {"tolerance": 1e-3, **task})
    command = [sys.executable, "-m", "HybridVolume.core.covering.exchange", str(folder)]
    running = subprocess.Popen(command, cwd=PROJECT, stdin=stdin, stdout=subprocess.PIPE, text=True)
    return (running, running.communicate(timeout=120)[0]) if wait else (running, "")


@needs_netgen
def test_the_process_covers_and_tells(tmp_path, monkeypatch):
    monkeypatch.setenv("HYBRIDVOLUME_FREE_ONLY", "1")
    write_prism(tmp_path / BREP)
    running, said = process(tmp_path, {})
    assert running.returncode == 0
    assert all(set(json.loads(line)) == {"stage", "fraction", "text"} for line in said.splitlines())
    surface = build_surface(list(read_cover(tmp_path).faces))
    check_surface(surface)
    assert surface.volume() == pytest.approx(VOLUME, rel=1e-12)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs limits and /proc")
@pytest.mark.skipif(not installed("gmsh"), reason="stands in for an installed Gmsh")
@pytest.mark.parametrize("limit", ["seconds", "stdin"])
def test_limits_end_the_process(limit, tmp_path, monkeypatch):
    # the time that counts is the processor's, of the mesher too
    work = "time.sleep(600)" if limit == "stdin" else "[sum(range(1000)) for _ in iter(int, 1)]"
    hang = f"open({str(tmp_path / 'pid')!r}, 'w').write(str(__import__('os').getpid()));"
    fake_gmsh(tmp_path, monkeypatch, f"{hang} import time; {work}")
    # Netgen is there, too: it finds no solid
    (tmp_path / BREP).write_text("no solid")
    task = {"seconds": 4.0 if limit == "seconds" else 100.0}
    began = time.monotonic()
    running, _ = process(
        tmp_path, task, wait=limit != "stdin",
        stdin=subprocess.PIPE if limit == "stdin" else subprocess.DEVNULL,
    )  # fmt: skip
    if limit == "stdin":
        while not (tmp_path / "pid").is_file() and time.monotonic() < began + 60:
            time.sleep(0.05)
        running.stdin.close()
        assert running.wait(60) == 1
    else:
        assert running.returncode == 2
        told = from_dict(json.loads((tmp_path / ERROR).read_text()))
        assert isinstance(told, LimitError) and "longer than 4 s" in told.message
        assert told.faces == ("Face1", "Face2")
        assert told.remedy
    running.stdout.close()
    assert not (tmp_path / COVER).exists()
    pid = int((tmp_path / "pid").read_text())
    while Path(f"/proc/{pid}").exists() and time.monotonic() < began + 90:
        time.sleep(0.05)
    assert not Path(f"/proc/{pid}").exists(), "the mesher goes on alone"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs limits")
def test_greedy_meshers_end_in_a_named_refusal(tmp_path, monkeypatch):
    import resource

    fake_gmsh(
        tmp_path,
        monkeypatch,
        "x = []\n    while True: x.append(__import__('numpy').zeros(1 << 25))",
    )
    before = resource.getrlimit(resource.RLIMIT_AS)
    try:
        assert limit_memory(2.0**34) == 2.0**34
        with pytest.raises(UnmeshedError, match="more memory") as caught:
            covered(tmp_path, [Way("gmsh", 6)])
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    assert caught.value.faces == ("Face1", "Face2")
    # and a process that is itself too small for the body
    running, _ = process(tmp_path, {"memory": 3e8})
    assert running.returncode == 2
    assert "more memory than 0.279 GiB" in json.loads((tmp_path / ERROR).read_text())["message"]
    running.stdout.close()


def test_ends_without_an_answer_are_told():
    assert "too little memory" in ended(-9).message and isinstance(ended(-9), LimitError)
    assert "SIGSEGV (a crash)" in ended(-11).message
    # an end that nobody intended is no property of the body
    fault = ended(1, "first\nlast words\n")
    assert isinstance(fault, FaultError) and "code 1 (last words)" in fault.message


def inside_this_process(folder, monkeypatch, cover_body, task):
    """Run the process's main function here, with another way to cover; its exit code."""
    monkeypatch.setattr(exchange, "cover_body", cover_body)
    monkeypatch.setattr(exchange, "end_after", lambda *_: threading.Event())
    monkeypatch.setattr(exchange, "end_with_parent", lambda: None)
    monkeypatch.setattr(exchange, "end_with_input", lambda: None)
    monkeypatch.setattr(exchange, "limit_memory", lambda most: most)
    write_body(folder, *prism(), {"tolerance": 1e-3, **task})
    return exchange.main([str(folder)])


@pytest.mark.parametrize("fault", [ZeroDivisionError("by 0"), RuntimeError("odd"), KeyError(3)])
def test_faults_inside_are_no_refusals(fault, tmp_path, monkeypatch):
    def fails(*_, **__):
        raise fault

    assert inside_this_process(tmp_path, monkeypatch, fails, {"turn": 60.0}) == 1
    told = from_dict(json.loads((tmp_path / ERROR).read_text()))
    assert isinstance(told, FaultError) and type(fault).__name__ in told.message
    assert "report" in told.remedy and not (tmp_path / COVER).exists()


def test_the_first_sizes_get_half_of_the_time(tmp_path, monkeypatch):
    """And the next ones half of what is left, however little of the clock has gone by."""
    given = []

    def fails(*_, seconds, **__):
        given.append(seconds)
        raise InputError("too far", faces=["Face1"])

    assert inside_this_process(tmp_path, monkeypatch, fails, {"seconds": 200.0}) == 2
    assert given[:2] == pytest.approx([90.0, 90.0], abs=2.0)


def test_a_fault_is_told_before_refusals():
    refusals = [InputError("far", faces=["Face1", "Face2"]), InputError("farther", faces=["Face3"])]
    fault = FaultError("quads do not close the body")
    assert told_failure(refusals) is refusals[1]
    assert told_failure([refusals[0], fault, refusals[1]]) is fault


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
def test_the_processors_time_counts():
    """Sleeping costs nothing, work does: here, in children that run, and in ended ones."""
    effort = Effort()
    time.sleep(0.5)
    assert effort.seconds() < 0.2
    spin = "import time\nwhile time.process_time() < 0.6: pass\nprint(); input()"
    command = [sys.executable, "-c", spin]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        own = Effort(child.pid)
        child.stdout.readline()
        assert own.seconds() > 0.4
        assert effort.seconds() < 0.3 and effort.seconds([child.pid]) > 0.5
        assert effort.left(0.5, [child.pid]) < 0.0 < effort.left(100.0, [child.pid])
        child.communicate(b"\n")
    assert effort.seconds() > 0.5
    # a hang: no time of the processor, but far too much of the clock
    idle = Effort()
    time.sleep(0.2)
    assert idle.left(0.01) < 0.0 < idle.left(1.0)


@needs_netgen
def test_netgen_goes_on_behind_a_face_that_kills_it(tmp_path, monkeypatch):
    # a file in which the second face crashes the mesher: its process is killed there
    write_prism(tmp_path / BREP)
    away = tmp_path / "fake" / "netgen"
    away.mkdir(parents=True)
    real = importlib.util.find_spec("netgen").origin
    (away / "__init__.py").write_text(
        f"__path__.append({str(Path(real).parent)!r})\nexec(open({real!r}).read())\n"
        "from netgen import occ\n_geometry, _count = occ.OCCGeometry, [0]\n"
        "def _deadly(shape):\n    _count[0] += 1\n"
        "    if _count[0] == 3: __import__('os').abort()\n    return _geometry(shape)\n"
        "occ.OCCGeometry = _deadly\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "fake"))

    outline, curves, _ = prism()
    rims = edge_points(outline, curves, np.full(9, 2))
    points = [rims.points[rims.along(edge)[::2]] for edge in range(9)]
    request = Request(
        str(tmp_path / BREP), np.arange(5), outline.face, outline.edge, np.full(9, 2),
        np.arange(0, 28, 3), np.concatenate(points), outline.middle,
        outline.vertices[outline.edges].sum(axis=1), 15.0, True, 0,
    )  # fmt: skip
    answer = run_mesher("netgen", request, 60.0)
    # calls: the file, Face1, Face2 (dies); the file, Face3, Face4 (dies); the file, Face5
    assert np.unique(answer.face).tolist() == [0, 2, 4]
