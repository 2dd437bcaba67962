# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Meshers of faces in processes of their own: with a time limit, and no harm where they crash."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import MesherError
from ..tetmesh.door import interpreter
from .effort import Effort
from .mesher import ANSWERS, COMPLAINT, Answer, Request, one_by_one

logger = logging.getLogger(__name__)

FACE_SECONDS = 20.0
"""Longest time of a mesher for a face, where it meshes them one by one; of the processor."""
RESTARTS = 10
"""So often a mesher goes on behind a face that it cannot end."""

_running: set[subprocess.Popen] = set()
_asked: list[tuple[int, ...]] = []


def kill_meshers() -> None:
    """End all meshers that run for this process."""
    for process in tuple(_running):
        process.kill()


def running_meshers() -> tuple[int, ...]:
    """Numbers of the processes of meshers that run for this process."""
    return tuple(process.pid for process in tuple(_running))


def last_faces() -> tuple[int, ...]:
    """Faces that a mesher was asked for last."""
    return _asked[-1] if _asked else ()


def run_mesher(engine: str, request: Request, seconds: float) -> Answer:
    """Mesh faces in a process of its own.

    Parameters
    ----------
    engine : {"gmsh", "netgen"}
    request : Request
    seconds : float
        Most time of the processor, see :class:`.effort.Effort`.

    Raises
    ------
    MesherError
        It gives nothing: it crashes, does not end, has too little memory, complains, or its answer
        is damaged. A mesher that works face by face leaves out faces where it does so.
    """
    _asked[:] = [tuple(request.faces.tolist())]
    effort = Effort()
    left = request.faces
    answers: list[Answer] = []
    reasons: list[str] = []
    for _ in range(RESTARTS + 1):
        found, reason, complained = _run(
            engine, replace(request, faces=left), seconds - effort.seconds()
        )
        answers += [_whole(engine, answer) for answer in found]
        if not reason:
            left = left[:0]
            break
        reasons.append(reason)
        logger.info("%s", reason)
        if complained or not one_by_one(engine):
            break
        # the face behind the last one that it got over is the one it cannot do
        left = left[sum(len(answer.done) for answer in found) + 1 :]
        if not len(left) or effort.seconds() >= seconds:
            break
    if not any(len(answer.elements) for answer in answers):
        raise MesherError("; ".join(dict.fromkeys(reasons)) or f"{engine} meshes none of the faces")
    return Answer.joined(answers)


def _run(engine: str, request: Request, seconds: float) -> tuple[list[Answer], str, bool]:
    """What a mesher gives in a process, why no more (empty at a good end), if it says so itself."""
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
            _running.add(process)
            try:
                code = _wait(process, folder, seconds, one_by_one(engine))
            finally:
                if process.poll() is None:
                    process.kill()
                    process.wait()
                _running.discard(process)
        said = (folder / "log.txt").read_text(encoding="utf-8", errors="replace")
        logger.debug("%s said: %s", engine, said[-2000:])
        try:
            answers = [Answer.read(path) for path in sorted(folder.glob(ANSWERS))]
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
            return [], f"{engine} left a damaged answer ({error})", True
        if code is None:
            return answers, f"{engine} gave no answer in time", False
        if code == 0 and answers:
            return answers, "", False
        return answers, _reason(engine, code, folder / COMPLAINT, said), code >= 0


def _wait(process: subprocess.Popen, folder: Path, seconds: float, by_face: bool) -> int | None:
    """Exit code of a mesher; None where it does not end in time."""
    whole = face = Effort(process.pid)
    count = 0
    while True:
        left = whole.left(seconds)
        if by_face:
            new = sum(1 for _ in folder.glob(ANSWERS))
            if new > count:
                count, face = new, Effort(process.pid)
            left = min(left, face.left(FACE_SECONDS))
        try:
            return process.wait(min(0.25, max(left, 0.0)))
        except subprocess.TimeoutExpired:
            if left <= 0.0:
                return None


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
        if "MemoryError" in text.split(":")[0] or "bad_alloc" in text:
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
