# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The question before a mesh file becomes bodies: what is in it, and which surface it means."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore, QtGui
from PySide.QtCore import QT_TRANSLATE_NOOP

from HybridVolume import mesh_import
from HybridVolume.errors import HybridVolumeError
from HybridVolume.objects.mesh_body import AS_NEEDED
from HybridVolume.sources.mesh_findings import MeshFindings, examine
from HybridVolume.sources.meshes import SCHEMES, STEPS
from HybridVolume.sources.polygon_files import SUFFIXES

from .analysis_commands import _Command
from .forms import load_form
from .macro import document_text
from .work import waiting

IMPORT = "HybridVolume_ImportMesh"
WIDTH = 520
"""Of the question, pixels."""

BUTTONS = {"bilinear": "bilinear", "catmull-clark": "catmullClark", "smooth": "smooth"}
"""Names in the form of each scheme."""
MANY = 10_000
"""Quads from which on the user is warned that it takes a while."""


class ImportMeshCommand(_Command):
    """Asks for mesh files, and for the scheme of each."""

    NAME = IMPORT
    MENU = QT_TRANSLATE_NOOP(IMPORT, "Import mesh")
    TIP = QT_TRANSLATE_NOOP(
        IMPORT,
        "Make bodies of NURBS faces from a closed mesh of quads or the cage of a subdivision "
        "surface (OBJ, OFF, PLY)",
    )

    def IsActive(self) -> bool:
        """Tell whether no panel is open; a document is made where there is none."""
        return not FreeCADGui.Control.activeDialog()

    def run(self) -> None:
        """Ask."""
        ask_for_files()


def ask_for_files() -> Any:
    """Ask for mesh files beside the living window.

    Returns
    -------
    QFileDialog
    """
    dialog = QtGui.QFileDialog(FreeCADGui.getMainWindow(), "Import mesh")
    dialog.setObjectName(IMPORT)
    dialog.setAttribute(QtCore.Qt.WA_DeleteOnClose)
    dialog.setFileMode(QtGui.QFileDialog.ExistingFiles)
    patterns = " ".join(f"*{suffix}" for suffix in SUFFIXES)
    dialog.setNameFilters([f"Meshes ({patterns})", "All files (*)"])
    active = FreeCAD.ActiveDocument
    if active is not None and active.FileName:
        dialog.setDirectory(str(Path(active.FileName).parent))
    document = active.Name if active is not None else ""

    def chosen(paths: list[str]) -> None:
        for path in paths:
            ask_soon(path, document)

    dialog.filesSelected.connect(chosen)
    dialog.open()
    return dialog


class Question:
    """The question about one file, beside the living window.

    Parameters
    ----------
    path : path
    document : str
        Name of the document that it goes to; empty: a new one.

    Attributes
    ----------
    path : Path
    findings : MeshFindings or None
        None before it is shown.
    dialog : QDialog or None
    """

    def __init__(self, path: str, document: str) -> None:
        self.path = Path(path)
        self.findings: MeshFindings | None = None
        self.dialog: Any | None = None
        self._document = document
        self._withdrawn = False

    def show(self, told: str = "", keywords: Mapping[str, Any] | None = None) -> None:
        """Look at the file and show what is in it.

        Parameters
        ----------
        told : str
            Why an answer could not be followed.
        keywords : mapping, optional
            That answer.
        """
        if self._withdrawn:
            _next()
            return
        if self.findings is None:
            with waiting():
                self.findings = examine(self.path)
        dialog = self.dialog = QtGui.QDialog(FreeCADGui.getMainWindow())
        dialog.setObjectName("HybridVolumeImportDialog")
        dialog.setAttribute(QtCore.Qt.WA_DeleteOnClose)
        dialog.setWindowTitle(f"Import mesh: {self.path.name}")
        self._form = load_form("import_mesh")
        self._buttons = QtGui.QDialogButtonBox(
            QtGui.QDialogButtonBox.Ok | QtGui.QDialogButtonBox.Cancel
        )
        self._buttons.button(QtGui.QDialogButtonBox.Ok).setText("Import")
        layout = QtGui.QVBoxLayout(dialog)
        layout.addWidget(self._form)
        layout.addWidget(self._buttons)
        self._fill(told, keywords or {})
        self._buttons.accepted.connect(dialog.accept)
        self._buttons.rejected.connect(dialog.reject)
        dialog.finished.connect(self._finished)
        dialog.setMinimumWidth(WIDTH)
        # as high as its sentences are at this width, and not as at the one that they would like
        dialog.resize(WIDTH, layout.heightForWidth(WIDTH))
        dialog.open()

    def withdraw(self) -> None:
        """Take the question back: the file is imported otherwise."""
        self._withdrawn = True
        if self.dialog is not None:
            self.dialog.reject()

    def _fill(self, told: str, keywords: Mapping[str, Any]) -> None:
        form, found = self._form, self.findings
        told = told or found.refusal
        lines = [*found.lines, *found.notes]
        form.found.setText("\n".join(lines))
        form.found.setVisible(bool(lines))
        form.refusal.setText(told)
        form.refusal.setVisible(bool(told))
        for scheme, name in BUTTONS.items():
            button, words = getattr(form, name), getattr(form, f"{name}Words")
            refused = found.refusals.get(scheme, "")
            button.setEnabled(not refused)
            words.setEnabled(not refused)
            if refused and not found.refusal:
                words.setText(f"Not for this mesh: {refused}")
            button.setChecked(scheme == keywords.get("scheme", found.scheme))
            button.toggled.connect(lambda *_: self._show_relevant())
        form.steps.setRange(AS_NEEDED, STEPS[1])
        form.steps.setValue(keywords.get("steps", AS_NEEDED))
        form.angle.setValue(keywords.get("sharp_angle", 0.0))
        form.steps.valueChanged.connect(lambda *_: self._show_relevant())
        form.angle.valueChanged.connect(lambda *_: self._show_relevant())
        ok = self._buttons.button(QtGui.QDialogButtonBox.Ok)
        ok.setEnabled(not found.refusal)
        ok.setToolTip(found.refusal)
        self._show_relevant()

    @property
    def scheme(self) -> str:
        """The scheme that is chosen; empty where the mesh is refused."""
        chosen = (s for s in SCHEMES[1:] if getattr(self._form, BUTTONS[s]).isChecked())
        return next(chosen, "")

    @property
    def keywords(self) -> dict[str, Any]:
        """What is asked of `HybridVolume.import_mesh`, without what does not count."""
        form, given = self._form, {"scheme": self.scheme}
        if self.scheme != "bilinear" and form.steps.value() != AS_NEEDED:
            given["steps"] = form.steps.value()
        if self.scheme == "catmull-clark" and form.angle.value():
            given["sharp_angle"] = form.angle.value()
        return given

    def _show_relevant(self) -> None:
        form, scheme, found = self._form, self.scheme, self.findings
        steps = scheme in ("catmull-clark", "smooth")
        for widget in (form.steps, form.stepsCaption):
            widget.setEnabled(steps)
        for widget in (form.angle, form.angleCaption, form.angleWords):
            widget.setEnabled(scheme == "catmull-clark")
        form.stepsWords.clear()
        form.angleWords.clear()
        if scheme:
            quads = found.quads(scheme, self.keywords.get("steps"))
            late = ": this takes a while" if quads > MANY else ""
            form.stepsWords.setText(f"{quads} quads{late}")
        if scheme == "catmull-clark" and form.angle.value():
            form.angleWords.setText(f"{found.sharper(form.angle.value())} edges turn by more")

    def _finished(self, result: int) -> None:
        mesh_import.answered(self)
        if result == QtGui.QDialog.Accepted and not self._withdrawn:
            keywords = self.keywords
            # Later: the question is still closing.
            QtCore.QTimer.singleShot(0, lambda: self._import(keywords))
        else:
            QtCore.QTimer.singleShot(0, _next)
        self.dialog = None

    def _import(self, keywords: dict[str, Any]) -> None:
        told = ""
        try:
            import_recorded(self.path, self._document, keywords)
        except HybridVolumeError as error:
            told = f"Not imported: {error.line}"
        finally:
            if told:
                mesh_import.asked(self)
                self.show(told, keywords)
            else:
                _next()


_waiting: list[Question] = []
_shown: list[Question] = []


def ask_soon(path: str, document: str) -> None:
    """Ask about a mesh file as soon as FreeCAD is idle, one after another.

    Parameters
    ----------
    path : path
    document : str
        Name of the document that it goes to; empty: a new one.
    """
    question = Question(path, document)
    mesh_import.asked(question)
    _waiting.append(question)
    # Later: FreeCAD shows its own waiting cursor, and holds a step of Undo open.
    QtCore.QTimer.singleShot(0, _begin)


def _begin() -> None:
    if not _shown and _waiting:
        question = _waiting.pop(0)
        _shown.append(question)
        try:
            question.show()
        except BaseException:
            _shown.clear()
            raise


def _next() -> None:
    _shown.clear()
    _begin()


def import_recorded(path: Path, document: str, keywords: dict[str, Any]) -> None:
    """Import a mesh file by a line for FreeCAD's macro recorder, and look at it.

    Parameters
    ----------
    path : Path
    document : str
        Name of a document; empty, or closed meanwhile: a new one.
    keywords : dict
        Of `HybridVolume.import_mesh`.

    Raises
    ------
    HybridVolumeError
        The mesh is refused; a document that was made for it is gone again.
    """
    doc = FreeCAD.listDocuments().get(document)
    first = doc is None or not doc.Objects
    # without a label FreeCAD 0.20 numbers it where there are other documents
    text = (
        document_text(doc) if doc is not None else f"App.newDocument({path.stem!r}, {path.stem!r})"
    )
    given = "".join(f", {name}={value!r}" for name, value in keywords.items())
    before = set(FreeCAD.listDocuments())
    with waiting():
        FreeCADGui.doCommand("import HybridVolume")
        try:
            FreeCADGui.doCommand(f"HybridVolume.import_mesh({str(path)!r}, {text}{given})")
        except HybridVolumeError:
            for name in set(FreeCAD.listDocuments()) - before:
                FreeCAD.closeDocument(name)
            raise
    # Later: the meshes are not drawn yet.
    QtCore.QTimer.singleShot(0, lambda: _look(isometric=first))


def _look(*, isometric: bool) -> None:
    """Show the whole document, from the corner where nobody has chosen a view yet."""
    doc = FreeCADGui.activeDocument()
    if doc is None or not hasattr(doc.activeView(), "fitAll"):
        return
    view = doc.activeView()
    moving = view.isAnimationEnabled()
    # the second of two flights would begin where the first is by then
    view.setAnimationEnabled(False)
    try:
        if isometric:
            view.viewIsometric()
        view.fitAll()
    finally:
        view.setAnimationEnabled(moving)
