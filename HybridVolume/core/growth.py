# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""From a surface and a field to a certified shell: start, optimise, prove, or start thin and grow.

A state of the columns counts only when two conditions hold together: every Bézier element is proved
valid (local), and the inner surface neither cuts itself nor touches the outer one (global).
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from .. import errors
from . import bspline
from .front import ColumnFrame, check_surface, column_frame, solve_front
from .harmonic import HarmonicField
from .intersection import self_intersections, surfaces_intersect
from .levels import equal_volume_layers, uniform_layers
from .shell import Shell
from .surface import PatchSurface
from .untangle import ColumnEnergy, optimise
from .validity import Certificate, certify

logger = logging.getLogger(__name__)

FIDELITIES = (0.3, 3.0)
"""Weights of the isosurface term, one after the other."""
CLOSE = 10.0
"""Weight that follows when the level reached is more than a tenth off."""
THIN_STARTS = (0.5, 0.35, 0.25, 0.15, 0.1, 0.05, 0.025, 0.01)
"""Thicknesses of the thin start, as shares of the shortest net edge nearby."""
STAGES = 4
CHUNK = 15
REJECTIONS = 5


@dataclass(frozen=True)
class _State:
    """A set of columns and what is known about them."""

    d: np.ndarray
    certificate: Certificate
    crossings: int
    w: np.ndarray
    mean: float
    rms: float

    @property
    def accepted(self) -> bool:
        return self.certificate.all_valid and self.crossings == 0


class _Grower:
    def __init__(
        self,
        surface: PatchSurface,
        field: HarmonicField,
        degree_w: int,
        report: Callable[[float, str], None],
    ) -> None:
        self.surface = surface
        self.field = field
        self.degree_w = degree_w
        self.report = report
        self.knots_w = bspline.clamped_knots(degree_w, 1)
        self.frame: ColumnFrame = column_frame(surface)
        check_surface(surface, self.frame)
        self.nodal = _nodal_matrix(surface)
        self.bulge = _polynomial_correction(surface, self.frame.nodes, self.nodal)
        # a grid that resolves the curves of the inner surface and holds the interface's nodes
        self.u, self.v = surface.grid_parameters(2)
        self.outer = surface.triangulation_at(self.u, self.v)

    def shell(self, d: np.ndarray) -> Shell:
        layers = uniform_layers(self.surface.control_points, d, self.degree_w, self.knots_w)
        return Shell(self.surface, layers, self.degree_w, self.knots_w)

    def check(self, d: np.ndarray) -> _State:
        shell = self.shell(d)
        certificate = certify(shell.bezier_elements())
        crossings = 0
        if certificate.all_valid:
            crossings = self.crossings(shell)
        inner = self.nodal @ (self.surface.control_points + d)
        w, _, _ = self.field.evaluate(inner)
        area = self.frame.area / self.frame.area.sum()
        mean = float(area @ w)
        rms = float(np.sqrt(area @ (w - mean) ** 2))
        state = _State(d, certificate, crossings, w, mean, rms)
        logger.info(
            "columns: %d invalid, %d undecided, %d crossings, w %.3f (rms %.3f)",
            certificate.invalid,
            certificate.undecided,
            crossings,
            mean,
            rms,
        )
        return state

    def crossings(self, shell: Shell) -> int:
        """Triangle pairs in which the inner surface cuts itself or the outer one."""
        inner = shell.inner_surface().triangulation_at(self.u, self.v)
        own = len(self_intersections(inner.vertices, inner.triangles))
        if own:
            return own
        return len(
            surfaces_intersect(
                inner.vertices, inner.triangles, self.outer.vertices, self.outer.triangles
            )
        )

    def energy(self, level: float, d: np.ndarray) -> ColumnEnergy:
        """Energy towards a level, with the thickness of the columns ``d`` as reference."""
        along = self.frame.mean_normal_length(d - self.bulge)
        floor = 0.1 * np.median(along[along > 0]) if (along > 0).any() else self.frame.spacing.min()
        reference = self.frame.smooth(np.maximum(along, floor), 2)
        return ColumnEnergy(self.surface, self.field, level, reference, self.degree_w, self.nodal)

    def improve(self, energy: ColumnEnergy, d: np.ndarray, fidelity: float) -> _State:
        """Optimise, prove, and watch what could not be proved more closely, twice at most."""
        state = self.check(optimise(energy, d, fidelity))
        for count in (7, 10):
            if state.certificate.all_valid:
                break
            bad = state.certificate.element[state.certificate.status < 1]
            if len(bad) > 0.2 * self.surface.element_count:
                break
            energy.add_samples(np.unique(bad), count)
            state = self.check(optimise(energy, state.d, fidelity, rounds=4, steps=60))
        return state

    def front(self, level: float) -> np.ndarray:
        """Displacements of the control points to the solved front at a level."""
        return self.bulge + solve_front(self.surface, self.frame, self.field, level)

    def from_front(self, level: float) -> _State | None:
        """The whole way at once: solved front, then optimisation with growing fidelity."""
        front = self.front(level)
        self.report(0.3, f"front at w0 = {level:.3g}")
        energy = self.energy(level, front)
        best, d = None, front
        for number, fidelity in enumerate((*FIDELITIES, CLOSE)):
            if fidelity == CLOSE and (best is None or abs(best.mean - level) < 0.1 * level):
                break
            state = self.improve(energy, d, fidelity)
            self.report(0.4 + 0.1 * number, f"elements optimised, w = {state.mean:.3g}")
            if state.accepted:
                best = state
            elif best is not None:
                break
            d = state.d
        return best

    def thin_start(self) -> tuple[_State | None, _State]:
        """The thickest of the thin straight shells that is proved, and the last one tried."""
        spacing = self.frame.smooth(self.frame.spacing, 3, least=True)
        state = None
        for share in THIN_STARTS:
            state = self.check(self.bulge + (share * spacing)[:, None] * self.frame.direction)
            if state.accepted:
                return state, state
        return None, state

    def grow(self, level: float) -> _State:
        """Start thin and grow in stages; a stage that fails is repeated in small checked steps.

        Raises
        ------
        ThicknessError
            When not even a thin shell can be proved.
        """
        best, last = self.thin_start()
        if best is None:
            raise self.failure(last)
        self.report(0.5, f"thin start, w = {best.mean:.3g}")
        for stage in np.linspace(0.0, 1.0, STAGES + 1)[1:]:
            # equal steps in the square root: convex edges recede like sqrt(w0)
            goal = (np.sqrt(max(best.mean, 0.0)) * (1 - stage) + np.sqrt(level) * stage) ** 2
            if goal <= best.mean:
                continue
            energy = self.energy(goal, self.front(goal))
            state = self.improve(energy, best.d, FIDELITIES[-1])
            if not state.accepted:
                state = self.guarded(energy, best)
            gained = state.mean > best.mean + 1e-3 * level
            if state.mean >= best.mean:
                best = state
            self.report(0.5 + 0.4 * stage, f"stage to w = {goal:.3g}: {best.mean:.3g}")
            if not gained:
                break
        return best

    def guarded(self, energy: ColumnEnergy, start: _State) -> _State:
        """Short optimisation runs, each proved before it counts."""
        best, share, chunk, rejected = start, 1.0, CHUNK, 0
        while rejected < REJECTIONS:
            moved = optimise(energy, best.d, FIDELITIES[-1], rounds=1, steps=chunk)
            state = self.check(best.d + share * (moved - best.d))
            if state.accepted:
                if abs(state.mean - best.mean) < 2e-3 * energy.w0:
                    return state
                best = state
            else:
                rejected += 1
                share, chunk = 0.3 * share, max(5, chunk // 2)
        return best

    def failure(self, state: _State) -> errors.ThicknessError:
        """No shell at all: name the faces whose elements stay unproved."""
        certificate = state.certificate
        bad = certificate.status < 1
        if bad.any():
            patches = np.unique(certificate.patch[bad])
            count = int(bad.sum())
            what = f"{count} elements at these faces are not valid even in a thin shell"
        else:
            patches = []
            what = f"the thin shell cuts itself in {state.crossings} places"
        return errors.ThicknessError(
            what,
            faces=[self.surface.patches[k].face for k in patches],
            figure=float(bad.sum() or state.crossings),
            remedy="look for folds, slivers or faces that touch, and rebuild them",
        )


def _nodal_matrix(surface: PatchSurface) -> sparse.csr_matrix:
    """Polynomial B-splines of all control points at the Greville points, (n, n)."""
    n = len(surface.control_points)
    rows, columns, values = [], [], []
    seen = np.zeros(n, dtype=bool)
    for patch in surface.patches:
        matrices = [
            bspline.basis_matrix(p, knots, bspline.greville(p, knots))
            for p, knots in zip(patch.degrees, patch.knots, strict=True)
        ]
        full = sparse.kron(*matrices, format="coo")
        flat = patch.index.ravel()
        keep = ~seen[flat[full.row]]
        rows.append(flat[full.row[keep]])
        columns.append(flat[full.col[keep]])
        values.append(full.data[keep])
        seen[flat] = True
    data = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_matrix(data, shape=(n, n))


def _polynomial_correction(
    surface: PatchSurface, nodes: np.ndarray, nodal: sparse.csr_matrix
) -> np.ndarray:
    """Shift that makes the polynomial surface over all control points pass the rational nodes.

    The inner layers have weights 1 (section 3.2), and without weights the control points of an arc
    make a curve that bulges out of it; a thin shell would be inside out. Zero for polynomials.
    """
    off = nodes - nodal @ surface.control_points
    if not surface.rational:
        return np.zeros_like(nodes)
    return splu(nodal.tocsc()).solve(off)


def grow_shell(
    surface: PatchSurface,
    field: HarmonicField,
    w0: float,
    *,
    layers: int = 2,
    degree_w: int = 3,
    progress: Callable[[float, str], None] | None = None,
) -> tuple[Shell, Certificate]:
    """A certified shell up to the level ``w0``, or the thickest one that could be proved.

    Parameters
    ----------
    surface : PatchSurface
    field : HarmonicField
    w0 : float
        Level of the inner boundary, in (0, 1).
    layers : int
        Bézier layers.
    degree_w : int
        Degree across the shell.
    progress : callable, optional
        Called with a share of the work done and a text.

    Returns
    -------
    Shell, Certificate

    Raises
    ------
    SingularSurfaceError
        When a patch cannot carry any shell.
    ThicknessError
        When no shell at any thickness could be proved.
    """
    report = progress or (lambda share, text: None)
    notes = []
    grower = _Grower(surface, field, degree_w, report)
    level = field.largest_level(surface.genus, w0)
    if level < w0 * (1.0 - 1e-9):
        notes.append(
            f"the isosurface at w0 = {w0:.3g} has another genus than the body;"
            f" the largest level with the right genus is {level:.3g}"
        )
    report(0.1, f"isosurface has the body's genus up to w0 = {level:.3g}")
    best = grower.from_front(level)
    if best is None:
        notes.append("grown from a thin start")
        best = grower.grow(level)
    if best.mean < 0.9 * w0:
        notes.append(
            f"w0 = {w0:.3g} was asked; the thickest shell that could be proved has a mean of"
            f" {best.mean:.3g}"
        )
    shell, certificate = _layered(grower, best, layers)
    shell = replace(
        shell,
        w0_asked=w0,
        w0=best.mean,
        w0_rms=best.rms,
        embedded=True,
        notes=tuple(notes),
    )
    return shell, certificate


def _layered(grower: _Grower, best: _State, layers: int) -> tuple[Shell, Certificate]:
    """Cut the columns into layers of equal volume and prove all elements once more."""
    surface, degree = grower.surface, grower.degree_w
    knots = bspline.clamped_knots(degree, layers)
    certificate = best.certificate
    for make in (equal_volume_layers, uniform_layers):
        points = make(surface.control_points, best.d, degree, knots, surface=surface)
        shell = Shell(surface, points, degree, knots)
        certificate = certify(shell.bezier_elements())
        if certificate.all_valid:
            return shell, certificate
    raise errors.ThicknessError(
        f"{certificate.invalid + certificate.undecided} elements are not proved when the shell is"
        f" cut into {layers} layers",
        faces=[
            surface.patches[k].face for k in np.unique(certificate.patch[certificate.status < 1])
        ],
        figure=float(certificate.invalid + certificate.undecided),
        remedy="take fewer layers",
    )
