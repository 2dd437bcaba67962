# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The panel of the midstructure: which sheets the shell grows towards, seen and decided by hand."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore, QtGui

from HybridVolume.core.midstructure.hints import hints
from HybridVolume.errors import HybridVolumeError
from HybridVolume.objects import midstructure as objects
from HybridVolume.sources import global_shape

from . import messages
from .clip import ClipControls
from .macro import Macro
from .panel import Panel
from .picking import (
    BoxSelection,
    SheetPicking,
    select_sheets,
    selected_sheets,
    sheets_in_box,
)
from .rule_sliders import RuleSliders, timer
from .search_controls import SearchControls
from .sheet_table import SheetTable
from .sheets_view import sheet_name
from .stage import Stage
from .undo import UndoMark
from .work import is_deleted


class MidstructurePanel(Panel):
    """Finds the midstructure of a volume in the worker, then lets the user choose its sheets.

    Parameters
    ----------
    volume : App.DocumentObject
        A hybrid volume with a midstructure.
    mark : UndoMark
        Where Cancel goes back to.
    goes_on : bool
        Whether OK opens the panel of the volume.

    Attributes
    ----------
    form : QWidget
        Its property ``previewSeconds`` tells what the last step of a slider took, with the view.
    """

    WIDTH = 460  # the table shows all but the end of its last column

    def __init__(self, volume: Any, mark: UndoMark, *, goes_on: bool = False) -> None:
        super().__init__("midstructure_panel", "HybridVolume_Midstructure")
        self._volume = volume
        self._obj = volume.Midstructure
        self._document = volume.Document.Name
        self._source = volume.Source
        self._names = (volume.Name, self._obj.Name, self._source.Name)
        self._mark = mark
        self._goes_on = goes_on
        self._macro = Macro(self._obj)
        self._macro.steps.update(volume.Document.UndoNames[:1] if goes_on else ())
        self._syncing = False
        self._box: BoxSelection | None = None
        self._refresh_soon = timer(self.form, 0, self._refresh)
        # the view is drawn first: hints take longer
        self._hint_soon = timer(self.form, 30, self._show_hints)
        self._rule = RuleSliders(self.form, self._preview, self._take_rule)
        self._table = SheetTable(self.form.sheets, self._toggle_row, self._select_rows)
        self._search = SearchControls(
            self.form, volume, self._macro, self._command, self._enable, self._show_thickness
        )
        self._fill_form()
        self._stage = self._make_stage()
        self._clip = ClipControls(self.form, self._looking, self._stage.cut)
        self._picking = SheetPicking(
            self._obj, self._click_sheet, self._selection_changed, self._hover
        )
        FreeCAD.addDocumentObserver(self)
        self._opened()
        self._refresh()

    # What FreeCAD asks a panel.

    def getStandardButtons(self) -> Any:
        """Return the buttons below the panel."""
        return QtGui.QDialogButtonBox.Ok | QtGui.QDialogButtonBox.Cancel

    def accept(self) -> bool:
        """Close; go on to the panel of the volume, where the panel belongs to its creation."""
        self._rule.finish()
        found = self._chosen()
        if found is None or not found.kept.any() or self.running:
            if self.running:
                reason = "The midstructure is still being computed. Wait, or press Cancel there."
            elif found is None:
                reason = "There is no midstructure yet. Press Find again, or Cancel."
            else:
                reason = (
                    "Nothing is kept, so the shell would have nothing to grow towards. "
                    "Keep at least one sheet, or press Automatic again."
                )
            self._warn(reason)
            messages.tell("Midstructure", reason)
            return False
        volume = self._volume
        self._close()
        self._mark.close()
        if self._goes_on:
            from . import commands

            # Later: FreeCAD is still closing this dialog.
            QtCore.QTimer.singleShot(0, lambda: commands.open_volume_panel(volume))
        return True

    def reject(self) -> bool:
        """Close, and undo all that was done since the panel was opened."""
        self._close()
        doc = FreeCAD.listDocuments().get(self._document)
        if doc is not None:
            self._mark.go_back(self._macro.steps)
        return True

    # Opening and closing.

    def _make_stage(self) -> Stage:
        volume = self._volume
        parts = (volume.Source, volume.Shell, volume.Core, volume.FemMesh, volume.AnalysisBody)
        shape = global_shape(volume.Source)
        if shape is not None and len(shape.Solids) >= volume.Solid:
            shape = shape.Solids[volume.Solid - 1]
        view = self._obj.ViewObject.Proxy
        view.draw(self._obj)
        return Stage(self._obj, view.scene, [part for part in parts if part is not None], shape)

    def _put_back(self) -> None:
        self._search.cancel()
        FreeCAD.removeDocumentObserver(self)
        if self._box:
            self._box.close()
        self._picking.close()
        self._stage.close()

    def _fill_form(self) -> None:
        form = self.form
        form.keep.clicked.connect(lambda: self._decide("keep"))
        form.remove.clicked.connect(lambda: self._decide("remove"))
        form.only.clicked.connect(lambda: self._decide("only"))
        form.invert.clicked.connect(lambda: self._decide("invert"))
        form.automatic.clicked.connect(lambda: self._command("automatic()"))
        form.box.toggled.connect(self._toggle_box)
        form.forget.clicked.connect(self._forget)
        form.exact.clicked.connect(self._compute_thickness)
        form.warning.hide()
        form.warning.setStyleSheet("color: #d9480f; font-weight: bold;")

    # What documents tell an observer.

    def slotChangedObject(self, obj: Any, name: str) -> None:
        """Follow changes of the midstructure, by whomever."""
        if obj.Document.Name == self._document and obj.Name in self._names:
            self._refresh_soon.start()

    def slotDeletedObject(self, obj: Any) -> None:
        """Close when the midstructure, its volume or the body goes."""
        if obj.Document.Name == self._document and obj.Name in self._names:
            QtCore.QTimer.singleShot(0, self._close_if_gone)

    def slotDeletedDocument(self, doc: Any) -> None:
        """Close with the document."""
        if doc.Name == self._document:
            self._close()
            self._mark.close()

    def _close_if_gone(self) -> None:
        if not self._closed and any(map(is_deleted, (self._obj, self._volume, self._source))):
            self._close()
            self._mark.close()

    # What is shown.

    def _chosen(self) -> Any | None:
        try:
            return objects.chosen(self._obj)
        except HybridVolumeError as error:
            self._warn(error.line)
            return None

    def _refresh(self) -> None:
        """Show what the properties say."""
        if self._closed or is_deleted(self._obj):
            return
        obj, form = self._obj, self.form
        found = self._chosen()
        self._syncing = True
        try:
            form.rule.setVisible(obj.Method in ("auto", "medial-axis"))
            self._rule.show(obj.Angle, obj.MinimumSize)
        finally:
            self._syncing = False
        self._search.show()
        self._picking.anything = self._search.by_user
        self._table.show(found)
        self._table.select(selected_sheets(obj))
        self._hint_soon.start()
        unmatched = list(obj.Unmatched)
        form.unmatchedBox.setVisible(bool(unmatched))
        form.unmatched.setText(
            f"No sheet fits these decisions any more: {', '.join(unmatched)}" if unmatched else ""
        )
        self._enable()

    def _show_hints(self) -> None:
        if self._closed or is_deleted(self._obj):
            return
        form, found = self.form, self._chosen()
        form.warning.hide()
        if found is None:
            form.hint.setText("")
            return
        told = hints(found, self._search.w0)
        kept = found.kept_sheets
        text = f"{kept} of {len(found.sheets)} sheets kept, in {_count(told.pieces, 'piece')}."
        if kept and told.thickest > 0.0:
            text += (
                f" Shell about {told.thinnest:.3g} to {told.thickest:.3g} mm thick "
                f"at w0 = {self._search.w0:.2g}."
            )
        form.hint.setText(text)
        if not kept:
            self._warn("Nothing is kept: keep at least one sheet.")
        elif told.unreached:
            self._warn("\n".join(_sentence(str(one)) for one in told.unreached[:3]))

    def _warn(self, text: str) -> None:
        self.form.warning.setText(text)
        self.form.warning.show()

    def _enable(self) -> None:
        form, running = self.form, self.running
        there = not running and bool(self._obj.Facets)
        for widget in (form.sheets, form.rule, form.exact, form.box, form.invert, form.automatic):
            widget.setEnabled(there)
        some = there and bool(self._table.selection())
        for widget in (form.keep, form.remove, form.only):
            widget.setEnabled(some)
        self._search.enable()

    @property
    def running(self) -> bool:
        """Whether a computation is under way."""
        return self._search.running

    def find(self) -> None:
        """Find the midstructure in the worker."""
        self._search.find()

    def _compute_thickness(self) -> None:
        self._rule.finish()
        self._search.compute_thickness()

    def _show_thickness(self, figures: dict[str, Any]) -> None:
        text = (
            f"Exact: {figures['min']:.3g} to {figures['max']:.3g} mm, "
            f"mean {figures['mean']:.3g} mm, at w0 = {figures['w0']:.2g}."
        )
        if figures["w0"] < self._search.w0 - 1e-9:
            text += f" A larger w0 than {figures['largest_w0']:.2g} cannot be reached."
        self._hint_soon.stop()
        self.form.hint.setText(text)

    # Angle and size.

    def _preview(self) -> None:
        """Show what the sliders would give; the document does not notice."""
        if self._closed:
            return
        began = time.perf_counter()
        found = objects.loaded(self._obj)
        if found is None:
            return
        angle, size = self._rule.values
        found = found.choose(angle=angle, minimum_size=size, decisions=tuple(self._obj.Decisions))
        self._obj.ViewObject.Proxy.preview(found)
        self._table.show(found)
        self.form.hint.setText(f"{found.kept_sheets} of {len(found.sheets)} sheets kept.")
        FreeCADGui.updateGui()
        self.form.setProperty("previewSeconds", time.perf_counter() - began)

    def _take_rule(self) -> None:
        """Take angle and size into the document, as one step of Undo."""
        if self._closed or is_deleted(self._obj):
            return
        changed = self._rule.changed_from(self._obj.Angle, self._obj.MinimumSize)
        if changed:
            self._command(f"set({', '.join(f'{k}={v:g}' for k, v in changed.items())})")
        else:
            self._obj.ViewObject.Proxy.draw(self._obj)
            self._refresh_soon.start()

    # Sheets.

    def _click_sheet(self, number: int) -> None:
        found = self._chosen()
        if found is not None and not self.running:
            self._decide("remove" if found.sheets[number].kept else "keep", [number])

    def _toggle_row(self, number: int, kept: bool) -> None:
        self._decide("keep" if kept else "remove", [number])

    def _decide(self, action: str, numbers: Sequence[int] | None = None) -> None:
        found = self._chosen()
        if found is None:
            return
        if numbers is None:
            numbers = self._table.selection()
        if not numbers and action != "invert":
            return
        self._rule.finish()
        self._command(self._macro.decision(action, [found.sheets[k] for k in numbers]))

    def _forget(self) -> None:
        self._command("forget()")

    def _command(self, call: str) -> bool:
        """Run a method of the editor so that macros record it; whether it went well."""
        try:
            self._macro.run(call)
        except HybridVolumeError as error:
            self._refresh()
            self._hint_soon.stop()
            self._warn(error.line)
            return False
        self._refresh_soon.start()
        return True

    def _select_rows(self, numbers: list[int]) -> None:
        self._syncing = True
        try:
            select_sheets(self._obj, numbers)
        finally:
            self._syncing = False
        self._enable()

    def _selection_changed(self) -> None:
        if not self._syncing and not is_deleted(self._obj):
            self._table.select(selected_sheets(self._obj))
            self._enable()

    def _hover(self, number: int | None) -> None:
        found = self._chosen() if number is not None else None
        if found is not None and number < len(found.sheets):
            sheet = found.sheets[number]
            what = "click to remove" if sheet.kept else "click to bring back"
            text = f"{sheet_name(number)} ({' + '.join(sheet.faces)}): {sheet.reason}; {what}"
            FreeCADGui.getMainWindow().statusBar().showMessage(text, 4000)

    def _toggle_box(self, on: bool) -> None:
        if self._box:
            self._box.close()
            self._box = None
        if on:
            view = FreeCADGui.getDocument(self._document).activeView()
            self._box = BoxSelection(view, lambda box: self._take_box(view, box))

    def _take_box(self, view: Any, box: tuple[float, ...] | None) -> None:
        self._box = None
        self.form.box.setChecked(False)
        found = self._chosen()
        if box is not None and found is not None:
            numbers = sheets_in_box(view, found.vertices, found.facets, found.sheet, box)
            select_sheets(self._obj, numbers)

    # The view.

    def _looking(self) -> tuple[float, float, float]:
        view = FreeCADGui.getDocument(self._document).activeView()
        return tuple(view.getViewDirection())


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."
