# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Cuts around the tips of cones and other sharp poles.

No four-sided patch with a normal at its corner follows a sharp tip: the distance is a share of the
patch's size. So a small cap is cut off at the tip, small enough for the tolerance, and the rest is
cut in rings that grow outwards by a constant factor. The rings are rectangles of the surface, which
keep its geometry, and few quads lie between the tip and the far end.
"""

from __future__ import annotations

from typing import Any

import numpy as np

SHARP = np.radians(4.0)
"""Normals around a pole that differ by more make it a tip."""
CAP = 20.0
"""Size of a needle's cap, as a multiple of the tolerance: four quads are within it then."""
GROWTH = 3.0
"""Every ring is so many times as far from the tip as the one before."""
SECTOR = np.radians(95.0)
"""A face turns by no more about its tip, or it is cut."""
_DIRECTIONS = 9


def pole_cuts(face: Any, tolerance: float) -> list:
    """Edges that cut a face in a cap and rings about its tips.

    Parameters
    ----------
    face : Part.Face
    tolerance : float
        Largest distance of patches from the face, mm.

    Returns
    -------
    list of Part.Edge
        None for a face without a tip, or where trimming edges come too near to it.
    """
    cuts = []
    for wire in face.Wires:
        for edge in wire.childShapes(True, True):
            if edge.Degenerated:
                cuts += _cuts_at(face, edge, tolerance)
    return cuts


def _cuts_at(face: Any, edge: Any, tolerance: float) -> list:
    curve, first, last = face.curveOnSurface(edge)
    ends = np.array([[point.x, point.y] for point in (curve.value(first), curve.value(last))])
    along = int(np.abs(ends[1] - ends[0]).argmax())  # the parameter that runs around the tip
    around = np.sort(ends[:, along])
    at = float(ends[:, 1 - along].mean())
    low, high = face.ParameterRange[2 - 2 * along : 4 - 2 * along]
    far = high if abs(at - low) < abs(high - at) else low
    if _spread(face.Surface, along, around, at, far) < SHARP:
        return []
    surface = face.Surface
    tip, middle = _value(surface, along, around.mean(), at), around.mean()
    share = np.geomspace(1e-6, 1.0, 241)
    away = np.array([
        tip.distanceToPoint(_value(surface, along, middle, at + s * (far - at)))
        for s in share.tolist()
    ])  # fmt: skip
    away = np.maximum.accumulate(away)
    flatness = np.sin(0.5 * _spread(surface, along, around, at, far))
    ring, cuts = CAP * tolerance / flatness, []
    while ring < 0.5 * away[-1]:
        s = float(np.interp(ring, away, share))
        iso = (surface.uIso, surface.vIso)[1 - along](at + s * (far - at))
        line = iso.toShape(*around.tolist())
        kept = line.common(face).Edges
        if abs(sum(part.Length for part in kept) - line.Length) > 1e-6 * line.Length:
            break  # trimmed away in part
        cuts += kept
        ring *= GROWTH
    turn = float(around[1] - around[0])
    period = (surface.UPeriod, surface.VPeriod)[along]() if _periodic(surface, along) else turn
    parts = int(np.ceil(2.0 * np.pi * turn / period / SECTOR))
    if cuts and turn < (1.0 - 1e-6) * period:
        iso = (surface.uIso, surface.vIso)[along]
        for k in range(1, parts):
            line = iso(float(around[0] + turn * k / parts)).toShape(*sorted((at, far)))
            cuts += line.common(face).Edges
    return cuts


def _periodic(surface: Any, along: int) -> bool:
    return bool((surface.isUPeriodic, surface.isVPeriodic)[along]())


def _value(surface: Any, along: int, around: float, across: float) -> Any:
    return surface.value(*((across, around) if along else (around, across)))


def _spread(surface: Any, along: int, around: np.ndarray, at: float, far: float) -> float:
    """Largest angle between normals about the tip, rad."""
    near = at + 1e-4 * (far - at)
    normals = np.array([
        tuple(surface.normal(*((near, u) if along else (u, near))))
        for u in np.linspace(*around, _DIRECTIONS).tolist()
    ])  # fmt: skip
    return float(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)).max())
