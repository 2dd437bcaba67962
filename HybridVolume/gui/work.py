# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What the panels do before a job: the environment, and the faces of the body."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import Any

from PySide import QtCore, QtGui

from HybridVolume import environment, sources
from HybridVolume.job import worker_python
from HybridVolume.sources import global_shape
from HybridVolume.sources.untrimmed import COVERED

from . import messages, preferences, red_places
from .setup import EnvironmentSetup, question

NO_ENVIRONMENT = "Not started: there is no environment to compute in"


def environment_setup() -> EnvironmentSetup | None | bool:
    """What makes the environment first; None where it is there, False where it is declined.

    Raises
    ------
    SetupError
        An interpreter is named that cannot be used.
    """
    chosen = preferences.load()
    if os.environ.get("HYBRIDVOLUME_PYTHON") or chosen.python:
        worker_python(chosen.python)
        return None
    if not environment.missing(gpl=not chosen.free_only):
        return None
    if messages.ask("Set-up", question()):
        return EnvironmentSetup(chosen.free_only)
    # What is there may do, though it is not what this version asks for.
    return None if environment.interpreter().is_file() else False


def reading() -> dict[str, Any]:
    """Keywords of `sources.read_object` by the preferences."""
    chosen = preferences.load()
    return {"python": chosen.python or None, "free_only": chosen.free_only}


def coverings(source: Any, tolerance: float) -> list[sources.Covering]:
    """What has to be done before the bodies of a document object can be read at once.

    Parameters
    ----------
    source : App.DocumentObject
    tolerance : float
        ``CoverTolerance`` of the hybrid volume, mm; 0: automatic.

    Raises
    ------
    InputError
        The tolerance is no length.
    """
    if is_deleted(source):
        return []  # reading tells it
    with waiting():
        return sources.coverings(source, tolerance=tolerance or None, **reading())


def count_solids(source: Any) -> int:
    """Number of the solids of a document object, refused ones among them.

    Raises
    ------
    InputError
        There is none, or none that can be taken, whatever its faces are covered with.
    """
    red_places.clear()
    with waiting():
        try:
            return len(sources.read_object(source, cover=False))
        except COVERED:
            return max(len(global_shape(source).Solids), 1)


@contextlib.contextmanager
def waiting() -> Iterator[None]:
    """Show a waiting cursor meanwhile."""
    QtGui.QApplication.setOverrideCursor(QtCore.Qt.WaitCursor)
    try:
        yield
    finally:
        QtGui.QApplication.restoreOverrideCursor()


def is_deleted(obj: Any) -> bool:
    """Whether a document object is gone, or its document."""
    try:
        doc, name = obj.Document, obj.Name
    except (ReferenceError, RuntimeError):
        return True
    return doc is None or not name or doc.getObject(name) is None
