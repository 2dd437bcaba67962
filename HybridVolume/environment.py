# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The worker's environment: a venv that holds the pinned wheels of ``requirements.txt``.

``run.sh`` and ``test.sh`` call this module with the distribution's Python; the workbench calls it
in a process when a user starts the first computation. Both get the same environment. It needs the
standard library only, and installs nothing outside the environment's folder.

``python -m HybridVolume.environment [--free-only] [--development]`` makes or completes the
environment, says on stderr what it does, a line each, and prints the environment's interpreter on
stdout. Killed half way, it leaves something that the next call replaces.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from HybridVolume.errors import SetupError

PROJECT = Path(__file__).resolve().parent.parent
REQUIREMENTS = PROJECT / "requirements.txt"
OLDEST_PYTHON = (3, 11)
STAMP = "hybridvolume.json"

# What a user is told before the first installation, and what the disk must have room for.
DOWNLOAD_MB = 340
INSTALLED_MB = 1300

# What wheels declare and do not need for what we call: mfem reads and integrates without numba,
# which fits few versions of numpy and Python.
NEEDLESS = (("mfem", "numba"),)

# Imported once after an installation, by the name of the wheel: a wheel that came but cannot be
# loaded (a system library is missing) must be noticed at the set-up, not in the middle of the work.
MODULES = {
    "numpy": "numpy",
    "scipy": "scipy.spatial",
    "netgen-mesher": "netgen.meshing",
    "pytetwild": "pytetwild",
    "scikit-fem": "skfem",
    "pyamg": "pyamg",
    "pyvista": "pyvista",
    "matplotlib": "matplotlib.figure",
    "cgal": "CGAL.CGAL_Triangulation_3",
    "gmsh": "gmsh",
    "pytest": "pytest",
}

Report = Callable[[str], None]


def free_only() -> bool:
    """Whether the GPL parts are left out (``HYBRIDVOLUME_FREE_ONLY`` set, and not to 0)."""
    return os.environ.get("HYBRIDVOLUME_FREE_ONLY", "") not in ("", "0")


def default_folder() -> Path:
    """Return the folder of the environment.

    That is ``HYBRIDVOLUME_ENVIRONMENT`` where it is set, else ``environment`` in the project
    folder, else (the project folder is not ours to write) a folder among the user's data.
    """
    named = os.environ.get("HYBRIDVOLUME_ENVIRONMENT")
    if named:
        return Path(named).expanduser().absolute()
    inside = PROJECT / "environment"
    if inside.is_dir() or os.access(PROJECT, os.W_OK):
        return inside
    data = os.environ.get("LOCALAPPDATA" if os.name == "nt" else "XDG_DATA_HOME")
    return Path(data or Path.home() / ".local" / "share") / "HybridVolume" / "environment"


def interpreter(folder: Path | None = None) -> Path:
    """Return the path of the environment's Python, whether it exists or not."""
    folder = folder or default_folder()
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def requirements(*, gpl: bool = True, development: bool = False) -> tuple[str, ...]:
    """Return the pinned lines of ``requirements.txt`` without their comments, in its order.

    Parameters
    ----------
    gpl : bool
        Take the section of GPL parts too.
    development : bool
        Take the section of what only the tests need too.
    """
    left_out = {name for name, taken in (("gpl", gpl), ("development", development)) if not taken}
    section = ""
    lines = []
    for text in REQUIREMENTS.read_text(encoding="utf-8").splitlines():
        if heading := re.fullmatch(r"#\s*\[(.+)\]\s*", text):
            section = heading[1]
        line = text.split("#", 1)[0].strip()
        if line and section not in left_out:
            lines.append(line)
    return tuple(lines)


def missing(
    folder: Path | None = None, *, gpl: bool = True, development: bool = False
) -> tuple[str, ...]:
    """Return the requirements that the environment does not hold; empty when it is ready.

    An environment that does not run, was never finished, or belongs to another Python than the
    one it was made with (the distribution was upgraded), holds nothing.
    """
    folder = folder or default_folder()
    wanted = requirements(gpl=gpl, development=development)
    stamp = _read_stamp(folder)
    if stamp is None or _version_of(interpreter(folder)) != stamp["python"]:
        return wanted
    return tuple(line for line in wanted if line not in stamp["requirements"])


def install(
    folder: Path | None = None,
    *,
    gpl: bool = True,
    development: bool = False,
    report: Report = lambda text: None,
) -> Path:
    """Make or complete the environment; do nothing where it is ready.

    Calls from several processes wait for each other. An environment that was left half made is
    removed and made anew.

    Parameters
    ----------
    folder : Path, optional
        Where; :func:`default_folder` otherwise.
    gpl, development : bool
        As in :func:`requirements`.
    report : callable
        Gets one line of text a step.

    Returns
    -------
    Path
        The environment's Python.

    Raises
    ------
    SetupError
        No usable Python, no network, no room, or a wheel that does not load.
    """
    folder = folder or default_folder()
    if not missing(folder, gpl=gpl, development=development):
        return interpreter(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with _locked(folder.parent / f".{folder.name}.lock", report) as lock:
            absent = missing(folder, gpl=gpl, development=development)
            if absent:
                _complete(folder, absent, lock, report)
    except OSError as fault:
        raise SetupError(
            f"the environment {folder} cannot be written: {fault}",
            remedy="set HYBRIDVOLUME_ENVIRONMENT to a folder of yours",
        ) from fault
    return interpreter(folder)


def base_interpreter() -> str:
    """Return the Python that environments are made with.

    The running one where it is an interpreter and not FreeCAD itself, else the one of FreeCAD's
    installation, else the system's. ``HYBRIDVOLUME_BASE_PYTHON`` names another.

    Raises
    ------
    SetupError
        None of them is new enough and has ``venv`` and ``ensurepip``.
    """
    named = os.environ.get("HYBRIDVOLUME_BASE_PYTHON")
    executable = "python.exe" if os.name == "nt" else "bin/python3"
    candidates = [named] if named else []
    if not named:
        if Path(sys.executable or "").stem.startswith("python"):
            candidates.append(sys.executable)
        candidates += [str(Path(sys.base_prefix) / executable), "/usr/bin/python3"]
        candidates.append(shutil.which("python3") or "")
    # An AppImage is mounted elsewhere at every start: a venv made with its Python dies with it.
    mount = os.environ.get("APPDIR")
    found = []
    for candidate in dict.fromkeys(filter(None, candidates)):
        if mount and candidate.startswith(mount):
            continue
        version = _version_of(candidate, modules=("venv", "ensurepip"))
        if version and tuple(map(int, version.split("."))) >= OLDEST_PYTHON:
            return candidate
        found.append(f"{candidate} ({version or 'no venv and ensurepip'})")
    oldest = ".".join(map(str, OLDEST_PYTHON))
    raise SetupError(
        f"no Python {oldest} or newer with venv and ensurepip, only {', '.join(found) or 'none'}",
        remedy="install python3 and python3-venv, or name one with HYBRIDVOLUME_BASE_PYTHON",
    )


def _complete(folder: Path, absent: Sequence[str], lock: int, report: Report) -> None:
    """Install the absent requirements into the environment; the caller holds the lock."""
    stamp = _read_stamp(folder)
    python = interpreter(folder)
    amount = ""
    if stamp is None or _version_of(python) != stamp["python"]:
        _require_room(folder.parent)
        if folder.exists():
            if not (folder / "pyvenv.cfg").is_file() and any(folder.iterdir()):
                raise SetupError(
                    f"{folder} exists and is no Python environment",
                    remedy="move it away, or name another with HYBRIDVOLUME_ENVIRONMENT",
                )
            report(f"removing the unfinished or outdated environment {folder}")
            shutil.rmtree(folder)
        base = base_interpreter()
        report(f"making the environment {folder} with {base}")
        _run([base, "-I", "-m", "venv", str(folder)], lock, "the environment was not made")
        stamp = {"python": _version_of(python), "requirements": []}
        amount = f", about {DOWNLOAD_MB} MB"
    (folder / STAMP).unlink(missing_ok=True)
    report(f"installing {len(absent)} wheels{amount}")
    _install_wheels(python, absent, lock, report)
    report("checking that the wheels load")
    _check(python, absent, report)
    names = {_name(line) for line in absent}
    kept = [line for line in stamp["requirements"] if _name(line) not in names]
    stamp["requirements"] = [*kept, *absent]
    _write_stamp(folder, stamp)
    report("the environment is ready")


def _install_wheels(python: Path, lines: Sequence[str], lock: int, report: Report) -> None:
    pip = [str(python), "-I", "-m", "pip", "--disable-pip-version-check", "--no-input"]
    with tempfile.TemporaryDirectory(prefix="hybridvolume-") as scratch:
        listed = Path(scratch) / "requirements.txt"
        listed.write_text("\n".join(lines) + "\n", encoding="utf-8")
        command = [*pip, "install", "--no-deps", "--only-binary=:all:", "--progress-bar=off"]

        def show(text: str) -> None:
            # pip's own lines name every wheel and its size; the large ones tell how far it is.
            if fetched := re.match(r"\s*(Downloading|Using cached) (\S+) \((\d+)\S* MB\)", text):
                wheel = Path(fetched[2]).name.split("-")
                if int(fetched[3]) >= 10:
                    report(f"{fetched[1].lower()} {wheel[0]} {wheel[1]} ({fetched[3]} MB)")
            elif text.startswith("Installing collected packages"):
                report("unpacking the wheels")

        _run(
            [*command, "-r", str(listed)],
            lock,
            "the wheels could not be installed",
            remedy="check the network and run it again",
            each_line=show,
        )
    _check_fit([*pip, "check"])


def _check_fit(command: Sequence[str]) -> None:
    """Let pip say whether the wheels fit each other, but for what is declared without need."""
    answer = subprocess.run(
        list(command), capture_output=True, text=True, env=_variables(), stdin=subprocess.DEVNULL
    )
    needless = [rf"{name} \S+ requires {other}, which is not installed" for name, other in NEEDLESS]
    wrong = [
        line
        for line in answer.stdout.splitlines()
        if not any(re.match(pattern, line) for pattern in needless)
    ]
    if answer.returncode and (wrong or not answer.stdout.strip()):
        last = " ".join(wrong[:5]) or answer.stderr.strip()[-500:]
        raise SetupError(f"the pinned wheels do not fit each other: {last}")


def _check(python: Path, lines: Sequence[str], report: Report) -> None:
    """Import what was installed, each in a process of its own: a crash must name its wheel."""
    optional = {_name(line) for line in requirements()} - {
        _name(line) for line in requirements(gpl=False)
    }
    for name in map(_name, lines):
        if name not in MODULES:
            continue
        code = (
            "import importlib.metadata as m, sys\n"
            f"try: m.version({name!r})\n"
            "except m.PackageNotFoundError: sys.exit(0)\n"
            f"import {MODULES[name]}"
        )
        command = [str(python), "-I", "-c", code]
        answer = subprocess.run(
            command, capture_output=True, text=True, env=_variables(), stdin=subprocess.DEVNULL
        )
        if answer.returncode == 0:
            continue
        reason = (answer.stderr.strip().splitlines() or [f"exit code {answer.returncode}"])[-1]
        if name not in optional:
            raise SetupError(
                f"{name} was installed but does not load: {reason}",
                remedy="install the system library that is named there and run it again",
            )
        report(f"{name} does not load and will not be used: {reason}")


def _run(
    command: Sequence[str],
    lock: int,
    message: str,
    *,
    remedy: str = "",
    each_line: Report = lambda text: None,
) -> None:
    """Run a command; raise :class:`SetupError` with its last lines when it fails.

    The child inherits the lock, so that where only this process is killed, the next set-up waits
    until the child has ended as well.
    """
    last: list[str] = []
    child = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        env=_variables(),
        pass_fds=(lock,) if os.name == "posix" else (),
    )
    try:
        for text in child.stdout:
            each_line(text.rstrip())
            last = [*last[-4:], text.strip()]
        code = child.wait()
    finally:
        if child.poll() is None:
            child.terminate()
            child.wait()
    if code:
        errors = [text for text in last if text.startswith("ERROR")] or last
        raise SetupError(f"{message}: {' '.join(errors) or f'exit code {code}'}", remedy=remedy)


def _variables() -> dict[str, str]:
    """Return the process's variables without those that make another Python find our modules."""
    variables = {key: value for key, value in os.environ.items() if key != "PYTHONHOME"}
    if "APPDIR" in variables:
        variables.pop("LD_LIBRARY_PATH", None)
    return variables


def _version_of(python: str | Path, modules: Sequence[str] = ()) -> str:
    """Return ``"3.11"`` or the like; empty where it does not run or lacks one of the modules."""
    imports = "".join(f"import {module}\n" for module in modules)
    code = f"{imports}import sys; print('%d.%d' % sys.version_info[:2])"
    try:
        answer = subprocess.run(
            [str(python), "-I", "-c", code],
            capture_output=True,
            text=True,
            env=_variables(),
            stdin=subprocess.DEVNULL,
            timeout=60,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return answer.stdout.strip() if answer.returncode == 0 else ""


def _name(line: str) -> str:
    """Return the name of the wheel in a pinned line."""
    return line.split("==", 1)[0].strip()


def _require_room(folder: Path) -> None:
    free = shutil.disk_usage(folder).free / 1e6
    needed = INSTALLED_MB + DOWNLOAD_MB
    if free < needed:
        raise SetupError(
            f"{folder} has {free:.0f} MB free, the environment needs {needed} MB",
            remedy="free some space, or name another folder with HYBRIDVOLUME_ENVIRONMENT",
        )


def _read_stamp(folder: Path) -> dict | None:
    try:
        stamp = json.loads((folder / STAMP).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    good = isinstance(stamp, dict) and isinstance(stamp.get("requirements"), list)
    return stamp if good and isinstance(stamp.get("python"), str) else None


def _write_stamp(folder: Path, stamp: dict) -> None:
    unfinished = folder / f"{STAMP}.new"
    unfinished.write_text(json.dumps(stamp, indent=1) + "\n", encoding="utf-8")
    unfinished.replace(folder / STAMP)


@contextlib.contextmanager
def _locked(path: Path, report: Report) -> Iterator[int]:
    """Hold the lock file; wait, and say so, while another process has it."""
    with open(path, "a+b") as file:
        if os.name == "posix":
            import fcntl

            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                report("waiting for another set-up that is under way")
                fcntl.flock(file, fcntl.LOCK_EX)
        else:
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)
        yield file.fileno()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the set-up as a command; see the module's text."""
    parser = argparse.ArgumentParser(prog="python -m HybridVolume.environment")
    parser.add_argument("--folder", type=Path, help="where (default: environment/)")
    parser.add_argument("--free-only", action="store_true", help="leave out the GPL parts")
    parser.add_argument("--development", action="store_true", help="add what the tests need")
    options = parser.parse_args(arguments)
    # A terminated set-up must take pip along, which SystemExit does and the default action not.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        python = install(
            options.folder,
            gpl=not (options.free_only or free_only()),
            development=options.development,
            report=lambda text: print(f"set-up: {text}", file=sys.stderr, flush=True),
        )
    except SetupError as fault:
        print(f"set-up: {fault.line}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    print(python)
    return 0


if __name__ == "__main__":
    sys.exit(main())
