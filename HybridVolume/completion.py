# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What the command line does: the bodies of a file completed, and everything that comes of them."""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from HybridVolume import report
from HybridVolume.delivery import OutputFolder
from HybridVolume.errors import HybridVolumeError, InputError
from HybridVolume.freecad_python import import_freecad
from HybridVolume.job import (
    EXPORTS,
    MESH_EXPORTS,
    REPORT_FILE,
    SHELL_EXPORTS,
    SURFACE_EXPORTS,
    Job,
    Progress,
    exit_code,
    worker_python,
)
from HybridVolume.screen import Screen
from HybridVolume.side_by_side import in_order, workers_at_once

logger = logging.getLogger(__name__)


@dataclass
class Outcome:
    """What became of one body: its part of the report, or why there is none."""

    name: str
    report: dict[str, Any] | None = None
    error: HybridVolumeError | None = None


def complete_file(options: argparse.Namespace, screen: Screen) -> int:
    """Complete all bodies of a file and write what comes out.

    Parameters
    ----------
    options : argparse.Namespace
        Of the command line.
    screen : Screen

    Returns
    -------
    int
        0 when all bodies are certified, else the highest exit code of those that are not.

    Raises
    ------
    HybridVolumeError
        Nothing could be delivered.
    """
    started = time.perf_counter()
    stem = Path(options.body).stem
    with OutputFolder(options.output or Path.cwd() / stem) as output:
        import_freecad()
        python = worker_python()
        from HybridVolume import sources
        from HybridVolume.core.pipeline import Options
        from HybridVolume.objects.volume import options_of

        parameters = parameters_of(options)
        Options(**options_of(parameters))  # refuses what is out of range before the long work
        geometry = _Geometry(options.midstructure) if _names_file(options) else None
        surfacing = sources.Surfacing(options.scheme, options.steps, options.sharp_angle)
        bodies = sources.read_file(
            options.body,
            surfacing,
            cover=options.cover,
            tolerance=options.cover_tolerance,
            free_only=options.free_only,
            python=python,
            progress=screen.progress,
        )
        for body in bodies:
            if body.cover is not None:
                screen.line(f"{body.name}: {body.origin['geometry']['sentence']}")
            for note in body.origin.get("mesh", {}).get("notes", ()):
                screen.line(f"{body.name}: {note}")
        check_named_faces(options.decisions, bodies)
        check_faces(parameters["FaceFactors"], bodies)
        check_faces(options.face_sizes, bodies, "size")
        reading = time.perf_counter() - started
        writer = _Writer(options, parameters, geometry, output, screen, python, len(bodies))
        outcomes = writer.complete_all(bodies)
        refused = [outcome for outcome in outcomes if outcome.error]
        drawn = [
            writer.draw_refusal(body, outcome.error)
            for body, outcome in zip(bodies, outcomes, strict=True)
        ]
        if len(refused) == len(outcomes):
            if any(drawn):
                names = ", ".join(output.deliver())
                screen.line(f"{os.path.relpath(output.path)}: {names} (where it is refused)")
            raise refused[0].error
        check_matched(options.decisions, outcomes)
        writer.save_document(stem)
        writer.save_report(outcomes, reading, started)
        names = output.deliver()
    for outcome in outcomes:
        if outcome.report:
            screen.line(summary(outcome))
            if outcome.report["evening"]["sentence"]:
                screen.line(f"{outcome.name}: {outcome.report['evening']['sentence']}")
            if outcome.report["shell"]["sentence"]:
                screen.line(f"{outcome.name}: {outcome.report['shell']['sentence']}")
    screen.clear()
    for outcome in refused:
        notes = getattr(outcome.error, "__notes__", ())
        print("\n".join([f"error: {outcome.name}: {outcome.error.line}", *notes]), file=sys.stderr)
    seconds = time.perf_counter() - started
    screen.line(f"{os.path.relpath(output.path)}: {', '.join(names)} ({seconds:.1f} s)")
    return max((exit_code(outcome.error) for outcome in refused), default=0)


def summary(outcome: Outcome) -> str:
    """Return the figures of a completed body in a line."""
    shell, fem = outcome.report["shell"], outcome.report["fem"]
    return (
        f"{outcome.name}: w0 {shell['w0']:.2f}, {shell['thickness']['mean']:.3g} mm, "
        f"{shell['elements']} shell elements, all proved valid, "
        f"{outcome.report['interior']['tets']} tets; FEM mesh of {fem['nodes']} nodes, smallest "
        f"scaled Jacobian {fem['min_scaled_jacobian']:.2g}"
    )


def parameters_of(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options of the command line under the names that document objects use.

    Raises
    ------
    InputError
        A value is out of its range, or two do not go together.
    """
    from HybridVolume.core.density import Density, parse_sizes
    from HybridVolume.core.goals import Thickness, parse_factors
    from HybridVolume.core.levels import Spacing
    from HybridVolume.objects.density import density_parameters
    from HybridVolume.objects.spans import KEYWORDS as SPANS
    from HybridVolume.objects.thickness import spacing_parameters, thickness_parameters

    if options.elements == "hex20" and options.order == 1:
        raise InputError(
            "--elements hex20 is of second order", remedy="leave out --order 1 or --elements hex20"
        )
    factors = parse_factors(options.face_factors)
    density = Density(
        nodes=options.nodes,
        subdivide=options.subdivide,
        size=options.size,
        face_sizes=parse_sizes(options.face_sizes),
        gradation=options.gradation,
        layers=options.fem_layers,
        growth=options.layer_growth,
    )
    return {
        **thickness_parameters(Thickness.parse(options.thickness or f"{options.w0!r}", factors)),
        **spacing_parameters(Spacing.parse(options.spacing)),
        "Method": options.method,
        "Layers": options.layers,
        "Degree": options.degree,
        "Tolerance": options.tolerance,
        "CoverTolerance": options.cover_tolerance or 0.0,
        **{name: getattr(options, keyword) for keyword, name in SPANS.items()},
        "Midstructure.Method": "own" if _names_file(options) else options.midstructure,
        "Midstructure.Samples": options.samples,
        "Midstructure.Angle": options.angle,
        "Midstructure.MinimumSize": options.minimum_size,
        "Midstructure.Depth": options.depth,
        "Midstructure.Decisions": tuple(options.decisions),
        "FemMesh.Order": "Second" if options.order == 2 else "First",
        **{f"FemMesh.{name}": value for name, value in density_parameters(density).items()},
    }


def _names_file(options: argparse.Namespace) -> bool:
    return bool(Path(options.midstructure).suffix)


def decisions_about(decisions: Sequence[str], body: Any) -> list[str]:
    """The decisions whose two faces a body has."""
    from HybridVolume.core.midstructure import Decision

    names = {face.name for face in body.faces}
    return [text for text in decisions if names.issuperset(Decision.parse(text).faces)]


def faces_about(texts: Sequence[str], body: Any, what: str = "factor") -> list[str]:
    """The factors or sizes, as ``"Face3 = 1.5"``, whose face a body has.

    Parameters
    ----------
    texts : sequence of str
    body : Body
    what : {"factor", "size"}
    """
    from HybridVolume.core.density import parse_size
    from HybridVolume.core.goals import parse_factor

    parse: Callable = {"factor": parse_factor, "size": parse_size}[what]
    names = {face.name for face in body.faces}
    return [text for text in texts if parse(text)[0] in names]


def check_faces(texts: Sequence[str], bodies: Sequence[Any], what: str = "factor") -> None:
    """Refuse a factor or size of a face that no body has, before the long work.

    Parameters
    ----------
    texts, what
        As for :func:`faces_about`.
    bodies : sequence of Body

    Raises
    ------
    InputError
    """
    usable = [body for body in bodies if not body.error]
    for text in texts:
        if usable and not any(faces_about([text], body, what) for body in usable):
            most = max(map(_face_count, usable))
            raise InputError(
                f"the {what} {text}: no body has this face",
                remedy=f"name one of Face1 to Face{most}",
            )


def _face_count(body: Any) -> int:
    """Faces of a body, each of which may have many patches."""
    return len({face.name for face in body.faces})


def check_named_faces(decisions: Sequence[str], bodies: Sequence[Any]) -> None:
    """Refuse a decision about faces that no body has, before the long work.

    Raises
    ------
    InputError
    """
    usable = [body for body in bodies if not body.error]
    for text in decisions:
        if usable and not any(decisions_about([text], body) for body in usable):
            most = max(map(_face_count, usable))
            raise InputError(
                f"{text}: no body has these faces", remedy=f"name two of Face1 to Face{most}"
            )


def check_matched(decisions: Sequence[str], outcomes: Sequence[Outcome]) -> None:
    """Refuse a decision that fits no sheet of any body that was completed with it.

    Raises
    ------
    InputError
    """
    for text in decisions:
        found = [one.report["midstructure"] for one in outcomes if one.report]
        given = [figures for figures in found if text in figures["decided"]]
        if given and all(text in figures["unmatched"] for figures in given):
            largest = [sheet["name"] for figures in given for sheet in figures["decisions"][:5]]
            raise InputError(
                f"{text}: no such sheet", remedy=f"the largest sheets are {', '.join(largest)}"
            )


class _Geometry:
    """Points, wires or faces of a file, shared out among the bodies."""

    def __init__(self, path: str) -> None:
        from HybridVolume.objects import own_geometry

        self._shape = own_geometry.read_geometry(path)
        self._name = Path(path).name

    def of(self, body: Any, *, alone: bool) -> Any:
        """The part for one body, a Part.Shape; everything where the body is alone.

        Raises
        ------
        InputError
            Nothing lies inside the body.
        """
        from HybridVolume.objects.own_geometry import parts_inside

        if alone:
            return self._shape
        part = parts_inside(self._shape, body.shape)
        if part is None:
            raise InputError(
                f"nothing in {self._name} lies inside this body",
                remedy="add points, wires or faces for it",
            )
        return part


@dataclass(frozen=True)
class _Task:
    """A body, its job, and what is to be kept with its result."""

    body: Any
    outcome: Outcome
    parameters: dict[str, Any]
    geometry: Any
    job: Job


class _Writer:
    """Completes bodies and collects what is delivered."""

    def __init__(
        self,
        options: argparse.Namespace,
        parameters: dict[str, Any],
        geometry: _Geometry | None,
        output: OutputFolder,
        screen: Screen,
        python: str,
        bodies: int,
    ) -> None:
        self._options = options
        self._parameters = parameters
        self._geometry = geometry
        self._output = output
        self._screen = screen
        self._python = python
        self._bodies = bodies
        shells = [name for name in dict.fromkeys(options.export) if name in SHELL_EXPORTS]
        self._exports = (
            *EXPORTS,
            *(("pictures",) if options.pictures else ()),
            *((*shells, "core") if shells else ()),
        )
        self._prepared: list[Any] = []
        self._document_seconds = 0.0

    def complete_all(self, bodies: Sequence[Any]) -> list[Outcome]:
        """Complete bodies, some side by side, and take the results in the order of the file.

        A refusal is kept in the outcome.
        """
        outcomes = [Outcome(body.name, error=body.error) for body in bodies]
        tasks: list[_Task] = []
        for body, outcome in zip(bodies, outcomes, strict=True):
            if outcome.error is None:
                try:
                    tasks.append(self._task(body, outcome))
                except HybridVolumeError as error:
                    outcome.error = error
        jobs = [task.job for task in tasks]
        with contextlib.closing(in_order(jobs, workers_at_once(), self._screen.progress)) as ended:
            for task, job in zip(tasks, ended, strict=True):
                try:
                    task.outcome.report = self._taken(task, job.outcome())
                except HybridVolumeError as error:
                    task.outcome.error = error
        return outcomes

    def draw_refusal(self, body: Any, error: HybridVolumeError | None) -> bool:
        """Draw where a body is refused, ``NAME_refused.png``; whether there is a picture.

        Only where the error has places. The refusal stands without a picture as well.
        """
        if error is None or not error.places:
            return False
        from HybridVolume.exports.red_places import write_refusal

        path = self._output.files / f"{body.name}_refused.png"
        try:
            write_refusal(path, body.name, body.faces, error, self._python)
        except (HybridVolumeError, OSError) as fault:
            logger.info("no picture of the refusal: %s", fault)
            return False
        return True

    def _task(self, body: Any, outcome: Outcome) -> _Task:
        from HybridVolume.objects import own_geometry, volume

        alone = self._bodies == 1
        parameters = dict(self._parameters)
        parameters["Midstructure.Decisions"] = tuple(decisions_about(self._options.decisions, body))
        for name, what in (("FaceFactors", "factor"), ("FemMesh.FaceSizes", "size")):
            parameters[name] = tuple(faces_about(parameters[name], body, what))
        geometry = own = None
        if self._geometry:
            geometry = self._geometry.of(body, alone=alone)
            own = own_geometry.tessellate([geometry])
            parameters[volume.GEOMETRY] = own_geometry.geometry_fingerprint([geometry])
        job = Job(
            body.faces,
            name=body.name,
            options={
                **volume.options_of(parameters),
                "singular_lines": self._options.singular_lines,
                "strict_decisions": alone,
            },
            own=own,
            source={
                "file": Path(self._options.body).name,
                "bodies": self._bodies,
                **body.origin,
            },
            exports=self._exports,
            elements=self._options.elements,
            python=self._python,
            free_only=self._options.free_only,
            parent=self._output.scratch,
        )
        return _Task(body, outcome, parameters, geometry, job)

    def _taken(self, task: _Task, result: Any) -> dict[str, Any]:
        """Take what a job has made; returns the body's part of the report."""
        from HybridVolume.core.assembly import build_surface
        from HybridVolume.exports.mesh_file import write_mesh
        from HybridVolume.exports.step import write_solid
        from HybridVolume.objects import document, volume

        body, job = task.body, task.job
        started = time.perf_counter()
        stored = self._output.scratch / f"{body.name}.npz"
        job.result_file.rename(stored)
        prepared = document.Prepared(
            document.Completed(
                body=body,
                solid=1,
                volume=result,
                result=stored,
                report=job.report(),
                parameters=task.parameters,
                fingerprint=volume.fingerprint(body.shape),
                geometry=task.geometry,
            )
        )
        for export in self._exports:
            for file in job.exported_files(export):
                file.rename(self._output.files / file.name)
        for name in dict.fromkeys(self._options.export):
            if name in SHELL_EXPORTS:
                # the worker wrote it
                continue
            file = {**MESH_EXPORTS, **SURFACE_EXPORTS}[name].format(body.name)
            self._screen.progress(body.name, Progress("exports", 0.97, f"writing {file}"))
            if name in SURFACE_EXPORTS:
                write_solid(self._output.files / file, build_surface(list(body.faces)))
            else:
                write_mesh(self._output.files / file, result.fem)
        self._prepared.append(prepared)
        self._document_seconds += time.perf_counter() - started
        return prepared.report

    def save_document(self, stem: str) -> None:
        """Write the FreeCAD document with all bodies."""
        from HybridVolume.objects import document

        self._screen.progress(stem, Progress("document", 0.98, f"writing {stem}.FCStd"))
        started = time.perf_counter()
        document.save_new(self._prepared, self._output.files / f"{stem}.FCStd")
        self._document_seconds += time.perf_counter() - started

    def save_report(self, outcomes: Sequence[Outcome], reading: float, started: float) -> None:
        """Write report.json."""
        figures = report.file_report(
            [outcome.report for outcome in outcomes if outcome.report],
            [(outcome.name, outcome.error) for outcome in outcomes if outcome.error],
            {"reading": reading, "document": self._document_seconds},
            time.perf_counter() - started,
        )
        report.write(figures, self._output.files / REPORT_FILE)
