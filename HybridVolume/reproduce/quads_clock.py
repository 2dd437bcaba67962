# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Seconds of the processor by stages, of this process and of everything that it has started."""

from __future__ import annotations

import os
from pathlib import Path

from .cases import processor_seconds

FIRST = "reading"
"""The stage before any is told."""
_PROC = Path("/proc")


class StageClock:
    """Adds up seconds of the processor by stages."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._stage = FIRST
        self._since = tree_seconds()

    def stage(self, name: str) -> None:
        """The next stage begins, or the same goes on."""
        if name != self._stage:
            now = tree_seconds()
            self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + now - self._since
            self._stage, self._since = name, now

    def end(self) -> dict[str, float]:
        """Seconds of all stages."""
        self.stage("")
        return dict(self._seconds)


def tree_seconds() -> float:
    """Seconds that this process, its children that are over and those that run have used.

    Where the system does not tell, running children count when they are over.
    """
    if not (_PROC / "self" / "stat").is_file():
        return processor_seconds()
    parent, spent = {}, {}
    for entry in _PROC.iterdir():
        if entry.name.isdigit():
            try:
                text = (entry / "stat").read_text(encoding="utf-8", errors="replace")
            except OSError:  # it is over
                continue
            # the name, in brackets, may have blanks
            words = text.rpartition(")")[2].split()
            parent[int(entry.name)] = int(words[1])
            spent[int(entry.name)] = sum(map(int, words[11:15]))
    total, reached = 0, {os.getpid()}
    waiting = list(reached)
    while waiting:
        one = waiting.pop()
        total += spent.get(one, 0)
        new = [child for child, its in parent.items() if its == one and child not in reached]
        reached.update(new)
        waiting += new
    return total / os.sysconf("SC_CLK_TCK")
