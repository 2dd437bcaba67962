# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Panels' forms from resources/ui, and icons."""

from __future__ import annotations

from typing import Any

import FreeCADGui
from PySide import QtCore

from HybridVolume.errors import FaultError

from .preferences import RESOURCES


def load_form(name: str) -> Any:
    """Return a new form.

    PySide may take a new form for one that FreeCAD has deleted, where it happens to lie at the same
    place in memory; then another one is made, which lies elsewhere.

    Parameters
    ----------
    name : str
        Of the file, e.g. ``"task_panel"``.

    Returns
    -------
    QWidget

    Raises
    ------
    FaultError
    """
    path = str(RESOURCES / "ui" / f"{name}.ui")
    mistaken = []  # kept, so that their places are not used again
    for _ in range(5):
        form = FreeCADGui.PySideUic.loadUi(path)
        try:
            for part in (form, *form.findChildren(QtCore.QObject)):
                part.objectName()
        except RuntimeError:
            mistaken.append(form)
        else:
            return form
    raise FaultError(f"no form could be made of {name}.ui", remedy="start FreeCAD again")


def load_icon(name: str) -> Any:
    """Return an icon of resources/icons.

    FreeCAD draws it: Qt itself may have no plugin for these files.

    Parameters
    ----------
    name : str
        Of the file, e.g. ``"HybridVolume_Solve"``.

    Returns
    -------
    QIcon
    """
    return FreeCADGui.getIcon(name)
