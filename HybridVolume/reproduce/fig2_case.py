# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One case of ``./run.sh reproduce fig2`` in a process of its own.

``python -m HybridVolume.reproduce.fig2_case FOLDER`` with the files of a
:class:`HybridVolume.job.Job`.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from pathlib import Path

from HybridVolume import protocol
from HybridVolume.worker import Channel

from .cases import case_main, processor_seconds, told
from .fig2_drop import BODIES, Drop, dropped


def run_case(folder: Path, channel: Channel) -> None:
    """Make the case and write it; one that cannot be made is written with its error."""
    from HybridVolume.core.atomic import replacing

    task = json.loads((folder / protocol.OPTIONS_FILE).read_text(encoding="utf-8"))["options"]
    started = time.perf_counter(), processor_seconds()
    (body,) = (body for body in BODIES if body.name == task["case"])
    if task.get("depth") is not None:
        body = replace(body, depth=task["depth"])
    try:
        figures = dropped(
            body, Drop(**task["drop"]), lambda share, text: channel.progress("drop", share, text)
        )
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


def main(arguments: list[str] | None = None) -> int:
    """Run one case; return the exit code."""
    return case_main(run_case, arguments)


if __name__ == "__main__":
    sys.exit(main())
