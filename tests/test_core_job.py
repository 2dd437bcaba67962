# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The job's side of the protocol against workers that answer, lie, hang and die."""

import os
import signal
import stat
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import torus
from shells import make_volume

import HybridVolume
from HybridVolume import exchange
from HybridVolume import job as protocol
from HybridVolume.core.pipeline import Options
from HybridVolume.errors import GapError, InputError, SetupError, WorkerError
from HybridVolume.job import Job
from HybridVolume.mesh_job import changed_density, mesh_job

pytestmark = pytest.mark.skipif(os.name != "posix", reason="workers are made of POSIX scripts")


@pytest.fixture
def worker(tmp_path, monkeypatch):
    """Makes an interpreter that runs a text as the worker; FOLDER is its job's folder."""
    monkeypatch.delenv("HYBRIDVOLUME_PYTHON", raising=False)  # it would win over the argument

    def make(text: str) -> str:
        path = tmp_path / "python"
        path.write_text(
            f"#!{sys.executable}\nimport os, sys, time\nFOLDER = sys.argv[-1]\n{text}\n"
        )
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return str(path)

    return make


def make_job(python: str, parent: Path, **keywords) -> Job:
    return Job(torus().faces, name="torus", python=python, parent=parent, **keywords)


ANSWER = """
for name in ("result.npz", "report.json", "torus.vtu"):
    open(os.path.join(FOLDER, name), "w").write("{}")
print('{"stage": "front", "fraction": 0.25, "text": "half of it"}', flush=True)
print('{"done": true}', flush=True)
"""


def is_alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def wait_until(condition, seconds: float = 10.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.02)
    return False


def test_faces_travel_bit_for_bit(tmp_path):
    faces = torus().faces
    exchange.write_surface(tmp_path / "surface.npz", faces)
    again = exchange.read_surface(tmp_path / "surface.npz")
    assert [face.name for face in again] == [face.name for face in faces]
    for one, other in zip(faces, again, strict=True):
        assert one.degrees == other.degrees and one.exact == other.exact
        for a, b in zip(
            (*one.knots, one.control_points, one.weights),
            (*other.knots, other.control_points, other.weights),
            strict=True,
        ):
            assert np.array_equal(a, b)


def test_own_geometry_travels_bit_for_bit(tmp_path):
    vertices, facets = np.eye(4, 3) / 3.0, np.array([[0, 1, 2], [0, 3, 3], [2, 2, 2]])
    exchange.write_own(tmp_path / "own.npz", vertices, facets)
    again = exchange.read_own(tmp_path / "own.npz")
    assert np.array_equal(again[0], vertices) and np.array_equal(again[1], facets)
    assert exchange.read_own(tmp_path / "none.npz") is None


THICKNESS = """
import json
task = json.load(open(os.path.join(FOLDER, "job.json")))
answer = {"thickness": {"goal": task["goal"], "own": os.path.exists(FOLDER + "/own.npz")}}
json.dump(answer, open(os.path.join(FOLDER, "report.json"), "w"))
open(os.path.join(FOLDER, "field.npz"), "w").close()
print('{"done": true}', flush=True)
"""


def test_a_goal_on_the_way(worker, tmp_path):
    own = (np.eye(3), np.array([[0, 1, 2]]))
    with make_job(worker(THICKNESS), tmp_path, goal="thickness", own=own) as job:
        assert job.run() == {"goal": "thickness", "own": True}
        assert job.field_file.name == "field.npz"
    without = THICKNESS.replace("field.npz", "other.npz")
    with (
        make_job(worker(without), tmp_path, goal="thickness") as job,
        pytest.raises(WorkerError, match=r"did not write field\.npz"),
    ):
        job.run()
    with (
        make_job(worker(THICKNESS), tmp_path, goal="midstructure") as job,
        pytest.raises(WorkerError, match="did not write result.npz"),
    ):
        job.run()
    with pytest.raises(ValueError, match="unknown goal"):
        make_job("", tmp_path, goal="everything")
    with pytest.raises(ValueError, match="unknown exports"):
        make_job("", tmp_path, goal="midstructure", exports=("vtu",))


def test_a_mesh_needs_a_volume_and_no_faces(worker, tmp_path):
    stored = tmp_path / "stored.npz"
    stored.write_bytes(b"a volume")
    copied = 'open(FOLDER + "/result.npz", "wb").write(open(FOLDER + "/volume.npz", "rb").read())'
    text = ANSWER.replace("for name", f"{copied}\nfor name").replace('"result.npz", ', "")
    with Job([], name="torus", goal="mesh", volume=stored, python=worker(text)) as job:
        folder = job.prepare()
        assert sorted(file.name for file in folder.iterdir()) == ["job.json", "volume.npz"]
        job.start()
        assert wait_until(lambda: job.poll() == [] and job.state == "done")
        assert job.result_file.read_bytes() == b"a volume"
    assert stored.read_bytes() == b"a volume" and not folder.exists()
    for wrong in ({"goal": "mesh"}, {"volume": stored}):
        with pytest.raises(ValueError, match="needs a volume"):
            Job([], **wrong)
    with pytest.raises(ValueError, match=r"unknown exports \['pictures'\] of a mesh"):
        Job([], goal="mesh", volume=stored, exports=("pictures",))
    with pytest.raises(ValueError, match="unknown elements 'hex8'"):
        Job([], elements="hex8")


def told_volume(name):
    """One of the ready volumes, with what a report asks for."""
    volume = make_volume(name)
    shell = replace(volume.shell, embedded=True, w0=0.4, w0_asked=0.4, w0_rms=0.0)
    return replace(volume, shell=shell, report={"boundary_deviation": 0.0})


def test_another_mesh_of_a_volume():
    """The real worker: the same shell bit for bit, and the mesh of a density."""
    volume = told_volume("sphere")
    options = {"order": 1, "subdivide": 2}
    with Job(
        [], goal="mesh", volume=volume, options=options, exports=("inp",), python=sys.executable
    ) as j:
        again = j.run()
        report = j.report()
        deck = j.exported("inp").read_text()
    # what is not asked for stays as it is
    third = mesh_job(again, changed_density(again.fem.density, fem_layers=1), 1)
    assert Options(**third.options).density == replace(again.fem.density, layers=1)
    assert np.array_equal(again.shell.layers, volume.shell.layers)
    assert np.array_equal(again.certificate.min_bernstein, volume.certificate.min_bernstein)
    assert again.fem.order == 1 and again.fem.density.subdivide == 2
    assert len(again.fem.boundary) == 4 * len(volume.fem.boundary)
    assert again.interior.volume + again.gap_volume == pytest.approx(
        volume.interior.volume + volume.gap_volume, rel=1e-12
    )
    assert report["fem"]["density"]["subdivide"] == 2
    quality = report["fem"]["quality"]["groups"]
    assert quality["shell"]["elements"] == len(again.fem.wedges) == report["fem"]["penta6"]
    assert quality["all"]["scaled_jacobian"]["min"] == report["fem"]["min_scaled_jacobian"]
    assert deck.count("*ELEMENT, TYPE=C3D6") == 1


def test_hexahedra_in_the_deck():
    volume = told_volume("box")
    asked = {"goal": "mesh", "volume": volume, "elements": "hex20", "exports": ("inp",)}
    with Job([], **asked, python=sys.executable) as job:
        again = job.run()
        figures = job.report()["fem"]
        deck = job.exported("inp").read_text()
    hexes = figures["hexahedra"]
    # two wedges a hexahedron, on the same core
    assert 2 * hexes["hex20"] + hexes["penta15"] == len(again.fem.wedges) == figures["penta15"]
    assert hexes["tet10"] == len(again.fem.tets)
    assert hexes["volume"] == pytest.approx(6.0, rel=1e-9)
    assert deck.count("*ELEMENT, TYPE=C3D20") == 1 and "*EQUATION" in deck
    with (
        Job([], **asked, options={"order": 1}, python=sys.executable) as job,
        pytest.raises(InputError, match="hexahedra have the order 2"),
    ):
        job.run()


@pytest.mark.parametrize("options", [{"size": -1.0}, {"face_sizes": {"Face99": 0.1}}])
def test_a_density_that_does_not_fit_is_refused(options):
    volume = told_volume("sphere")
    with (
        Job([], goal="mesh", volume=volume, options=options, python=sys.executable) as job,
        pytest.raises(InputError) as caught,
    ):
        job.run()
    assert protocol.exit_code(caught.value) == 2


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"order": 3}, "order is 3; choose 1 or 2"),
        ({"layers": 3}, "no such value: layers; use order, nodes, subdivide"),
        ({"subdivide": 2.5}, "2.5 is no count"),
        ({"subdivide": 65}, "parts of a cell: 65"),
        ({"size": "small"}, "cannot be read"),
        ({"face_sizes": ["Face3"]}, "sizes of faces as"),
        ({"face_sizes": {"Face3": -1}}, "the size of elements at Face3 is -1 mm"),
        ({"nodes": "greville", "size": 1.0}, "have no size"),
    ],
)
def test_a_macro_is_told_what_is_wrong_before_any_work(values, told):
    with pytest.raises(InputError, match=told):
        HybridVolume.remesh(make_volume("sphere"), python="/nowhere", **values)


def test_progress_and_answer(worker, tmp_path):
    job = make_job(worker(ANSWER), tmp_path, exports=("vtu",))
    news = []
    job.start()
    while job.state == "running":
        news += job.poll(wait=0.1)
    assert job.state == "done" and job.error is None
    assert news == [protocol.Progress("front", 0.25, "half of it")]
    assert job.report() == {} and job.exported("vtu").is_file()
    folder = job.folder
    job.close()
    assert not folder.exists()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("print('Traceback: hello', flush=True); time.sleep(60)", "wrote 'Traceback: hello'"),
        ("sys.exit('no numpy here')", "ended with code 1: no numpy here"),
        ("sys.exit(3)", "ended with code 3: no reason"),
        ("os.abort()", "SIGABRT"),
        ("os.kill(os.getpid(), 9)", "SIGKILL"),
        ("print('{\"done\": true}', flush=True)", "did not write result.npz"),
        ("print('{\"stage\": 1}', flush=True)", "wrote"),
    ],
)
def test_workers_that_die_or_lie(worker, tmp_path, text, told):
    job = make_job(worker(text), tmp_path)
    with pytest.raises(WorkerError, match=told):
        job.run()
    assert job.state == "failed" and job.folder is None
    assert [entry.name for entry in tmp_path.iterdir()] == ["python"]


def test_an_error_arrives_whole(worker, tmp_path):
    error = GapError("side gap 3e-4 mm", faces=("Face7", "Face12"), figure=3e-4, remedy="heal it")
    text = f"import json; print(json.dumps({{'error': {error.to_dict()!r}}}), flush=True)"
    with pytest.raises(GapError) as caught:
        make_job(worker(text), tmp_path).run()
    assert caught.value.line == error.line and caught.value.figure == 3e-4
    assert protocol.exit_code(caught.value) == 2
    assert protocol.exit_code(WorkerError("it died")) == 1


GRANDCHILD = """
import subprocess
child = subprocess.Popen(["sleep", "300"])
print('{"stage": "s", "fraction": 0, "text": "%d"}' % child.pid, flush=True)
time.sleep(300)
"""


def grandchild_of(job: Job) -> int:
    news = []
    while not news:
        news = job.poll(wait=0.1)
    return int(news[0].text)


def test_cancel_ends_the_meshers_too(worker, tmp_path):
    job = make_job(worker(GRANDCHILD), tmp_path)
    job.start()
    pid = grandchild_of(job)
    folder = job.folder
    started = time.monotonic()
    job.cancel()
    assert time.monotonic() - started < 5.0
    assert job.state == "cancelled" and not folder.exists()
    assert wait_until(lambda: not is_alive(pid))


def test_a_killed_worker_takes_its_meshers_along(worker, tmp_path):
    job = make_job(worker(GRANDCHILD), tmp_path)
    job.start()
    pid = grandchild_of(job)
    os.kill(job._process.pid, signal.SIGKILL)
    assert wait_until(lambda: job.poll() == [] and job.state == "failed")
    assert "SIGKILL" in job.error.line
    assert wait_until(lambda: not is_alive(pid))


def test_a_stubborn_worker_is_killed(worker, tmp_path):
    text = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN)\n" + GRANDCHILD
    job = make_job(worker(text), tmp_path)
    job.start()
    grandchild_of(job)
    pid = job._process.pid
    job.cancel()
    assert not is_alive(pid)


def test_a_missing_interpreter_says_what_to_do(tmp_path, monkeypatch):
    monkeypatch.delenv("HYBRIDVOLUME_PYTHON", raising=False)
    monkeypatch.setenv("HYBRIDVOLUME_ENVIRONMENT", str(tmp_path / "nowhere"))
    with pytest.raises(SetupError, match=r"run \./run\.sh once or open Preferences"):
        Job(torus().faces).prepare()
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", str(tmp_path))
    with pytest.raises(SetupError, match="is no interpreter"):
        Job(torus().faces).prepare()


PARENT = """
import subprocess, sys
worker = '''
import subprocess
from HybridVolume import worker
worker.die_with_parent()
child = subprocess.Popen(["sleep", "300"])
print(child.pid, flush=True)
child.wait()
'''
command = [sys.executable, "-c", worker]
subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True).wait()
"""


def test_the_worker_dies_with_its_parent():
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parent.parent)}
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        env=environment,
    )
    with parent.stdout:
        pid = int(parent.stdout.readline())
        assert is_alive(pid)
        parent.kill()
        parent.wait()
        assert wait_until(lambda: not is_alive(pid))
