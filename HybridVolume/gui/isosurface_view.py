# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The inner boundary in the 3D view, inside the body as glass, while a slider moves it.

Only nodes of the scene are added and taken away, never a property: a document that is saved
meanwhile, and its Undo, do not notice. The faces of the body stay where the mouse can pick them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import FreeCADGui
import numpy as np
from pivy import coin

if TYPE_CHECKING:
    from HybridVolume.core.field_view import Inner

PLAIN = (0.22, 0.48, 0.84)
WRONG = (0.86, 0.12, 0.10)
"""Of an inner boundary that no shell can reach, as it does not look like the body."""
SCALE = ((0.27, 0.00, 0.33), (0.23, 0.32, 0.55), (0.13, 0.57, 0.55), (0.37, 0.79, 0.38),
         (0.99, 0.91, 0.14))  # fmt: skip
"""Colours from thin to thick: dark blue over green to yellow (the map "viridis")."""
GLASS_TRANSPARENCY = 0.82


class IsosurfaceView:
    """Shows the body, as glass around its inner boundary or as it is, until :meth:`close`.

    Parameters
    ----------
    source : App.DocumentObject
        The body; it is shown even if it is hidden.
    hidden : iterable of App.DocumentObject
        What would stand in the way.
    """

    def __init__(self, source: Any, hidden: Iterable[Any]) -> None:
        self._switches: list[tuple[Any, int, int]] = []
        self._parents: list[tuple[Any, Any]] = []
        for obj in hidden:
            self._turn(obj.ViewObject.SwitchNode, coin.SO_SWITCH_NONE)
        switch = source.ViewObject.SwitchNode
        if switch.whichChild.getValue() == coin.SO_SWITCH_NONE and switch.getNumChildren():
            self._turn(switch, 0)
        self._inner = _Surface()
        self._glass = _glass()
        # at the root, and not below the body, where its placement would move it a second time
        document = FreeCADGui.getDocument(source.Document.Name)
        for view in document.mdiViewsOfType("Gui::View3DInventor"):
            self._add(view.getSceneGraph(), self._inner.root)
        self._add(source.ViewObject.RootNode, self._glass, first=True)

    def _turn(self, switch: Any, child: int) -> None:
        before = switch.whichChild.getValue()
        # the node itself is kept, not the object: that may be deleted before the view closes
        self._switches.append((switch, before, child))
        switch.whichChild = child

    def _add(self, parent: Any, node: Any, *, first: bool = False) -> None:
        if first:
            parent.insertChild(node, 0)
        else:
            parent.addChild(node)
        self._parents.append((parent, node))

    def show(self, inner: Inner, colours: np.ndarray | tuple[float, float, float]) -> None:
        """Draw an inner boundary, and the body as glass.

        Parameters
        ----------
        inner : Inner
        colours : (k, 3) array or one colour
            Of its vertices, each in [0, 1].
        """
        self._inner.show(inner, colours)
        self._glass.whichChild = coin.SO_SWITCH_ALL

    def clear(self) -> None:
        """Draw no inner boundary, and the body as it is."""
        self._inner.clear()
        self._glass.whichChild = coin.SO_SWITCH_NONE

    def close(self) -> None:
        """Put everything back; what was turned on or off otherwise meanwhile stays so."""
        for parent, node in self._parents:
            place = parent.findChild(node)
            if place >= 0:
                parent.removeChild(place)
        for switch, before, after in self._switches:
            if switch.whichChild.getValue() == after:
                switch.whichChild = before
        self._parents, self._switches = [], []


def colours_of(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Colours of values on the scale, (k, 3)."""
    share = np.clip((values - low) / max(high - low, np.finfo(float).tiny), 0.0, 1.0)
    at = np.linspace(0.0, 1.0, len(SCALE))
    return np.column_stack([np.interp(share, at, column) for column in np.array(SCALE).T])


def _glass() -> Any:
    """What makes all that follows it transparent, turned off."""
    material = coin.SoMaterial()
    material.transparency = GLASS_TRANSPARENCY
    # the colours of the body stay
    for field in (material.diffuseColor, material.ambientColor, material.specularColor,
                  material.emissiveColor, material.shininess):  # fmt: skip
        field.setIgnored(True)
    material.setOverride(True)
    switch = coin.SoSwitch()
    switch.whichChild = coin.SO_SWITCH_NONE
    switch.addChild(material)
    return switch


class _Surface:
    """Triangles that the mouse does not see."""

    def __init__(self) -> None:
        self.root = coin.SoSeparator()
        self.root.renderCaching = coin.SoSeparator.OFF
        style = coin.SoPickStyle()
        style.style = coin.SoPickStyle.UNPICKABLE
        hints = coin.SoShapeHints()
        hints.vertexOrdering = coin.SoShapeHints.UNKNOWN_ORDERING
        self._material = coin.SoMaterial()
        self._binding = coin.SoMaterialBinding()
        self._points = coin.SoCoordinate3()
        self._normals = coin.SoNormal()
        binding = coin.SoNormalBinding()
        binding.value = coin.SoNormalBinding.PER_VERTEX_INDEXED
        self._faces = coin.SoIndexedFaceSet()
        for node in (
            *(style, hints, self._material, self._binding),
            *(self._points, self._normals, binding, self._faces),
        ):
            self.root.addChild(node)

    def show(self, inner: Inner, colours: np.ndarray | tuple[float, float, float]) -> None:
        one = isinstance(colours, tuple)
        binding = coin.SoMaterialBinding
        self._binding.value = binding.OVERALL if one else binding.PER_VERTEX_INDEXED
        triangles = inner.triangles
        index = np.column_stack([triangles, np.full(len(triangles), -1)])
        # no index may point beyond the other fields while they are filled
        self._faces.coordIndex.setNum(0)
        _fill(self._points.point, inner.vertices.tolist())
        _fill(self._normals.vector, _normals(inner.vertices, triangles).tolist())
        _fill(self._material.diffuseColor, [colours] if one else colours.tolist())
        _fill(self._faces.coordIndex, index.ravel().tolist())

    def clear(self) -> None:
        self._faces.coordIndex.setNum(0)


def _fill(field: Any, values: list) -> None:
    field.setNum(len(values))
    if values:
        field.setValues(0, len(values), values)


def _normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Normals of the vertices, means of those of the triangles around."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    corner, count = triangles.ravel(), len(vertices)
    total = np.column_stack(
        [np.bincount(corner, np.repeat(flat[:, i], 3), minlength=count) for i in range(3)]
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), (0.0, 0.0, 1.0))
