# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""CalculiX beside the living window: FreeCAD writes its input and reads its results."""

from __future__ import annotations

import os
import tempfile
from typing import Any

import FreeCAD
import FreeCADGui
from PySide import QtCore, QtGui

import HybridVolume
from HybridVolume.errors import HybridVolumeError, InputError

from . import messages
from .analysis_commands import object_text, refuse, show_result
from .work import is_deleted, waiting

_running: SolveRun | None = None


def start(analysis: Any) -> SolveRun | None:
    """Check an analysis and begin to solve it; None where it is refused, which is then told.

    Parameters
    ----------
    analysis : App.DocumentObject
    """
    global _running
    from HybridVolume.objects.analysis import problems

    if _running is not None:
        messages.tell("Solve", "CalculiX is at work already. Wait, or press Cancel there.")
        return None
    with waiting():
        found = problems(analysis)
    if found:
        refuse(found[0], analysis)
        for other in found[1:]:
            FreeCAD.Console.PrintError(f"{analysis.Label}: {other.line}\n")
        return None
    try:
        _running = SolveRun(analysis)
    except HybridVolumeError as error:
        refuse(error, analysis)
        return None
    return _running


class SolveRun(QtCore.QObject):
    """One run of CalculiX, with a window that says so and has a Cancel.

    Parameters
    ----------
    analysis : App.DocumentObject

    Raises
    ------
    InputError
        The FEM workbench complains of the analysis.
    """

    def __init__(self, analysis: Any) -> None:
        super().__init__()
        from HybridVolume.objects.analysis import find_calculix, mesh_in, prepare_run

        self._analysis = analysis
        self._closed = False
        self._folder = tempfile.TemporaryDirectory(prefix="hybridvolume_")
        try:
            with waiting():
                self._run = prepare_run(analysis, self._folder.name)
        except BaseException:
            self._folder.cleanup()
            raise
        nodes = mesh_in(analysis).FemMesh.NodeCount
        self._window = QtGui.QProgressDialog(
            f"CalculiX solves {analysis.Label}, {nodes} nodes.",
            *("Cancel", 0, 0),
            FreeCADGui.getMainWindow(),
        )
        self._window.setWindowTitle(messages.TITLE)
        self._window.setMinimumDuration(0)
        self._window.canceled.connect(self._cancel)
        self._window.show()
        self._process = QtCore.QProcess(self)
        variables = QtCore.QProcessEnvironment.systemEnvironment()
        variables.insert("OMP_NUM_THREADS", str(os.cpu_count() or 1))
        self._process.setProcessEnvironment(variables)
        self._process.setWorkingDirectory(self._folder.name)
        self._process.finished.connect(self._finish)
        self._process.errorOccurred.connect(self._not_started)
        name = os.path.splitext(os.path.basename(self._run.inp_file_name))[0]
        self._process.start(find_calculix(), ["-i", name])

    def _cancel(self) -> None:
        if not self._closed:
            self._closed = True
            self._process.kill()
            self._process.waitForFinished(5000)
            self._close()

    def _close(self) -> None:
        global _running
        _running = None
        # the window says that it is cancelled when it is closed, and the process that it ended
        self._closed = True
        self._window.close()
        self._window.deleteLater()
        self._folder.cleanup()

    def _not_started(self, error: Any) -> None:
        if error == QtCore.QProcess.FailedToStart:
            reason = self._process.errorString()
            self._close()
            refused = InputError(
                f"CalculiX does not start: {reason}",
                remedy="name the program under Edit > Preferences > FEM > CalculiX",
            )
            messages.show_error(refused, self._analysis)

    def _finish(self, code: int, *_: Any) -> None:
        from HybridVolume.objects.analysis import take_results

        if self._closed:
            return
        analysis, run = self._analysis, self._run
        said = bytes(self._process.readAllStandardOutput()).decode(errors="replace")
        if is_deleted(analysis):
            self._close()
            return
        crashed = self._process.exitStatus() == QtCore.QProcess.CrashExit
        failed = crashed or code != 0 or "*ERROR" in said
        # this once the solver has done already what the line asks for
        HybridVolume.solve = lambda *_: take_results(analysis, run, failed=failed)
        try:
            with waiting():
                FreeCADGui.doCommand("import HybridVolume")
                FreeCADGui.doCommand(f"HybridVolume.solve({object_text(analysis)})")
        except HybridVolumeError as error:
            self._close()
            for line in said.splitlines():
                if "ERROR" in line or "WARNING" in line:
                    FreeCAD.Console.PrintError(f"CalculiX: {line.strip()}\n")
            refuse(error, analysis)
            return
        finally:
            del HybridVolume.solve
        self._close()
        show_result(analysis)
