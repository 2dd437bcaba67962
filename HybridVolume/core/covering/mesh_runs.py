# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Meshers of faces in processes of their own: with a time limit, and no harm where they crash."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import MesherError
from ..tetmesh.door import interpreter
from .mesher import ANSWER, COMPLAINT, Answer, Request

logger = logging.getLogger(__name__)


def run_mesher(engine: str, request: Request, seconds: float) -> Answer:
    """Mesh faces in a process of its own.

    Parameters
    ----------
    engine : {"gmsh", "netgen"}
    request : Request
    seconds : float
        Time limit.

    Raises
    ------
    MesherError
        It crashes, does not end, has too little memory, complains, or its answer is damaged.
    """
    root = Path(__file__).resolve().parents[3]
    variables = dict(os.environ)
    path = [str(root), *(p for p in variables.get("PYTHONPATH", "").split(os.pathsep) if p)]
    variables["PYTHONPATH"] = os.pathsep.join(path)
    variables["PYTHONSAFEPATH"] = "1"
    with tempfile.TemporaryDirectory(prefix="hybridvolume-") as temporary:
        folder = Path(temporary)
        replace(request, brep=str(Path(request.brep).absolute())).write(folder)
        command = [interpreter(), "-m", f"{__package__}.mesher", str(folder), engine]
        with open(folder / "log.txt", "wb") as output:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=variables,
                cwd=folder,
            )
            try:
                code = process.wait(seconds)
            except subprocess.TimeoutExpired:
                raise MesherError(
                    f"{engine} gave no answer within {seconds:.0f} s", figure=seconds
                ) from None
            finally:
                if process.poll() is None:
                    process.kill()
                    process.wait()
        said = (folder / "log.txt").read_text(encoding="utf-8", errors="replace")
        logger.debug("%s said: %s", engine, said[-2000:])
        if not (folder / ANSWER).is_file():
            raise MesherError(_reason(engine, code, folder / COMPLAINT, said))
        try:
            answer = Answer.read(folder)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise MesherError(f"{engine} left a damaged answer ({error})") from error
    return _whole(engine, answer)


def _whole(engine: str, answer: Answer) -> Answer:
    """The answer, where its numbers are numbers and its indices exist."""
    count = len(answer.points)
    shapes = (
        answer.points.shape == (count, 3)
        and answer.elements.ndim == answer.rim.ndim == 2
        and answer.elements.shape == (len(answer.face), 4)
        and answer.rim.shape[1] == 4
    )
    if not shapes or not np.isfinite(answer.points).all():
        raise MesherError(f"{engine} gave coordinates that are no numbers, or incomplete arrays")
    corners = answer.elements
    if (
        np.any(corners[:, :3] < 0)
        or np.any(corners >= count)
        or np.any(corners[:, 3] < -1)
        or np.any(answer.rim[:, 2] >= count)
        or np.any(answer.rim < 0)
    ):
        raise MesherError(f"{engine} gave corners that do not exist")
    return answer


def _reason(engine: str, code: int, complaint: Path, said: str) -> str:
    if complaint.is_file():
        text = " ".join(complaint.read_text(encoding="utf-8").split())
        if text.startswith("MemoryError") or "bad_alloc" in text:
            return f"{engine} needs more memory than it may have"
        return f"{engine} failed ({text[:200]})"
    if code < 0:
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        return f"{engine} crashed ({name})"
    lines = [line for line in said.splitlines() if line.strip()]
    return f"{engine} ended with code {code} ({(lines or ['no message'])[-1].strip()[:200]})"
