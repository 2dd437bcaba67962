# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The set-up: what is pinned, how an environment is made, completed and recovered, and run.sh."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from HybridVolume import environment
from HybridVolume.errors import SetupError

PROJECT = Path(__file__).resolve().parent.parent
PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"

posix_only = pytest.mark.skipif(os.name != "posix", reason="run.sh is for POSIX systems")


def make_wheel(folder: Path, name: str, version: str, source: str) -> None:
    """Write a pure Python wheel with one module, by hand (PEP 427)."""
    info = f"{name}-{version}.dist-info"
    files = {
        f"{name}.py": source,
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = f"{info}/RECORD"
    with zipfile.ZipFile(folder / f"{name}-{version}-py3-none-any.whl", "w") as wheel:
        for path, text in files.items():
            wheel.writestr(path, text)
        wheel.writestr(record, "".join(f"{path},,\n" for path in [*files, record]))


@pytest.fixture
def index(tmp_path, monkeypatch):
    """A requirements file and a folder of wheels in place of the real ones; no network."""
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    make_wheel(wheels, "alpha", "1.0", "VERSION = '1.0'\n")
    make_wheel(wheels, "alpha", "2.0", "VERSION = '2.0'\n")
    make_wheel(wheels, "beta", "1.0", "")
    make_wheel(wheels, "broken", "1.0", "import a_library_that_is_not_there\n")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", wheels.as_uri())
    monkeypatch.setattr(environment, "REQUIREMENTS", tmp_path / "requirements.txt")
    monkeypatch.setitem(environment.MODULES, "broken", "broken")

    def write(*lines: str) -> None:
        environment.REQUIREMENTS.write_text("# [required]\n" + "\n".join(lines) + "\n")

    return write


def installed_version(python: Path) -> str:
    command = [str(python), "-c", "import alpha; print(alpha.VERSION)"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_every_requirement_is_pinned_and_gpl_parts_can_be_left_out():
    everything = environment.requirements(development=True)
    assert all(re.fullmatch(r"[\w-]+==[\w.]+( ;.*)?", line) for line in everything)
    names = {line.split("==")[0] for line in everything}
    assert len(names) == len(everything)
    free = {line.split("==")[0] for line in environment.requirements(gpl=False, development=True)}
    assert names - free == {"cgal", "gmsh"}
    run = {line.split("==")[0] for line in environment.requirements()}
    assert {"pytest", "ruff"} <= names - run
    assert {"numpy", "scipy", "netgen-mesher", "pytetwild"} <= run & free


def test_every_checked_module_is_a_requirement():
    names = {line.split("==")[0] for line in environment.requirements(development=True)}
    assert set(environment.MODULES) <= names


def test_the_environment_is_made_completed_and_left_alone(index, tmp_path):
    folder = tmp_path / "a folder with spaces" / "environment"
    said = []
    index("alpha==1.0  # why")
    assert environment.missing(folder) == ("alpha==1.0",)
    python = environment.install(folder, report=said.append)
    assert installed_version(python) == "1.0"
    assert json.loads((folder / environment.STAMP).read_text()) == {
        "python": PYTHON,
        "requirements": ["alpha==1.0"],
    }

    steps = len(said)
    assert environment.install(folder, report=said.append) == python
    assert len(said) == steps  # ready: nothing done, nothing said

    keep = folder / "kept"
    keep.touch()
    index("alpha==2.0", "beta==1.0")
    assert environment.missing(folder) == ("alpha==2.0", "beta==1.0")
    environment.install(folder, report=said.append)
    assert installed_version(python) == "2.0"
    assert keep.exists()  # completed in place
    assert not environment.missing(folder)

    # A wheel that does not load is told, and what is left does not look ready.
    index("alpha==2.0", "beta==1.0", "broken==1.0")
    with pytest.raises(SetupError, match="broken .*a_library_that_is_not_there"):
        environment.install(folder)
    assert len(environment.missing(folder)) == 3

    # An unfinished environment is made anew, and a wheel that cannot be had is told.
    (python.parent / "python").unlink()
    index("alpha==2.0")
    environment.install(folder, report=said.append)
    assert installed_version(python) == "2.0"
    assert not keep.exists()
    index("alpha==3.0")
    with pytest.raises(SetupError, match="alpha==3.0.*check the network"):
        environment.install(folder)
    assert environment.missing(folder) == ("alpha==3.0",)


def fake_environment(folder: Path, python: str, lines: list[str]) -> None:
    """Lay out what a finished environment has to show, around the running interpreter."""
    environment.interpreter(folder).parent.mkdir(parents=True)
    environment.interpreter(folder).symlink_to(sys.executable)
    stamp = {"python": python, "requirements": lines}
    (folder / environment.STAMP).write_text(json.dumps(stamp))


@posix_only
def test_an_environment_of_another_python_is_not_ready(index, tmp_path):
    index("alpha==1.0")
    fake_environment(tmp_path / "same", PYTHON, ["alpha==1.0"])
    fake_environment(tmp_path / "other", "3.0", ["alpha==1.0"])
    assert environment.missing(tmp_path / "same") == ()
    assert environment.missing(tmp_path / "other") == ("alpha==1.0",)
    (tmp_path / "same" / environment.STAMP).write_text("half a")
    assert environment.missing(tmp_path / "same") == ("alpha==1.0",)


def test_a_folder_of_something_else_is_not_touched(index, tmp_path):
    folder = tmp_path / "environment"
    folder.mkdir()
    (folder / "thesis.tex").write_text("years of work")
    index("alpha==1.0")
    with pytest.raises(SetupError, match="no Python environment"):
        environment.install(folder)
    assert [path.name for path in folder.iterdir()] == ["thesis.tex"]


@posix_only
def test_a_second_set_up_waits_for_the_first(index, tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")
    folder = tmp_path / "environment"
    index("alpha==1.0")
    said = []

    def finish_the_first(text: str) -> None:
        said.append(text)
        fake_environment(folder, PYTHON, ["alpha==1.0"])
        first.close()

    with open(tmp_path / ".environment.lock", "a+b") as first:
        fcntl.flock(first, fcntl.LOCK_EX)
        environment.install(folder, report=finish_the_first)
    assert said == ["waiting for another set-up that is under way"]  # and nothing else to do


def test_an_unusable_base_python_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("HYBRIDVOLUME_BASE_PYTHON", str(tmp_path / "python"))
    with pytest.raises(SetupError, match=re.escape(str(tmp_path / "python"))):
        environment.base_interpreter()


@pytest.fixture
def project(tmp_path):
    """A copy of what run.sh needs, with a command line that tells what it got."""
    copy = tmp_path / "the project's folder"
    (copy / "HybridVolume").mkdir(parents=True)
    shutil.copytree(PROJECT / "scripts", copy / "scripts")
    shutil.copy(PROJECT / "run.sh", copy)
    (copy / "HybridVolume" / "__init__.py").touch()
    (copy / "HybridVolume" / "__main__.py").write_text(
        "import json, os, sys\n"
        "names = ('HYBRIDVOLUME_PYTHON', 'HYBRIDVOLUME_FREE_ONLY', 'PYTHONPATH')\n"
        "told = [os.getcwd(), sys.argv[1:], *map(os.environ.get, names), sys.executable]\n"
        "print(json.dumps(told))\n"
        "sys.exit(7)\n"
    )
    return copy


@posix_only
def test_run_sh_hands_everything_on(project, tmp_path):
    elsewhere = tmp_path / "some where"
    elsewhere.mkdir()
    (elsewhere / "json.py").write_text("raise RuntimeError('a module of the caller')\n")
    (tmp_path / "link").symlink_to(project / "run.sh")
    answer = subprocess.run(
        ["bash", str(tmp_path / "link"), "my part.step", "--free-only", "--w0", "0.4"],
        cwd=elsewhere,
        env={**os.environ, "HYBRIDVOLUME_PYTHON": sys.executable, "PYTHONHOME": ""},
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
    )
    assert answer.returncode == 7, answer.stderr
    assert json.loads(answer.stdout) == [
        str(elsewhere),
        ["my part.step", "--w0", "0.4"],
        sys.executable,
        "1",
        str(project),
        "/usr/bin/python3",
    ]


@pytest.mark.parametrize(
    ("said", "wrong"),
    [
        ("mfem 4.10.0.1 requires numba, which is not installed.", ""),
        ("mfem 4.10.0.1 requires numpy, which is not installed.", "mfem"),
        (
            "mfem 4.10.0.1 requires numba, which is not installed.\\n"
            "pyvista 0.49 has requirement vtk<9, but you have vtk 9.7.2.",
            "pyvista",
        ),
    ],
)
def test_what_a_wheel_declares_without_need_is_no_fault(said, wrong):
    command = [sys.executable, "-c", f"print('{said}'); raise SystemExit(1)"]
    if not wrong:
        environment._check_fit(command)
        return
    with pytest.raises(SetupError, match=wrong) as refused:
        environment._check_fit(command)
    assert "numba" not in str(refused.value)
