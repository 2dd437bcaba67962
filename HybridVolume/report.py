# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The figures of report.json; docs/report.md says what each means.

A body's part is put together in the worker; the reader and FreeCAD add what only they know.
"""

from __future__ import annotations

import importlib.metadata
import json
import math
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume import __version__
from HybridVolume.core.covering.kinds import ROUNDING
from HybridVolume.errors import FaultError, HybridVolumeError
from HybridVolume.geometry_figures import with_moves

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh
    from HybridVolume.core.hybrid import HybridVolume
    from HybridVolume.core.midstructure import Midstructure
    from HybridVolume.core.pipeline import Options, Stage
    from HybridVolume.core.shell import Shell
    from HybridVolume.core.surface import PatchSurface

SCHEMA = 2
"""Version of report.json: goes up when a key is removed or changes its meaning."""

WHEELS = ("numpy", "scipy", "netgen-mesher", "gmsh", "pytetwild", "cgal", "scikit-fem", "pyvista")

_ROW = 600
"""Characters that a row of a table may have to be written as one line."""

_ROUNDING = 1e-13
"""Moves of control points below this share of the diagonal come from exact refinement."""


def volume_report(
    volume: HybridVolume, source: Mapping[str, Any], seconds: Mapping[str, float]
) -> dict[str, Any]:
    """Return one body's part of the report.

    Parameters
    ----------
    volume : HybridVolume
    source : mapping
        What is known about the input besides its surface (``file``, ``bodies``).
    seconds : mapping of str to float
        Seconds by stage.
    """
    shell, interior = volume.shell, volume.interior
    shell_part = shell_figures(shell, volume)
    told = [shell_part["sentence"]] if shell_part["sentence"] else []
    given = input_part(source, volume.surface)
    return {
        "version": SCHEMA,
        "input": given,
        "evening": evening_part(volume.report.get("evening", {})),
        "midstructure": midstructure_figures(
            volume.midstructure, volume.report.get("search", {}), shell.w0
        ),
        "field": dict(volume.field),
        "shell": shell_part,
        "interior": {
            "tets": len(interior.mesh),
            "vertices": len(interior.mesh.vertices),
            "mesher": interior.mesh.engine,
            "boundary_exact": bool(interior.boundary_exact),
            "min_dihedral_deg": float(interior.min_dihedral),
            "volume": float(interior.volume),
        },
        "interface": {
            "nodes": len(volume.interface.vertices),
            "gap_volume": float(volume.gap_volume),
        },
        "fem": fem_figures(volume.fem),
        "notes": [
            *geometry_notes(given),
            *told,
            *shell.notes,
            *midstructure_notes(volume.midstructure),
        ],
        "seconds": {**seconds, "total": sum(seconds.values())},
        "peak_memory_mb": peak_memory_mb(),
        "versions": versions(),
    }


def stage_report(
    stage: Stage, options: Options, source: Mapping[str, Any], seconds: Mapping[str, float]
) -> dict[str, Any]:
    """Return the report of a body of which only the midstructure is there.

    Parameters
    ----------
    stage : Stage
    options : Options
    source, seconds
        As for :func:`volume_report`.
    """
    from HybridVolume.core.pipeline import search_figures

    given = input_part(source, stage.surface)
    return {
        "version": SCHEMA,
        "input": given,
        "evening": evening_part(stage.evening),
        "midstructure": midstructure_figures(
            stage.midstructure, search_figures(options), options.w0
        ),
        "notes": [*geometry_notes(given), *midstructure_notes(stage.midstructure)],
        "seconds": {**seconds, "total": sum(seconds.values())},
        "peak_memory_mb": peak_memory_mb(),
        "versions": versions(),
    }


def input_part(source: Mapping[str, Any], surface: PatchSurface) -> dict[str, Any]:
    """What is known about the input, and the figures of its surface.

    Parameters
    ----------
    source : mapping
        With ``geometry``, as :func:`HybridVolume.geometry_figures.geometry_figures` gives it, the
        faces are counted by what became of them there; else by their patches.
    surface : PatchSurface
    """
    found = {**source, **surface_figures(surface)}
    if "geometry" in source:
        # sides of covers are raised to common degrees and cut at common knots
        covered = source["geometry"]["tolerance"] is not None
        moved = surface.moved > (ROUNDING if covered else _ROUNDING) * surface.diagonal
        moves: dict[str, float] = {}
        for k in np.flatnonzero(moved).tolist():
            name = surface.patches[k].face
            moves[name] = max(moves.get(name, 0.0), float(surface.moved[k]))
        found["geometry"] = with_moves(source["geometry"], moves)
        counts = found["geometry"]["counts"]
        found |= {f"faces_{kind}": count for kind, count in counts.items()}
    return found


def geometry_notes(given: Mapping[str, Any]) -> list[str]:
    """Tell of a covered body what became of its faces.

    Parameters
    ----------
    given : mapping
        As :func:`input_part` gives it.
    """
    geometry = given.get("geometry", {})
    return [geometry["sentence"]] if geometry.get("tolerance") is not None else []


def surface_figures(surface: PatchSurface) -> dict[str, Any]:
    """Figures of the closed surface, and how its patches compare with the faces given."""
    moved = surface.moved > _ROUNDING * surface.diagonal
    return {
        "faces": len({patch.face for patch in surface.patches}),
        "patches": len(surface.patches),
        "control_points": len(surface.control_points),
        "genus": list(surface.genus),
        "shells": surface.shells,
        "closed": True,
        "volume": surface.volume(),
        "area": surface.area(),
        "faces_bit": int(np.count_nonzero(~moved & ~surface.exact)),
        "faces_exact": int(np.count_nonzero(~moved & surface.exact)),
        "faces_tolerance": int(np.count_nonzero(moved)),
        "max_move": float(surface.moved.max(initial=0.0)),
    }


def evening_part(evening: Mapping[str, Any]) -> dict[str, Any]:
    """How the knot spans of the surface were evened out.

    Parameters
    ----------
    evening : mapping
        As :func:`HybridVolume.core.even.evening_figures` gives it; empty of volumes of earlier
        versions.

    Returns
    -------
    dict
        The same, and ``sentence``: in words what was asked for and done; empty where both are
        nothing.
    """
    return {**evening, "sentence": _evening_sentence(evening)}


_STRIPS = "; strips are not cut for their aspect where fewer than half of their spans ask for it"
"""Why spans are longer than was asked."""


def _evening_sentence(evening: Mapping[str, Any]) -> str:
    if not evening:
        return ""
    asked, before, after = evening["asked"], evening["before"], evening["after"]
    words = (("size", "to {:.3g} mm"), ("aspect", "aspect to {:.3g}"), ("turn", "turn to {:.3g}°"))
    wanted = ", ".join(text.format(asked[name]) for name, text in words if asked[name])
    if before == after and not wanted:
        return ""
    missed = asked["aspect"] and after["aspect"] > 1.01 * asked["aspect"]
    return (
        f"{after['spans']} spans of the faces, {before['spans']} as given"
        f"{f' (asked: {wanted})' if wanted else ''}: longest {after['longest']:.3g} mm (was "
        f"{before['longest']:.3g}), aspect {after['aspect']:.3g} (was {before['aspect']:.3g}), "
        f"turn {after['turn']:.0f}° (was {before['turn']:.0f}°)"
        f"{_STRIPS if missed else ''}"
    )


def midstructure_figures(
    midstructure: Midstructure, search: Mapping[str, Any], w0: float
) -> dict[str, Any]:
    """Figures of the midstructure, and what was decided about each sheet.

    Parameters
    ----------
    midstructure : Midstructure
    search : mapping
        How it was asked for.
    w0 : float
        Of the shell, for the estimate of its thickness.
    """
    from HybridVolume.core.midstructure.hints import hints

    told = hints(midstructure, w0)
    return {
        "method": midstructure.method,
        **search,
        "sheets": len(midstructure.sheets),
        "kept": midstructure.kept_sheets,
        "facets": int(np.count_nonzero(midstructure.kept)),
        "area": midstructure.area,
        "pieces": told.pieces,
        "thinnest": told.thinnest,
        "thickest": told.thickest,
        "unreached": [
            {
                "faces": list(region.faces),
                "share": float(region.share),
                "distance": float(region.distance),
            }
            for region in told.unreached
        ],
        "unmatched": list(midstructure.unmatched),
        "decisions": [
            {
                "name": sheet.name,
                "faces": list(sheet.faces),
                "kept": bool(sheet.kept),
                "reason": sheet.reason,
                "area": float(sheet.area),
                "point": [float(x) for x in sheet.seed],
            }
            for sheet in midstructure.sheets
        ],
    }


def midstructure_notes(midstructure: Midstructure) -> list[str]:
    """Notes on decisions that fit no sheet, and on regions that nothing kept reaches."""
    from HybridVolume.core.midstructure.hints import hints

    return [
        *(f"{decision}: no such sheet, nothing was done" for decision in midstructure.unmatched),
        *(str(region) for region in hints(midstructure).unreached),
    ]


def shell_figures(shell: Shell, volume: HybridVolume) -> dict[str, Any]:
    """Figures of the shell and of its certificate.

    Raises
    ------
    FaultError
        The certificate is another shell's, or does not prove every element.
    """
    from HybridVolume.core.goals import Thickness
    from HybridVolume.core.reached import layer_heights, reached_figures
    from HybridVolume.core.validity import scaled_jacobian

    certificate = volume.certificate
    if len(certificate) != shell.element_count:
        raise FaultError(
            f"the certificate has {len(certificate)} elements, the shell {shell.element_count}"
        )
    if not (certificate.all_valid and shell.embedded):
        raise FaultError(
            f"only {certificate.valid} of {len(certificate)} elements are proved valid, or the "
            "inner surface cuts itself: this is no result"
        )
    told = volume.report
    # volumes of earlier versions do not tell what was asked but for the level
    reached = told if "faces" in told else reached_figures(shell, Thickness("w0", shell.w0_asked))
    heights = told["layer_heights"] if "layer_heights" in told else layer_heights(shell)
    sizes = shell.element_volumes()
    columns = sizes.reshape(-1, shell.layer_count)
    outer = np.abs(shell.layers[0] - volume.surface.control_points).max()
    return {
        "w0": float(shell.w0),
        "w0_rms": float(shell.w0_rms),
        "w0_asked": float(shell.w0_asked),
        "embedded": bool(shell.embedded),
        "embedding_proved": told.get("embedding_proved", {"outer": False, "inner": False}),
        **{name: reached[name] for name in ("asked", "thickness", "faces", "sentence")},
        "isosurface": told.get("isosurface", {}),
        "method": told.get("method", "certified"),
        "degree": shell.degree_w,
        "layers": shell.layer_count,
        "spacing": told.get("spacing", "volume"),
        "layer_heights": heights,
        "elements": len(certificate),
        "valid": certificate.valid,
        "undecided": certificate.undecided,
        "invalid": certificate.invalid,
        "valid_inside": certificate.valid_inside,
        "min_scaled_jacobian": float(scaled_jacobian(shell.bezier_elements()).min()),
        "min_bernstein": float(certificate.min_bernstein.min()),
        "volume": float(sizes.sum()),
        "boundary_deviation": float(max(outer, volume.report["boundary_deviation"])),
        "volume_ratio_max": float((columns.max(axis=1) / columns.min(axis=1)).max()),
    }


def fem_figures(fem: FiniteElementMesh) -> dict[str, Any]:
    """Figures of the finite element mesh: its size, how it was wanted, repairs, quality."""
    from HybridVolume.core.fem_quality import mesh_quality

    counts = dict.fromkeys(("penta15", "tet10", "penta6", "tet4"), 0)
    counts |= {fem.wedge_kind: len(fem.wedges), fem.tet_kind: len(fem.tets)}
    density = fem.density
    return {
        "nodes": len(fem.nodes),
        **counts,
        "min_scaled_jacobian": fem.min_scaled_jacobian,
        "volume": fem.volume,
        "layers": int(fem.wedge_layer.max(initial=-1)) + 1,
        "density": {**asdict(density), "face_sizes": dict(density.face_sizes)},
        "repairs": dict(fem.repairs),
        "quality": mesh_quality(fem).figures(),
    }


def file_report(
    reports: Sequence[Mapping[str, Any]],
    refused: Sequence[tuple[str, HybridVolumeError]],
    seconds: Mapping[str, float],
    total: float,
) -> dict[str, Any]:
    """Return the report of a whole file.

    Parameters
    ----------
    reports : sequence of mapping
        One for each completed body; at least one.
    refused : sequence of (str, HybridVolumeError)
        Names of the other bodies, and why.
    seconds : mapping of str to float
        Seconds spent on the whole file outside the workers.
    total : float
        Seconds from start to end.

    Returns
    -------
    dict
        The only body's figures at top level; of several, sums there and each in ``volumes``.
    """
    own = peak_memory_mb()
    if len(reports) == 1 and not refused:
        figures = dict(reports[0])
    else:
        figures = {"version": SCHEMA, **_sums(reports), "volumes": [dict(r) for r in reports]}
        figures["refused"] = [{"name": name, **error.to_dict()} for name, error in refused]
        figures["versions"] = reports[0]["versions"]
    stages: dict[str, float] = dict(seconds)
    for one in reports:
        for stage, spent in one["seconds"].items():
            if stage != "total":
                stages[stage] = stages.get(stage, 0.0) + spent
    figures["seconds"] = {**stages, "total": total}
    # The worker runs while FreeCAD waits: the sum of both peaks is what the machine must have.
    figures["peak_memory_mb"] = own + max(one["peak_memory_mb"] for one in reports)
    figures["versions"] = {**figures["versions"], **_freecad_version()}
    return figures


def _sums(reports: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Sums over bodies of everything that adds up."""
    summed = {
        "input": ("faces", "patches", "control_points", "shells", "volume", "area")
        + ("faces_bit", "faces_exact", "faces_tolerance"),
        "midstructure": ("sheets", "kept", "facets", "area"),
        "field": ("tets", "vertices"),
        "shell": ("elements", "valid", "undecided", "invalid", "valid_inside", "volume"),
        "interior": ("tets", "vertices", "volume"),
        "interface": ("nodes", "gap_volume"),
        "fem": ("nodes", "penta15", "tet10", "penta6", "tet4", "volume", "faces_covered"),
    }
    sums = {
        part: {name: sum(one[part][name] for one in reports) for name in names}
        for part, names in summed.items()
    }
    sums["input"] = {
        "file": reports[0]["input"]["file"],
        "bodies": reports[0]["input"]["bodies"],
        **sums["input"],
    }
    return sums


def peak_memory_mb() -> float:
    """Peak memory of this process plus that of its largest child so far, MB; 0 where unknown."""
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    unit = 1e6 if sys.platform == "darwin" else 1e6 / 1024.0
    usage = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_maxrss for one in usage) / unit


def versions() -> dict[str, str]:
    """Versions of this program, of Python and of the wheels that are installed."""
    found = {"HybridVolume": __version__, "python": platform.python_version()}
    for name in WHEELS:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def _freecad_version() -> dict[str, str]:
    freecad = sys.modules.get("FreeCAD")
    return {"FreeCAD": ".".join(freecad.Version()[:3])} if freecad else {}


def write(figures: Mapping[str, Any], path: Path) -> None:
    """Write a report as JSON.

    Raises
    ------
    FaultError
        A figure is not finite: it was never computed.
    """
    try:
        text = _text(figures)
    except ValueError:
        bad = ", ".join(_not_finite(figures))
        raise FaultError(f"figures of the report are not finite: {bad}") from None
    path.write_text(text + "\n", encoding="utf-8")


def _text(value: Any, indent: str = "") -> str:
    """JSON with a key a line; a row of a table, of which there may be thousands, is one line.

    Raises
    ------
    ValueError
        A figure is not finite.
    """
    deeper = indent + " "
    if isinstance(value, Mapping) and value:
        rows = [f"{json.dumps(str(key))}: {_text(one, deeper)}" for key, one in value.items()]
    elif isinstance(value, list | tuple) and any(isinstance(one, Mapping) for one in value):
        rows = [json.dumps(one, allow_nan=False) for one in value]
        if max(map(len, rows)) > _ROW:
            rows = [_text(one, deeper) for one in value]
    else:
        return json.dumps(value, allow_nan=False)
    first, last = "{}" if isinstance(value, Mapping) else "[]"
    return f"{first}\n{deeper}" + f",\n{deeper}".join(rows) + f"\n{indent}{last}"


def _not_finite(value: Any, name: str = "") -> list[str]:
    if isinstance(value, Mapping):
        return [
            bad for key, v in value.items() for bad in _not_finite(v, f"{name}.{key}".strip("."))
        ]
    if isinstance(value, list | tuple):
        return [bad for i, v in enumerate(value) for bad in _not_finite(v, f"{name}[{i}]")]
    return [name] if isinstance(value, float) and not math.isfinite(value) else []
