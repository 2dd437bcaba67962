# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One case of ``./run.sh reproduce rates3d`` in a process of its own.

``python -m HybridVolume.reproduce.rates3d_case FOLDER`` with the files of a
:class:`HybridVolume.job.Job`. A shell is made once, of one knot span a patch where the body has no
more; every further level is the same volume with all spans and all tets cut.
"""

from __future__ import annotations

import json
import logging
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from HybridVolume import exchange, protocol
from HybridVolume.core import bspline
from HybridVolume.core.analysis.coupling import CollocationSpace, NitscheSpace
from HybridVolume.core.analysis.elevation import elevated_shell
from HybridVolume.core.analysis.hybrid_space import hybrid_space, refined
from HybridVolume.core.analysis.interface_figures import gap_figures, patch_deviation
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.atomic import replacing
from HybridVolume.core.even import Evenness, even_as_needed
from HybridVolume.core.growth import grow_shell
from HybridVolume.core.interior import build_interface, fill_interior
from HybridVolume.core.pipeline import Options, field_stage, midstructure_stage
from HybridVolume.core.shell import Shell
from HybridVolume.core.surface import PatchSurface, SplineFace
from HybridVolume.core.validity import certify
from HybridVolume.errors import FaultError
from HybridVolume.worker import Channel

from .cases import case_main, processor_seconds, told
from .rates3d_measure import rigid_energy, solved, solved_alone
from .rates3d_pictures import sampled_errors
from .rates3d_problems import PROBLEMS, STEEL_LIKE

logger = logging.getLogger(__name__)

Space = CollocationSpace | NitscheSpace
NORMS = ("l2", "h1", "energy")
OWN, USER, SCALED = "own", "user", "scaled"
_RIGID, _PATCH = 2, 3
"""Levels on which the energy of rigid motions and patch tests are told: they need a solution or the
matrix of all components, and finer ones tell no more."""


def made_shell(
    faces: Sequence[SplineFace], degree: int, w0: float = 0.5, start: str | float = OWN
) -> Shell:
    """A certified shell of one layer.

    Parameters
    ----------
    faces : sequence of SplineFace
    degree : int
        Across the shell, and the least along the surface; higher ones of the faces stay.
    w0 : float
        Level.
    start : {"own", "user", "scaled"} or float
        Knot spans: those of the body itself; those that a user's shell has, halved where normals
        turn much; or such that no side is longer than this, mm. Scaled: the inner surface is half
        of the body itself, about its middle, so that it is flat where the body is.
    """
    surface = build_surface(list(faces))
    if start == SCALED:
        return elevated_shell(_scaled(surface, degree), degree)
    options = Options(w0=w0, layers=1, degree=degree)
    stage = midstructure_stage(surface, options)
    if start == OWN:
        stage = replace(stage, surface=surface)
    elif start != USER:
        stage = replace(stage, surface=even_as_needed(surface, Evenness(float(start), 0.0, 0.0)))
    shell, certificate = grow_shell(
        stage.surface, field_stage(stage, options), options.goal, layers=1, degree_w=degree
    )
    logger.info("%d elements proved, w0 %.3f", certificate.valid, shell.w0)
    return elevated_shell(shell, degree)


def _scaled(surface: PatchSurface, degree: int) -> Shell:
    """Shell of a convex body of polynomial faces, towards the body of half the size."""
    knots = bspline.clamped_knots(degree, 1)
    points = surface.control_points
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    step = bspline.greville(degree, knots)[:, None, None] * 0.5 * (middle - points)
    shell = Shell(surface, points + step, degree, knots)
    certificate = certify(shell.bezier_elements())
    if certificate.valid < shell.element_count:
        raise FaultError("a scaled shell is not valid", figure=float(certificate.valid))
    return shell


def made_space(shell: Shell, degree: int, coupling: str, cuts: int = 1, finer: int = 0) -> Space:
    """The coarsest space on a shell and its core.

    Parameters
    ----------
    shell : Shell
    degree : int
        Of the core.
    coupling : {"collocation", "nitsche"}
    cuts : int
        Parts that the interface has along each side of a knot rectangle.
    finer : int
        How often the shell's functions are refined while the core stays; Nitsche's coupling alone
        allows it.
    """
    interface = build_interface(shell, subdivide=cuts)
    interior = fill_interior(interface, surface=shell.surface)
    space = hybrid_space(shell, interface, interior, degree=degree, coupling=coupling)
    for _ in range(finer):
        space = replace(space, spline=space.spline.refined())
    return space


def levels(space: Space, count: int) -> Iterator[tuple[int, Space, float]]:
    """A space and finer ones of the same volume; their numbers, and seconds of the processor."""
    spent = 0.0
    for level in range(count):
        if level:
            started = time.process_time()
            space = refined(space)
            spent = time.process_time() - started
        yield level, space, spent


def with_rates(rows: list[dict[str, Any]], names: Sequence[str] = NORMS) -> list[dict[str, Any]]:
    """Rows with their rates in h, which halves from one to the next: ``l2_rate``, ..."""
    for before, row in zip([None, *rows], rows, strict=False):
        for name in names:
            known = bool(before and before[name] and row[name])
            row[f"{name}_rate"] = float(np.log2(before[name] / row[name])) if known else None
    return rows


def rates(
    space: Space,
    problem: str,
    count: int,
    told_to: Callable[[float, str], None] | None = None,
    keep: Callable[[int, Space, np.ndarray], None] | None = None,
) -> list[dict[str, Any]]:
    """Errors and rates of a problem on a space and on those finer, a row each.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
    problem : str
        Of :data:`.rates3d_problems.PROBLEMS`.
    count : int
        Levels.
    told_to : callable, optional
        Gets the share that is done, and a text.
    keep : callable, optional
        Gets each level, its space and the answer.
    """
    rows = []
    wanted = PROBLEMS[problem](space.spline.shell.surface)
    for level, fine, spent in levels(space, count):
        figures, values = solved(fine, wanted)
        row = {
            "level": level,
            "h": 0.5**level,
            **figures,
            "seconds_refined": spent,
            "notes": list(getattr(fine, "notes", ())),
        }
        rows.append(row)
        logger.info("level %d: %s", level, {k: v for k, v in row.items() if k != "notes"})
        if keep:
            keep(level, fine, values)
        if told_to:
            told_to((level + 1) / count, f"{row['unknowns']} unknowns")
    return with_rates(rows)


def _hybrid(task: Mapping[str, Any], faces: Sequence[SplineFace], tell: Callable) -> dict[str, Any]:
    shell, space = _coarsest(task, faces)
    surface = shell.surface
    problem = PROBLEMS[task["problem"]](surface)

    def keep(level: int, fine: Space, values: np.ndarray) -> None:
        if level == task["pictured"]:
            found = sampled_errors(fine, values, problem)
            with replacing(Path(task["cases"]) / f"{task['name']}.npz") as file:
                np.savez_compressed(file, level=level, **found)

    degrees = sorted({d for patch in surface.patches for d in patch.degrees})
    return {
        "degrees": degrees,
        "degree_w": shell.degree_w,
        "rational": surface.rational,
        "patches": len(surface.patches),
        "w0_reached": shell.w0,
        "words": problem.words,
        "levels": rates(space, task["problem"], task["levels"], tell, keep),
    }


def _tets(task: Mapping[str, Any], faces: Sequence[SplineFace], tell: Callable) -> dict[str, Any]:
    from .fem_rivals import Sizes, tet10_mesh

    surface = build_surface(list(faces))
    problem = PROBLEMS[task["problem"]](surface)
    rows = []
    for number, share in enumerate(task["sizes"]):
        size = share * surface.diagonal
        started = time.process_time()
        mesh = tet10_mesh(surface, Sizes(size), time_limit=task["mesher_limit"])
        rows.append({"h": size, **solved_alone(mesh, _cavities(surface, problem.pressed), problem),
                     "seconds_mesher": time.process_time() - started})  # fmt: skip
        tell((number + 1) / len(task["sizes"]), f"{rows[-1]['unknowns']} unknowns")
    return {"words": problem.words, "levels": rows}


def _cavities(surface: PatchSurface, pressed: float) -> list[str]:
    if not pressed:
        return []
    inside = zip(surface.patches, surface.shell_of_patch, strict=True)
    return list(dict.fromkeys(patch.face for patch, shell in inside if shell > 0))


def _coarsest(task: Mapping[str, Any], faces: Sequence[SplineFace]) -> tuple[Shell, Space]:
    shell = made_shell(faces, task["p"], task["w0"], task["start"])
    return shell, made_space(shell, task["k"], task["coupling"], task["cuts"], task["finer"])


def interface_rows(
    space: Space, count: int, told_to: Callable[[float, str], None] | None = None
) -> list[dict[str, Any]]:
    """What the interface does to linear fields and rigid motions, on a space and finer ones.

    Returns
    -------
    list of dict
        ``gap``: root mean square distance between the core's faces and the inner surface, and
        ``transfer``: largest one at the interface's nodes, shares of the diagonal; ``patch_l2``,
        ``patch_h1``: errors of the patch test; ``rigid``: energy of rigid motions; and rates.
    """
    rows = []
    surface = space.spline.shell.surface
    for level, fine, _ in levels(space, count):
        figures = gap_figures(fine)
        patch = patch_deviation(fine) if level < _PATCH else (None, None)
        rows.append({
            "level": level,
            "h": 0.5**level,
            "unknowns": fine.size,
            "transfer": figures["transfer"] / surface.diagonal,
            "gap": figures["rms"] / surface.diagonal,
            "patch_l2": patch[0],
            "patch_h1": patch[1],
            "rigid": rigid_energy(fine, STEEL_LIKE) if level < _RIGID else None,
        })  # fmt: skip
        if told_to:
            told_to((level + 1) / count, f"{fine.size} unknowns")
    return with_rates(rows, ("gap", "patch_l2", "patch_h1"))


def _gaps(task: Mapping[str, Any], faces: Sequence[SplineFace], tell: Callable) -> dict[str, Any]:
    _, space = _coarsest(task, faces)
    return {"levels": interface_rows(space, task["levels"], tell)}


PARTS: dict[str, Callable] = {"rates": _hybrid, "tets": _tets, "gaps": _gaps}


def run_case(folder: Path, channel: Channel) -> None:
    """Make the case and write it; one that cannot be made is written with its error."""
    task = json.loads((folder / protocol.OPTIONS_FILE).read_text(encoding="utf-8"))["options"]
    started = time.perf_counter(), processor_seconds()

    def tell(share: float, text: str) -> None:
        channel.progress(task["part"], share, text)

    try:
        faces = exchange.read_surface(folder / protocol.SURFACE_FILE)
        figures = {**PARTS[task["part"]](task, faces, tell), "error": None}
    except Exception as fault:
        figures = {"levels": [], "error": told(fault).to_dict()}
    kept = ("name", "part", "body", "problem", "p", "k", "coupling", "w0", "start", "cuts",
            "finer", "key")  # fmt: skip
    values = {
        **{name: task[name] for name in kept},
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
