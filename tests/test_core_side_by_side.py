# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Jobs at once: how many run, in which order they are given, what remains when that is stopped."""

from __future__ import annotations

import os
import stat
import sys

import pytest
from bodies import torus

from HybridVolume import side_by_side
from HybridVolume.job import Job
from HybridVolume.side_by_side import in_order, workers_at_once

pytestmark = pytest.mark.skipif(os.name != "posix", reason="workers are made of POSIX scripts")

# "slow" and "quick" wait for each other, "endless" waits for its end.
WORKER = """
import json, os, sys, time
folder = sys.argv[-1]
place = os.environ["MEETING"]
name = json.load(open(os.path.join(folder, "job.json")))["name"]
open(os.path.join(place, name + ".started"), "w").write(str(os.getpid()))
while name == "quick" and os.environ["PAIR"] and not os.path.exists(place + "/slow.started"):
    time.sleep(0.01)
running = [n for n in os.listdir(place) if n.endswith(".started")
           and not os.path.exists(os.path.join(place, n[:-8] + ".ended"))]
open(os.path.join(place, name + ".seen"), "w").write(str(len(running)))
print(json.dumps({"stage": "front", "fraction": 0.5, "text": name}), flush=True)
while name == "slow" and not os.path.exists(os.path.join(place, "quick.ended")):
    time.sleep(0.01)
if name == "endless":
    time.sleep(600)
open(os.path.join(place, name + ".ended"), "w").close()
if name == "bad":
    sys.exit("no reason to go on")
for file in ("result.npz", "report.json"):
    open(os.path.join(folder, file), "w").write("{}")
print(json.dumps({"done": True}), flush=True)
"""


@pytest.fixture
def make(tmp_path, monkeypatch):
    """Makes jobs with given names; their meeting place is ``tmp_path / "meeting"``."""
    monkeypatch.delenv("HYBRIDVOLUME_PYTHON", raising=False)
    (tmp_path / "meeting").mkdir()
    monkeypatch.setenv("MEETING", str(tmp_path / "meeting"))
    python = tmp_path / "python"
    python.write_text(f"#!{sys.executable}\n{WORKER}")
    python.chmod(python.stat().st_mode | stat.S_IXUSR)
    faces = torus().faces
    monkeypatch.setenv("PAIR", "")
    return lambda *names: [
        Job(faces, name=name, python=str(python), parent=tmp_path) for name in names
    ]


def test_ends_come_in_order_and_not_too_many_run(make, tmp_path, monkeypatch):
    monkeypatch.setenv("PAIR", "1")
    # the first can only end when the second has: they run at once
    jobs = make("slow", "quick", "bad", "last")
    told = []
    given = []
    for job in in_order(jobs, 2, lambda name, news: told.append((name, news.text))):
        given.append((job.name, job.state, job.report() if job.state == "done" else None))
    assert given == [
        ("slow", "done", {}),
        ("quick", "done", {}),
        ("bad", "failed", None),
        ("last", "done", {}),
    ]
    assert "no reason to go on" in jobs[2].error.line
    assert sorted(told) == sorted((job.name, job.name) for job in jobs)
    seen = [int(path.read_text()) for path in (tmp_path / "meeting").glob("*.seen")]
    assert len(seen) == 4 and max(seen) == 2
    assert not list(tmp_path.glob("hybridvolume-*"))


def test_closing_ends_what_runs(make, tmp_path):
    jobs = make("quick", "endless", "endless2")
    ended = in_order(jobs, 2)
    assert next(ended).name == "quick"
    started = tmp_path / "meeting" / "endless.started"
    while not started.exists():
        jobs[1].poll(wait=0.05)
    ended.close()
    assert jobs[1].state == "cancelled"
    with pytest.raises(ProcessLookupError):
        os.kill(int(started.read_text()), 0)
    assert not list(tmp_path.glob("hybridvolume-*"))


def test_a_job_that_cannot_start_fails_alone(make, tmp_path):
    jobs = make("first", "second")
    jobs[0].python = str(tmp_path / "absent")
    assert [job.state for job in in_order(jobs, 1)] == ["failed", "done"]
    assert "does not exist" in jobs[0].error.line or "no interpreter" in jobs[0].error.line


@pytest.mark.parametrize(
    ("free", "cores", "count"), [(3e9, 8, 1), (9e9, 8, 2), (1e12, 2, 2), (1e12, 64, 4)]
)
def test_as_many_as_there_is_room_for(monkeypatch, tmp_path, free, cores, count):
    told = tmp_path / "meminfo"
    told.write_text(f"MemTotal: 9 kB\nMemAvailable: {int(free / 1024)} kB\n", encoding="ascii")
    read = side_by_side._free_memory(told, tmp_path)
    assert abs(read - free) < 1024.0
    assert side_by_side._free_memory(tmp_path / "absent", tmp_path) == 0.0
    (tmp_path / "memory.current").write_text("1000000000\n")
    (tmp_path / "memory.max").write_text("2500000000\n")
    assert side_by_side._free_memory(told, tmp_path) == 1.5e9
    (tmp_path / "memory.max").write_text("max\n")
    assert side_by_side._free_memory(told, tmp_path) == read
    monkeypatch.setattr(side_by_side, "_free_memory", lambda: read)
    if hasattr(os, "sched_getaffinity"):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(cores)))
    else:
        monkeypatch.setattr(os, "cpu_count", lambda: cores)
    assert workers_at_once() == count
