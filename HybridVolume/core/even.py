# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Knot spans of similar size and shape, before the offset (section 3.5).

Spans are cut by knot insertion along whole strips of patches, which never changes the surface.
Knots are simple, so that the inner boundary stays as smooth across them as it can be.
"""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..errors import InputError
from .refinement import cut_spans
from .strips import SpanIntervals, span_intervals
from .surface import PatchSurface

logger = logging.getLogger(__name__)

ROUNDS = 8
"""Most rounds: one does it where parameters run evenly along the spans."""
FINEST = 256
"""Parts of a span as given that are not cut further for their aspect or turn: there is a fold, a
kink or a side without length, which stays."""
MOST = 200_000
"""Spans that are not exceeded."""
NEEDED_ASPECT = 10.0
"""Aspect of spans from which on they are cut without being asked: shells and meshes of longer ones
were measured to be worse than those of the same spans in two."""
NEEDED_FINEST = 16
"""Parts of a span as given that are not cut further without being asked."""
NEEDED_MOST = 5_000
"""Spans that are not exceeded without being asked."""
UNEVEN = 1.5
"""Parts that are added at once, at most, because a line is run through at uneven speed: equal parts
of the parameter are unequal ones of the line, and a later round could only halve the longest."""
_POINTS = np.linspace(0.0, 1.0, 5)
_BLOCK = 400_000
"""Places that are evaluated at once, which bounds the memory."""


@dataclass(frozen=True)
class Evenness:
    """What spans are wanted.

    Attributes
    ----------
    size : float
        Longest side of a span, mm; 0: any.
    aspect : float
        Longest over shortest side that a span should have, 2 or more; 0: as needed. A strip is cut
        only where at least half of the spans that it crosses ask, since others become thinner.
    turn : float
        Largest angle by which the normal turns along a line of a span, degrees; 0: as needed.

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
        if self.aspect and not 2.0 <= self.aspect < np.inf:
            raise InputError(
                f"the aspect of spans is {self.aspect:g}",
                remedy="choose 2 or more, or 0 for as needed",
            )
        if self.turn and not 1.0 <= self.turn <= 180.0:
            raise InputError(
                f"normals turn by {self.turn:g} degrees in a span",
                remedy="choose from 1 to 180 degrees, or 0 for as needed",
            )

    @property
    def asks(self) -> bool:
        """Whether anything is asked for."""
        return bool(self.size or self.aspect or self.turn)


@dataclass(frozen=True)
class SpanFigures:
    """Spans of a surface: how large and how even they are.

    Attributes
    ----------
    spans : int
    shortest : float
        Smallest mean length of a span's lines along u or along v, mm.
    longest : float
        Longest line of a span, mm.
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
    length, longest, turn, _ = _measured(surface)
    short, long = length.min(axis=1), length.max(axis=1)
    return SpanFigures(
        len(length),
        float(short.min()),
        float(longest.max()),
        float((long / np.maximum(short, 1e-9 * surface.diagonal)).max()),
        float(turn.max()),
    )


def evening_figures(
    wanted: Evenness, before: PatchSurface, after: PatchSurface
) -> dict[str, dict[str, Any]]:
    """What was asked for, and the figures of the spans before and after, as plain values.

    Returns
    -------
    dict
        ``asked``: the attributes of `Evenness`; ``before``, ``after``: those of `SpanFigures`.
    """
    first = asdict(span_figures(before))
    last = first if after is before else asdict(span_figures(after))
    return {"asked": asdict(wanted), "before": first, "after": dict(last)}


def even_out(surface: PatchSurface, wanted: Evenness) -> PatchSurface:
    """Cut spans into equal parts until they are as wanted.

    Parameters
    ----------
    surface : PatchSurface
    wanted : Evenness

    Returns
    -------
    PatchSurface
        The same surface, point for point. Normals turn more than wanted where the surface itself
        has a kink.

    Raises
    ------
    InputError
        That takes more spans than there may be.
    """
    even, refused = _even(surface, wanted, MOST, FINEST)
    if refused:
        raise InputError(
            f"spans as wanted would be {refused:.3g}, more than {MOST}",
            figure=refused,
            remedy="choose a larger size, aspect or turn",
        )
    return even


def even_as_needed(surface: PatchSurface, wanted: Evenness) -> PatchSurface:
    """Cut spans as wanted; where nothing is said about their aspect, very long ones too.

    Parameters
    ----------
    surface : PatchSurface
    wanted : Evenness

    Returns
    -------
    PatchSurface
        As of :func:`even_out`.

    Raises
    ------
    InputError
        What was asked for takes more spans than there may be.
    """
    surface = even_out(surface, wanted)
    if wanted.aspect:
        return surface
    return _even(surface, Evenness(aspect=NEEDED_ASPECT), NEEDED_MOST, NEEDED_FINEST)[0]


def _even(
    surface: PatchSurface, wanted: Evenness, most: int, finest: int
) -> tuple[PatchSurface, float]:
    """Cut spans until they are as wanted, or until they would be more than ``most``.

    Returns
    -------
    PatchSurface
    float
        How many spans it would have taken; 0 where they are as wanted.
    """
    if not wanted.asks:
        return surface, 0.0
    intervals = span_intervals(surface)
    # one over the share of a span as given that each interval is
    parts = np.ones(intervals.count)
    for _ in range(ROUNDS):
        asked = _parts(surface, wanted, intervals, finest / parts)
        if asked.max(initial=1) <= 1:
            break
        spans = float(asked[intervals.of_span].prod(axis=1).sum())
        if spans > most:
            return surface, spans
        finer = cut_spans(surface, asked, intervals)
        logger.info("spans evened out: %d, were %d", finer.element_count, surface.element_count)
        surface, intervals = finer, span_intervals(finer)
        parts = np.repeat(parts * asked, asked.astype(int))
    return surface, 0.0


def _parts(
    surface: PatchSurface, wanted: Evenness, intervals: SpanIntervals, left: np.ndarray
) -> np.ndarray:
    """Parts (ni,) that each interval of the strips is to be cut into.

    Parameters
    ----------
    surface : PatchSurface
    wanted : Evenness
    intervals : SpanIntervals
    left : (ni,) array
        Most parts for aspect and turn.
    """
    length, longest, turn, uneven = _measured(surface)
    parts = np.ones(intervals.count)
    for limit, values, counts in ((wanted.size, longest, True), (wanted.turn, turn, left > 1.0)):
        if limit:
            over = values > limit * (1.0 + 1e-9)
            asked = intervals.largest(np.where(over, values * uneven, 0.0)) / limit
            parts = np.maximum(parts, np.where(counts, np.ceil(asked * (1.0 - 1e-9)), 1.0))
    if wanted.aspect:
        # of the spans as they will be, cut by the rest
        cut = length / parts[intervals.of_span]
        ratio = cut / np.maximum(cut[:, ::-1], 1e-9 * surface.diagonal) / wanted.aspect
        asking = ratio > 1.0 + 1e-9
        most = (left >= 2.0) & (intervals.mean(asking) >= 0.5)
        more = np.ceil(np.maximum(intervals.median(ratio, asking) * (1.0 - 1e-9), 2.0))
        parts = np.where(most, parts * np.minimum(more, np.floor(left)), parts)
    return parts


def _measured(
    surface: PatchSurface,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What the lines of spans along u and along v are like.

    Returns
    -------
    length, longest : (ne, 2) arrays
        Mean and largest lengths, mm.
    turn : (ne, 2) array
        Largest turn of the normal, degrees.
    uneven : (ne, 2) array
        Highest over mean speed along a line, 1 to `UNEVEN`.
    """
    n = len(_POINTS)
    count = surface.element_count
    length, longest, turn, uneven = np.empty((4, count, 2))
    for block in np.array_split(np.arange(count), 1 + count * n**2 // _BLOCK):
        samples = surface.element_samples(_POINTS, _POINTS, block)
        x, x_u, x_v = (a.reshape(-1, n, n, 3) for a in samples.surface(surface.control_points))
        normal = np.cross(x_u, x_v)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
        for d, axis in enumerate((1, 2)):
            steps = np.linalg.norm(np.diff(x, axis=axis), axis=-1)
            lines = steps.sum(axis=axis)
            length[block, d], longest[block, d] = lines.mean(axis=1), lines.max(axis=1)
            pace = (n - 1) * steps.max(axis=(1, 2)) / np.maximum(longest[block, d], 1e-300)
            uneven[block, d] = np.clip(pace, 1.0, UNEVEN)
            one, other = (np.take(normal, rows, axis=axis) for rows in (range(n - 1), range(1, n)))
            angle = np.arctan2(
                np.linalg.norm(np.cross(one, other), axis=-1), (one * other).sum(axis=-1)
            )
            turn[block, d] = np.degrees(angle.sum(axis=axis).max(axis=1))
    return length, longest, turn, uneven
