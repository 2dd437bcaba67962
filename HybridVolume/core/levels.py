# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The set W: where the layers of control points stand on straight columns (section 3.2)."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..errors import InputError
from . import bspline
from .evaluation import grid_quads
from .surface import PatchSurface

EVENED = (0.25, 0.5, 0.75)
"""How far layers are evened out where they cannot be as asked, one after the other."""
STEEPEST = 8.0
"""Largest ratio of the heights of two layers that follow each other."""


@dataclass(frozen=True)
class Spacing:
    """How a column is cut into layers.

    Attributes
    ----------
    kind : {"volume", "distance", "ratio", "first"}
        Layers of equal volume, of equal height, each higher than the one before it (seen from the
        outside) by one factor, or so that the outermost one has a given height.
    value : float
        The factor, or the height in mm.

    Raises
    ------
    InputError
        The value is out of its range.
    """

    kind: str = "volume"
    value: float = 0.0

    def __post_init__(self) -> None:
        if self.kind == "ratio" and not 1.0 / STEEPEST <= self.value <= STEEPEST:
            raise InputError(
                f"layers that grow by the factor {self.value:g}",
                remedy=f"choose a factor from {1 / STEEPEST:g} to {STEEPEST:g}",
            )
        if self.kind == "first" and not 0.0 < self.value < np.inf:
            raise InputError(
                f"a first layer of {self.value:g} mm", remedy="choose a height above 0 mm"
            )

    @classmethod
    def parse(cls, text: str) -> Spacing:
        """Read ``"volume"``, ``"distance"``, ``"ratio 1.5"`` or ``"first 0.2 mm"``.

        The words ``ratio`` and ``first`` may be left out.

        Raises
        ------
        InputError
            It is none of them.
        """
        words = text.strip().lower()
        if words in ("volume", "distance"):
            return cls(words)
        number = r"([0-9]+\.?[0-9]*(?:e[-+]?[0-9]+)?|\.[0-9]+(?:e[-+]?[0-9]+)?)"
        found = re.fullmatch(rf"(?:ratio\s)?\s*{number}|(?:first\s)?\s*{number}\s*mm", words)
        if not found:
            raise InputError(
                f"{text!r} is no spacing of layers",
                remedy='give "volume", "distance", a factor such as "ratio 1.5", or the height of'
                ' the first layer such as "first 0.2 mm"',
            )
        return cls("ratio", float(found[1])) if found[1] else cls("first", float(found[2]))

    @property
    def text(self) -> str:
        """What `parse` reads."""
        ending = {"ratio": f" {self.value:.12g}", "first": f" {self.value:.12g} mm"}
        return self.kind + ending.get(self.kind, "")


def uniform_layers(
    points: np.ndarray,
    displacement: np.ndarray,
    degree: int,
    knots: np.ndarray,
) -> np.ndarray:
    """Layers at the Greville abscissae: the map is linear in w.

    Parameters
    ----------
    points, displacement : (n, 3) arrays
        Control points of the surface and how far their columns reach, mm.
    degree : int
    knots : array
        Clamped, on [0, 1].

    Returns
    -------
    (nw, n, 3) array; layer 0 is ``points`` itself
    """
    shares = bspline.greville(degree, knots)
    return _at_shares(points, displacement, shares[:, None])


def spaced_layers(
    points: np.ndarray,
    displacement: np.ndarray,
    degree: int,
    knots: np.ndarray,
    surface: PatchSurface,
    spacing: Spacing | None = None,
    heights: np.ndarray | None = None,
    nodal: sparse.csr_matrix | None = None,
    evened: float = 0.0,
    smooth: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Layers whose knots w_k stand where the spacing wants the layers to end.

    All columns stay straight, so det J only changes by the factor of the re-spacing.

    Parameters
    ----------
    points, displacement, degree, knots
        As for :func:`uniform_layers`.
    surface : PatchSurface
        Its net gives the volumes.
    spacing : Spacing, optional
        Equal volumes otherwise.
    heights : (n,) array, optional
        How far each column reaches across the surface, mm: a leaning one is longer. Its length
        otherwise.
    nodal : (n, n) sparse matrix, optional
        Polynomial B-splines at the Greville points: volumes are then measured between these points
        and not on the net, which lies off the surface where a span is large.
    smooth : callable, optional
        Evens out values at the control points over their neighbours: heights of equal volume that
        change from column to column tilt the layers.
    evened : float
        How far to go from the spacing wanted (0) to equal heights (1).

    Returns
    -------
    (nw, n, 3) array; layer 0 is ``points`` itself
    """
    spacing = spacing or Spacing()
    count = len(bspline.breakpoints(knots)) - 1
    # a single layer has no other to be compared with
    if spacing.kind == "distance" or evened == 1.0 or (count == 1 and spacing.kind != "volume"):
        return uniform_layers(points, displacement, degree, knots)
    if spacing.kind == "volume":
        feet, ways = points, displacement
        if nodal is not None:
            feet, ways = nodal @ points, nodal @ displacement

        def wanted(sites: np.ndarray) -> np.ndarray:
            shares = _equal_volumes(surface, feet, ways, sites)
            return shares if smooth is None else np.stack([smooth(row) for row in shares])
    else:
        ratio = np.full(len(points), spacing.value)
        if spacing.kind == "first":
            if heights is None:
                heights = np.linalg.norm(displacement, axis=1)
            ratio = _ratio_of_first(spacing.value / np.maximum(heights, 1e-300), count)

        def wanted(sites: np.ndarray) -> np.ndarray:
            return _graded(ratio, count, sites)

    sites, even = _sites(degree, knots), bspline.greville(degree, knots)
    ends = wanted(sites)
    shares = np.linalg.solve(bspline.basis_matrix(degree, knots, sites).toarray(), ends)
    rising = np.all(np.diff(shares, axis=0) > 1e-4 * np.diff(ends, axis=0).min(axis=0), axis=0)
    # a column whose spline would not rise everywhere takes the values at the Greville abscissae,
    # which do: its layers end nearly where they should
    shares = np.where(rising, shares, wanted(even))
    shares = (1.0 - evened) * shares + evened * even[:, None]
    return _at_shares(points, displacement, shares)


def trials(spacing: Spacing) -> list[tuple[float, str]]:
    """How far to even layers out, one after the other until all elements are proved.

    Returns
    -------
    list of (float, str)
        ``evened`` of :func:`spaced_layers`, and what to tell the user then.
    """
    if spacing.kind == "distance":
        return [(0.0, "")]
    told = f"not all elements are proved in layers as asked ({spacing.text}); they are"
    return [
        (0.0, ""),
        *((share, f"{told} {100 * share:.0f} % of the way to equal heights") for share in EVENED),
        (1.0, f"{told} layers of equal height"),
    ]


def _at_shares(points: np.ndarray, displacement: np.ndarray, shares: np.ndarray) -> np.ndarray:
    layers = points + shares[..., None] * displacement
    layers[0] = points
    layers[-1] = points + displacement
    return layers


def _sites(degree: int, knots: np.ndarray) -> np.ndarray:
    """Interpolation sites, all knots among them: there the layers end exactly as asked."""
    breaks = bspline.breakpoints(knots)
    extra = degree - 1
    first = np.linspace(breaks[0], breaks[1], extra - extra // 2 + 2)[1:-1]
    last = np.linspace(breaks[-2], breaks[-1], extra // 2 + 2)[1:-1]
    if len(breaks) == 2:
        return np.linspace(0.0, 1.0, degree + 1)
    return np.sort(np.concatenate([breaks, first, last]))


def _equal_volumes(
    surface: PatchSurface, points: np.ndarray, displacement: np.ndarray, sites: np.ndarray
) -> np.ndarray:
    """Shares of the columns up to which they hold given shares of their volume, (sites, n).

    The volume of a column up to the share t is V(t), the integral of (area vector at t) . D; the
    area vector is quadratic in t, so three levels give it exactly.
    """
    rate = np.array(
        [
            np.einsum("li,li->l", _area_vectors(surface, points + t * displacement), displacement)
            for t in (0.0, 0.5, 1.0)
        ]
    )
    # quadratic through t = 0, 1/2, 1; its integral is the cumulated volume
    a = rate[0]
    b = -3.0 * rate[0] + 4.0 * rate[1] - rate[2]
    c = 2.0 * rate[0] - 4.0 * rate[1] + 2.0 * rate[2]

    def volume(t: np.ndarray) -> np.ndarray:
        return t * (a + t * (b / 2.0 + t * c / 3.0))

    whole = volume(np.ones(1))
    least = np.diff(volume(np.linspace(0.0, 1.0, 129)[:, None]), axis=0).min(axis=0)
    usable = (whole > 0.0) & (least > 1e-6 * whole / 128)
    low = np.zeros((len(sites), len(points)))
    high = np.ones_like(low)
    for _ in range(50):
        middle = 0.5 * (low + high)
        under = volume(middle) < sites[:, None] * whole
        low, high = np.where(under, middle, low), np.where(under, high, middle)
    return np.where(usable, 0.5 * (low + high), sites[:, None])


def _graded(ratio: np.ndarray, count: int, sites: np.ndarray) -> np.ndarray:
    """Shares at the sites when each of ``count`` layers is ``ratio`` times as high as the last."""
    log = np.log(ratio)
    even = np.abs(log) < 1e-9
    log = np.where(even, 1.0, log)
    graded = np.expm1(count * sites[:, None] * log) / np.expm1(count * log)
    return np.where(even, sites[:, None], graded)


def _ratio_of_first(share: np.ndarray, count: int) -> np.ndarray:
    """Factor from layer to layer that gives the outermost one a share of its column.

    Columns that are too short or too long for it within the steepest factor get that factor.
    """
    low = np.full(len(share), -np.log(STEEPEST))
    high = -low
    site = np.array([1.0 / count])
    for _ in range(60):
        middle = 0.5 * (low + high)
        # the first layer's share falls as the factor rises
        thick = _graded(np.exp(middle), count, site)[0] > share
        low, high = np.where(thick, middle, low), np.where(thick, high, middle)
    return np.exp(0.5 * (low + high))


def _area_vectors(surface: PatchSurface, points: np.ndarray) -> np.ndarray:
    """Inward dual area vector of every control point on the net, (n, 3), mm²."""
    corners = grid_quads([patch.index for patch in surface.patches])
    x = points[corners]
    cell = -0.5 * np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]) / 4.0
    share = np.repeat(cell, 4, axis=0)
    return np.column_stack(
        [np.bincount(corners.ravel(), part, minlength=len(points)) for part in share.T]
    )
