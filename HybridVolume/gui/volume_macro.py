# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What the volume's panel does as Python lines, for FreeCAD's macro recorder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import FreeCADGui

from HybridVolume.objects.volume_editor import keywords_of

from .macro import document_text

_VARIABLE = "vol"


class VolumeMacro:
    """Runs methods of a volume's editor as recorded lines.

    Parameters
    ----------
    obj : App.DocumentObject
        A body, or a hybrid volume.
    """

    def __init__(self, obj: Any) -> None:
        self._obj = obj

    def run(self, method: str, keywords: Mapping[str, Any]) -> None:
        """Run a method.

        Raises
        ------
        HybridVolumeError
            What the method raises.
        """
        self._introduce()
        self._call(method, keywords)

    def completed(
        self, parameters: Mapping[str, Any], engine: str, insert: Callable[[], list[Any]]
    ) -> list[Any]:
        """Take in what jobs computed; the recorded line computes it anew.

        Parameters
        ----------
        parameters : mapping
            What it was computed with.
        engine : str
            Mesher of the core.
        insert : callable() -> list of App.DocumentObject
            Puts the results into the document.

        Returns
        -------
        list of App.DocumentObject
        """
        import __main__

        self._introduce()
        editor = getattr(__main__, _VARIABLE)
        made: list[Any] = []
        # this once the worker has done already what the line asks for
        editor.complete = lambda **_: made.extend(insert())
        keywords = keywords_of(parameters)
        if editor.volume is None:
            keywords["midstructure"] = parameters["Midstructure.Method"]
        if engine != "auto":
            keywords["engine"] = engine
        try:
            self._call("complete", keywords)
        finally:
            del editor.complete
        return made

    def _call(self, method: str, keywords: Mapping[str, Any]) -> None:
        given = ", ".join(f"{name}={value!r}" for name, value in keywords.items())
        FreeCADGui.doCommand(f"{_VARIABLE}.{method}({given})")

    def _introduce(self) -> None:
        obj = self._obj
        FreeCADGui.doCommand("import HybridVolume")
        FreeCADGui.doCommand(
            f"{_VARIABLE} = HybridVolume.edit_volume("
            f"{document_text(obj.Document)}.getObject({obj.Name!r}))"
        )
