# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Small pieces of scene that several views are made of."""

from __future__ import annotations

from typing import Any

import numpy as np
from pivy import coin

ON, OFF = coin.SO_SWITCH_ALL, coin.SO_SWITCH_NONE


def fill(field: Any, values: Any) -> None:
    """Give a field of many values just these (a list, or an (n, 3) array for points)."""
    count = len(values)
    field.setNum(count)
    if count:
        if isinstance(values, np.ndarray):
            values = values.astype(np.float32) if values.ndim == 2 else values.tolist()
        field.setValues(0, count, values)


def closed_rows(rows: np.ndarray) -> list[int]:
    """Indices row by row, each row closed by -1 as Coin wants them."""
    return np.hstack([rows, np.full((len(rows), 1), -1)]).ravel().tolist()


def separator(*children: Any) -> Any:
    """A separator that is never cached: what is below it changes often."""
    root = coin.SoSeparator()
    root.renderCaching = coin.SoSeparator.OFF
    for child in children:
        root.addChild(child)
    return root


def switch(*children: Any, on: bool = True) -> Any:
    """A switch over all of its children."""
    root = coin.SoSwitch()
    root.whichChild = ON if on else OFF
    for child in children:
        root.addChild(child)
    return root


def turn(node: Any, on: bool) -> None:
    """Turn a switch on or off."""
    node.whichChild = ON if on else OFF


def unpickable() -> Any:
    """Lets the mouse through to what is behind."""
    style = coin.SoPickStyle()
    style.style = coin.SoPickStyle.UNPICKABLE
    return style


def unlit() -> Any:
    """Colours as they are, without light."""
    model = coin.SoLightModel()
    model.model = coin.SoLightModel.BASE_COLOR
    return model


def two_sided(crease: float = 0.0) -> Any:
    """Surfaces that are lit from both sides; smooth where they turn by less than ``crease``."""
    hints = coin.SoShapeHints()
    hints.vertexOrdering = coin.SoShapeHints.COUNTERCLOCKWISE
    hints.creaseAngle = crease
    return hints


def behind_lines() -> Any:
    """Moves surfaces back a little, so that lines on them are whole."""
    offset = coin.SoPolygonOffset()
    offset.factor, offset.units = 1.0, 1.0
    return offset


def look(colour: tuple[float, float, float], transparency: float = 0.0) -> Any:
    """One colour for everything."""
    material = coin.SoMaterial()
    material.diffuseColor = colour
    material.transparency = transparency
    return material


def line_style(width: float) -> Any:
    """Width of lines, pixels."""
    style = coin.SoDrawStyle()
    style.lineWidth = width
    return style


def opaque_nothing(place: Any) -> Any:
    """A triangle without area.

    Where nothing opaque is drawn before, Coin takes blending for switched on, which FreeCAD's
    background switches off behind its back: glass would not be transparent.
    """
    coordinates = coin.SoCoordinate3()
    coordinates.point.setValues(0, 3, [tuple(place)] * 3)
    triangle = coin.SoIndexedFaceSet()
    triangle.coordIndex.setValues(0, 4, [0, 1, 2, -1])
    root = coin.SoSeparator()
    for node in (coin.SoMaterial(), coordinates, triangle):
        root.addChild(node)
    return root


def without_extent(*children: Any) -> Any:
    """Children that "fit all" does not look at."""
    kind = coin.SoType.fromName("SoSkipBoundingGroup")
    group = coin.SoGroup() if kind.isBad() else kind.createInstance()
    mode = group.getField("mode")
    if mode is not None:
        mode.set("EXCLUDE_BBOX")
    for child in children:
        group.addChild(child)
    return group


class Lines:
    """Polylines of one colour, unlit; the mouse meets what is behind.

    Attributes
    ----------
    node : SoSwitch
    """

    def __init__(
        self, colour: tuple[float, float, float], width: float = 1.0, transparency: float = 0.0
    ) -> None:
        self._points = coin.SoCoordinate3()
        self._lines = coin.SoIndexedLineSet()
        self.node = switch(
            separator(
                *(unpickable(), unlit(), look(colour, transparency), line_style(width)),
                *(self._points, self._lines),
            )
        )

    def show(self, points: np.ndarray, rows: np.ndarray) -> None:
        """Draw lines.

        Parameters
        ----------
        points : (n, 3) array
        rows : (m, k) int array
            Points of each line.
        """
        # an index beyond the points would be read before the points are there
        fill(self._lines.coordIndex, [])
        fill(self._points.point, points)
        fill(self._lines.coordIndex, closed_rows(rows) if len(rows) else [])


class Faces:
    """Triangles with a colour at each corner, or one for all.

    Parameters
    ----------
    lit : bool
    smooth : bool
        Normals are given; otherwise Coin makes them.
    transparency : float
    colour : (r, g, b), optional
        Of all; None: each corner has its own.
    crease : float
        Angle up to which edges look smooth where no normals are given, radians.

    Attributes
    ----------
    node : SoSwitch
    """

    def __init__(
        self,
        *,
        lit: bool = True,
        smooth: bool = True,
        transparency: float = 0.0,
        colour: tuple[float, float, float] | None = None,
        crease: float = 0.0,
    ) -> None:
        self._points, self._normals = coin.SoCoordinate3(), coin.SoNormal()
        self._triangles = coin.SoIndexedFaceSet()
        self._owner = np.zeros(0, dtype=int)
        self._colours = coin.SoPackedColor() if colour is None else look(colour, transparency)
        materials = coin.SoMaterialBinding()
        if colour is None:
            materials.value = coin.SoMaterialBinding.PER_VERTEX_INDEXED
        nodes = [two_sided(crease), behind_lines(), self._colours, materials, self._points]
        if not lit:
            nodes.insert(0, unlit())
        if smooth:
            nodes.append(self._normals)
        self.node = switch(separator(*nodes, self._triangles))

    def show(
        self,
        points: np.ndarray,
        triangles: np.ndarray,
        normals: np.ndarray | None = None,
        colours: np.ndarray | None = None,
        owner: np.ndarray | None = None,
    ) -> None:
        """Draw triangles.

        Parameters
        ----------
        points : (n, 3) array
        triangles : (m, 3) int array
        normals : (n, 3) array, optional
        colours : (n,) int array, optional
            Packed 0xRRGGBBAA.
        owner : (m,) int array, optional
            What each triangle belongs to, for :meth:`picked`.
        """
        self._owner = np.zeros(0, dtype=int) if owner is None else owner
        fill(self._triangles.coordIndex, [])
        fill(self._points.point, points)
        if normals is not None:
            fill(self._normals.vector, normals)
        if colours is not None:
            self.colour(colours)
        fill(self._triangles.coordIndex, closed_rows(triangles) if len(triangles) else [])

    def picked(self, point: Any) -> int | None:
        """What the triangle at a picked point (SoPickedPoint) belongs to; None: none of these."""
        if point.getPath().getTail() != self._triangles or not len(self._owner):
            return None
        return int(self._owner[coin.cast(point.getDetail(), "SoFaceDetail").getFaceIndex()])

    def colour(self, colours: np.ndarray) -> None:
        """Take other colours at the same points."""
        fill(self._colours.orderedRGBA, colours.tolist())
