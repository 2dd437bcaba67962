# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Volume of a CAD solid by OCC's triangles, where no formula is known.

OCC's own figure is off by up to some 1e-2 on B-spline faces. That of its triangles is off by a
figure that falls with the square of their size, and is extrapolated.
"""

from __future__ import annotations

from typing import Any

ANGLES = (0.1, 0.05)
"""Turns of neighbouring triangles, radian."""
DEFLECTIONS = (1e-3, 2.5e-4)
"""Distances from the surface that go with them, as shares of the diagonal."""


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
    import MeshPart

    # meshes have coordinates of single precision
    centred = solid.copy()
    centred.translate(-solid.BoundBox.Center)
    diagonal = solid.BoundBox.DiagonalLength
    coarse, fine = (
        MeshPart.meshFromShape(
            Shape=centred.copy(),
            LinearDeflection=share * diagonal,
            AngularDeflection=angle,
            Relative=False,
        ).Volume
        for angle, share in zip(ANGLES, DEFLECTIONS, strict=True)
    )
    change = (fine - coarse) / 3.0
    return fine + change, abs(change)
