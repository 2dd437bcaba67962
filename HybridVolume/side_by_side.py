# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Several jobs at once, as many as there are cores and memory for, with their ends in order.

This module needs the standard library only.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from HybridVolume.errors import HybridVolumeError
from HybridVolume.job import Job
from HybridVolume.protocol import Progress

MOST = 4
"""Workers at once on machines with many cores."""
MEMORY = 4e9
"""Bytes that must be free for each worker: a body of some thousand patches needs about half."""


def workers_at_once() -> int:
    """How many workers this machine has cores and free memory for, one at least."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(cores or 1, MOST, int(_free_memory() // MEMORY)))


def _free_memory(told: Path = Path("/proc/meminfo"), group: Path = Path("/sys/fs/cgroup")) -> float:
    """Bytes that processes can have; 0 where the system does not tell.

    Containers may have a limit of their own (control groups of the second version).
    """
    free = 0.0
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in told.read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                free = 1024.0 * int(line.split()[1])
    with contextlib.suppress(OSError, ValueError):
        # "max" where there is no limit
        limit = int((group / "memory.max").read_text(encoding="ascii"))
        free = min(free, limit - int((group / "memory.current").read_text(encoding="ascii")))
    return max(free, 0.0)


def in_order(
    jobs: Sequence[Job], count: int, progress: Callable[[str, Progress], None] | None = None
) -> Iterator[Job]:
    """Run jobs, some at once, and give each when it and all before it have ended.

    Parameters
    ----------
    jobs : sequence of Job
        New ones.
    count : int
        How many may run at the same time.
    progress : callable, optional
        Called with a job's name and what is new of it.

    Yields
    ------
    Job
        Done, or failed with its ``error``. Its folder goes away when the next one is asked for.
        Where the iterator is closed, everything that still runs is ended.
    """
    waiting, running = list(jobs), []
    try:
        for job in jobs:
            while job in waiting or job in running:
                while waiting and len(running) < count:
                    running.append(waiting.pop(0))
                    _start(running[-1])
                for other in running:
                    for news in other.poll(wait=0.1 / len(running)):
                        if progress:
                            progress(other.name, news)
                running = [other for other in running if other.state == "running"]
            yield job
            job.close()
    finally:
        for job in jobs:
            job.close()


def _start(job: Job) -> None:
    """Start a job; what prevents it becomes its error."""
    try:
        job.start()
    except HybridVolumeError as error:
        job.state, job.error = "failed", error
