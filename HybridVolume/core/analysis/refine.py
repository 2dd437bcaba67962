# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Finer shells of the same volume, for analysis: knots are inserted, nothing is offset anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..refinement import split_spans
from ..shell import Shell


def refine_shell(shell: Shell, parts: int = 2) -> Shell:
    """Cut all knot spans of a shell along both of the surface's directions, exactly.

    The knots through the thickness stay; :class:`.spline_space.SplineSpace` makes these finer.

    Parameters
    ----------
    shell : Shell
    parts : int
        Parts of each span.

    Returns
    -------
    Shell
        The same volume, point for point. Its levels and notes are those of the coarse one.
    """
    outer = split_spans(shell.surface, parts)
    inner = [
        split_spans(shell.surface.with_points(layer, polynomial=True), parts).control_points
        for layer in shell.layers[1:]
    ]
    nothing = np.zeros(0)
    layers = np.stack([outer.control_points, *inner])
    return replace(shell, surface=outer, layers=layers, level=nothing, goal=nothing)
