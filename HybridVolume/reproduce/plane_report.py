# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What the commands of the plane have in common: their files, their pictures and their heads."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from HybridVolume.completion import Screen
from HybridVolume.errors import SetupError, WorkerError
from HybridVolume.job import worker_python

from .cases import told_figures
from .midstructure import write_json
from .plane_pictures import draw
from .shell import machine
from .table import made_on

VERSION = 1
"""Of the JSON files."""


def reported(
    name: str,
    options: argparse.Namespace,
    make: Callable[[Screen], tuple[list[dict[str, Any]], list[dict[str, Any]]]],
    text: Callable[[Mapping[str, Any]], Sequence[str]],
    more: Callable[[Path], list[list[str]]] | None = None,
) -> int:
    """Make the cases of a command, and write ``NAME.json``, ``NAME.md`` and ``pictures``.

    Parameters
    ----------
    name : str
        Of the command.
    options : argparse.Namespace
        With ``output`` and ``small``.
    make : callable
        Returns cases and demands.
    text : callable
        Returns paragraphs of Markdown below the head of what was found.
    more : callable, optional
        Draws further pictures into a folder and returns their names and titles.

    Returns
    -------
    int
        0 when every demand is met and every case was made, else 1.
    """
    started = time.perf_counter()
    folder = Path(options.output)
    (folder / "pictures").mkdir(parents=True, exist_ok=True)
    screen = Screen()
    cases, demands = make(screen)
    found: dict[str, Any] = {
        "version": VERSION,
        "command": f"./run.sh reproduce {name} -o DIR" + (" --small" if options.small else ""),
        "machine": machine(),
        "missing": [],
        "not_done": [],
        "cases": cases,
        "demands": demands,
        "pictures": [],
        "seconds": time.perf_counter() - started,
    }
    file = folder / f"{name}.json"
    write_json(file, found)
    try:
        found["pictures"] = draw(file, worker_python())
        found["pictures"] += more(folder / "pictures") if more else []
    except (SetupError, WorkerError) as error:
        screen.line(f"no pictures: {error.line}")
    write_json(file, found)
    return told_figures(found, _markdown(found, text(found)), file.with_suffix(".md"), screen,
                        ("cases",))  # fmt: skip


def _markdown(found: Mapping[str, Any], paragraphs: Sequence[str]) -> str:
    """Title, command and machine, then the paragraphs, faults and pictures."""
    head, *others = paragraphs
    parts = [head, f"`{found['command']}`", _made_on(found), *others]
    failed = [f"- {c['name']}: {c['error']['message']}" for c in found["cases"] if c["error"]]
    parts += ["\n".join(failed)] if failed else []
    parts += [f"![{words}](pictures/{name})" for name, words in found["pictures"]]
    return "\n\n".join(part.strip("\n") for part in parts if part) + "\n"


def _made_on(found: Mapping[str, Any]) -> str:
    return made_on(found, "cases").replace(", two cases side by side with one thread each", "")
