# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Strips of patches, and grid lines along them that meet at every shared side.

A line that crosses a patch leaves it through a side and goes on in the neighbour: all patches that
it runs through have it. So each strip has one set of lines, whatever way its patches are turned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .assembly import direction_strips
from .surface import PatchSurface


@dataclass(frozen=True)
class Strips:
    """Which strip crosses each patch in each direction.

    Attributes
    ----------
    number : (np, 2) int array
        Strip whose lines stand along u, and along v.
    turned : (np, 2) bool array
        Whether the patch runs against its strip.
    twisted : (ns,) bool array
        Strips that come back turned round: their lines must be the same from either end.
    """

    number: np.ndarray
    turned: np.ndarray
    twisted: np.ndarray

    def __len__(self) -> int:
        return len(self.twisted)


def strips(surface: PatchSurface) -> Strips:
    """The strips of a closed surface."""
    number, turned, twisted = direction_strips(surface.neighbour, surface.reversed)
    return Strips(number, turned, np.array(twisted))


@dataclass(frozen=True, eq=False)
class GridLines:
    """Grid lines of all patches: those of a base, and lines between them.

    Attributes
    ----------
    strips : Strips
    base_u, base_v : lists of arrays
        Parameters of the lines that are there in any case, for each patch.
    places : tuple of arrays
        For each strip where its lines stand: line 2.25 is a quarter of the way from the third base
        line to the next.
    """

    strips: Strips
    base_u: list[np.ndarray]
    base_v: list[np.ndarray]
    places: tuple[np.ndarray, ...]

    @property
    def plain(self) -> bool:
        """Whether there are only the base's lines."""
        bases = self._first_bases()
        return all(len(p) == len(b) for p, b in zip(self.places, bases, strict=True))

    @property
    def cells(self) -> int:
        """Cells between the lines, of all patches."""
        lines = np.array([len(p) - 1 for p in self.places])
        return int(lines[self.strips.number].prod(axis=1).sum())

    def lines(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Parameters of the lines along u and along v, for each patch; alike ones are one array."""
        made: dict[tuple[int, int, bool], np.ndarray] = {}

        def values(base: np.ndarray, strip: int, turned: bool) -> np.ndarray:
            key = (id(base), strip, turned)
            if key not in made:
                places = self.places[strip]
                last = len(base) - 1
                if turned:
                    places = last - places[::-1]
                made[key] = (
                    base
                    if len(places) == len(base)
                    else np.interp(places, np.arange(last + 1), base)
                )
            return made[key]

        number, turned = self.strips.number.tolist(), self.strips.turned.tolist()
        return tuple(
            [values(base, n[k], t[k]) for base, n, t in zip(bases, number, turned, strict=True)]
            for k, bases in enumerate((self.base_u, self.base_v))
        )

    def cut(self, parts: Sequence[np.ndarray]) -> GridLines:
        """The same with every interval of each strip cut into equal parts.

        Parameters
        ----------
        parts : ns (m,) int arrays
            Parts of each interval.
        """
        return replace(
            self,
            places=tuple(_cut(p, count) for p, count in zip(self.places, parts, strict=True)),
        )

    def marked(self, cells: np.ndarray) -> list[np.ndarray]:
        """Intervals of each strip that run through some cells.

        Parameters
        ----------
        cells : (nc, 2) bool array
            For each cell of the grid, patch by patch, u then v: whether its intervals along u and
            along v count.

        Returns
        -------
        ns (m,) bool arrays
        """
        found = [np.zeros(len(p) - 1, dtype=bool) for p in self.places]
        start = 0
        for number, turned in zip(
            self.strips.number.tolist(), self.strips.turned.tolist(), strict=True
        ):
            shape = tuple(len(found[n]) for n in number)
            part = cells[start : start + shape[0] * shape[1]]
            start += len(part)
            if not part.any():
                continue
            part = part.reshape(*shape, 2)
            for axis in (0, 1):
                hit = part[..., axis].any(axis=1 - axis)
                found[number[axis]] |= hit[::-1] if turned[axis] else hit
        for n in np.flatnonzero(self.strips.twisted):
            found[n] = found[n] | found[n][::-1]
        return found

    def within(self, wanted: GridLines) -> int:
        """Cells of a coarser grid that are cut here."""
        split = [
            np.bincount(np.searchsorted(b, 0.5 * (a[1:] + a[:-1])) - 1, minlength=len(b) - 1) > 1
            for a, b in zip(self.places, wanted.places, strict=True)
        ]
        whole = np.array([np.count_nonzero(~s) for s in split])
        return wanted.cells - int(whole[self.strips.number].prod(axis=1).sum())

    def _first_bases(self) -> list[np.ndarray]:
        bases: list[np.ndarray | None] = [None] * len(self.strips)
        for patch, numbers in enumerate(self.strips.number.tolist()):
            for number, base in zip(numbers, (self.base_u[patch], self.base_v[patch]), strict=True):
                bases[number] = base
        return bases


def base_lines(surface: PatchSurface, nodes: str) -> GridLines:
    """Lines at the knots or at the Greville abscissae, and no others."""
    if nodes not in ("knots", "greville"):
        raise ValueError(f"nodes stand at 'knots' or 'greville', not at {nodes!r}")
    u, v = surface.grid_parameters(nodes)
    found = GridLines(strips(surface), u, v, ())
    places = tuple(np.arange(float(len(base))) for base in found._first_bases())
    return replace(found, places=places)


@dataclass(frozen=True, eq=False)
class SpanIntervals:
    """Intervals between knot lines that run through strips of patches, and the spans in them.

    Attributes
    ----------
    strips : Strips
    of_span : (ne, 2) int array
        Interval of each knot span along u and along v.
    first : (ns + 1,) int array
        First interval of each strip.
    twin : (ni,) int array
        The interval that is cut alike: of a strip that comes back turned round the one at the
        other end, else itself.
    """

    strips: Strips
    of_span: np.ndarray
    first: np.ndarray
    twin: np.ndarray

    @property
    def count(self) -> int:
        """Number of intervals."""
        return int(self.first[-1])

    def largest(self, values: np.ndarray) -> np.ndarray:
        """Largest value (ni,) of the spans in each interval, from (ne, 2) values."""
        found = np.full(self.count, -np.inf)
        np.maximum.at(found, self._number, np.asarray(values, dtype=float).ravel())
        return found[self._alike]

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Mean value (ni,) of the spans in each interval, from (ne, 2) values."""
        spans = np.bincount(self._number, minlength=self.count)
        total = np.bincount(self._number, np.asarray(values, dtype=float).ravel(), self.count)
        return (total / np.maximum(spans, 1))[self._alike]

    def median(self, values: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Median (ni,) of chosen spans in each interval, the lower of two; 0 where there is none.

        Parameters
        ----------
        values : (ne, 2) array
        chosen : (ne, 2) bool array
        """
        values, number = values[chosen], self._number.reshape(-1, 2)[chosen]
        order = np.lexsort((values, number))
        spans = np.bincount(number, minlength=self.count)
        middle = np.cumsum(spans) - spans + np.maximum(spans - 1, 0) // 2
        found = np.zeros(self.count)
        found[spans > 0] = values[order][middle[spans > 0]]
        return found[self._alike]

    @property
    def _alike(self) -> np.ndarray:
        """The first interval that is cut like each one."""
        return np.minimum(np.arange(self.count), self.twin)

    @property
    def _number(self) -> np.ndarray:
        return self._alike[self.of_span.ravel()]


def span_intervals(surface: PatchSurface) -> SpanIntervals:
    """The intervals of a surface's strips."""
    found = strips(surface)
    patch = surface.element_patch
    low = np.empty((len(patch), 2))
    for group in surface.groups:
        low[group.element] = group.low
    # spans are numbered patch by patch, along v first
    many = np.stack(
        [np.bincount(patch[low[:, 1 - d] == 0.0], minlength=len(surface.patches)) for d in (0, 1)],
        axis=1,
    )
    start = np.concatenate([[0], np.cumsum(many.prod(axis=1))[:-1]])
    place = np.stack(np.divmod(np.arange(len(patch)) - start[patch], many[patch, 1]), axis=1)
    place = np.where(found.turned[patch], many[patch] - 1 - place, place)
    length = np.zeros(len(found), dtype=int)
    length[found.number] = many
    first = np.concatenate([[0], np.cumsum(length)])
    strip = np.repeat(np.arange(len(found)), length)
    own = np.arange(first[-1])
    twin = np.where(found.twisted[strip], first[strip] + first[strip + 1] - 1 - own, own)
    return SpanIntervals(found, first[found.number[patch]] + place, first, twin)


def _cut(places: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Places with each interval cut into so many equal parts."""
    if (parts == 1).all():
        return places
    number = np.repeat(np.arange(len(parts)), parts)
    first = np.repeat(np.cumsum(parts) - parts, parts)
    share = (np.arange(len(number)) - first) / parts[number]
    return np.append(places[number] + np.diff(places)[number] * share, places[-1])
