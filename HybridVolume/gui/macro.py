# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Commands of the midstructure's panel as Python lines, for FreeCAD's macro recorder."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import FreeCAD
import FreeCADGui

if TYPE_CHECKING:
    from HybridVolume.core.midstructure import Sheet

_VARIABLE = "mid"


class Macro:
    """Runs methods of a midstructure's editor as recorded lines.

    Parameters
    ----------
    obj : App.DocumentObject
        The midstructure.

    Attributes
    ----------
    steps : set of str
        Names of the steps of Undo that were made.
    """

    def __init__(self, obj: Any) -> None:
        self._obj = obj
        self.steps: set[str] = set()
        self._recording: bool | None = None
        self._introduced = False

    def run(self, call: str) -> None:
        """Run a method of the editor, e.g. ``automatic()``.

        Raises
        ------
        HybridVolumeError
            What the method raises.
        """
        self._introduce()
        self._run(call)

    def _run(self, call: str) -> None:
        FreeCADGui.doCommand(f"{_VARIABLE}.{call}")
        self.steps.update(self._obj.Document.UndoNames[:1])

    def found(self, path: os.PathLike, found_from: Mapping[str, str]) -> None:
        """Take in what a job found; the recorded line is ``mid.find()``, which finds it anew.

        Parameters
        ----------
        path : path
            The job's ``result_file``.
        found_from : mapping
            ``search_inputs`` when the job was made.
        """
        import __main__

        self._introduce()
        editor = getattr(__main__, _VARIABLE)
        # this once the worker has done already what the line asks for
        editor.find = lambda: editor.insert(path, dict(found_from))
        try:
            self._run("find()")
        finally:
            del editor.find

    def decision(self, action: str, sheets: Sequence[Sheet]) -> str:
        """Call of the editor that keeps, removes, ... sheets, which finds them in other bodies too.

        Parameters
        ----------
        action : {"keep", "remove", "only", "invert"}
        sheets : sequence of Sheet
            Without any, all are meant.
        """
        if not sheets:
            return f"{action}()"
        if len(sheets) == 1:
            (sheet,) = sheets
            at = ", ".join(f"{x:.6g}" for x in sheet.foot)
            return f"{action}(faces={sheet.faces!r}, at=({at}))"
        return f"{action}({', '.join(repr(sheet.name) for sheet in sheets)})"

    def object_text(self, obj: Any) -> str:
        """Expression for an object of the document."""
        return f"{document_text(obj.Document)}.getObject({obj.Name!r})"

    def _introduce(self) -> None:
        """Name the editor where a macro that is being recorded has not seen it yet."""
        # from FreeCAD 1.0 on there is no such command, and nothing tells
        stop = FreeCADGui.Command.get("Std_MacroStopRecord")
        recording = stop.isActive() if stop else None
        if self._introduced and recording is not None and recording == self._recording:
            return
        self._introduced, self._recording = True, recording
        FreeCADGui.doCommand("import HybridVolume")
        FreeCADGui.doCommand(
            f"{_VARIABLE} = HybridVolume.edit_midstructure({self.object_text(self._obj)})"
        )


def document_text(doc: Any) -> str:
    """Expression for a document; the active one is not named, so that macros serve others too."""
    active = FreeCAD.ActiveDocument
    if active is not None and active.Name == doc.Name:
        return "App.ActiveDocument"
    return f"App.getDocument({doc.Name!r})"


def start_volume(source: Any, solid: int) -> Any:
    """Make a volume with its midstructure, before anything is computed, as recorded lines.

    Parameters
    ----------
    source : App.DocumentObject
        The body.
    solid : int
        Which solid of it, from 1.
    """
    doc = document_text(source.Document)
    before = {obj.Name for obj in source.Document.Objects}
    # FreeCAD's recorder understands this kind of import only
    FreeCADGui.doCommand("import HybridVolume.objects.volume")
    FreeCADGui.doCommand(
        f"volume = HybridVolume.objects.volume.start("
        f"{doc}, {doc}.getObject({source.Name!r}), {solid})"
    )
    (made,) = (
        obj
        for obj in source.Document.Objects
        if obj.Name not in before and getattr(obj, "Midstructure", None) is not None
    )
    return made
