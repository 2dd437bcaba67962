# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What FreeCAD's File menu calls for mesh files; ``Init.py`` names this module to FreeCAD.

Where there is a window, the user is asked for the scheme as soon as FreeCAD is idle. A macro that
was recorded meanwhile has FreeCAD's own line, which asks, and the line of the answer,
`HybridVolume.import_mesh`: played back, the answer withdraws the question.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import FreeCAD

FILTER = "HybridVolume quad mesh or cage (*.obj *.off *.ply)"
"""How FreeCAD's dialogs name these files; its own Mesh workbench reads them as triangles."""

_questions: list[Any] = []


def open(filename: str) -> None:
    """Import a mesh file into a new document.

    Parameters
    ----------
    filename : path
    """
    _import(filename, "")


def insert(filename: str, document: str) -> None:
    """Import a mesh file into a document.

    Parameters
    ----------
    filename : path
    document : str
        Its name; one that does not exist is made.
    """
    _import(filename, document)


def _import(filename: str, document: str) -> None:
    if FreeCAD.GuiUp:
        # The window is not needed, nor there, without one.
        from HybridVolume.gui.import_mesh import ask_soon

        ask_soon(filename, document)
        return
    from HybridVolume import scripting

    doc = FreeCAD.listDocuments().get(document)
    made = doc is None
    if made:
        # without a label FreeCAD 0.20 numbers it where there are other documents
        name = document or Path(filename).stem
        doc = FreeCAD.newDocument(name, name)
    try:
        scripting.import_mesh(filename, doc)
    except BaseException:
        if made:
            FreeCAD.closeDocument(doc.Name)
        raise


def asked(question: Any) -> None:
    """Remember a question.

    Parameters
    ----------
    question
        With the ``path`` that it is about and a method ``withdraw``.
    """
    _questions.append(question)


def answered(question: Any) -> None:
    """Forget a question."""
    if question in _questions:
        _questions.remove(question)


def withdraw(path: str | os.PathLike) -> None:
    """Take back the questions about a file that is being imported."""
    for question in [one for one in _questions if Path(one.path) == Path(path)]:
        answered(question)
        question.withdraw()
