# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The sheets of a midstructure in the 3D view: kept ones in colour, removed ones as faint outlines.

Coordinates and normals go into the scene once. What is kept changes index lists of single sheets
only, so that a slider can be followed.
"""

from __future__ import annotations

import colorsys
import re
from typing import TYPE_CHECKING, Any

import FreeCAD
import numpy as np
from pivy import coin

from .clip import ClipNode
from .coin_nodes import closed_rows, fill, line_style, switch, turn, two_sided, unlit

if TYPE_CHECKING:
    from HybridVolume.core.midstructure import Midstructure

REMOVED_COLOUR = (0.90, 0.92, 0.96)
REMOVED_TRANSPARENCY = 0.88
OUTLINE_TRANSPARENCY = 0.65
MARKED_TRANSPARENCY = 0.45
SLIGHT = 0.004
"""Share of the whole area below which a removed sheet is not drawn; the table still has it."""

_SHEET = re.compile(r"Sheet[1-9][0-9]*")
_GOLDEN = 0.6180339887498949


def sheet_name(number: int) -> str:
    """Name of a sheet in the 3D view and in tables, for its place in ``Midstructure.sheets``."""
    return f"Sheet{number + 1}"


def sheet_number(name: str) -> int | None:
    """Reverse :func:`sheet_name`; None where the name is none of a sheet."""
    # FreeCAD puts a full stop behind the names of containers
    name = name.rstrip(".")
    return int(name[5:]) - 1 if _SHEET.fullmatch(name) else None


def sheet_colour(number: int) -> tuple[float, float, float]:
    """Colour of a kept sheet: far from its neighbours' in the list, from yellow and from green."""
    place = (0.58 + number * _GOLDEN) % 1.0
    # hues from 0.44 (teal) over blue and red to 0.11 (orange); hover and selection take the rest
    hue = (0.44 + 0.67 * place) % 1.0
    return colorsys.hsv_to_rgb(hue, (0.60, 0.40, 0.75)[number % 3], (0.95, 1.00, 0.85)[number % 3])


class SheetsScene:
    """Coin's nodes for one midstructure.

    Attributes
    ----------
    root : SoSeparator
    sheets : list
        One a sheet of the midstructure; ``any_kept`` tells whether it is drawn in colour.
    """

    def __init__(self) -> None:
        self.root = coin.SoSeparator()
        # what is drawn changes often: no cache around it all
        self.root.renderCaching = coin.SoSeparator.OFF
        self.clip = ClipNode()
        self._points = coin.SoCoordinate3()
        self._normals = coin.SoNormal()
        binding = coin.SoNormalBinding()
        binding.value = coin.SoNormalBinding.PER_VERTEX_INDEXED
        self._kept = coin.SoGroup()
        self._removed = coin.SoGroup()
        self._all = coin.SoSeparator()
        self._all.renderCaching = coin.SoSeparator.OFF
        parts = (two_sided(), self._points, self._normals, binding, self._kept, self._removed)
        for node in parts:
            self._all.addChild(node)
        self.root.addChild(self.clip.node)
        self.root.addChild(self._all)
        self._source: Midstructure | None = None
        self.sheets: list[_SheetNodes] = []
        self._marked: frozenset[int] = frozenset()
        self._hovered: int | None = None

    def show(self, midstructure: Midstructure | None) -> None:
        """Draw a midstructure; one that differs from the last in what is kept is drawn quickly."""
        if midstructure is None:
            self._clear()
            return
        last = self._source
        if last is None or last.facets is not midstructure.facets:
            self._build(midstructure)
        self._source = midstructure
        for nodes in self.sheets:
            nodes.show(midstructure.kept)

    def mark(self, numbers: frozenset[int]) -> None:
        """Give sheets the colour of what is selected."""
        changed = self._marked ^ numbers
        self._marked = numbers
        self._colour(changed)

    def hover(self, number: int | None) -> None:
        """Give one sheet the colour of what is under the mouse."""
        changed = {self._hovered, number} - {None}
        self._hovered = number
        self._colour(changed)

    def picked(self, point: Any) -> str:
        """Name of the sheet that a picked point (SoPickedPoint) lies on; "" for none."""
        path = point.getPath()
        for place in range(path.getLength() - 1, -1, -1):
            name = path.getNode(place).getName().getString()
            if _SHEET.fullmatch(name):
                return name
        return ""

    def extend_path(self, name: str, path: Any) -> bool:
        """Append the nodes that lead from the root to a sheet to a path (SoPath)."""
        number = sheet_number(name)
        if number is None or number >= len(self.sheets):
            return False
        sheet = self.sheets[number]
        in_colour = (self._kept, sheet.kept)
        for node in (
            *(self.root, self._all),
            *(in_colour if sheet.any_kept else (self._removed, sheet.removed)),
        ):
            path.append(node)
        return True

    def _clear(self) -> None:
        self._source, self.sheets = None, []
        self._kept.removeAllChildren()
        self._removed.removeAllChildren()

    def _build(self, midstructure: Midstructure) -> None:
        self._clear()
        facets = midstructure.facets
        vertex, normals, places = _smooth_normals(midstructure.vertices, facets, midstructure.sheet)
        fill(self._points.point, midstructure.vertices[vertex].tolist())
        fill(self._normals.vector, normals.tolist())
        order = np.argsort(midstructure.sheet, kind="stable")
        bounds = np.searchsorted(midstructure.sheet[order], np.arange(len(midstructure.sheets) + 1))
        slight = SLIGHT * sum(sheet.area for sheet in midstructure.sheets)
        for number, sheet in enumerate(midstructure.sheets):
            mine = order[bounds[number] : bounds[number + 1]]
            nodes = _SheetNodes(number, mine, facets[mine], places[mine])
            nodes.slight = sheet.area < slight
            self.sheets.append(nodes)
            self._kept.addChild(nodes.kept)
            self._removed.addChild(nodes.removed)
        self._colour(range(len(self.sheets)))

    def _colour(self, numbers: Any) -> None:
        for number in numbers:
            if number < len(self.sheets):
                hovered, marked = number == self._hovered, number in self._marked
                colour = _preferred_colour(hovered) if hovered or marked else None
                self.sheets[number].colour(colour)


class _SheetNodes:
    """Nodes of one sheet: a part with what is kept of it and a part with what is not."""

    def __init__(
        self, number: int, facet: np.ndarray, corners: np.ndarray, places: np.ndarray
    ) -> None:
        self.number = number
        self.slight = False
        self.any_kept = False
        self._facet = facet
        self._corners = corners
        self._places = places
        same = (corners == np.roll(corners, 1, axis=1)).sum(axis=1)
        self._kind = np.where(same == 0, 3, np.where(same == 3, 1, 2))  # corners that differ
        self._shown: np.ndarray | None = None
        self._removed_is_drawn = False
        self._kept_material, self._kept_shape = coin.SoMaterial(), _Shape(thick=True)
        self._fill_material, self._fill = coin.SoMaterial(), _Shape(thick=True)
        self._line_material, self._outline = coin.SoMaterial(), coin.SoIndexedLineSet()
        self.kept = self._part(
            coin.SoPickStyle.SHAPE_ON_TOP, self._kept_material, *self._kept_shape.nodes
        )
        self.removed = self._part(
            coin.SoPickStyle.SHAPE,
            *(self._fill_material, *self._fill.nodes),
            *(unlit(), self._line_material, line_style(1.0), self._outline),
        )

    def _part(self, pick: int, *nodes: Any) -> Any:
        part = coin.SoSeparator()
        part.setName(sheet_name(self.number))
        style = coin.SoPickStyle()
        style.style = pick
        part.addChild(switch(style, *nodes, on=False))
        return part

    def show(self, kept: np.ndarray) -> None:
        """Take which facets of the whole midstructure are kept."""
        mine = kept[self._facet]
        if self._shown is not None and np.array_equal(mine, self._shown):
            return
        self._shown = mine
        self.any_kept = bool(mine.any())
        turn(self.kept.getChild(0), self.any_kept)
        if self.any_kept:
            self._kept_shape.show(self._places, self._kind, mine)
        # the rest of a kept sheet, a rim near the faces, is not drawn: it can only be kept as whole
        drawn = not self.slight and not self.any_kept
        turn(self.removed.getChild(0), drawn)
        if drawn and not self._removed_is_drawn:
            self._removed_is_drawn = True
            self._fill.show(self._places, self._kind, np.ones(len(mine), dtype=bool))
            solid = self._kind == 3
            fill(self._outline.coordIndex, _outline(self._corners[solid], self._places[solid]))

    def colour(self, marked: tuple[float, float, float] | None) -> None:
        """Draw in the sheet's own colour, or in another one."""
        self._kept_material.diffuseColor = marked or sheet_colour(self.number)
        self._fill_material.diffuseColor = marked or REMOVED_COLOUR
        self._fill_material.transparency = MARKED_TRANSPARENCY if marked else REMOVED_TRANSPARENCY
        self._line_material.diffuseColor = marked or REMOVED_COLOUR
        self._line_material.transparency = 0.0 if marked else OUTLINE_TRANSPARENCY


class _Shape:
    """Triangles, lines and points over the scene's coordinates."""

    def __init__(self, *, thick: bool) -> None:
        self._triangles = coin.SoIndexedFaceSet()
        self._lines = coin.SoIndexedLineSet()
        self._points = coin.SoIndexedPointSet()
        style = coin.SoDrawStyle()
        style.lineWidth, style.pointSize = (5.0, 9.0) if thick else (1.0, 1.0)
        self.nodes = (self._triangles, style, self._lines, self._points)

    def show(self, places: np.ndarray, kind: np.ndarray, use: np.ndarray) -> None:
        """Draw the facets ``use``; ``kind`` is their number of corners that differ."""
        fill(self._triangles.coordIndex, closed_rows(places[use & (kind == 3)]))
        lines = places[use & (kind == 2)]
        # (a, b, b), (a, a, b) and (a, b, a) are one line
        second = np.where(lines[:, 0] == lines[:, 1], lines[:, 2], lines[:, 1])
        fill(self._lines.coordIndex, closed_rows(np.column_stack([lines[:, 0], second])))
        fill(self._points.coordIndex, places[use & (kind == 1)][:, 0].tolist())


def _outline(triangles: np.ndarray, places: np.ndarray) -> list[int]:
    """Sides that belong to one triangle only, as lines of Coin.

    Parameters
    ----------
    triangles : (f, 3) int array
    places : (f, 3) int array
        Where the same corners are in the scene.
    """
    along = [[0, 1], [1, 2], [2, 0]]
    sides = np.sort(triangles[:, along].reshape(-1, 2), axis=1).astype(np.int64)
    key = sides[:, 0] * (sides.max(initial=0) + 1) + sides[:, 1]
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    return closed_rows(places[:, along].reshape(-1, 2)[first[count == 1]])


def _smooth_normals(
    points: np.ndarray, facets: np.ndarray, sheet: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals that are smooth within each sheet, with places of their own for the corners.

    Facets of a sheet are wound in no common sense: a corner takes the normal or its opposite,
    whichever agrees with the facet.

    Returns
    -------
    vertex : (k,) int array
        The point at each place.
    normals : (k, 3) array
    places : (f, 3) int array
        Of each facet's corners.
    """
    x = points[facets]
    flat = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    size = np.linalg.norm(flat, axis=1)
    key = (sheet[:, None].astype(np.int64) * len(points) + facets).ravel()
    unique, corner = np.unique(key, return_inverse=True)
    corner, count = corner.ravel(), len(unique)
    facet = np.repeat(np.arange(len(facets)), 3)
    # the largest facet at a corner says which of the two senses is summed
    largest = np.zeros(count, dtype=np.int64)
    order = np.argsort(size[facet], kind="stable")
    largest[corner[order]] = facet[order]
    sense = np.sign(np.einsum("ki,ki->k", flat[facet], flat[largest[corner]]))
    total = np.column_stack(
        [np.bincount(corner, sense * flat[facet, i], minlength=count) for i in range(3)]
    ).reshape(-1, 3)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    total = np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), (0.0, 0.0, 1.0))
    along = np.einsum("ki,ki->k", flat[facet], total[corner]) >= 0.0
    used, places = np.unique(np.where(along, corner, corner + count), return_inverse=True)
    vertex = unique[used % count] % len(points) if count else used
    return vertex, np.vstack([total, -total])[used], places.reshape(-1, 3)


def _preferred_colour(hovered: bool) -> tuple[float, float, float]:
    """The colour that FreeCAD's preferences give to what is under the mouse, or selected."""
    group = FreeCAD.ParamGet("User parameter:BaseApp/Preferences/View")
    if hovered:
        packed = group.GetUnsigned("HighlightColor", 0xE1E114FF)
    else:
        packed = group.GetUnsigned("SelectionColor", 0x1CAD1CFF)
    return tuple((packed >> shift & 0xFF) / 255.0 for shift in (24, 16, 8))
