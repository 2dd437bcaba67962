# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A finite element mesh in the 3D view: coloured by quality, cut open, or single elements in glass.

Coin's plane takes away what is before a cut, and the section through the elements is drawn in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pivy import coin

from HybridVolume.core.mesh_cells import MeshCells

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
from .colour_scale import Legend
from .result_view import (
    BAD_COLOUR,
    CORE_COLOUR,
    GLASS_COLOUR,
    GLASS_TRANSPARENCY,
    LINE_COLOUR,
    SHELL_COLOUR,
)

GROUPS = ("All", "Shell", "Core")


class MeshScene:
    """Coin's nodes for one mesh.

    Parameters
    ----------
    cells : MeshCells
    quality : (n,) array
        Scaled Jacobian of each element, wedges first.

    Attributes
    ----------
    root : SoSeparator
    group : {"All", "Shell", "Core"}
        What is drawn; the shell alone has its cut, too.
    coloured : bool
        By quality; otherwise shell and core have a colour each.
    """

    def __init__(self, cells: MeshCells, quality: np.ndarray) -> None:
        self._cells, self._quality = cells, quality
        self.group, self.coloured = "All", True
        self._plane: tuple[np.ndarray, float] | None = None
        self._marked = np.zeros(0, dtype=int)
        self._skin, self._lines = Faces(smooth=False, crease=0.5), Lines(LINE_COLOUR, 1.0, 0.35)
        self._cut, self._rims = Faces(), Lines(LINE_COLOUR, 1.0, 0.2)
        self._glass = Faces(
            smooth=False, colour=GLASS_COLOUR, transparency=GLASS_TRANSPARENCY, crease=0.5
        )
        self._glass_lines = Lines(LINE_COLOUR, 1.0, 0.85)
        self._blocks, self._block_rims = Faces(smooth=False, crease=0.3), Lines(LINE_COLOUR, 1.5)
        self._labels = coin.SoSeparator()
        self._clip = ClipNode()
        self.legend = Legend()
        self._cuts = switch(self._cut.node, self._rims.node)
        self._body = switch(
            self._cuts,
            # what follows the plane is cut by it: not its own section
            separator(self._clip.node, self._skin.node, self._lines.node),
        )
        self._with_marks = switch(
            *(self._blocks.node, self._block_rims.node, self._labels),
            *(unpickable(), self._glass.node, self._glass_lines.node),
            on=False,
        )
        low, high = self.box
        self.root = separator(
            *(unpickable(), opaque_nothing(0.5 * (low + high)), self.legend.node),
            *(self._body, self._with_marks),
        )
        outside, _, edges = cells.outside()
        self._glass.show(cells.nodes, outside)
        self._glass_lines.show(cells.nodes, edges)
        self.refresh()

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner of the box around the mesh."""
        points = self._cells.nodes
        return points.min(axis=0), points.max(axis=0)

    @property
    def elements(self) -> np.ndarray:
        """Elements that are drawn, by number."""
        wedges, count = len(self._cells.wedges), len(self._cells)
        first = wedges if self.group == "Core" else 0
        return np.arange(first, wedges if self.group == "Shell" else count)

    @property
    def marked(self) -> np.ndarray:
        """Elements that are drawn alone."""
        return self._marked

    def refresh(self) -> None:
        """Draw what the attributes say."""
        core = self.group == "Core"
        triangles, owner, edges = self._cells.outside(core)
        # each corner has the colour of its own element
        corners = self._cells.nodes[triangles].reshape(-1, 3)
        rows = np.arange(len(corners)).reshape(-1, 3)
        self._skin.show(corners, rows, None, np.repeat(self._colours(owner), 3), owner)
        self._lines.show(self._cells.nodes, edges)
        self.legend.show(colour_scale.quality_scale() if self.coloured else None)
        self._show_cut()

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

    def mark(self, elements: np.ndarray, labels: Mapping[int, str] | None = None) -> None:
        """Draw some elements alone in the rest as glass; none goes back.

        Parameters
        ----------
        elements : (k,) int array
        labels : mapping of int to str, optional
            Words at elements, which are then red.
        """
        self._marked = np.asarray(elements, dtype=int)
        turn(self._body, not len(self._marked))
        turn(self._with_marks, len(self._marked) > 0)
        self._labels.removeAllChildren()
        if not len(self._marked):
            self._show_cut()
            return
        cells = self._cells
        triangles, owner = cells.faces(self._marked)
        corners = cells.nodes[triangles].reshape(-1, 3)
        rows = np.arange(len(corners)).reshape(-1, 3)
        colours = self._colours(owner)
        if labels:
            colours = np.full(len(owner), colour_scale.packed(np.array(BAD_COLOUR)))
        self._blocks.show(corners, rows, None, np.repeat(colours, 3), owner)
        self._block_rims.show(cells.nodes, cells.edges(self._marked))
        for element, text in (labels or {}).items():
            self._label(cells.nodes[triangles[owner == element]].mean(axis=(0, 1)), text)

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
        drawn = (self._skin, self._cut, self._blocks)
        return next((k for k in (one.picked(point) for one in drawn) if k is not None), None)

    def _colours(self, elements: np.ndarray) -> np.ndarray:
        """Packed colours of elements, (k,)."""
        if self.coloured:
            return colour_scale.quality_scale().packed(self._quality[elements])
        parts = colour_scale.packed(np.array([SHELL_COLOUR, CORE_COLOUR]))
        return parts[(elements >= len(self._cells.wedges)).astype(int)]

    def _show_cut(self) -> None:
        seen = self._plane is not None and not len(self._marked)
        turn(self._cuts, seen)
        if not seen:
            return
        normal, distance = self._plane
        cut, rims = self._cells.section(self.elements, normal, distance)
        facing = np.broadcast_to(-normal, cut.points.shape)
        # the corners of a section belong to one triangle each
        colours = np.repeat(self._colours(cut.owner), 3)
        self._cut.show(cut.points, cut.facing(-normal), facing, colours, cut.owner)
        self._rims.show(rims.points, rims.parts)

    def _label(self, where: np.ndarray, text: str) -> None:
        place, font, words = coin.SoTranslation(), coin.SoFont(), coin.SoText2()
        place.translation = tuple(map(float, where))
        font.size, font.name = 16.0, "sans:bold"
        words.string = text
        on_top = coin.SoAnnotation()
        for node in (unlit(), look((0.05, 0.0, 0.0)), place, font, words):
            on_top.addChild(node)
        self._labels.addChild(on_top)
