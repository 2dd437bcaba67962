# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Knot spans of similar size and shape, before the offset (section 3.5).

Spans are halved by knot insertion along whole strips of patches, which never changes the surface.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .refinement import insert_knots
from .surface import PatchSurface

logger = logging.getLogger(__name__)

ROUNDS = 12
"""Most halvings of a span."""
MOST = 200_000
"""Spans that are not exceeded."""
_POINTS = np.linspace(0.0, 1.0, 5)


@dataclass(frozen=True)
class Evenness:
    """What spans are wanted.

    Attributes
    ----------
    size : float
        Longest side of a span, mm; 0: any.
    aspect : float
        Longest over shortest side that a span should have, 2 or more; 0: any. A strip is cut only
        where most of the spans that it crosses ask for it, since others become thinner by that.
    turn : float
        Largest angle by which the normal turns along a side of a span, degrees; 0: any.

    Raises
    ------
    InputError
        A value is out of its range.
    """

    size: float = 0.0
    aspect: float = 0.0
    turn: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.size < np.inf:
            raise InputError(f"the size of spans is {self.size:g} mm", remedy="choose 0 mm or more")
        if self.aspect and not self.aspect >= 2.0:
            raise InputError(
                f"the aspect of spans is {self.aspect:g}",
                remedy="choose 2 or more; halving cannot make it better",
            )
        if self.turn and not 1.0 <= self.turn <= 180.0:
            raise InputError(
                f"normals turn by {self.turn:g} degrees in a span",
                remedy="choose from 1 to 180 degrees",
            )


@dataclass(frozen=True)
class SpanFigures:
    """Spans of a surface: how large and how even they are.

    Attributes
    ----------
    spans : int
    shortest, longest : float
        Mean lengths of sides, mm.
    aspect : float
        Largest ratio of the two mean lengths of a span.
    turn : float
        Largest turn of the normal along a line of a span, degrees.
    """

    spans: int
    shortest: float
    longest: float
    aspect: float
    turn: float


def span_figures(surface: PatchSurface) -> SpanFigures:
    """Figures of the spans of a surface."""
    length, turn = _measured(surface)
    return SpanFigures(
        len(length),
        float(length.min()),
        float(length.max()),
        float((length.max(axis=1) / np.maximum(length.min(axis=1), 1e-300)).max()),
        float(turn.max()),
    )


def even_out(surface: PatchSurface, wanted: Evenness) -> PatchSurface:
    """Halve spans until they are as wanted.

    Parameters
    ----------
    surface : PatchSurface
    wanted : Evenness

    Returns
    -------
    PatchSurface
        The same surface, point for point.

    Raises
    ------
    InputError
        That takes more spans than there may be.
    """
    for _ in range(ROUNDS):
        length, turn = _measured(surface)
        parts = np.ones(length.shape)
        if wanted.size:
            parts = np.maximum(parts, length / wanted.size)
        if wanted.turn:
            parts = np.maximum(parts, turn / wanted.turn)
        least = float(parts.prod(axis=1).sum())
        if least > MOST:
            raise InputError(
                f"spans as wanted would be {least:.3g}, more than {MOST}",
                figure=least,
                remedy="choose a larger size, aspect or turn",
            )
        halved = np.zeros(length.shape, dtype=bool)
        if wanted.size:
            halved |= length > wanted.size * (1.0 + 1e-9)
        if wanted.turn:
            halved |= turn > wanted.turn
        if wanted.aspect:
            other = length[:, ::-1]
            halved |= _by_most(surface, length > wanted.aspect * other)
        if not halved.any():
            return surface
        finer = _halve(surface, halved)
        logger.info("spans evened out: %d, were %d", finer.element_count, surface.element_count)
        surface = finer
    return surface


def _halve(surface: PatchSurface, halved: np.ndarray) -> PatchSurface:
    new: dict[tuple[int, int], list[float]] = {}
    for patch, direction, value, element in _middles(surface):
        if halved[element, direction]:
            new.setdefault((patch, direction), []).append(value)
    return insert_knots(surface, lambda k, d: np.unique(new.get((k, d), [])))


def _middles(surface: PatchSurface) -> Iterable[tuple[int, int, float, int]]:
    """Patch, direction, middle parameter and number of each span."""
    for group in surface.groups:
        middle = 0.5 * (group.low + group.high)
        for row, element in enumerate(group.element.tolist()):
            for direction in (0, 1):
                yield int(group.patch[row]), direction, float(middle[row, direction]), element


def _by_most(surface: PatchSurface, asked: np.ndarray) -> np.ndarray:
    """Where most spans between the same two lines of their patch ask for it."""
    line = np.empty((len(asked), 2), dtype=np.int64)
    keys: dict[tuple[int, int, float], int] = {}
    for patch, direction, value, element in _middles(surface):
        line[element, direction] = keys.setdefault((patch, direction, value), len(keys))
    share = np.bincount(line.ravel(), asked.ravel().astype(float)) / np.bincount(line.ravel())
    return asked & (share[line] > 0.5)


def _measured(surface: PatchSurface) -> tuple[np.ndarray, np.ndarray]:
    """Mean lengths (ne, 2), mm, and largest turns (ne, 2), degrees, of spans along u and v."""
    samples = surface.element_samples(_POINTS, _POINTS)
    n = len(_POINTS)
    x, x_u, x_v = (a.reshape(-1, n, n, 3) for a in samples.surface(surface.control_points))
    normal = np.cross(x_u, x_v)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    length, turn = [], []
    for axis in (1, 2):
        steps = np.linalg.norm(np.diff(x, axis=axis), axis=-1)
        length.append(steps.sum(axis=axis).mean(axis=1))
        one, other = (np.take(normal, rows, axis=axis) for rows in (range(n - 1), range(1, n)))
        angle = np.arctan2(
            np.linalg.norm(np.cross(one, other), axis=-1), (one * other).sum(axis=-1)
        )
        turn.append(np.degrees(angle.sum(axis=axis).max(axis=1)))
    return np.stack(length, axis=1), np.stack(turn, axis=1)
