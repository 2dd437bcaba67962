# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Pictures of ``./run.sh reproduce fem``, drawn in the worker's Python, whose matplotlib is known.

``python -m HybridVolume.reproduce.fem_pictures DIR`` draws what DIR/fem.json holds and prints the
names of the files as JSON.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from .cases import drawn_elsewhere

TIME_LIMIT = 300.0


def draw(folder: Path, python: str) -> list[str]:
    """Names of the pictures beside ``fem.json``, drawn by another Python.

    Parameters
    ----------
    folder : Path
        Holds ``fem.json``.
    python : str
        The worker's interpreter.

    Raises
    ------
    WorkerError
        It failed.
    """
    return drawn_elsewhere(__name__, folder, python, TIME_LIMIT)


def main(arguments: list[str] | None = None) -> int:
    """Draw and print; return the exit code."""
    from .fem_accuracy_table import pictures

    (name,) = sys.argv[1:] if arguments is None else arguments
    folder = Path(name)
    found = json.loads((folder / "fem.json").read_text(encoding="utf-8"))
    made = [case for case in found["accuracy"] if not case["error"]]
    print(json.dumps(pictures(made, folder) if made else []))
    return 0


if __name__ == "__main__":
    sys.exit(main())
