# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""STEP and BREP files to bodies.

OCC takes damaged files in good faith: it hangs on a truncated BREP, crashes on a STEP with broken
points, and leaves out what it cannot translate. So the file is looked at first, read on trial in a
process of its own where the system can fork, and what comes back is compared with what the file
announces.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import re
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .. import errors
from .shapes import Body, read_shape

logger = logging.getLogger(__name__)

STEP_SUFFIXES = (".step", ".stp")
BREP_SUFFIXES = (".brep", ".brp")

TRIAL_SECONDS = 600.0
"""Longest time that reading a file may take."""

_REPAIR = "export the file again"
_ANNOUNCED = re.compile(
    rb"#\d+\s*=\s*\(?[^;'#]*?\b(?:MANIFOLD_SOLID_BREP|FACETED_BREP|BREP_WITH_VOIDS)\s*\("
)


def read_file(path: str | os.PathLike, **keywords: Any) -> list[Body]:
    """Bodies of a STEP or BREP file.

    Parameters
    ----------
    path : path
        ``.step``, ``.stp``, ``.brep`` or ``.brp``, in any case.
    **keywords
        As for :func:`.shapes.read_shape`: ``cover``, ``tolerance``, ``free_only``, ``python``,
        ``progress``.

    Returns
    -------
    list of Body
        One a solid, named after the file. Refused bodies carry their error; at least one is not
        refused.

    Raises
    ------
    InputError
        One of its kinds: the file cannot be read, holds no solid, or every body is refused.
    """
    path = Path(path)
    return read_shape(read_any_shape(path), path.stem, **keywords)


def read_any_shape(path: str | os.PathLike) -> Any:
    """Everything in a STEP or BREP file as one Part.Shape, solids or not.

    Parameters
    ----------
    path : path

    Raises
    ------
    InputError
        The file cannot be read, or holds nothing.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    content = _content(path, suffix)
    if suffix in STEP_SUFFIXES:
        _check_step(path.name, content)
        announced = len(_ANNOUNCED.findall(content))
    else:
        _check_brep(path.name, content)
        announced = 0
    binary = suffix in BREP_SUFFIXES and b"Open CASCADE Topology" in content[:200]
    del content
    _read_on_trial(path, suffix, binary)
    shape = _read(path, suffix, binary)
    if shape.isNull():
        raise errors.InputError(f"{path.name} holds no shape", remedy=_REPAIR)
    if announced and not shape.Faces:
        raise errors.InputError(
            f"{path.name} announces solids ({announced}), but no face could be read",
            figure=0.0,
            remedy=_REPAIR,
        )
    if 0 < len(shape.Solids) < announced:
        raise errors.InputError(
            f"{path.name} announces {announced} solids, only {len(shape.Solids)} could be read",
            figure=float(len(shape.Solids)),
            remedy=_REPAIR,
        )
    return shape


def _content(path: Path, suffix: str) -> bytes:
    if not path.exists():
        raise errors.InputError(f"{path} does not exist", remedy="check the path")
    if path.is_dir():
        raise errors.InputError(f"{path} is a folder", remedy="give a STEP or BREP file")
    if suffix not in STEP_SUFFIXES + BREP_SUFFIXES:
        raise errors.InputError(
            f"{path.name} is neither STEP nor BREP ({suffix or 'no suffix'})",
            remedy="give a .step, .stp, .brep or .brp file, or a mesh of quads as .obj, .off or"
            " .ply",
        )
    if not path.is_file():
        raise errors.InputError(f"{path} is no regular file", remedy="give a STEP or BREP file")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise errors.InputError(
            f"{path} cannot be read ({error.strerror})", remedy="check its permissions"
        ) from error
    if not content.strip():
        raise errors.InputError(f"{path.name} is empty", figure=0.0, remedy=_REPAIR)
    return content


def _check_step(name: str, content: bytes) -> None:
    if b"ISO-10303-21" not in content[:4096]:
        raise errors.InputError(
            f"{name} is no STEP file: the header ISO-10303-21 is missing",
            remedy="give a STEP file (ISO 10303-21)",
        )
    if b"END-ISO-10303-21" not in content[-4096:]:
        raise errors.InputError(
            f"{name} is truncated: the end mark END-ISO-10303-21 is missing"
            f" after {len(content)} bytes",
            figure=float(len(content)),
            remedy="copy or export the file again",
        )


def _check_brep(name: str, content: bytes) -> None:
    head = content[:400]
    if b"CASCADE Topology" not in head:
        raise errors.InputError(
            f"{name} is no BREP file: the header CASCADE Topology is missing",
            remedy="give a BREP file of OpenCASCADE",
        )
    if b"Open CASCADE Topology" in head:
        return
    # the last line of a text BREP is its root shape, behind the star that ends the last record
    if not re.search(rb"\*\s*[+-]\d+ \d+\s*$", content[-200:]):
        raise errors.InputError(
            f"{name} is truncated: the root shape is missing after {len(content)} bytes",
            figure=float(len(content)),
            remedy="copy or export the file again",
        )


def _read(path: Path, suffix: str, binary: bool) -> Any:
    import FreeCAD  # noqa: F401  Part needs it loaded
    import Part

    shape = Part.Shape()
    with quiet_kernel():
        try:
            if binary:
                shape.importBinary(str(path))
            elif suffix in BREP_SUFFIXES:
                shape.importBrep(str(path))
            else:
                shape.read(str(path))
        except (Part.OCCError, OSError, RuntimeError, ValueError) as error:
            logger.debug("%s", error)
            raise errors.InputError(
                f"{path.name} cannot be read as {'BREP' if suffix in BREP_SUFFIXES else 'STEP'}",
                remedy=_REPAIR,
            ) from error
    return shape


def _read_on_trial(path: Path, suffix: str, binary: bool) -> None:
    """Read the file in a forked process first: a crash or a hang must not take us along.

    Not in FreeCAD's window, where other threads run, and not where the system cannot fork.
    """
    import FreeCAD

    if not hasattr(os, "fork") or FreeCAD.GuiUp:
        return
    sys.stdout.flush()
    sys.stderr.flush()
    with warnings.catch_warnings():
        # threads of numpy make Python warn; the child only reads and leaves
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        code = 4
        try:
            _read(path, suffix, binary)
            code = 0
        except errors.InputError:
            # the parent meets the same refusal and words it
            code = 0
        finally:
            os._exit(code)
    end = time.monotonic() + TRIAL_SECONDS
    pause = 0.001
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            break
        if time.monotonic() > end:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            raise errors.InputError(
                f"{path.name} could not be read within {TRIAL_SECONDS:.0f} s",
                figure=TRIAL_SECONDS,
                remedy=_REPAIR,
            )
        time.sleep(pause)
        pause = min(2.0 * pause, 0.05)
    if status:
        raise errors.InputError(
            f"{path.name} is damaged: OpenCASCADE crashes on it", remedy=_REPAIR
        )


@contextlib.contextmanager
def quiet_kernel() -> Iterator[None]:
    """Send what OCC prints to the log (level debug) instead of the screen."""
    library = _c_library()
    sys.stdout.flush()
    sys.stderr.flush()
    try:
        saved = [os.dup(1), os.dup(2)]
    except OSError:
        # a window without console has no standard streams
        yield
        return
    with tempfile.TemporaryFile() as sink:
        try:
            if library is not None:
                library.fflush(None)
            os.dup2(sink.fileno(), 1)
            os.dup2(sink.fileno(), 2)
            yield
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            if library is not None:
                library.fflush(None)
            os.dup2(saved[0], 1)
            os.dup2(saved[1], 2)
            for stream in saved:
                os.close(stream)
            sink.seek(0)
            said = sink.read().decode("utf-8", "replace").strip()
            if said:
                logger.debug("OpenCASCADE says: %s", said[:2000])


def _c_library() -> Any:
    """The C library whose streams OCC prints to, to flush them."""
    try:
        return ctypes.CDLL(None) if os.name == "posix" else ctypes.CDLL("ucrtbase")
    except OSError:
        return None
