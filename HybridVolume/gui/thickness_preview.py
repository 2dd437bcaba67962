# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The inner boundary that follows the slider: its field from the worker, its pictures from here."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import FreeCAD
import FreeCADGui
import numpy as np
from PySide import QtCore, QtGui

from HybridVolume.errors import HybridVolumeError
from HybridVolume.job import Job
from HybridVolume.objects.volume import CHILDREN, inputs_of, source_fingerprint

from .colour_scale import packed, thickness_scale
from .isosurface_view import IsosurfaceView
from .rule_sliders import timer
from .runner import Callbacks, Runner
from .work import environment_setup, is_deleted

if TYPE_CHECKING:
    from HybridVolume.core.field_view import FieldView, Inner
    from HybridVolume.core.goals import Thickness
    from HybridVolume.sources import Covering

COLOURS = ("by thickness", "plain")
PLAIN = (0.22, 0.48, 0.84)
WRONG = (0.86, 0.12, 0.10)
"""Of an inner boundary that no shell can reach, as it does not look like the body."""
SETTINGS_OF_FIELD = ("Midstructure.", "Tolerance", "CoverTolerance", "Source")
"""Beginnings of the names of what a field depends on."""


class ThicknessPreview:
    """Shows what the thickness means before anything is computed with it.

    Parameters
    ----------
    form : QWidget
        The panel. Its property ``previewSeconds`` tells what the last step of a slider took, with
        the view.
    source : App.DocumentObject
        The body.
    volume : App.DocumentObject or None
    thickness : callable() -> Thickness
        What the panel asks for now.
    parameters : callable() -> dict
        What the panel would compute with now.
    cover : callable(parameters) -> sequence of Covering
        What has to be done before that job can be made.
    make_job : callable(parameters) -> Job
        A job of the goal ``thickness``.
    callbacks : Callbacks
        Of the panel: ``progress`` and ``failed`` are used.
    changed : callable()
        A computation began or ended, or the field is there.
    """

    def __init__(
        self,
        form: Any,
        source: Any,
        volume: Any | None,
        *,
        thickness: Callable[[], Thickness],
        parameters: Callable[[], Mapping[str, Any]],
        cover: Callable[[Mapping[str, Any]], Sequence[Covering]],
        make_job: Callable[[Mapping[str, Any]], Job],
        callbacks: Callbacks,
        changed: Callable[[], None],
    ) -> None:
        self._form = form
        self._source = source
        self._volume = volume
        self._names = {source.Name, *([volume.Midstructure.Name] if volume else [])}
        self._document = source.Document.Name
        self._thickness = thickness
        self._parameters = parameters
        self._cover = cover
        self._make_job = make_job
        self._callbacks = callbacks
        self._changed = changed
        self._field: FieldView | None = None
        self._field_of: dict[str, str] = {}
        self._view: IsosurfaceView | None = None
        self._picking = False
        self._closed = False
        self._runner = Runner(
            Callbacks(callbacks.progress, lambda _: None, self._finish, self._fail)
        )
        self._draw_soon = timer(form, 0, self._draw)
        self._check_soon = timer(form, 0, self._check)
        form.colour.addItems(COLOURS)
        form.colour.activated.connect(lambda *_: self._draw_soon.start())
        form.showInner.toggled.connect(self._toggle)
        form.legend.setPixmap(_legend())
        FreeCAD.addDocumentObserver(self)
        self.tell("", "")

    # What the panel does with it.

    @property
    def running(self) -> bool:
        """Whether the field is being computed."""
        return self._runner.running

    @property
    def field(self) -> FieldView | None:
        """The field, once it is there."""
        return self._field

    @property
    def shown(self) -> bool:
        """Whether the inner boundary is to be seen."""
        return self._form.showInner.isChecked()

    def update(self) -> None:
        """Follow the panel's values."""
        if not self._closed and self.shown and self._field is not None:
            self._draw_soon.start()

    def show_body(self, on: bool) -> None:
        """Show the body where it is hidden, so that its faces can be picked."""
        self._picking = on
        self._update_view()

    def cancel(self) -> None:
        """Stop computing the field."""
        if self.running:
            self._runner.cancel()
            self._uncheck()
            self._changed()

    def hide(self) -> None:
        """Show the 3D view as it was."""
        self._uncheck()

    def close(self) -> None:
        """Put everything back."""
        if not self._closed:
            self._closed = True
            self._runner.cancel()
            FreeCAD.removeDocumentObserver(self)
            self._picking = False
            if self._view:
                self._view.close()
                self._view = None

    # The field.

    def _toggle(self, on: bool) -> None:
        if not on:
            self._runner.cancel()
            self.tell("", "")
            self._update_view()
            self._changed()
        elif self._field is not None and self._field_of == self._depends_on():
            self._draw()
        else:
            self._begin()

    def _depends_on(self) -> dict[str, str]:
        """What the field is computed from, as text by name."""
        texts = {**inputs_of(self._parameters()), "Source": source_fingerprint(self._source)}
        return {k: text for k, text in texts.items() if k.startswith(SETTINGS_OF_FIELD)}

    def _begin(self) -> None:
        self._field = None
        try:
            setup = environment_setup()
            if setup is False:
                self._uncheck()
                return
            self._field_of = self._depends_on()
            parameters = dict(self._parameters())
            self._runner.start(
                lambda: [self._make_job(parameters)], setup, lambda: self._cover(parameters)
            )
        except HybridVolumeError as error:
            self._fail(error, "")
            return
        self.tell("Computing the field of the body...", "")
        self._changed()

    def _finish(self, jobs: Sequence[Job]) -> None:
        from HybridVolume.core.field_view import FieldView

        (job,) = jobs
        try:
            self._field = FieldView.load(job.field_file)
        except HybridVolumeError as error:
            self._fail(error, "")
            return
        self._changed()
        self._draw()

    def _fail(self, error: HybridVolumeError, log: str) -> None:
        self._uncheck()
        self._callbacks.failed(error, log)

    def _uncheck(self) -> None:
        self._form.showInner.setChecked(False)

    def _check(self) -> None:
        """Drop a field whose body or midstructure is another one now."""
        if self._closed or self._field is None or is_deleted(self._source):
            return
        if self._volume is not None and is_deleted(self._volume):
            return
        if self._field_of != self._depends_on():
            self._field = None
            shown = self.shown
            self._uncheck()
            if shown:
                self.tell("", "Body or midstructure changed: show the inner boundary again.")

    # What documents tell an observer.

    def slotChangedObject(self, obj: Any, name: str) -> None:
        """Look whether the field is still that of the body."""
        if obj.Name in self._names and obj.Document.Name == self._document:
            self._check_soon.start()

    def slotDeletedObject(self, obj: Any) -> None:
        """Show the 3D view as it was when the body goes."""
        if obj.Name in self._names and obj.Document.Name == self._document:
            self._uncheck()

    def slotDeletedDocument(self, doc: Any) -> None:
        """Let go of the document's view."""
        if doc.Name == self._document:
            self.close()

    # What is seen.

    def _update_view(self) -> None:
        drawn = self.shown and self._field is not None
        needed = not self._closed and (drawn or self._picking)
        if needed and self._view is None and not is_deleted(self._source):
            self._view = IsosurfaceView(self._source, self._in_the_way())
        elif not needed and self._view is not None:
            self._view.close()
            self._view = None
        if self._view and not drawn:
            self._view.clear()

    def _in_the_way(self) -> list[Any]:
        if self._volume is None or is_deleted(self._volume):
            return []
        names = [*CHILDREN, "AnalysisBody"]
        parts = [getattr(self._volume, name, None) for name in names if name != "Midstructure"]
        return [part for part in parts if part is not None]

    def _draw(self) -> None:
        if self._closed or not self.shown or self._field is None:
            return
        began = time.perf_counter()
        try:
            thickness = self._thickness()
        except HybridVolumeError as error:
            self.tell("", error.line)
            return
        self._unselect_body()
        self._update_view()
        inner = self._field.inner(thickness)
        figures, warning, wrong = self._sentences(thickness, inner)
        top = float(self._field.distance.max())
        plain = self._form.colour.currentIndex() == 1
        if wrong or plain:
            colours = packed(np.tile(WRONG if wrong else PLAIN, (len(inner.vertices), 1)))
        else:
            colours = thickness_scale(top).packed(inner.distance)
        self._view.show(inner, colours)
        self.tell(figures, warning, wrong=wrong)
        self._show_legend(not (wrong or plain), top)
        FreeCADGui.updateGui()
        self._form.setProperty("previewSeconds", time.perf_counter() - began)

    def _unselect_body(self) -> None:
        """A body that is selected as a whole, as it is when the panel opens, hides what is in it.

        Selected faces stay so.
        """
        for one in FreeCADGui.Selection.getSelectionEx(self._document):
            if not one.SubElementNames:
                FreeCADGui.Selection.removeSelection(one.Object)

    def _sentences(self, thickness: Thickness, inner: Inner) -> tuple[str, str, bool]:
        """Figures, a warning, and whether no shell can look like that."""
        field = self._field
        least, mean, most = field.figures(inner)
        if most - least < 0.01 * most:
            text = f"Shell {_figure(mean)} mm thick."
        else:
            most_and_mean = f"{_figure(most)} mm thick, {_figure(mean)} mm in the mean."
            text = f"Shell {_figure(least)} to {most_and_mean}"
        level = field.level(thickness)
        if level is None:
            share, faces = field.short(thickness, inner)
            where = f" ({_listed(faces)})" if faces and share < 0.9 else ""
            warning = (
                f"The body is too thin for that on {100 * share:.0f} % of its surface{where}: "
                "the shell is thinner there."
            )
            return text, warning if share > 0.01 else "", False
        if thickness.kind == "w0":
            genus = field.genus_at(thickness) if level > field.largest_w0 else field.genus
            wrong = not field.same_genus(genus)
            return text, _genus_sentence(field, level, genus) if wrong else "", wrong
        text += f" That is w0 = {level:.2f}."
        reached = mean if thickness.kind == "mean" else least
        if reached < 0.97 * thickness.value:
            return text, f"The body is too thin for {thickness}: this is the most.", False
        return text, "", False

    def tell(self, figures: str, warning: str, *, wrong: bool = False) -> None:
        """Say something about the thickness, below it.

        Parameters
        ----------
        figures, warning : str
            Empty ones are not shown.
        wrong : bool
            Whether no shell can be like that: red instead of orange.
        """
        form = self._form
        colour = "#c92a2a" if wrong else "#d9480f"
        form.warning.setStyleSheet(f"color: {colour}; font-weight: bold;")
        for label, text in ((form.figures, figures), (form.warning, warning)):
            label.setText(text)
            label.setVisible(bool(text))
        if not figures or self.running:
            self._show_legend(False, 0.0)

    def _show_legend(self, on: bool, top: float) -> None:
        form = self._form
        for widget in (form.legendLow, form.legend, form.legendHigh):
            widget.setVisible(on)
        form.legendLow.setText("0")
        form.legendHigh.setText(f"{_figure(top)} mm")


def _genus_sentence(field: FieldView, level: float, genus: Sequence[int]) -> str:
    """Why no shell can reach a level."""
    body = field.genus.tolist()
    if len(genus) > len(body):
        what = f"falls into {len(genus) - len(body) + 1} pieces"
    elif len(genus) < len(body):
        what = f"has {len(genus)} parts, the body {len(body)}"
    else:
        what = f"has genus {_words(genus)}, the body {_words(body)}"
    stop, at = field.stops_at(level), f"At w0 = {level:.2f} the inner boundary {what}"
    if stop < level:
        return f"{at}: the shell will stop at {stop:.2f}."
    return f"{at}. The shell is drawn to there all the same."


def _figure(value: float) -> str:
    """Three digits, without powers of ten as far as people do without."""
    return f"{float(f'{value:.3g}'):.7g}"


def _words(genus: Sequence[int]) -> str:
    return ", ".join(str(g) for g in sorted(genus))


def _listed(faces: Sequence[str], most: int = 4) -> str:
    more = len(faces) - most
    return ", ".join(faces[:most]) + (f" and {more} more" if more > 0 else "")


def _legend() -> Any:
    """The scale of colours as a picture."""
    picture = QtGui.QPixmap(200, 10)
    gradient = QtGui.QLinearGradient(0, 0, picture.width(), 0)
    for place, colour in thickness_scale(1.0).stops:
        gradient.setColorAt(place, QtGui.QColor.fromRgbF(*colour))
    painter = QtGui.QPainter(picture)
    painter.fillRect(QtCore.QRect(QtCore.QPoint(), picture.size()), QtGui.QBrush(gradient))
    painter.end()
    return picture
