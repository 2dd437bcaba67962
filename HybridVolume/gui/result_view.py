# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A computed volume in the 3D view: layers of the shell, core, inner boundary, whole or cut.

Elements are drawn as Bézier cells with their knot lines. A cut is closed by its section: Coin's
plane takes away what is before it, and the section through cells and tetrahedra is drawn in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from pivy import coin

from HybridVolume.core.cells import CoreCells, ShellCells, shell_cells
from HybridVolume.core.quality import element_quality
from HybridVolume.core.reached import InnerSurface, figures_by_face, inner_figures

from . import colour_scale
from .clip import ClipNode
from .coin_nodes import (
    Faces,
    Lines,
    look,
    opaque_nothing,
    separator,
    switch,
    turn,
    unlit,
    unpickable,
)
from .colour_scale import ColourScale, Legend

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume

SHELL_COLOUR = (0.93, 0.40, 0.35)
INNER_COLOUR = (0.35, 0.70, 0.40)
CORE_COLOUR = (0.80, 0.81, 0.83)
BAD_COLOUR = (0.90, 0.05, 0.05)
LINE_COLOUR = (0.22, 0.20, 0.24)
GLASS_COLOUR = (0.78, 0.82, 0.88)
GLASS_TRANSPARENCY = 0.86

COLOURINGS = {
    "quality": "quality of the elements",
    "share": "reached / asked",
    "level": "level reached",
    "thickness": "thickness in mm",
    "part": "one colour a part",
}
"""What a result can be coloured by."""


class Result:
    """A volume with what is drawn of it.

    Parameters
    ----------
    volume : HybridVolume

    Attributes
    ----------
    volume : HybridVolume
    cells : ShellCells
    quality : ElementQuality
    """

    def __init__(self, volume: HybridVolume) -> None:
        batches = volume.shell.bezier_elements()
        self.volume = volume
        self.cells = shell_cells(volume.shell, batches)
        self.quality = element_quality(volume, batches)

    @cached_property
    def inner(self) -> InnerSurface:
        """Level and thickness over the inner boundary."""
        return inner_figures(self.volume.shell)

    @cached_property
    def by_face(self) -> list[dict[str, Any]]:
        """Level and thickness of each CAD face, as in the report."""
        known = self.volume.report.get("faces")
        return known or figures_by_face(self.volume.shell, self.inner)

    @property
    def colourings(self) -> list[str]:
        """Names of :data:`COLOURINGS` that this result knows the figures of."""
        known = len(self.volume.shell.level) > 0
        return [name for name in COLOURINGS if known or name not in ("share", "level")]

    def column_values(self, name: str) -> np.ndarray | None:
        """Figures over the lattice of each surface element; None where columns have none."""
        if name not in ("share", "level", "thickness"):
            return None
        inner = self.inner
        values = {"level": inner.level, "thickness": inner.thickness}.get(name)
        if values is None:
            values = inner.level / np.maximum(inner.goal, np.finfo(float).tiny)
        return values[self.cells.vertex]

    def scale(self, name: str) -> ColourScale | None:
        """The colours of a colouring; None for one colour a part."""
        if name == "quality":
            return colour_scale.quality_scale()
        if name == "share":
            return colour_scale.share_scale()
        if name == "level":
            highest = max(self.inner.level.max(), self.inner.goal.max())
            return colour_scale.level_scale(float(highest))
        if name == "thickness":
            return colour_scale.thickness_scale(float(self.inner.thickness.max()))
        return None

    def colours(
        self, elements: np.ndarray, colouring: str, plain: tuple[float, float, float]
    ) -> np.ndarray:
        """Packed colours over the lattices of elements along the surface.

        Parameters
        ----------
        elements : (k,) int array
        colouring : str
            One of :data:`COLOURINGS`.
        plain : (r, g, b)
            For one colour a part.

        Returns
        -------
        (k, s + 1, s + 1) int array
        """
        shape = (len(elements), *self.cells.vertex.shape[1:])
        scale = self.scale(colouring)
        if scale is None:
            return np.full(shape, colour_scale.packed(np.array(plain)))
        columns = self.column_values(colouring)
        if columns is not None:
            return scale.packed(columns[elements // self.cells.layers])
        each = scale.packed(self.quality.scaled_jacobian[elements])
        return np.broadcast_to(each[:, None, None], shape)


class Skin:
    """The surface w = constant of many elements: coloured patches with knot lines."""

    def __init__(self, cells: ShellCells, *, glass: bool = False) -> None:
        self._cells = cells
        self._steps = cells.steps[0] + 1
        ink = 0.6 if glass else 0.0
        self._faces = (
            Faces(colour=GLASS_COLOUR, transparency=GLASS_TRANSPARENCY) if glass else Faces()
        )
        self._thin = Lines(LINE_COLOUR, 1.0, 1.0 if glass else 0.35)
        self._thick = Lines(LINE_COLOUR, 1.0 if glass else 2.0, ink)
        self._glass = glass
        self.node = switch(self._faces.node, self._thin.node, self._thick.node)

    def picked(self, point: Any) -> int | None:
        """The element at a picked point; None: none of these."""
        return self._faces.picked(point)

    def show(self, elements: np.ndarray, side: int, colours: np.ndarray | None) -> None:
        """Draw one side of elements.

        Parameters
        ----------
        elements : (k,) int array
        side : {0, -1}
            The outer or the inner one.
        colours : (k, s + 1, s + 1) int array, optional
            Packed.
        """
        turn(self.node, len(elements) > 0)
        if not len(elements):
            return
        n, count = self._steps, len(elements)
        points = self._cells.points[elements][:, :, :, side].reshape(-1, 3)
        normals = self._cells.normals[elements][:, :, :, side].reshape(-1, 3)
        index = np.arange(n * n).reshape(n, n)
        a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
        cell = np.concatenate(
            [np.stack([x.ravel() for x in t], axis=-1) for t in ((a, c, b), (a, d, c))]
        )
        start = (np.arange(count) * n * n)[:, None, None]
        self._faces.show(
            points,
            (start + cell).reshape(-1, 3),
            normals,
            None if colours is None else colours.reshape(-1),
            np.repeat(elements, len(cell)),
        )
        rims = np.stack([index[0], index[-1], index[:, 0], index[:, -1]])
        ends = self._cells.rim[elements // self._cells.layers]
        rows = start + rims
        self._thick.show(points, rows[ends])
        self._thin.show(points, rows[~ends] if not self._glass else rows[:0, 0])


class InnerScene:
    """Coin's nodes for the inner boundary alone.

    Attributes
    ----------
    root : SoSeparator
    """

    def __init__(self) -> None:
        self.root = separator()
        self._result: Result | None = None

    def show(self, volume: HybridVolume | None, colouring: str, *, legend: bool) -> None:
        """Draw the inner boundary of a volume.

        Parameters
        ----------
        volume : HybridVolume or None
            None draws nothing.
        colouring : str
            One of :data:`COLOURINGS`; what the volume does not know becomes one colour.
        legend : bool
        """
        self.root.removeAllChildren()
        if volume is None:
            return
        if self._result is None or self._result.volume is not volume:
            self._result = Result(volume)
        result, cells = self._result, self._result.cells
        if colouring not in result.colourings:
            colouring = "part"
        last = cells.of_layers(cells.layers - 1, cells.layers - 1)
        skin, bar = Skin(cells), Legend()
        skin.show(last, -1, result.colours(last, colouring, INNER_COLOUR))
        bar.show(result.scale(colouring) if legend else None)
        for node in (bar.node, skin.node):
            self.root.addChild(node)


class ResultScene:
    """Coin's nodes for one result.

    Parameters
    ----------
    result : Result

    Attributes
    ----------
    root : SoSeparator
    layers : (int, int) or None
        First and last layer that are drawn, from 0; None: none.
    core, inner : bool
        Whether the core and the inner boundary are drawn.
    colouring : str
    """

    def __init__(self, result: Result) -> None:
        self._result = result
        cells, fem = result.cells, result.volume.fem
        self._core_cells = CoreCells(fem.nodes, fem.tets, fem.interface)
        self.layers: tuple[int, int] | None = (0, cells.layers - 1)
        self.core, self.inner = True, False
        self.colouring = "quality"
        self._plane: tuple[np.ndarray, float] | None = None
        self._marked = np.zeros(0, dtype=int)
        self._red = False

        self._outer, self._bottom = Skin(cells), Skin(cells)
        self._core_faces = Faces(smooth=False, colour=CORE_COLOUR, crease=0.7)
        self._core_edges = Lines(LINE_COLOUR, 1.0, 0.45)
        self._cut, self._cut_rims = Faces(), Lines(LINE_COLOUR, 1.5)
        self._core_cut, self._core_rims = Faces(colour=CORE_COLOUR), Lines(LINE_COLOUR, 1.0, 0.3)
        self._glass = Skin(cells, glass=True)
        self._blocks, self._block_rims = Faces(smooth=False, crease=0.5), Lines(LINE_COLOUR, 1.5)
        self._labels = coin.SoSeparator()
        self.legend = Legend()
        self._clip = ClipNode()

        core = switch(self._core_faces.node, self._core_edges.node)
        self._core_whole = core
        self._cuts = switch(
            self._cut.node, self._cut_rims.node, self._core_cut.node, self._core_rims.node
        )
        self._body = switch(
            self._cuts,
            # what follows the plane is cut by it: not its own section
            separator(self._clip.node, self._outer.node, self._bottom.node, core),
        )
        self._with_marks = switch(
            *(self._blocks.node, self._block_rims.node, self._labels),
            *(unpickable(), self._glass.node),
            on=False,
        )
        middle = cells.flat.mean(axis=0)
        self.root = separator(
            *(unpickable(), opaque_nothing(middle), self.legend.node),
            *(self._body, self._with_marks),
        )
        nodes = self._core_cells.nodes
        self._core_faces.show(nodes, self._core_cells.triangles)
        self._core_edges.show(nodes, self._core_cells.edges)
        self._glass.show(cells.of_layers(0, 0), 0, None)
        self.refresh()

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner of the box around the body."""
        points = self._result.cells.flat
        return points.min(axis=0), points.max(axis=0)

    def refresh(self) -> None:
        """Draw what the attributes say."""
        result, cells = self._result, self._result.cells
        none = np.zeros(0, dtype=int)
        outer = bottom = none
        last = cells.layers - 1
        if self.layers is not None:
            outer = cells.of_layers(self.layers[0], self.layers[0])
            bottom = cells.of_layers(self.layers[1], self.layers[1])
        if self.inner and (self.layers is None or self.layers[1] != last):
            bottom = cells.of_layers(last, last)
        inner_is_drawn = len(bottom) > 0 and bottom[0] % cells.layers == last
        self._outer.show(outer, 0, self._colours(outer, SHELL_COLOUR))
        self._bottom.show(bottom, -1, self._colours(bottom, INNER_COLOUR))
        # both lie on the inner boundary: one of them is drawn
        turn(self._core_whole, self.core and not inner_is_drawn)
        self.legend.show(result.scale(self.colouring))
        self._show_cut()
        if len(self._marked):
            self._show_blocks()

    def clip(self, normal: np.ndarray | None, distance: float = 0.0) -> None:
        """Cut the view open; None shows everything.

        Parameters
        ----------
        normal : (3,) array, optional
            Points x with ``normal . x > distance`` stay.
        distance : float
            mm.
        """
        self._plane = None if normal is None else (np.asarray(normal, dtype=float), distance)
        self._clip.set(normal, distance)
        self._show_cut()

    def mark(
        self,
        elements: np.ndarray | None,
        *,
        red: bool = False,
        labels: Mapping[int, str] | None = None,
    ) -> None:
        """Draw some elements alone, whole, in the rest as glass; None goes back.

        Parameters
        ----------
        elements : (k,) int array, optional
        red : bool
            In red; otherwise coloured as everything is.
        labels : mapping of int to str, optional
            Words at elements.
        """
        self._marked = np.zeros(0, dtype=int) if elements is None else np.asarray(elements)
        self._red = red
        turn(self._body, not len(self._marked))
        turn(self._with_marks, len(self._marked) > 0)
        self._labels.removeAllChildren()
        if not len(self._marked):
            self._show_cut()
            return
        self._show_blocks()
        for element, text in (labels or {}).items():
            self._label(element, text)

    @property
    def marked(self) -> np.ndarray:
        """Elements that are drawn alone."""
        return self._marked

    def element_at(self, view: Any, place: tuple[int, int]) -> int | None:
        """The element that is seen at a place of a view.

        Parameters
        ----------
        view : Gui.View3DInventor
        place : (int, int)
            Pixels from the lower left corner.
        """
        region = view.getViewer().getSoRenderManager().getViewportRegion()
        action = coin.SoRayPickAction(region)
        action.setPoint(coin.SbVec2s(*place))
        # FreeCAD itself must not pick here: it would select nothing that is in the document
        action.apply(separator(view.getCameraNode(), self._body, self._with_marks))
        point = action.getPickedPoint()
        if point is None:
            return None
        drawn = (self._outer, self._bottom, self._cut, self._blocks)
        return next((k for k in (one.picked(point) for one in drawn) if k is not None), None)

    def _colours(self, elements: np.ndarray, plain: tuple[float, float, float]) -> np.ndarray:
        return self._result.colours(elements, self.colouring, plain)

    def _show_cut(self) -> None:
        seen = self._plane is not None and not len(self._marked)
        turn(self._cuts, seen)
        if not seen:
            return
        normal, distance = self._plane
        cells = self._result.cells
        elements = np.zeros(0, dtype=int) if self.layers is None else cells.of_layers(*self.layers)
        cut, rims = cells.section(elements, normal, distance)
        facing = np.broadcast_to(-normal, cut.points.shape)
        colours = self._cut_colours(cut)
        self._cut.show(cut.points, cut.facing(-normal), facing, colours, cut.owner)
        self._cut_rims.show(rims.points, rims.parts)
        for node in (self._core_cut.node, self._core_rims.node):
            turn(node, self.core)
        if self.core:
            cut, rims = self._core_cells.section(normal, distance)
            facing = np.broadcast_to(-normal, cut.points.shape)
            self._core_cut.show(cut.points, cut.facing(-normal), facing)
            self._core_rims.show(rims.points, rims.parts)

    def _cut_colours(self, cut: Any) -> np.ndarray:
        """Packed colours at the corners of a section."""
        result = self._result
        scale = result.scale(self.colouring)
        if scale is None:
            return np.full(len(cut.points), colour_scale.packed(np.array(SHELL_COLOUR)))
        columns = result.column_values(self.colouring)
        if columns is None:
            return np.repeat(scale.packed(result.quality.scaled_jacobian[cut.owner]), 3)
        cells = result.cells
        element, local = np.divmod(cut.ends, cells.size)
        values = columns.reshape(len(columns), -1)[
            element // cells.layers, local // (cells.steps[1] + 1)
        ]
        return scale.packed((1.0 - cut.share) * values[:, 0] + cut.share * values[:, 1])

    def _show_blocks(self) -> None:
        cells, elements = self._result.cells, self._marked
        start = (np.arange(len(elements)) * cells.size)[:, None, None]
        points = cells.points[elements].reshape(-1, 3)
        if self._red:
            colours = np.full(len(points), colour_scale.packed(np.array(BAD_COLOUR)))
        else:
            along = self._colours(elements, SHELL_COLOUR).reshape(len(elements), -1, 1)
            colours = np.broadcast_to(along, (*along.shape[:2], cells.steps[1] + 1)).reshape(-1)
        sides = cells.triangles(range(6))
        triangles, owner = (start + sides).reshape(-1, 3), np.repeat(elements, len(sides))
        self._blocks.show(points, triangles, None, colours, owner)
        along, across = cells.rims(range(6))
        lines = [(start + along).reshape(-1, along.shape[1])]
        # lines of one length: those across are drawn piece by piece
        pieces = np.stack([across[:, :-1], across[:, 1:]], axis=-1).reshape(-1, 2)
        pieces = (start + pieces).reshape(-1, 2)
        fill_up = np.repeat(pieces[:, 1:], along.shape[1] - 2, axis=1)
        lines.append(np.hstack([pieces, fill_up]))
        self._block_rims.show(points, np.concatenate(lines))

    def _label(self, element: int, text: str) -> None:
        cells = self._result.cells
        points = cells.points[element]
        middle = points[points.shape[0] // 2, points.shape[1] // 2, 0]
        away = cells.normals[element][points.shape[0] // 2, points.shape[1] // 2, 0]
        low, high = self.box
        place, font, words = coin.SoTranslation(), coin.SoFont(), coin.SoText2()
        place.translation = tuple(middle + 0.03 * np.linalg.norm(high - low) * away)
        font.size, font.name = 16.0, "sans:bold"
        words.string = text
        on_top = coin.SoAnnotation()
        for node in (unlit(), look((0.05, 0.0, 0.0)), place, font, words):
            on_top.addChild(node)
        self._labels.addChild(on_top)
