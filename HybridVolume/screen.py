# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What the command line shows while it works."""

from __future__ import annotations

import shutil
import sys

from HybridVolume.protocol import Progress


class Screen:
    """Progress on standard output: one line that changes on a terminal, plain lines elsewhere."""

    def __init__(self) -> None:
        self._terminal = sys.stdout.isatty()
        self._open = False
        # of each body, as several may be worked on side by side
        self._last: dict[str, str] = {}

    def progress(self, name: str, news: Progress) -> None:
        """Show how far a body is."""
        text = f"{news.stage}: {news.text}" if news.text else news.stage
        if self._terminal:
            width = shutil.get_terminal_size().columns - 1
            line = f"{name} [{100 * news.fraction:3.0f} %] {text}"[:width]
            sys.stdout.write(f"\r\x1b[K{line}")
            sys.stdout.flush()
            self._open = True
        elif text != self._last.get(name):
            self._last[name] = text
            print(f"{name} [{100 * news.fraction:3.0f} %] {text}", flush=True)

    def line(self, text: str) -> None:
        """Write a line that stays."""
        self.clear()
        print(text, flush=True)

    def clear(self) -> None:
        """Take the changing line away."""
        if self._open:
            sys.stdout.write("\r\x1b[K")
            sys.stdout.flush()
            self._open = False
