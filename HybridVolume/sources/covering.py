# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Solids of any faces covered with four-sided patches, within a tolerance.

Whole spheres and rings are taken out and seams cut away here, in FreeCAD; the rest is covered in
the worker's Python, in a process of its own that limits its time and memory.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import queue
import shutil
import tempfile
import time
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import errors
from ..core.covering.effort import PATIENCE
from ..core.covering.exchange import BREP, read_cover, read_error, write_body
from ..core.covering.kinds import BIT, EXACT, TOLERANCE, kinds_of_origins
from ..core.covering.limits import ended, too_long
from ..core.surface import SplineFace
from ..protocol import Progress, parse_line
from ..worker_process import WorkerProcess, tail, wait_for, worker_python
from .covered import Covered, allowed_deviation
from .distances import surface_distances
from .exact_geometry import curves_of, surfaces_of
from .faces import evaluate_face, random_parameters
from .fingerprint import fingerprint
from .imprint import imprint_seams
from .inner_walls import United, without_inner_walls
from .outlines import outline_of
from .slivers import Merged, without_slivers
from .spheres import Parted, without_whole_faces
from .untrimmed import take_faces

logger = logging.getLogger(__name__)

SECONDS = 240.0
"""Longest time of the processor that covering a solid may take."""

LATE = 1.2 * PATIENCE
"""The process limits its time itself; after so many times that, by the clock, it is ended here."""

MARGIN = 0.95
"""Deviations are measured at samples: so much of the tolerance is aimed at."""

STAGE = "covering"
"""Name of the stage in the progress."""

_MODULE = "HybridVolume.core.covering.exchange"
_LOG = "log"
_KEPT = 64


class Covering:
    """The covering of one solid, in a process of its own.

    ``start`` cuts the seams and launches the mesher's process, ``poll`` (from a timer) tells how
    far it is; ``run`` does both and waits. Covers and refusals are kept in memory: of a solid that
    was covered with the same tolerance before, ``start`` is the end already.

    Parameters
    ----------
    solid : Part.Solid
        With any faces: trimmed, with seams and poles.
    tolerance : float, optional
        Largest distance from the faces, mm; 1e-4 of the diagonal by default.
    free_only : bool
        Leave Gmsh out.
    python : str, optional
        Interpreter of the mesher's process; :func:`..worker_process.worker_python` otherwise.
    name : str
        Of the solid, for messages.

    Attributes
    ----------
    state : {"new", "running", "done", "failed", "cancelled"}
    error : HybridVolumeError or None
        Why it failed or ended.
    log : str
        The last lines that the mesher's process wrote.

    Raises
    ------
    InputError
        The tolerance is no length.
    """

    def __init__(
        self,
        solid: Any,
        tolerance: float | None = None,
        *,
        free_only: bool = False,
        python: str | None = None,
        name: str = "body",
    ) -> None:
        self.solid = solid
        self.tolerance = allowed_deviation(solid, tolerance)
        self.free_only = free_only
        self.name = name
        self.state = "new"
        self.error: errors.HybridVolumeError | None = None
        self.log = ""
        self._python = python
        self._result: Covered | None = None
        self._process: WorkerProcess | None = None
        self._folder: Path | None = None
        self._given = np.zeros(0, dtype=int)
        self._united: United | None = None
        self._merged: Merged | None = None
        self._kept = np.zeros(0, dtype=int)
        self._parted: Parted | None = None
        self._began = 0.0
        self._said = "preparing"
        self._key = _key(solid, self.tolerance, free_only)

    def start(self) -> None:
        """Cut the seams and launch the mesher's process; failures are kept, not raised."""
        if self.state != "new":
            raise RuntimeError(f"a covering that is {self.state} cannot be started")
        self.state = "running"
        known = _MEMORY.get(self._key)
        if known is not None:
            _MEMORY.move_to_end(self._key)
            self._end(known)
            return
        try:
            imprinted = self._prepare()
            if imprinted is not None:
                self._launch(imprinted)
        except errors.HybridVolumeError as error:
            self._end(error)
        except Exception as fault:
            self._end(_fault(fault))

    def poll(self, wait: float = 0.0) -> list[Progress]:
        """Return the progress since the last call; update ``state`` and ``error``.

        Parameters
        ----------
        wait : float
            Seconds to wait for the first line.
        """
        news: list[Progress] = []
        if self.state != "running":
            return news
        try:
            with contextlib.suppress(queue.Empty):
                while self.state == "running":
                    line = self._process.line(wait)
                    wait = 0.0
                    if line is None:
                        self._finish()
                    elif line.startswith("{"):
                        said = parse_line(line)
                        if isinstance(said, Progress):
                            news.append(replace(said, stage=STAGE))
                            self._said = said.text
            if self.state == "running" and self._process.gone:
                self._finish()
            if self.state == "running" and time.monotonic() - self._began > LATE * SECONDS:
                raise too_long(SECONDS, self._said)
        except errors.HybridVolumeError as error:
            self._end(error)
        except Exception as fault:  # also what FreeCAD raises: nobody expects it in a timer
            self._end(_fault(fault))
        return news

    def run(self, progress: Callable[[Progress], None] | None = None) -> Covered:
        """Start, wait, and return the result (blocking: for macros and scripts).

        Raises
        ------
        HybridVolumeError
            As :meth:`result`.
        """
        if self.state in ("new", "running"):
            wait_for(self, progress)
        return self.result()

    def cancel(self) -> None:
        """End the process and everything that it started."""
        if self.state in ("new", "running"):
            self.state = "cancelled"
            self.error = errors.WorkerError("the covering was cancelled")
            self._close()

    def result(self) -> Covered:
        """Return the cover.

        Raises
        ------
        InputError
            No cover was found; faces are named. A LimitError where time or memory ended it.
        FaultError
            Something went wrong that must not.
        SetupError
            There is no Python for the mesher.
        WorkerError
            It was cancelled.
        """
        if self.error is not None:
            raise self.error
        if self._result is None:
            raise RuntimeError(f"a covering that is {self.state} has no result")
        return self._result

    def _prepare(self) -> Any:
        """Leave out walls inside, whole spheres and rings, merge slivers, cut the seams.

        Returns
        -------
        Part.Solid or None
            What is left for the mesher, if anything.

        Raises
        ------
        InputError
            The walls cannot be left out, or the seams not be cut; faces of the given solid are
            named.
        """
        self._united = without_inner_walls(self.solid)
        self._merged = without_slivers(self._united.solid, self.tolerance)
        self._kept = self._united.numbers[self._merged.numbers]
        self._parted = without_whole_faces(self._merged.solid)
        self._given = self._kept[self._parted.numbers]
        if self._parted.rest is None:
            self._end(self._joined((), np.zeros(0, dtype=int), (), np.zeros(0), 0))
            return None
        try:
            imprinted = imprint_seams(self._parted.rest, self.tolerance)
        except errors.InputError as error:
            raise self._renamed(error) from error
        self._given = self._given[imprinted.origin]
        whole = self._whole_patches(imprinted.solid)
        if whole is not None:
            self._end(whole)
            return None
        return imprinted.solid

    def _whole_patches(self, cut: Any) -> Covered | None:
        """The cover of a solid that needed nothing but its seams cut; None of any other."""
        try:
            readings = take_faces(cut)
        except errors.InputError:
            return None
        faces = [reading.face for reading in readings]
        kinds = [EXACT if reading.domain is None else BIT for reading in readings]
        count = len(faces)
        return self._joined(faces, np.arange(count), kinds, np.zeros(count), count)

    def _launch(self, cut: Any) -> None:
        """Describe a solid without seams and start the process that covers it.

        Raises
        ------
        InputError
            It cannot be described; faces of the given solid are named.
        SetupError
            There is no Python for the process.
        WorkerError
            It cannot be made.
        """
        self._python = worker_python(self._python)
        try:
            outline = outline_of(cut)
            geometry = curves_of(cut), surfaces_of(cut)
        except errors.InputError as error:
            raise self._renamed(error) from error
        self._folder = Path(tempfile.mkdtemp(prefix="hybridvolume-"))
        cut.exportBrep(str(self._folder / BREP))
        task = {"tolerance": MARGIN * self.tolerance, "seconds": SECONDS}
        write_body(self._folder, outline, *geometry, task)
        try:
            self._process = WorkerProcess(
                self._python,
                _MODULE,
                self._folder,
                self._folder / _LOG,
                free_only=self.free_only,
            )
        except OSError as fault:
            raise errors.WorkerError(
                f"the mesher did not start: {fault}", remedy="check Preferences"
            ) from fault
        self._began = time.monotonic()

    def _finish(self) -> None:
        """Turn the end of the process into a result or a refusal."""
        code = self._process.code
        if code == 0:
            try:
                found = read_cover(self._folder)
            except (OSError, ValueError, LookupError, zipfile.BadZipFile) as fault:
                raise errors.WorkerError(
                    f"the cover cannot be read ({type(fault).__name__}: {fault})",
                    remedy="try again",
                ) from fault
            self._end(
                self._joined(found.faces, found.origin, found.kinds, found.deviation, found.quads)
            )
        elif code is None:
            raise self._process.death()
        else:
            told = read_error(self._folder) if code in (1, 2) else None
            self._end(self._renamed(told) if told else ended(code, tail(self._folder / _LOG)))

    def _end(self, found: Covered | errors.HybridVolumeError) -> None:
        if isinstance(found, Covered):
            self.state, self._result = "done", found
        else:
            self.state, self.error = "failed", found
        # what is the body's own fault stays so; a Python that was absent may be there tomorrow
        if isinstance(found, Covered | errors.InputError | errors.FaultError):
            _MEMORY[self._key] = found
            while len(_MEMORY) > _KEPT:
                _MEMORY.popitem(last=False)
        self._close()

    def _close(self) -> None:
        """End the process and remove its folder."""
        if self._process is not None:
            self._process.stop(gently=self.state == "done")
            self._process = None
        if self._folder is not None:
            self.log = tail(self._folder / _LOG)
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def _renamed(self, error: errors.HybridVolumeError) -> errors.HybridVolumeError:
        """An error about pieces of faces as one about the faces of the given solid."""
        numbers = [face.split(".")[0].removeprefix("Face") for face in error.faces]
        pieces = [int(number) - 1 for number in numbers if number.isdigit()]
        return type(error)(
            error.message,
            faces=[f"Face{self._given[k] + 1}" for k in pieces if k < len(self._given)],
            figure=error.figure,
            remedy=error.remedy,
        )

    def _joined(
        self,
        faces: Sequence[SplineFace],
        piece: np.ndarray,
        kinds: Sequence[str],
        deviation: np.ndarray,
        quads: int,
    ) -> Covered:
        """The cover of the given solid.

        Parameters
        ----------
        faces : sequence of SplineFace
            On the pieces of its faces, whole spheres and rings not among them.
        piece : (n,) int array
            Which piece each is on.
        kinds : sequence of str
        deviation : (m,) array
            Of the pieces.
        quads : int
        """
        closed, whole = self._parted, self._kept[self._parted.origin]
        given = np.concatenate([self._given, whole])
        origin = np.concatenate([self._given[piece], whole])
        given_faces = self.solid.Faces
        count = len(given_faces)
        worst = np.zeros(count)
        np.maximum.at(worst, self._given, deviation)
        for patch, number in zip(closed.patches, whole.tolist(), strict=True):
            points = evaluate_face(patch, *random_parameters(number))
            off = surface_distances(given_faces[number], points)
            worst[number] = max(worst[number], float(off.max()))
        old = self._united.numbers
        for face, off in self._merged.moved.items():
            worst[old[face]] = max(worst[old[face]], off)
        merged = {int(old[face]): int(old[into]) for face, into in self._merged.into.items()}
        inside = (*self._united.inside, *sorted(merged))
        bare = np.setdiff1d(np.arange(count), np.concatenate([origin, np.array(inside, int)]))
        if len(bare) or not np.all(np.isfinite(worst)) or worst.max() > self.tolerance:
            raise errors.FaultError(
                f"the cover is {worst.max():.2g} mm away, or leaves {len(bare)} faces out",
                faces=[f"Face{k + 1}" for k in bare.tolist()],
                remedy="please report this body",
            )
        named = [
            replace(face, name=f"Face{number + 1}")
            for face, number in zip([*faces, *closed.patches], origin.tolist(), strict=True)
        ]
        # of what is left out nothing is changed, as nothing is left
        moved = old[sorted(self._merged.moved)]
        given = np.concatenate([given, np.array(inside, dtype=int), moved])
        of_pieces = [*kinds, *closed.kinds, *(len(inside) * [BIT]), *(len(moved) * [TOLERANCE])]
        return Covered(
            tuple(named),
            origin,
            worst,
            quads,
            kinds_of_origins(of_pieces, given),
            self.tolerance,
            inside,
            merged,
        )


def _fault(fault: Exception) -> errors.FaultError:
    """What nobody expected, in words; the whole of it goes to the log."""
    logger.error("covering failed", exc_info=fault)
    return errors.FaultError(
        f"covering failed: {type(fault).__name__}: {fault}".replace("\n", " "),
        remedy="please report this body",
    )


_MEMORY: OrderedDict[tuple, Covered | errors.HybridVolumeError] = OrderedDict()
"""What was covered or refused lately."""


def forget_limits() -> None:
    """Forget bodies that were refused because of a limit: they are covered anew when read next.

    Within one reading they are remembered, or a window that covers first and reads then would wait
    for the covering again.
    """
    for key in [key for key, found in _MEMORY.items() if isinstance(found, errors.LimitError)]:
        del _MEMORY[key]


def is_known(solid: Any, tolerance: float | None = None, *, free_only: bool = False) -> bool:
    """Whether the cover of a solid, or why there is none, is in memory.

    Parameters
    ----------
    solid, tolerance, free_only
        As for :class:`Covering`.
    """
    return _key(solid, allowed_deviation(solid, tolerance), free_only) in _MEMORY


def _key(solid: Any, tolerance: float, free_only: bool) -> tuple:
    """What a cover depends on."""
    # where the edges end is not in the fingerprint, and covers follow them
    corners = np.array([tuple(vertex.Point) for vertex in solid.Vertexes])
    digest = hashlib.sha256(corners.tobytes()).hexdigest()
    return fingerprint(solid), digest, float(tolerance), bool(free_only)


def cover_solid(
    solid: Any,
    tolerance: float | None = None,
    *,
    free_only: bool = False,
    python: str | None = None,
    name: str = "body",
    progress: Callable[[Progress], None] | None = None,
) -> Covered:
    """Cover a solid with four-sided patches, and wait for it.

    Parameters
    ----------
    solid, tolerance, free_only, python, name
        As for :class:`Covering`.
    progress : callable, optional
        Called with a :class:`..protocol.Progress` now and then.

    Raises
    ------
    HybridVolumeError
        As :meth:`Covering.result`.
    """
    covering = Covering(solid, tolerance, free_only=free_only, python=python, name=name)
    return covering.run(progress)
