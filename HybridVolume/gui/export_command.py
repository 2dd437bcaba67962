# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Export of the FEM mesh from the window.

FreeCAD's own export loses all but one kind of elements in VTK's formats, turns those inside out,
and forgets the groups in decks, all without a word.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore, QtGui
from PySide.QtCore import QT_TRANSLATE_NOOP

from HybridVolume.errors import HybridVolumeError, InputError

from . import messages
from .analysis_commands import _Command, object_text

EXPORT = "HybridVolume_Export"

FILTERS = {
    ".inp": "CalculiX or Abaqus (*.inp)",
    ".unv": "I-DEAS universal (*.unv)",
    ".med": "Salome, Code_Aster (*.med)",
    ".msh": "Gmsh 4.1 (*.msh)",
    ".vtu": "ParaView (*.vtu)",
    ".mesh": "MFEM: NURBS shell, core beside it (*.mesh)",
    ".xml": "G+Smo: NURBS shell, core beside it (*.xml)",
}
"""What the dialog offers, by ending."""

SHELLS = (".mesh", ".xml")
"""Endings of the shell's own formats; the others are of the finite element mesh."""


class ExportCommand(_Command):
    """Asks for a file and writes the mesh of the selected volume to it."""

    NAME = EXPORT
    MENU = QT_TRANSLATE_NOOP(EXPORT, "Export FEM mesh")
    TIP = QT_TRANSLATE_NOOP(
        EXPORT,
        "Write the FEM mesh of a completed volume with its groups to a file for CalculiX, "
        "Code_Aster, Gmsh, ParaView and others; every element of it, as FreeCAD's own export "
        "does not",
    )

    def run(self) -> None:
        """Ask."""
        from . import commands

        try:
            volume = commands.meant_volume()
        except InputError as error:
            messages.tell("Export FEM mesh", error.line)
            return
        ask(volume)


def ask(volume: Any) -> Any:
    """Ask for a file beside the living window; the answer writes it.

    Parameters
    ----------
    volume : App.DocumentObject
        A hybrid volume with a result.

    Returns
    -------
    QFileDialog
    """
    document, name = volume.Document.Name, volume.Name
    dialog = QtGui.QFileDialog(FreeCADGui.getMainWindow(), "Export FEM mesh")
    dialog.setObjectName(EXPORT)
    dialog.setAttribute(QtCore.Qt.WA_DeleteOnClose)
    dialog.setAcceptMode(QtGui.QFileDialog.AcceptSave)
    dialog.setNameFilters(list(FILTERS.values()))
    dialog.setDirectory(str(Path(volume.Document.FileName or Path.home() / "x").parent))
    suffixes = {words: suffix.removeprefix(".") for suffix, words in FILTERS.items()}
    # the ending that is added to a name without one: that of the kind that is chosen
    dialog.filterSelected.connect(lambda words: dialog.setDefaultSuffix(suffixes[words]))
    dialog.setDefaultSuffix(suffixes[dialog.selectedNameFilter()])
    body = volume.Source.Label if volume.Source else volume.Label
    dialog.selectFile(body)
    dialog.fileSelected.connect(lambda path: export(document, name, path))
    dialog.open()
    return dialog


def export(document: str, name: str, path: str) -> bool:
    """Write the mesh or the shell of a volume; say where it is, or why not.

    Returns
    -------
    bool
        Whether it was written.
    """
    volume = FreeCAD.getDocument(document).getObject(name)
    try:
        FreeCADGui.doCommand("import HybridVolume")
        what = "shell" if Path(path).suffix.lower() in SHELLS else "mesh"
        FreeCADGui.doCommand(f"HybridVolume.export_{what}({object_text(volume)}, {path!r})")
    except HybridVolumeError as error:
        messages.show_error(error, volume)
        return False
    except OSError as error:
        reason = error.strerror or error
        messages.tell("Export FEM mesh", f"{path} cannot be written: {reason}")
        return False
    text = f"The FEM mesh of {volume.Label} is in {path}"
    FreeCAD.Console.PrintMessage(text + "\n")
    FreeCADGui.getMainWindow().statusBar().showMessage(text, 20_000)
    return True
