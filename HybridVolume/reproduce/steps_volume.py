# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Volume of a CAD solid by OCC's triangles, where no formula is known.

OCC's own figure is off by up to some 1e-2 on B-spline faces. That of its triangles is off by a
figure that falls with their distance from the surface, and is extrapolated.
"""

from __future__ import annotations

from typing import Any

import numpy as np

COARSE, FINE = 4e-4, 1e-4
"""Distances of the triangles from the surface, as shares of the diagonal."""


def triangle_volume(solid: Any) -> tuple[float, float]:
    """Volume of a solid and how far it may be off.

    Parameters
    ----------
    solid : Part.Solid

    Returns
    -------
    volume, doubt : float
        mm³; the doubt is what the extrapolation changed.
    """
    diagonal = solid.BoundBox.DiagonalLength
    coarse, fine = (_volume(solid, share * diagonal) for share in (COARSE, FINE))
    change = (fine - coarse) * FINE / (COARSE - FINE)
    return fine + change, abs(change)


def _volume(solid: Any, deflection: float) -> float:
    centre = np.array(tuple(solid.BoundBox.Center))
    total = 0.0
    for face in solid.Faces:
        points, triangles = face.tessellate(deflection, True)
        x = (np.array([tuple(point) for point in points]) - centre)[np.array(triangles)]
        total += float(np.einsum("ij,ij->", x[:, 0], np.cross(x[:, 1], x[:, 2]))) / 6.0
    return total
