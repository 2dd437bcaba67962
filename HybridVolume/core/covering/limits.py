# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Limits of the covering process: time, memory, and the life of who asked for it.

Time is the processor's, so that a body is not refused because the computer does other work; the
clock only ends what hangs.
"""

from __future__ import annotations

import logging
import os
import signal
import stat
import sys
import threading
from collections.abc import Callable

from ...errors import FaultError, HybridVolumeError, LimitError
from .effort import Effort
from .mesh_runs import kill_meshers, last_faces, running_meshers

logger = logging.getLogger(__name__)

SHARE = 0.8
"""Share of the computer's memory that the process and each of its meshers may have."""
LEAST = 2 * 1024**3
"""But no less than this, bytes."""


def limit_memory(most: float | None = None) -> float | None:
    """Let this process and its children have so much memory each.

    Parameters
    ----------
    most : float, optional
        Bytes of address space; most of the computer's memory by default.

    Returns
    -------
    float or None
        The limit, bytes; None where the system knows none.
    """
    try:
        import resource
    except ImportError:  # Windows
        return None
    try:
        if most is None:
            total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
            most = max(LEAST, SHARE * total)
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        for other in (soft, hard):
            if other != resource.RLIM_INFINITY:
                most = min(most, other)
        resource.setrlimit(resource.RLIMIT_AS, (int(most), hard))
    except (OSError, ValueError) as error:  # a system that does not let us
        logger.info("no limit of memory (%s)", error)
        return None
    return float(most)


def end_after(seconds: float, last_words: Callable[[], int]) -> threading.Event:
    """End this process and its meshers when the time is over, whatever it is doing.

    Parameters
    ----------
    seconds : float
        Of the processor, in this process and its meshers; what hangs ends, too.
    last_words : callable
        Called before the end; gives the exit code.

    Returns
    -------
    threading.Event
        Set, it takes the limit away.
    """
    effort, over = Effort(), threading.Event()

    def watch() -> None:
        while True:
            left = effort.left(seconds, running_meshers())
            if left <= 0.0:
                break
            # neither time runs faster than the clock
            if over.wait(max(left, 0.01)):
                return
        code = 1
        try:
            code = last_words()
        finally:
            kill_meshers()
            os._exit(code)

    threading.Thread(target=watch, daemon=True).start()
    return over


def end_with_input() -> None:
    """End this process and its meshers when its input, a pipe, is closed: who asked is gone."""
    try:
        if not stat.S_ISFIFO(os.fstat(sys.stdin.fileno()).st_mode):
            return
    except (OSError, ValueError, AttributeError):  # no input at all
        return

    def wait() -> None:
        while os.read(0, 4096):
            pass
        kill_meshers()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def too_long(seconds: float, where: str) -> LimitError:
    """What a body is told that takes too long, with the faces that a mesher had last."""
    return LimitError(
        f"covering the faces took longer than {seconds:.0f} s of the processor, or hung ({where})",
        faces=[f"Face{face + 1}" for face in last_faces()],
        figure=seconds,
        remedy="merge narrow faces and remove small ones in the CAD program, or allow a larger"
        " deviation",
    )


def too_large(most: float | None) -> LimitError:
    """What a body is told that needs too much memory."""
    amount = "" if most is None else f" than {most / 1024**3:.3g} GiB"
    return LimitError(
        f"covering the faces needs more memory{amount}",
        figure=most,
        remedy="merge narrow faces and remove small ones in the CAD program, or allow a larger"
        " deviation",
    )


def ended(code: int, log: str = "") -> HybridVolumeError:
    """What a body is told whose process ended without an answer.

    Parameters
    ----------
    code : int
        Of the process; negative: the signal that ended it.
    log : str
        What it said.

    Returns
    -------
    LimitError or FaultError
        A signal came from outside or from a library; anything else is a fault of ours.
    """
    if code < 0:
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        kills = {"SIGKILL": "too little memory, or killed from outside", "SIGSEGV": "a crash"}
        why = f"was ended by {name}" + (f" ({kills[name]})" if name in kills else "")
        return LimitError(
            f"the process that covers the faces {why}",
            remedy="simplify the body in the CAD program: merge narrow faces, remove small ones",
        )
    lines = [line for line in log.splitlines() if line.strip()]
    why = (lines or ["no reason"])[-1].strip()[:200]
    return FaultError(
        f"the process that covers the faces ended with code {code} ({why})",
        remedy="please report this body",
    )
