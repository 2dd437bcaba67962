# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies from files and FreeCAD shapes. Runs in FreeCAD's Python, which it imports when needed."""

from .agreement import check_against_cad
from .covering import Covered, Covering
from .files import Surfacing, read_file
from .shapes import Body, coverings, global_shape, read_object, read_shape, solids_of_object

__all__ = [
    "Body",
    "Covered",
    "Covering",
    "Surfacing",
    "check_against_cad",
    "coverings",
    "global_shape",
    "read_file",
    "read_object",
    "read_shape",
    "solids_of_object",
]
