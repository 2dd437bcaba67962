# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""From a surface and a field to a certified shell: start, optimise, prove, or start thin and grow.

A state of the columns counts only when two conditions hold together: every Bézier element is proved
valid (local), and the inner surface does not cut itself (global). Then the shell is one-to-one: the
number of its points at a place is the winding number of the outer boundary less that of the inner
one, which is never negative where det J > 0, so the inner surface lies inside the outer one and
every place between them is taken once.
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
from .front import ColumnFrame, column_frame, solve_front
from .goals import Thickness, goal_levels, usable_level
from .harmonic import HarmonicField
from .intersection import self_intersections
from .levels import Spacing, spaced_layers, uniform_layers
from .shell import Shell
from .surface import PatchSurface
from .untangle import ColumnEnergy, elements_with, optimise, points_of
from .validity import Certificate, certify, scaled_jacobian

logger = logging.getLogger(__name__)

FIDELITIES = (3.0, 10.0, 30.0, 100.0)
"""Weights of the isosurface term, one after the other until the level is reached."""
CLOSE = 0.05
"""Root mean square distance from the level, as a share of it, that is near enough."""
SHAPELY = 0.1
"""Scaled Jacobian from which on an element's shape does not count against the level."""
FLAT = 0.2
"""Share of the level that is worth giving up for elements that are not flat."""
RELAX = 1.7
"""Factor by which a level that a repair lowered may rise again in the next step."""
THIN_STARTS = (0.5, 0.35, 0.25, 0.15, 0.1, 0.05, 0.025, 0.01)
"""Thicknesses of the thin start, as shares of the shortest net edge nearby."""
REPAIRS = 9
"""Most local repairs in a row."""
MERGES = (2, 4, 7, 12)
"""Rings of elements around what is wrong that stay as they were, one after the other."""
PATIENCE = 3
"""Repairs in a row without fewer bad elements after which to give up."""
GRIDS = (1, 2)
"""Cells a knot span in the triangulations that are tested for crossings.

One cell a span is what the core's boundary has, two follow the curves."""


@dataclass(frozen=True)
class _State:
    """A set of columns and what is known about them.

    ``target`` is the level that each Greville point of the inner surface was drawn to: less than
    the level asked where a repair had to make the shell thinner.
    """

    d: np.ndarray
    target: np.ndarray
    certificate: Certificate
    crossing: np.ndarray  # elements whose inner sides cut something
    w: np.ndarray  # level at each Greville point of the inner surface
    mean: float
    rms: float

    @property
    def accepted(self) -> bool:
        return self.certificate.all_valid and not len(self.crossing)

    @property
    def bad(self) -> np.ndarray:
        """Surface elements that are not proved or that cross others."""
        unproved = self.certificate.element[self.certificate.status < 1]
        return np.union1d(unproved, self.crossing)


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
        self.area = self.frame.area / self.frame.area.sum()
        self.nodal = _nodal_matrix(surface)
        # feet of the columns: all layers but the outermost stand on them
        self.base = surface.control_points + _polynomial_correction(
            surface, self.frame.nodes, self.nodal
        )
        self.reach = 0.3 * self.frame.spacing
        self.grids = [_TestGrid(surface, cells) for cells in GRIDS]
        # where even the outer surface is cut by its own coarse triangles, they tell nothing
        self.grids = [grid for grid in self.grids if grid.outer_embedded] or self.grids[-1:]

    def shell(self, d: np.ndarray) -> Shell:
        layers = uniform_layers(self.base, d, self.degree_w, self.knots_w)
        layers[0] = self.surface.control_points
        return Shell(self.surface, layers, self.degree_w, self.knots_w)

    def check(self, d: np.ndarray, target: np.ndarray) -> _State:
        shell = self.shell(d)
        certificate = certify(shell.bezier_elements())
        crossing = np.zeros(0, dtype=int)
        # far from valid there is nothing to be learnt from crossings
        if certificate.invalid + certificate.undecided <= 0.02 * self.surface.element_count:
            crossing = self.crossing_elements(shell)
        inner = self.nodal @ (self.base + d)
        w, _, _ = self.field.evaluate(inner)
        mean = float(self.area @ w)
        rms = float(np.sqrt(self.area @ (w - mean) ** 2))
        logger.info(
            "columns: %d invalid, %d undecided, %d crossing, w %.3f (rms %.3f)",
            certificate.invalid,
            certificate.undecided,
            len(crossing),
            mean,
            rms,
        )
        return _State(d, target, certificate, crossing, w, mean, rms)

    def crossing_elements(self, shell: Shell) -> np.ndarray:
        """Elements over which the inner surface cuts itself."""
        inner = shell.inner_surface()
        return np.unique(np.concatenate([grid.crossing(inner) for grid in self.grids]))

    def front(self, goal: np.ndarray) -> np.ndarray:
        """Displacements of the control points to the solved front at given levels."""
        return solve_front(self.surface, self.frame, self.field, goal)

    def off(self, state: _State, goal: np.ndarray) -> float:
        """Root mean square distance from the levels, as a share of their mean."""
        return float(np.sqrt(self.area @ (state.w - goal) ** 2) / (self.area @ goal))

    def reference(self, d: np.ndarray) -> np.ndarray:
        """Thickness at the control points that the elements should have, from columns ``d``."""
        along = self.frame.mean_normal_length(d)
        usable = along > 0
        floor = 0.1 * np.median(along[usable]) if usable.any() else 0.1
        floor = np.minimum(floor, 0.5 * self.frame.spacing)
        return self.frame.smooth(np.maximum(along, floor), 2)

    def energy(
        self,
        d: np.ndarray,
        target: np.ndarray,
        reference: np.ndarray,
        fidelity: float,
        free: np.ndarray | None = None,
    ) -> ColumnEnergy:
        """Energy of the columns ``d``, all or some of them free."""
        return ColumnEnergy(
            self.surface,
            self.base,
            self.field,
            target,
            reference,
            self.degree_w,
            self.nodal,
            d,
            free=free,
            fidelity=fidelity,
        )

    def settle(
        self, d: np.ndarray, target: np.ndarray, fidelity: float, repairs: int = REPAIRS
    ) -> _State:
        """Repair what is not proved or crosses: locally, ever wider, and thinner where need be."""
        state = self.check(d, target)
        fewest, since = len(state.bad), 0
        for number in range(repairs):
            bad = state.bad
            since = 0 if len(bad) < fewest else since + 1
            fewest = min(fewest, len(bad))
            hopeless = len(bad) > 0.3 * self.surface.element_count or since > PATIENCE
            if not len(bad) or hopeless:
                break
            d, target = state.d, state.target
            near = self.nearness(bad, 2 + number)
            # overlap is no matter of shape: only a thinner shell cures it
            if number or len(state.crossing):
                d, target = self.thinner(d, target, near)
            energy = self.energy(d, target, self.reference(d), fidelity, near > 0)
            energy.add_samples(np.intersect1d(bad, energy.elements), 7 if number < 3 else 9)
            state = self.check(optimise(energy, self.reach, rounds=6, steps=40), target)
        return state

    def nearness(self, elements: np.ndarray, rings: int) -> np.ndarray:
        """1 at the control points of some elements, falling to 0 over rings of elements."""
        points = points_of(self.surface, elements)
        near = np.zeros(len(self.reach))
        for ring in range(rings):
            share = 1.0 - ring / rings
            near[points] = np.maximum(near[points], share)
            points = points_of(self.surface, elements_with(self.surface, points))
        return near

    def thinner(
        self, d: np.ndarray, target: np.ndarray, near: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Draw columns back to half their thickness along the most inward direction."""
        along = np.maximum(self.frame.mean_normal_length(d), 0.1 * self.frame.spacing)
        straight = 0.5 * along[:, None] * self.frame.direction
        share = near[:, None]
        return (1.0 - share) * d + share * straight, target * (1.0 - 0.4 * near)

    def merged(self, sound: _State, wanted: _State) -> _State:
        """The wanted columns, apart from those around its bad elements, which stay as they were.

        Where a state is wrong in few places only, all the others need not wait for them.
        """
        bad = wanted.bad
        state = wanted
        for rings in MERGES:
            if not len(bad) or len(bad) > 0.2 * self.surface.element_count:
                break
            share = np.minimum(2.0 * self.nearness(bad, rings), 1.0)
            d = wanted.d + share[:, None] * (sound.d - wanted.d)
            target = wanted.target + share * (
                np.minimum(sound.target, wanted.target) - wanted.target
            )
            state = self.check(d, target)
            bad = np.union1d(bad, state.bad)
            if state.accepted:
                break
        return state

    def advance(
        self, state: _State, goal: np.ndarray, fidelity: float, repairs: int = REPAIRS
    ) -> _State:
        """Optimise all columns towards given levels, then repair."""
        target = np.minimum(goal, RELAX * state.target)
        reference = self.reference(state.d)
        energy = self.energy(state.d, target, reference, fidelity)
        return self.settle(optimise(energy, self.reach), target, fidelity, repairs)

    def from_front(self, goal: np.ndarray) -> _State | None:
        """The whole way at once: solved front, repair where it is not valid, then optimisation."""
        front = self.front(goal)
        self.report(0.3, f"front at w0 = {float(self.area @ goal):.3g}")
        first = self.check(front, goal)
        if len(first.bad) > 0.1 * self.surface.element_count:
            first = self.advance(first, goal, 0.1 * FIDELITIES[0])
        else:
            first = self.settle(front, goal, 0.1 * FIDELITIES[0])
        self.report(0.4, f"repaired, w = {first.mean:.3g}")
        best = first if first.accepted else None
        least = np.inf if best is None else self.fault(best, goal)
        misses = 0
        for number, fidelity in enumerate(FIDELITIES):
            # what only improves an accepted state is not worth many repairs
            repairs = REPAIRS if best is None else 1
            state = self.advance(best or first, goal, fidelity, repairs)
            if best is not None and not state.accepted:
                state = self.merged(best, state)
            self.report(0.5 + 0.1 * number, f"elements optimised, w = {state.mean:.3g}")
            # where an optimised state is worse, a stronger pull may hold the shell nearer
            fault = self.fault(state, goal) if state.accepted else np.inf
            misses = 0 if fault < least else misses + 1
            if fault < least:
                best, least = state, fault
            if best is not None and (
                misses > 1 or least < CLOSE or self.off(best, goal) < 0.5 * CLOSE
            ):
                break
        return best

    def fault(self, state: _State, goal: np.ndarray) -> float:
        """How far an accepted state is from the levels, flat elements counted as well."""
        flattest = float(scaled_jacobian(self.shell(state.d).bezier_elements()).min())
        return self.off(state, goal) + FLAT * max(0.0, 1.0 - flattest / SHAPELY)

    def thin_start(self) -> tuple[_State | None, _State]:
        """The thickest of the thin straight shells that is proved, and the last one tried."""
        spacing = self.frame.smooth(self.frame.spacing, 3, least=True)
        for share in THIN_STARTS:
            d = (share * spacing)[:, None] * self.frame.direction
            state = self.check(d, np.ones(len(d)))
            if state.accepted:
                return state, state
        return None, state

    def grow(self, goal: np.ndarray) -> _State:
        """Start thin and grow in stages; a stage that fails is tried again with half the step.

        Raises
        ------
        ThicknessError
            When not even a thin shell can be proved.
        """
        best, last = self.thin_start()
        if best is None:
            raise self.failure(last)
        self.report(0.5, f"thin start, w = {best.mean:.3g}")
        level, ratio = float(self.area @ goal), 2.0
        while best.mean < 0.97 * level and ratio > 1.1:
            share = min(1.0, max(best.mean, 0.005) * ratio / level)
            state = self.advance(best, share * goal, FIDELITIES[0], 3)
            if not state.accepted:
                state = self.merged(best, state)
            if state.accepted and state.mean > best.mean * 1.02:
                best = state
                done = np.log(best.mean / 0.005) / np.log(level / 0.005)
                self.report(0.5 + 0.4 * float(np.clip(done, 0, 1)), f"w = {best.mean:.3g}")
            else:
                ratio = np.sqrt(ratio)
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
            patches = np.unique(self.surface.element_patch[state.crossing])
            what = f"the shell cuts itself at {len(state.crossing)} elements even where it is thin"
        return errors.ThicknessError(
            what,
            faces=[self.surface.patches[k].face for k in patches],
            figure=float(bad.sum() or len(state.crossing)),
            remedy="look for folds, slivers or faces that touch, and rebuild them",
        )


class _TestGrid:
    """Triangles over the knot spans, by which crossings are found."""

    def __init__(self, surface: PatchSurface, cells: int) -> None:
        self.lines = surface.grid_parameters(cells)
        outer = surface.triangulation_at(*self.lines)
        found, start = [], 0
        for patch in surface.patches:
            spans = [len(bspline.breakpoints(knots)) - 1 for knots in patch.knots]
            i, j = np.indices((cells * spans[0], cells * spans[1]))
            found.append(start + (i // cells * spans[1] + j // cells).ravel())
            start += spans[0] * spans[1]
        self.element = np.repeat(np.concatenate(found), 2)
        self.outer_embedded = not len(self_intersections(outer.vertices, outer.triangles))

    def crossing(self, inner: PatchSurface) -> np.ndarray:
        """Elements whose inner triangles cut each other."""
        mesh = inner.triangulation_at(*self.lines)
        return self.element[self_intersections(mesh.vertices, mesh.triangles).ravel()]


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
    thickness: float | Thickness,
    *,
    layers: int = 2,
    degree_w: int = 3,
    spacing: Spacing | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> tuple[Shell, Certificate]:
    """A certified shell of the thickness asked, or the thickest one that could be proved.

    Parameters
    ----------
    surface : PatchSurface
        One that :func:`HybridVolume.core.check.check_surface` lets pass.
    field : HarmonicField
    thickness : float or Thickness
        A number is the level w0 of the inner boundary, in (0, 1).
    layers : int
        Bézier layers.
    degree_w : int
        Degree across the shell.
    spacing : Spacing, optional
        Heights of the layers; equal volumes otherwise.
    progress : callable, optional
        Called with a share of the work done and a text.

    Returns
    -------
    Shell, Certificate

    Raises
    ------
    ThicknessError
        When no shell at any thickness could be proved.
    """
    report = progress or (lambda share, text: None)
    grower = _Grower(surface, field, degree_w, report)
    if not isinstance(thickness, Thickness):
        thickness = Thickness("w0", float(thickness))
    goal, notes = goal_levels(thickness, surface, grower.frame, field)
    wanted = goal
    top = float(goal.max())
    # the mean of one and the same number has rounding in it
    asked = top if goal.min() == top else float(grower.area @ goal)
    largest, used, note = usable_level(field, surface.genus, top)
    notes += [note] if note else []
    goal = np.minimum(goal, used)
    report(0.1, f"isosurface has the body's genus up to w0 = {largest:.3g}")
    best = grower.from_front(goal)
    if best is None:
        notes.append("grown from a thin start")
        best = grower.grow(goal)
    if best.mean < 0.9 * asked:
        notes.append(
            f"w0 = {asked:.3g} was asked; the thickest shell that could be proved has a mean of"
            f" {best.mean:.3g}"
        )
    shell, certificate, spaced = _layered(grower, best, layers, spacing or Spacing())
    notes += spaced
    shell = replace(
        shell,
        w0_asked=asked,
        w0=best.mean,
        w0_rms=best.rms,
        embedded=True,
        notes=tuple(notes),
        level=best.w,
        goal=wanted,
    )
    return shell, certificate


def _layered(
    grower: _Grower, best: _State, layers: int, spacing: Spacing
) -> tuple[Shell, Certificate, list[str]]:
    """Cut the columns into layers and prove all elements once more; notes where that failed."""
    surface, degree = grower.surface, grower.degree_w
    knots = bspline.clamped_knots(degree, layers)
    heights = grower.frame.mean_normal_length(best.d)
    feet = [grower.base]
    if surface.rational:
        # near singular corners columns that start at the rational control points themselves hold
        feet.append(surface.control_points)
    notes: list[str] = []
    for wanted in dict.fromkeys((spacing, Spacing("distance"))):
        for foot in feet:
            columns = (foot, grower.base + best.d - foot, degree, knots)
            points = spaced_layers(*columns, surface, wanted, heights, grower.nodal)
            points[0] = surface.control_points
            shell = Shell(surface, points, degree, knots)
            certificate = certify(shell.bezier_elements())
            if certificate.all_valid:
                return shell, certificate, notes
        notes.append("layers of equal height: in the spacing asked not all elements are proved")
    raise errors.ThicknessError(
        f"{certificate.invalid + certificate.undecided} elements are not proved when the shell is"
        f" cut into {layers} layers",
        faces=[
            surface.patches[k].face for k in np.unique(certificate.patch[certificate.status < 1])
        ],
        figure=float(certificate.invalid + certificate.undecided),
        remedy="take fewer layers",
    )
