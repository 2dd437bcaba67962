# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""FreeCAD's modules in a plain Python: for the command line, scripts and tests."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from HybridVolume.errors import SetupError

PLACES = (
    "/usr/lib/freecad-python3/lib",
    "/usr/lib/freecad/lib",
    "/usr/lib64/freecad/lib",
    "/usr/local/lib/freecad/lib",
    "/usr/local/lib",
    "/opt/freecad/lib",
    "/Applications/FreeCAD.app/Contents/Resources/lib",
)
"""Folders in which distributions keep ``FreeCAD.so``; ``FREECAD_LIB`` names another."""


def import_freecad() -> ModuleType:
    """Return the module ``FreeCAD``, with ``Part``, ``Fem`` and FreeCAD's own Python on the path.

    Inside FreeCAD this is the plain import.

    Raises
    ------
    SetupError
        FreeCAD is not found, or was built for another Python.
    """
    if "FreeCAD" in sys.modules:
        freecad = sys.modules["FreeCAD"]
    else:
        freecad = _find()
    # Only FreeCAD's own start-up puts its modules on the path; a plain import does not.
    resources = Path(freecad.getResourceDir())
    for folder in (*sorted(resources.glob("Mod/*")), resources / "Mod", resources / "Ext"):
        if folder.is_dir() and str(folder) not in sys.path:
            sys.path.append(str(folder))
    return freecad


def _find() -> ModuleType:
    reasons = []
    for place in ("", *_places()):
        if place:
            sys.path.append(place)
        try:
            return importlib.import_module("FreeCAD")
        except ImportError as fault:
            if place:
                sys.path.remove(place)
                reasons.append(f"{place}: {fault}")
    raise SetupError(
        "FreeCAD's Python modules were not found" + (f" ({'; '.join(reasons)})" if reasons else ""),
        remedy="install FreeCAD 0.20.2 or newer, or name the folder of FreeCAD.so with FREECAD_LIB",
    )


def _places() -> Iterator[str]:
    named = os.environ.get("FREECAD_LIB")
    for place in (named,) if named else (*PLACES, str(Path(sys.prefix) / "lib")):
        if any(Path(place).glob("FreeCAD.*")):
            yield place
