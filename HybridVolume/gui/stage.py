# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The 3D view while a panel works on it: what is hidden, what is added, the body as glass.

Only nodes of the scene are changed and put back, never a property: a document that is saved
meanwhile, its Undo and its view settings do not notice.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import FreeCADGui
import numpy as np
from pivy import coin

from .clip import plane_across
from .coin_nodes import Faces, look, opaque_nothing, separator, unlit, unpickable

if TYPE_CHECKING:
    from .sheets_view import SheetsScene

GLASS_COLOUR = (0.78, 0.82, 0.88)
GLASS_TRANSPARENCY = 0.90
EDGE_COLOUR = (0.70, 0.73, 0.80)
EDGE_TRANSPARENCY = 0.60
DEVIATION = 0.004
"""Of the glass from the body, as a share of its diagonal; its edges stand half as far off."""


class Hidden:
    """Objects that are drawn otherwise than their properties say, until :meth:`close`."""

    def __init__(self) -> None:
        self._switches: list[tuple[Any, int, int]] = []
        self._forced: list[Any] = []

    def hide(self, obj: Any) -> None:
        """Draw nothing of an object."""
        self.turn(obj, coin.SO_SWITCH_NONE)

    def turn(self, obj: Any, child: int) -> None:
        """Draw one display mode of an object, by its place below the object's switch."""
        switch = obj.ViewObject.SwitchNode
        before = switch.whichChild.getValue()
        # the node itself is kept, not the object: that may be deleted before the stage closes
        self._switches.append((switch, before, child))
        switch.whichChild = child

    def show(self, obj: Any) -> None:
        """Draw an object that is hidden, in its first display mode."""
        view = obj.ViewObject
        switch = view.SwitchNode
        if switch.whichChild.getValue() != coin.SO_SWITCH_NONE or not switch.getNumChildren():
            return
        # FreeCAD makes no picture of what was never to be seen in this session
        if hasattr(view, "ForceUpdate") and not view.ForceUpdate:
            view.ForceUpdate = True
            self._forced.append(obj)
        self.turn(obj, 0)

    def close(self) -> None:
        """Put everything back; what was turned on or off otherwise meanwhile stays so."""
        for obj in self._forced:
            with contextlib.suppress(ReferenceError, RuntimeError):  # deleted meanwhile
                obj.ViewObject.ForceUpdate = False
        self._forced = []
        for switch, before, after in reversed(self._switches):
            if switch.whichChild.getValue() == after:
                switch.whichChild = before
        self._switches = []


class Added:
    """A node in every 3D view of a document, in global coordinates, until :meth:`close`.

    Parameters
    ----------
    document : str
    node : SoNode
    """

    def __init__(self, document: str, node: Any) -> None:
        self._node = node
        views = FreeCADGui.getDocument(document).mdiViewsOfType("Gui::View3DInventor")
        self._roots = [view.getSceneGraph() for view in views]
        for root in self._roots:
            root.addChild(node)

    def close(self) -> None:
        """Take the node away."""
        for root in self._roots:
            place = root.findChild(self._node)
            if place >= 0:
                root.removeChild(place)
        self._roots = []


class Stage:
    """Shows the sheets of a midstructure and the glass, hides other objects, until :meth:`close`.

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
        self._hidden = Hidden()
        for obj in hidden:
            self._hidden.hide(obj)
        switch = midstructure.ViewObject.SwitchNode
        self._hidden.turn(midstructure, switch.findChild(scene.root))
        self._glass = glass(shape) if shape is not None else coin.SoSeparator()
        scene.root.addChild(self._glass)

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
            self._scene.clip.set(None)
            return
        box = self._shape.BoundBox
        low = np.array([box.XMin, box.YMin, box.ZMin])
        high = np.array([box.XMax, box.YMax, box.ZMax])
        self._scene.clip.set(*plane_across(low, high, direction, share))

    def close(self) -> None:
        """Put everything back; what was turned on or off otherwise meanwhile stays so."""
        self._scene.clip.set(None)
        place = self._scene.root.findChild(self._glass)
        if place >= 0:
            self._scene.root.removeChild(place)
        self._hidden.close()


def glass(
    shape: Any,
    edges: tuple[float, float, float] = EDGE_COLOUR,
    transparency: float = EDGE_TRANSPARENCY,
) -> Any:
    """Nodes for a body that can be looked through and clicked through.

    Parameters
    ----------
    shape : Part.Shape
    edges : (r, g, b)
        Colour of its edges.
    transparency : float
        Of its edges.
    """
    deviation = DEVIATION * shape.BoundBox.DiagonalLength
    faces = Faces(smooth=False, colour=GLASS_COLOUR, transparency=GLASS_TRANSPARENCY, crease=0.6)
    faces.show(*triangles_of(shape, deviation))
    return separator(
        *(unpickable(), opaque_nothing(shape.BoundBox.Center), faces.node),
        separator(unlit(), look(edges, transparency), *_edges(shape, 0.5 * deviation)),
    )


def triangles_of(shape: Any, deviation: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of a shape.

    Parameters
    ----------
    shape : Part.Shape
    deviation : float
        Of the triangles from the shape, mm.

    Returns
    -------
    points : (n, 3) array
        mm.
    triangles : (m, 3) int array
    """
    import MeshPart

    # a copy: the shape stores its triangles, and the document's own must not get coarser; not by
    # tessellate, which has no limit to the angle and takes minutes for faces with sharp folds
    mesh = MeshPart.meshFromShape(
        Shape=shape.copy(), LinearDeflection=deviation, AngularDeflection=0.5, Relative=False
    )
    points, triangles = mesh.Topology
    found = np.array([tuple(point) for point in points]).reshape(-1, 3)
    return found, np.array(triangles, dtype=int).reshape(-1, 3)


def _edges(shape: Any, deviation: float) -> tuple[Any, ...]:
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
    return (coordinates, lines) if counts else ()
