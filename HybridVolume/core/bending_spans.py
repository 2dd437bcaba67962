# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A second look at shells that stay far from their level because spans cannot bend.

A span of degree 1 has columns at its corners only, so that its inner side stays as straight as its
outer one. Over something round inside that holds the whole shell back: six faces of one span each
around a ball-shaped cavity reach w0 = .36 of .5, with four spans each .50.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from ..errors import ThicknessError
from .refinement import cut_spans
from .shell import Shell
from .surface import PatchSurface
from .validity import Certificate, scaled_jacobian

logger = logging.getLogger(__name__)

SHORT = 0.85
"""Share of the level below which a shell is looked at again."""
FEW = 200
"""Spans up to which that is done: it costs about four times the shell's own time."""
GAIN = 1.1
"""Factor of the level that is worth more spans."""
KEPT_SHAPE = 0.5
"""Share of the smallest scaled Jacobian that must be left."""


def bending_spans(surface: PatchSurface) -> PatchSurface:
    """The same surface with all spans halved along which the degree is 1."""
    degrees = np.array([patch.degrees for patch in surface.patches])[surface.element_patch]
    return cut_spans(surface, np.where(degrees == 1, 2, 1))


def grown_again(
    surface: PatchSurface,
    grown: tuple[Shell, Certificate],
    level: float,
    grow: Callable[[PatchSurface], tuple[Shell, Certificate]],
) -> tuple[PatchSurface, Shell, Certificate]:
    """A shell on spans that can bend, where that comes clearly nearer to the level.

    Parameters
    ----------
    surface : PatchSurface
    grown : Shell, Certificate
        On this surface.
    level : float
        That was asked for and that the body allows.
    grow : callable
        Grows a shell on a surface.

    Returns
    -------
    PatchSurface, Shell, Certificate
        As they came where nothing is gained.
    """
    shell, _ = grown
    if shell.w0 >= SHORT * level or surface.element_count > FEW:
        return surface, *grown
    finer = bending_spans(surface)
    if finer is surface:
        return surface, *grown
    logger.info("w0 %.3f of %.3f: spans of degree 1 are halved", shell.w0, level)
    try:
        again = grow(finer)
    except ThicknessError as error:
        logger.info("%s", error.line)
        return surface, *grown
    shapes = [float(scaled_jacobian(s.bezier_elements()).min()) for s in (shell, again[0])]
    if again[0].w0 < GAIN * shell.w0 or shapes[1] < KEPT_SHAPE * shapes[0]:
        return surface, *grown
    return finer, *again
