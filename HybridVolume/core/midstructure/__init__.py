# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The midstructure of a body: facets on which the harmonic field is 1."""

from .medial_axis import medial_axis
from .sheets import Midstructure, Sheet

__all__ = ["Midstructure", "Sheet", "medial_axis"]
