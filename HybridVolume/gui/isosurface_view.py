# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The inner boundary in the 3D view, inside the body as glass, while a slider moves it.

Only nodes of the scene are added and taken away, never a property: a document that is saved
meanwhile, and its Undo, do not notice. The faces of the body stay where the mouse can pick them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from pivy import coin

from .coin_nodes import OFF, ON, Faces, separator, switch, unpickable
from .stage import Added, Hidden

if TYPE_CHECKING:
    from HybridVolume.core.field_view import Inner

GLASS_TRANSPARENCY = 0.82
RIM = (0.13, 0.13, 0.13)
"""Light of places that are turned away."""
ROUNDS = 2
"""Of smoothing normals."""


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
        self._hidden = Hidden()
        for obj in hidden:
            self._hidden.hide(obj)
        self._source = source
        self._hidden.show(source)
        # the one lamp is at the eye: rims would be black
        rim = coin.SoMaterial()
        rim.emissiveColor = RIM
        self._faces = Faces()
        # not below the body, where its placement would move it a second time
        self._added = Added(source.Document.Name, separator(unpickable(), rim, self._faces.node))
        self._body = source.ViewObject.RootNode
        self._glass = _glass()
        self._body.insertChild(self._glass, 0)
        self.clear()

    def show(self, inner: Inner, colours: np.ndarray) -> None:
        """Draw an inner boundary, and the body as glass.

        Parameters
        ----------
        inner : Inner
        colours : (k,) int array
            Of its vertices, packed 0xRRGGBBAA.
        """
        normals = _normals(inner.vertices, inner.triangles)
        self._faces.show(inner.vertices, inner.triangles, normals, colours)
        self._faces.node.whichChild = ON
        self._glass.whichChild = ON

    def clear(self) -> None:
        """Draw no inner boundary, and the body as it is."""
        self._faces.node.whichChild = OFF
        self._glass.whichChild = OFF

    def close(self) -> None:
        """Put everything back; what was turned on or off otherwise meanwhile stays so."""
        self._added.close()
        place = self._body.findChild(self._glass)
        if place >= 0:
            self._body.removeChild(place)
        self._hidden.close()


def _glass() -> Any:
    """What makes all that follows it transparent."""
    material = coin.SoMaterial()
    material.transparency = GLASS_TRANSPARENCY
    # the colours of the body stay
    for field in (
        *(material.diffuseColor, material.ambientColor, material.specularColor),
        *(material.emissiveColor, material.shininess),
    ):
        field.setIgnored(True)
    material.setOverride(True)
    return switch(material, on=False)


def _normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Normals of the vertices, means of those of the triangles around, smoothed.

    The slivers of an isosurface have normals of no meaning.
    """
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    area = _lengths(flat)
    corner, count = triangles.ravel(), len(vertices)
    for _ in range(ROUNDS):
        total = np.column_stack(
            [np.bincount(corner, np.repeat(column, 3), minlength=count) for column in flat.T]
        )
        length = _lengths(total)
        total /= np.where(length > 0.0, length, 1.0)
        flat = area * (total[triangles[:, 0]] + total[triangles[:, 1]] + total[triangles[:, 2]])
    return np.where(length > 0.0, total, (0.0, 0.0, 1.0))


def _lengths(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("ki,ki->k", vectors, vectors))[:, None]
