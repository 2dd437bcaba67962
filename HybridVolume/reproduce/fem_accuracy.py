# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Accuracy for the nodes spent: five elastic fields, the hybrid mesh and other meshers.

Every case is one problem of `fem_problems` on the meshes of one mesher at several refinements. All
are solved by CalculiX under the same consistent loads, and their stress is judged twice: as
CalculiX extrapolates it, and recovered from the displacements. The recovery is the same for all.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..core.assembly import build_surface
from ..core.density import Density
from ..core.pipeline import Options, complete
from ..core.recovery import recover
from ..core.remesh import remesh
from ..errors import HybridVolumeError
from .calculix import solve
from .fem_accuracy_table import as_markdown, demands, pictures
from .fem_measure import measure, prepare
from .fem_mesh import Meshed
from .fem_problems import MAKERS, Problem, problem
from .fem_rivals import Sizes, layered_mesh, tet10_mesh

__all__ = ["CASES", "as_markdown", "demands", "make", "pictures"]

logger = logging.getLogger(__name__)

MESHERS = ("hybrid", "tet10", "tet10-graded", "netgen-layers")
CASES: tuple[str, ...] = tuple(f"{name}-{mesher}" for name in MAKERS for mesher in MESHERS)
"""Problem and mesher."""

LAYERS = (0.2, 0.3)
"""Heights of Netgen's layers as shares of the size of its elements."""
Meshes = Iterator[tuple[dict[str, Any], Callable[[], Meshed]]]


def make(name: str, folder: Path, progress: Callable[[float, str], None]) -> dict[str, Any]:
    """Solve one case at all refinements.

    Parameters
    ----------
    name : str
        One of `CASES`.
    folder : path
        For CalculiX's files.
    progress : callable
        Called with a share and a text.

    Returns
    -------
    dict
        ``problem``, ``words``, ``mesher``, ``rows``: for each refinement what was asked of the
        mesher, and the figures of `fem_measure.measure` or ``error``.

    Raises
    ------
    HybridVolumeError
        There is no hybrid volume of the body.
    """
    of, _, mesher = name.partition("-")
    chosen = problem(of)
    meshes = list(_hybrids(chosen) if mesher == "hybrid" else _others(chosen, mesher))
    rows = []
    for number, (asked, mesh) in enumerate(meshes):
        progress(number / len(meshes), f"{name}, {asked}")
        row: dict[str, Any] = {"asked": asked}
        try:
            row.update(_row(chosen, mesh, Path(folder) / str(number)))
        except HybridVolumeError as error:
            logger.warning("%s, %s: %s", name, asked, error.line)
            row["error"] = error.line
        rows.append(row)
    progress(1.0, name)
    return {"problem": of, "words": chosen.words, "mesher": mesher, "rows": rows}


def _row(chosen: Problem, mesh: Callable[[], Meshed], folder: Path) -> dict[str, Any]:
    started = time.process_time()
    meshed = mesh()
    spent = time.process_time() - started
    case = prepare(chosen, meshed)
    found = solve(
        meshed.nodes, meshed.elements, chosen.material, case.prescribed,
        forces=case.forces, folder=folder,
    )  # fmt: skip
    own = recover(meshed.nodes, meshed.elements, found.displacement, chosen.material)
    recovered = np.full(found.stress.shape, np.nan)
    recovered[own.nodes] = own.stress
    figures = measure(case, found.displacement, {"ccx": found.stress, "recovered": recovered})
    return {**figures, "unproved": meshed.unproved, "seconds": spent}


def _hybrids(chosen: Problem) -> Meshes:
    """Meshes of one shell."""
    surface = build_surface(list(chosen.body.faces))
    volume = complete(surface, Options(layers=1, w0=chosen.level))
    for parts, layers in chosen.densities:
        density = Density(subdivide=parts, layers=layers)
        asked = {"subdivide": parts, "layers": layers}
        yield asked, lambda density=density: Meshed.of(remesh(volume, density).fem)


def _others(chosen: Problem, mesher: str) -> Meshes:
    surface = build_surface(list(chosen.body.faces))
    near = chosen.body.named(*chosen.near)
    for size in chosen.sizes[mesher]:
        sizes = Sizes(size, chosen.slope if mesher == "tet10-graded" else 0.0, near)
        asked: dict[str, Any] = {"size": size}
        if mesher == "netgen-layers":
            heights = [share * size for share in LAYERS]
            asked["heights"] = heights
            yield asked, lambda s=sizes, h=heights: layered_mesh(surface, s, h, limit=True)
        else:
            asked["slope"] = sizes.slope
            yield asked, lambda s=sizes: tet10_mesh(surface, s)
