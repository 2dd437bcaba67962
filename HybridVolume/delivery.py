# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Files that appear in a folder all together, or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import tempfile
from pathlib import Path

from HybridVolume.errors import InputError

_HINT = "name another folder with -o"


class OutputFolder:
    """A folder to be, written beside its place and moved there at the end.

    Used as a context manager: entering finds out whether the folder can be written at all; leaving
    without :meth:`deliver` removes everything that was made, folders included.

    Parameters
    ----------
    path : path
        It may exist, and then keeps its other files.

    Attributes
    ----------
    path : Path
    files : Path
        Where to write the files.
    scratch : Path
        Where to write what is not delivered.
    """

    def __init__(self, path: str | os.PathLike) -> None:
        self.path = Path(path).absolute()
        self._made: list[Path] = []
        self._work: Path | None = None

    def __enter__(self) -> OutputFolder:
        try:
            self._open()
        except OSError as fault:
            self._clear()
            raise InputError(
                f"the output folder {self.path} cannot be written: {fault.strerror or fault}",
                remedy=_HINT,
            ) from fault
        except BaseException:
            self._clear()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._clear()

    def _open(self) -> None:
        if self.path.exists() and not self.path.is_dir():
            raise InputError(f"{self.path} is no folder", remedy=_HINT)
        for parent in reversed(self.path.parents):
            if not parent.exists():
                parent.mkdir()
                self._made.append(parent)
        place = self.path if self.path.exists() else self.path.parent
        self._work = Path(tempfile.mkdtemp(prefix=".hybridvolume-", dir=place))
        self.files = self._work / "files"
        self.files.mkdir()
        self.scratch = self._work / "scratch"
        self.scratch.mkdir()

    def deliver(self) -> list[str]:
        """Move the files to their place; existing ones of these names are replaced.

        Returns
        -------
        list of str
            Their names.

        Raises
        ------
        InputError
            A file cannot be moved; all is as it was before.
        """
        names = sorted(entry.name for entry in self.files.iterdir())
        try:
            if self.path.exists():
                self._exchange(names)
            else:
                os.rename(self.files, self.path)
        except OSError as fault:
            raise InputError(
                f"{fault.filename2 or fault.filename} cannot be written: {fault.strerror}",
                remedy=_HINT,
            ) from fault
        self._made.clear()
        return names

    def _exchange(self, names: list[str]) -> None:
        old = self._work / "old"
        old.mkdir()
        moved: list[str] = []
        try:
            for name in names:
                if (self.path / name).is_dir():
                    raise IsADirectoryError(errno.EISDIR, "it is a folder", str(self.path / name))
                if os.path.lexists(self.path / name):
                    os.rename(self.path / name, old / name)
                moved.append(name)
                os.rename(self.files / name, self.path / name)
        except BaseException:
            for name in moved:
                with contextlib.suppress(OSError):
                    os.rename(self.path / name, self.files / name)
            for entry in old.iterdir():
                with contextlib.suppress(OSError):
                    os.rename(entry, self.path / entry.name)
            raise

    def _clear(self) -> None:
        if self._work:
            shutil.rmtree(self._work, ignore_errors=True)
            self._work = None
        for folder in reversed(self._made):
            with contextlib.suppress(OSError):
                folder.rmdir()
        self._made.clear()
