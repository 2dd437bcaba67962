# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How thick the shell should be: a level, millimetres or a share, and factors for faces."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from ..errors import InputError
from .front import ColumnFrame, solve_front
from .harmonic import HarmonicField
from .midstructure.distances import SurfaceDistance
from .midstructure.thickness import local_thickness
from .surface import PatchSurface

logger = logging.getLogger(__name__)

LEVELS = (0.01, 0.99)
"""Levels that may be asked for."""
FACTORS = (0.05, 20.0)
"""Factors of faces."""
KINDS = ("w0", "even", "mean", "min", "share")
SHARES = (0.01, 0.95)
"""Shares of the local radius that may be asked for."""
DEEPEST = 0.95
"""The highest level that a thickness in mm or a factor leads to: near 1 elements are crushed."""
SHALLOWEST = 1e-4
"""The lowest level that a thickness in mm leads to: at a corner it goes like the third power."""
CORRECTIONS = 4
"""Solutions of the front by which levels are found that give an even thickness."""
STEEPEST = 2.0
"""Largest factor of one correction."""
STEPS = 32
"""Places on a straight column where the level is looked up."""
LEANING = 0.2
"""Least share of its length by which a column is taken to lead away from the surface."""
POWERS = (0.7, 3.0)
"""Powers of the thickness that the level may go like."""
CLOSE = 0.01
"""Mean logarithm of the thickness over the one wanted that is near enough."""
THINNEST = 0.05
"""Smallest thickness that a share of the local radius leads to, as a share of its mean."""
TORN = 0.05
"""Share of the level asked below which a level with the body's genus is of no use."""
SECANTS = 6
"""Most solutions of the front by which the level of a mean or smallest thickness is found."""
BEHIND = 0.8
"""Share of its level below which a column of the front tells nothing about the thickness."""
SAMPLES = 20_000
"""Samples of the surface by which distances to it are found."""


@dataclass(frozen=True)
class Thickness:
    """Thickness of a shell.

    Attributes
    ----------
    kind : {"w0", "even", "mean", "min", "share"}
        One level of the harmonic field everywhere; the same number of mm everywhere; one level,
        such that the mean, or the smallest, thickness is that many mm; everywhere the same share
        of the local radius, which is half the body's thickness there.
    value : float
        The level, mm, or the share as a fraction.
    factors : mapping of str to float
        By what the thickness is multiplied at a CAD face; 1 at faces that are not named.

    Raises
    ------
    InputError
        A value is out of its range.
    """

    kind: str = "w0"
    value: float = 0.5
    factors: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(
                f"{self.kind!r} is no kind of thickness", remedy=f"use one of {', '.join(KINDS)}"
            )
        low, high = LEVELS
        if self.kind == "w0" and not low <= self.value <= high:
            raise InputError(
                f"w0 is {self.value:g}",
                remedy=f'choose a level from {low} to {high}, or a length such as "2 mm"',
            )
        low, high = SHARES
        if self.kind == "share" and not low <= self.value <= high:
            raise InputError(
                f"the shell is {100 * self.value:g} % of the local radius",
                remedy=f"choose a share from {100 * low:g} % to {100 * high:g} %",
            )
        if self.in_mm and not 0.0 < self.value < np.inf:
            raise InputError(
                f"the thickness is {self.value:g} mm", remedy="choose a length above 0 mm"
            )
        for face, factor in self.factors.items():
            low, high = FACTORS
            if not low <= factor <= high:
                raise InputError(
                    f"the factor of {face} is {factor:g}",
                    faces=[face],
                    remedy=f"choose a factor from {low} to {high}",
                )

    @classmethod
    def parse(cls, text: str, factors: Mapping[str, float] | None = None) -> Thickness:
        """Read ``"0.5"``, ``"2 mm"``, ``"mean 2 mm"``, ``"min 2 mm"`` or ``"30 %"``.

        Raises
        ------
        InputError
            It is none of them.
        """
        number = r"([0-9]+\.?[0-9]*(?:e[-+]?[0-9]+)?|\.[0-9]+(?:e[-+]?[0-9]+)?)"
        found = re.fullmatch(rf"(mean|min)?\s*{number}\s*(mm|%)?", text.strip().lower())
        if not found or (found[1] and found[3] != "mm"):
            raise InputError(
                f"{text!r} is no thickness",
                remedy='give a level such as "0.5", or "2 mm", "mean 2 mm", "min 2 mm", "30 %"',
            )
        kind = found[1] or {None: "w0", "mm": "even", "%": "share"}[found[3]]
        value = float(found[2])
        return cls(kind, value / 100.0 if kind == "share" else value, dict(factors or {}))

    @property
    def in_mm(self) -> bool:
        """Whether ``value`` is a length."""
        return self.kind in ("even", "mean", "min")

    @property
    def uniform(self) -> bool:
        """Whether one level is asked everywhere."""
        return self.kind in ("w0", "mean", "min") and all(f == 1.0 for f in self.factors.values())

    @property
    def text(self) -> str:
        """What `parse` reads."""
        if self.kind == "w0":
            return f"{self.value:.12g}"
        if self.kind == "share":
            return f"{100.0 * self.value:.12g} %"
        word = "" if self.kind == "even" else f"{self.kind} "
        return f"{word}{self.value:.12g} mm"

    def __str__(self) -> str:
        if self.kind == "w0":
            return f"w0 = {self.value:.3g}"
        return f"{self.text} of the local radius" if self.kind == "share" else self.text


def parse_factor(text: str) -> tuple[str, float]:
    """Read the factor of a face, e.g. ``"Face3 = 1.5"``.

    Raises
    ------
    InputError
        It is none, or out of its range.
    """
    found = re.fullmatch(r"\s*([^\s=:]+)\s*[=:]\s*([^\s=:]+)\s*", text)
    try:
        factor = float(found[2]) if found else np.nan
    except ValueError:
        factor = np.nan
    if not np.isfinite(factor):
        raise InputError(f"{text!r} is no factor of a face", remedy='write it as "Face3 = 1.5"')
    return found[1], Thickness(factors={found[1]: factor}).factors[found[1]]


def parse_factors(texts: Sequence[str]) -> dict[str, float]:
    """Read the factors of several faces, each as for :func:`parse_factor`.

    Raises
    ------
    InputError
        One cannot be read, is out of its range, or a face has two.
    """
    factors: dict[str, float] = {}
    for face, factor in map(parse_factor, texts):
        if factors.setdefault(face, factor) != factor:
            raise InputError(
                f"{face} has the factors {factors[face]:g} and {factor:g}",
                faces=[face],
                remedy="leave one of them",
            )
    return factors


def goal_levels(
    thickness: Thickness, surface: PatchSurface, frame: ColumnFrame, field: HarmonicField
) -> tuple[np.ndarray, list[str]]:
    """Level of the field that the inner surface should lie on at each control point.

    Parameters
    ----------
    thickness : Thickness
    surface : PatchSurface
    frame : ColumnFrame
    field : HarmonicField

    Returns
    -------
    goal : (n,) array
    notes : list of str
        Where the body is too thin for what was asked.

    Raises
    ------
    InputError
        A factor is for a face that the body has not.
    """
    notes = []
    lengths = wanted_lengths(thickness, surface, frame)
    if lengths is not None:
        goal = _even(lengths, surface, frame, field)
        thin = goal >= DEEPEST * (1.0 - 1e-9)
        faces = _faces_of(surface, thin)
        if faces:
            notes.append(
                f"the midstructure is nearer than {thickness} at {', '.join(faces)}; the shell"
                " stays thinner there"
            )
        return goal, notes
    factor = _factors(thickness.factors, surface, frame)
    level = thickness.value
    if thickness.in_mm:
        level, enough = _level_for(thickness, surface, frame, field)
        if not enough:
            notes.append(
                f"the body is too thin for {thickness}; the shell is as thick as it can be"
            )
    goal = np.full(len(frame.nodes), level)
    if thickness.factors:
        goal = np.minimum(goal * factor, max(level, DEEPEST))
    return goal, notes


def wanted_lengths(
    thickness: Thickness, surface: PatchSurface, frame: ColumnFrame
) -> np.ndarray | None:
    """How far from the surface the inner one should be at each control point, (n,), mm.

    None for the kinds that ask for one level of the field.

    Raises
    ------
    InputError
        A factor is for a face that the body has not.
    """
    if thickness.kind == "even":
        return thickness.value * _factors(thickness.factors, surface, frame)
    if thickness.kind == "share":
        length = thickness.value * local_radius(surface, frame)
        # towards the tip of a wedge the radius vanishes, but no element can
        length = np.maximum(length, THINNEST * np.average(length, weights=frame.area))
        return length * _factors(thickness.factors, surface, frame)
    return None


def local_radius(surface: PatchSurface, frame: ColumnFrame) -> np.ndarray:
    """Half the body's thickness at each control point, (n,), mm.

    That is the radius of the largest ball inside the body that touches the surface there; beside a
    convex edge, where such balls are small, of the one in front of it.
    """
    local = local_thickness(SurfaceDistance(surface, SAMPLES))
    near = cKDTree(local.points).query(frame.nodes, k=4)[1]
    return frame.smooth(np.median(local.half[near], axis=1), 1)


def usable_level(
    field: HarmonicField, genus: Sequence[int], asked: float
) -> tuple[float, float, str]:
    """How far the isosurfaces up to a level look like the body (section 3.2).

    Parameters
    ----------
    field : HarmonicField
    genus : sequence of int
        Of each shell of the body.
    asked : float
        Level, in (0, 1).

    Returns
    -------
    largest : float
        The largest level up to the one asked whose isosurface has the body's genus; 0 where none
        has.
    used : float
        The level to take: where next to no level has it the field is torn by necks, which columns
        cross undisturbed, and the level asked is kept.
    note : str
        What the user should know; empty where the asked level fits.
    """
    largest = field.largest_level(genus, asked)
    if largest >= asked * (1.0 - 1e-9):
        return largest, asked, ""
    if largest < TORN * asked:
        return (
            largest,
            asked,
            (f"no isosurface has the body's genus; the shell is drawn to w0 = {asked:.3g}"),
        )
    return (
        largest,
        largest,
        (
            f"the isosurface at w0 = {asked:.3g} has another genus than the body; the largest level"
            f" with the right genus is {largest:.3g}"
        ),
    )


def check_faces(factors: Iterable[str], surface: PatchSurface) -> None:
    """Refuse factors of faces that are not there.

    Raises
    ------
    InputError
    """
    names = {patch.face for patch in surface.patches}
    unknown = sorted(set(factors) - names)
    if unknown:
        raise InputError(
            "the body has no such faces",
            faces=unknown,
            remedy=f"name some of its {len(names)} faces, such as {min(names, key=_by_number)}",
        )


def _by_number(name: str) -> tuple[int, str]:
    return len(name), name


def _factors(factors: Mapping[str, float], surface: PatchSurface, frame: ColumnFrame) -> np.ndarray:
    """Factor at every control point: between faces the geometric mean, evened out a little."""
    check_faces(factors, surface)
    n = len(frame.nodes)
    if not factors:
        return np.ones(n)
    of_patch = np.log([factors.get(patch.face, 1.0) for patch in surface.patches])
    sizes = [patch.index.size for patch in surface.patches]
    points = np.concatenate([patch.index.ravel() for patch in surface.patches])
    # a patch counts once at a point, however often it comes there
    patch, points = np.divmod(np.unique(np.repeat(np.arange(len(sizes)), sizes) * n + points), n)
    total, count = np.bincount(points, of_patch[patch], n), np.bincount(points, minlength=n)
    return np.exp(frame.smooth(total / np.maximum(count, 1.0), 1))


def _level_for(
    thickness: Thickness, surface: PatchSurface, frame: ColumnFrame, field: HarmonicField
) -> tuple[float, bool]:
    """The level at which the solved front has the mean or the smallest distance asked.

    Straight columns tell where to begin. The second value is False where even the highest level
    is not enough.
    """
    _, highest, _ = usable_level(field, surface.genus, DEEPEST)
    to_surface = SurfaceDistance(surface, SAMPLES)
    rays = _Rays(frame, field)
    everywhere = np.ones(len(frame.nodes))

    def off(level: float, *, straight: bool = False) -> float:
        """Logarithm of the thickness over the one asked."""
        depth = rays.depth(level)
        if not straight:
            front = solve_front(surface, frame, field, level * everywhere)
            lagging = _lagging(frame, field, front, level * everywhere)
            reached = to_surface.nearest(frame.nodes + front).distance
            depth = np.where(lagging, depth, reached)
        found = depth.min() if thickness.kind == "min" else np.average(depth, weights=frame.area)
        logger.info("w0 = %.4g: %s thickness %.4g mm", level, thickness.kind, found)
        return float(np.log(max(found, 1e-12 * surface.diagonal) / thickness.value))

    low, high = SHALLOWEST, highest
    for _ in range(20):
        level = float(np.sqrt(low * high))
        low, high = (low, level) if off(level, straight=True) > 0.0 else (level, high)
    low, high = SHALLOWEST, highest
    for _ in range(SECANTS):
        found = off(level)
        if abs(found) < CLOSE:
            break
        if found < 0.0 and level >= highest:
            return highest, False
        low, high = (low, level) if found > 0.0 else (level, high)
        # the thickness goes about like the level, whatever it is for straight columns
        level = float(level * np.exp(-found))
        if level >= high == highest:
            level = highest
        elif not low < level < high:
            level = float(np.sqrt(low * high))
    return level, True


class _Rays:
    """Straight columns along the most inward directions, far enough to meet every level."""

    def __init__(self, frame: ColumnFrame, field: HarmonicField) -> None:
        middle = cKDTree(field.mesh.vertices[field.fixed])
        self._way = 2.0 * middle.query(frame.nodes)[0]
        self._across = np.maximum(frame.mean_normal_length(frame.direction), LEANING)
        self._shares = np.arange(STEPS + 1) / STEPS
        self._w = _levels_along(frame, field, self._way, self._shares)

    def depth(self, level: float) -> np.ndarray:
        """How far across the surface each column meets a level, or else its highest one, mm."""
        level = np.minimum(level, self._w[-1])
        last = (self._w < level).sum(axis=0)  # levels rise along a column
        first = np.maximum(last - 1, 0)
        column = np.arange(self._w.shape[1])
        below, above = self._w[first, column], self._w[last, column]
        part = np.clip((level - below) / np.maximum(above - below, 1e-300), 0.0, 1.0)
        share = self._shares[first] + part * (self._shares[last] - self._shares[first])
        return self._across * self._way * share


def _levels_along(
    frame: ColumnFrame, field: HarmonicField, lengths: np.ndarray, shares: np.ndarray
) -> np.ndarray:
    """Highest level so far at shares of straight columns of given lengths, (k, n)."""
    points = frame.nodes + shares[:, None, None] * (lengths[:, None] * frame.direction)
    w, _, inside = field.evaluate(points.reshape(-1, 3))
    w = np.where(inside, w, 0.0).reshape(len(shares), -1)
    # beyond the midstructure the level falls again
    return np.maximum.accumulate(w, axis=0)


def _lagging(
    frame: ColumnFrame, field: HarmonicField, front: np.ndarray, goal: np.ndarray
) -> np.ndarray:
    """Columns of a front that stay behind their level, as on coarse nets, (n,) bool."""
    return field.evaluate(frame.nodes + front)[0] < BEHIND * goal


def _even(
    length: np.ndarray, surface: PatchSurface, frame: ColumnFrame, field: HarmonicField
) -> np.ndarray:
    """Levels at which the solved front stands off the surface by given lengths.

    The first guess is the level at the places where straight columns of these lengths end; then
    the front is solved and the levels are corrected by the lengths that it gives.
    """
    across = np.maximum(frame.mean_normal_length(frame.direction), LEANING)
    w = _levels_along(frame, field, length / across, np.array([0.5, 1.0]))
    goal = np.clip(w[-1], SHALLOWEST, DEEPEST)
    # the level goes like a power of the length: 1 off a face, 2 off an edge, 3 off a corner
    tiny = 1e-3 * SHALLOWEST
    rise = np.log2(np.maximum(w[1], tiny) / np.maximum(w[0], tiny))
    power = frame.smooth(np.clip(rise, *POWERS), 1)
    for _ in range(CORRECTIONS):
        front = solve_front(surface, frame, field, goal)
        reached = np.maximum(frame.mean_normal_length(front), 1e-12 * surface.diagonal)
        ratio = np.clip(length / reached, 1.0 / STEEPEST, STEEPEST)
        ratio[_lagging(frame, field, front, goal)] = 1.0
        off = np.abs(np.log(ratio))
        logger.info("even thickness: off by up to %.3g times", np.exp(off.max()))
        if np.average(off, weights=frame.area) < CLOSE:
            break
        step = frame.smooth(power * np.log(ratio), 1)
        goal = np.clip(goal * np.exp(step), SHALLOWEST, DEEPEST)
    return goal


def _faces_of(surface: PatchSurface, points: np.ndarray) -> list[str]:
    """Faces on most of whose control points something is the case."""
    names = [p.face for p in surface.patches if points[np.unique(p.index)].mean() > 0.3]
    return sorted(set(names), key=_by_number)
