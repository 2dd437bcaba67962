# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A chamfered nut whose chamfer touches its flats: corners of 0 degrees."""

import numpy as np
import pytest

from HybridVolume import errors
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.check import check_surface
from HybridVolume.freecad_python import import_freecad
from HybridVolume.sources.covering import cover_solid

try:
    FreeCAD = import_freecad()
    import Part
except (errors.SetupError, ImportError) as reason:
    pytest.skip(f"FreeCAD: {reason}", allow_module_level=True)

FLAT, HEIGHT, BORE = 10.0, 8.0, 6.0
SLOPE = 1.0 / np.tan(np.radians(30.0))


def nut():
    """A hexagon of 20 mm across flats, cut by a cone that touches the flats at the top."""
    angles = np.arange(7) * np.pi / 3.0
    ring = FLAT / np.cos(np.pi / 6.0) * np.column_stack([np.cos(angles), np.sin(angles)])
    wire = Part.makePolygon([FreeCAD.Vector(x, y, 0) for x, y in ring.tolist()])
    prism = Part.Face(wire).extrude(FreeCAD.Vector(0, 0, HEIGHT))
    cone = Part.makeCone(FLAT + SLOPE * HEIGHT, FLAT, HEIGHT)
    return prism.common(cone).cut(Part.makeCylinder(BORE, HEIGHT)).Solids[0]


def volume():
    """Layers of a disc in a hexagon: triangles between the flats' chords, and sectors."""
    top = FLAT / np.cos(np.pi / 6.0)
    chamfer = (top - FLAT) / SLOPE
    x, w = np.polynomial.legendre.leggauss(200)
    # the layers' area grows like the root of the depth first
    root = 0.5 * (x + 1.0) * np.sqrt(chamfer)
    radius = FLAT + SLOPE * root**2
    half = np.arccos(FLAT / radius)
    area = 6.0 * (FLAT**2 * np.tan(half) + radius**2 * (np.pi / 6.0 - half))
    above = float((area * 2.0 * root * 0.5 * np.sqrt(chamfer)) @ w)
    hexagon = 12.0 * 0.5 * FLAT**2 * np.tan(np.pi / 6.0)
    return above + hexagon * (HEIGHT - chamfer) - np.pi * BORE**2 * HEIGHT


def test_a_nut_with_cusps_is_covered():
    solid = nut()
    found = cover_solid(solid)
    surface = build_surface(list(found.faces))
    singular = check_surface(surface)
    # six flats, of which each touches the circle at the top: twelve cusps, and nothing else
    assert {tuple(np.round(place.point, 6)) for place in singular.places} == {
        tuple(np.round([FLAT * np.cos(a), FLAT * np.sin(a), HEIGHT], 6))
        for a in (np.arange(6) + 0.5) * np.pi / 3.0
    }
    assert surface.volume() == pytest.approx(volume(), rel=1e-6)
    assert found.deviation.max() < 1e-5 * solid.BoundBox.DiagonalLength
