# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Cancel: back to a midstructure as it was, by Undo where the steps are a panel's own."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import FreeCAD

from HybridVolume.objects import midstructure as objects
from HybridVolume.objects.properties import include, transaction
from HybridVolume.objects.volume import update_status

PROPERTIES = (*objects.PARAMETERS, "Geometry", "FoundFrom", "MethodUsed")


class UndoMark:
    """Where Cancel goes back to.

    Parameters
    ----------
    doc : App.Document
    volume : App.DocumentObject, optional
        The volume as it is; None where it is not made yet.
    """

    def __init__(self, doc: Any, volume: Any | None = None) -> None:
        self._document = doc.Name
        self._volume = volume.Name if volume is not None else ""
        self._made: tuple[str, ...] = ()
        self._before = _state(volume.Midstructure) if volume is not None else None
        self._copy: tempfile.TemporaryDirectory | None = None
        if volume is not None and volume.Midstructure.Facets:
            self._copy = tempfile.TemporaryDirectory(prefix="hybridvolume-")
            shutil.copy(volume.Midstructure.Facets, Path(self._copy.name) / "facets.npz")

    def made(self, volume: Any) -> None:
        """Tell what was made since: Cancel takes it away."""
        self._made = (volume.Midstructure.Name, volume.Name)

    def close(self) -> None:
        """Forget it; nothing will be undone."""
        if self._copy:
            self._copy.cleanup()
            self._copy = None

    def go_back(self, own_steps: Collection[str]) -> None:
        """Bring the document back.

        Undo goes as far as its steps are the panel's; where others lie between, or Undo does not
        reach so far, the properties are set in a step of their own.

        Parameters
        ----------
        own_steps : collection of str
            Names of the steps that the panel made.
        """
        doc = FreeCAD.listDocuments().get(self._document)
        if doc is not None:
            while not self._is_back(doc) and doc.UndoNames and doc.UndoNames[0] in own_steps:
                doc.undo()
            if not self._is_back(doc):
                self._restore(doc)
        self.close()

    def _is_back(self, doc: Any) -> bool:
        if self._before is None:
            return not any(doc.getObject(name) for name in self._made)
        obj = self._midstructure(doc)
        return obj is None or _state(obj) == self._before

    def _midstructure(self, doc: Any) -> Any | None:
        volume = doc.getObject(self._volume)
        return volume.Midstructure if volume is not None else None

    def _restore(self, doc: Any) -> None:
        with transaction(doc, "Cancel the midstructure"):
            if self._before is None:
                for name in self._made:
                    if doc.getObject(name):
                        doc.removeObject(name)
                return
            obj = self._midstructure(doc)
            if self._copy:
                include(obj, "Facets", Path(self._copy.name) / "facets.npz")
            else:
                obj.Facets = ""
            for name, value in self._before.items():
                setattr(obj, name, list(value) if isinstance(value, tuple) else value)
            objects.update_choice(obj)
            update_status(doc.getObject(self._volume))
            obj.purgeTouched()


def _state(obj: Any) -> dict[str, Any]:
    """Values that say everything about a midstructure."""
    values = {name: getattr(obj, name) for name in PROPERTIES}
    return {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
