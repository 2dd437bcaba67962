# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Faces of a body in the colours of how exactly they are kept, with a legend, in the 3D view.

Only nodes of the scene are added and taken away, never a property: a document that is saved
meanwhile, and its Undo, do not notice. Faces stay where the mouse can pick them, and those that are
selected look as selected faces do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pivy import coin

from HybridVolume.sources import global_shape

from .coin_nodes import (
    Faces,
    behind_lines,
    look,
    separator,
    switch,
    turn,
    unlit,
    unpickable,
    without_extent,
)
from .colour_scale import packed
from .stage import DEVIATION, Added, triangles_of

KINDS = {
    "bit": ("bit for bit", (0.20, 0.47, 0.74)),
    "exact": ("exact", (0.38, 0.71, 0.45)),
    "tolerance": ("within tolerance", (0.96, 0.68, 0.26)),
}
"""Words and colour of each kind of face, the best first; readable without telling red from
green."""

OTHER = (0.80, 0.80, 0.80)
"""Colour of faces about which nothing is known: those of other solids."""


_AROUND = [(0.003 * x, 0.003 * y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]
"""About a pixel each way, in the view of the legend."""


class FaceKinds:
    """Colours the faces of a body until :meth:`close`.

    Parameters
    ----------
    source : App.DocumentObject
        The body.
    kinds : mapping of str to str
        Kind of each face, by its name in the source: ``"Face3"``.
    words : sequence of (kind, text)
        Lines of the legend.
    """

    def __init__(
        self, source: Any, kinds: Mapping[str, str], words: Sequence[tuple[str, str]]
    ) -> None:
        shape = global_shape(source)
        count = len(shape.Faces)
        colours = np.tile(OTHER, (count, 1))
        for name, kind in kinds.items():
            number = int(name.removeprefix("Face"))
            if number <= count:
                colours[number - 1] = KINDS[kind][1]
        self._inserted: list[tuple[Any, Any]] = []
        root = separator(unpickable())
        if not self._colour(source.ViewObject.RootNode, colours):
            root.addChild(_painted(shape, colours))
        self._legend = KindsLegend()
        self._legend.show(words)
        root.addChild(self._legend.node)
        self._added = Added(source.Document.Name, root)

    def close(self) -> None:
        """Take everything away."""
        for group, node in self._inserted:
            place = group.findChild(node)
            if place >= 0:
                group.removeChild(place)
        self._inserted = []
        self._added.close()

    def _colour(self, root: Any, colours: np.ndarray) -> bool:
        """Give the faces that FreeCAD draws a colour each; whether they are just these."""
        search = coin.SoSearchAction()
        search.setType(coin.SoType.fromName("SoBrepFaceSet"))
        search.setInterest(coin.SoSearchAction.ALL)
        search.setSearchingAll(True)
        search.apply(root)
        paths = search.getPaths()
        for k in range(paths.getLength()):
            path = paths[k]
            drawn, group = path.getTail(), path.getNodeFromTail(1)
            parts = drawn.getField("partIndex")
            if parts is None or parts.getNum() != len(colours):
                continue
            material, binding = coin.SoMaterial(), coin.SoMaterialBinding()
            material.diffuseColor.setValues(0, len(colours), colours.tolist())
            binding.value = coin.SoMaterialBinding.PER_PART
            for node in (binding, material):
                group.insertChild(node, group.findChild(drawn))
                self._inserted.append((group, node))
        return bool(self._inserted)


def _painted(shape: Any, colours: np.ndarray) -> Any:
    """Coloured triangles over a body that FreeCAD draws in other pieces than its faces."""
    import Part

    deviation = DEVIATION * shape.BoundBox.DiagonalLength
    faces = shape.Faces  # a new list at each call
    node = coin.SoSeparator()
    forward = coin.SoPolygonOffset()
    forward.factor, forward.units = -1.0, -1.0
    for colour in np.unique(colours, axis=0):
        own = np.flatnonzero((colours == colour).all(axis=1)).tolist()
        drawn = Faces(smooth=False, colour=tuple(colour.tolist()), crease=0.6)
        drawn.show(*triangles_of(Part.makeCompound([faces[k] for k in own]), deviation))
        node.addChild(drawn.node)
    return separator(forward, node)


class KindsLegend:
    """Boxes in the colours of the kinds, and words beside them, at the left edge of the 3D view.

    Attributes
    ----------
    node : SoSwitch
    """

    LEFT, TOP, SIZE, LINE = -0.96, 0.90, 0.035, 0.065
    """Of the boxes, in a view that reaches from -1 to 1 both ways."""
    INK, PAPER = (0.05, 0.05, 0.08), (0.97, 0.97, 0.97)

    def __init__(self) -> None:
        camera = coin.SoOrthographicCamera()
        camera.viewportMapping = coin.SoCamera.LEAVE_ALONE
        camera.aspectRatio, camera.height = 1.0, 2.0
        camera.position = (0.0, 0.0, 1.0)
        camera.nearDistance, camera.farDistance = 0.5, 2.0
        self._boxes, self._texts = Faces(lit=False), coin.SoSeparator()
        on_top = coin.SoAnnotation()
        for node in (camera, unpickable(), behind_lines(), self._boxes.node, self._texts):
            on_top.addChild(node)
        self.node = switch(without_extent(on_top), on=False)

    def show(self, words: Sequence[tuple[str, str]]) -> None:
        """Write lines.

        Parameters
        ----------
        words : sequence of (kind, text)
        """
        turn(self.node, bool(words))
        if not words:
            return
        count = len(words)
        low = self.TOP - self.LINE * np.arange(1, count + 1)
        x = self.LEFT + self.SIZE * np.array([0.0, 1.0, 1.0, 0.0])
        y = low[:, None] + self.SIZE * np.array([0.0, 0.0, 1.0, 1.0])
        points = np.zeros((count, 4, 3))
        points[:, :, 0], points[:, :, 1] = x, y
        corners = 4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
        colours = packed(np.array([KINDS[kind][1] for kind, _ in words])).repeat(4)
        normals = np.tile([0.0, 0.0, 1.0], (4 * count, 1))
        self._boxes.show(points.reshape(-1, 3), corners.reshape(-1, 3), normals, colours)
        self._texts.removeAllChildren()
        self._texts.addChild(unlit())
        # light around the letters: backgrounds are dark or light
        for colour, shifts in ((self.PAPER, _AROUND), (self.INK, [(0.0, 0.0)])):
            self._texts.addChild(look(colour))
            for (_, text), base in zip(words, low.tolist(), strict=True):
                for x, y in shifts:
                    self._write(text, self.LEFT + 1.6 * self.SIZE + x, base + 0.2 * self.SIZE + y)

    def _write(self, text: str, x: float, y: float) -> None:
        place, font, written = coin.SoTranslation(), coin.SoFont(), coin.SoText2()
        place.translation = (x, y, 0.0)
        font.size, font.name = 13, "sans"
        written.string = text
        self._texts.addChild(separator(place, font, written))
