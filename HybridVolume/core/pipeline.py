# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The whole way from a closed surface to a hybrid volume, one stage after the other."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..errors import FaultError, InputError
from .bending_spans import grown_again
from .check import SingularPlaces, check_surface, check_uncut
from .density import Density
from .embedding_proof import prove_embedded
from .even import Evenness, even_as_needed, evening_figures
from .finite_elements import build_finite_elements
from .gap import check_balance, gap_volume
from .goals import Thickness, check_faces
from .growth import grow_shell
from .harmonic import HarmonicField, solve_harmonic
from .hybrid import HybridVolume
from .levels import Spacing
from .midstructure import Midstructure, Search, find_midstructure
from .paper import WHY, check_wishes, paper_field, paper_shell
from .rational_spans import follow_rational
from .reached import expected_figures, isosurface_figures, layer_heights, reached_figures
from .refinement import divide_faces, flatten_spans
from .sizes import wanted_lines
from .surface import PatchSurface

logger = logging.getLogger(__name__)

METHODS = ("certified", "paper")
"""Ways to make the shell."""

NAMED_SHEETS = 10
"""Sheets, the largest, that an error about a decision names."""

Progress = Callable[[str, float, str], None]
Observe = Callable[[str, Any], None]
"""Gets what a stage has made that the hybrid volume does not hold: ``"field"``."""
Own = tuple[np.ndarray, np.ndarray]
"""Geometry of the user's: vertices (m, 3), mm, and facets (f, 3), see `Midstructure.facets`."""


@dataclass(frozen=True)
class Options:
    """What a user can choose.

    Attributes
    ----------
    w0 : float
        Harmonic level of the inner boundary: 0 is the surface, 1 the midstructure.
    thickness : str
        In place of w0, where given, as for `Thickness.parse`: ``"2 mm"`` everywhere,
        ``"mean 2 mm"``, ``"min 2 mm"``, or ``"30 %"`` of the local radius.
    method : {"certified", "paper"}
        How the shell is made: by the front and the untangling, or as in the paper's section 3,
        for comparison. Both are proved, and refused where the proof fails.
    face_factors : mapping of str to float
        By what the thickness is multiplied at CAD faces.
    layers : int
        Bézier layers of the shell.
    spacing : str
        Heights of the layers, as for `Spacing.parse`.
    degree : int
        Degree across the shell.
    tolerance : float
        Largest gap between sides that meet, as a share of the diagonal.
    span_size, span_aspect, span_turn : float
        How even knot spans are to be made first: longest side (mm), longest over shortest side,
        largest turn of the normal (degrees), as in `Evenness`; 0: as the shell needs.
    midstructure : str
        Its kind, the ``method`` of `Search`.
    samples, angle, minimum_size, depth, decisions
        As in `Search`.
    singular_lines : bool
        Let a surface pass whose normal is zero along lines, where control points are doubled; it
        is zero in corners of 180 degrees anyway. Everything around is proved.
    strict_decisions : bool
        Refuse a decision that fits no sheet; otherwise it is only told in the report.
    nodes : {"knots", "greville"}
        Nodes of the interface.
    order : {1, 2}
        Order of the finite elements.
    engine : {"auto", "netgen", "gmsh"}
        Mesher of the core.
    subdivide, size, face_sizes, gradation, growth
        How fine the finite elements are, as in `Density`.
    fem_layers : int
        Layers of finite elements through the shell, the ``layers`` of `Density`.

    Raises
    ------
    InputError
        A value is out of its range.
    """

    w0: float = 0.5
    thickness: str = ""
    method: str = "certified"
    face_factors: Mapping[str, float] = field(default_factory=dict)
    layers: int = 2
    spacing: str = "volume"
    degree: int = 3
    tolerance: float = 1e-7
    span_size: float = 0.0
    span_aspect: float = 0.0
    span_turn: float = 0.0
    midstructure: str = "auto"
    samples: int = 0
    angle: float = 125.0
    minimum_size: float = 1.0
    depth: str = "50%"
    decisions: tuple[str, ...] = ()
    singular_lines: bool = False
    strict_decisions: bool = False
    nodes: str = "knots"
    order: int = 2
    engine: str = "auto"
    subdivide: int = 1
    size: float = 0.0
    face_sizes: Mapping[str, float] = field(default_factory=dict)
    gradation: float = 0.5
    fem_layers: int = 0
    growth: float = 1.3

    @property
    def density(self) -> Density:
        """How fine the finite elements are."""
        return Density(
            self.nodes,
            self.subdivide,
            self.size,
            self.face_sizes,
            self.gradation,
            self.fem_layers,
            self.growth,
        )

    @property
    def evenness(self) -> Evenness:
        """How even knot spans are to be made."""
        return Evenness(self.span_size, self.span_aspect, self.span_turn)

    @property
    def search(self) -> Search:
        """How the midstructure is found."""
        return Search(
            method=self.midstructure,
            samples=self.samples,
            angle=self.angle,
            minimum_size=self.minimum_size,
            depth=self.depth,
            decisions=tuple(self.decisions),
        )

    @property
    def goal(self) -> Thickness:
        """How thick the shell should be."""
        if self.thickness:
            return Thickness.parse(self.thickness, self.face_factors)
        return Thickness("w0", self.w0, self.face_factors)

    def __post_init__(self) -> None:
        object.__setattr__(self, "decisions", self.search.decisions)
        self.goal, Spacing.parse(self.spacing), self.density, self.evenness  # refused here
        choices = {
            "method": METHODS,
            "nodes": ("knots", "greville"),
            "order": (1, 2),
            "engine": ("auto", "netgen", "gmsh"),
        }
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                words = ", ".join(str(a) for a in allowed)
                raise InputError(
                    f"{name} is {getattr(self, name)!r}", remedy=f"choose one of {words}"
                )
        if self.method == "paper":
            check_wishes(self.thickness, self.face_factors, self.spacing)
        ranges = {
            "w0": (0.01, 0.99),
            "layers": (1, 50),
            "degree": (1, 6),
            "tolerance": (1e-12, 1e-2),
        }
        for name, (low, high) in ranges.items():
            if not low <= getattr(self, name) <= high:
                raise InputError(
                    f"{name} is {getattr(self, name)}",
                    remedy=f"choose a value from {low} to {high}",
                )


@dataclass(frozen=True)
class Stage:
    """The body and its midstructure, as far as all goals go the same way.

    Attributes
    ----------
    surface : PatchSurface
        Refined; the same surface as the one given.
    deviation : float
        Largest distance of the two, mm.
    midstructure : Midstructure
    singular : SingularPlaces
        Where the surface itself is singular, and stays so.
    evening : mapping
        Knot spans as asked for, as given and as they are, see `evening_figures`.
    """

    surface: PatchSurface
    deviation: float
    midstructure: Midstructure
    singular: SingularPlaces = SingularPlaces()
    evening: Mapping[str, Any] = field(default_factory=dict)


def complete(
    surface: PatchSurface,
    options: Options | None = None,
    progress: Progress | None = None,
    own: Own | None = None,
    observe: Observe | None = None,
) -> HybridVolume:
    """Complete the volume of a closed surface.

    Parameters
    ----------
    surface : PatchSurface
        From :func:`HybridVolume.core.assembly.build_surface`.
    options : Options, optional
    progress : callable, optional
        Called with the stage, the share of the whole work that is done, and a text.
    own : (vertices, facets), optional
        Geometry for the midstructure ``own``.
    observe : callable, optional
        Called with ``"field"`` and the `HarmonicField` when it is there: pictures need it, the
        result does not keep it.

    Returns
    -------
    HybridVolume
        Every Bézier element is proved valid, and the inner surface cuts neither itself nor the
        outer one.

    Raises
    ------
    HybridVolumeError
        One of its kinds, naming faces, figures and a remedy.
    """
    options = options or Options()
    report = progress or _silent
    spacing = Spacing.parse(options.spacing)
    stage = midstructure_stage(surface, options, report, own)
    body = stage.surface
    wanted_lines(body, options.density)  # too many nodes are refused before the long work
    field = field_stage(stage, options, report)
    if observe:
        observe("field", field)
    report("shell", 0.3, f"{len(field.mesh.tets)} tetrahedra in the field; front")
    across = {
        "layers": options.layers,
        "degree_w": options.degree,
        "progress": lambda share, text: report("shell", 0.3 + 0.45 * share, text),
    }
    if options.method == "paper":
        shell, certificate = paper_shell(body, field, options.w0, **across)
    else:
        shell, certificate = grow_shell(body, field, options.goal, spacing=spacing, **across)
        if not (options.thickness or options.face_factors or options.evenness.asks):
            body, shell, certificate = grown_again(
                body,
                (shell, certificate),
                options.w0,
                lambda finer: grow_shell(finer, field, options.goal, spacing=spacing, **across),
            )
    if stage.singular.places:
        shell = replace(shell, notes=(stage.singular.sentence, *shell.notes))
    report("interior", 0.75, f"{certificate.valid} elements proved; interface, core, FEM mesh")
    interface, interior, fem = build_finite_elements(
        shell, options.density, order=options.order, engine=options.engine
    )
    report("interior", 0.9, f"{len(interior.mesh.tets)} tetrahedra in the core; balance")
    gap = gap_volume(interface, shell)
    check_balance(body, shell, interior, gap)
    embedding = {
        "outer": prove_embedded(body).proved,
        "inner": prove_embedded(shell.inner_surface()).proved,
    }
    top = float(shell.goal.max()) if len(shell.goal) else options.w0
    topology = isosurface_figures(field, body, top)
    why = WHY if options.method == "paper" else ""
    return HybridVolume(
        surface=body,
        midstructure=stage.midstructure,
        field={
            "tets": len(field.mesh.tets),
            "vertices": len(field.mesh.vertices),
            "mesher": field.mesh.engine,
            "embedded": bool(field.embedded),
        },
        shell=shell,
        certificate=certificate,
        interior=interior,
        interface=interface,
        fem=fem,
        gap_volume=gap,
        report={
            "boundary_deviation": stage.deviation,
            "evening": evening_figures(options.evenness, surface, body),
            "search": search_figures(options),
            "method": options.method,
            "spacing": spacing.text,
            "layer_heights": layer_heights(shell),
            "embedding_proved": embedding,
            "isosurface": topology,
            **reached_figures(shell, options.goal, why, topology["w0_used"]),
        },
    )


def midstructure_stage(
    surface: PatchSurface,
    options: Options | None = None,
    progress: Progress | None = None,
    own: Own | None = None,
) -> Stage:
    """Check a body and find its midstructure, with the user's decisions applied.

    Faces that factors or sizes are given for must be there: a slip of the pen costs no time.

    Parameters
    ----------
    surface, options, progress, own
        As for :func:`complete`.

    Returns
    -------
    Stage
        Its midstructure may be without kept facets, where the decisions remove all.

    Raises
    ------
    InputError
        The body is singular or cuts itself, the user's geometry does not fit, or, where that is
        asked for, a decision fits no sheet.
    """
    options = options or Options()
    report = progress or _silent
    report("surface", 0.02, f"{len(surface.patches)} patches, genus {_words(surface.genus)}")
    check_faces([*options.face_factors, *options.face_sizes], surface)
    varied = [face for face, factor in options.face_factors.items() if factor != 1.0]
    body = even_as_needed(flatten_spans(divide_faces(surface, varied)), options.evenness)
    body = follow_rational(body)
    deviation = _deviation(surface, body)
    singular = check_surface(body, lines=options.singular_lines)
    check_uncut(body)
    search = options.search
    kind = "medial axis" if search.method == "auto" else search.method.replace("-", " ")
    report("midstructure", 0.05, kind)
    found = find_midstructure(body, search, own)
    if found.unmatched and options.strict_decisions:
        raise InputError(
            f"{_listed(found.unmatched)}: no such sheet",
            figure=float(len(found.unmatched)),
            remedy=f"the largest sheets are {sheet_names(found)}",
        )
    for decision in found.unmatched:
        logger.warning("%s fits no sheet", decision)
    evening = evening_figures(options.evenness, surface, body)
    return Stage(body, deviation, found, singular, evening)


def field_stage(
    stage: Stage, options: Options | None = None, progress: Progress | None = None
) -> HarmonicField:
    """Solve the harmonic field between the surface and the midstructure.

    Raises
    ------
    InputError
        Nothing of the midstructure is kept.
    """
    found = stage.midstructure
    report = progress or _silent
    if not found.kept.any():
        decided = _listed((options or Options()).decisions) or "the choice"
        raise InputError(
            f"nothing is left of the midstructure after {decided}",
            figure=0.0,
            remedy=f"keep a sheet; the largest are {sheet_names(found)}",
        )
    report("field", 0.12, f"{found.kept_sheets} sheets kept; harmonic field")
    solve = paper_field if options is not None and options.method == "paper" else solve_harmonic
    return solve(stage.surface, found)


def thickness(
    surface: PatchSurface,
    options: Options | None = None,
    progress: Progress | None = None,
    own: Own | None = None,
) -> tuple[Stage, HarmonicField, dict[str, Any]]:
    """Tell how thick the shell will be, without making it.

    Parameters
    ----------
    surface, options, progress, own
        As for :func:`complete`.

    Returns
    -------
    stage : Stage
    field : HarmonicField
    figures : dict
        As of :func:`HybridVolume.core.reached.expected_figures`, mm.

    Raises
    ------
    HybridVolumeError
        As :func:`complete`, as far as the field.
    """
    options = options or Options()
    report = progress or _silent
    stage = midstructure_stage(surface, options, report, own)
    field = field_stage(stage, options, report)
    report("thickness", 0.9, f"{len(field.mesh.tets)} tetrahedra in the field; distances")
    return stage, field, expected_figures(field, stage.surface, options.goal)


def search_figures(options: Options) -> dict[str, Any]:
    """Plain values of how the midstructure was asked for."""
    search = options.search
    return {
        "asked": search.method,
        "samples": search.samples,
        "angle": search.angle,
        "minimum_size": search.minimum_size,
        "depth": search.depth,
        "decided": list(search.decisions),
    }


def sheet_names(midstructure: Midstructure) -> str:
    """Names of the largest sheets."""
    names = [sheet.name for sheet in midstructure.sheets]
    more = len(names) - NAMED_SHEETS
    return ", ".join(names[:NAMED_SHEETS]) + (f" and {more} more" if more > 0 else "")


def _silent(stage: str, share: float, text: str) -> None:
    pass


def _listed(decisions: tuple[str, ...]) -> str:
    return ", ".join(decisions)


def _words(genus: tuple[int, ...]) -> str:
    return ", ".join(str(g) for g in genus)


def _deviation(surface: PatchSurface, body: PatchSurface) -> float:
    """Largest distance of the refined surface from the one given, 25 places a patch, mm.

    Raises
    ------
    FaultError
        It is not zero within rounding.
    """
    line = np.linspace(0.0, 1.0, 5) * 0.98 + 0.007
    u, v = (np.tile(a.ravel(), len(surface.patches)) for a in np.meshgrid(line, line))
    patch = np.repeat(np.arange(len(surface.patches)), line.size**2)
    worst = float(np.abs(surface.evaluate_at(patch, u, v) - body.evaluate_at(patch, u, v)).max())
    # coordinates far from the origin have no more digits than that
    digits = np.finfo(float).eps * float(np.abs(surface.control_points).max())
    if worst > 1e-12 * surface.diagonal + 16.0 * digits:
        raise FaultError(f"exact refinement moved the surface by {worst:.2g} mm")
    return worst
