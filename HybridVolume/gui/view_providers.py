# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How the objects look in the tree and in the 3D view.

View providers are stored in documents by module and name: they stay where they are.
"""

from __future__ import annotations

from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore

from .element_colours import colour_elements, traffic_light
from .preferences import RESOURCES


class ViewProvider:
    """Base of the view providers: an icon, and no state of its own."""

    ICON = "HybridVolume"

    def __init__(self, view: Any) -> None:
        view.Proxy = self

    def attach(self, view: Any) -> None:
        """Take over a view object, new or restored."""
        self.Object = view.Object

    def getIcon(self) -> str:
        """Return the path of the icon in the tree."""
        return str(RESOURCES / "icons" / f"{self.ICON}.svg")

    def __getstate__(self) -> None:
        return None

    def __setstate__(self, state: Any) -> None:
        return None

    def dumps(self) -> None:
        """Store nothing."""
        return None

    def loads(self, state: Any) -> None:
        """Restore nothing."""
        return None


class LazyView(ViewProvider):
    """Base of views that are drawn later, and only when they are seen."""

    def attach(self, view: Any) -> None:
        """Take over a view object; what it shows is drawn when it is to be seen."""
        super().attach(view)
        self._outdated = True
        self._waiting = False

    def seen(self, obj: Any) -> bool:
        """Whether the object is to be seen now."""
        return bool(obj.ViewObject.Visibility)

    def draw(self, obj: Any) -> None:
        """Draw what the properties say now."""
        raise NotImplementedError

    def outdate(self, obj: Any) -> None:
        """Draw anew when it is seen: what it shows is another one."""
        self._outdated = True
        self.draw_soon(obj)

    def draw_soon(self, obj: Any) -> None:
        """Draw once for all changes that come together.

        Later: a transaction, an Undo and the opening of a document change one thing after another,
        and links and files are restored last.
        """
        if not self._waiting:
            self._waiting = True
            QtCore.QTimer.singleShot(0, lambda: self._draw_if_seen(obj))

    def _draw_if_seen(self, obj: Any) -> bool:
        """Draw what is outdated and seen; return whether it is seen."""
        self._waiting = False
        try:
            seen = self.seen(obj)
        except (ReferenceError, RuntimeError):  # deleted meanwhile
            return False
        if seen and self._outdated:
            self._outdated = False
            self.draw(obj)
        return seen


class SceneView(LazyView):
    """Base of views with a scene of their own, which is their one display mode."""

    MODE = ""
    """Name of the display mode."""

    def getDisplayModes(self, view: Any) -> list[str]:
        """Return the one display mode."""
        return [self.MODE]

    def getDefaultDisplayMode(self) -> str:
        """Return the one display mode."""
        return self.MODE

    def setDisplayMode(self, mode: str) -> str:
        """Return the mode as it is."""
        return mode


class VolumeView(ViewProvider):
    """The hybrid volume: holds its parts in the tree, opens its panel when double-clicked."""

    def attach(self, view: Any) -> None:
        """Add an empty display mode; without one the object would be greyed out."""
        from pivy import coin

        super().attach(view)
        view.addDisplayMode(coin.SoSeparator(), "Parts")

    def getDisplayModes(self, view: Any) -> list[str]:
        """Return the one display mode."""
        return ["Parts"]

    def getDefaultDisplayMode(self) -> str:
        """Return the one display mode."""
        return "Parts"

    def setDisplayMode(self, mode: str) -> str:
        """Return the mode as it is."""
        return mode

    def claimChildren(self) -> list:
        """Return the parts, which the tree shows below."""
        from HybridVolume.objects.volume import CHILDREN

        parts = (getattr(self.Object, name, None) for name in (*CHILDREN, "AnalysisBody"))
        return [part for part in parts if part is not None]

    def updateData(self, obj: Any, name: str) -> None:
        """Let the inner boundary follow the result."""
        inner = getattr(obj, "InnerBoundary", None)
        if name == "Result" and inner is not None and inner.ViewObject.Proxy:
            inner.ViewObject.Proxy.outdate(inner)

    def doubleClicked(self, view: Any) -> bool:
        """Open the panel."""
        from . import commands

        if not FreeCADGui.Control.activeDialog():
            commands.open_soon(view.Object)
        return True


class MeshView(ViewProvider):
    """The mesh for an analysis; a double click opens its panel."""

    ICON = "HybridVolume_FemMesh"
    COLOUR = (0.90, 0.91, 0.88)

    def __init__(self, view: Any) -> None:
        super().__init__(view)
        _paint(view, self.COLOUR)

    def attach(self, view: Any) -> None:
        """Take over a view object; the FEM workbench gets what it lacks for such meshes."""
        from . import fem_workbench

        super().attach(view)
        fem_workbench.install()

    def doubleClicked(self, view: Any) -> bool:
        """Open the panel that tells its quality and makes another one."""
        from . import commands

        if not FreeCADGui.Control.activeDialog():
            commands.open_mesh_soon(view.Object)
        return True


class PartView(MeshView):
    """A mesh to look at, in one colour or coloured by the quality of its elements."""

    def __init__(self, view: Any) -> None:
        super().__init__(view)
        view.addProperty(
            "App::PropertyEnumeration",
            "ColourBy",
            "HybridVolume",
            "One colour for the part, or the smallest scaled Jacobian of each element: "
            "red at 0, yellow at 0.5, green at 1.",
        )
        view.ColourBy = ["Part", "Quality"]

    def updateData(self, obj: Any, name: str) -> None:
        """Colour a new mesh as the old one was."""
        if name == "FemMesh" and getattr(obj.ViewObject, "ColourBy", "") == "Quality":
            self.onChanged(obj.ViewObject, "ColourBy")

    def onChanged(self, view: Any, name: str) -> None:
        """Take another colouring."""
        if name == "ColourBy":
            # Later: while a document is opened, the mesh that is to be coloured comes last.
            QtCore.QTimer.singleShot(0, lambda: self._colour(view))

    def _colour(self, view: Any) -> None:
        from HybridVolume.objects.fem_mesh import element_quality

        try:
            mesh = view.Object.FemMesh
        except ReferenceError:  # deleted meanwhile
            return
        if view.ColourBy == "Quality":
            quality = element_quality(mesh, outer=True)
            colour_elements(view, {e: traffic_light(q) for e, q in quality.items()})
        elif "ColorMode" in view.PropertiesList:  # FreeCAD 1.0 and later
            view.ColorMode = "Overall"
        else:
            view.ElementColor = {}
            _paint(view, self.COLOUR)


class ShellView(PartView):
    """The shell's mesh; a double click tells its quality."""

    ICON = "HybridVolume_Shell"
    COLOUR = (0.93, 0.27, 0.24)

    def doubleClicked(self, view: Any) -> bool:
        """Open the quality panel of the volume."""
        from . import commands

        volume = next((one for one in view.Object.InList if commands.is_volume(one)), None)
        if volume is not None and not FreeCADGui.Control.activeDialog():
            commands.open_quality_soon(volume)
        return True


class CoreView(PartView):
    """The core's mesh."""

    ICON = "HybridVolume_Core"
    COLOUR = (0.86, 0.87, 0.84)


class MidstructureView(SceneView):
    """The midstructure: its sheets are sub-elements ``Sheet1``, ``Sheet2``, ...

    What is drawn is a function of the object's properties, and follows them through Undo.

    Attributes
    ----------
    scene : SheetsScene
    """

    ICON = "HybridVolume_Midstructure"
    MODE = "Sheets"
    SHOWN = ("Facets", "Decisions", "Angle", "MinimumSize", "Kept")
    """Properties that the drawing depends on."""

    def attach(self, view: Any) -> None:
        """Build the scene; it is filled when it is to be seen."""
        from . import picking
        from .sheets_view import SheetsScene

        super().attach(view)
        self.scene = SheetsScene()
        view.addDisplayMode(self.scene.root, self.MODE)
        picking.colour_what_is_picked()

    def updateData(self, obj: Any, name: str) -> None:
        """Draw anew after a change, once for all properties that change together."""
        if name in self.SHOWN:
            self.outdate(obj)

    def onChanged(self, view: Any, name: str) -> None:
        """Draw what was not needed before."""
        if name == "Visibility" and view.Visibility and hasattr(self, "scene"):
            self.draw_soon(view.Object)

    def draw(self, obj: Any) -> None:
        """Draw what the properties say now."""
        from HybridVolume.objects.midstructure import chosen

        self._outdated = False
        self.scene.show(chosen(obj))

    def preview(self, midstructure: Any) -> None:
        """Draw another choice of the same sheets; the document does not notice.

        Parameters
        ----------
        midstructure : Midstructure
        """
        self.scene.show(midstructure)

    def seen(self, obj: Any) -> bool:
        """Whether FreeCAD shows the sheets, itself or as part of a group."""
        return obj.ViewObject.SwitchNode.whichChild.getValue() != -1

    def getElementPicked(self, point: Any) -> str:
        """Return the name of the sheet below the mouse."""
        return self.scene.picked(point)

    def getDetailPath(self, name: str, path: Any, append: bool) -> bool:
        """Lead FreeCAD from a sheet's name to its nodes."""
        view = self.Object.ViewObject
        if append:
            path.append(view.RootNode)
            path.append(view.SwitchNode)
        return self.scene.extend_path(name, path)

    def doubleClicked(self, view: Any) -> bool:
        """Open the panel."""
        from . import commands

        if not FreeCADGui.Control.activeDialog():
            commands.open_soon(view.Object)
        return True

    def onDelete(self, view: Any, names: Any) -> bool:
        """Remove the sheets that are selected; the object itself goes where none is."""
        from . import picking

        obj = view.Object
        sheets = picking.selected_sheets(obj)
        if sheets:
            # Later: FreeCAD holds a transaction for its own deleting open.
            QtCore.QTimer.singleShot(0, lambda: picking.remove_sheets(obj, sheets))
        return not sheets


class InnerBoundaryView(SceneView):
    """The inner boundary, coloured by what was reached; drawn from the volume's stored result.

    Attributes
    ----------
    scene : InnerScene
    """

    ICON = "HybridVolume_InnerBoundary"
    MODE = "Surface"
    COLOURINGS = {
        "Reached / asked": "share",
        "Level": "level",
        "Thickness": "thickness",
        "Part": "part",
    }

    def __init__(self, view: Any) -> None:
        super().__init__(view)
        view.addProperty(
            "App::PropertyEnumeration",
            "ColourBy",
            "HybridVolume",
            "What was reached of the level that was asked, the level itself, the thickness in mm, "
            "or one colour.",
        )
        view.ColourBy = list(self.COLOURINGS)
        view.addProperty(
            "App::PropertyBool", "Legend", "HybridVolume", "Show what the colours mean."
        )
        view.Legend = True

    def attach(self, view: Any) -> None:
        """Build the scene; it is filled when it is to be seen."""
        from .result_view import InnerScene

        super().attach(view)
        self.scene = InnerScene()
        view.addDisplayMode(self.scene.root, self.MODE)

    def onChanged(self, view: Any, name: str) -> None:
        """Take another colouring, or draw what was not needed before."""
        if not hasattr(self, "scene"):
            return
        if name in ("ColourBy", "Legend"):
            self._outdated = True
        if name in ("ColourBy", "Legend", "Visibility"):
            self.draw_soon(view.Object)

    def draw(self, obj: Any) -> None:
        """Draw the volume's stored result."""
        from HybridVolume.errors import HybridVolumeError
        from HybridVolume.objects.inner import stored_volume, volume_of

        view, volume = obj.ViewObject, volume_of(obj)
        try:
            found = stored_volume(volume) if volume is not None and volume.Result else None
        except HybridVolumeError as error:
            FreeCAD.Console.PrintError(f"{obj.Label}: {error.line}\n")
            found = None
        self.scene.show(found, self.COLOURINGS[view.ColourBy], legend=view.Legend)

    def doubleClicked(self, view: Any) -> bool:
        """Open the quality panel with the inner boundary alone."""
        from HybridVolume.objects.inner import volume_of

        from . import commands

        volume = volume_of(view.Object)
        if volume is not None and not FreeCADGui.Control.activeDialog():
            commands.open_quality_soon(volume, inner=True)
        return True


def attach(obj: Any) -> None:
    """Give a document object its view provider and first looks, if it has none yet."""
    view = obj.ViewObject
    if view.Proxy:
        return
    kind = obj.Proxy.Type
    if kind == "HybridVolume::MeshBody":
        from .mesh_body_view import MeshBodyView

        MeshBodyView(view)
        return
    if kind == "HybridVolume::Volume":
        VolumeView(view)
    elif kind == "HybridVolume::Midstructure":
        MidstructureView(view)
    elif kind == "HybridVolume::AnalysisMesh":
        MeshView(view)
    elif kind == "HybridVolume::InnerBoundary":
        InnerBoundaryView(view)
    elif obj.Part == "Shell":
        ShellView(view)
    else:
        CoreView(view)
    view.Visibility = kind in ("HybridVolume::Volume", "HybridVolume::PartMesh")


def _paint(view: Any, colour: tuple[float, float, float]) -> None:
    if "ShapeColor" in view.PropertiesList:
        view.ShapeColor = colour
    else:  # FreeCAD 1.0 and later
        look = FreeCAD.Material()
        look.DiffuseColor = colour
        view.ShapeAppearance = (look,)
    view.PointSize = 1.0
    view.LineWidth = 1.0
    view.DisplayMode = "Faces & Wireframe"
