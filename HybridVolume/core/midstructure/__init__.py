# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The midstructure of a body: facets on which the harmonic field is 1."""

from .medial_axis import medial_axis
from .search import METHODS, Search, find_midstructure
from .sheets import Decision, Figures, Midstructure, Sheet

__all__ = [
    "METHODS",
    "Decision",
    "Figures",
    "Midstructure",
    "Search",
    "Sheet",
    "find_midstructure",
    "medial_axis",
]
