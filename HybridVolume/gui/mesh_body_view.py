# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How a body from a mesh looks: its faces, and the lines of its mesh over them.

The view provider is stored in documents by module and name: it stays where it is.
"""

from __future__ import annotations

from typing import Any

import FreeCAD
import numpy as np
from PySide import QtCore

from .coin_nodes import Lines, separator, switch, turn
from .view_providers import LazyView

CAGE_COLOUR = (0.98, 0.68, 0.16)
CREASE_COLOUR = (0.86, 0.10, 0.08)


class MeshBodyView(LazyView):
    """A body from a mesh. What is drawn of the mesh follows the object's properties.

    Attributes
    ----------
    cage : SoSwitch
        Lines of the mesh, and over them its creases.
    """

    ICON = "HybridVolume_MeshBody"
    SHOWN = ("Cage", "Scheme", "SharpAngle")
    """Properties that the lines depend on."""

    def __init__(self, view: Any) -> None:
        super().__init__(view)
        view.addProperty(
            "App::PropertyBool",
            "ShowCage",
            "HybridVolume",
            "Show the mesh that the body was made from, as lines; creases are thicker.",
        )
        view.ShowCage = True

    def attach(self, view: Any) -> None:
        """Add the lines; they are drawn when they are to be seen."""
        super().attach(view)
        self._edges, self._creases = Lines(CAGE_COLOUR, 1.5), Lines(CREASE_COLOUR, 3.5)
        self.cage = switch(separator(self._edges.node, self._creases.node), on=False)
        # below the placement of the body, beside what its display mode shows
        view.RootNode.addChild(self.cage)
        self._told = ""
        self.draw_soon(view.Object)

    def updateData(self, obj: Any, name: str) -> None:
        """Draw another mesh or other creases; tell why there is no surface."""
        if name in self.SHOWN:
            self.outdate(obj)
        elif name == "Status":
            self._tell(obj)

    def onChanged(self, view: Any, name: str) -> None:
        """Show or hide the lines."""
        if name in ("Visibility", "ShowCage") and hasattr(self, "cage"):
            self.draw_soon(view.Object)

    def seen(self, obj: Any) -> bool:
        """Whether the lines are wanted, and there are any."""
        view = obj.ViewObject
        return view.Visibility and getattr(view, "ShowCage", True) and bool(obj.Cage)

    def _draw_if_seen(self, obj: Any) -> bool:
        seen = super()._draw_if_seen(obj)
        turn(self.cage, seen)
        return seen

    def draw(self, obj: Any) -> None:
        """Draw the mesh and its creases."""
        from HybridVolume.errors import HybridVolumeError
        from HybridVolume.objects.mesh_body import creases_of, stored_mesh

        points, ends, creases = np.zeros((0, 3)), np.zeros((0, 2), int), np.zeros((0, 2), int)
        try:
            mesh = stored_mesh(obj)
            points, (ends, _), creases = mesh.vertices, mesh.edges, creases_of(obj, mesh)
        except HybridVolumeError as error:
            FreeCAD.Console.PrintError(f"{obj.Label}: {error.line}\n")
        self._edges.show(points, ends)
        self._creases.show(points, creases)

    def _tell(self, obj: Any) -> None:
        """Tell in a window why a scheme that was chosen makes no surface."""
        from HybridVolume.objects.mesh_body import FAILED

        status = obj.Status
        new, self._told = status != getattr(self, "_told", ""), status
        if new and status.startswith(FAILED) and not obj.Document.Restoring:
            from . import messages

            text = f"{obj.Label}: {status.removeprefix(FAILED)}"
            # Later: the document is still being recomputed.
            QtCore.QTimer.singleShot(0, lambda: messages.tell("Mesh", text))
