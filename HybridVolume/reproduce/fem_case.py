# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One case of ``./run.sh reproduce fem`` in a process of its own.

``python -m HybridVolume.reproduce.fem_case FOLDER`` with the files of a
:class:`HybridVolume.job.Job`. The case is a file as soon as it is finished. Volumes, patch tests
and accuracy run in the worker's Python, sums of loads in FreeCAD's.
"""

from __future__ import annotations

import json
import logging
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from HybridVolume import protocol
from HybridVolume.worker import Channel

from .cases import case_main, processor_seconds, told

logger = logging.getLogger(__name__)


def _volume(task: Mapping[str, Any], folder: Path, channel: Channel) -> dict[str, Any]:
    """Complete a body and keep its volume for the cases that need it."""
    from HybridVolume import exchange
    from HybridVolume.core.assembly import build_surface
    from HybridVolume.core.pipeline import Options, complete
    from HybridVolume.core.refinement import split_spans

    options = Options(**task["options"])
    surface = build_surface(exchange.read_surface(folder / protocol.SURFACE_FILE))
    if task["split"] > 1:
        surface = split_spans(surface, task["split"])
    volume = complete(surface, options, channel.progress)
    volume.save(task["volume"])
    return {
        "nodes": len(volume.fem.nodes),
        "wedges": len(volume.fem.wedges),
        "tets": len(volume.fem.tets),
        "min_scaled_jacobian": volume.fem.min_scaled_jacobian,
        "repairs": dict(volume.fem.repairs),
        "patches": len(volume.surface.patches),
        "genus": list(volume.surface.genus),
        "rational": volume.surface.rational,
    }


def _patch(task: Mapping[str, Any], folder: Path, channel: Channel) -> dict[str, Any]:
    from HybridVolume.core import hybrid

    from . import fem_patch

    return fem_patch.make(hybrid.load(task["volume"]), _told_to(channel, "patch"))


def _loads(task: Mapping[str, Any], folder: Path, channel: Channel) -> dict[str, Any]:
    from HybridVolume.core import hybrid

    from . import fem_loads

    volume = hybrid.load(task["volume"])
    return fem_loads.make(volume, Path(task["brep"]), folder, _told_to(channel, "loads"))


def _accuracy(task: Mapping[str, Any], folder: Path, channel: Channel) -> dict[str, Any]:
    from . import fem_accuracy

    return fem_accuracy.make(task["case"], folder, _told_to(channel, "accuracy"))


PARTS = {"volume": _volume, "patch": _patch, "loads": _loads, "accuracy": _accuracy}


def _told_to(channel: Channel, stage: str) -> Any:
    return lambda share, text: channel.progress(stage, share, text)


def run_case(folder: Path, channel: Channel) -> None:
    """Make the case and write it; one that cannot be made is written with its error."""
    from HybridVolume.core.atomic import replacing

    task = json.loads((folder / protocol.OPTIONS_FILE).read_text(encoding="utf-8"))["options"]
    started = time.perf_counter(), processor_seconds()
    try:
        figures = {**PARTS[task["part"]](task, folder, channel), "error": None}
    except Exception as fault:
        figures = {"error": told(fault).to_dict()}
    values = {
        "name": task["name"],
        "part": task["part"],
        "case": task["case"],
        "words": task["words"],
        "key": task["key"],
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
