# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What the preference page (``resources/ui/preferences.ui``) stores."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import FreeCAD

import HybridVolume
from HybridVolume.job import PREFERENCES

RESOURCES = Path(HybridVolume.__file__).resolve().parent.parent / "resources"

ENGINES = ("auto", "netgen", "gmsh")
"""Meshers for the core in the order of the page's list."""


@dataclass(frozen=True)
class Preferences:
    """Defaults for a new hybrid volume.

    Attributes
    ----------
    python : str
        Interpreter of the worker; empty: the environment of the set-up.
    w0 : float
        Share of the way from the faces to the midstructure that the shell takes.
    layers : int
        Bézier layers through the shell's thickness.
    engine : str
        One of :data:`ENGINES`.
    free_only : bool
        Leave the GPL parts out.
    ask_midstructure : bool
        Show the midstructure before the shell is computed.
    """

    python: str
    w0: float
    layers: int
    engine: str
    free_only: bool
    ask_midstructure: bool


def load() -> Preferences:
    """Read the page's values, or its defaults."""
    group = FreeCAD.ParamGet(PREFERENCES)
    engine = group.GetInt("Engine", 0)
    return Preferences(
        python=group.GetString("Python", ""),
        w0=min(max(group.GetFloat("W0", 0.5), 0.01), 0.99),
        layers=max(group.GetInt("Layers", 2), 1),
        engine=ENGINES[engine] if 0 <= engine < len(ENGINES) else ENGINES[0],
        free_only=group.GetBool("FreeOnly", False),
        ask_midstructure=group.GetBool("AskMidstructure", True),
    )
