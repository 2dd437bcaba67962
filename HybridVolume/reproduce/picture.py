# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The picture of a midstructure: kept facets in the colours of their sheets, in a body of glass."""

from __future__ import annotations

import numpy as np

from HybridVolume.core.midstructure import Midstructure
from HybridVolume.core.surface import PatchSurface
from HybridVolume.exports.scene import Scene, Skin, Wire, glass, outline

REMOVED = (0.62, 0.62, 0.62)
COLOURS = (
    (0.85, 0.22, 0.16), (0.16, 0.45, 0.80), (0.20, 0.63, 0.28), (0.95, 0.60, 0.10),
    (0.55, 0.27, 0.70), (0.10, 0.66, 0.66), (0.85, 0.35, 0.60), (0.55, 0.40, 0.22),
    (0.45, 0.62, 0.10), (0.30, 0.32, 0.62), (0.95, 0.80, 0.15), (0.45, 0.10, 0.20),
)  # fmt: skip
"""Of the kept sheets, the largest first; they come round again."""

# A triangle flatter than this is drawn as a line.
_FLAT = 0.02
# Sheets with less area than this, in squares of their length, are lines.
_LINE = 0.01
# Size of a point, as a share of the body's diagonal.
_POINT = 0.02


def inside(surface: PatchSurface, midstructure: Midstructure) -> Scene:
    """The body as glass, kept sheets solid, the outlines of removed ones faint.

    Parameters
    ----------
    surface : PatchSurface
    midstructure : Midstructure
    """
    skins = [glass(surface)]
    wires = [outline(surface)]
    size = surface.diagonal
    kept_sheets = [k for k, sheet in enumerate(midstructure.sheets) if sheet.kept]
    for place, k in enumerate(kept_sheets):
        facets = midstructure.facets[midstructure.kept & (midstructure.sheet == k)]
        skin, wire = _sheet(
            midstructure.vertices, facets, COLOURS[place % len(COLOURS)], _POINT * size
        )
        skins.extend(skin)
        wires.extend(wire)
    wires.extend(_outline(midstructure))
    low, high = surface.control_points.min(axis=0), surface.control_points.max(axis=0)
    order = np.argsort(high - low, kind="stable")
    axes = np.eye(3)
    up, along, third = axes[order[0]], axes[order[2]], axes[order[1]]
    third = third * np.sign(np.linalg.det([along, third, up]))
    direction = 0.35 * along + 0.62 * up - 0.85 * third
    return Scene(
        tuple(skins),
        tuple(wires),
        direction / np.linalg.norm(direction),
        up,
        0.5 * float(np.linalg.norm(high - low)),
    )


def _sheet(
    vertices: np.ndarray, facets: np.ndarray, colour: tuple[float, float, float], size: float
) -> tuple[list[Skin], list[Wire]]:
    """Triangles of a sheet; those without area, and lines, as lines; points as diamonds."""
    x = vertices[facets]
    side = np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=2)
    area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    longest = side.max(axis=1)
    flat = area <= _FLAT * longest**2
    skins, wires = [], []
    solid = area > 0.0
    if solid.any():
        used, triangles = np.unique(facets[solid], return_inverse=True)
        skins.append(Skin(vertices[used], None, triangles.reshape(-1, 3), colour))
    lines = np.flatnonzero(flat & (longest > 0.0))
    # slivers within a sheet are covered by their neighbours
    extent = np.ptp(x.reshape(-1, 3), axis=0).max()
    if len(lines) and (0.5 * area.sum() < _LINE * extent**2 or (area[lines] == 0.0).any()):
        start = side[lines].argmax(axis=1)
        ends = np.stack([x[lines, start], x[lines, (start + 1) % 3]], axis=1)
        wires.append(Wire(ends, colour, 5.0))
    points = vertices[np.unique(facets[longest == 0.0, 0])]
    if extent < size:
        points = x.reshape(-1, 3).mean(axis=0)[None]
    if len(points):
        skins.append(_diamonds(points, 0.5 * size, colour))
    return skins, wires


def _diamonds(points: np.ndarray, size: float, colour: tuple[float, float, float]) -> Skin:
    """An octahedron around each point."""
    corners = size * np.concatenate([np.eye(3), -np.eye(3)])
    signs = np.array([[i, j, k] for i in (0, 3) for j in (1, 4) for k in (2, 5)])
    triangles = np.arange(len(points))[:, None, None] * 6 + signs
    return Skin((points[:, None] + corners).reshape(-1, 3), None, triangles.reshape(-1, 3), colour)


def _outline(midstructure: Midstructure) -> list[Wire]:
    """Edges of one facet only, of sheets of which nothing is kept."""
    gone = np.array([not sheet.kept for sheet in midstructure.sheets], dtype=bool)
    rows = gone[midstructure.sheet] if len(gone) else np.zeros(len(midstructure.facets), bool)
    facets = midstructure.facets[rows]
    if not len(facets):
        return []
    pairs = np.sort(facets[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    sheet = np.repeat(midstructure.sheet[rows], 3)
    keys = np.column_stack([sheet, pairs])
    unique, count = np.unique(keys, axis=0, return_counts=True)
    rim = unique[(count == 1) & (unique[:, 1] != unique[:, 2])][:, 1:]
    return [Wire(midstructure.vertices[rim], REMOVED, 1.0)] if len(rim) else []
