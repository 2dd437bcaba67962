# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What both panels do before a job: the environment, and the faces of the body."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import Any

from PySide import QtCore, QtGui

from HybridVolume import environment, sources
from HybridVolume.job import worker_python
from HybridVolume.objects.volume import source_fingerprint

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


def read_bodies(source: Any) -> tuple[str, list[sources.Body]]:
    """Read the solids of a document object, behind a waiting cursor.

    Returns
    -------
    fingerprint : str
        Of the object when it was read.
    bodies : list of Body
        Those that are refused carry their error.

    Raises
    ------
    InputError
        The object has no solid.
    """
    red_places.clear()
    with waiting():
        return source_fingerprint(source), list(sources.read_object(source))


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
