# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Where points of space are in shell and core: their element, and their parameters inside.

Newton's method in the elements whose sample points are nearest, all points at once; what is in
none of these is looked for in every element whose box it is in. An element is one-to-one, so a
point has one place in it, or on a side that elements share one in each, of which one is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ..boxtree import BoxTree
from ..intersection import winding_numbers
from ..surface import SurfaceMesh
from .fields import Field, FieldSpace
from .simplex_space import bernstein_coefficients, shape_functions

_NEAR = 6
"""Sample points whose elements are tried first."""
_STEPS = 20
"""Steps of Newton's method at most."""
_MET = 1e-10
"""Distance from a point at which its place is found, as a share of the body's size."""
_BLOCK = 4000
"""Points that are looked for at once."""
_TRIANGLES = 20_000
"""Of the outer boundary, where points are told inside or outside."""
_INSIDE = np.array([1.0 / 6.0, 0.5, 5.0 / 6.0])


@dataclass(frozen=True)
class Places:
    """Places of m points.

    Attributes
    ----------
    element : (m,) int array
        Of the shell, or number of shell elements + element of the core; -1: none was near.
    local : (m, 3) array
        Parameters there: along (v, u, w) in [0, 1] of an element of the shell, reference
        coordinates of a tet.
    distance : (m,) array
        From the point to its place, mm.
    """

    element: np.ndarray
    local: np.ndarray
    distance: np.ndarray


class Locator:
    """Finds points of space in the elements of a coupled space.

    Parameters
    ----------
    space : FieldSpace
    """

    def __init__(self, space: FieldSpace) -> None:
        self.cells, self.tets = space.cells, space.space.tets
        self.surface = space.space.spline.shell.surface
        self.count = len(self.cells)
        points = np.concatenate([batch.points.reshape(-1, 3) for batch in self.cells.batches])
        self.size = float(np.linalg.norm(np.ptp(points, axis=0)))
        # far off the origin coordinates have fewer digits
        rounding = 64.0 * np.finfo(float).eps * float(np.abs(points).max())
        self._met = max(_MET * self.size, rounding)

    @cached_property
    def _samples(self) -> tuple[cKDTree, np.ndarray, np.ndarray]:
        """Sample points of all elements as a tree, their elements and parameters."""
        grid = np.stack(np.meshgrid(_INSIDE, _INSIDE, _INSIDE, indexing="ij"), axis=-1)
        local, places = grid.reshape(-1, 3), []
        element, inside = [], []
        for batch in self.cells.batches:
            x, _ = batch.on_lattice(slice(None), (_INSIDE,) * 3, batch.points)
            places.append(x.reshape(-1, 3))
            element.append(np.repeat(batch.element, len(local)))
            inside.append(np.tile(local, (len(batch), 1)))
        # the middle of a tet, and nearer to each of its corners
        share = np.concatenate([np.full((1, 4), 0.25), 0.15 + 0.4 * np.eye(4)])[:, 1:]
        values, _ = shape_functions(self.tets.degree, share)
        places.append((values @ self.tets.nodes[self.tets.elements]).reshape(-1, 3))
        number = self.count + np.arange(len(self.tets.elements))
        element.append(np.repeat(number, len(share)))
        inside.append(np.tile(share, (len(number), 1)))
        return cKDTree(np.concatenate(places)), np.concatenate(element), np.concatenate(inside)

    @cached_property
    def _boxes(self) -> BoxTree:
        """Boxes of all elements: a Bézier element is in the hull of its control points."""
        low, high = np.empty((2, self.count + len(self.tets.elements), 3))
        for batch in self.cells.batches:
            net = batch.points.reshape(len(batch), -1, 3)
            low[batch.element], high[batch.element] = net.min(axis=1), net.max(axis=1)
        net = bernstein_coefficients(3, self.tets.degree) @ self.tets.nodes[self.tets.elements]
        low[self.count :], high[self.count :] = net.min(axis=1), net.max(axis=1)
        room = 1e-3 * self.size
        return BoxTree(low - room, high + room)

    def find(self, points: np.ndarray) -> Places:
        """Places of (m, 3) points, mm; the nearest that was found where a point is in no element.

        Between the core's faces and the shell's inner surface there are slits and overlaps of a
        higher order; a point in a slit has its place on one of their sides.
        """
        points = np.asarray(points, dtype=float)
        found = Places(
            np.full(len(points), -1), np.zeros((len(points), 3)), np.full(len(points), np.inf)
        )
        for first in range(0, len(points), _BLOCK):
            self._find(points, np.arange(first, min(first + _BLOCK, len(points))), found)
        return found

    def _find(self, points: np.ndarray, rows: np.ndarray, found: Places) -> None:
        tree, element, local = self._samples
        _, near = tree.query(points[rows], k=min(_NEAR, tree.n))
        near = near.reshape(len(rows), -1)
        for place in range(near.shape[1]):
            left = np.flatnonzero(found.distance[rows] > self._met)
            again = (element[near[left, :place]] == element[near[left, place]][:, None]).any(axis=1)
            left = left[~again]
            sample = near[left, place]
            self._try(points, rows[left], element[sample], local[sample], found)
        left = rows[found.distance[rows] > self._met]
        if len(left):
            pairs = self._boxes.pairs(BoxTree(points[left], points[left]))
            row, member = left[pairs[:, 1]], pairs[:, 0]
            start = np.where(member[:, None] < self.count, 0.5, 0.25) * np.ones(3)
            self._try(points, row, member, start, found)

    def _try(
        self,
        points: np.ndarray,
        rows: np.ndarray,
        element: np.ndarray,
        start: np.ndarray,
        found: Places,
    ) -> None:
        """Newton's method in an element for each point; what is nearer than before is kept."""
        local, distance = start.copy(), np.full(len(rows), np.inf)
        shell = np.flatnonzero(element < self.count)
        for batch, place, some in self.cells.split(element[shell]):
            chosen, members = shell[some], self.cells.batches[batch]

            def cube(t: np.ndarray, k: np.ndarray, members=members, place=place) -> tuple:
                return members.at(place[k], t, members.points, slopes=True)

            local[chosen], distance[chosen] = _newton(
                points[rows[chosen]], start[chosen], cube, _into_cube, self._met
            )
        core = np.flatnonzero(element >= self.count)
        if len(core):
            net = self.tets.nodes[self.tets.elements[element[core] - self.count]]

            def tet(t: np.ndarray, k: np.ndarray) -> tuple:
                values, slopes = shape_functions(self.tets.degree, t)
                return np.einsum("mn,mnd->md", values, net[k]), slopes @ net[k]

            local[core], distance[core] = _newton(
                points[rows[core]], start[core], tet, _into_tet, self._met
            )
        # a point may stand here several times: the nearest comes last and stays
        order = np.argsort(-distance, kind="stable")
        k = order[distance[order] < found.distance[rows[order]]]
        found.element[rows[k]] = element[k]
        found.local[rows[k]] = local[k]
        found.distance[rows[k]] = distance[k]

    def values(self, places: Places, field: Field) -> np.ndarray:
        """Values of a field at places, (m, k); nan where there is none."""
        found = np.full((len(places.element), field.width), np.nan)
        shell = np.flatnonzero((places.element >= 0) & (places.element < self.count))
        if len(shell):
            found[shell] = self.cells.at(places.element[shell], places.local[shell], field.shell)
        core = np.flatnonzero(places.element >= self.count)
        for some in np.array_split(core, 1 + len(core) // _BLOCK):
            values, _ = shape_functions(self.tets.degree, places.local[some])
            members = self.tets.elements[places.element[some] - self.count]
            found[some] = np.einsum("mn,mnk->mk", values, field.core[members])
        return found

    @cached_property
    def _skin(self) -> SurfaceMesh:
        """Triangles of the outer boundary, which tell inside from outside."""
        cells = np.sqrt(0.5 * _TRIANGLES / self.surface.element_count)
        return self.surface.triangulation(int(np.clip(cells, 2, 40)))

    def outside(self, points: np.ndarray, places: Places, tolerance: float) -> np.ndarray:
        """Numbers of the points outside of the body, (k,).

        Parameters
        ----------
        points : (m, 3) array
            mm
        places : Places
            Of these points.
        tolerance : float
            As far from its place a point may be, mm; farther ones are in a slit or outside.
        """
        shell = places.element < self.count
        beyond = (shell & (places.local[:, 2] <= 0.0)) | (places.element < 0)
        far = np.flatnonzero(~(places.distance <= tolerance))
        # the place found for a point outside may be on the side of an element, inside the body
        rest = far[~beyond[far]]
        skin = self._skin
        beyond[rest] = winding_numbers(skin.vertices, skin.triangles, points[rest]) < 1
        return far[beyond[far]]


def _newton(points, start, evaluate, into, met) -> tuple[np.ndarray, np.ndarray]:
    """Parameters of points in elements and the distances that are left."""
    best, distance = start.copy(), np.full(len(points), np.inf)
    current, active = start.copy(), np.arange(len(points))
    for _ in range(_STEPS):
        x, along = evaluate(current[active], active)
        miss = points[active] - x
        length = np.linalg.norm(miss, axis=1)
        better = length < distance[active]
        best[active[better]], distance[active[better]] = current[active[better]], length[better]
        go = length > met
        active, miss, along = active[go], miss[go], along[go]
        if not len(active):
            break
        # a step for x(t) = point; least squares with a little damping holds on singular places
        normal = along @ np.swapaxes(along, 1, 2)
        normal += 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        step = np.linalg.solve(normal, (along @ miss[..., None]))[..., 0]
        longest = np.abs(step).max(axis=1, keepdims=True)
        step *= np.minimum(1.0, 0.5 / np.maximum(longest, 1e-300))
        last = current[active]
        current[active] = into(last + step)
        # at a side that stops it nothing changes any more
        active = active[np.abs(current[active] - last).max(axis=1) > 1e-14]
    return best, distance


def _into_cube(local: np.ndarray) -> np.ndarray:
    return np.clip(local, 0.0, 1.0)


def _into_tet(local: np.ndarray) -> np.ndarray:
    inside = np.maximum(local, 0.0)
    total = inside.sum(axis=1, keepdims=True)
    return inside / np.maximum(total, 1.0)
