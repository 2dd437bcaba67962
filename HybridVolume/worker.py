# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The worker process: ``python -m HybridVolume.worker FOLDER``; see :mod:`.protocol`.

Ends with 0 when the result is written, 2 for an input that is refused, 1 for a fault.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import signal
import sys
import threading
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from HybridVolume import protocol
from HybridVolume.errors import FaultError, HybridVolumeError, InputError, SetupError

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume
    from HybridVolume.core.pipeline import Options
    from HybridVolume.core.surface import PatchSurface

logger = logging.getLogger(__name__)


class Channel:
    """The line of JSON objects to the process that started this one."""

    def __init__(self) -> None:
        # Meshers print what they like on descriptor 1: it becomes the log, and the lines of the
        # protocol go through a copy that no child inherits.
        self._file: TextIO = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
        os.dup2(2, 1)
        self._lock = threading.Lock()

    def send(self, **values: Any) -> None:
        """Write one object; a reader that is gone is no fault, the watch on the input ends us."""
        with self._lock, contextlib.suppress(BrokenPipeError):
            self._file.write(json.dumps(values) + "\n")
            self._file.flush()

    def progress(self, stage: str, fraction: float, text: str = "") -> None:
        """Tell how far the work is."""
        logger.info("%s %.3f %s", stage, fraction, text)
        self.send(stage=stage, fraction=float(fraction), text=text)


class Stopwatch:
    """Seconds spent in each stage, told apart by the progress that is reported."""

    def __init__(self, progress: Any) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress
        self._stage: str | None = None
        self._since = time.perf_counter()

    def __call__(self, stage: str, fraction: float, text: str = "") -> None:
        self.enter(stage)
        self._progress(stage, fraction, text)

    def enter(self, stage: str | None) -> None:
        """Close the running stage and open another (None: the end)."""
        if stage == self._stage:
            return
        now = time.perf_counter()
        if self._stage is not None:
            spent = self.seconds.get(self._stage, 0.0) + now - self._since
            self.seconds[self._stage] = spent
        self._stage, self._since = stage, now


def work(folder: Path, channel: Channel) -> None:
    """Read the job, go as far as its goal, write the answer's files.

    Raises
    ------
    HybridVolumeError
    """
    from HybridVolume import report
    from HybridVolume.core.pipeline import Options

    task = json.loads((folder / protocol.OPTIONS_FILE).read_text(encoding="utf-8"))
    if task["protocol"] != protocol.PROTOCOL:
        raise FaultError(f"the job speaks protocol {task['protocol']}, not {protocol.PROTOCOL}")
    watch = Stopwatch(channel.progress)
    options = Options(**task["options"])
    if task["elements"] == "hex20" and options.order == 1:
        raise InputError("hexahedra have the order 2", remedy="leave the order 1 or the hexahedra")
    if task["goal"] == "mesh":
        figures = _mesh(folder, task, options, watch)
    else:
        surface, own = _body(folder, options, watch)
        reach = {"volume": _volume, "midstructure": _midstructure, "thickness": _thickness}
        figures = reach[task["goal"]](folder, task, surface, options, own, watch)
    report.write(figures, folder / protocol.REPORT_FILE)


def _body(folder: Path, options: Options, watch: Stopwatch) -> tuple[PatchSurface, Any]:
    """The closed surface, and the user's own geometry for the midstructure where there is some."""
    from HybridVolume import exchange
    from HybridVolume.core.assembly import build_surface

    watch("surface", 0.0, "pairing and welding the faces")
    faces = exchange.read_surface(folder / protocol.SURFACE_FILE)
    return build_surface(faces, options.tolerance), exchange.read_own(folder / protocol.OWN_FILE)


def _volume(
    folder: Path, task: dict, surface: PatchSurface, options: Options, own: Any, watch: Stopwatch
) -> dict[str, Any]:
    from HybridVolume import report
    from HybridVolume.core.pipeline import complete

    # pictures show the field, which the result does not hold
    made: dict[str, Any] = {}
    drawn = "pictures" in task["exports"]
    volume = complete(surface, options, watch, own, made.__setitem__ if drawn else None)
    further = _write(folder, task, volume, watch)
    pictures: list[str] = []
    if drawn:
        from HybridVolume.exports.pictures import write_pictures

        watch("pictures", 0.985, "drawing")
        pictures = write_pictures(folder, task["name"], volume, made["field"])
    watch.enter(None)
    figures = report.volume_report(volume, source=task["source"], seconds=watch.seconds)
    figures["fem"] |= further
    return {**figures, "pictures": pictures} if drawn else figures


def _mesh(folder: Path, task: dict, options: Options, watch: Stopwatch) -> dict[str, Any]:
    """Another mesh of a volume whose shell stays."""
    from HybridVolume import report
    from HybridVolume.core import hybrid
    from HybridVolume.core.goals import check_faces
    from HybridVolume.core.remesh import remesh

    watch("surface", 0.0, "reading the shell")
    volume = hybrid.load(folder / protocol.VOLUME_FILE)
    check_faces(options.face_sizes, volume.surface)
    watch("interior", 0.1, "interface, core, FEM mesh")
    volume = remesh(volume, options.density, order=options.order, engine=options.engine)
    further = _write(folder, task, volume, watch)
    watch.enter(None)
    figures = report.volume_report(volume, source=task["source"], seconds=watch.seconds)
    figures["fem"] |= further
    return figures


def _write(folder: Path, task: dict, volume: HybridVolume, watch: Stopwatch) -> dict[str, Any]:
    """Write the result and all exports but the pictures of the stages.

    Returns
    -------
    dict
        What is to be told about the exports with the mesh.
    """
    told: dict[str, Any] = {}
    watch("exports", 0.93, "writing the result")
    volume.save(folder / protocol.RESULT_FILE)
    for number, export in enumerate(task["exports"]):
        if export == "pictures":
            continue
        file = protocol.exported_files(task["name"], export)[0]
        watch("exports", 0.94 + 0.005 * number, f"writing {file}")
        told |= write_export(volume, export, folder / file, task["elements"])
    return told


def _midstructure(
    folder: Path, task: dict, surface: PatchSurface, options: Options, own: Any, watch: Stopwatch
) -> dict[str, Any]:
    from HybridVolume import report
    from HybridVolume.core.hybrid import save_midstructure
    from HybridVolume.core.pipeline import midstructure_stage

    stage = midstructure_stage(surface, options, watch, own)
    watch("exports", 0.95, f"{len(stage.midstructure.sheets)} sheets; writing them")
    save_midstructure(stage.midstructure, folder / protocol.RESULT_FILE)
    watch.enter(None)
    return report.stage_report(stage, options, task["source"], watch.seconds)


def _thickness(
    folder: Path, task: dict, surface: PatchSurface, options: Options, own: Any, watch: Stopwatch
) -> dict[str, Any]:
    from HybridVolume import report
    from HybridVolume.core.field_view import FieldView
    from HybridVolume.core.pipeline import thickness

    stage, field, figures = thickness(surface, options, watch, own)
    watch("exports", 0.95, "writing the field")
    FieldView.of(field, stage.surface).save(folder / protocol.FIELD_FILE)
    watch.enter(None)
    part = report.stage_report(stage, options, task["source"], watch.seconds)
    return {**part, "thickness": figures}


def write_export(
    volume: HybridVolume, export: str, path: Path, elements: str = "wedges"
) -> dict[str, Any]:
    """Write one export: of :data:`HybridVolume.protocol.EXPORTS`, shell or core for other solvers.

    Parameters
    ----------
    volume : HybridVolume
    export : {"vtu", "inp", "png", "mfem", "gismo", "core"}
    path : Path
        The first of its files.
    elements : {"wedges", "hex20"}
        Of the shell in an .inp file.

    Returns
    -------
    dict
        ``hexahedra`` or ``solver_core``, the figures of the mesh in the file where it is not the
        volume's own.
    """
    if export == "vtu":
        from HybridVolume.exports.vtu import write_vtu

        write_vtu(path, volume)
    elif export == "inp":
        from HybridVolume.exports.inp import write_inp

        mesh = volume.fem
        if elements == "hex20":
            from HybridVolume.core.hexahedra import hexahedral_mesh

            mesh = hexahedral_mesh(volume.fem, volume.interface)
        write_inp(path, mesh, title=path.stem)
        return {"hexahedra": mesh.figures()} if mesh is not volume.fem else {}
    elif export == "png":
        from HybridVolume.exports.picture import write_picture

        write_picture(path, volume)
    elif export in protocol.SHELL_EXPORTS:
        from HybridVolume.exports.solver_files import write_shell

        write_shell(path, volume)
    elif export == "core":
        from HybridVolume.exports.solver_files import write_core_files

        stem = path.name.removesuffix(protocol.CORE_FILES[0].format(""))
        # what took minutes is not lost because tetrahedra cannot be curved
        _, figures = write_core_files(path.parent, stem, volume, volume.fem.order, straight=True)
        return {"solver_core": figures}
    else:
        raise ValueError(f"no export {export!r}")
    return {}


def die_with_parent() -> None:
    """End this process and its children when the process that started it is gone.

    The parent holds the other end of our input: reading it returns only when the parent closes it
    or dies, even by SIGKILL.
    """

    def watch() -> None:
        while os.read(0, 4096):
            pass
        if os.name == "posix":
            os.killpg(0, signal.SIGKILL)
        os._exit(1)

    if os.name == "posix" and os.getpgrp() != os.getpid():
        # Started by hand in a terminal: the group is the shell's, and the input a keyboard.
        return
    threading.Thread(target=watch, daemon=True).start()


def main(arguments: list[str] | None = None) -> int:
    """Run one job; return the exit code."""
    (folder,) = sys.argv[1:] if arguments is None else arguments
    channel = Channel()
    die_with_parent()
    logging.basicConfig(level=logging.INFO, format="%(relativeCreated)7d %(name)s: %(message)s")
    try:
        work(Path(folder), channel)
    except HybridVolumeError as error:
        code = protocol.exit_code(error)
        if code == 1:
            traceback.print_exc()
        channel.send(error=error.to_dict())
        return code
    except ModuleNotFoundError as missing:
        traceback.print_exc()
        error = SetupError(
            f"the worker's Python {sys.executable} has no {missing.name}",
            remedy="run ./run.sh once or open Preferences > HybridVolume",
        )
        channel.send(error=error.to_dict())
        return 1
    except Exception as fault:
        traceback.print_exc()
        where = traceback.extract_tb(fault.__traceback__)[-1]
        place = f"{Path(where.filename).name}:{where.lineno}"
        text = f"{type(fault).__name__} in {place}: {fault}".replace("\n", " ")
        error = FaultError(text, remedy="report it together with the input")
        channel.send(error=error.to_dict())
        return 1
    channel.send(done=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
