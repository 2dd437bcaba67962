# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The shell of a body without a core: ``python -m HybridVolume.reproduce.quads_shell FOLDER``.

In the worker's Python, for bodies whose shell alone is wanted.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from HybridVolume import exchange, protocol
from HybridVolume.worker import Channel

from .cases import case_main

FIGURES_FILE = "figures.json"
"""What this process answers."""


def shell_figures(folder: Path, channel: Channel) -> dict[str, Any]:
    """Make the shell of the surface in a job's folder.

    Returns
    -------
    dict
        Figures of the surface and of its shell.
    """
    from HybridVolume.core.assembly import build_surface
    from HybridVolume.core.embedding_proof import prove_embedded
    from HybridVolume.core.growth import grow_shell
    from HybridVolume.core.levels import Spacing
    from HybridVolume.core.pipeline import Options, field_stage, midstructure_stage
    from HybridVolume.core.validity import scaled_jacobian

    options = Options()
    given = build_surface(exchange.read_surface(folder / protocol.SURFACE_FILE))
    stage = midstructure_stage(given, options, channel.progress)
    field = field_stage(stage, options, channel.progress)
    channel.progress("shell", 0.3, f"{len(field.mesh.tets)} tetrahedra in the field; front")
    shell, certificate = grow_shell(
        stage.surface,
        field,
        options.goal,
        layers=options.layers,
        degree_w=options.degree,
        spacing=Spacing.parse(options.spacing),
        progress=lambda share, text: channel.progress("shell", 0.3 + 0.6 * share, text),
    )
    channel.progress("proof", 0.95, "embedding")
    return {
        "patches": len(given.patches),
        "control_points": len(given.control_points),
        "genus": list(given.genus),
        "volume": given.volume(),
        "elements": len(certificate),
        "proved": certificate.valid,
        "embedded": bool(shell.embedded),
        "embedding_proved": prove_embedded(shell.inner_surface()).proved,
        "w0": float(shell.w0),
        "w0_rms": float(shell.w0_rms),
        "w0_asked": float(shell.w0_asked),
        "min_scaled_jacobian": float(scaled_jacobian(shell.bezier_elements()).min()),
        "notes": list(shell.notes),
    }


def work(folder: Path, channel: Channel) -> None:
    """Make the shell and write its figures; its refusal is that of the process that waits."""
    text = json.dumps(shell_figures(folder, channel), indent=1, allow_nan=False)
    (folder / FIGURES_FILE).write_text(text + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> int:
    """Make a shell; return the exit code."""
    return case_main(work, arguments)


if __name__ == "__main__":
    sys.exit(main())
