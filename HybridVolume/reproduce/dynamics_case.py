# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One case of ``./run.sh reproduce dynamics`` in a process of its own.

``python -m HybridVolume.reproduce.dynamics_case FOLDER`` with the files of a
:class:`HybridVolume.job.Job`.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from HybridVolume import exchange, protocol
from HybridVolume.core.analysis.hybrid_space import refined
from HybridVolume.core.atomic import replacing
from HybridVolume.worker import Channel

from .cases import case_main, processor_seconds, told
from .dynamics_motion import Drop, at_rest, dropped, flown, swung
from .rates3d_case import Space, made_shell, made_space

POISSON = 0.25
"""Of the sphere that swings."""


def run_case(folder: Path, channel: Channel) -> None:
    """Make the case and write it; one that cannot be made is written with its error."""
    task = json.loads((folder / protocol.OPTIONS_FILE).read_text(encoding="utf-8"))["options"]
    started = time.perf_counter(), processor_seconds()
    try:
        figures = _figures(folder, task, channel)
        figures["error"] = None
    except Exception as fault:
        figures = {"error": told(fault).to_dict()}
    values = {
        **{word: task[word] for word in ("name", "part", "case", "key")},
        **figures,
        "seconds": time.perf_counter() - started[0],
        "seconds_cpu": processor_seconds() - started[1],
    }
    with replacing(Path(task["cases"]) / f"{task['name']}.json") as file:
        file.write((json.dumps(values, allow_nan=False) + "\n").encode())


def _figures(folder: Path, task: Mapping[str, Any], channel: Channel) -> dict[str, Any]:
    def progress(share: float, text: str) -> None:
        channel.progress(task["part"], share, text)

    progress(0.0, "making the volume")
    faces = exchange.read_surface(folder / protocol.SURFACE_FILE)
    shell = made_shell(faces, task.get("p", 3), task.get("w0", 0.5), task.get("own_spans", False))
    space = made_space(shell, task["k"], task["coupling"])
    if task["part"] == "drops":
        drop = Drop(**task["drop"])
        return dropped(space, drop, Path(task["cases"]), task["name"], progress)
    if task["part"] == "flights":
        return flown(space, task["rule"], task["steps"], progress)
    if task["part"] == "rest":
        return {**at_rest(space), "coupling": task["coupling"]}
    return {"coupling": task["coupling"], **_modes(space, task["levels"], progress)}


def _modes(space: Space, levels: int, progress: Any) -> dict[str, Any]:
    """Frequencies on a space and on finer ones."""
    rows = []
    for level in range(levels):
        if level:
            space = refined(space)
        rows.append({"level": level, **swung(space, POISSON)})
        progress((level + 1) / levels, f"{rows[-1]['unknowns']} unknowns")
    return {"levels": rows, "off": rows[-1]["off"], "poisson": POISSON}


def main(arguments: list[str] | None = None) -> int:
    """Run one case; return the exit code."""
    return case_main(run_case, arguments)


if __name__ == "__main__":
    sys.exit(main())
