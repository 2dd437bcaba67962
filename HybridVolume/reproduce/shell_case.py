# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Shells of one body for several levels, in a process of its own.

``python -m HybridVolume.reproduce.shell_case FOLDER`` with the files of a
:class:`HybridVolume.job.Job`. Midstructure and field are made once; every finished case is a file
at once, so that nothing is lost when the process ends early.
"""

from __future__ import annotations

import contextlib
import json
import logging
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume import exchange, job
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.atomic import replacing
from HybridVolume.core.columns import evaluate_columns, layer_parameters
from HybridVolume.core.levels import Spacing, spaced_layers
from HybridVolume.core.pipeline import Options, Stage, field_stage, midstructure_stage
from HybridVolume.core.reached import inner_figures
from HybridVolume.core.refinement import split_spans
from HybridVolume.core.validity import certify, scaled_jacobian
from HybridVolume.errors import FaultError, HybridVolumeError
from HybridVolume.worker import Channel

from .cases import case_main, processor_seconds, told
from .shell_bodies import RIVALS_FILE, no_shell

if TYPE_CHECKING:
    from HybridVolume.core.harmonic import HarmonicField
    from HybridVolume.core.shell import Shell
    from HybridVolume.core.validity import Certificate

logger = logging.getLogger(__name__)

BINS = 20
"""Bins of the histogram of scaled Jacobians, from 0 to 1."""
QUANTILES = {"q01": 0.01, "q05": 0.05, "median": 0.5}
SHAPE_FIRST = 0.3
"""Weight of the isosurface in the cases where shape goes before the level."""
SPACINGS = ("distance", "volume", "1.5", "first")
"""Of the table of levels; the first layer is a tenth of the mean thickness."""
LEVEL_LAYERS = 3
DEGREES = (1, 2, 3, 4)


def write_case(folder: Path, name: str, values: Mapping[str, Any]) -> None:
    """Write a case, whole or not at all."""
    with replacing(folder / f"{name}.json") as file:
        file.write((json.dumps(values, indent=1) + "\n").encode())


class Bench:
    """One body with its midstructure and field."""

    def __init__(self, faces: list, task: Mapping[str, Any], progress: Callable) -> None:
        self.task, self.progress = task, progress
        self.options = Options(layers=task["layers"], **task["options"])
        with self._stopped("surface") as spent:
            surface = build_surface(faces, self.options.tolerance)
            if task["split"] > 1:
                surface = split_spans(surface, task["split"])
            self.given = surface
        self.seconds = {"surface": spent[0]}
        self.cpu = {"surface": spent[1]}
        self.stage: Stage | None = None
        self.field: HarmonicField | None = None
        self.bound: np.ndarray | None = None
        self.thickness: dict[float, float] = {}
        self._paper: HarmonicField | None = None

    @contextlib.contextmanager
    def _stopped(self, what: str) -> Iterator[list[float]]:
        """Seconds on the wall and of the processor, in a list that is filled at the end."""
        spent = [0.0, 0.0]
        started = time.perf_counter(), processor_seconds()
        yield spent
        spent[:] = [time.perf_counter() - started[0], processor_seconds() - started[1]]
        logger.info("%s: %.2f s, %.2f s of the processor", what, *spent)

    def prepare(self) -> None:
        """Midstructure, field, and the bound that the surface sets."""
        for name, work in (
            ("midstructure", lambda: midstructure_stage(self.given, self.options, self.progress)),
            ("field", lambda: field_stage(self.stage, self.options, self.progress)),
            ("bound", lambda: _bound(self.stage)),
        ):
            with self._stopped(name) as spent:
                found = work()
            setattr(self, "stage" if name == "midstructure" else name, found)
            self.seconds[name], self.cpu[name] = spent

    def figures(self) -> dict[str, Any]:
        """What is known of the body."""
        surface = self.given
        return {
            "patches": len(surface.patches),
            "faces": len({patch.face for patch in surface.patches}),
            "genus": list(surface.genus),
            "shells": surface.shells,
            "rational": surface.rational,
            "degrees": [max(max(p.degrees) for p in surface.patches),
                        min(min(p.degrees) for p in surface.patches)],
            "spans_given": surface.element_count,
        }  # fmt: skip

    def prepared(self) -> dict[str, Any]:
        """What is known of the body once it has a field."""
        middle = self.stage.midstructure
        return {
            "spans": self.stage.surface.element_count,
            "sheets": len(middle.sheets),
            "kept": middle.kept_sheets,
            "tets": len(self.field.mesh.tets),
            "mesher": self.field.mesh.engine,
            "largest_w0": float(self.field.largest_level(self.stage.surface.genus, 0.99)),
            "bound": None if self.bound is None else float(self.bound.min()),
            "seconds_before": dict(self.seconds),
        }

    def shell(self, w0: float, fidelity: float | None = None) -> dict[str, Any]:
        """Figures of the shell at a level."""
        from HybridVolume.core.growth import grow_shell

        more = {} if fidelity is None else {"fidelity": fidelity}
        with self._stopped(f"shell at {w0:g}") as spent:
            shell, certificate = grow_shell(
                self.stage.surface,
                self.field,
                w0,
                layers=self.options.layers,
                degree_w=self.options.degree,
                spacing=Spacing.parse(self.options.spacing),
                progress=lambda share, text: self.progress("shell", share, f"w0 {w0:g}: {text}"),
                **more,
            )
        figures = shell_figures(shell, certificate)
        if fidelity is None:
            self.thickness[w0] = figures["thickness"]["mean"]
        return {
            **figures,
            "seconds": spent[0],
            "seconds_cpu": spent[1],
            "seconds_stage": spent[0] + self.seconds["field"],
            "seconds_stage_cpu": spent[1] + self.cpu["field"],
        }

    def levels(self, w0: float) -> list[dict[str, Any]]:
        """All ways to cut one shell into layers, of degree 1 to 4."""
        from HybridVolume.core import bspline
        from HybridVolume.core.growth import grow_shell

        surface = self.stage.surface
        shell, _ = grow_shell(surface, self.field, w0, layers=1)
        columns = shell.layers[-1] - shell.layers[0]
        thickness = shell.thickness()
        rows = []
        for text in SPACINGS:
            spacing = (
                Spacing("first", 0.1 * float(thickness.mean()))
                if text == "first"
                else Spacing.parse(text)
            )
            for degree in DEGREES:
                knots = bspline.clamped_knots(degree, LEVEL_LAYERS)
                points = spaced_layers(
                    shell.layers[0], columns, degree, knots, surface, spacing, thickness
                )
                cut = type(shell)(surface, points, degree, knots)
                rows.append({"spacing": spacing.kind, "value": spacing.value, "degree": degree,
                             **_cut_figures(cut)})  # fmt: skip
        return rows

    def paper(self, w0: float) -> dict[str, Any]:
        """What the paper's own method makes of the body."""
        from HybridVolume.core.paper import paper_field, paper_figures

        surface, middle = self.stage.surface, self.stage.midstructure
        if self._paper is None:
            # where there is no such field, every level says why
            with contextlib.suppress(HybridVolumeError):
                self._paper = paper_field(surface, middle)
        return paper_figures(surface, middle, w0, layers=self.options.layers, field=self._paper)

    def rivals(self, w0: float, path: Path) -> dict[str, Any]:
        """Boundary layers of other meshers, as thick as our shell is in the mean.

        Parameters
        ----------
        w0 : float
            Level of our shell.
        path : Path
            BREP file of the body.
        """
        from . import rivals

        if not path.is_file():
            raise FaultError("the body could not be written for other meshers")
        thickness = self.thickness.get(w0)
        if thickness is None:
            thickness = float(self.shell(w0)["thickness"]["mean"])
        size = rivals.size_for(self.given.area())
        return {
            "thickness_asked": thickness,
            "size": size,
            "made": {
                "netgen": rivals.netgen_layers(path, thickness, size),
                "gmsh": rivals.gmsh_layers(path, thickness, size),
            },
        }


def shell_figures(shell: Shell, certificate: Certificate) -> dict[str, Any]:
    """Figures of a shell under the names of shell.json."""
    scaled = scaled_jacobian(shell.bezier_elements())
    inner = inner_figures(shell)
    # an element with the scaled Jacobian 1 belongs to the last bin
    counts, _ = np.histogram(np.clip(scaled, 0.0, 1.0), BINS, (0.0, 1.0))
    return {
        "w0": float(shell.w0),
        "w0_rms": float(shell.w0_rms),
        "elements": len(certificate),
        "valid": certificate.valid,
        "valid_inside": certificate.valid_inside,
        "undecided": certificate.undecided,
        "invalid": certificate.invalid,
        "embedded": bool(shell.embedded),
        "min_scaled_jacobian": float(scaled.min()),
        "scaled_jacobian": {
            **{name: float(np.quantile(scaled, share)) for name, share in QUANTILES.items()},
            "mean": float(scaled.mean()),
            "histogram": counts.tolist(),
        },
        "min_bernstein": float(certificate.min_bernstein.min()),
        "thickness": {
            "min": float(inner.thickness.min()),
            "mean": float(np.average(inner.thickness, weights=inner.area)),
            "max": float(inner.thickness.max()),
        },
        "layers": shell.layer_count,
        "notes": list(shell.notes),
    }


def _cut_figures(shell: Shell) -> dict[str, Any]:
    """Proof, shape and volumes of a shell that is cut into layers."""
    certificate = certify(shell.bezier_elements())
    sizes = shell.element_volumes().reshape(-1, shell.layer_count)
    ratio = sizes.max(axis=1) / np.maximum(sizes.min(axis=1), np.finfo(float).tiny)
    grid = shell.surface.triangulation("greville")
    ends = evaluate_columns(
        shell, grid.vertex_patch, grid.vertex_uv, layer_parameters(shell, between=False)
    )
    heights = np.linalg.norm(np.diff(ends, axis=0), axis=2).mean(axis=1)
    return {
        "elements": len(certificate),
        "valid": certificate.valid,
        "not_proved": certificate.invalid + certificate.undecided,
        "min_scaled_jacobian": float(scaled_jacobian(shell.bezier_elements()).min()),
        "volume_ratio_median": float(np.median(ratio)),
        "volume_ratio_max": float(ratio.max()),
        "heights": heights.tolist(),
    }


def _bound(stage: Stage) -> np.ndarray:
    from HybridVolume.core.bound import scaled_jacobian_bound

    return scaled_jacobian_bound(stage.surface)


def work(folder: Path, channel: Channel) -> None:
    """All cases of the job; what cannot be made is a case with an error."""
    task = json.loads((folder / job.OPTIONS_FILE).read_text(encoding="utf-8"))
    cases = Path(task["options"]["cases"])
    options = task["options"]
    head = {"body": task["name"], "key": options["key"], "words": options["words"],
            "options": options["options"]}  # fmt: skip
    made: dict[str, Any] = {}
    started = time.perf_counter()
    try:
        bench = Bench(exchange.read_surface(folder / job.SURFACE_FILE), options, channel.progress)
        made = bench.figures()
        bench.prepare()
        made.update(bench.prepared())
    except Exception as fault:
        values = {**no_shell(told(fault)), "seconds": time.perf_counter() - started}
        for name, asked in options["asked"].items():
            write_case(cases, name, {**head, **asked, **made, **values})
        return
    kinds = {
        "shell": lambda asked: bench.shell(asked["w0_asked"]),
        "shape": lambda asked: bench.shell(asked["w0_asked"], SHAPE_FIRST),
        "free": lambda asked: bench.shell(asked["w0_asked"]),
        "levels": lambda asked: {"levels": bench.levels(asked["w0_asked"])},
        "paper": lambda asked: {"paper": bench.paper(asked["w0_asked"])},
        "rivals": lambda asked: bench.rivals(asked["w0_asked"], folder / RIVALS_FILE),
    }
    for name, asked in options["asked"].items():
        started = time.perf_counter()
        try:
            values = kinds[asked["kind"]](asked)
        except Exception as fault:
            values = {**no_shell(told(fault)), "bound": made["bound"]}
            values["seconds"] = time.perf_counter() - started
        write_case(cases, name, {**head, **asked, **made, **values})
        channel.send(stage="case", fraction=0.0, text=name)


def main(arguments: list[str] | None = None) -> int:
    """Run one job; return the exit code."""
    return case_main(work, arguments)


if __name__ == "__main__":
    sys.exit(main())
