# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""From a surface and a field to a certified shell: a sound start, then better and better states.

From the first sound state on there is always one to fall back to: what is proposed takes its place
only where it is proved, free of crossings and nearer to what was asked.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from .. import errors
from . import bspline
from .column_state import OFTEN, ColumnSpace, ColumnState
from .companion import carried, companion, needs_companion
from .contacts import Planes
from .goals import Thickness, goal_levels, usable_level
from .harmonic import HarmonicField
from .levels import Spacing, spaced_layers, trials, uniform_layers
from .shell import Shell
from .surface import PatchSurface
from .untangle import optimise
from .validity import Certificate, certify

logger = logging.getLogger(__name__)

FIDELITIES = (3.0, 10.0, 30.0, 100.0)
"""Weights of the isosurface term, one after the other until the level is reached."""
CLOSE = 0.05
"""Root mean square distance from the level, as a share of it, that is near enough."""
THIN_STARTS = (0.5, 0.35, 0.25, 0.15, 0.1, 0.05, 0.025, 0.01)
"""Thicknesses of the thin start, as shares of the shortest net edge nearby."""
REPAIRS = 4
"""Most local repairs in a row."""
MANY = 0.1
"""Share of folded elements from which on all columns are untangled together."""
PATCHED = 0.75
"""Share of the others' faults from which on a start counts that has thin columns put in around its
own: they may stay flat."""
UNTANGLINGS = 9
"""Most local repairs of a start for which there is no sound one to fall back to."""
PATIENCE = 3
"""Such repairs in a row without fewer bad elements after which to give up."""
CARRIED = 0.5
"""Share of the level on a surface's companion that must be left on the surface itself."""
POLISHES = 10
"""Most rounds in which the worst shapes are improved."""
GENTLE = 30.0
"""Weight of the isosurface term in the first of these rounds, at most."""
YIELD = 0.2
"""Factor of this weight after a round that brought nothing: a thinner shell may be less flat."""
WORTHWHILE = 0.97
"""Share of its fault that a state may keep if a round is to count as a gain."""
LOOSEST = 1.0
"""Smallest weight of the isosurface term in these rounds."""
AHEAD = (0.25, 0.5, 1.0)
"""Shares of a layer by which the feet of columns stand ahead where thin rational layers fail."""
CLOSER_LOOKS = 3
"""Times that crossings, which only a finer grid shows, are parted."""
KEPT = 0.95
"""Share of the mean level that is kept where such crossings are parted; with less another way is
tried."""


class _Grower(ColumnSpace):
    def __init__(
        self,
        surface: PatchSurface,
        field: HarmonicField,
        degree_w: int,
        report: Callable[[float, str], None],
    ) -> None:
        super().__init__(surface, field, degree_w)
        self.report = report
        self.fidelities: Sequence[float] = FIDELITIES

    # ------------------------------------------------------------------------------------ stages

    def advance(
        self,
        state: ColumnState,
        goal: np.ndarray,
        fidelity: float,
        planes: Planes | None,
    ) -> tuple[ColumnState, Planes | None]:
        """Optimise all columns of a sound state, then repair what is wrong in few places."""
        energy = self.energy(state.d, goal, fidelity, planes=planes)
        wanted = self.check(optimise(energy, self.reach, rounds=2))
        return self.repaired(state, wanted, goal, fidelity, planes)

    def repaired(
        self,
        sound: ColumnState,
        wanted: ColumnState,
        goal: np.ndarray,
        fidelity: float,
        planes: Planes | None,
        emphasis: np.ndarray | None = None,
        repairs: int = REPAIRS,
    ) -> tuple[ColumnState, Planes | None]:
        """Mend a wanted state in few places, and take the sound one there where that fails.

        What crosses is parted by planes, what folds goes back on its way from the sound state and
        gets more samples; only what is near is optimised again.
        """
        fewest, least = wanted, len(wanted.bad)
        for number in range(repairs):
            bad = wanted.bad
            if not len(bad) or len(bad) > 0.3 * self.surface.element_count:
                break
            self.failures[wanted.unproved] += 1
            if len(wanted.crossing):
                fresh = self.planes(sound.d, wanted.d)
                planes = fresh if planes is None else planes.joined(fresh)
            energy = self.energy(
                self.held_back(sound.d, wanted.d),
                goal,
                fidelity,
                like=wanted.d,
                free=self.around(bad, 2 + number) > 0,
                planes=planes,
                emphasis=emphasis,
            )
            wanted = self.check(optimise(energy, self.reach, rounds=2, steps=30))
            if len(wanted.bad) < least:
                fewest, least = wanted, len(wanted.bad)
        if fewest.accepted:
            return fewest, planes
        # far from the sound state the mixture may hold only where next to nothing is taken; on the
        # way back from the wanted one all columns but those concerned come along
        mixed = [self.merged(sound, fewest), self.blended(sound, fewest)]
        mixed = [state for state in mixed if state.accepted] or mixed[:1]
        return min(mixed, key=lambda state: self.fault(state, goal)), planes

    def stages(self, best: ColumnState, goal: np.ndarray) -> ColumnState:
        """Draw a sound state to its levels, ever more strongly."""
        planes, misses = None, 0
        least = self.fault(best, goal)
        for number, fidelity in enumerate(self.fidelities):
            state, planes = self.advance(best, goal, fidelity, planes)
            self.report(0.5 + 0.08 * number, f"elements optimised, w = {state.mean:.3g}")
            # where an optimised state is worse, a stronger pull may hold the shell nearer
            fault = self.fault(state, goal) if state.accepted else np.inf
            misses = 0 if fault < least else misses + 1
            if fault < least:
                best, least = state, fault
            near = abs(best.mean / float(self.area @ goal) - 1.0) < 0.5 * CLOSE
            if misses > 1 or (near and self.off(best, goal) < CLOSE):
                break
        return self.polished(best, goal, fidelity, planes)

    def polished(
        self, best: ColumnState, goal: np.ndarray, fidelity: float, planes: Planes | None
    ) -> ColumnState:
        """Give the flattest elements more weight, round after round, and optimise around them."""
        emphasis = np.ones(self.surface.element_count)
        pull = min(fidelity, GENTLE)
        state, least = best, self.fault(best, goal)
        for number in range(POLISHES):
            shapes = self.shapes(state)
            flat = np.flatnonzero(shapes < self.shapely)
            if not len(flat):
                break
            emphasis[flat] *= np.clip(self.shapely / np.maximum(shapes[flat], 1e-3), 1.0, 5.0)
            energy = self.energy(
                state.d,
                goal,
                pull,
                free=self.around(flat, 3) > 0,
                planes=planes,
                emphasis=emphasis,
            )
            wanted = self.check(optimise(energy, self.reach, rounds=1))
            wanted, planes = self.repaired(state, wanted, goal, pull, planes, emphasis, 2)
            if not wanted.accepted:
                break
            state = wanted
            self.report(0.8 + 0.03 * number, f"{len(flat)} flat elements, w = {state.mean:.3g}")
            fault = self.fault(state, goal)
            if fault > least * WORTHWHILE:
                pull *= YIELD
            if fault < least:
                best, least = state, fault
            if pull < LOOSEST:
                break
        return best

    def confirmed(self, best: ColumnState, goal: np.ndarray) -> ColumnState:
        """An accepted state that holds on a finer grid too, wherever it is not proved embedded.

        Raises
        ------
        ThicknessError
            No state holds there.
        """
        for _ in range(CLOSER_LOOKS):
            if not self.look_closer(best):
                return best
            crossed = self.check(best.d)
            logger.info("a finer look finds %d elements that cross", len(crossed.crossing))
            thin, last = self.thin_start()
            if thin is None:
                raise self.failure(last)
            state, planes = self.repaired(thin, crossed, goal, GENTLE, None)
            starts = [state] if state.accepted else []
            if not starts or state.mean < KEPT * crossed.mean:
                # a thin shell put in around a few crossings may spread; on the way back from it
                # only the columns concerned become shorter
                starts.append(self.blended(thin, crossed))
            best = min(
                (self.polished(start, goal, GENTLE, planes) for start in starts),
                key=lambda state: self.fault(state, goal),
            )
        if self.look_closer(best):
            raise self.failure(self.check(best.d))
        return best

    # ------------------------------------------------------------------------------------ starts

    def from_front(self, goal: np.ndarray) -> ColumnState | None:
        """From the solved front on; None where neither it nor anything near it is sound."""
        start = self.check(self.front(goal))
        self.report(0.3, f"front at w0 = {float(self.area @ goal):.3g}")
        if not start.accepted:
            thin, _ = self.thin_start()
            starts = [self.blended(thin, start)] if thin else []
            before = self.failures.copy()
            # where much of the front is folded, little is left of it on the way back
            if not starts or len(start.bad) > MANY * self.surface.element_count:
                lower = self.from_companion(goal, thin)
                starts += [lower] if lower else self.untangled(start, goal, thin)
            sound = [state for state in starts if state.accepted]
            if not sound:
                return None
            faults = [self.fault(state, goal) for state in sound]
            if len(starts) > 2 and starts[-1].accepted:
                faults[-1] /= PATCHED
            start = sound[int(np.argmin(faults))]
            if start is not starts[-1]:
                # what failed on the way to the last one says nothing about the others
                self.failures = before
            self.report(0.4, f"start, w = {start.mean:.3g}")
        return self.stages(start, goal)

    def from_companion(self, goal: np.ndarray, thin: ColumnState | None) -> ColumnState | None:
        """Columns found on splines of low degree; None where there is no need, or no success.

        Success is a sound state that has not lost more than a little of the level found there.
        """
        if not needs_companion(self.surface):
            return None
        low = companion(self.surface)
        grower = _Grower(
            low,
            self.field,
            self.degree_w,
            lambda share, text: self.report(0.3, f"columns of low degree: {text}"),
        )
        # where sides touch those of low degree may cross: then nothing is to be had from them
        if grower.thin_start()[0] is None:
            return None
        near = cKDTree(self.frame.nodes).query(grower.frame.nodes)[1]
        found = grower.from_front(goal[near])
        if found is None:
            return None
        state = self.check(self.rest + carried(found.d, low, self.surface))
        if not state.accepted and thin is not None:
            state = self.blended(thin, state)
        logger.info("columns of low degree: w %.3f, carried over %.3f", found.mean, state.mean)
        return state if state.accepted and state.mean > CARRIED * found.mean else None

    def untangled(
        self, state: ColumnState, goal: np.ndarray, thin: ColumnState | None
    ) -> list[ColumnState]:
        """Optimise folded columns together and mend what is still wrong, in two ways.

        Locally, ever wider, and thinner (which around a few faults in coarse nets may become thin
        everywhere); with sound columns, ``thin``, as in any stage.
        """
        fidelity = 0.1 * FIDELITIES[0]
        if len(state.bad) > MANY * self.surface.element_count:
            energy = self.energy(state.d, goal, fidelity)
            state = self.check(optimise(energy, self.reach))
        found = [self.locally_untangled(state, goal, fidelity)]
        if thin is not None and not state.accepted:
            mended, _ = self.repaired(thin, state, goal, fidelity, None)
            found.append(mended if mended.accepted else self.blended(thin, state))
        return found

    def locally_untangled(
        self, state: ColumnState, goal: np.ndarray, fidelity: float
    ) -> ColumnState:
        """Repair columns where no sound ones are known: locally, ever wider, and thinner."""
        fewest, since = len(state.bad), 0
        for number in range(UNTANGLINGS):
            bad = state.bad
            since = 0 if len(bad) < fewest else since + 1
            fewest = min(fewest, len(bad))
            hopeless = len(bad) > 0.3 * self.surface.element_count or since > PATIENCE
            if not len(bad) or hopeless:
                break
            self.report(0.3, f"{len(bad)} folded or crossing elements, w = {state.mean:.3g}")
            # what folds between its samples needs more of them
            self.failures[state.unproved] += 1
            near = self.around(bad, 2 + number)
            d = state.d
            # overlap is no matter of shape: only a thinner shell cures it
            if number or len(state.crossing):
                along = np.maximum(self.heights(d), 0.1 * self.frame.spacing)
                straight = self.rest + 0.5 * along[:, None] * self.frame.direction
                d = d + near[:, None] * (straight - d)
            energy = self.energy(d, goal * (1.0 - 0.4 * near), fidelity, free=near > 0)
            state = self.check(optimise(energy, self.reach, rounds=6, steps=40))
        return state

    def thin_start(self) -> tuple[ColumnState | None, ColumnState]:
        """The thickest of the thin straight shells that is proved, and the last one tried."""
        spacing = self.frame.smooth(self.frame.spacing, 3, least=True)
        tried = []
        for share in THIN_STARTS:
            state = self.check(self.rest + (share * spacing)[:, None] * self.frame.direction)
            if state.accepted:
                return state, state
            tried.append(state)
        return self.thin_mended(min(tried, key=lambda state: len(state.bad))), state

    def thin_mended(self, state: ColumnState) -> ColumnState | None:
        """A thin shell that is wrong in few places, mended there; None where that fails.

        Where the surface is singular the directions of the columns around decide, however short
        they are.
        """
        for number in range(REPAIRS):
            bad = state.bad
            if not len(bad) or len(bad) > MANY * self.surface.element_count:
                break
            self.failures[state.unproved] = OFTEN
            free = self.around(bad, 2 + number) > 0
            energy = self.energy(state.d, np.zeros(len(state.d)), 0.0, free=free)
            state = self.check(optimise(energy, self.reach, rounds=6, steps=40))
        return state if state.accepted else None

    def grow(self, goal: np.ndarray) -> ColumnState:
        """Grow from a thin start.

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
        while best.mean < 0.5 * level and ratio > 1.1:
            share = min(1.0, max(best.mean, 0.005) * ratio / level)
            state, _ = self.advance(best, share * goal, FIDELITIES[0], None)
            if state.accepted and state.mean > best.mean * 1.02:
                best = state
            else:
                ratio = np.sqrt(ratio)
        return self.stages(best, goal)

    def failure(self, state: ColumnState) -> errors.ThicknessError:
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


def grow_shell(
    surface: PatchSurface,
    field: HarmonicField,
    thickness: float | Thickness,
    *,
    layers: int = 2,
    degree_w: int = 3,
    spacing: Spacing | None = None,
    fidelity: float | None = None,
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
    fidelity : float, optional
        Go no further than to this weight of the distance from the level, for the best shapes; by
        default the weight rises until the level is reached.
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
    if fidelity is not None:
        grower.level_counts = False
        grower.fidelities = (*(f for f in FIDELITIES if f < fidelity), fidelity)
    best = grower.from_front(goal)
    if best is None:
        notes.append("grown from a thin start")
        best = grower.grow(goal)
    best = grower.confirmed(best, goal)
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
    grower: _Grower, best: ColumnState, layers: int, spacing: Spacing
) -> tuple[Shell, Certificate, list[str]]:
    """Cut the columns into layers and prove all elements once more; notes where that failed."""
    surface, degree = grower.surface, grower.degree_w
    knots = bspline.clamped_knots(degree, layers)
    heights = grower.heights(best.d)
    feet = [grower.base]
    if surface.rational:
        # near singular corners columns that start at the rational control points themselves hold
        feet.append(surface.control_points)
        # thin layers: polynomial ones do not follow the rational surface closely enough, and the
        # outermost one has to make room
        feet += [grower.base + share / layers * best.d for share in AHEAD]
    for evened, note in trials(spacing):
        for foot in feet:
            columns = (foot, grower.base + best.d - foot, degree, knots)
            points = spaced_layers(
                *columns,
                surface,
                spacing,
                heights,
                grower.nodal,
                evened,
                lambda row: grower.frame.smooth(row, 2),
            )
            points[0] = surface.control_points
            shell = Shell(surface, points, degree, knots)
            certificate = certify(shell.bezier_elements())
            if certificate.all_valid:
                return shell, certificate, [note] if note else []
    fewer = layers // 2
    while fewer and not _proved(grower, best, fewer):
        fewer //= 2
    advice = "insert knots at these faces"
    raise errors.ThicknessError(
        f"{certificate.invalid + certificate.undecided} elements are not proved when the shell is"
        f" cut into {layers} layers",
        faces=[
            surface.patches[k].face for k in np.unique(certificate.patch[certificate.status < 1])
        ],
        figure=float(certificate.invalid + certificate.undecided),
        remedy=f"take {fewer} layers of equal height, or {advice}" if fewer else advice,
    )


def _proved(grower: _Grower, best: ColumnState, layers: int) -> bool:
    """Whether the columns can be cut into some layers of equal height."""
    knots = bspline.clamped_knots(grower.degree_w, layers)
    points = uniform_layers(grower.base, best.d, grower.degree_w, knots)
    points[0] = grower.surface.control_points
    shell = Shell(grower.surface, points, grower.degree_w, knots)
    return certify(shell.bezier_elements()).all_valid
