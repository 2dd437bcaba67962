# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The cover of a solid, and how far it may be from the solid's faces."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .. import errors
from ..core.surface import SplineFace

TOLERANCE = 1e-4
"""Largest distance of patches from the faces, as a share of the diagonal, if none is given."""


@dataclass(frozen=True)
class Covered:
    """Patches of a solid.

    Attributes
    ----------
    faces : tuple of SplineFace
        Named after the faces of the solid that they are on: ``Face3`` as often as it has patches.
    origin : (n,) int array
        Face of the solid that each patch is on, from 0.
    deviation : (nf,) array
        Largest distance of the patches from each face of the solid, mm, at samples.
    quads : int
        Quads that the patches were joined from.
    kinds : tuple of str
        ``bit``, ``exact`` or ``tolerance`` for each face of the solid, see
        :mod:`..core.covering.kinds`.
    tolerance : float
        Largest deviation that was allowed, mm.
    inside : tuple of int
        Faces of the solid, from 0, that are left out: those that lie inside its material, where
        parts of it touch, and the merged ones. They have no patches, and their kinds say nothing.
    merged : dict of int to int
        Faces that were too narrow for patches, and the neighbour that each is a part of now.
    """

    faces: tuple[SplineFace, ...]
    origin: np.ndarray
    deviation: np.ndarray
    quads: int
    kinds: tuple[str, ...]
    tolerance: float
    inside: tuple[int, ...] = ()
    merged: dict[int, int] = field(default_factory=dict)


def allowed_deviation(solid: Any, tolerance: float | None) -> float:
    """Largest distance of patches from the faces of a solid, mm.

    Parameters
    ----------
    solid : Part.Shape
    tolerance : float or None
        What is asked for, mm; None or 0: 1e-4 of the diagonal.

    Raises
    ------
    InputError
        It is no length.
    """
    if not tolerance:
        return TOLERANCE * solid.BoundBox.DiagonalLength
    allowed = float(tolerance)
    if not (math.isfinite(allowed) and allowed > 0.0):
        raise errors.InputError(
            f"the tolerance {tolerance!r} is no length above 0 mm",
            remedy="give a length in mm, or 0 for 1e-4 of the diagonal",
        )
    return allowed
