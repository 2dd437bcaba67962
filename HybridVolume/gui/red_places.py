# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Where a body is refused: its faces in red, the exact places as balls, the rest as glass.

Nothing of it is in the document: nodes are added to the 3D views and taken away again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import FreeCAD
import numpy as np
from pivy import coin

from HybridVolume.errors import HybridVolumeError, Place
from HybridVolume.sources import global_shape

from .coin_nodes import Faces, look, separator, unlit, unpickable
from .stage import DEVIATION, Added, Hidden, glass, triangles_of

RED = (0.85, 0.0, 0.0)
FACE_RED = (1.0, 0.25, 0.20)
FACE_TRANSPARENCY = 0.50
INK = (0.15, 0.05, 0.05)
BALL = 0.008
"""Radius of a ball, as a share of the body's diagonal."""
NAMED = 12
"""Places that words stand at, at most."""
MOST = 400
"""Balls, at most."""

_shown: RedPlaces | None = None


def show(source: Any, error: HybridVolumeError) -> bool:
    """Show where a body is refused, in place of what was shown before.

    Parameters
    ----------
    source : App.DocumentObject
        The body.
    error : HybridVolumeError
        Its faces become red, its places balls.

    Returns
    -------
    bool
        False where the error names no face and no place of the body, or nobody looks.
    """
    global _shown
    clear()
    if not (error.faces or error.places):
        return False
    try:
        gone, shape = source.Document is None, global_shape(source)
    except (ReferenceError, RuntimeError):
        return False
    if gone or shape is None or shape.isNull():
        return False
    _shown = RedPlaces(source, shape, error)
    return True


def clear() -> None:
    """Show the body as it was."""
    global _shown
    if _shown is not None:
        _shown.close()
        _shown = None


def shown() -> RedPlaces | None:
    """What is shown."""
    return _shown


def lines(error: HybridVolumeError) -> list[str]:
    """The places of an error, a line each."""
    return [_words(place) for place in error.places]


def _words(place: Place) -> str:
    return f"{place.face} at {place.where}: {place.what}"


def _drawn(make: Callable[[], Any], name: str) -> Any | None:
    """What a function draws; None where OCC cannot mesh it: the body is a bad one, after all."""
    try:
        return make()
    except RuntimeError as problem:
        FreeCAD.Console.PrintLog(f"HybridVolume: {name} cannot be drawn: {problem}\n")
        return None


class RedPlaces:
    """Red faces and balls in all views of the body's document, until :meth:`close`.

    Parameters
    ----------
    source : App.DocumentObject
    shape : Part.Shape
        Of the source, in global coordinates.
    error : HybridVolumeError

    Attributes
    ----------
    faces : list of str
        Faces that are drawn red.
    balls : int
        Places that are drawn.
    """

    def __init__(self, source: Any, shape: Any, error: HybridVolumeError) -> None:
        self._document, self._name = source.Document.Name, source.Name
        self._diagonal = shape.BoundBox.DiagonalLength
        known = {f"Face{number}": face for number, face in enumerate(shape.Faces, start=1)}
        named = dict.fromkeys([*error.faces, *(place.face for place in error.places)])
        self.faces: list[str] = []
        self.balls = min(len(error.places), MOST)
        root = separator(unpickable())
        self._hidden = Hidden()
        body = _drawn(lambda: glass(shape, INK, 0.3), source.Label)
        if body is not None:
            root.addChild(body)
            self._hidden.hide(source)
        for name in (name for name in named if name in known):
            face = known[name]
            red = _drawn(lambda face=face: self._face(face), name)
            if red is not None:
                root.addChild(red)
                self.faces.append(name)
        root.addChild(self._balls(error.places[:MOST]))
        root.addChild(self._texts(error.places))
        self._added = Added(self._document, root)
        FreeCAD.addDocumentObserver(self)

    def close(self) -> None:
        """Take everything away."""
        FreeCAD.removeDocumentObserver(self)
        self._added.close()
        self._hidden.close()

    def _face(self, face: Any) -> Any:
        drawn = Faces(smooth=False, colour=FACE_RED, transparency=FACE_TRANSPARENCY, crease=0.6)
        drawn.show(*triangles_of(face, DEVIATION * self._diagonal))
        return drawn.node

    def _balls(self, places: Sequence[Place]) -> Any:
        """Balls that are seen through everything."""
        on_top = coin.SoAnnotation()
        on_top.addChild(look(RED))
        ball = coin.SoSphere()
        ball.radius = BALL * self._diagonal
        for place in places:
            at = coin.SoTranslation()
            at.translation = place.point
            on_top.addChild(separator(at, ball))
        return on_top

    def _texts(self, places: Sequence[Place]) -> Any:
        """Words at places; each fault of a face once, and none on top of another."""
        on_top = coin.SoAnnotation()
        font = coin.SoFont()
        font.size, font.name = 14.0, "sans:bold"
        for node in (unlit(), look(INK), font):
            on_top.addChild(node)
        written: dict[str, np.ndarray] = {}
        for place in places:
            text, point = f"{place.face}: {place.what}", np.array(place.point)
            near = any(np.linalg.norm(point - x) < 0.05 * self._diagonal for x in written.values())
            if near or text in written or len(written) == NAMED:
                continue
            written[text] = point
            at, words = coin.SoTranslation(), coin.SoText2()
            at.translation = place.point
            # to both sides in turn and a line lower on one: places often lie in a row
            if len(written) % 2:
                words.string = f"    {text}"
            else:
                words.justification = coin.SoText2.RIGHT
                words.string.setValues(0, 2, ["", f"{text}    "])
            on_top.addChild(separator(at, words))
        return on_top

    # What documents tell an observer: after a change of the body the places are wrong.

    def slotChangedObject(self, obj: Any, name: str) -> None:
        """Clear when the body changes, or anything takes another shape."""
        if obj.Document.Name == self._document and (
            obj.Name == self._name or name in ("Shape", "Placement", "Result")
        ):
            clear()

    def slotCreatedObject(self, obj: Any) -> None:
        """Clear when something new appears beside the body."""
        if obj.Document.Name == self._document:
            clear()

    def slotDeletedObject(self, obj: Any) -> None:
        """Clear when something goes."""
        if obj.Document.Name == self._document:
            clear()

    def slotUndoDocument(self, doc: Any) -> None:
        """Clear at Undo."""
        if doc.Name == self._document:
            clear()

    slotRedoDocument = slotUndoDocument

    def slotDeletedDocument(self, doc: Any) -> None:
        """Clear with the document."""
        if doc.Name == self._document:
            clear()
