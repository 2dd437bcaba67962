# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What the commands have in common that make tables of cases, each in a process of its own."""

from __future__ import annotations

import argparse
import hashlib
import json
import logging
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from HybridVolume.errors import FaultError, HybridVolumeError, InputError, WorkerError
from HybridVolume.job import Job
from HybridVolume.worker import Channel, die_with_parent
from HybridVolume.worker_process import THREADS

from .midstructure import PROJECT

if TYPE_CHECKING:
    from HybridVolume.completion import Screen

logger = logging.getLogger(__name__)


BESIDES = "STEP and BREP files, or folders of them, besides the example"
"""What ``--data`` takes as a rule."""


class Named(Protocol):
    """A case: its name, and the part of the tables that it belongs to."""

    @property
    def name(self) -> str:
        """Of its file."""

    @property
    def part(self) -> str:
        """Of the tables."""


C = TypeVar("C", bound=Named)


class CaseJob(Job):
    """A job whose process writes its cases itself, to the folder of cases."""

    def answers(self) -> list[str]:
        """Nothing besides the cases."""
        return []


def add_case_arguments(
    parser: argparse.ArgumentParser,
    time_limit: float,
    what: str,
    *,
    data: str = "",
    parts: Iterable[str] = (),
    example: str = "names of cases",
    small: str = "",
) -> None:
    """Declare which cases are done, and how.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    time_limit : float
        Seconds by default.
    what : str
        What has them: "case", "body".
    data : str
        What the files of ``--data`` are; none are taken otherwise.
    parts : iterable of str
        Parts that ``--only`` takes; there is no such choice otherwise.
    example : str
        What it takes besides.
    small : str
        What ``--small`` makes, where there is such a version.
    """
    if data:
        parser.add_argument("--data", nargs="+", metavar="FILE|DIR", help=data)
    parts = list(parts)
    if parts:
        parser.add_argument(
            "--only",
            nargs="+",
            metavar="PART|NAME",
            help=f"{', '.join(parts)}, or {example}; the others are left out",
        )
    if small:
        parser.add_argument("--small", action="store_true", help=small)
    parser.add_argument(
        "--gather", action="store_true", help="do nothing new: tables of what is finished"
    )
    parser.add_argument("--again", action="store_true", help="do finished cases again")
    parser.add_argument(
        "--time-limit",
        type=float,
        default=time_limit,
        metavar="S",
        help=f"seconds for a {what} ({time_limit:g})",
    )


def chosen_cases(cases: Sequence[C], only: Sequence[str] | None, parts: Iterable[str]) -> list[C]:
    """Cases that are asked for.

    Parameters
    ----------
    cases : sequence
        All that there are.
    only : sequence of str, optional
        Names of cases and of parts.
    parts : iterable of str

    Raises
    ------
    InputError
        A word is no part and no case; with all that there are.
    """
    if not only:
        return list(cases)
    names, parts = {case.name for case in cases}, list(parts)
    unknown = [word for word in only if word not in parts and word not in names]
    if unknown:
        raise InputError(
            f"{', '.join(unknown)}: no such part or case",
            remedy=f"parts are {', '.join(parts)}, cases {', '.join(sorted(names))}",
        )
    return [case for case in cases if {case.part, case.name} & set(only)]


def one_thread_each() -> None:
    """Let every process use one thread: seconds of cases side by side are then their own."""
    for name in THREADS:
        os.environ.setdefault(name, "1")


def digest_of(files: Iterable[Path]) -> str:
    """Return what tells one version of some files from another, whatever their order here.

    Parameters
    ----------
    files : iterable of Path
    """
    digest = hashlib.sha256()
    for path in sorted(set(files)):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def told_figures(
    found: Mapping[str, Any], text: str, file: Path, screen: Screen, parts: Iterable[str]
) -> int:
    """Write the tables and tell what came of them; return the exit code.

    Parameters
    ----------
    found : mapping
        With ``demands``, ``seconds``, ``not_done``, and the cases of each part.
    text : str
        The tables.
    file : Path
        Where they are written.
    screen : Screen
    parts : iterable of str
        Keys of the cases.

    Returns
    -------
    int
        0 when every demand that could be asked is met and every case was made, else 1.
    """
    file.write_text(text, encoding="utf-8")
    screen.line(text)
    unmet = [row for row in found["demands"] if row["met"] is False]
    screen.line(
        f"{file}: {len(unmet)} of {len(found['demands'])} demands not met"
        f" ({found['seconds']:.0f} s)"
    )
    failed = [case["name"] for part in parts for case in found[part] if case["error"]]
    if failed:
        screen.line(f"cases with an error: {', '.join(failed)}")
    return 1 if unmet or failed or found["not_done"] else 0


def drawn_elsewhere(module: str, folder: Path, python: str, time_limit: float) -> list[str]:
    """Names of the pictures that a module draws in a folder, in another Python.

    Parameters
    ----------
    module : str
        Run with the folder; its last line is the list of names as JSON.
    folder : Path
    python : str
        The worker's interpreter, whose libraries are known.
    time_limit : float
        Seconds.

    Raises
    ------
    WorkerError
        It failed.
    """
    command = [python, "-m", module, str(folder.resolve())]
    try:
        done = subprocess.run(
            command, cwd=PROJECT, stdin=subprocess.DEVNULL, capture_output=True, text=True,
            check=False, timeout=time_limit,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise WorkerError(f"no pictures within {time_limit:g} s") from None
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no reason"])[-1]
        raise WorkerError(f"the pictures ended with code {done.returncode}: {last}")
    return list(json.loads(done.stdout.splitlines()[-1]))


def told(fault: Exception) -> HybridVolumeError:
    """A fault of ours is a row as well: one case must not hide the others."""
    if isinstance(fault, HybridVolumeError):
        return fault
    logger.exception("a fault")
    where = traceback.extract_tb(fault.__traceback__)[-1]
    text = f"{type(fault).__name__} in {Path(where.filename).name}:{where.lineno}: {fault}"
    return FaultError(text.replace("\n", " "))


def processor_seconds() -> float:
    """Seconds of the processor that this process and its finished children have used."""
    try:
        import resource
    except ImportError:  # Windows
        return time.process_time()
    usage = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in usage)


def case_main(work: Callable[[Path, Channel], None], arguments: list[str] | None = None) -> int:
    """Run the work of a case's process; return the exit code.

    Parameters
    ----------
    work : callable
        Takes the job's folder and the channel to the process that waits.
    arguments : list of str, optional
        The folder, by default as the command line names it.
    """
    (folder,) = sys.argv[1:] if arguments is None else arguments
    channel = Channel()
    die_with_parent()
    logging.basicConfig(level=logging.INFO, format="%(relativeCreated)7d %(name)s: %(message)s")
    try:
        work(Path(folder), channel)
    except Exception as fault:
        channel.send(error=told(fault).to_dict())
        return 1
    channel.send(done=True)
    return 0
