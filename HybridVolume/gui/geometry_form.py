# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The part of the volume's panel that says how near its patches are to the faces, face by face."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore, QtGui

from HybridVolume.objects.face_geometry import FaceColour, face_colours
from HybridVolume.sources import Body
from HybridVolume.sources.covered import TOLERANCE

from .face_kinds import KINDS, FaceKinds
from .face_table import face_names
from .figure_table import FigureTable
from .thickness_form import Length
from .work import is_deleted

COLUMNS = (
    ("Face", "CAD face of the body"),
    ("Kept", "How exactly the patches of the hybrid volume are this face"),
    ("Patches", "Four-sided patches that the face became"),
    ("Off, mm", "Largest distance of the patches from the face, at samples; 0: but for rounding"),
)
HINT = (
    "Press Check to see how exactly each face can be kept, before anything else is computed. "
    "Run does it too."
)


@dataclass(frozen=True)
class Geometry:
    """How exactly the faces of one solid are kept.

    Attributes
    ----------
    names : dict of str to str
        For every face of the solid, its name in the source.
    faces : dict of str to FaceColour
        Of every face of the solid.
    sentence : str
    """

    names: dict[str, str]
    faces: dict[str, FaceColour]
    sentence: str


def body_geometry(source: Any, number: int, body: Body) -> Geometry:
    """How the faces of a solid, from 1, of a document object were read."""
    told = body.origin["geometry"]
    faces = {
        row["name"]: FaceColour(row["kind"], float(row["deviation"]), int(row["patches"]))
        for row in told["faces"]
    }
    return Geometry(_in_source(source, number), faces, told["sentence"])


def volume_geometry(volume: Any) -> list[Geometry]:
    """How the faces were kept that a hybrid volume was computed with; empty where none tells."""
    faces = face_colours(volume)
    names = _in_source(volume.Source, volume.Solid)
    return [Geometry(names, faces, volume.FacesKept)] if faces else []


def _in_source(source: Any, number: int) -> dict[str, str]:
    return {own: name for name, own in face_names(source, number).items()}


@dataclass(frozen=True)
class _Row:
    face: str
    """In the source."""
    shown: str
    """In the table."""
    kind: str
    deviation: float
    patches: int


class GeometryForm:
    """The tolerance of patches, and a table of what each face became; its faces in colours.

    Parameters
    ----------
    form : QWidget
        The panel.
    source : App.DocumentObject
        The body.
    solids : sequence of Part.Solid
        Of the body.
    check : callable()
        The user wants to know about the faces.
    opened : callable()
        The coloured faces are to be seen, or not any more: :attr:`coloured` tells.
    """

    def __init__(
        self,
        form: Any,
        source: Any,
        solids: Sequence[Any],
        *,
        check: Callable[[], None],
        opened: Callable[[], None],
    ) -> None:
        self._form = form
        self._source = source
        self._document = source.Document.Name
        sizes = [TOLERANCE * solid.BoundBox.DiagonalLength for solid in solids]
        self._automatic = max(sizes, default=TOLERANCE)
        self._opened = opened
        self._rows: list[_Row] = []
        self._sentence = ""
        self._legend: list[tuple[str, str]] = []
        self._view: FaceKinds | None = None
        self._coloured = self._marking = self._closed = False
        self._tolerance = Length(form.coverTolerance, self.forget)
        self._tolerance.step(float(f"{self._automatic:.1g}"))
        self._table = FigureTable(form.geometryTable, COLUMNS, self._mark_faces)
        form.geometryCheck.clicked.connect(check)
        form.geometryColours.toggled.connect(lambda *_: self._update_view())
        form.geometryToggle.toggled.connect(self._open)
        FreeCADGui.Selection.addObserver(self)
        FreeCAD.addDocumentObserver(self)
        self._open(False)

    def close(self) -> None:
        """Show the body as it was."""
        if not self._closed:
            self._closed = True
            FreeCADGui.Selection.removeObserver(self)
            FreeCAD.removeDocumentObserver(self)
            self._leave_view()

    @property
    def values(self) -> dict[str, float]:
        """The property of a hybrid volume, by name; mm, 0: automatic."""
        return {"CoverTolerance": self._tolerance.value}

    @property
    def coloured(self) -> bool:
        """Whether the faces are to be seen in colours."""
        return self._coloured

    def show(self, values: Mapping[str, Any]) -> None:
        """Show the property."""
        self._tolerance.value = values["CoverTolerance"]
        self._tell()

    def show_geometry(self, found: Sequence[Geometry]) -> None:
        """Tell how faces are kept; nothing where there is nothing."""
        self._leave_view()
        several = len(found) > 1
        self._rows = [
            _Row(name, name if several else own, face.kind, face.deviation, face.patches)
            for one in found
            for own, face in one.faces.items()
            for name in (one.names.get(own, own),)
        ]
        self._sentence = "\n".join(one.sentence for one in found)
        kinds = [kind for kind in KINDS if any(row.kind == kind for row in self._rows)]
        self._legend = [(kind, self._legend_line(kind)) for kind in kinds]
        self._table.show([self._cells(row) for row in self._rows])
        self._table.sort(0)
        self._tell()
        self._update_view()

    def forget(self) -> None:
        """Nothing is known of the faces any more: body or tolerance are other ones."""
        self.show_geometry([])

    def _cells(self, row: _Row) -> list[tuple]:
        words, colour = KINDS[row.kind]
        words = words.removeprefix("within ")  # all columns are to be seen
        # of the others it is rounding
        off = row.deviation if row.kind == "tolerance" else 0.0
        return [
            *((row.shown, None), (words, float(list(KINDS).index(row.kind)), _swatch(colour))),
            *((f"{row.patches}", float(row.patches)), (f"{off:.2g}", off)),
        ]

    def _legend_line(self, kind: str) -> str:
        rows = [row for row in self._rows if row.kind == kind]
        words = f"{KINDS[kind][0]}: {len(rows)} {'face' if len(rows) == 1 else 'faces'}"
        if kind == "tolerance":
            words += f", off by {max(row.deviation for row in rows):.2g} mm at most"
        return words

    # The section.

    def open(self) -> None:
        """Open the section."""
        self._form.geometryToggle.setChecked(True)

    @property
    def summary(self) -> str:
        """What is known or asked, in a few words."""
        if self._rows:
            kinds = [row.kind for row in self._rows]
            return ", ".join(f"{kinds.count(kind)} {KINDS[kind][0]}" for kind, _ in self._legend)
        given = self._tolerance.value
        return f"exact, or within {given or self._automatic:.2g} mm"

    def _open(self, on: bool) -> None:
        form = self._form
        form.geometryToggle.setArrowType(QtCore.Qt.DownArrow if on else QtCore.Qt.RightArrow)
        form.geometryBox.setVisible(on)
        self._tell()
        self._update_view()

    def _tell(self) -> None:
        form = self._form
        closed = not form.geometryToggle.isChecked()
        form.geometryToggle.setText(f"Geometry: {self.summary}" if closed else "Geometry")
        form.coverAutomatic.setText(
            "" if self._tolerance.value else f"0: automatic, {self._automatic:.2g} mm"
        )
        form.geometryHint.setText(self._sentence or HINT)
        for widget in (form.geometryTable, form.geometryColours):
            widget.setVisible(bool(self._rows))

    # The view.

    def _update_view(self) -> None:
        form = self._form
        wanted = (
            *(not self._closed, bool(self._rows)),
            *(form.geometryToggle.isChecked(), form.geometryColours.isChecked()),
        )
        if all(wanted) and self._view is None and not is_deleted(self._source):
            # first the body is shown: one that was not seen since its file was opened has no nodes
            self._coloured = True
            self._opened()
            kinds = {row.face: row.kind for row in self._rows}
            self._view = FaceKinds(self._source, kinds, self._legend)
        elif not all(wanted):
            self._leave_view()

    def _leave_view(self) -> None:
        if self._view is not None:
            self._view.close()
            self._view = None
            self._coloured = False
            self._opened()

    # Table and selection say the same.

    def _mark_faces(self, rows: list[int]) -> None:
        if self._marking or is_deleted(self._source):
            return
        self._marking = True
        try:
            FreeCADGui.Selection.clearSelection(self._document)
            for row in rows:
                FreeCADGui.Selection.addSelection(
                    self._document, self._source.Name, self._rows[row].face
                )
        finally:
            self._marking = False

    def _follow(self) -> None:
        if self._marking or not self._rows or not self._form.geometryToggle.isChecked():
            return
        picked = {
            sub
            for one in FreeCADGui.Selection.getSelectionEx(self._document)
            if one.Object == self._source or one.Object == getattr(self._source, "Tip", None)
            for sub in one.SubElementNames
        }
        self._table.select([k for k, row in enumerate(self._rows) if row.face in picked])

    # What documents tell an observer.

    def slotChangedObject(self, obj: Any, name: str) -> None:
        """Forget what was found of a body that is another one now."""
        if name in ("Shape", "Placement") and self._rows and obj == self._source:
            self.forget()

    # What the selection tells an observer.

    def addSelection(self, document: str, name: str, sub: str, point: Any) -> None:
        """Mark the row of a face that is picked."""
        self._follow()

    def removeSelection(self, document: str, name: str, sub: str) -> None:
        """Follow."""
        self._follow()

    def setSelection(self, document: str) -> None:
        """Follow."""
        self._follow()

    def clearSelection(self, document: str) -> None:
        """Follow."""
        self._follow()


def _swatch(colour: tuple[float, float, float]) -> Any:
    picture = QtGui.QPixmap(12, 12)
    picture.fill(QtGui.QColor.fromRgbF(*colour))
    return QtGui.QIcon(picture)
