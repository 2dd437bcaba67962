# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""States of the columns of a shell, and what is known about them.

A state counts only when two conditions hold together: every Bézier element is proved valid (local),
and the inner surface does not cut itself (global). Then the shell is one-to-one: the number of its
points at a place is the winding number of the outer boundary less that of the inner one, which is
never negative where det J > 0, so the inner surface lies inside the outer one and every place
between them is taken once.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from . import bspline
from .bound import scaled_jacobian_bound
from .contacts import Planes, TestGrid, planes_between
from .embedding_proof import prove_embedded
from .front import ColumnFrame, column_frame, solve_front
from .harmonic import HarmonicField
from .levels import uniform_layers
from .shell import Shell
from .surface import PatchSurface
from .untangle import ColumnEnergy, elements_with, points_of
from .validity import Certificate, certify, scaled_jacobian

logger = logging.getLogger(__name__)

SHAPELY = 0.8
"""Share of the body's bound of the scaled Jacobian from which on a shape does not count."""
LEAST_BOUND = 0.02
"""Elements whose own surface allows less than this have no shape to be kept."""
FLAT = 0.2
"""Share of the level that is worth giving up for elements that are not flat."""
OFTEN = 3
"""Times that an element was not proved after which it is watched at many more samples."""
GRIDS = (1, 2)
"""Cells a knot span in the triangulations that are tested for crossings.

One cell a span is what the core's boundary has, two follow the curves."""
MERGES = (2, 4, 7, 12)
"""Rings of elements around what is wrong that stay as they were, one after the other."""
BACK = 2.5
"""How much farther than its neighbour on a net edge a column may be on its way from one state to
another."""
REACH = 3.0
"""Longest way of a control point in a step, as a share of its shortest net edge."""
CLOSER = 8
"""Cells a knot span where the inner surface is not proved to be free of crossings."""


@dataclass(frozen=True)
class ColumnState:
    """A set of columns and what is known about them.

    Attributes
    ----------
    d : (n, 3) array
        Displacements of the control points, mm.
    certificate : Certificate
        Of the elements of one layer.
    crossing : (k,) int array
        Elements whose inner sides cut something.
    w : (n,) array
        Level at each Greville point of the inner surface.
    mean, rms : float
        Mean of ``w`` over the surface's area and its deviation.
    """

    d: np.ndarray
    certificate: Certificate
    crossing: np.ndarray
    w: np.ndarray
    mean: float
    rms: float

    @property
    def accepted(self) -> bool:
        """Every element is proved and nothing crosses."""
        return self.certificate.all_valid and not len(self.crossing)

    @cached_property
    def unproved(self) -> np.ndarray:
        """Surface elements that are not proved."""
        return self.certificate.element[self.certificate.status < 1]

    @cached_property
    def bad(self) -> np.ndarray:
        """Surface elements that are not proved or that cross others."""
        return np.union1d(self.unproved, self.crossing)


class ColumnSpace:
    """Everything that states of columns on one surface in one field have in common.

    Parameters
    ----------
    surface : PatchSurface
    field : HarmonicField
    degree_w : int
        Degree across the shell.
    """

    def __init__(self, surface: PatchSurface, field: HarmonicField, degree_w: int) -> None:
        self.surface = surface
        self.field = field
        self.degree_w = degree_w
        self.knots_w = bspline.clamped_knots(degree_w, 1)
        self.frame: ColumnFrame = column_frame(surface)
        self.area = self.frame.area / self.frame.area.sum()
        self.nodal = nodal_matrix(surface)
        # feet of the columns: all layers but the outermost stand on them
        correction = polynomial_correction(surface, self.frame.nodes, self.nodal)
        # where the surface is singular columns start at its own control points and come to where
        # the feet would be on their way
        singular = np.flatnonzero(surface.singular_flags.any(axis=(1, 2)))
        self.rest = np.zeros_like(correction)
        if len(singular):
            at = points_of(surface, singular)
            self.rest[at] = correction[at]
        self.base = surface.control_points + correction - self.rest
        self.failures = np.zeros(surface.element_count, dtype=int)
        self._proved: tuple[np.ndarray, Certificate] | None = None
        self._shapes: tuple[ColumnState, np.ndarray] | None = None
        self.level_counts = True  # or only shapes do, where less fidelity is asked for
        self.reach = REACH * self.frame.spacing
        self.grids = [TestGrid(surface, cells) for cells in GRIDS]
        # where even the outer surface is cut by its own coarse triangles, they tell nothing
        self.grids = [grid for grid in self.grids if grid.outer_embedded] or self.grids[-1:]
        bound = scaled_jacobian_bound(surface)
        usable = bound[bound > LEAST_BOUND]
        self.shapely = SHAPELY * float(usable.min()) if len(usable) else LEAST_BOUND

    def shell(self, d: np.ndarray) -> Shell:
        """The shell of one layer on given columns."""
        layers = uniform_layers(self.base, d, self.degree_w, self.knots_w)
        layers[0] = self.surface.control_points
        return Shell(self.surface, layers, self.degree_w, self.knots_w)

    def certificate(self, d: np.ndarray) -> Certificate:
        """What can be proved about the elements of given columns.

        Only elements that are not as they were at the last call are looked at again.
        """
        if self._proved is None:
            certificate = certify(self.shell(d).bezier_elements())
        else:
            before, certificate = self._proved
            moved = np.flatnonzero((d != before).any(axis=1))
            changed = np.zeros(self.surface.element_count, dtype=bool)
            changed[elements_with(self.surface, moved)] = True
            certificate = certificate.merge(certify(self.shell(d).bezier_elements(changed)))
        self._proved = d.copy(), certificate
        return certificate

    def check(self, d: np.ndarray) -> ColumnState:
        """Prove, test and measure columns."""
        certificate = self.certificate(d)
        crossing = np.zeros(0, dtype=int)
        # far from valid there is nothing to be learnt from crossings
        if certificate.invalid + certificate.undecided <= 0.02 * self.surface.element_count:
            found = [grid.element[grid.crossing(self.base + d)[1].ravel()] for grid in self.grids]
            crossing = np.unique(np.concatenate(found))
        w, _, _ = self.field.evaluate(self.nodal @ (self.base + d))
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
        return ColumnState(d, certificate, crossing, w, mean, rms)

    def planes(self, sound: np.ndarray, wanted: np.ndarray) -> Planes:
        """Planes between what crosses in wanted columns, from columns that are sound."""
        found = []
        for grid in self.grids:
            triangles, pairs = grid.crossing(self.base + wanted)
            found.append(planes_between(grid, triangles, pairs, self.base + sound))
        return reduce(Planes.joined, found)

    def look_closer(self, state: ColumnState) -> bool:
        """Test what of a state's inner surface is not proved to be embedded on a finer grid.

        Where that finds crossings the grid stays: every later check sees them.

        Returns
        -------
        bool
            Whether there are any.
        """
        inner = self.surface.with_points(self.base + state.d, polynomial=True)
        left = prove_embedded(inner)
        if left.proved:
            return False
        grid = TestGrid(self.surface, CLOSER, left.open)
        if not grid.outer_embedded or not len(grid.crossing(self.base + state.d)[1]):
            return False
        self.grids.append(grid)
        return True

    def front(self, goal: np.ndarray) -> np.ndarray:
        """Displacements of the control points to the solved front at given levels."""
        return self.rest + solve_front(self.surface, self.frame, self.field, goal)

    def off(self, state: ColumnState, goal: np.ndarray) -> float:
        """Root mean square distance from the levels, as a share of their mean."""
        return float(np.sqrt(self.area @ (state.w - goal) ** 2) / (self.area @ goal))

    def shapes(self, state: ColumnState) -> np.ndarray:
        """Smallest scaled Jacobian of every element."""
        if self._shapes is None or self._shapes[0] is not state:
            self._shapes = state, scaled_jacobian(self.shell(state.d).bezier_elements())
        return self._shapes[1]

    def fault(self, state: ColumnState, goal: np.ndarray) -> float:
        """How far an accepted state is from the levels, flat elements counted as well."""
        flattest = float(self.shapes(state).min())
        off = self.off(state, goal) if self.level_counts else 0.0
        return off + FLAT * max(0.0, 1.0 - flattest / self.shapely)

    def heights(self, d: np.ndarray) -> np.ndarray:
        """How far columns reach across the surface, (n,), mm."""
        return self.frame.mean_normal_length(d - self.rest)

    def reference(self, d: np.ndarray) -> np.ndarray:
        """Thickness at the control points that the elements should have, from columns ``d``."""
        along = self.heights(d)
        usable = along > 0
        floor = 0.1 * np.median(along[usable]) if usable.any() else 0.1
        floor = np.minimum(floor, 0.5 * self.frame.spacing)
        return self.frame.smooth(np.maximum(along, floor), 2)

    def energy(
        self,
        d: np.ndarray,
        goal: np.ndarray,
        fidelity: float,
        *,
        like: np.ndarray | None = None,
        free: np.ndarray | None = None,
        planes: Planes | None = None,
        emphasis: np.ndarray | None = None,
    ) -> ColumnEnergy:
        """Energy of the columns ``d``, all or some of them free.

        Parameters
        ----------
        d : (n, 3) array
        goal : (n,) array
            Levels.
        fidelity : float
        like : (n, 3) array, optional
            Columns of the thickness that elements should have; ``d`` otherwise.
        free, planes, emphasis
            As for :class:`HybridVolume.core.untangle.ColumnEnergy`.
        """
        energy = ColumnEnergy(
            self.surface,
            self.base,
            self.field,
            goal,
            self.reference(d if like is None else like),
            self.degree_w,
            self.nodal,
            d,
            free=free,
            fidelity=fidelity,
            planes=planes,
            emphasis=emphasis,
        )
        # what folded between its samples once will do so again
        known = self.failures[energy.elements]
        energy.add_samples(energy.elements[(known > 0) & (known < OFTEN)], 7)
        energy.add_samples(energy.elements[known >= OFTEN], 11)
        return energy

    def around(self, elements: np.ndarray, rings: int) -> np.ndarray:
        """1 at the control points of some elements, falling to 0 over rings of elements."""
        points = points_of(self.surface, elements)
        near = np.zeros(len(self.reach))
        for ring in range(rings):
            share = 1.0 - ring / rings
            near[points] = np.maximum(near[points], share)
            points = points_of(self.surface, elements_with(self.surface, points))
        return near

    # ------------------------------------------------------------------------ mixtures of states

    def held_back(self, sound: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Columns on the way from sound to wanted ones, as far as their elements are proved."""
        share = np.ones(len(self.reach))
        d = wanted
        for _ in range(8):
            certificate = self.certificate(d)
            bad = certificate.element[certificate.status < 1]
            if not len(bad):
                return d
            d = self._backed(sound, wanted, share, bad)
        return d

    def blended(self, sound: ColumnState, wanted: ColumnState) -> ColumnState:
        """As :meth:`held_back`, for what crosses as well; the sound state where that fails."""
        share = np.ones(len(self.reach))
        state = wanted
        for _ in range(12):
            if state.accepted:
                return state
            state = self.check(self._backed(sound.d, wanted.d, share, state.bad))
        return state if state.accepted else sound

    def _backed(
        self, sound: np.ndarray, wanted: np.ndarray, share: np.ndarray, bad: np.ndarray
    ) -> np.ndarray:
        """Halve the shares (in place) at bad elements and even them out around."""
        points = points_of(self.surface, bad)
        share[points] *= 0.5
        share[share < 0.03] = 0.0
        a, b = self.frame.edges.T
        for _ in range(3):
            np.minimum.at(share, a, np.maximum(BACK * share[b], 0.08))
            np.minimum.at(share, b, np.maximum(BACK * share[a], 0.08))
        return sound + share[:, None] * (wanted - sound)

    def merged(self, sound: ColumnState, wanted: ColumnState) -> ColumnState:
        """The wanted columns, apart from those around its bad elements, which stay as they were.

        Where a state is wrong in few places only, all the others need not wait for them.
        """
        bad = wanted.bad
        state = wanted
        for rings in MERGES:
            if not len(bad) or len(bad) > 0.2 * self.surface.element_count:
                break
            share = np.minimum(2.0 * self.around(bad, rings), 1.0)[:, None]
            state = self.check(wanted.d + share * (sound.d - wanted.d))
            bad = np.union1d(bad, state.bad)
            if state.accepted:
                break
        return state


def nodal_matrix(surface: PatchSurface) -> sparse.csr_matrix:
    """Polynomial B-splines of all control points at the Greville points, (n, n)."""
    mesh = surface.triangulation("greville")
    return surface.basis_at(mesh.vertex_patch, *mesh.vertex_uv.T)


def polynomial_correction(
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
