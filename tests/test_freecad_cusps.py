# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Faces with corners of 0 degrees: a nut whose chamfer touches its flats, a vanishing chamfer."""

import numpy as np
import pytest

import HybridVolume
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


def vanishing_chamfer():
    """A block of 20 x 10 x 10 mm; its chamfer begins as a point, 0.04 x² wide, and ends at x = 10.

    Its two edges are parabolas that touch each other, and the block's edge, in that point.
    """

    def at(x, t):
        return FreeCAD.Vector(x, -5.0, t - 5.0)  # t is z - y

    curve = Part.BezierCurve()
    curve.setPoles([at(0.0, 10.0), at(6.0, 10.0), at(12.0, 10.0 - 0.04 * 144.0)])
    corners = [at(12.0, 10.0 - 0.04 * 144.0), at(12.0, 20.0), at(0.0, 20.0), at(0.0, 10.0)]
    lines = [Part.makeLine(a, b) for a, b in zip(corners[:-1], corners[1:], strict=True)]
    knife = Part.Face(Part.Wire([curve.toShape(), *lines])).extrude(FreeCAD.Vector(0, 20, 20))
    return Part.makeBox(20, 10, 10, FreeCAD.Vector(-10, 0, 0)).cut(knife).Solids[0]


def test_a_body_with_a_cusp_is_completed(python, monkeypatch):
    monkeypatch.setenv("HYBRIDVOLUME_PYTHON", python)
    volume = HybridVolume.complete(vanishing_chamfer())
    assert volume.certificate.all_valid and volume.certificate.valid == volume.shell.element_count
    # the chamfer takes triangles with legs of 0.04 x²: 0.04² 10⁵ / 10 of the block's 2000 mm³
    assert volume.surface.volume() == pytest.approx(2000.0 - 16.0, rel=1e-6)
    assert volume.shell.w0 > 0.4
    assert volume.fem.min_scaled_jacobian > 0.0
