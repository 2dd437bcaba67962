# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The shell as trivariate patches for other programs: corners, sides that meet, interfaces.

Programs such as MFEM know an edge by its two ends and a face by its corners. Where that is not
enough (a ring of one or two patches, two patches over the same corners), patches are cut exactly,
by knots of full multiplicity, along whole strips.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import FaultError
from . import bspline
from .shell import Shell
from .strips import Strips, strips

_ROUNDS = 8
"""Halvings of a strip; a ring of one patch needs two."""


@dataclass(frozen=True, eq=False)
class SolverPatch:
    """A trivariate NURBS patch with parameters (v, u, w) of its surface patch, right-handed.

    Attributes
    ----------
    face : str
        CAD face on its outer side, w = 0.
    source : int
        Patch of the surface that it is, or is cut from; parameters stay those of that patch.
    degrees : (int, int, int)
    knots : (array, array, array)
        Clamped, within [0, 1].
    columns : (n1, n2) int array
        Numbers of the columns of control points: patches that meet share them.
    points : (n1, n2, n3, 3) array
        mm.
    weights : (n1, n2, n3) array
    """

    face: str
    source: int
    degrees: tuple[int, int, int]
    knots: tuple[np.ndarray, np.ndarray, np.ndarray]
    columns: np.ndarray
    points: np.ndarray
    weights: np.ndarray

    @property
    def rational(self) -> bool:
        """Whether the weights are not all 1."""
        return bool((self.weights != 1.0).any())


@dataclass(frozen=True, eq=False)
class SolverPatches:
    """All patches of a shell.

    Attributes
    ----------
    patches : tuple of SolverPatch
    columns : int
        Number of columns of control points.
    face_names : tuple of str
        CAD faces in the order of the surface's patches.
    """

    patches: tuple[SolverPatch, ...]
    columns: int
    face_names: tuple[str, ...]

    @cached_property
    def face(self) -> np.ndarray:
        """Position of each patch's face among ``face_names``, (np,)."""
        place = {name: k for k, name in enumerate(self.face_names)}
        return np.array([place[patch.face] for patch in self.patches])

    @cached_property
    def corner_columns(self) -> np.ndarray:
        """Columns at (0, 0), (1, 0), (1, 1), (0, 1) of the first two parameters, (np, 4)."""
        return np.stack([p.columns[[0, -1, -1, 0], [0, 0, -1, -1]] for p in self.patches])

    @cached_property
    def corners(self) -> np.ndarray:
        """Vertices of each patch, (np, 8): outer then inner ones, in VTK's order.

        Vertices with w = 0 have the lowest numbers, those below them follow in the same order.
        """
        found, number, count = np.unique(
            self.corner_columns, return_inverse=True, return_counts=True
        )
        # MFEM tells faces by their three lowest vertices: where two patches alone meet at a vertex
        # both have its neighbours, so that it must not be one of the three
        rank = np.empty(len(found), dtype=int)
        rank[np.argsort(count == 2, kind="stable")] = np.arange(len(found))
        outer = rank[number.reshape(-1, 4)]
        return np.hstack([outer, outer + len(found)])

    @cached_property
    def sides(self) -> np.ndarray:
        """Columns that name each side, (np, 4, 4): its ends, and those next to them.

        Sides are first = 0, first = 1 (along the second), second = 0, second = 1 (along the
        first).
        """
        rows = []
        for patch in self.patches:
            c = patch.columns
            rows.append([line[[0, -1, 1, -2]] for line in (c[0], c[-1], c[:, 0], c[:, -1])])
        return np.array(rows)

    @cached_property
    def meetings(self) -> np.ndarray:
        """Sides that meet, (m, 5): patch, side, other patch, its side, 1 where it runs back.

        Raises
        ------
        FaultError
            A side has no partner, or more than one.
        """
        ends = self.sides.reshape(-1, 2, 2)
        flip = ends[:, 0, 0] > ends[:, 0, 1]
        keys = np.where(flip[:, None, None], ends[..., ::-1], ends).reshape(-1, 4)
        _, number, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        if not (count == 2).all():
            raise FaultError(
                f"{int((count != 2).sum())} sides of patches do not meet one other side",
                figure=float((count != 2).sum()),
                remedy="report this body: its patches share control points in an unforeseen way",
            )
        one, other = np.argsort(number.ravel(), kind="stable").reshape(-1, 2).T
        back = flip[one] != flip[other]
        return np.column_stack([one // 4, one % 4, other // 4, other % 4, back])

    def places(self, source: np.ndarray, uv: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Patch and parameters of places that are given on the surface's patches, (m, 4).

        Parameters
        ----------
        source : (m,) int array
            Patch of the surface.
        uv : (m, 2) array
        w : (m,) array

        Returns
        -------
        (m, 4) array
            Patch, and its first, second and third parameter.
        """
        first = np.array([[p.knots[0][0], p.knots[1][0]] for p in self.patches])
        owner = np.array([p.source for p in self.patches])
        # patches of one source stand row by row: the last that begins before a place has it
        start = np.searchsorted(owner, np.arange(owner.max() + 2))
        found = start[source]
        most = int(np.diff(start).max())
        swapped = uv[:, ::-1]
        for step in range(1, most):
            other = np.minimum(start[source] + step, start[source + 1] - 1)
            inside = (first[other] <= swapped).all(axis=1)
            found = np.where(inside, other, found)
        return np.column_stack([found, swapped, w])


def solver_patches(shell: Shell) -> SolverPatches:
    """Patches of a shell such that corners tell edges and faces apart.

    Parameters
    ----------
    shell : Shell

    Raises
    ------
    FaultError
        Cutting patches did not lead to such patches.
    """
    found = strips(shell.surface)
    cuts: list[list[float]] = [[] for _ in range(len(found))]
    for _ in range(_ROUNDS):
        made, crossed = _cut(shell, found, cuts)
        wanted = _ambiguous(made, crossed)
        if not len(wanted):
            return made
        for strip in wanted:
            _halve(shell, found, cuts, int(strip))
    raise FaultError(
        "the shell's patches cannot be told apart by their corners",
        remedy="report this body: cutting its patches did not help",
    )


def _ambiguous(made: SolverPatches, crossed: np.ndarray) -> np.ndarray:
    """Strips to cut because an edge or a face is not told by its corners."""
    ends = np.sort(made.sides[..., :2], axis=-1)
    # a side runs along the second parameter, then along the first
    along = crossed[:, [1, 1, 0, 0]]
    wanted = [along[ends[..., 0] == ends[..., 1]]]
    near = np.sort(made.sides[..., 2:], axis=-1)
    keys = np.concatenate([ends, near], axis=-1).reshape(-1, 4)
    distinct, which = np.unique(keys, axis=0, return_inverse=True)
    _, pair, count = np.unique(distinct[:, :2], axis=0, return_inverse=True, return_counts=True)
    twice = count[pair.ravel()] > 1
    wanted.append(along.reshape(-1)[twice[which.ravel()]])
    faces = np.sort(made.corners[:, :4], axis=1)[:, :3]
    _, face, count = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    wanted.append(crossed[count[face.ravel()] > 1, 0])
    return np.unique(np.concatenate(wanted))


def _halve(shell: Shell, found: Strips, cuts: list[list[float]], strip: int) -> None:
    """Add a cut in the middle of a strip's longest part, at a knot if one is near."""
    k, d = np.argwhere(found.number == strip)[0]
    knots = np.unique(shell.surface.patches[k].knots[d])
    knots = 1.0 - knots[::-1] if found.turned[k, d] else knots
    lines = np.array([0.0, *cuts[strip], 1.0])
    longest = int(np.argmax(np.diff(lines)))
    low, high = lines[longest : longest + 2]
    middle = 0.5 * (low + high)
    near = knots[np.abs(knots - middle) < 0.25 * (high - low)]
    place = float(near[np.argmin(np.abs(near - middle))]) if len(near) else middle
    fresh = [place, 1.0 - place] if found.twisted[strip] else [place]
    for x in fresh:
        if all(abs(x - known) > bspline.KNOT_TOLERANCE for known in cuts[strip]):
            cuts[strip].append(x)
    cuts[strip].sort()


def _cut(shell: Shell, found: Strips, cuts: list[list[float]]) -> tuple[SolverPatches, np.ndarray]:
    """Patches that end at the cuts, and the strips that cross each in the file's directions."""
    surface = shell.surface
    lines = []
    for k, patch in enumerate(surface.patches):
        both = []
        for d in (0, 1):
            asked = np.array(cuts[found.number[k, d]])
            asked = np.sort(1.0 - asked) if found.turned[k, d] else asked
            both.append(_cut_line(patch.degrees[d], patch.knots[d], asked))
        lines.append(both)
    grids, count = surface.shared_grid(
        [tuple(len(knots) - p - 1 for (knots, *_), p in zip(both, patch.degrees, strict=True))
         for both, patch in zip(lines, surface.patches, strict=True)]
    )  # fmt: skip
    weights = np.ones(count)
    layers = np.empty((len(shell.layers), count, 3))
    # patches give the points that they share to a rounding: the lowest patch's stay
    for k in reversed(range(len(surface.patches))):
        patch = surface.patches[k]
        (_, left, _), (_, right, _) = lines[k]
        inside, heavy = shell.layers[:, patch.index], patch.weights
        if left is not None or right is not None:
            inside, heavy = _finer(inside, heavy, left, right)
        layers[:, grids[k]], weights[grids[k]] = inside, heavy
    patches, crossed = [], []
    for k, patch in enumerate(surface.patches):
        (knots_u, _, parts_u), (knots_v, _, parts_v) = lines[k]
        for second, across in _parts(patch.degrees[1], knots_v, parts_v):
            for first, along in _parts(patch.degrees[0], knots_u, parts_u):
                columns = grids[k][first, second].T
                points = np.moveaxis(layers[:, columns], 0, 2)
                heavy = np.ones(points.shape[:3])
                heavy[..., 0] = weights[columns]
                degrees = (*patch.degrees[::-1], shell.degree_w)
                knots = (across, along, shell.knots_w)
                patches.append(SolverPatch(patch.face, k, degrees, knots, columns, points, heavy))
                crossed.append(found.number[k, ::-1])
    names = tuple(dict.fromkeys(patch.face for patch in surface.patches))
    return SolverPatches(tuple(patches), count, names), np.array(crossed)


def _cut_line(
    degree: int, knots: np.ndarray, asked: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
    """Knots with full multiplicity at the cuts, the matrix to them (None: none), the cuts."""
    if not len(asked):
        return knots, None, asked
    places = []
    more: list[float] = []
    for x in asked:
        near = knots[np.abs(knots - x) <= bspline.KNOT_TOLERANCE]
        places.append(float(near[0]) if len(near) else float(x))
        more += [places[-1]] * (degree - len(near))
    finer = np.sort(np.concatenate([knots, more]))
    return finer, bspline.insertion_matrix(degree, knots, finer), np.array(places)


def _finer(
    layers: np.ndarray,
    weights: np.ndarray,
    left: np.ndarray | None,
    right: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Control points of all layers (nw, nu, nv, 3) and outer weights after insertion."""
    left = np.eye(weights.shape[0]) if left is None else left
    right = np.eye(weights.shape[1]) if right is None else right
    fine = left @ weights @ right.T
    if np.ptp(weights) == 0.0:
        # sums of equal weights may miss them by a rounding
        fine = np.full(fine.shape, weights[0, 0])
    inside = layers.copy()
    inside[0] *= weights[..., None]
    inside = np.einsum("ai,bj,kijd->kabd", left, right, inside, optimize=True)
    inside[0] /= fine[..., None]
    return inside, fine


def _parts(degree: int, knots: np.ndarray, cuts: np.ndarray) -> list[tuple[slice, np.ndarray]]:
    """Control points and clamped knots of each part of a line that is cut."""
    found = []
    ends = [knots[0], *cuts, knots[-1]]
    for low, high in zip(ends[:-1], ends[1:], strict=True):
        # the control point that the spline goes through stands before a full knot's first
        start = 0 if low == knots[0] else int(np.searchsorted(knots, low)) - 1
        stop = int(np.searchsorted(knots, high)) - 1
        inner = knots[(knots > low) & (knots < high)]
        full = np.concatenate([[low] * (degree + 1), inner, [high] * (degree + 1)])
        found.append((slice(start, stop + 1), full))
    return found
