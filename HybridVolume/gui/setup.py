# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The first use: the worker's environment is made in a process that can be watched and ended."""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import threading

from HybridVolume import environment
from HybridVolume.errors import SetupError

QUESTION = (
    "HybridVolume computes in a Python environment of its own, which {state}.\n\n"
    "Make it now? Up to {download} MB are fetched from the Python Package Index and "
    "{installed} MB of disk are used, in\n{folder}"
)


def question() -> str:
    """Return what a user is asked before anything is fetched."""
    exists = environment.interpreter().is_file()
    return QUESTION.format(
        state="is not complete or belongs to another version" if exists else "does not exist yet",
        download=environment.DOWNLOAD_MB,
        installed=environment.INSTALLED_MB,
        folder=environment.default_folder(),
    )


class EnvironmentSetup:
    """Makes the environment beside FreeCAD's window; ``poll`` from a timer.

    Parameters
    ----------
    free_only : bool
        Leave the GPL parts out.

    Attributes
    ----------
    running : bool
    error : SetupError or None
    """

    def __init__(self, free_only: bool = False) -> None:
        self.running = False
        self.error: SetupError | None = None
        self._free_only = free_only
        self._process: subprocess.Popen | None = None
        self._lines: queue.Queue[str] = queue.Queue()
        self._last = ""

    def start(self) -> None:
        """Launch the set-up; return at once.

        Raises
        ------
        SetupError
            No Python is found that could make an environment.
        """
        variables = {k: v for k, v in os.environ.items() if k != "PYTHONHOME"}
        if "APPDIR" in variables:
            variables.pop("LD_LIBRARY_PATH", None)
        variables["PYTHONPATH"] = str(environment.PROJECT)
        command = [environment.base_interpreter(), "-m", "HybridVolume.environment"]
        if self._free_only:
            command.append("--free-only")
        hidden = {} if os.name == "posix" else {"creationflags": subprocess.CREATE_NO_WINDOW}
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env=variables,
            **hidden,
        )
        self.running = True
        threading.Thread(target=self._read_lines, daemon=True).start()

    def _read_lines(self) -> None:
        with contextlib.suppress(ValueError, OSError):
            for line in self._process.stderr:
                self._lines.put(line.rstrip())

    def poll(self) -> list[str]:
        """Return the lines since the last call; update ``running`` and ``error``."""
        ended = self._process is not None and self._process.poll() is not None
        news = []
        with contextlib.suppress(queue.Empty):
            while True:
                news.append(self._lines.get_nowait().removeprefix("set-up: "))
        self._last = next((line for line in reversed(news) if line), self._last)
        if ended and self.running:
            self.running = False
            if self._process.returncode:
                reason = self._last or f"exit code {self._process.returncode}"
                self.error = SetupError(
                    f"the environment was not made: {reason}",
                    remedy="check the network and the disk, or name an interpreter in "
                    "Preferences > HybridVolume",
                )
        return news

    def cancel(self) -> None:
        """End the set-up; what it leaves is replaced by the next one."""
        if self.running:
            self._process.terminate()
            try:
                self._process.wait(5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self.running = False
