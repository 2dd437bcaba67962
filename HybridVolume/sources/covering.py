# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Solids of any faces covered with four-sided patches, within a tolerance.

Seams are cut away here, in FreeCAD; the mesher runs in the worker's Python, in a process of its
own with a time limit, and is asked again with other sizes where it crashes.
"""

from __future__ import annotations

import json
import logging
import subprocess
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import errors
from ..core.covering.cover import Cover
from ..core.covering.exchange import BREP, ERROR, read_cover, write_body
from ..core.covering.kinds import kinds_of_origins
from ..core.surface import SplineFace
from ..worker_process import tail, worker_python, worker_variables
from .exact_geometry import curves_of, surfaces_of
from .imprint import imprint_seams
from .outlines import outline_of

logger = logging.getLogger(__name__)

TOLERANCE = 1e-4
"""Largest distance of patches from the faces, as a share of the diagonal, if none is given."""

SECONDS = 240.0
"""Longest time of one attempt."""

ATTEMPTS = (
    {"turn": 60.0, "share": 5.0},
    {"turn": 45.0, "share": 8.0},
    {"turn": 30.0, "share": 12.0},
)
"""Sizes of the first quads: the largest turn of an edge in an interval, degrees, and how often an
interval goes into the diagonal. The next is tried where the mesher crashes or does not end."""


@dataclass(frozen=True)
class Covered:
    """Patches of a solid.

    Attributes
    ----------
    faces : tuple of SplineFace
        Named after the solid's faces: ``Face3.1``, ``Face3.2``, ...
    origin : (n,) int array
        Face of the solid that each patch is on, from 0.
    deviation : (nf,) array
        Largest distance of the patches from each face of the solid, mm, at samples.
    quads : int
        Quads that the patches were joined from.
    kinds : tuple of str
        ``bit``, ``exact`` or ``tolerance`` for each face of the solid, see
        :mod:`..core.covering.kinds`.
    """

    faces: tuple[SplineFace, ...]
    origin: np.ndarray
    deviation: np.ndarray
    quads: int
    kinds: tuple[str, ...]


def cover_solid(solid: Any, tolerance: float | None = None) -> Covered:
    """Cover a solid with four-sided patches.

    Parameters
    ----------
    solid : Part.Solid
        With any faces: trimmed, with seams and poles.
    tolerance : float, optional
        Largest distance from the faces, mm; 1e-4 of the diagonal by default.

    Raises
    ------
    InputError
        No cover was found; faces are named.
    SetupError
        There is no Python for the mesher.
    """
    imprinted = imprint_seams(solid)
    names = [f"Face{k + 1}" for k in imprinted.origin.tolist()]
    try:
        outline = outline_of(imprinted.solid)
        geometry = curves_of(imprinted.solid), surfaces_of(imprinted.solid)
    except errors.InputError as error:
        raise _renamed(error, names) from error
    allowed = TOLERANCE * solid.BoundBox.DiagonalLength if tolerance is None else float(tolerance)
    python = worker_python()
    words = []
    for attempt in ATTEMPTS:
        with tempfile.TemporaryDirectory(prefix="hybridvolume-") as name:
            folder = Path(name)
            imprinted.solid.exportBrep(str(folder / BREP))
            write_body(folder, outline, *geometry, {"tolerance": allowed, **attempt})
            state = _run(python, folder)
            if state == 0:
                return _on_given_faces(read_cover(folder), imprinted.origin)
            if state == 2:
                told = json.loads((folder / ERROR).read_text())
                raise _renamed(errors.InputError(**told), names)
            words.append(f"{'time limit' if state is None else f'code {state}'}")
            logger.warning("covering failed (%s); other sizes are tried", words[-1])
    raise errors.InputError(
        f"the mesher of the faces fails ({', '.join(words)})",
        remedy="simplify the body in the CAD program: merge narrow faces, remove small ones",
    )


def _run(python: str, folder: Path) -> int | None:
    """Exit code of the mesher's process; None where it did not end in time."""
    command = [python, "-m", "HybridVolume.core.covering.exchange", str(folder)]
    with open(folder / "log", "wb") as log:
        try:
            code = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=worker_variables(folder),
                timeout=SECONDS,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            return None
    if code not in (0, 2):
        logger.debug("%s", tail(folder / "log"))
    return code


def _renamed(error: errors.InputError, names: list[str]) -> errors.InputError:
    """An error about pieces of faces as one about the faces of the given solid."""
    faces = [names[int(face.split(".")[0][4:]) - 1] for face in error.faces]
    return errors.InputError(
        error.message,
        faces=list(dict.fromkeys(faces)),
        figure=error.figure,
        remedy=error.remedy,
    )


def _on_given_faces(cover: Cover, given: np.ndarray) -> Covered:
    """The cover of the cut solid as one of the solid before seams were cut."""
    own = given[cover.origin]
    worst = np.zeros(int(given.max()) + 1)
    np.maximum.at(worst, given, cover.deviation)
    count: dict[int, int] = {}
    named = []
    for face, number in zip(cover.faces, own.tolist(), strict=True):
        count[number] = count.get(number, 0) + 1
        named.append(replace(face, name=f"Face{number + 1}.{count[number]}"))
    kinds = kinds_of_origins(cover.kinds, given)
    return Covered(tuple(named), own, worst, cover.quads, kinds)
