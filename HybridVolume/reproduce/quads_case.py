# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One case of ``./run.sh reproduce quads`` in a process of its own.

``python -m HybridVolume.reproduce.quads_case FOLDER`` with the files of a
:class:`HybridVolume.job.Job`, in FreeCAD's Python. The case is a file as soon as it is finished.
"""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from HybridVolume import protocol
from HybridVolume.completion import Screen
from HybridVolume.errors import WorkerError
from HybridVolume.job import Job, Progress
from HybridVolume.worker import Channel

from .cases import case_main, processor_seconds, told
from .quads_clock import StageClock
from .quads_shell import FIGURES_FILE

logger = logging.getLogger(__name__)


class ShellJob(Job):
    """The shell of a body, without a core."""

    module = "HybridVolume.reproduce.quads_shell"

    def answers(self) -> list[str]:
        """The figures."""
        return [FIGURES_FILE]


class _ClockScreen(Screen):
    """Tells the progress to the process that waits, and the time of each stage to a clock."""

    def __init__(self, channel: Channel, clock: StageClock) -> None:
        super().__init__()
        self._channel, self._clock = channel, clock

    def progress(self, name: str, news: Progress) -> None:
        self._clock.stage(news.stage)
        self._channel.progress(news.stage, news.fraction, news.text)


def _whole(task: Mapping[str, Any], channel: Channel) -> dict[str, Any]:
    """The whole way from a file to all files, as the command line goes it."""
    from HybridVolume.completion import complete_file
    from HybridVolume.options import parser

    path, output = _input(task), Path(task["output"])
    words = [str(path), "-o", str(output), *task["words"]]
    clock = StageClock()
    complete_file(parser().parse_args(words), _ClockScreen(channel, clock))
    figures = json.loads((output / protocol.REPORT_FILE).read_text(encoding="utf-8"))
    surface, shell, fem = figures["input"], figures["shell"], figures["fem"]
    return {
        **_surface(surface),
        **{key: shell[key] for key in ("elements", "w0", "w0_rms", "w0_asked")},
        "proved": shell["valid"],
        "embedded": shell["embedded"],
        "min_scaled_jacobian": shell["min_scaled_jacobian"],
        "thickness": shell["thickness"]["mean"],
        "tets": figures["interior"]["tets"],
        "wedges": fem["penta15"] + fem["penta6"],
        "fem_nodes": fem["nodes"],
        "fem_order": 2 if fem["penta15"] + fem["tet10"] else 1,
        "fem_min_scaled_jacobian": fem["min_scaled_jacobian"],
        "fem_volume": fem["volume"],
        "repairs": fem["repairs"],
        "evening": figures.get("evening", {}),
        "notes": figures["notes"],
        "peak_memory_mb": figures["peak_memory_mb"],
        "stages": clock.end(),
    }


def _shell(task: Mapping[str, Any], channel: Channel) -> dict[str, Any]:
    """The shell only."""
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
    from HybridVolume.sources import Surfacing, read_file

    clock = StageClock()
    (body,) = read_file(task["file"], Surfacing(task["scheme"]))
    if body.error:
        raise body.error
    with ShellJob(body.faces, name=task["name"], parent=task["scratch"]) as job:
        job.start()
        while job.state == "running":
            for news in job.poll(wait=0.1):
                clock.stage(news.stage)
                channel.progress(news.stage, news.fraction, news.text)
        if job.error:
            raise job.error
        figures = json.loads((job.folder / FIGURES_FILE).read_text(encoding="utf-8"))
    return {**figures, **_mesh(body.origin["mesh"]), "stages": clock.end()}


def _surface(figures: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "patches": figures["patches"],
        "control_points": figures["control_points"],
        "genus": figures["genus"],
        "volume": figures["volume"],
        **_mesh(figures.get("mesh", {})),
    }


def _mesh(figures: Mapping[str, Any]) -> dict[str, Any]:
    """What the reader of meshes told."""
    return {
        "scheme": figures.get("scheme", ""),
        "quads": figures.get("quads", 0),
        "mesh_notes": figures.get("notes", []),
    }


def _input(task: Mapping[str, Any]) -> Path:
    """The file to complete; one that is made here is written now, before the time is taken."""
    from .quads_inputs import joined_bilinear, obj_text, torus_cage

    folder = Path(task["scratch"])
    if task.get("made") == "torus":
        path = folder / f"{task['name']}.obj"
        path.write_text(obj_text(*torus_cage(*task["cells"])), encoding="utf-8")
        return path
    if task.get("made") == "joined":
        from HybridVolume.core.assembly import build_surface
        from HybridVolume.core.polygon_repair import mended
        from HybridVolume.exports.step import write_solid
        from HybridVolume.freecad_python import import_freecad
        from HybridVolume.sources.polygon_files import read_polygons

        import_freecad()
        path = folder / f"{task['name']}.brep"
        mesh = mended(read_polygons(task["file"]))
        write_solid(path, build_surface(joined_bilinear(mesh)))
        return path
    return Path(task["file"])


def _smoothness(task: Mapping[str, Any], channel: Channel) -> dict[str, Any]:
    from . import quads_smoothness

    return quads_smoothness.make(task)


def _limit(task: Mapping[str, Any], channel: Channel) -> dict[str, Any]:
    from . import quads_limit

    return quads_limit.make(task)


def _exactness(task: Mapping[str, Any], channel: Channel) -> dict[str, Any]:
    from . import quads_exactness

    return quads_exactness.make(task)


def _broken(task: Mapping[str, Any], channel: Channel) -> dict[str, Any]:
    """What the command line says about a broken mesh."""
    from .quads_broken import catalogue

    (mesh,) = (one for one in catalogue() if one.name == task["mesh"])
    folder = Path(task["scratch"])
    path, output = folder / mesh.file, folder / "output"
    path.write_bytes(mesh.content)
    command = [sys.executable, "-P", "-m", "HybridVolume", str(path), "-o", str(output)]
    if mesh.scheme:
        command += ["--scheme", mesh.scheme]
    try:
        done = subprocess.run(
            command, cwd=Path(__file__).resolve().parents[2], stdin=subprocess.DEVNULL,
            capture_output=True, text=True, check=False, timeout=task["time_limit"],
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise WorkerError(f"no answer within {task['time_limit']:g} s") from None
    said = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    notes = [
        line.partition(": ")[2]
        for line in done.stdout.splitlines()
        if line.startswith(f"{path.stem}: ") or line.startswith(f"{path.stem}_1: ")
    ]
    left = sorted(p.name for p in output.rglob("*")) if output.exists() else []
    return {
        **{key: value for key, value in asdict(mesh).items() if key != "content"},
        "code": done.returncode,
        "said": said[-1].removeprefix("error: ") if said else "",
        "traceback": "Traceback" in done.stderr,
        "notes": notes,
        "left": left,
    }


PARTS = {
    "cases": _whole, "shell": _shell, "many": _whole, "smoothness": _smoothness,
    "limit": _limit, "exactness": _exactness, "broken": _broken,
}  # fmt: skip


def run_case(folder: Path, channel: Channel) -> None:
    """Make the case and write it; one that cannot be made is written with its error."""
    from HybridVolume.core.atomic import replacing

    task = json.loads((folder / protocol.OPTIONS_FILE).read_text(encoding="utf-8"))["options"]
    task["scratch"] = str(folder)
    started = time.perf_counter(), processor_seconds()
    try:
        figures = {**PARTS[task["part"]](task, channel), "error": None}
    except Exception as fault:
        figures = {"error": told(fault).to_dict()}
    values = {
        **{key: task[key] for key in ("name", "part", "case", "key")},
        **{key: task[key] for key in ("input", "scheme", "way", "words") if key in task},
        **figures,
        "seconds": time.perf_counter() - started[0],
        "seconds_cpu": processor_seconds() - started[1],
    }
    with replacing(Path(task["cases"]) / f"{task['name']}.json") as file:
        file.write((json.dumps(values, indent=1, allow_nan=False) + "\n").encode())


def main(arguments: list[str] | None = None) -> int:
    """Run one case; return the exit code."""
    return case_main(run_case, arguments)


if __name__ == "__main__":
    sys.exit(main())
