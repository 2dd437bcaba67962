# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The 3D view while the midstructure is worked on: its sheets, and the body as glass around them.

Only nodes of the scene are changed and put back, never a property: a document that is saved
meanwhile, its Undo and its view settings do not notice.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from pivy import coin

if TYPE_CHECKING:
    from .sheets_view import SheetsScene

GLASS_COLOUR = (0.78, 0.82, 0.88)
GLASS_TRANSPARENCY = 0.90
EDGE_COLOUR = (0.70, 0.73, 0.80)
EDGE_TRANSPARENCY = 0.60
DEVIATION = 0.002
"""Of the glass from the body, as a share of its diagonal."""


class Stage:
    """Shows the sheets and the glass, hides other objects, until :meth:`close`.

    Parameters
    ----------
    midstructure : App.DocumentObject
    scene : SheetsScene
        Of its view.
    hidden : iterable of App.DocumentObject
        What would stand in the way.
    shape : Part.Shape, optional
        The body, in global coordinates.
    """

    def __init__(
        self, midstructure: Any, scene: SheetsScene, hidden: Iterable[Any], shape: Any | None
    ) -> None:
        self._scene = scene
        self._shape = shape
        self._switches: list[tuple[Any, int, int]] = []
        for obj in hidden:
            self._turn(obj, coin.SO_SWITCH_NONE)
        switch = midstructure.ViewObject.SwitchNode
        self._turn(midstructure, switch.findChild(scene.root))
        self._glass = glass(shape) if shape is not None else coin.SoSeparator()
        scene.root.addChild(self._glass)

    def _turn(self, obj: Any, child: int) -> None:
        switch = obj.ViewObject.SwitchNode
        before = switch.whichChild.getValue()
        # the node itself is kept, not the object: that may be deleted before the stage closes
        self._switches.append((switch, before, child))
        switch.whichChild = child

    def cut(self, direction: tuple[float, float, float] | None, share: float = 0.5) -> None:
        """Cut the view open; None shows everything.

        Parameters
        ----------
        direction : (3,) floats, optional
            What comes first along it is hidden.
        share : float
            How much of the body, along the direction, in [0, 1].
        """
        if direction is None or self._shape is None:
            self._scene.clip(None)
            return
        normal = np.array(direction) / np.linalg.norm(direction)
        box = self._shape.BoundBox
        along = [normal @ (x, y, z) for x in (box.XMin, box.XMax)
                 for y in (box.YMin, box.YMax) for z in (box.ZMin, box.ZMax)]  # fmt: skip
        self._scene.clip(normal, (1.0 - share) * min(along) + share * max(along))

    def close(self) -> None:
        """Put everything back; what was turned on or off otherwise meanwhile stays so."""
        self._scene.clip(None)
        place = self._scene.root.findChild(self._glass)
        if place >= 0:
            self._scene.root.removeChild(place)
        for switch, before, after in self._switches:
            if switch.whichChild.getValue() == after:
                switch.whichChild = before
        self._switches = []


def glass(shape: Any) -> Any:
    """Nodes for a body that can be looked through and clicked through."""
    deviation = DEVIATION * shape.BoundBox.DiagonalLength
    # tessellate stores its triangles in the shape: the document's own must not get coarser
    points, triangles = shape.copy().tessellate(deviation)
    root = coin.SoSeparator()
    root.renderCaching = coin.SoSeparator.OFF
    style = coin.SoPickStyle()
    style.style = coin.SoPickStyle.UNPICKABLE
    material = coin.SoMaterial()
    material.diffuseColor = GLASS_COLOUR
    material.transparency = GLASS_TRANSPARENCY
    hints = coin.SoShapeHints()
    hints.vertexOrdering = coin.SoShapeHints.COUNTERCLOCKWISE
    hints.creaseAngle = 0.6
    faces = coin.SoIndexedFaceSet()
    coordinates = coin.SoCoordinate3()
    coordinates.point.setValues(0, len(points), [tuple(p) for p in points])
    index = np.column_stack([np.array(triangles).reshape(-1, 3), np.full(len(triangles), -1)])
    faces.coordIndex.setValues(0, index.size, index.ravel().tolist())
    nothing = _opaque_nothing(shape.BoundBox.Center)
    for node in (style, nothing, material, hints, coordinates, faces):
        root.addChild(node)
    root.addChild(_edges(shape, deviation))
    return root


def _opaque_nothing(place: Any) -> Any:
    """A triangle without area.

    Where nothing opaque is drawn before, Coin takes blending for switched on, which FreeCAD's
    background switches off behind its back: glass would not be transparent.
    """
    root = coin.SoSeparator()
    coordinates = coin.SoCoordinate3()
    coordinates.point.setValues(0, 3, [tuple(place)] * 3)
    triangle = coin.SoIndexedFaceSet()
    triangle.coordIndex.setValues(0, 4, [0, 1, 2, -1])
    for node in (coin.SoMaterial(), coordinates, triangle):
        root.addChild(node)
    return root


def _edges(shape: Any, deviation: float) -> Any:
    root = coin.SoSeparator()
    unlit = coin.SoLightModel()
    unlit.model = coin.SoLightModel.BASE_COLOR
    material = coin.SoMaterial()
    material.diffuseColor = EDGE_COLOUR
    material.transparency = EDGE_TRANSPARENCY
    points: list[tuple[float, float, float]] = []
    counts: list[int] = []
    for edge in shape.Edges:
        if not edge.Degenerated:
            line = edge.discretize(Deflection=deviation)
            points += [tuple(p) for p in line]
            counts.append(len(line))
    coordinates = coin.SoCoordinate3()
    lines = coin.SoLineSet()
    if counts:
        coordinates.point.setValues(0, len(points), points)
        lines.numVertices.setValues(0, len(counts), counts)
    for node in (unlit, material, coordinates, *([lines] if counts else [])):
        root.addChild(node)
    return root
