# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How long work has taken, whatever else the computer does meanwhile."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

PATIENCE = 10.0
"""By the clock, work may take so many times as long as by the processor."""
IDLE = 30.0
"""By the clock, work may take so many seconds without the processor,"""
SHARE = 0.05
"""and then as long as it gets this share of one: what gets less waits for something, for ever."""


def processor_seconds(pids: Sequence[int] = ()) -> float | None:
    """Processor time of this process, of its children that have ended, and of some that run.

    Parameters
    ----------
    pids : sequence of int
        Children that run. Where the system has no ``/proc`` they count when they have ended.

    Returns
    -------
    float or None
        s; None on systems that do not tell the time of children.
    """
    if os.name != "posix":
        return None
    times = os.times()
    running = sum(child_seconds(pid) or 0.0 for pid in pids)
    return times.user + times.system + times.children_user + times.children_system + running


def child_seconds(pid: int) -> float | None:
    """Processor time of one running process, s; None where it is not told."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
        # the name of the program, in brackets, may hold anything
        user, system = text.rpartition(")")[2].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, AttributeError):
        return None


class Effort:
    """Time that work has taken since this was made.

    It is the processor's time, of this process or of one child, and where several threads run at
    once, or that time is not known, the clock's.

    Parameters
    ----------
    pid : int, optional
        The child; this process and its children otherwise.
    """

    def __init__(self, pid: int | None = None) -> None:
        self._pid = pid
        self._clock = time.monotonic()
        self._processor = self._now(())

    def _now(self, running: Sequence[int]) -> float | None:
        return processor_seconds(running) if self._pid is None else child_seconds(self._pid)

    def seconds(self, running: Sequence[int] = ()) -> float:
        """What it has taken so far, s.

        Parameters
        ----------
        running : sequence of int
            Children that run.
        """
        clock = time.monotonic() - self._clock
        now = self._now(running)
        if now is None or self._processor is None:
            return clock
        return min(clock, now - self._processor)

    def left(self, seconds: float, running: Sequence[int] = ()) -> float:
        """Seconds of the clock for which the work may go on at least; none where it hangs.

        Parameters
        ----------
        seconds : float
            That the work may take.
        running : sequence of int
            Children that run.
        """
        clock = time.monotonic() - self._clock
        spent = self.seconds(running)
        patience = min(PATIENCE * seconds, IDLE + spent / SHARE)
        return min(seconds - spent, patience - clock)
