# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Solids as engineers draw them, made by script in FreeCAD, with their exact volumes.

Volumes are formulas or integrals in one variable, none of them OCC's. Lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

PI = math.pi


@dataclass(frozen=True)
class Scripted:
    """A solid.

    Attributes
    ----------
    name, words : str
    make : callable
        Returns a Part.Solid.
    volume : float or None
        Exact, mm³; None where no formula is known.
    genus : tuple of int
        Of each shell, sorted.
    """

    name: str
    words: str
    make: Callable[[], Any]
    volume: float | None
    genus: tuple[int, ...] = (0,)


def _v(*xyz: float) -> Any:
    import FreeCAD

    return FreeCAD.Vector(*xyz)


def _box(x: float, y: float, z: float, at: tuple[float, float, float] = (0, 0, 0)) -> Any:
    import Part

    return Part.makeBox(x, y, z, _v(*at))


def _rod(
    r: float, h: float, at: tuple[float, float, float] = (0, 0, 0), along: Any = (0, 0, 1)
) -> Any:
    import Part

    return Part.makeCylinder(r, h, _v(*at), _v(*along))


def _ball(r: float, at: tuple[float, float, float] = (0, 0, 0)) -> Any:
    import Part

    return Part.makeSphere(r, _v(*at))


def _cone(r: float, s: float, h: float, at: tuple[float, float, float] = (0, 0, 0)) -> Any:
    import Part

    return Part.makeCone(r, s, h, _v(*at))


def _prism(points: list[tuple[float, float]], height: float) -> Any:
    import Part

    wire = Part.makePolygon([_v(x, y, 0) for x, y in [*points, points[0]]])
    return Part.Face(wire).extrude(_v(0, 0, height))


def _revolved(points: list[tuple[float, float]]) -> Any:
    import Part

    wire = Part.makePolygon([_v(x, 0, z) for x, z in [*points, points[0]]])
    return Part.Face(wire).revolve(_v(0, 0, 0), _v(0, 0, 1), 360)


def _edges(solid: Any, wanted: Callable[[Any], bool]) -> list:
    return [edge for edge in solid.Edges if wanted(edge.BoundBox)]


def shoelace(points: list[tuple[float, float]]) -> float:
    """Area of a polygon that runs anticlockwise."""
    x, y = np.array(points).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def turned(points: list[tuple[float, float]]) -> float:
    """Volume of the whole turn of a polygon of radii and heights, anticlockwise (Pappus)."""
    r, z = np.array(points).T
    s, t = np.roll(r, -1), np.roll(z, -1)
    return 2.0 * PI * abs(float(np.sum((r + s) * (r * t - s * z)))) / 6.0


def frustum(r: float, s: float, h: float) -> float:
    """Volume of a truncated cone."""
    return PI * h * (r * r + r * s + s * s) / 3.0


def cap(r: float, h: float) -> float:
    """Volume of a cap of a ball, ``h`` high."""
    return PI * h * h * (3.0 * r - h) / 3.0


def crossing(r: float, big: float) -> float:
    """Volume common to two long cylinders of radii ``r <= big`` whose axes cross at 90 degrees."""
    a, w = np.polynomial.legendre.leggauss(200)
    # y = r sin(a) takes the root at the ends away
    y = r * np.sin(0.5 * PI * a)
    return float(
        np.sum(w * 0.5 * PI * 4.0 * np.sqrt(big * big - y * y) * (r * np.cos(0.5 * PI * a)) ** 2)
    )


def segment(r: float, half: float, floor: float) -> float:
    """Area of a disc's part with ``|x| < half`` and ``y > floor``."""
    under = half * math.sqrt(r * r - half * half) + r * r * math.asin(half / r)
    return under - 2.0 * half * floor


def _drilled() -> Any:
    return _box(40, 30, 10).cut(_rod(4, 10, (10, 15, 0))).cut(_rod(6, 10, (28, 15, 0)))


DRILLED = 40 * 30 * 10 - PI * (16 + 36) * 10


def _moved(scale: float, place: tuple[float, float, float]) -> Any:
    solid = _drilled().Solids[0]
    solid.rotate(_v(0, 0, 0), _v(1, 2, 3), 37.0)
    solid.scale(scale)
    solid.translate(_v(*place))
    return solid


def _bracket() -> Any:
    shape = _box(40, 20, 6).fuse(_box(6, 20, 30)).removeSplitter()
    inner = _edges(
        shape, lambda b: max(abs(b.XMin - 6), abs(b.XMax - 6), abs(b.ZMin - 6), b.ZMax - 6) < 1e-6
    )
    holes = shape.makeFillet(4, inner).cut(_rod(3, 6, (28, 10, 0)))
    return holes.cut(_rod(3, 6, (0, 10, 22), (1, 0, 0)))


def _flange() -> Any:
    shape = _rod(30, 8).fuse(_rod(12, 25)).removeSplitter()
    for k in range(6):
        a = k * PI / 3
        shape = shape.cut(_rod(3, 8, (22 * math.cos(a), 22 * math.sin(a), 0)))
    return shape.cut(_rod(8, 25))


def _tee() -> Any:
    whole = _rod(8, 40).fuse(_rod(6, 20, (0, 0, 20), (1, 0, 0))).removeSplitter()
    return whole.cut(_rod(6, 40)).cut(_rod(4, 20, (0, 0, 20), (1, 0, 0)))


TEE = (
    PI * 64 * 40 + PI * 36 * 20 - crossing(6, 8) / 2
    - (PI * 36 * 40 + PI * 16 * 20 - crossing(4, 6) / 2)
)  # fmt: skip

CUP = [(0.0, 0.0), (10.0, 0.0), (12.0, 15.0), (10.5, 15.0), (8.5, 2.0), (0.0, 2.0)]
FLARE = [(4.0, 0.0), (9.0, 0.0), (9.0, 2.0), (6.0, 12.0), (5.0, 12.0)]
WEDGE = [(0.0, 0.0), (30.0, 0.0), (0.0, 14.0)]


def _vase() -> Any:
    import Part

    return Part.Face(Part.Wire([*_vase_sides()])).revolve(_v(0, 0, 0), _v(0, 0, 1), 360)


def _vase_curve() -> Any:
    import Part

    curve = Part.BSplineCurve()
    points = [(8, 0, 0), (12, 0, 6), (5, 0, 14), (6, 0, 22), (9, 0, 26)]
    curve.buildFromPolesMultsKnots([_v(*p) for p in points], [4, 1, 4], [0, 0.5, 1], False, 3)
    return curve


def _vase_sides() -> list:
    import Part

    top, low = _v(0, 0, 26), _v(0, 0, 0)
    lines = [Part.makeLine(low, _v(8, 0, 0)), Part.makeLine(_v(9, 0, 26), top)]
    return [lines[0], _vase_curve().toShape(), lines[1], Part.makeLine(top, low)]


def vase_volume() -> float:
    """The integral of pi r² dz over the spline's poles, one Gauss rule a span."""
    from scipy.interpolate import BSpline

    knots = [0, 0, 0, 0, 0.5, 1, 1, 1, 1]
    poles = np.array([(8, 0), (12, 6), (5, 14), (6, 22), (9, 26)], dtype=float)
    curve = BSpline(knots, poles, 3)
    a, w = np.polynomial.legendre.leggauss(8)
    t = np.concatenate([0.25 + 0.25 * a, 0.75 + 0.25 * a])
    r, dz = curve(t)[:, 0], curve.derivative()(t)[:, 1]
    return float(PI * np.sum(0.25 * np.tile(w, 2) * r * r * dz))


CAM = [(20, 0), (14, 16), (-2, 13), (-12, 2), (-8, -10), (8, -12)]
"""Poles of a closed uniform cubic."""


def _cam() -> Any:
    import Part

    curve = Part.BSplineCurve()
    curve.buildFromPolesMultsKnots([_v(x, y, 0) for x, y in CAM], [1] * 7, list(range(7)), True, 3)
    return Part.Face(Part.Wire(curve.toShape())).extrude(_v(0, 0, 8)).cut(_rod(4, 8))


def cam_area() -> float:
    """Area within the closed uniform cubic of ``CAM``."""
    b = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
    a, w = np.polynomial.legendre.leggauss(4)
    t = 0.5 + 0.5 * a
    powers = np.stack([t**0, t, t**2, t**3])
    slopes = np.stack([0 * t, t**0, 2 * t, 3 * t**2])
    poles = np.array(CAM, dtype=float)
    area = 0.0
    for k in range(len(poles)):
        local = np.roll(poles, -k, axis=0)[:4]
        x, d = (powers.T @ b @ local).T, (slopes.T @ b @ local).T
        area += 0.25 * float(np.sum(w * (x[0] * d[1] - x[1] * d[0])))
    return abs(area)


def _shaft() -> Any:
    shape = _rod(8, 20).fuse(_rod(11, 15, (0, 0, 20))).fuse(_rod(7, 18, (0, 0, 35)))
    key = _box(4, 8, 10, (-2, 4, 40))
    return shape.removeSplitter().cut(key)


SHAFT = PI * (64 * 20 + 121 * 15 + 49 * 18) - 10 * segment(7, 2, 4)


def _slotted() -> Any:
    slot = _box(30, 8, 2, (15, 16, 0)).fuse(_rod(4, 2, (15, 20, 0))).fuse(_rod(4, 2, (45, 20, 0)))
    return _box(60, 40, 2).cut(slot.removeSplitter())


GEAR = [
    (r * math.cos(a), r * math.sin(a))
    for k in range(12)
    for r, a in (
        (16.0, (k - 0.30) * PI / 6), (20.0, (k - 0.16) * PI / 6),
        (20.0, (k + 0.16) * PI / 6), (16.0, (k + 0.30) * PI / 6),
    )
]  # fmt: skip


def _elbow() -> Any:
    import Part

    def bend(radius: float) -> Any:
        ring = Part.Wire(Part.makeCircle(radius, _v(20, 0, 0), _v(0, 0, 1)))
        return Part.Face(ring).revolve(_v(0, 0, 0), _v(0, 1, 0), -90)

    return bend(6.0).cut(bend(4.0))


def _sweep() -> Any:
    import Part

    curve = Part.BezierCurve()
    curve.setPoles([_v(0, 0, 0), _v(0, 0, 30), _v(20, 0, 30), _v(20, 0, 60)])
    path = Part.Wire(curve.toShape())
    ring = Part.Wire(Part.makeCircle(5, _v(0, 0, 0), _v(0, 0, 1)))
    return path.makePipeShell([ring], True, False)


def _loft() -> Any:
    import Part

    corners = [(-8, -8, 0), (8, -8, 0), (8, 8, 0), (-8, 8, 0), (-8, -8, 0)]
    square = Part.makePolygon([_v(*p) for p in corners])
    disc = Part.Wire(Part.makeCircle(5, _v(0, 0, 24), _v(0, 0, 1)))
    return Part.makeLoft([square, disc], True)


def _rails() -> Any:
    import Part

    rings = [
        Part.Wire(Part.makeCircle(r, _v(0, 0, z), _v(0, 0, 1)))
        for r, z in ((6, 0), (9, 10), (5, 22), (7, 30))
    ]
    return Part.makeLoft(rings, True)


def _shelled() -> Any:
    box = _box(40, 30, 20)
    (top,) = [face for face in box.Faces if face.CenterOfMass.z > 19]
    return box.makeThickness([top], -2.0, 1e-3)


def _housing() -> Any:
    box = _box(50, 40, 20)
    upright = _edges(box, lambda b: b.ZLength > 19)
    shape = box.makeFillet(6, upright).cut(_box(42, 32, 17, (4, 4, 3)))
    for x, y in ((10, 10), (40, 30)):
        shape = shape.fuse(_rod(4, 15, (x, y, 2))).cut(_rod(2, 10, (x, y, 8)))
    return shape.removeSplitter()


def _ellipsoid() -> Any:
    import FreeCAD

    matrix = FreeCAD.Matrix()
    matrix.scale(15, 10, 6)
    return _ball(1).transformGeometry(matrix)


def _spring() -> Any:
    import Part

    helix = Part.makeHelix(8, 12, 10)
    ring = Part.Wire(Part.makeCircle(1.5, _v(10, 0, 0), _v(0, 1, 0)))
    return Part.Wire(helix).makePipeShell([ring], True, True)


def _capsule() -> Any:
    return _rod(5, 12).fuse(_ball(5)).fuse(_ball(5, (0, 0, 12))).removeSplitter()


def _nut() -> Any:
    points = [(10 * math.cos(k * PI / 3), 10 * math.sin(k * PI / 3)) for k in range(6)]
    return _prism(points, 8).cut(_rod(5, 8)).cut(_cone(6, 5, 1)).cut(_cone(5, 6, 1, (0, 0, 7)))


NUT = (
    6 * 100 * math.sqrt(3) / 4 * 8 - PI * 25 * 8 - 2 * (frustum(6, 5, 1) - PI * 25)
)  # fmt: skip


def _rounded(r: float) -> float:
    a = 20 - 2 * r
    return a**3 + 6 * a * a * r + 3 * PI * r * r * a + 4 / 3 * PI * r**3


def _genus_three() -> Any:
    shape = _box(30, 30, 30)
    for along, at in (((1, 0, 0), (0, 15, 15)), ((0, 1, 0), (6, 0, 6)), ((0, 0, 1), (24, 6, 0))):
        shape = shape.cut(_rod(4, 30, at, along))
    return shape


def _torus() -> Any:
    import Part

    return Part.makeTorus(10, 3)


BODIES: tuple[Scripted, ...] = (
    Scripted("sphere", "ball", lambda: _ball(10), 4000 * PI / 3),
    Scripted("cylinder", "round bar", lambda: _rod(5, 20), PI * 500),
    Scripted("cone", "cone with its tip", lambda: _cone(6, 0, 15), PI * 180),
    Scripted("frustum", "truncated cone", lambda: _cone(6, 2, 15), frustum(6, 2, 15)),
    Scripted("torus", "torus", _torus, 2 * PI**2 * 10 * 9, (1,)),
    Scripted("drilled", "plate with two through holes", _drilled, DRILLED, (2,)),
    Scripted("blind", "plate with a blind hole",
             lambda: _box(40, 30, 10).cut(_rod(4, 6, (10, 15, 4))), 12000 - PI * 96),
    Scripted("filleted", "cube, all edges rounded",
             lambda: (lambda b: b.makeFillet(3, b.Edges))(_box(20, 20, 20)), _rounded(3)),
    Scripted("chamfered", "cube, all edges chamfered",
             lambda: (lambda b: b.makeChamfer(3, b.Edges))(_box(20, 20, 20)),
             8000 - 12 * 4.5 * 14 - 8 * 22.5),
    Scripted("bracket", "angle bracket with a fillet and two holes", _bracket,
             40 * 20 * 6 + 6 * 20 * 24 + 20 * (16 - 4 * PI) - 2 * PI * 54, (2,)),
    Scripted("flange", "flange with hub and bolt circle", _flange,
             PI * 900 * 8 + PI * 144 * 17 - 6 * PI * 72 - PI * 1600, (7,)),
    Scripted("tee", "pipe tee", _tee, TEE, (2,)),
    Scripted("cup", "revolved cup", lambda: _revolved(CUP), turned(CUP)),
    Scripted("flare", "revolved ring with conical walls", lambda: _revolved(FLARE),
             turned(FLARE), (1,)),
    Scripted("vase", "revolved spline", _vase, vase_volume()),
    Scripted("cam", "extruded closed spline with a bore", _cam,
             8 * cam_area() - 128 * PI, (1,)),
    Scripted("hollow_ball", "ball with a cavity", lambda: _ball(10).cut(_ball(5)),
             4 / 3 * PI * 875, (0, 0)),
    Scripted("cavity", "block with a spherical cavity",
             lambda: _box(20, 20, 20).cut(_ball(6, (10, 10, 10))), 8000 - 288 * PI, (0, 0)),
    Scripted("genus3", "cube with three crossing-free bores", _genus_three,
             27000 - 3 * PI * 16 * 30, (3,)),
    Scripted("bored_ball", "ball with a bore", lambda: _ball(10).cut(_rod(6, 30, (0, 0, -15))),
             4 / 3 * PI * 512, (1,)),
    Scripted("lens", "two balls in common", lambda: _ball(10).common(_ball(10, (0, 0, 12))),
             2 * cap(10, 4)),
    Scripted("capsule", "round bar with round ends", _capsule, PI * 300 + 500 / 3 * PI),
    Scripted("ellipsoid", "half axes 15, 10, 6", _ellipsoid, 4 / 3 * PI * 900),
    Scripted("wedge", "wedge of 25 degrees", lambda: _prism(WEDGE, 10), shoelace(WEDGE) * 10),
    Scripted("slotted", "thin plate with a slot", _slotted,
             2 * (2400 - 240 - 16 * PI), (1,)),
    Scripted("gear", "wheel of 12 teeth with a bore",
             lambda: _prism(GEAR, 6).cut(_rod(6, 6)), 6 * (shoelace(GEAR) - 36 * PI), (1,)),
    Scripted("nut", "hexagon with a countersunk bore", _nut, NUT, (1,)),
    Scripted("shaft", "stepped shaft with a keyway", _shaft, SHAFT),
    Scripted("shelled", "open box, walls of 2 mm", _shelled, 24000 - 36 * 26 * 18),
    Scripted("housing", "rounded housing with two bosses", _housing,
             20 * (2000 - (4 - PI) * 36) - 42 * 32 * 17 + 2 * (PI * 16 * 14 - PI * 4 * 9)),
    Scripted("elbow", "pipe bend", _elbow, PI / 2 * 20 * PI * 20, (1,)),
    # the modelling kernel's pipe is up to 4.5e-6 mm beside the ideal one, which has a formula
    Scripted("sweep", "disc swept along a plane curve", _sweep, None),
    Scripted("spring", "helical wire", _spring, None),
    Scripted("loft", "from square to disc", _loft, None),
    Scripted("bulge", "loft through four circles", _rails, None),
    Scripted("drilled_turned", "plate with two holes, turned and 500 mm off",
             lambda: _moved(1.0, (500, -300, 200)), DRILLED, (2,)),
    Scripted("drilled_small", "the same, 40 µm long",
             lambda: _moved(1e-3, (0, 0, 0)), DRILLED * 1e-9, (2,)),
    Scripted("drilled_large", "the same, 40 m long",
             lambda: _moved(1e3, (0, 0, 0)), DRILLED * 1e9, (2,)),
)  # fmt: skip
