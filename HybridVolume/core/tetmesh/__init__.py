# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Tetrahedra: one door to the meshers, each of which runs in a process of its own."""

from .door import CONFORMING, available_engines, enclosed_volume, fill, free_only
from .improve import improve
from .mesh import TetMesh

__all__ = [
    "CONFORMING",
    "TetMesh",
    "available_engines",
    "enclosed_volume",
    "fill",
    "free_only",
    "improve",
]
