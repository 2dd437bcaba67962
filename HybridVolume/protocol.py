# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What a job and its worker process agree on: names of files, goals, lines of the pipe.

The two sides share a folder and two pipes. The folder holds what :meth:`Job.prepare` writes
(:data:`OPTIONS_FILE`; :data:`SURFACE_FILE`, with geometry of the user's :data:`OWN_FILE`, or for
another mesh :data:`VOLUME_FILE`) and what the worker answers (:data:`RESULT_FILE` or, by the goal,
:data:`FIELD_FILE`; :data:`REPORT_FILE` and the exports). On its output the worker writes one JSON
object a line: ``{"stage", "fraction", "text"}`` while it works, then ``{"done": true}`` or
``{"error": {...}}``. Its input carries nothing and stays open: when it closes, our process is gone
and the worker ends.

This module needs the standard library only.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from HybridVolume.errors import (
    FileFormatError,
    InputError,
    ThicknessError,
    WorkerError,
)

PROTOCOL = 4
GOALS = ("volume", "midstructure", "thickness", "mesh")
"""What a job ends with: the hybrid volume, the midstructure alone, how thick a shell will be, or
the hybrid volume given with another finite element mesh."""

OPTIONS_FILE = "job.json"
SURFACE_FILE = "surface.npz"
OWN_FILE = "own.npz"
VOLUME_FILE = "volume.npz"
RESULT_FILE = "result.npz"
FIELD_FILE = "field.npz"
REPORT_FILE = "report.json"
LOG_FILE = "worker.log"
EXPORTS = ("vtu", "inp", "png")
"""What the command line always writes besides the result, each as ``NAME.<export>``."""
MESH_EXPORTS = {"unv": "{}.unv", "med": "{}.med", "msh": "{}.msh", "vtu": "{}_fem.vtu"}
"""Further files of the finite element mesh, by the words of ``--export``. FreeCAD's side writes
them: not all wheels of the worker can."""
SURFACE_EXPORTS = {"step": "{}_surface.step"}
"""Files of the surface itself, by the words of ``--export``: the faces of the body, untrimmed."""
SHELL_EXPORTS = {"mfem": "{}.mesh", "gismo": "{}.xml"}
"""Files of the shell for solvers that know splines, by the words of ``--export``; the export
``core`` writes :data:`CORE_FILES` beside them."""
CORE_FILES = ("{}_core.msh", "{}_interface.csv", "{}_interface_triangles.csv")
PICTURES = (
    *("field", "columns", "shell", "level", "thickness", "histogram", "worst"),
    "fem_histogram",
)
"""What the export ``pictures`` writes, each as ``NAME_<picture>.png``."""
ELEMENTS = ("wedges", "hex20")
"""Elements of the shell in NAME.inp."""

_EXPORTS = {
    "volume": (*EXPORTS, "pictures", *SHELL_EXPORTS, "core"),
    "mesh": (*EXPORTS, *SHELL_EXPORTS, "core"),
}
"""What a worker can write, by the goal; pictures show the field, which a stored volume lacks."""


@dataclass(frozen=True)
class Progress:
    """How far a worker is: the stage's name, the share of the whole work done, a line of text."""

    stage: str
    fraction: float
    text: str


def exit_code(error: BaseException) -> int:
    """2 for an input that is refused, 1 for a fault of this program or its surroundings."""
    return 2 if isinstance(error, InputError | ThicknessError | FileFormatError) else 1


def check_exports(exports: tuple[str, ...], goal: str) -> None:
    """Refuse exports that a goal does not have, and goals that there are not; ValueError."""
    if goal not in GOALS:
        raise ValueError(f"unknown goal {goal!r}")
    unknown = set(exports) - set(_EXPORTS.get(goal, ()))
    if unknown:
        raise ValueError(f"unknown exports {sorted(unknown)} of a {goal}")


def exported_files(name: str, export: str) -> list[str]:
    """Names of the files of one export of a body.

    Parameters
    ----------
    name : str
        Stem of the files.
    export : {"vtu", "inp", "png", "pictures", "mfem", "gismo", "core"}
    """
    if export in SHELL_EXPORTS:
        return [SHELL_EXPORTS[export].format(name)]
    if export == "core":
        return [file.format(name) for file in CORE_FILES]
    if export == "pictures":
        return [f"{name}_{picture}.png" for picture in PICTURES]
    return [f"{name}.{export}"]


def parse_line(line: str) -> Progress | dict[str, Any]:
    """Read a line of the worker: progress, or its answer; what is neither becomes an error."""
    try:
        values = json.loads(line)
        if "stage" in values:
            fraction = min(max(float(values["fraction"]), 0.0), 1.0)
            return Progress(str(values["stage"]), fraction, str(values["text"]))
        if "done" in values or "error" in values:
            return values
        raise ValueError("neither progress nor answer")
    except (ValueError, TypeError, KeyError) as fault:
        error = WorkerError(f"the worker wrote {line.strip()[:80]!r}: {fault}")
        return {"error": error.to_dict()}
